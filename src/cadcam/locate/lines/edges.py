"""Samples of a part's visible edges: fixed on the part, and projected again for each step of the pose.

A line is cut at its corners into runs, each run into cells of equal length, with one sample per cell. What else lies
near a sample (other lines, its own run beyond a bend) limits how far along the normal the pixels are its own.

The contour of a faceted surface is a polygon, and zigzags a little. It is taken as the smooth line that it stands for:
directions are those of chords as long as a cell, only what turns by much more than from facet to facet is a corner, and
runs continue where a facet of the surface itself hides a pixel or two of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.edges import EdgeKind
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Ideal
from cadcam.geometry.rigid import Rigid
from cadcam.native.profiles import along_runs, camera_rows, clearance, edge_rows
from cadcam.render.lines.wireframe import Polylines

_CORNER = np.cos(np.radians(8.0))  # where a line turns by more, a new run begins
_ROUND = np.cos(np.radians(30.0))  # the same where a contour turns, from one chord to the next
_MOST_TURN, _CIRCLE = np.radians(30.0), np.radians(120.0)  # turns between sides of a coarse circle, and of all of them
_GAP_PX = 3.0  # largest gap in a contour that a run bridges
_ARC = np.radians(30.0)  # turn of the arcs that a contour is judged by
_AROUND = 3  # samples to each side over which normals are averaged, to tell how far a contour turns
_OWN_RUN = 4.0  # reaches along a run within which a sample does not take the run itself for another line


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSamples:
    """N samples: p (N, 3) mm and unit tangent (N, 3) in the part frame, chain (N,; -1 on contours) and run (N,).

    arc (N,): the run or, of a contour, the part of it that turns by some 30 degrees; a contour's normals point away
    from its surface. part, line (N,): body and number of the polyline that they lie on; below, above (N,) px: distance
    against and along the normal that is free of other lines. twins (N, 2, 2): the lines there, below and above, that
    run about parallel through the whole cell: (d, slope), px from the sample and px per px along the line; infinite
    where there is none. beyond (N, 2) px: distance free of any further line. bulge (N,) mm: how far the contour of the
    surface that facets stand for may lie along the normal; 0 on edges.
    """

    p: Array
    tangent: Array
    chain: Ids
    run: Ids
    arc: Ids
    part: Ids
    line: Ids
    below: Array
    above: Array
    twins: Array
    beyond: Array
    bulge: Array

    def __len__(self) -> int:
        return len(self.p)

    def select(self, which: Mask | Longs | slice) -> EdgeSamples:
        """Return the chosen samples."""
        chosen = np.arange(len(self))[which]
        return EdgeSamples(*(getattr(self, name).take(chosen, axis=0) for name in self.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """Samples as a camera images them: q (N, 2) px, unit normal (N, 2), and row (N, 6).

    row: d(offset along the normal)/dxi by the pose's twist: how the model's line moves across itself.
    """

    q: Array
    normal: Array
    row: Array

    @property
    def imaged(self) -> Mask:
        """Return which samples (N,) the camera images."""
        return np.isfinite(self.q[:, 0] + self.q[:, 1])


def project(samples: EdgeSamples, camera: Camera, camera_from_part: Rigid) -> Projected:
    """Return the samples in the photo; nan where the camera does not image them.

    xi is the twist of `camera_from_part @ Rigid.exp(xi)`: dp = v + w x p in the part frame, so dq/dxi = D [I, -hat(p)]
    with D = dq/dp.
    """
    R, t = camera_from_part.rotation, camera_from_part.translation
    lens = camera.lens
    if isinstance(lens, Ideal):
        return Projected(*camera_rows(camera.K, R, t, samples.p, samples.tangent))
    if type(lens) is BrownConrady:  # tilted ones are its subclasses
        told = np.array(list(lens.parameters.values()))
        return Projected(*camera_rows(camera.K, R, t, samples.p, samples.tangent, lens=told, radius=lens.valid_radius))
    q, J = camera.project_with_jacobian(camera_from_part @ samples.p)
    return Projected(q, *edge_rows(J, R, samples.p, samples.tangent))


def sample_lines(
    lines: Polylines, camera: Camera, *, step_px: float, reach_px: float, bulges: Array | None = None
) -> EdgeSamples:
    """Return samples `step_px` apart on lines drawn with the part's own frame as the world.

    reach_px: how far along the normal other lines are searched for. bulges (P,) mm: how far each body's contours may
    lie beyond its facets, default not at all.
    """
    paths = _Paths.of(lines)
    run = _runs(paths, step_px)
    arc0 = _along(paths.length, run)
    segment, fraction, arc = _cells(paths.length, run, arc0, step_px)
    a, b, pa, pb = (of.take(segment, axis=0) for of in (paths.a, paths.b, paths.pa, paths.pb))
    along, tangent = b - a, pb - pa
    at, p = a + fraction[:, None] * along, pa + fraction[:, None] * tangent
    some = np.flatnonzero(paths.contour[segment])
    if len(some):
        along[some], tangent[some] = paths.chords(segment[some], fraction[some], run, step_px)
    along /= np.maximum(np.hypot(*along.T), 1e-300)[:, None]
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    line, contour = paths.line[segment], paths.contour[segment]
    beside = clearance(
        at,
        normal,
        run[segment],
        arc,
        np.concatenate([paths.a, paths.b], axis=1),
        run,
        np.stack([arc0, arc0 + paths.length], axis=1),
        half_length=0.5 * step_px + 1.0,
        near=_OWN_RUN * reach_px,
        most=reach_px,
    )
    chain = np.where(contour, -1, lines.chain[line]).astype(np.int32)
    of, part = run[segment], lines.part[line].astype(np.int32)
    bulge = np.zeros(len(of)) if bulges is None else np.where(contour, bulges[part], 0.0)
    samples = EdgeSamples(p, tangent, chain, of, _arcs(normal, of, contour), part, line, *beside, bulge)
    inside = camera.sees(at)
    return samples if inside.all() else samples.select(inside)


def pieces_of(run: Ids, most: float) -> Longs:
    """Return ascending numbers (n,) of the pieces of line that samples lie on, not without gaps.

    Every run, whose samples follow each other, is divided evenly into pieces of about `most` samples.
    """
    run = run.astype(np.int64)
    count = np.bincount(run)
    place = np.arange(len(run)) - (np.cumsum(count) - count)[run]
    of_run = np.maximum(np.round(count / most), 1).astype(np.int64)[run]
    return np.asarray(run * len(run) + place * of_run // count[run])


def numbered(of: Longs) -> Longs:
    """Return ascending numbers (n,) renumbered from 0 without gaps."""
    return np.cumsum(np.diff(of, prepend=of[:1]) > 0, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class _Paths:
    """The M segments of polylines that have a length: from a to b (M, 2) px, and from pa to pb (M, 3) mm.

    length (M,) px; line (M,): number of the polyline; contour (M,): whether that is one; joined (M,): whether a segment
    continues the one before, maybe beyond a gap in a contour.
    """

    a: Array
    b: Array
    pa: Array
    pb: Array
    length: Array
    line: Ids
    contour: Mask
    joined: Mask

    @classmethod
    def of(cls, lines: Polylines) -> _Paths:
        """Return the segments of polylines."""
        of = lines.line_of_point
        first = np.flatnonzero(of[1:] == of[:-1])
        length = np.hypot(*(lines.q[first + 1] - lines.q[first]).T)
        first, length = first[length > 1e-6], length[length > 1e-6]
        a, b, line = lines.q[first], lines.q[first + 1], of[first]
        contour, chain = lines.kind[line] == EdgeKind.CONTOUR, lines.chain[line]
        bridged = contour[1:] & (chain[1:] == chain[:-1]) & (np.hypot(*(a[1:] - b[:-1]).T) < _GAP_PX)
        joined = np.append(False, (line[1:] == line[:-1]) | bridged)[: len(first)]
        return cls(a, b, lines.p[first], lines.p[first + 1], length, line.astype(np.int32), contour, joined)

    def at(self, segment: Longs, fraction: Array) -> tuple[Array, Array]:
        """Return places at fractions (n,) of segments (n,): px (n, 2) and mm (n, 3)."""
        ends = ((self.a, self.b), (self.pa, self.pb))
        q, p = (a[segment] + fraction[:, None] * (b[segment] - a[segment]) for a, b in ends)
        return q, p

    def chords(self, segment: Longs, fraction: Array, path: Ids, reach_px: float) -> tuple[Array, Array]:
        """Return the chords, in px (n, 2) and in mm (n, 3), from `reach_px` before to as far behind places.

        These are at fractions (n,) of segments (n,); chords end where the path does, numbered (M,) for the segments.
        """
        before, after = (self.at(*self._moved(segment, fraction, path, way)) for way in (-reach_px, reach_px))
        return after[0] - before[0], after[1] - before[1]

    def _moved(self, segment: Longs, fraction: Array, path: Ids, by_px: float) -> tuple[Longs, Array]:
        """Return segments and fractions so far along their paths from others, or at the paths' ends."""
        begin = np.cumsum(self.length) - self.length
        first, last = (np.searchsorted(path, path[segment], side) for side in ("left", "right"))
        end = begin[last - 1] + self.length[last - 1]
        arc = np.clip(begin[segment] + fraction * self.length[segment] + by_px, begin[first], end)
        to = np.clip(np.searchsorted(begin, arc, side="right") - 1, first, last - 1)
        return to, np.clip((arc - begin[to]) / self.length[to], 0.0, 1.0)


def _runs(paths: _Paths, reach_px: float) -> Ids:
    """Return the run (M,), counted from 0, that each segment belongs to.

    A corner of a contour is found between chords `reach_px` long, before and behind it. The sides of a coarse circle
    are too short to be looked at one by one: it is one line, as finer ones are.
    """
    d = (paths.b - paths.a) / paths.length[:, None]
    straight = np.append(False, np.einsum("ij,ij->i", d[1:], d[:-1]) >= _CORNER)[: len(d)]
    straight |= _coarse(d, paths.length, paths.joined, reach_px)
    some = np.flatnonzero(paths.joined & paths.contour)
    if len(some):
        path = (np.cumsum(~paths.joined) - 1).astype(np.int32)
        here, zero = paths.a[some], np.zeros(len(some))
        before, after = (paths.at(*paths._moved(some, zero, path, way))[0] for way in (-reach_px, reach_px))
        to, on = here - before, after - here
        long = np.hypot(*to.T) * np.hypot(*on.T)
        straight[some] = (to * on).sum(axis=1) >= _ROUND * long
    return (np.cumsum(~(paths.joined & straight)) - 1).astype(np.int32)


def _coarse(d: Array, length: Array, joined: Mask, reach_px: float) -> Mask:
    """Return which of M segments, of directions d (M, 2), continue a coarse circle, or a third of one, of short sides.

    What turns by less in all, as a fillet does, or by more within a reach, as a small circle does, is left cut at its
    corners: a few steps measured on a bend would tell of a displacement along it.
    """
    turn = np.append(0.0, np.arctan2(_cross(d[:-1], d[1:]), _dot(d[:-1], d[1:])))[: len(d)]
    one, other = (np.append(0.0, its)[: len(d)] / reach_px for its in (length[:-1], length[1:]))
    on = joined & (np.maximum(one, other) < 2) & (np.abs(turn) <= _MOST_TURN * np.minimum(0.5 * (one + other), 1.0))
    row = np.cumsum(~on)
    return np.asarray(on & (np.abs(np.bincount(row, turn * on))[row] > _CIRCLE))


def _arcs(normal: Array, run: Ids, contour: Mask) -> Ids:
    """Return the arc (n,) of each sample: its run or, on a contour, a part of that which turns by some `_ARC`."""
    if not contour.any():
        return run
    turn = np.zeros(len(run))
    smooth = along_runs(normal, run, _AROUND)
    d = np.arctan2(*(f(smooth[:-1], smooth[1:]) for f in (_cross, _dot)))
    turn[1:] = np.where((run[1:] == run[:-1]) & contour[1:], np.abs(d), 0.0)
    turned = np.cumsum(turn)
    first, last = np.searchsorted(run, run), np.searchsorted(run, run, side="right") - 1
    whole = turned[last] - turned[first]
    arcs = np.maximum(np.round(whole / _ARC), 1)
    place = np.minimum((turned - turned[first]) / np.maximum(whole, 1e-9) * arcs, arcs - 1).astype(np.int64)
    begins = (np.diff(run, prepend=-1) > 0) | (np.diff(place, prepend=0) > 0)
    return (np.cumsum(begins) - 1).astype(np.int32)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=1))


def _along(length: Array, run: Ids) -> Array:
    """Return how far along its run each segment begins."""
    before = np.cumsum(length) - length
    return before - np.repeat(before[np.diff(run, prepend=-1) > 0], np.bincount(run)) if len(run) else before


def _cells(length: Array, run: Ids, arc0: Array, step_px: float) -> tuple[Longs, Array, Array]:
    """Return segment, fraction of it and arc length of the middle of each cell; runs shorter than a cell have none."""
    if not len(run):
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    of_run = np.bincount(run, length)
    n = np.floor(of_run / step_px).astype(np.int64)
    which = np.repeat(np.arange(len(n)), n)
    place = np.arange(len(which)) - np.repeat(np.cumsum(n) - n, n)
    arc = (place + 0.5) * step_px + 0.5 * (of_run - n * step_px)[which]
    begin = np.cumsum(of_run) - of_run  # all runs in a row: a single sorted axis
    segment = np.searchsorted(begin[run] + arc0, begin[which] + arc, side="right") - 1
    fraction = np.clip((arc - arc0[segment]) / length[segment], 0.0, 1.0)
    return segment, fraction, arc
