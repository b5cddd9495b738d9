"""The visible edges of a part from many viewpoints, quickly: samples spread evenly over small rendered pictures.

A search needs edges only to a few thousandths of the part's size, but from hundreds of viewpoints. So small pictures
are rendered, their depth buffer decides which edges are hidden (`render.lines.seen`), and samples are chosen for many
pictures at once. What lies a pixel or two behind an outline, as the far edge of a thin plate, may count as visible.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from cadcam.arrays import Array, Ids, Longs
from cadcam.cad.chains import chain_of_each
from cadcam.cad.topology import corner_points
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.views.pieces import Pieces, ShownEdges, leads_on
from cadcam.native.seen import SeenLines
from cadcam.render.lines.seen import SeenEdges, drawable_edges
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Scene

SIZE, FILLED = 400, 0.9  # picture size, px, and the share of it that the part fills: the scale `approach` works at
_BATCH = 16  # pictures for which samples are chosen at once
_SHORTEST = 0.004  # of the picture size: lines with a shorter visible length get no sample
_BEND_PX = 0.1  # tolerance to which a polyline may be simplified


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
        at: list[Rigid] = []
        for view in self._renderer.render_batch(camera, poses, channels=Channel.DEPTH | Channel.NORMAL):
            seen.append(self._seen.stretches(view, shortest_px=0.0, bend_px=_BEND_PX))
            at.append(view.camera_from_world)
            if len(seen) == _BATCH:
                yield from self._chosen(seen, at)
                seen, at = [], []
        if seen:
            yield from self._chosen(seen, at)

    def _pose(self, towards: Array, distance: float) -> Rigid:
        up = np.eye(3)[np.argmin(np.abs(towards))]
        return Rigid.look_at(self._centre + distance * towards, self._centre, up=up)

    def _chosen(self, seen: Sequence[SeenLines], at: Sequence[Rigid]) -> Iterator[ShownEdges]:
        """Yield the sampled lines of some pictures, taken at these poses (camera_from_part)."""
        q, p = (np.concatenate([getattr(one, name) for one in seen]) for name in ("q", "p"))
        leads = np.concatenate([leads_on(one.start, len(one.q)) for one in seen])
        picture = np.repeat(np.arange(len(seen)), [len(one.q) for one in seen])[leads]
        line = self._numbers(picture, np.concatenate([one.edge for one in seen])[leads])
        pieces = Pieces.between(q, p, np.flatnonzero(leads), line)
        n = int(line.max(initial=0)) + 1
        key = picture * n + line
        kept = np.flatnonzero(np.bincount(key, pieces.length, len(seen) * n)[key] > _SHORTEST * SIZE)
        kept = kept[np.argsort(key[kept], kind="stable")]
        pieces, first = pieces.select(kept), np.searchsorted(picture[kept], np.arange(len(seen) + 1))
        for k, pose in enumerate(at):
            yield pieces.select(slice(first[k], first[k + 1])).shown(pose, self._centre, self._radius)

    def _numbers(self, picture: Longs, edge: Ids) -> Longs:
        """Return the number (N,) of the line that each piece is on: its chain or, after all chains, its contour.

        picture, edge (N,): of each piece.
        """
        line = self._segments.chain[edge].astype(np.int64)
        contour = np.flatnonzero(edge >= self._features)
        if len(contour):
            key = picture[contour] * len(self._segments.edge) + edge[contour]
            every, which = np.unique(key, return_inverse=True)
            at, number = np.divmod(every, len(self._segments.edge))
            ends = self._segments.vertices[number]
            group = at * self._parts + self._segments.part[number]
            line[contour] = self._contours + chain_of_each(self._vertices[ends], self._points[ends], group)[which]
        return line
