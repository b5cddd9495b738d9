"""Which mark is which on a regular grid: lattices grown through marks in a picture, and matched to a board's cells.

A lattice grows from one mark and two steps; each next mark is searched for where the local steps lead, so that
perspective and lens distortion may bend it. It need not be complete: marks may be missing, false ones may lie nearby.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids
from cadcam.target.boards.board import Pattern

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Cell: TypeAlias = tuple[int, int]
Kind: TypeAlias = Callable[[int, Array, float], int]  # mark, step to it, side of the step on which the other edge lies
_NEAR = 0.3  # of a step: largest distance of a mark from where its neighbours predict it
_SIDES: tuple[Cell, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))
_SEEDS = 24
_TURNS = [np.array(m).reshape(2, 2) for m in product((-1, 0, 1), repeat=4) if abs(m[0] * m[3] - m[1] * m[2]) == 1]
_TURNS = [m for m in _TURNS if np.abs(m).sum() == 2]  # quarter turns and their mirror images


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Marks on a grid: whole numbers (N, 2) in the lattice's own steps, and each mark's index among all (N,)."""

    cells: Ids
    marks: npt.NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.marks)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedLattice:
    """A lattice placed on a board: point numbers and marks of what fits; `extent`, its full (columns, rows).

    fixed: whether no other place on the board would match as many marks (apart from rotations of the board).
    beyond: marks of the lattice that the board has no point for.
    """

    points: npt.NDArray[np.intp]
    marks: npt.NDArray[np.intp]
    extent: tuple[int, int]
    fixed: bool
    beyond: int


def grown(
    q: Array, seeds: Sequence[tuple[int, Array]], *, enough: int, sizes: Array, kind: Kind | None = None
) -> Lattice | None:
    """Return the largest lattice through marks q (M, 2), or None where not even four marks make one.

    seeds: marks to start from, the best first, each with its two steps (2, 2) px, one per row. sizes (M,): a mark more
    than twice as large or small as its neighbour does not belong. kind: +1 or -1 for marks that alternate. Stops early
    at a lattice of `enough` marks.
    """
    from scipy.spatial import cKDTree

    tree, best = cKDTree(q), None
    tried: set[int] = set()
    for seed, steps in seeds:
        if len(tried) >= _SEEDS:
            break
        if seed in tried or (best is not None and seed in set(best.marks.tolist())):
            continue
        tried.add(seed)
        found = _grow(tree, q, seed, steps, sizes, kind)
        if np.ptp(found.cells, axis=0).min() >= 1 and len(found) > (3 if best is None else len(best)):
            best = found
        if best is not None and len(best) >= enough:
            break
    return best


def _grow(tree: cKDTree, q: Array, seed: int, steps: Array, sizes: Array, kind: Kind | None) -> Lattice:
    at: dict[Cell, int] = {(0, 0): seed}
    taken = {seed}
    queue: deque[Cell] = deque([(0, 0)])
    handed = float(np.sign(np.linalg.det(steps)))
    first = 0 if kind is None else kind(seed, steps[0], handed)
    while queue:
        cell = queue.popleft()
        for side in _SIDES:
            there = (cell[0] + side[0], cell[1] + side[1])
            if there in at:
                continue
            step = _step(at, q, cell, side, steps)
            mark = _nearest(tree, q[at[cell]] + step, _NEAR * float(np.hypot(*step)))
            if mark is None or mark in taken or not _agrees(at, q, there, mark, step):
                continue
            if not 0.5 < sizes[mark] / sizes[at[cell]] < 2.0:
                continue
            if kind is not None and kind(mark, step, handed if side[0] else -handed) != first * (-1) ** (sum(there)):
                continue
            at[there] = mark
            taken.add(mark)
            queue.append(there)
    return Lattice(np.array(list(at), dtype=np.int32).reshape(-1, 2), np.array(list(at.values())))


def _step(at: dict[Cell, int], q: Array, cell: Cell, side: Cell, steps: Array) -> Array:
    """Return the step from a cell to its side, from the marks nearest to it: behind it, beside it, or the seed's."""
    back = (cell[0] - side[0], cell[1] - side[1])
    if back in at:
        return np.asarray(q[at[cell]] - q[at[back]])
    for away in (1, -1):
        beside = (cell[0] + away * side[1], cell[1] + away * side[0])
        beyond = (beside[0] + side[0], beside[1] + side[1])
        if beside in at and beyond in at:
            return np.asarray(q[at[beyond]] - q[at[beside]])
    return np.asarray(side[0] * steps[0] + side[1] * steps[1])


def _agrees(at: dict[Cell, int], q: Array, there: Cell, mark: int, step: Array) -> bool:
    """Return whether the marks already placed around a cell predict the position of `mark`."""
    for sx, sy in product((1, -1), (1, -1)):
        across, along, corner = (there[0] + sx, there[1]), (there[0], there[1] + sy), (there[0] + sx, there[1] + sy)
        if across in at and along in at and corner in at:
            expected = q[at[across]] + q[at[along]] - q[at[corner]]
            if np.hypot(*(expected - q[mark])) > 1.5 * _NEAR * np.hypot(*step):
                return False
    return True


def _nearest(tree: cKDTree, q: Array, reach: float) -> int | None:
    distance, index = tree.query(q, distance_upper_bound=reach)
    return int(index) if np.isfinite(distance) else None


def straightened(cells: npt.NDArray[np.integer], *, staggered: bool) -> Ids:
    """Return the cells in the steps that make the lattice the smallest rectangle.

    Any two steps that span a lattice reach all of it; foreshortened discs may have grown along a diagonal. staggered:
    count columns and rows as in a staggered grid, in half steps.
    """
    basis = min(_spans(staggered), key=lambda m: (int(np.prod(np.ptp(cells @ m.T, axis=0) + 1)), np.abs(m).sum()))
    return np.asarray(cells @ basis.T, dtype=np.int32)


def _spans(staggered: bool) -> list[npt.NDArray[np.int64]]:
    small = [np.array(m).reshape(2, 2) for m in product((-1, 0, 1), repeat=4)]
    unimodular = [m for m in small if abs(m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) == 1]
    cell = np.array([[1, 1], [1, -1]]) if staggered else np.eye(2, dtype=np.int64)
    return [cell @ m for m in unimodular]


def placed(cells: npt.NDArray[np.integer], q: Array, color: npt.NDArray[np.integer], pattern: Pattern) -> PlacedLattice:
    """Return N marks at `cells` of a lattice, placed on the board where most match points, upright among equals.

    color (N,): +1 where the quadrants between the lattice's steps of like sign are dark, -1 where the others are; all 0
    for marks without such quadrants. Never mirrored: a board is seen from its front.
    """
    best: PlacedLattice | None = None
    rank: tuple[int, float] = (0, 0.0)
    places: list[tuple[int, int]] = []  # (marks on points, number of places with as many) for each rotation
    for turn in _TURNS:
        along = cells @ turn.T
        right = _direction(along, q)
        if np.linalg.det(right) <= 0:
            continue
        found, ways = _best_shift(along, color * int(np.prod(turn.sum(axis=1))), pattern)
        places.append((len(found.points), ways))
        upright = float(right[0, 0] / np.hypot(*right[:, 0]) + 1e-6 * right[1, 1] / np.hypot(*right[:, 1]))
        if (len(found.points), upright) > rank:
            best, rank = found, (len(found.points), upright)
    if best is None:
        nothing = np.zeros(0, dtype=np.intp)
        return PlacedLattice(nothing, nothing, _extent(cells), False, len(cells))
    ways = sum(n for count, n in places if count == len(best.points))
    return replace(best, fixed=ways <= pattern.turns)


def _direction(cells: npt.NDArray[np.int64], q: Array) -> Array:
    """Return the mean steps (2, 2), columns px along the board's x and y."""
    A = np.column_stack([cells, np.ones(len(cells))])
    return np.asarray(np.linalg.lstsq(A, q, rcond=None)[0][:2].T)


def _best_shift(
    cells: npt.NDArray[np.int64], own: npt.NDArray[np.integer], pattern: Pattern
) -> tuple[PlacedLattice, int]:
    """Return the shift at which most marks match points of their kind, by correlation; and how many do as well."""
    from scipy.signal import correlate

    cells = cells - cells.min(axis=0)
    target = pattern.cells
    kinds = (1 - 2 * (target.sum(axis=1) % 2)) if own.any() else np.zeros(len(target), dtype=np.int64)
    scores = [
        correlate(_occupied(target[kinds == k], target), _occupied(cells[own == k], cells)) for k in np.unique(kinds)
    ]
    counts = np.rint(np.sum(scores, axis=0))
    most = counts.max()
    shift = np.array(np.unravel_index(int(np.argmax(counts)), counts.shape)) - cells.max(axis=0)
    number = np.full(target.max(axis=0) + 1, -1, dtype=np.intp)
    number[target[:, 0], target[:, 1]] = np.arange(len(target))
    place = cells + shift
    inside = ((place >= 0) & (place < number.shape)).all(axis=1)
    point = np.where(inside, number[tuple(np.where(inside[:, None], place, 0).T)], -1)
    hit = point >= 0
    ways = int((counts == most).sum())
    return PlacedLattice(point[hit], np.flatnonzero(hit), _extent(cells), ways == 1, int((~hit).sum())), ways


def _occupied(cells: npt.NDArray[np.integer], frame: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
    out = np.zeros(frame.max(axis=0) + 1)
    out[cells[:, 0], cells[:, 1]] = 1.0
    return out


def _extent(cells: npt.NDArray[np.integer]) -> tuple[int, int]:
    """Return how many columns and rows are at least half as full as the fullest: a stray mark is not a row."""
    lines = [np.bincount(cells[:, axis] - cells[:, axis].min()) for axis in (0, 1)]
    columns, rows = (int((line >= line.max() / 2).sum()) for line in lines)
    return columns, rows
