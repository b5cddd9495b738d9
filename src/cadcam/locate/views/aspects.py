"""The aspects of a part: which of its edges it shows, from every side.

The thesis (section 3.4.1.1) weighs aspect graphs, whose nodes are topologically equal views, and asks for "recoverable
aspects" instead. Here an aspect is one direction of view out of an even net over the sphere, with the edges that are
visible from there, sampled in space. It is computed exactly (hidden lines removed in object space) when first asked for
and kept: a photo near a known pose needs a few of them, a search over the sphere all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.native.fields import PLACE
from cadcam.render.lines.wireframe import LineOptions, Polylines

if TYPE_CHECKING:
    from cadcam.render.lines.visible import LineDrawer

PLACES = 320  # samples of an aspect
DIRECTIONS = 400
_GOLDEN = 0.6180339887498949
_SIZE, _FILLED = 1000, 0.9  # px of the picture in which lines are drawn, and the share of it that the part takes
# Distances in radii at which aspects are made, a geometric series: from farther than the last a part shows the same.
_NEAREST, _FARTHEST, _STEP = 1.3, 5.2, 2.0
_CELLS = 32  # along a side of the cube that finds the nearest direction
_SHORTEST = 0.004  # of the part's size: visible stretches below it are not worth a sample


@dataclass(frozen=True, slots=True, eq=False)
class Aspect:
    """What a part shows to an eye: samples of its visible edges, in an order whose beginnings are spread as the whole.

    direction (3,) unit, from the part's middle to the eye, and distance (mm) in the part frame. places (N,) structured
    (`native.fields.PLACE`): p (3,) mm and unit tangent (3,) in the part frame, weight. chain (N,) feature chain (edge),
    -1 on contours; line (N,) numbers from 0 the edges and contours on which places lie. length: of all visible edges in
    units of the part's diameter, as the eye sees them.
    """

    direction: Array
    distance: float
    places: npt.NDArray[np.void]
    chain: Ids
    line: Ids
    length: float

    def recoverable(self, n_chains: int) -> Array:
        """Return the share (n_chains,) of this aspect's visible length that each edge of the part has."""
        own = self.chain[self.chain >= 0]
        return np.bincount(own, minlength=n_chains) / max(len(self.chain), 1)


class Aspects:
    """The aspects of one part over an even net of directions, made when first asked for and kept.

    net (V, 3): unit directions from the part's middle to the eye, about 10 degrees apart.
    """

    def __init__(self, lines: LineDrawer) -> None:
        mesh = lines.scene.mesh
        low, high = mesh.bounds
        self.centre: Array = (low + high) / 2
        self.radius = float(np.linalg.norm(high - low) / 2)
        self.net = sphere_net(DIRECTIONS)
        self._lines = lines
        self._made: dict[tuple[int, int], Aspect] = {}

    @property
    def made(self) -> Mapping[tuple[int, int], Aspect]:
        """The aspects made so far, by numbers of direction and of distance."""
        return MappingProxyType(self._made)

    def take(self, made: Mapping[tuple[int, int], Aspect]) -> None:
        """Take aspects that were made of this part before."""
        self._made.update(made)

    def nearest(self, eyes: Array) -> tuple[Ids, Ids]:
        """Return the numbers (N,) of net direction and of distance that are nearest to eyes (N, 3) mm, part frame."""
        sight = eyes - self.centre
        return self._table[_cube_cell(sight)], self.step_of(np.sqrt(np.einsum("ij,ij->i", sight, sight)))

    @cached_property
    def _table(self) -> Ids:
        """The net direction nearest to the middle of each cell of the cube: off by less than one cell, 3 degrees."""
        return np.asarray(np.argmax(_cube_middles() @ self.net.T, axis=1), np.int32)

    def step_of(self, distance: Array) -> Ids:
        """Return the numbers (N,) of the distances that are nearest to distances (N,) mm."""
        ratio = np.clip(distance / self.radius, _NEAREST, _FARTHEST)
        return np.rint(np.log(ratio / _NEAREST) / math.log(_STEP)).astype(np.int32)

    def aspect(self, direction: int, step: int) -> Aspect:
        """Return the aspect of a number of direction and of distance."""
        key = (int(direction), int(step))
        if key not in self._made:
            self._made[key] = self._drawn(*key)
        return self._made[key]

    def _drawn(self, direction: int, step: int) -> Aspect:
        distance = self.radius * _NEAREST * _STEP**step
        towards = self.net[direction]
        eye = self.centre + distance * towards
        focal = _FILLED * _SIZE / 2 * math.sqrt(distance**2 - self.radius**2) / self.radius
        up = np.eye(3)[np.argmin(np.abs(towards))]
        pose = Rigid.look_at(eye, self.centre, up=up)
        camera = Camera.from_focal((_SIZE, _SIZE), focal)
        visible = self._lines.draw(camera, pose, options=LineOptions(chord_px=1.0)).visible
        places, chain, line, length = _sampled(visible, pose)
        return Aspect(towards, distance, places, chain, line, length / (_FILLED * _SIZE))


def sphere_net(n: int) -> Array:
    """Return n unit vectors (n, 3) spread evenly: a Fibonacci spiral (A. Gonzalez, Math. Geosciences 42, 2010)."""
    k = np.arange(n) + 0.5
    z, turn = 1 - 2 * k / n, 2 * math.pi * _GOLDEN * k
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def _cube_cell(sight: Array) -> npt.NDArray[np.int64]:
    """Return in which cell of a cube's sides, each _CELLS x _CELLS, directions (N, 3) fall."""
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
    """Return the direction (6 * _CELLS ** 2, 3) of the middle of each cell, in the order of `_cube_cell`."""
    middle = (np.arange(_CELLS) + 0.5) / _CELLS * 2 - 1
    u, v = (a.ravel() for a in np.meshgrid(middle, middle, indexing="ij"))
    sides = []
    for major in range(3):
        for sign in (1.0, -1.0):
            side = np.zeros((len(u), 3))
            side[:, major], side[:, (major + 1) % 3], side[:, (major + 2) % 3] = sign, u, v
            sides.append(side / np.linalg.norm(side, axis=1, keepdims=True))
    return np.concatenate(sides)


def _sampled(lines: Polylines, pose: Rigid) -> tuple[npt.NDArray[np.void], Ids, Ids, float]:
    """Return PLACES places, their chains and lines, and the length of all lines (px): evenly spaced in the picture."""
    line = lines.line_of_point
    first = np.flatnonzero(line[1:] == line[:-1])
    q, p = lines.q, lines.p
    length = np.linalg.norm(q[first + 1] - q[first], axis=1)
    of_line = np.bincount(line[first], length, minlength=len(lines))
    kept = of_line[line[first]] > _SHORTEST * _SIZE
    first, length = first[kept], length[kept]
    total = float(length.sum())
    if not total > 0:
        return np.zeros(0, PLACE), np.zeros(0, np.int32), np.zeros(0, np.int32), 0.0
    ends = np.cumsum(length)
    rank = np.argsort(np.argsort(np.modf(np.arange(PLACES) * _GOLDEN)[0]))  # any first n of them are spread evenly
    along = (rank + 0.5) / PLACES * total
    k = np.minimum(np.searchsorted(ends, along, side="right"), len(ends) - 1)
    share = np.clip(1 - (ends[k] - along) / length[k], 0, 1)
    a, b = p[first[k]], p[first[k] + 1]
    za, zb = (pose @ a)[:, 2], (pose @ b)[:, 2]
    t = share * za / (share * za + (1 - share) * zb)
    places = np.zeros(PLACES, PLACE)
    places["p"] = a + t[:, None] * (b - a)
    places["tangent"] = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1), 1e-300)[:, None]
    places["weight"] = 1.0
    on = line[first[k]]
    chain = np.where(lines.segment[first[k]] >= 0, lines.chain[on], -1).astype(np.int32)
    _, number = np.unique(lines.chain[on], return_inverse=True)
    return places, chain, number.ravel().astype(np.int32), total
