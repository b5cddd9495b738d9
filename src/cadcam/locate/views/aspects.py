"""The aspects of a part: which of its edges are visible from each direction.

The thesis (section 3.4.1.1) weighs aspect graphs, whose nodes are topologically equal views, and asks for "recoverable
aspects" instead. Here an aspect is one viewing direction of an even net over the sphere, with the edges visible from
there, sampled in space. It is computed on first use and kept: a photo near a known pose needs a few of them, a search
over the whole sphere needs all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.views.drawing import FILLED, SIZE, Drawer
from cadcam.locate.views.pieces import GOLDEN
from cadcam.render.view import Scene

DIRECTIONS = 400
# Distances, in radii of the part, at which aspects are made: a geometric series. Beyond the last one perspective hardly
# changes what is visible.
_NEAREST, _FARTHEST, _STEP = 1.3, 5.2, 2.0
_CELLS = 32  # along each edge of the cube map that looks up the nearest direction


@dataclass(frozen=True, slots=True, eq=False)
class Aspect:
    """Samples of the edges that are visible from one viewpoint, ordered so that any first n are spread as all are.

    direction (3,): unit vector from the part's centre to the eye, and distance (mm), in the part frame. places (N,),
    structured (`native.fields.PLACE`), spread evenly: p (3,) mm and unit tangent (3,) in the part frame, weight. line
    (N,): consecutive numbers, from 0, of the edges and contours that the samples lie on. telling (N,): as places, but
    most of them where they tell the pose best. length: of all visible edges as seen from there, in units of the part's
    diameter.
    """

    direction: Array
    distance: float
    places: npt.NDArray[np.void]
    line: Ids
    telling: npt.NDArray[np.void]
    length: float


class Views(Protocol):
    """What a part shows of itself: aspects, each numbered by two indices."""

    @property
    def centre(self) -> Array:
        """The middle (3,) of what shows, mm in the part frame."""

    @property
    def radius(self) -> float:
        """How far what shows extends from there, mm."""

    @property
    def made(self) -> Mapping[tuple[int, int], Aspect]:
        """The aspects computed so far."""

    def make(self, keys: Iterable[tuple[int, int]]) -> None:
        """Compute the aspects with these indices that are missing."""

    def nearest(self, eyes: Array, axes: Array, /) -> tuple[Ids, Ids]:
        """Return the indices (N,), (N,) of the aspects that cameras see.

        eyes (N, 3) mm, and their optical axes (N, 3), unit vectors, in the part frame.
        """

    def span(self, camera: Camera, camera_from_part: Rigid) -> tuple[Array, Array] | None:
        """Return the corners (px) of the bounding box of what a camera sees; None where that is behind it."""


class Aspects:
    """The aspects of one part over an even net of directions, computed on first use and kept.

    net (V, 3): unit directions from the part's centre to the eye, about 10 degrees apart.
    """

    def __init__(self, scene: Scene) -> None:
        low, high = scene.mesh.bounds
        self.centre: Array = (low + high) / 2
        self.radius: float = float(np.linalg.norm(high - low) / 2)
        self.net: Array = sphere_net(DIRECTIONS)
        self._scene = scene
        self._made: dict[tuple[int, int], Aspect] = {}

    @property
    def made(self) -> Mapping[tuple[int, int], Aspect]:
        """The aspects computed so far, by index of direction and index of distance."""
        return MappingProxyType(self._made)

    def take(self, made: Mapping[tuple[int, int], Aspect]) -> None:
        """Add aspects of this part that were computed earlier."""
        self._made.update(made)

    def hold(self, eye: Array) -> bool:
        """Return whether an eye (3,) mm in the part frame is nearer than all of them: in the part's ball, or beside."""
        return bool(np.linalg.norm(eye - self.centre) < _NEAREST * self.radius)

    def span(self, camera: Camera, camera_from_part: Rigid) -> tuple[Array, Array] | None:
        """Return the corners (px) of the bounding box of the part's ball in a picture; None where it is behind."""
        centre = camera_from_part @ self.centre
        if centre[2] < 0.2 * self.radius:
            return None
        offsets = self.radius * np.concatenate([np.eye(3)[:2], -np.eye(3)[:2]])
        q = camera.project(np.concatenate([[centre], centre + offsets]))
        q = q[np.isfinite(q).all(axis=1)]
        return (q.min(axis=0), q.max(axis=0)) if len(q) else None

    def nearest(self, eyes: Array, _axes: Array | None = None, /) -> tuple[Ids, Ids]:
        """Return the indices (N,) of the net direction and the distance nearest to eyes (N, 3) mm in the part frame."""
        sight = eyes - self.centre
        return self._table[_cube_cell(sight)], self.step_of(np.sqrt(np.einsum("ij,ij->i", sight, sight)))

    @cached_property
    def _table(self) -> Ids:
        """The net direction nearest to the centre of each cell of the cube map: wrong by less than a cell, 3 deg."""
        return np.asarray(np.argmax(_cube_middles() @ self.net.T, axis=1), np.int32)

    def step_of(self, distance: Array) -> Ids:
        """Return the indices (N,) of the tabulated distances that are nearest to distances (N,) mm."""
        ratio = np.clip(distance / self.radius, _NEAREST, _FARTHEST)
        return np.rint(np.log(ratio / _NEAREST) / math.log(_STEP)).astype(np.int32)

    def aspect(self, direction: int, step: int) -> Aspect:
        """Return the aspect with these indices of direction and distance."""
        key = (int(direction), int(step))
        if key not in self._made:
            self.make([key])
        return self._made[key]

    def make(self, keys: Iterable[tuple[int, int]], made: Callable[[], None] = lambda: None) -> None:
        """Compute the aspects of these (direction, distance) indices that are missing; call `made` after each.

        One call for many is faster than many calls.
        """
        todo = dict.fromkeys(key for key in keys if key not in self._made)
        for step in dict.fromkeys(step for _, step in todo):
            numbers = [direction for direction, its in todo if its == step]
            distance = self.radius * _NEAREST * _STEP**step
            for number, shown in zip(numbers, self._drawer.draw(self.net[numbers], distance), strict=True):
                length = shown.length / (FILLED * SIZE)
                self._made[number, step] = Aspect(self.net[number], distance, *shown[:3], length)
                made()

    @cached_property
    def _drawer(self) -> Drawer:
        return Drawer(self._scene, self.centre, self.radius)


def sphere_net(n: int) -> Array:
    """Return n unit vectors (n, 3) spread evenly: a Fibonacci spiral (A. Gonzalez, Math. Geosciences 42, 2010)."""
    k = np.arange(n) + 0.5
    z, turn = 1 - 2 * k / n, 2 * math.pi * GOLDEN * k
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def _cube_cell(sight: Array) -> npt.NDArray[np.int64]:
    """Return the index (N,) of the cube-map cell, of _CELLS x _CELLS a face, that each direction (N, 3) falls into."""
    size = np.abs(sight)
    major = np.argmax(size, axis=1)
    at = np.arange(len(sight))
    top = sight[at, major]
    scale = (0.5 * _CELLS) / np.maximum(np.abs(top), 1e-300)
    u, v = (
        np.minimum((sight[at, (major + k) % 3] * scale + 0.5 * _CELLS).astype(np.int64), _CELLS - 1) for k in (1, 2)
    )
    return np.asarray(((2 * major + (top < 0)) * _CELLS + u) * _CELLS + v)


def _cube_middles() -> Array:
    """Return the direction (6 * _CELLS**2, 3) of each cell's centre, indexed as by `_cube_cell`."""
    middle = (np.arange(_CELLS) + 0.5) / _CELLS * 2 - 1
    u, v = (a.ravel() for a in np.meshgrid(middle, middle, indexing="ij"))
    sides = []
    for major in range(3):
        for sign in (1.0, -1.0):
            side = np.zeros((len(u), 3))
            side[:, major], side[:, (major + 1) % 3], side[:, (major + 2) % 3] = sign, u, v
            sides.append(side / np.linalg.norm(side, axis=1, keepdims=True))
    return np.concatenate(sides)
