"""From stretches of lines to polylines: joined along chains, bent as by the lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.render.lines.clip import FlatSegments
from cadcam.render.lines.segments import Segments
from cadcam.render.lines.stretches import Stretches
from cadcam.render.lines.wireframe import Polylines
from cadcam.render.view import Scene

_MOST_PIECES = 1024
_ALONG = np.array([0.0, 0.25, 0.5, 0.75, 1.0])  # samples of a run that measure the bending of its image


@dataclass(frozen=True, slots=True, eq=False)
class Tracer:
    """Makes polylines in the picture and in space from stretches of `lines`, the images of `segments`."""

    scene: Scene
    camera: Camera
    segments: Segments
    source: Longs  # index of each line among all segments, before culling
    lines: FlatSegments
    chord_px: float

    def polylines(self, runs: Stretches) -> Polylines:
        """Return the runs, consecutive ones joined, no farther than `chord_px` from the lens' true curve."""
        joined = self._joined(runs)
        pieces = self._pieces(runs)
        points = pieces + ~joined  # a joined run shares its first point with the last of the one before
        run = np.repeat(np.arange(len(points)), points)
        step = np.arange(len(run)) - np.repeat(np.cumsum(points) - points, points) + joined[run]
        s = runs.s0[run] + (runs.s1 - runs.s0)[run] * (step / pieces[run])
        line = runs.line[run]
        begins = np.flatnonzero(~joined)
        return Polylines(
            q=self._pixels(line, s),
            p=self._space(line, s),
            segment=self._leading(run, runs.line, joined),
            start=np.append((np.cumsum(points) - points)[begins], len(run)).astype(np.int32),
            kind=self.segments.kind[runs.line[begins]],
            part=self.segments.part[runs.line[begins]],
            chain=self.segments.chain[runs.line[begins]],
        )

    def _joined(self, runs: Stretches) -> Mask:
        """Return which runs continue the one before."""
        before, after = runs.line[:-1], runs.line[1:]
        chain = self.segments.chain
        joined = (self.source[after] == self.source[before] + 1) & (chain[after] == chain[before])
        joined &= (runs.s1[:-1] == 1) & (self.lines.t1[before] == 1)
        joined &= (runs.s0[1:] == 0) & (self.lines.t0[after] == 0)
        return np.append(False, joined)[: len(runs.line)]

    def _leading(self, run: Longs, line: Longs, joined: Mask) -> Ids:
        """Return the feature segment that leads away from each point."""
        own = self.segments.feature[line]
        at_end = np.append(run[1:] != run[:-1], True)
        goes_on = np.append(joined[1:], False)
        following = np.append(own[1:], -1)
        return np.where(at_end & goes_on[run], following[run], own[run]).astype(np.int32)

    def _pieces(self, runs: Stretches) -> Longs:
        """Return the number of chords of each run: the error of a chord decreases with the square of their number."""
        if isinstance(self.camera.lens, Ideal) or not len(runs.line):
            return np.ones(len(runs.line), np.int64)
        s = runs.s0 + _ALONG[:, None] * (runs.s1 - runs.s0)
        q = self._pixels(np.tile(runs.line, len(s)), s.ravel()).reshape(*s.shape, 2)
        chord, d = q[-1] - q[0], q[1:-1] - q[0]
        length = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-9)
        off = np.abs(d[..., 0] * chord[:, 1] - d[..., 1] * chord[:, 0]).max(axis=0) / length
        return np.asarray(np.clip(np.ceil(1.2 * np.sqrt(off / self.chord_px)), 1, _MOST_PIECES), np.int64)

    def _pixels(self, line: Longs, s: Array) -> Array:
        a, b = self.lines.a[line], self.lines.b[line]
        u = a + s[:, None] * (b - a)
        return self.camera.project(np.column_stack([u, np.ones(len(u))]))

    def _space(self, line: Longs, s: Array) -> Array:
        a, b = (self.scene.mesh.vertices[self.segments.vertices[line, k]] for k in range(2))
        return np.asarray(a + self.lines.in_space(line, s)[:, None] * (b - a))
