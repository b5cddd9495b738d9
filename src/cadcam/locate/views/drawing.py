"""The visible edges of a part from many viewpoints, quickly: samples spread evenly over small rendered pictures.

A search needs edges only to a few thousandths of the part's size, but from hundreds of viewpoints. So small pictures
are rendered, their depth buffer decides which edges are hidden (`render.lines.seen`), and samples are chosen for many
pictures at once. What lies a pixel or two behind an outline, as the far edge of a thin plate, may count as visible.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Longs
from cadcam.cad.chains import chain_of_each
from cadcam.cad.topology import corner_points
from cadcam.camera.camera import Camera
from cadcam.fit.optimal_design import design
from cadcam.geometry.rigid import Rigid
from cadcam.native.fields import PLACE
from cadcam.native.seen import SeenLines
from cadcam.render.lines.seen import SeenEdges, drawable_edges
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Scene

PLACES = 320  # samples of the visible edges of one view
SIZE, FILLED = 400, 0.9  # picture size, px, and the share of it that the part fills: the scale `approach` works at
_BATCH = 16  # pictures for which samples are chosen at once
_SHORTEST = 0.004  # of the picture size: lines with a shorter visible length get no sample
_BEND_PX = 0.1  # tolerance to which a polyline may be simplified
GOLDEN = (math.sqrt(5) - 1) / 2  # the fractional parts of its first n multiples are spread evenly, whatever n is
_RANK = np.argsort(np.argsort(np.modf(np.arange(PLACES) * GOLDEN)[0]))  # any first n are spread evenly


class ShownEdges(NamedTuple):
    """The edges visible in one view: places, line, telling (N,) as in `Aspect`, and the total length in px."""

    places: npt.NDArray[np.void]
    line: Ids
    telling: npt.NDArray[np.void]
    length: float


class Drawer:
    """Draws views of a part inside a ball; what does not depend on the viewpoint is computed once."""

    def __init__(self, scene: Scene, centre: Array, radius: float) -> None:
        mesh, every = scene.mesh, drawable_edges(scene)
        self._centre, self._radius = centre, radius
        self._renderer = RasterRenderer(scene, backs=False, solid=every.solid)
        self._seen = SeenEdges(scene, every)
        self._segments, self._features = every.segments, len(scene.edges)
        self._contours = int(scene.edges.chain.max(initial=-1)) + 1  # line numbers from here on are contours
        self._vertices, self._parts = mesh.vertices, len(mesh.part_names)
        self._points = np.zeros(len(mesh.vertices), np.int64)
        self._points[mesh.faces.ravel()] = corner_points(mesh).ravel()

    def draw(self, directions: Array, distance: float) -> Iterator[ShownEdges]:
        """Yield the views from unit directions (N, 3) seen from the ball's centre, all at one distance (mm) from it."""
        focal = FILLED * SIZE / 2 * math.sqrt(distance**2 - self._radius**2) / self._radius
        camera = Camera.from_focal((SIZE, SIZE), focal)
        poses = [self._pose(towards, distance) for towards in directions]
        seen: list[SeenLines] = []
        depths: list[Array] = []
        for view in self._renderer.render_batch(camera, poses, channels=Channel.DEPTH | Channel.NORMAL):
            seen.append(self._seen.stretches(view, shortest_px=0.0, bend_px=_BEND_PX))
            depths.append(view.camera_from_world.matrix[2])
            if len(seen) == _BATCH:
                yield from self._chosen(seen, np.stack(depths))
                seen, depths = [], []
        if seen:
            yield from self._chosen(seen, np.stack(depths))

    def _pose(self, towards: Array, distance: float) -> Rigid:
        up = np.eye(3)[np.argmin(np.abs(towards))]
        return Rigid.look_at(self._centre + distance * towards, self._centre, up=up)

    def _chosen(self, seen: Sequence[SeenLines], depth: Array) -> Iterator[ShownEdges]:
        """Yield the sampled lines of some pictures; depth (pictures, 4): the third row of each camera_from_part."""
        steps = _Steps.of(seen)
        line = self._numbers(steps)
        n = int(line.max(initial=0)) + 1
        of_line = np.bincount(steps.picture * n + line, steps.length, len(seen) * n)
        kept = np.flatnonzero(of_line[steps.picture * n + line] > _SHORTEST * SIZE)
        kept = kept[np.argsort((steps.picture * n + line)[kept], kind="stable")]
        steps, line = steps.select(kept), line[kept]
        first = np.searchsorted(steps.picture, np.arange(len(seen) + 1))
        for k, row in enumerate(depth):
            own = slice(first[k], first[k + 1])
            yield self._shown(steps.select(own), line[own], row)

    def _shown(self, steps: _Steps, line: Longs, depth: Array) -> ShownEdges:
        """Return samples of the lines of one picture; the pieces of a line must be consecutive."""
        if not len(line):
            none = np.zeros(0, PLACE)
            return ShownEdges(none, np.zeros(0, np.int32), none, 0.0)
        places, k = steps.sampled(steps.length, depth)
        telling, _ = steps.sampled(self._design(steps, depth), depth)
        numbers = np.unique(line[k], return_inverse=True)[1].ravel().astype(np.int32)
        return ShownEdges(places, numbers, telling, float(steps.length.sum()))

    def _design(self, steps: _Steps, depth: Array) -> Array:
        """Return the share (N,) of samples that each piece gets, by length and by what it tells of the pose.

        Nearly all of a long bar's lines run along it, and are the same wherever it is shifted to: only its ends, a
        fiftieth of them, tell where it is. depth (4,): as of `_shown`.
        """
        away = float(depth[:3] @ self._centre + depth[3])
        eye = self._centre - away * depth[:3]
        middle = (steps.a + steps.b) / 2
        normal = np.cross(steps.b - steps.a, middle - eye)  # of the plane that a piece is seen in
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) * np.linalg.norm(middle - eye, axis=1, keepdims=True)
        rows = np.concatenate([normal, np.cross((middle - self._centre) / self._radius, normal)], axis=1)
        return design(np.nan_to_num(rows), steps.length)

    def _numbers(self, steps: _Steps) -> Longs:
        """Return the number (N,) of the line that each piece is on: its chain or, after all chains, its contour."""
        line = self._segments.chain[steps.edge].astype(np.int64)
        contour = np.flatnonzero(steps.edge >= self._features)
        if len(contour):
            key = steps.picture[contour] * len(self._segments.edge) + steps.edge[contour]
            every, which = np.unique(key, return_inverse=True)
            picture, edge = np.divmod(every, len(self._segments.edge))
            ends = self._segments.vertices[edge]
            group = picture * self._parts + self._segments.part[edge]
            line[contour] = self._contours + chain_of_each(self._vertices[ends], self._points[ends], group)[which]
        return line


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """Straight pieces of the lines in pictures: picture and edge (N,), ends a, b (N, 3) mm, length (N,) px."""

    picture: Longs
    edge: Ids
    a: Array
    b: Array
    length: Array

    @classmethod
    def of(cls, seen: Sequence[SeenLines]) -> _Steps:
        """Return the pieces of all lines."""
        last = [np.zeros(len(one.q), bool) for one in seen]
        for mark, one in zip(last, seen, strict=True):
            mark[one.start[1:] - 1] = True
        first = np.flatnonzero(~np.concatenate(last))
        q, p = (np.concatenate([getattr(one, name) for one in seen]) for name in ("q", "p"))
        picture = np.repeat(np.arange(len(seen)), [len(one.q) for one in seen])
        edge = np.concatenate([one.edge for one in seen])
        d = q[first + 1] - q[first]
        return cls(picture[first], edge[first], p[first], p[first + 1], np.hypot(d[:, 0], d[:, 1]))

    def sampled(self, share: Array, depth: Array) -> tuple[npt.NDArray[np.void], Longs]:
        """Return samples (PLACES,) of one picture's pieces, each piece's in proportion to a share (N,), and the piece.

        depth (4,): third row of camera_from_part.
        """
        ends = np.concatenate([[0.0], np.cumsum(share)])
        along = (_RANK + 0.5) / PLACES * ends[-1]
        k = np.clip(np.searchsorted(ends, along, side="right") - 1, 0, len(share) - 1)
        part = np.clip((along - ends[k]) / share[k], 0, 1)
        a, b = self.a[k], self.b[k]
        za, zb = a @ depth[:3] + depth[3], b @ depth[:3] + depth[3]
        places = np.zeros(PLACES, PLACE)
        places["p"] = a + (part * za / (part * za + (1 - part) * zb))[:, None] * (b - a)
        places["tangent"] = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1), 1e-300)[:, None]
        places["weight"] = 1.0
        return places, k

    def select(self, which: Longs | slice) -> _Steps:
        """Return the chosen ones."""
        return _Steps(*(getattr(self, f.name)[which] for f in fields(self)))
