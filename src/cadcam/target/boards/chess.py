"""Chessboard corners in a picture: saddle points of the grey values, tested on a ring, joined to a lattice.

A corner's picture is a saddle: the determinant of the Hessian is negative and least there (Lucchese and Mitra, ICIP
2002). On a ring around it the grey value crosses its mean four times, at opposite angles (the idea of Bennett and
Lasenby's ChESS, CVIU 2014); those angles are the edges. Neighbours of a corner lie along its edges and are of the
opposite kind: black where it is white. Positions come from `photometric.fit_corners` on the full picture at the end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Picture
from cadcam.target.boards.grid import Grid, fitted_grid
from cadcam.target.boards.lattice import grown
from cadcam.target.boards.photometric import BLUR, Fit, fit_corners
from cadcam.target.boards.pyramid import reduced

_RING = 24  # samples on the ring
_MOST = 4000  # candidates at most
_FAINT = 0.02  # of the strongest saddle: weaker candidates are noise
_MIN_REACH, _MAX_REACH = 2.5, 12.0  # px: radius of the fitted window
_BLURS = 3.0  # blurs that a window reaches at least, where there is room
_CLEAR = 0.42  # of the distance to the neighbours' edges


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Candidates in a picture: q (M, 2) px, directions (M, 2) of their two edges in rad, kind (M,) +1 or -1.

    kind: whether the quadrants swept by the rotation from the first direction to the second are the dark ones.
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
        turn = np.mod(other - along, np.pi)  # from the one edge to the other, by increasing angles
        middle = along + turn / 2 if side > 0 else along + turn / 2 + np.pi / 2
        first, second = self.directions[mark]
        swept = np.mod(middle - first, np.pi) < np.mod(second - first, np.pi)
        return int(self.kind[mark]) if swept else -int(self.kind[mark])


def corner_grid(gray: Picture, *, smoothing: float, enough: int, scale: float = 1.0) -> Grid | None:
    """Return the largest grid of chessboard corners in a picture, or None.

    Candidates are detected in the picture reduced by `scale` (at most 1) and smoothed by `smoothing` px, grown to a
    lattice, fitted and completed where the lattice predicts further corners, and finally fitted to the full picture.
    """
    small, full = reduced(gray, scale)
    corners = corner_candidates(small, smoothing)
    if len(corners.q) < 4:
        return None
    order = np.argsort(-corners.strength, kind="stable")[:200].tolist()
    seeds = [(i, steps) for i in order if (steps := _steps(corners, i)) is not None]
    lattice = grown(corners.q, seeds, enough=enough, sizes=np.ones(len(corners.q)), kind=corners.color)
    if lattice is None:
        return None
    grid = fitted_corners(small, lattice.cells, corners.q[lattice.marks])
    if grid is None or small is gray:
        return grid
    ratio = len(gray) / len(small)
    q, blur = full(grid.fit.q), float(np.median(grid.fit.parameters[:, BLUR])) * ratio
    fine = fitted_corners(gray, grid.cells, q, blur=blur)
    if fine is not None and len(fine) >= len(grid):
        return fine
    coarse = replace(grid.fit, q=q, covariance=grid.fit.covariance * ratio**2)  # weak enough that nothing is lost
    return replace(grid, fit=coarse)


def fitted_corners(gray: Picture, cells: Ids, q: Array, *, clear_of: float = 1.0, blur: float = 1.0) -> Grid | None:
    """Return the corners near q (N, 2) at `cells` (N, 2) of their grid, fitted and completed, or None.

    clear_of: the distance to other structure, in units of a square's side; windows keep clear of it. blur: a guess, px.
    """

    def fit(places: Array, steps: Array) -> Fit:
        clear = np.abs(np.linalg.det(steps)) / np.linalg.norm(steps, axis=1).max(axis=1)
        reach = (_CLEAR * clear_of * clear).clip(_MIN_REACH, max(_MAX_REACH, _BLURS * blur))
        return fit_corners(gray, places, np.arctan2(steps[:, 1], steps[:, 0]), reach, blur=blur)

    return fitted_grid(cells, q, fit, gray.shape, alternating=True, staggered=False)


def corner_candidates(gray: Picture, smoothing: float) -> Corners:
    """Return the saddle points of a picture smoothed by a Gaussian of `smoothing` px that pass the ring test."""
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
        return np.asarray(smooth[y + dy, x + dx], dtype=np.float64)

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
    even = half.mean(axis=1)  # the part that opposite sides have in common
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
