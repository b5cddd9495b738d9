"""How bright a photo is where a body ought to be: as that body should be in this light, or as what it would hide.

Pixels of the body's picture are taken together by what they show with the body and without it. The light, fitted to all
the rest of the photo (`cadcam.locate.light`), says how bright each of these surfaces is, and how surely; pieces of one
surface err together. Either way the light may not be as it was fitted, for a shadow say, with a probability that no
surface can make up for: then the tones are any that the photo has elsewhere, and edges that ought to show need not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask
from cadcam.cad.edges import FeatureEdges
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import noise_of
from cadcam.locate.light import Light, colors_of, fitted_light, surfaces
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Scene

Longs = npt.NDArray[np.int64]
Window = tuple[slice, slice]
EVERYWHERE: Window = (slice(None), slice(None))
_RIM_PX = 3  # of the body's picture, which is blurred or another body's where that one is off
_LEAST_PX = 60  # of a piece whose brightness counts: small ones are borders and corners
_LAPSE = 0.02  # probability that the light is not as it was fitted
_UNEVEN = 0.006  # sigma of the brightness of pieces of one surface
_BESIDE_PX = 14  # how far beside a body what it hides is looked at, and how far inside what is compared with it
_ANY_MEAN, _ANY_SPREAD = 0.5, 0.3  # brightness of what is no part, and of the light as a whole
_ONE_SURFACE = 0.995  # cosine between normals of one surface
_PAIR, _ONE = np.zeros((0, 2), np.int32), np.zeros(0, np.int32)
_NO_EDGES = FeatureEdges(_PAIR, _PAIR, _ONE, _ONE, _ONE)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What a model shows in pixels: normal (h, w, 3) in the part frame, colour and part (h, w), -1 for nothing."""

    normal: Array
    color: Ids
    part: Ids

    @classmethod
    def of(
        cls, part: Part, photo: Photo, camera_from_part: Rigid, *, without: int = -1, window: Window = EVERYWHERE
    ) -> Drawn:
        """Return what a part shows in a window of the photo, the body `without` left out."""
        mesh = part.scene.mesh
        kept = np.flatnonzero(mesh.part != without)
        scene = part.scene if without < 0 else Scene.of(mesh.select(mesh.part != without), edges=_NO_EDGES)
        view = open_renderer(scene).render(photo.camera, camera_from_part, channels=Channel.NORMAL | Channel.FACE)
        seen = view.face[window]
        face = np.where(seen >= 0, kept[np.maximum(seen, 0)], -1).astype(np.int32)
        normal = view.normal[window].astype(np.float64) @ camera_from_part.rotation
        number = np.where(face >= 0, mesh.part[np.maximum(face, 0)], -1).astype(np.int32)
        return cls(normal, colors_of(part, face), number)


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """Some pixels: normal (n, 3) and colour (n,) of what they show, and that surface's number (n,)."""

    normal: Array
    color: Ids
    surface: Longs

    @classmethod
    def of(cls, drawn: Drawn, where: Mask) -> _Pixels:
        """Return the pixels `where` (H, W)."""
        normal, color = drawn.normal[where], drawn.color[where]
        return cls(normal, color, surfaces(normal, color))

    def log_density(self, light: Light, tones: Array, at: Longs) -> float:
        """Return the log probability density of tones (r,) where the pixels `at` (r,) and their like are."""
        if not len(at):
            return 0.0
        _, first, kind = np.unique(self.surface[at], return_index=True, return_inverse=True)
        mean, V = light.brightness(self.normal[at[first]], self.color[at[first]])
        nothing = self.color[at[first]] < 0
        mean[nothing], V[nothing], V[:, nothing] = _ANY_MEAN, 0.0, 0.0
        V[nothing, nothing] = _ANY_SPREAD**2
        kind = kind.reshape(-1)
        return _log_normal(tones - mean[kind], V[np.ix_(kind, kind)] + _UNEVEN**2 * np.eye(len(kind)))


@dataclass(frozen=True)
class Tones:
    """A part at a pose in photos: what their brightness says of each of its bodies."""

    part: Part
    photos: Sequence[Photo]
    world_from_part: Rigid

    @cached_property
    def _shown(self) -> list[Drawn]:
        return [Drawn.of(self.part, photo, self._camera_from_part(photo)) for photo in self.photos]

    def _camera_from_part(self, photo: Photo) -> Rigid:
        return photo.viewpoint.camera_from_world @ self.world_from_part

    def log_ratio(self, body: int, *, edges: float = 0.0) -> float:
        """Return the logarithm of the likelihood ratio of "there" to "not there" of part number `body`.

        edges: what its edges say, which goes by the same light where they are not seen.
        """
        told = [self._in_photo(photo, shown, body) for photo, shown in zip(self.photos, self._shown, strict=True)]
        there, not_there, other = np.sum(told, axis=0)
        if not np.any(told):
            return edges
        return _lapsing(edges + there, max(edges, 0.0) + other) - _lapsing(not_there, other)

    def _in_photo(self, photo: Photo, shown: Drawn, body: int) -> tuple[float, float, float]:
        """Return the log densities of the tones with the body, without it, and in any other light."""
        from scipy.ndimage import binary_erosion

        its = shown.part == body
        inside = binary_erosion(its, iterations=_RIM_PX)
        if inside.sum() < _LEAST_PX:
            return 0.0, 0.0, 0.0
        light = fitted_light(photo.gray, shown.normal, shown.color, without=its)
        hidden = Drawn.of(self.part, photo, self._camera_from_part(photo), without=body)
        own, behind = _Pixels.of(shown, inside), _Pixels.of(hidden, inside)
        pairs = _pairs(own.surface, behind.surface)
        pieces = [np.flatnonzero(pairs == i) for i in np.flatnonzero(np.bincount(pairs) >= _LEAST_PX)]
        if not pieces:
            return 0.0, 0.0, 0.0
        gray = photo.gray[inside].astype(np.float64)
        tones, at = np.array([np.median(gray[piece]) for piece in pieces]), np.array([piece[0] for piece in pieces])
        other = _log_normal(tones - light.mean, light.spread**2 * np.eye(len(tones)) + _ANY_SPREAD**2)
        near = np.array([_from_beside(photo, shown, hidden, its, _where(inside, piece)) for piece in pieces])
        known = np.isfinite(near[:, 0])
        not_there = behind.log_density(light, tones[~known], at[~known])
        not_there += _log_normal(near[known, 0], np.diag(near[known, 1] ** 2))
        return own.log_density(light, tones, at), not_there, other


def _where(inside: Mask, piece: Longs) -> Mask:
    """Return the pixels (H, W) that are a piece of those inside."""
    out = np.zeros(inside.shape, bool)
    out.ravel()[np.flatnonzero(inside)[piece]] = True
    return out


def _from_beside(photo: Photo, shown: Drawn, hidden: Drawn, its: Mask, piece: Mask) -> tuple[float, float]:
    """Return how much brighter a piece (H, W) is than what it would hide is beside it, and how uneven that is.

    nan where too little of that surface is to be seen beside it.
    """
    from scipy.ndimage import binary_dilation, distance_transform_edt

    rows, columns = np.nonzero(piece)
    room = _BESIDE_PX + 2 * _RIM_PX
    window = tuple(slice(max(int(x.min()) - room, 0), int(x.max()) + room + 1) for x in (rows, columns))
    piece, gray = piece[window], photo.gray[window].astype(np.float64)
    i = int(rows[0]) - window[0].start, int(columns[0]) - window[1].start
    normal, color, part = hidden.normal[window], hidden.color[window], hidden.part[window]
    same = (part == part[i]) & (color == color[i]) & (normal @ normal[i] > _ONE_SURFACE)
    beside = same & (shown.part[window] == part) & ~binary_dilation(its[window], iterations=_RIM_PX)
    beside &= distance_transform_edt(~piece) <= _BESIDE_PX + 2 * _RIM_PX
    if part[i] < 0 or beside.sum() < _LEAST_PX:
        return np.nan, np.nan
    own = piece & (distance_transform_edt(~beside) <= _BESIDE_PX + 2 * _RIM_PX)
    if own.sum() < _LEAST_PX:
        return np.nan, np.nan
    level, uneven = _level(gray[beside])
    tone, uneven_too = _level(gray[own])
    noise2 = 2 * noise_of(photo.gray) ** 2
    return tone - level, float(np.sqrt(_UNEVEN**2 + max(uneven**2 + uneven_too**2 - noise2, 0.0)))


def _level(gray: Array) -> tuple[float, float]:
    """Return the median of brightnesses and their robust standard deviation."""
    level = float(np.median(gray))
    return level, 1.4826 * float(np.median(np.abs(gray - level)))


def _pairs(one: Longs, other: Longs) -> Longs:
    """Return the number (n,) of each pair of two numbers (n,), 0 ... ."""
    numbers, at = np.unique(other, return_inverse=True)
    return np.asarray(np.unique(one * len(numbers) + at, return_inverse=True)[1], np.int64)


def _lapsing(as_told: float, other: float) -> float:
    """Return the log density where the light is as it was fitted, but for a lapse."""
    return float(np.logaddexp(np.log1p(-_LAPSE) + as_told, np.log(_LAPSE) + other))


def _log_normal(r: Array, V: Array) -> float:
    if not len(r):
        return 0.0
    return float(-0.5 * (r @ np.linalg.solve(V, r) + np.linalg.slogdet(2 * np.pi * V)[1]))
