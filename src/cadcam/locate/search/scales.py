"""The photos as a search sees them: direction fields of all sizes, and how large a part is in them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry.rigid import Rigid
from cadcam.image.direction_field import DirectionField
from cadcam.locate.photo import Photo
from cadcam.locate.search.climb import FieldLevel, composed, turned
from cadcam.locate.views.aspects import Aspects

SWEPT_PX = 33.0  # size of the part in the field that it is swept over
# Displacements at which lines are compared, as shares of the part's size in the picture.
_ASIDE = np.array([[(0.12, 0.22)[k % 2] * f((k + 0.3) * math.pi / 8) for f in (np.cos, np.sin)] for k in range(16)])
_BASES = ((1, 1), (2, 6), (3, 6))  # fields are reduced by the first number times up to so many powers of two
_WIDEST_PX = 1100  # larger photos are reduced first
_NARROWEST_PX = 12  # fields are at least this large


class Scales:
    """The fields of all photos at reductions 1, 2, 3, 4, 6, 8, 12 ..., and how large a part is in them."""

    def __init__(self, aspects: Aspects, photos: Sequence[Photo]) -> None:
        self.aspects = aspects
        self._fields = [_fields(photo) for photo in photos]
        self.places: tuple[Rigid, ...] = tuple(photo.camera_from_world for photo in photos)
        self.focal: list[float] = [math.sqrt(photo.camera.fx * photo.camera.fy) for photo in photos]

    def stage(self, reductions: Array) -> FieldLevel:
        """Return the field of each photo that is nearest to its given reduction (photos,)."""
        both = zip(self._fields, reductions, strict=True)
        fields = (min(own, key=lambda f: abs(math.log(f.reduction / k))) for own, k in both)
        return FieldLevel(tuple(fields), self.places)

    def chosen(self, eye: int, size: float) -> list[int]:
        """Return reductions at which a part of `size` px in one photo is about SWEPT_PX large, then twice that ..."""
        known = self.reductions(eye)
        chosen = [min(known, key=lambda k: abs(math.log(size / k / SWEPT_PX)))]
        while chosen[-1] % 2 == 0 and chosen[-1] // 2 in known:
            chosen.append(chosen[-1] // 2)
        return chosen

    def reductions(self, eye: int) -> list[int]:
        """Return all reductions of one photo, finest first."""
        return [f.reduction for f in self._fields[eye]]

    def swept(self, eye: int, reduction: int) -> DirectionField:
        """Return the field of one photo at one of its reductions."""
        return next(f for f in self._fields[eye] if f.reduction == reduction)

    def alike(self, eye: int, reduction: int, poses: Array) -> FieldLevel:
        """Return fields in which the part at poses (N, 12) is about as large as in one photo's reduced field."""
        sizes = self.sizes(poses)
        return self.stage(reduction * np.median(sizes / sizes[eye], axis=1))

    def beside(self, poses: Array, every: int = 1) -> list[Array]:
        """Return poses (N, 12) displaced by every `every`-th vector of _ASIDE in the photo where the part is largest.

        Poses behind all cameras, and displaced ones that no camera sees, are returned unchanged.
        """
        middle = self.middles(poses)
        depth = np.stack([(T @ middle)[:, 2] for T in self.places])
        eye = np.argmax(np.where(depth > 0, self.sizes(poses), 0.0), axis=0)
        out = [poses.copy() for _ in _ASIDE[::every]]
        for e, (T, fields) in enumerate(zip(self.places, self._fields, strict=True)):
            own = np.flatnonzero(eye == e)
            seen, camera = composed(T, poses[own]), fields[0].camera
            size = self.sizes(poses[own])[e] / fields[0].reduction
            for moved, aside in zip(out, _ASIDE[::every], strict=True):
                there = composed(T.inv, turned(self.aspects, camera, seen, size[:, None] * aside))
                seen_there = np.isfinite(there).all(axis=1)
                moved[own[seen_there]] = there[seen_there]
        return out

    def sizes(self, poses: Array) -> Array:
        """Return the size (photos, N) px of the part in each photo at poses (N, 12)."""
        middle = self.middles(poses)
        away = [np.linalg.norm(middle - T.origin, axis=1) for T in self.places]
        return np.stack([size_px(self.aspects, f, d) for f, d in zip(self.focal, away, strict=True)])

    def middles(self, poses: Array) -> Array:
        """Return the part's centre (N, 3) at poses (N, 12)."""
        return np.asarray(poses[:, :9].reshape(-1, 3, 3) @ self.aspects.centre + poses[:, 9:])


def _fields(photo: Photo) -> list[DirectionField]:
    k = max(1, math.ceil(max(photo.camera.size) / _WIDEST_PX))
    every = [f for b, n in _BASES for f in photo.fields(reduction=b * k, levels=n)]
    return sorted((f for f in every if min(f.camera.size) >= _NARROWEST_PX), key=lambda f: f.reduction)


def size_px(aspects: Aspects, focal: float, distance: Array) -> Array:
    """Return the size (px) of the part's sphere at distances (mm) of its centre."""
    r = aspects.radius
    return np.asarray(2 * focal * r / np.sqrt(np.maximum(distance**2 - r**2, (0.2 * r) ** 2)))
