"""Marks of a board fitted on their grid: those unlike the rest are dropped, missing ones are searched for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask
from cadcam.target.boards.photometric import CONTRAST, Fit

Fitter: TypeAlias = Callable[[Array, Array], Fit]  # places q (N, 2), steps of the grid there (N, 2, 2) -> the fit

_WEAK = 0.35  # of the median contrast: weaker marks are not the board's
_MISFIT, _TIMES = 0.16, 3.0  # rms over contrast that is always allowed; and as a multiple of its median
_ROUNDS = 8
_SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))
_CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Fitted marks and their cells (N, 2) on a grid of arbitrary origin, in no particular order.

    alternating: whether the contrast's sign alternates from cell to cell, as that of chessboard corners does.
    """

    cells: Ids
    fit: Fit
    alternating: bool

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def color(self) -> Ids:
        """Return the contrast's sign (N,), 0 where it carries no information."""
        sign = np.sign(self.fit.parameters[:, CONTRAST]) if self.alternating else np.zeros(len(self.cells))
        return sign.astype(np.int32)

    def subset(self, which: Mask) -> Grid:
        """Return the marks that `which` (N,) selects."""
        fit = Fit(*(getattr(self.fit, name)[which] for name in Fit.__slots__))
        return Grid(self.cells[which], fit, self.alternating)

    def joined(self, other: Grid) -> Grid:
        """Return the marks of both."""
        fit = Fit(*(np.concatenate([getattr(g.fit, name) for g in (self, other)]) for name in Fit.__slots__))
        return Grid(np.concatenate([self.cells, other.cells]), fit, self.alternating)


def fitted_grid(
    cells: Ids, q: Array, fit: Fitter, shape: tuple[int, ...], *, alternating: bool, staggered: bool
) -> Grid | None:
    """Return the marks near q (N, 2) at `cells` that fit, and those predicted by neighbours that a fit confirms.

    None where fewer than four are left. shape: the picture's.
    """
    grid = _kept(Grid(cells, fit(q, local_steps(q, cells)), alternating))
    tried: set[tuple[int, int]] = set()
    for _ in range(_ROUNDS):
        if grid is None:
            return None
        more = _with_neighbours(grid, fit, shape, tried, _CORNERS if staggered else _SIDES)
        if more is None or len(more) <= len(grid):
            break
        grid = more
    return grid


def local_steps(q: Array, cells: npt.NDArray[np.integer], *, at: npt.NDArray[np.integer] | None = None) -> Array:
    """Return the steps (M, 2, 2) px, columns along the grid's x and y, from the marks within two cells of each cell.

    at: the cells (M, 2) of interest, by default those of all marks.
    """
    from scipy.spatial import cKDTree

    at = cells if at is None else at
    A = np.column_stack([cells, np.ones(len(cells))])
    overall = np.linalg.lstsq(A, q, rcond=None)[0][:2].T
    near = cKDTree(cells).query_ball_point(at, 2.1, p=2)
    out = np.repeat(overall[None], len(at), axis=0)
    for i, index in enumerate(near):
        if np.linalg.matrix_rank(A[index]) == 3:
            out[i] = np.linalg.lstsq(A[index], q[index], rcond=None)[0][:2].T
    return out


def _kept(grid: Grid) -> Grid | None:
    """Return the marks consistent with one board: fitted well, of similar contrast, of alternating kind."""
    fit = grid.fit
    if not fit.good.any():
        return None
    strength = fit.parameters[:, CONTRAST]
    misfit = min(max(_MISFIT, _TIMES * float(np.median(fit.misfit[fit.good]))), 2 * _MISFIT)
    sigma = np.sqrt(np.einsum("nii->n", fit.covariance))
    good = fit.good & (fit.misfit < misfit) & (sigma < 2 * _TIMES * np.median(sigma[fit.good]))
    good &= np.abs(strength) > _WEAK * np.median(np.abs(strength[fit.good]))
    sign = np.sign(strength) * ((1 - 2 * (grid.cells.sum(axis=1) % 2)) if grid.alternating else 1)
    good &= sign == (1 if sign[good].sum() >= 0 else -1)
    good = _connected(grid.cells, good)
    spread = good.sum() >= 4 and np.ptp(grid.cells[good], axis=0).min() >= 1
    return grid.subset(good) if spread else None


def _with_neighbours(
    grid: Grid, fit: Fitter, shape: tuple[int, ...], tried: set[tuple[int, int]], sides: tuple[tuple[int, int], ...]
) -> Grid | None:
    cells, q = _wanted(grid, shape, tried, sides)
    if not len(cells):
        return None
    tried |= {(x, y) for x, y in cells.tolist()}
    steps = local_steps(grid.fit.q, grid.cells, at=cells)
    new = Grid(cells, fit(q, steps), grid.alternating)
    near = np.hypot(*(new.fit.q - q).T) < 0.2 * np.linalg.norm(steps, axis=1).min(axis=1)
    return _kept(grid.joined(new.subset(near)))


def _wanted(
    grid: Grid, shape: tuple[int, ...], tried: set[tuple[int, int]], sides: tuple[tuple[int, int], ...]
) -> tuple[Ids, Array]:
    """Return the empty cells next to the grid's, and the positions extrapolated from two or three marks in line."""
    at = {(x, y): i for i, (x, y) in enumerate(grid.cells.tolist())}
    found: dict[tuple[int, int], list[Array]] = {}
    for x, y in at:
        for dx, dy in sides:
            there, back, far = (x + dx, y + dy), (x - dx, y - dy), (x - 2 * dx, y - 2 * dy)
            if there in at or there in tried or back not in at:
                continue
            q, one = grid.fit.q[at[x, y]], grid.fit.q[at[back]]
            bend = q - 2 * one + grid.fit.q[at[far]] if far in at else np.zeros(2)
            found.setdefault(there, []).append(2 * q - one + bend)
    cells = np.array(list(found), dtype=np.int32).reshape(-1, 2)
    q = np.array([np.mean(places, axis=0) for places in found.values()]).reshape(-1, 2)
    inside = ((q > 2) & (q < np.array([shape[1] - 3, shape[0] - 3]))).all(axis=1)
    return cells[inside], q[inside]


def _connected(cells: Ids, good: Mask) -> Mask:
    """Return which of the good cells belong to the largest connected group."""
    from scipy.ndimage import label

    if not good.any():
        return good
    low = cells.min(axis=0)
    board = np.zeros(np.ptp(cells, axis=0) + 1, dtype=bool)
    place = tuple((cells - low).T)
    board[place] = good
    number = label(board, np.ones((3, 3)))[0][place]
    return np.asarray(good & (number == np.bincount(number[good]).argmax()))
