"""Lines of one body that run close beside each other, and which of them can be measured all the same.

The two borders of a narrow face, seen nearly edge on, are twins: they move together, but one may be taken for the
other. Not so if the light makes one rise where the other falls, nor can the stronger be taken for the fainter. Then it
has room up to the line beyond; its twin's step, at a known distance, is fitted with its own (`cadcam.image.profile`). A
line where a body stands on another is no twin: it may not follow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask
from cadcam.cad.edges import EdgeKind
from cadcam.locate.sight import Sight
from cadcam.verify.sightlines import STEP_PX, Sightlines
from cadcam.verify.surroundings import Surroundings

Longs = npt.NDArray[np.int64]
_LEAST_PX = 2.0  # between twins whose face shows a tone of its own
_NEIGHBOURS = 6  # places looked at where a twin should be
_SURE = 3.0  # sigmas by which one's contrast has to be less


def room_beside_twins(lines: Sightlines, sights: Sequence[Sight], beside: Surroundings) -> Array:
    """Return the distance (N,) px of places to the next line that they may be taken for."""
    room = lines.room.copy()
    for i, sight in enumerate(sights):
        rows, samples = np.flatnonzero(lines.photo == i), sight.samples
        sides = np.stack([samples.below, samples.above], axis=1)
        for side in range(2):
            twin = _twins(lines.select(rows), samples.twins[:, side, 0])
            other = rows[np.maximum(twin, 0)]
            apart = (twin >= 0) & (_fainter(beside, rows, other) | _opposite(lines, beside, rows, other))
            sides[apart, side] = samples.beyond[apart, side]
        room[rows] = sides.min(axis=1)
    return room


def _twins(lines: Sightlines, at: Array) -> Longs:
    """Return the place (n,) of the same body, on another line, that is `at` (n,) px along each normal; -1 for none."""
    from scipy.spatial import cKDTree

    out = np.full(len(lines), -1, np.int64)
    asked = np.flatnonzero(np.isfinite(at) & (np.abs(at) >= _LEAST_PX) & (lines.kind != EdgeKind.CONTACT))
    if not len(asked):
        return out
    q = lines.q[asked] + at[asked, None] * lines.normal[asked]
    _, near = cKDTree(lines.q).query(q, k=min(_NEIGHBOURS, len(lines)), distance_upper_bound=STEP_PX)
    for j in near.reshape(len(asked), -1).T[::-1]:
        k = np.minimum(j, len(lines) - 1)
        off = np.abs(np.einsum("ni,ni->n", lines.q[k] - q, lines.normal[asked]))
        other = (j < len(lines)) & (lines.edge[k] != lines.edge[asked]) & (off < 0.5)
        rigid = (lines.part[k] == lines.part[asked]) & (lines.kind[k] != EdgeKind.CONTACT)
        out[asked] = np.where(other, np.where(rigid, k, -1), out[asked])
    return out


def _fainter(beside: Surroundings, i: Longs, j: Longs) -> Mask:
    """Return which twins j (n,) surely have less contrast than lines i (n,)."""
    less = np.abs(beside.change[i]) - np.abs(beside.change[j])
    return np.asarray((beside.way[i] != 0) & (less > _SURE * np.hypot(beside.doubt[i], beside.doubt[j])))


def _opposite(lines: Sightlines, beside: Surroundings, i: Longs, j: Longs) -> Mask:
    """Return which of two lines (n,) surely rise where the other falls."""
    along = np.sign(np.einsum("ni,ni->n", lines.normal[i], lines.normal[j]))
    return np.asarray(beside.way[i] * beside.way[j] * along < 0)
