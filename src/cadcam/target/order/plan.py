"""The plan of a set of marks: their nominal places, and the look-ups that a search among them repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Floats, Ids, Mask, frozen
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints

FEWEST = 4
NEIGHBOURS = 8
_FLAT = 1e-6  # of the plan's length
_CELLS = (64, 256)  # of the table along the plan's longer side
_CELLS_A_SPACING = 8


@dataclass(frozen=True, slots=True, eq=False)
class MarkPlan:
    """M marks: places p (M, 2) in any unit, distance to the nearest other mark, nearest marks (M, k) and adjacency.

    joined (M, M): 1 where one of two marks is among the nearest of the other, else 0.
    """

    p: Array
    spacing: Array
    near: Ids
    joined: Array

    @classmethod
    def of(cls, places: Floats) -> MarkPlan:
        """Return the plan of marks at places (M, 2). Raises `BadValue`, `TooFewPoints`, `DegenerateGeometry`."""
        from scipy.spatial import cKDTree

        p = frozen(places, "plan", (None, 2))
        if len(p) < FEWEST:
            raise TooFewPoints("a plan of marks", len(p), FEWEST)
        k = min(NEIGHBOURS, len(p) - 1)
        distance, near = (np.asarray(a) for a in cKDTree(p).query(p, k + 1))
        twins = np.flatnonzero(distance[:, 1] == 0)
        if len(twins):
            i, j = int(twins[0]), int(near[twins[0]][near[twins[0]] != twins[0]][0])
            raise BadValue(f"plan marks {min(i, j)} and {max(i, j)}", p[i].tolist(), "marks at different places")
        spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
        if spread[1] <= _FLAT * spread[0]:
            raise DegenerateGeometry("the plan's marks lie on one line: their order cannot be told under perspective")
        near = near[:, 1:]
        joined = np.zeros((len(p), len(p)))
        joined[np.repeat(np.arange(len(p)), k), near.ravel()] = 1.0
        return cls(p, distance[:, 1], near.astype(np.int32), np.maximum(joined, joined.T))

    def __len__(self) -> int:
        return len(self.p)


class NearestMark:
    """The mark nearest to a place, from a table: for very many places, where hits matter and near misses do not.

    Between two marks the result may be either of them.
    """

    def __init__(self, plan: MarkPlan) -> None:
        from scipy.ndimage import distance_transform_edt

        self._plan = plan
        low, high = plan.p.min(axis=0), plan.p.max(axis=0)
        extent = float((high - low).max())
        cells = int(np.clip(_CELLS_A_SPACING * extent / np.median(plan.spacing), *_CELLS))
        self._cell = extent / cells
        self._low = low - 2 * self._cell
        self._last = np.floor((high - self._low) / self._cell).astype(np.int64) + 2
        number = np.full(tuple(self._last + 1), -1, dtype=np.int64)
        x, y = np.floor((plan.p - self._low) / self._cell).astype(np.int64).T
        number[x, y] = np.arange(len(plan))
        nearest = distance_transform_edt(number < 0, return_distances=False, return_indices=True)
        self._number = number[nearest[0], nearest[1]].ravel()

    def __call__(self, places: Array) -> tuple[Ids, Array]:
        """Return the marks (...,) near places (..., 2), and their squared distance over the marks' squared spacing."""
        x = ((places[..., 0] - self._low[0]) / self._cell).clip(0, self._last[0]).astype(np.int64)
        y = ((places[..., 1] - self._low[1]) / self._cell).clip(0, self._last[1]).astype(np.int64)
        mark = self._number[x * (self._last[1] + 1) + y]
        p, s = self._plan.p, self._plan.spacing
        dx, dy = places[..., 0] - p[mark, 0], places[..., 1] - p[mark, 1]
        return mark, (dx * dx + dy * dy) / s[mark] ** 2


def areas(corners: Array) -> Array:
    """Return twice the signed area (...,) of triangles (..., 3, 2)."""
    a, b = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def matched_once(mark: Ids, distance: Array, near_enough: Mask) -> Ids:
    """Return `mark` (N,) with -1 where it is not near enough, or another of the N is nearer to the same mark."""
    out = np.full(len(mark), -1, dtype=np.int32)
    order = np.argsort(np.where(near_enough, distance, np.inf), kind="stable")
    order = order[near_enough[order]]
    taken, first = np.unique(mark[order], return_index=True)
    out[order[first]] = taken
    return out
