"""Lines of one body that run close beside each other: they move as one, and where they meet they are one edge.

The two borders of a narrow face of a body, seen nearly edge on, are twins. What belongs to the same body moves with a
line, so it takes no room from it: its step, at a known distance, is fitted too (`cadcam.image.profile`). Nearer than
their blur allows to tell apart, twins step as one: they are measured once, in their middle. That is off by more than
half their distance where the face between them is brighter, or darker, than what lies on both sides of it. A line where
a body stands on another is no twin: it may not follow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.cad.edges import EdgeKind
from cadcam.locate.edges import EdgeSamples, Projected
from cadcam.render.wireframe import Polylines

AS_ONE_PX = 1.5  # twins nearer than this step as one
_BESIDE_PX = 2.0  # around where a twin should be, in which its points are looked for
_POINTS = 12  # of lines looked at there


@dataclass(frozen=True, slots=True, eq=False)
class Twins:
    """What runs beside N samples.

    room (N,) px: distance to the next line that is not of the same body; twin (N, 2) px: where, along the normal, the
    twins before and after it are, infinite where there is none; middle (N,) px: where the step of a sample and its twin
    is, if they step as one; else 0. second (N,): whether such a step is counted with the twin already.
    """

    room: Array
    twin: Array
    middle: Array
    second: Mask

    @classmethod
    def of(cls, samples: EdgeSamples, at: Projected, wires: Polylines) -> Twins:
        """Return the twins of samples of lines `wires`, which are `at` these places."""
        n = len(samples)
        clear = np.stack([samples.below, samples.above], axis=1)
        own_twin = np.tile([-np.inf, np.inf], (n, 1))
        away, second = np.full(n, np.inf), np.zeros(n, bool)
        for side in range(2):
            twin = samples.twins[:, side, 0]
            line = _lines_at(at.q + np.where(np.isfinite(twin), twin, 0.0)[:, None] * at.normal, samples, wires)
            own = np.isfinite(twin) & (line >= 0) & _rigid(wires, samples.line, line)
            clear[own, side], own_twin[own, side] = samples.beyond[own, side], twin[own]
            nearer = own & (np.abs(twin) < np.abs(away))
            away[nearer], second[nearer] = twin[nearer], (line < samples.line)[nearer]
        as_one = np.abs(away) < AS_ONE_PX
        return cls(clear.min(axis=1), own_twin, np.where(as_one, away / 2, 0.0), second & as_one)

    def joined(self, samples: EdgeSamples) -> EdgeSamples:
        """Return the samples, those that step as one with a twin having none, but its room."""
        one = self.middle != 0
        twins = samples.twins.copy()
        twins[one, :, 0] = [-np.inf, np.inf]
        twins[one, :, 1] = 0.0
        below, above = (np.where(one, self.room, old) for old in (samples.below, samples.above))
        beyond = np.where(one[:, None], self.room[:, None], samples.beyond)
        return replace(samples, below=below, above=above, twins=twins, beyond=beyond)


def _rigid(wires: Polylines, one: np.typing.NDArray[np.integer], other: np.typing.NDArray[np.integer]) -> Mask:
    """Return which pairs of lines (n,) move as one."""
    standing = np.asarray(wires.kind) == EdgeKind.CONTACT
    same = np.asarray(wires.part)[one] == np.asarray(wires.part)[other]
    return np.asarray(same & ~standing[one] & ~standing[other])


def _lines_at(q: Array, samples: EdgeSamples, wires: Polylines) -> np.typing.NDArray[np.int64]:
    """Return the number (n,) of the line nearest to each place (n, 2) px that is not the sample's own; -1 for none."""
    from scipy.spatial import cKDTree

    points, _, line = wires.points_along(1.0)
    out = np.full(len(q), -1, np.int64)
    if not len(points):
        return out
    _, near = cKDTree(points).query(q, k=_POINTS, distance_upper_bound=_BESIDE_PX)
    for k in range(_POINTS - 1, -1, -1):
        known = near[:, k] < len(points)
        of = np.where(known, line[np.minimum(near[:, k], len(points) - 1)], -1)
        out = np.where(known & (of != samples.line), of, out)
    return out
