"""Chessboard corners in a picture: saddle points of the grey values, tested on a ring, joined to a lattice.

A corner's picture is a saddle: the determinant of the Hessian is negative and least there (Lucchese and Mitra, ICIP
2002). On a ring around it the grey value crosses its mean four times, at opposite angles (the idea of Bennett and
Lasenby's ChESS, CVIU 2014); those angles are the edges. Neighbours of a corner lie along its edges and are of the other
kind: black where it is white. Positions come from `photometric.fit_corners` on the full picture at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Picture
from cadcam.target.lattice import grown
from cadcam.target.photometric import Fit, fit_corners

_RING = 24  # samples on the ring
_MOST = 4000  # candidates
_FAINT = 0.02  # of the strongest saddle: below it a candidate is noise
_MIN_REACH, _MAX_REACH = 2.5, 12.0  # px of the window that is fitted
_CLEAR = 0.42  # of the distance to the neighbours' edges
_CONTRAST = 4  # its place among a corner's parameters
_WEAK = 0.35  # of the median contrast: below it it is no corner of the board
_MISFIT, _TIMES = 0.16, 3.0  # rms by contrast that is always allowed; and that by its median
_ROUNDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Candidates in a picture: q (M, 2) px, directions (M, 2) of their two edges in rad, kind (M,) +1 or -1.

    kind: whether the quadrants that the turn from the first direction to the second sweeps are the dark ones.
    """

    q: Array
    directions: Array
    kind: Ids
    strength: Array

    def color(self, mark: int, step: Array, side: float) -> int:
        """Return +1 if the quadrant between a step along one edge and the other edge on its `side` is dark, else -1."""
        angle = np.arctan2(step[1], step[0])
        off = np.abs(np.mod(self.directions[mark] - angle + np.pi / 2, np.pi) - np.pi / 2)
        along = self.directions[mark, int(np.argmin(off))]
        other = self.directions[mark, int(np.argmax(off))]
        turn = np.mod(other - along, np.pi)  # from the one edge to the other, on the side of growing angles
        middle = along + turn / 2 if side > 0 else along + turn / 2 + np.pi / 2
        first, second = self.directions[mark]
        swept = np.mod(middle - first, np.pi) < np.mod(second - first, np.pi)
        return int(self.kind[mark]) if swept else -int(self.kind[mark])


@dataclass(frozen=True, slots=True, eq=False)
class CornerGrid:
    """Corners fitted to the picture and their places on a grid: cells (N, 2), and the fit of each.

    color (N,): +1 where the quadrants between steps of like sign are dark.
    """

    cells: Ids
    fit: Fit

    @property
    def color(self) -> Ids:
        return np.sign(self.fit.parameters[:, _CONTRAST]).astype(np.int32)


def corner_grid(gray: Picture, *, smoothing: float, enough: int, scale: float = 1.0) -> CornerGrid | None:
    """Return the largest grid of chessboard corners in a picture, or None.

    Candidates are sought in the picture reduced by `scale` (at most 1) and smoothed there by `smoothing` px, grown to a
    lattice, fitted to the full picture, and completed where the lattice says that a corner should be.
    """
    from scipy.ndimage import zoom

    small = gray if scale == 1.0 else zoom(gray, scale, order=1, grid_mode=True, mode="nearest")
    corners = corner_candidates(small, smoothing)
    if len(corners.q) < 4:
        return None
    order = np.argsort(-corners.strength, kind="stable")[:200].tolist()
    seeds = [(i, steps) for i in order if (steps := _steps(corners, i)) is not None]
    lattice = grown(corners.q, seeds, enough=enough, sizes=np.ones(len(corners.q)), kind=corners.color)
    if lattice is None:
        return None
    ratio = np.array(gray.shape[::-1]) / np.array(small.shape[::-1])
    q = (corners.q[lattice.marks] + 0.5) * ratio - 0.5
    return _completed(gray, _kept(_fitted(gray, lattice.cells, q, local_steps(q, lattice.cells))))


def _fitted(gray: Picture, cells: Ids, q: Array, steps: Array) -> CornerGrid:
    """Return the corners near q fitted to the picture, in windows that keep clear of the neighbours' edges."""
    clear = np.abs(np.linalg.det(steps)) / np.linalg.norm(steps, axis=1).max(axis=1)
    reach = (_CLEAR * clear).clip(_MIN_REACH, _MAX_REACH)
    return CornerGrid(cells, fit_corners(gray, q, np.arctan2(steps[:, 1], steps[:, 0]), reach))


def _kept(grid: CornerGrid) -> CornerGrid | None:
    """Return the corners that look like ones: fitted well, about as strong as the others, of alternating kind."""
    fit = grid.fit
    if not fit.good.any():
        return None
    contrast = np.abs(fit.parameters[:, _CONTRAST])
    misfit = min(max(_MISFIT, _TIMES * float(np.median(fit.misfit[fit.good]))), 2 * _MISFIT)
    sigma = np.sqrt(np.einsum("nii->n", fit.covariance))
    good = fit.good & (contrast > _WEAK * np.median(contrast[fit.good])) & (fit.misfit < misfit)
    good &= sigma < 2 * _TIMES * np.median(sigma[fit.good])
    sign = grid.color * (1 - 2 * (grid.cells.sum(axis=1) % 2))
    good &= sign == (1 if sign[good].sum() >= 0 else -1)
    good = _connected(grid.cells, good)
    return _subset(grid, good) if good.sum() >= 4 else None


def _completed(gray: Picture, grid: CornerGrid | None) -> CornerGrid | None:
    """Return the grid with the corners that its neighbours predict and the picture confirms, round by round."""
    tried: set[tuple[int, int]] = set()
    for _ in range(_ROUNDS):
        if grid is None:
            return None
        cells, q = _wanted(grid, gray.shape, tried)
        if not len(cells):
            break
        tried |= {(x, y) for x, y in cells.tolist()}
        steps = local_steps(np.concatenate([grid.fit.q, q]), np.concatenate([grid.cells, cells]))[len(grid.cells) :]
        new = _fitted(gray, cells, q, steps)
        near = np.hypot(*(new.fit.q - q).T) < 0.2 * np.linalg.norm(steps, axis=1).min(axis=1)
        more = _kept(_joined(grid, _subset(new, near)))
        if more is None or len(more.cells) <= len(grid.cells):
            break
        grid = more
    return grid


def _wanted(grid: CornerGrid, shape: tuple[int, ...], tried: set[tuple[int, int]]) -> tuple[Ids, Array]:
    """Return the empty cells beside the grid's and where two neighbours in line with them say that they are."""
    at = {(x, y): i for i, (x, y) in enumerate(grid.cells.tolist())}
    found: dict[tuple[int, int], list[Array]] = {}
    for x, y in at:
        for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1)):
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


def _joined(one: CornerGrid, other: CornerGrid) -> CornerGrid:
    f, g = one.fit, other.fit
    fit = Fit(*(np.concatenate([getattr(f, name), getattr(g, name)]) for name in Fit.__slots__))
    return CornerGrid(np.concatenate([one.cells, other.cells]), fit)


def _subset(grid: CornerGrid, which: npt.NDArray[np.bool_]) -> CornerGrid:
    f = grid.fit
    fit = Fit(f.q[which], f.covariance[which], f.parameters[which], f.misfit[which], f.good[which])
    return CornerGrid(grid.cells[which], fit)


def _connected(cells: Ids, good: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return which of the good cells hang together with most others side by side."""
    from scipy.ndimage import label

    low = cells.min(axis=0)
    board = np.zeros(np.ptp(cells, axis=0) + 1, dtype=bool)
    place = tuple((cells - low).T)
    board[place] = good
    number = label(board)[0][place]
    if not good.any():
        return good
    return np.asarray(good & (number == np.bincount(number[good]).argmax()))


def corner_candidates(gray: Picture, smoothing: float) -> Corners:
    """Return the saddle points of a picture smoothed by a Gaussian of `smoothing` px that pass the test on the ring."""
    from scipy.ndimage import gaussian_filter, maximum_filter

    smooth = gaussian_filter(gray, smoothing)
    xx = gaussian_filter(gray, smoothing, order=(0, 2))
    yy = gaussian_filter(gray, smoothing, order=(2, 0))
    xy = gaussian_filter(gray, smoothing, order=(1, 1))
    saddle = xy * xy - xx * yy
    peak = (saddle == maximum_filter(saddle, 2 * round(1.5 * smoothing) + 1)) & (saddle > _FAINT * saddle.max())
    border = int(np.ceil(3 * smoothing)) + 1
    peak[:border] = peak[-border:] = False
    peak[:, :border] = peak[:, -border:] = False
    y, x = np.nonzero(peak)
    order = np.argsort(-saddle[y, x], kind="stable")[:_MOST]
    q = np.column_stack([x[order], y[order]]).astype(np.float64)
    return _on_ring(smooth, q + _newton(smooth, q), saddle[y[order], x[order]], radius=2.5 * smoothing)


def _newton(smooth: Picture, q: Array) -> Array:
    """Return the step from whole pixels q (N, 2) to the stationary point of the parabola through their neighbours."""
    x, y = q.astype(np.int64).T

    def at(dx: int, dy: int) -> Array:
        return smooth[y + dy, x + dx].astype(np.float64)

    gx, gy = (at(1, 0) - at(-1, 0)) / 2, (at(0, 1) - at(0, -1)) / 2
    xx, yy = at(1, 0) - 2 * at(0, 0) + at(-1, 0), at(0, 1) - 2 * at(0, 0) + at(0, -1)
    xy = (at(1, 1) - at(-1, 1) - at(1, -1) + at(-1, -1)) / 4
    det = np.minimum(xx * yy - xy * xy, -1e-12)
    step = np.column_stack([xy * gy - yy * gx, xy * gx - xx * gy]) / det[:, None]
    return np.asarray(step.clip(-1.5, 1.5))


def _on_ring(smooth: Picture, q: Array, strength: Array, *, radius: float) -> Corners:
    from scipy.ndimage import map_coordinates

    turn = np.arange(_RING) * (2 * np.pi / _RING)
    x = q[:, :1] + radius * np.cos(turn)
    y = q[:, 1:] + radius * np.sin(turn)
    ring = map_coordinates(smooth, [y, x], order=1, mode="nearest").astype(np.float64)
    half = ring.reshape(-1, 2, _RING // 2)
    even = half.mean(axis=1)  # what is the same on opposite sides
    even -= (even.max(axis=1, keepdims=True) + even.min(axis=1, keepdims=True)) / 2
    odd = np.abs(half[:, 0] - half[:, 1]).max(axis=1)
    wrapped = np.concatenate([even, even[:, :1]], axis=1)
    crossing = np.signbit(wrapped[:, 1:]) != np.signbit(wrapped[:, :-1])
    swing = np.ptp(even, axis=1)
    good = (crossing.sum(axis=1) == 2) & (odd < 0.7 * swing) & (swing > 0.02)
    q, even, wrapped, crossing = q[good], even[good], wrapped[good], crossing[good]
    if not len(q):
        return Corners(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, dtype=np.int32), np.zeros(0))
    first = np.argmax(crossing, axis=1)
    second = _RING // 2 - 1 - np.argmax(crossing[:, ::-1], axis=1)
    directions = np.column_stack([_crossing(wrapped, at) for at in (first, second)]) * (2 * np.pi / _RING)
    between = np.take_along_axis(even, ((first + 1) % (_RING // 2))[:, None], axis=1)[:, 0]
    return Corners(q, directions, np.where(between < 0, 1, -1).astype(np.int32), strength[good])


def _crossing(ring: Array, at: npt.NDArray[np.intp]) -> Array:
    """Return where the ring crosses zero after sample `at`, in samples."""
    before, after = (np.take_along_axis(ring, at[:, None] + k, axis=1)[:, 0] for k in (0, 1))
    return np.asarray(at + before / (before - after))


def _steps(corners: Corners, seed: int) -> Array | None:
    """Return the steps (2, 2) to the nearest corners along the seed's two edges, or None."""
    away = corners.q - corners.q[seed]
    distance = np.hypot(away[:, 0], away[:, 1])
    pair = []
    for angle in corners.directions[seed]:
        off = np.abs(away[:, 0] * np.sin(angle) - away[:, 1] * np.cos(angle))
        along = np.flatnonzero((distance > 0) & (off < 0.2 * distance))
        if not along.size:
            return None
        pair.append(away[along[np.argmin(distance[along])]])
    return np.array(pair)


def local_steps(q: Array, cells: Ids) -> Array:
    """Return the steps (N, 2, 2) px, columns along the grid's x and y, at each point: from its neighbours' places."""
    where = {tuple(c): i for i, c in enumerate(cells.tolist())}
    A = np.column_stack([cells, np.ones(len(cells))])
    overall = np.linalg.lstsq(A, q, rcond=None)[0][:2].T
    out = np.repeat(overall[None], len(q), axis=0)
    for i, (x, y) in enumerate(cells.tolist()):
        for axis, (dx, dy) in enumerate(((1, 0), (0, 1))):
            after, before = where.get((x + dx, y + dy)), where.get((x - dx, y - dy))
            if after is not None and before is not None:
                out[i, :, axis] = (q[after] - q[before]) / 2
            elif after is not None or before is not None:
                out[i, :, axis] = q[after] - q[i] if after is not None else q[i] - q[before]
    return out
