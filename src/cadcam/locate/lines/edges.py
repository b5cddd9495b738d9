"""Samples of a part's visible edges: fixed on the part, and projected again for each step of the pose.

A line is cut at its corners into runs, each run into cells of equal length, with one sample per cell. What else lies
near a sample (other lines, its own run beyond a bend) limits how far along the normal the pixels are its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.edges import EdgeKind
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Ideal
from cadcam.geometry.rigid import Rigid
from cadcam.native.profiles import camera_rows, clearance, edge_rows
from cadcam.render.lines.wireframe import Polylines

_CORNER = np.cos(np.radians(8.0))  # where a line turns by more, a new run begins
_OWN_RUN = 4.0  # reaches along a run within which a sample does not take the run itself for another line


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSamples:
    """N samples: p (N, 3) mm and unit tangent (N, 3) in the part frame, chain (N,; -1 on contours) and run (N,).

    part, line (N,): body and number of the polyline that they lie on; below, above (N,) px: distance against and along
    the normal that is free of other lines. twins (N, 2, 2): the lines there, below and above, that run about parallel
    through the whole cell: (d, slope), px from the sample and px per px along the line; infinite where there is none.
    beyond (N, 2) px: distance free of any further line.
    """

    p: Array
    tangent: Array
    chain: Ids
    run: Ids
    part: Ids
    line: Ids
    below: Array
    above: Array
    twins: Array
    beyond: Array

    def __len__(self) -> int:
        return len(self.p)

    def select(self, which: Mask | Longs | slice) -> EdgeSamples:
        """Return the chosen samples."""
        return EdgeSamples(*(getattr(self, name)[which] for name in self.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """Samples as a camera images them: q (N, 2) px, unit normal (N, 2), and row (N, 6).

    row: d(offset along the normal)/dxi by the pose's twist: how the model's line moves across itself.
    """

    q: Array
    normal: Array
    row: Array


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


def sample_lines(lines: Polylines, camera: Camera, *, step_px: float, reach_px: float) -> EdgeSamples:
    """Return samples `step_px` apart on lines drawn with the part's own frame as the world.

    reach_px: how far along the normal other lines are searched for.
    """
    first, run = _runs(lines)
    q, p = lines.q, lines.p
    a, b = q[first], q[first + 1]
    length = np.hypot(*(b - a).T)
    arc0 = _along(length, run)
    segment, fraction, arc = _cells(length, run, arc0, step_px)
    pa, pb = p[first[segment]], p[first[segment] + 1]
    tangent = pb - pa
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    at = q[first[segment]] + fraction[:, None] * (b - a)[segment]
    along = (b - a)[segment] / np.maximum(length[segment], 1e-300)[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    line = lines.line_of_point[first[segment]].astype(np.int32)
    chain = np.where(lines.kind[line] == EdgeKind.CONTOUR, -1, lines.chain[line]).astype(np.int32)
    beside = clearance(
        at,
        normal,
        run[segment],
        arc,
        np.concatenate([a, b], axis=1),
        run,
        np.stack([arc0, arc0 + length], axis=1),
        half_length=0.5 * step_px + 1.0,
        near=_OWN_RUN * reach_px,
        most=reach_px,
    )
    part = lines.part[line].astype(np.int32)
    samples = EdgeSamples(pa + fraction[:, None] * (pb - pa), tangent, chain, run[segment], part, line, *beside)
    inside = camera.sees(at)
    return samples if inside.all() else samples.select(inside)


def _runs(lines: Polylines) -> tuple[Longs, Ids]:
    """Return the first point of each segment that has a length, and the run it belongs to, counted from 0."""
    of = lines.line_of_point
    first = np.flatnonzero(of[1:] == of[:-1])
    d = lines.q[first + 1] - lines.q[first]
    length = np.hypot(d[:, 0], d[:, 1])
    long = length > 1e-6
    first, d = first[long], d[long] / length[long, None]
    turns = np.einsum("ij,ij->i", d[1:], d[:-1]) < _CORNER
    begins = np.concatenate([[True], turns | (of[first[1:]] != of[first[:-1]])])
    return first, (np.cumsum(begins[: len(first)]) - 1).astype(np.int32)


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
