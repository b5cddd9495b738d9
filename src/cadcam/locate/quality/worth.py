"""How many constraints lines impose on a pose.

A line is worth two, its position and its direction; a short one is worth one. Lines that lie on one edge of the photo
count once. Each straight stretch of a bent line counts by itself, but a rounded corner does not split an edge in two.

A contour of a curved surface is one smooth line, however long. Its first arc is worth what a line is; each further one
goes on where the one before ended, in its direction, and adds how much it bends: one constraint.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.native.profiles import along_runs

_WORTH_PX = (10.0, 24.0)  # length from which a line is worth one constraint, and two
_CORNER, _CORNERS = np.radians(30.0), 16  # turn between two stretches of a line; most stretches of one
_BENT, _AROUND = 1 / 170, 3  # rad per px, averaged over so many samples to each side, from which a line is bent
_ONE_EDGE = 8.0, np.cos(np.radians(4.0))  # distance and angle within which lines lie on one edge of the photo
_STRAIGHT = 0.95  # least chord over arc of a line that may lie on another one


def distinct_lines(q: Array, run: Ids) -> tuple[Longs, Array]:
    """Return the number of the distinct line of each sample (n,), and the length (L,) px of each of these lines.

    A straight run is merged into the longest line that both its ends are near and that has about its direction.
    """
    first = np.flatnonzero(np.diff(run, prepend=-1))
    last = np.append(first[1:], len(run)) - 1
    a, b = q[first], q[last]
    step = np.hypot(*np.diff(q, axis=0, prepend=q[:1]).T)
    step[first] = 0.0
    arc, chord = np.add.reduceat(step, first), np.hypot(*(b - a).T)
    along = (b - a) / np.maximum(chord, 1e-9)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    straight = chord > _STRAIGHT * arc
    far = np.maximum(*(np.abs(np.einsum("ijk,jk->ij", end[:, None] - a, across)) for end in (a, b)))
    on = (far < _ONE_EDGE[0]) & (np.abs(along @ along.T) > _ONE_EDGE[1]) & straight & straight[:, None]
    np.fill_diagonal(on, True)
    owner = np.argmax(np.where(on, arc, -1.0), axis=1)
    _, line = np.unique(owner, return_inverse=True)
    return np.repeat(line, last - first + 1), np.bincount(line, arc).astype(np.float64)


def further_arcs(line: Longs, arc: Ids, run: Ids) -> Mask:
    """Return which lines (L,) are arcs of a contour that go on from another one.

    line, arc, run (n,): of each sample, as of `distinct_lines` for the arcs, and of `EdgeSamples`.
    """
    first = np.flatnonzero(np.diff(arc, prepend=-1))
    goes_on = np.append(False, run[first[1:]] == run[first[1:] - 1])[: len(first)]
    return np.asarray(np.bincount(line[first], ~goes_on) == 0)


def worth_of_lines(length: Array, further: Mask) -> float:
    """Return how many constraints lines of these lengths (L,) px impose on a pose, whether they bend or not.

    further (L,): which are arcs of a contour beyond its first one.
    """
    return float(_worth(length, further).sum())


def _worth(length: Array, further: Mask) -> Longs:
    return np.asarray(np.minimum(np.searchsorted(_WORTH_PX, length, side="right"), np.where(further, 1, 2)))


def worth_of_stretches(
    q: Array, normal: Array, run: Ids, line: Longs, length: Array, further: Mask | None = None
) -> float:
    """Return how many constraints samples (n,) on lines of these lengths (L,) px impose on a pose.

    A line is worth the sum of its straight stretches; one that bends everywhere, or hardly, is worth its length.
    further (L,): which are arcs of a contour beyond its first one, default none; these are not worth more.
    """
    same = run[1:] == run[:-1]
    step, turn = (np.append(0.0, same * np.hypot(*np.diff(a, axis=0).T)) for a in (q, normal))
    straight = along_runs(turn, run, _AROUND) < _BENT * along_runs(step, run, _AROUND)
    turned = np.cumsum(turn)
    turned -= turned[np.searchsorted(run, run)]
    stretch = np.minimum(turned // _CORNER, _CORNERS - 1).astype(np.int64)
    of_stretch = np.bincount(line * _CORNERS + stretch, step * straight, len(length) * _CORNERS)
    further = np.zeros(len(length), bool) if further is None else further
    of_stretches = np.searchsorted(_WORTH_PX, of_stretch, side="right").reshape(-1, _CORNERS).sum(axis=1)
    of_lines = _worth(length, further)
    return float(np.where(further, of_lines, np.maximum(of_lines, of_stretches)).sum())
