"""Discs in a picture: elliptic blobs, joined to a lattice and fitted to the grey values.

What is measured is the centre of the disc's *image*. Under perspective and distortion that is not the image of the
disc's centre (Heikkila, PAMI 22, 2000); `disc_shift` gives the difference, for any lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Mask, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.target.boards.grid import Grid, fitted_grid, local_steps
from cadcam.target.boards.lattice import grown, straightened
from cadcam.target.boards.photometric import Fit, fit_discs
from cadcam.target.boards.pyramid import reduced

_LEAST_AREA = 10.0  # px
_FAINT = 0.12  # contrast, relative to the picture's own
_ROUND = 0.15  # largest relative difference of a blob's area from that of the ellipse with its moments
_LONG = 5.0  # largest ratio of the ellipse's axes
_MOST = 8000
_INTO_GAP, _TO_NEIGHBOUR = 0.7, 0.95  # of the gap between discs, that the fitted window covers; and at most
_LEAST_MARGIN, _MOST_MARGIN = 1.5, 6.0  # px: limits of the window's margin
_RINGS, _SPOKES = 4, 12  # of the quadrature over a disc: exact for polynomials of degree 7


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Elliptic blobs: centroids q (M, 2) px, areas (M,) px^2, second moments (M, 2, 2) px^2."""

    q: Array
    area: Array
    moments: Array


def disc_grid(
    gray: Picture, *, window: float, light: bool, staggered: bool, enough: int, scale: float = 1.0
) -> Grid | None:
    """Return the largest grid of discs in a picture, dark ones or light ones, or None.

    window: the neighbourhood in which dark and light are separated, larger than a disc; share of the longer side.
    """
    small, full = reduced(gray, scale)
    blobs = elliptic_blobs(small, round(window * max(small.shape)), light=light)
    if len(blobs.q) < 4:
        return None
    lattice = grown(blobs.q, _seeds(blobs), enough=enough, sizes=np.sqrt(blobs.area))
    if lattice is None:
        return None
    q, cells = full(blobs.q[lattice.marks]), straightened(lattice.cells, staggered=staggered)
    moments = blobs.moments[lattice.marks] * (gray.shape[0] / small.shape[0]) ** 2
    share = _radius_by_step(moments, local_steps(q, cells))
    return fitted_discs(gray, cells, q, share, light=light, staggered=staggered)


def fitted_discs(gray: Picture, cells: Ids, q: Array, radius: float, *, light: bool, staggered: bool) -> Grid | None:
    """Return the discs near q (N, 2) at `cells` of their grid, fitted and completed; radius: over a cell's side."""
    nearest = np.sqrt(2.0) if staggered else 1.0

    def fit(places: Array, steps: Array) -> Fit:
        moments = radius**2 / 4 * steps @ np.swapaxes(steps, 1, 2)
        minor = radius * np.linalg.svd(steps, compute_uv=False)[:, 1]
        gap = (nearest - 2 * radius) / radius  # to the neighbour's border, in radii
        margin = np.minimum(_INTO_GAP * gap, _MOST_MARGIN / minor).clip(_LEAST_MARGIN / minor)
        return fit_discs(gray, places, moments, 1 + np.minimum(margin, _TO_NEIGHBOUR * gap))

    grid = fitted_grid(cells, q, fit, gray.shape, alternating=False, staggered=staggered)
    if grid is None:
        return None
    right = (grid.fit.parameters[:, 4] > 0) == light
    return grid.subset(right) if right.sum() >= 4 else None


def radius_by_cell(grid: Grid) -> float:
    """Return the discs' radius in units of a cell's side, from the fitted ellipses."""
    p = grid.fit.parameters
    A = np.stack([np.stack([p[:, 2], p[:, 3]], axis=-1), np.stack([p[:, 3], p[:, 9]], axis=-1)], axis=-1)
    return _radius_by_step(np.linalg.inv(A) / 4, local_steps(grid.fit.q, grid.cells))


def _radius_by_step(moments: Array, steps: Array) -> float:
    """Return r from moments = r^2/4 S S^T, the median over all marks."""
    cell = np.abs(np.linalg.det(steps))
    flat = cell <= 1e-9
    ratio = np.sqrt(np.linalg.det(moments).clip(0)) / np.where(flat, np.inf, cell)
    return float(2 * np.sqrt(np.median(ratio)))


def elliptic_blobs(gray: Picture, window: int, *, light: bool) -> Blobs:
    """Return the elliptic blobs, thresholded midway between the least and greatest value within `window` px."""
    from scipy.ndimage import gaussian_filter, label, maximum_filter, minimum_filter

    smooth = gaussian_filter(gray, 0.7)
    low, high = minimum_filter(smooth, window), maximum_filter(smooth, window)
    low, high = _softened(low, window / 4), _softened(high, window / 4)
    contrast = np.percentile(smooth, 99) - np.percentile(smooth, 1)
    middle, clear = (low + high) / 2, (high - low) > _FAINT * contrast
    number, count = label(clear & ((smooth > middle) if light else (smooth < middle)))
    return _ellipses(np.asarray(number), int(count))


def _softened(field: Picture, sigma: float) -> Picture:
    """Return a field smoothed by a Gaussian, computed only on every few rows and columns, as sigma allows."""
    from scipy.ndimage import gaussian_filter

    step = max(1, int(sigma / 4))
    soft = gaussian_filter(field[::step, ::step], sigma / step)
    for axis in (0, 1):
        place = np.minimum(np.arange(field.shape[axis]) / step, soft.shape[axis] - 1)
        first = np.minimum(place.astype(int), max(soft.shape[axis] - 2, 0))
        share = (place - first).astype(np.float32).reshape((-1, 1) if axis == 0 else (1, -1))
        after = np.minimum(first + 1, soft.shape[axis] - 1)
        soft = np.take(soft, first, axis) * (1 - share) + np.take(soft, after, axis) * share
    return np.asarray(soft, np.float32)


def _ellipses(number: Ids, count: int) -> Blobs:
    y, x = np.nonzero(number)
    k = number[y, x] - 1
    area = np.bincount(k, minlength=count).astype(np.float64)
    cx, cy = (np.bincount(k, v, count) / np.maximum(area, 1) for v in (x, y))
    dx, dy = x - cx[k], y - cy[k]
    xx, xy, yy = (np.bincount(k, v, count) / np.maximum(area, 1) for v in (dx * dx, dx * dy, dy * dy))
    moments = np.stack([np.stack([xx + 1 / 12, xy], axis=-1), np.stack([xy, yy + 1 / 12], axis=-1)], axis=-1)
    edge = np.bincount(k, (x == 0) | (y == 0) | (x == number.shape[1] - 1) | (y == number.shape[0] - 1), count) > 0
    good = ~edge & (area >= _LEAST_AREA) & _elliptic(area, moments)
    index = np.flatnonzero(good)[np.argsort(-area[good], kind="stable")][:_MOST]
    return Blobs(np.column_stack([cx, cy])[index], area[index], moments[index])


def _elliptic(area: Array, moments: Array) -> Mask:
    det = np.maximum(np.linalg.det(moments), 1e-12)
    trace = moments[:, 0, 0] + moments[:, 1, 1]
    fill = area / (4 * np.pi * np.sqrt(det))
    ratio = np.sqrt((trace + np.sqrt(np.maximum(trace**2 - 4 * det, 0))) ** 2 / (4 * det))  # of the semi-axes
    return np.asarray((np.abs(fill - 1) < _ROUND) & (ratio < _LONG))


def _seeds(blobs: Blobs) -> list[tuple[int, Array]]:
    """Return blobs with their two shortest steps, those around which the lattice is already visible first."""
    from scipy.spatial import cKDTree

    tree = cKDTree(blobs.q)
    count = min(9, len(blobs.q))
    near = np.asarray(tree.query(blobs.q, count)[1])
    seeds: list[tuple[int, int, Array]] = []
    for i in range(len(blobs.q)):
        away = blobs.q[near[i, 1:]] - blobs.q[i]
        length = np.hypot(away[:, 0], away[:, 1])
        sine = np.abs(away[:, 0] * away[0, 1] - away[:, 1] * away[0, 0]) / (length * length[0])
        across = np.flatnonzero(sine > 0.4)
        if not across.size:
            continue
        pair = np.array([away[0], away[across[0]]])
        expected = blobs.q[i] + np.concatenate([pair, -pair, [pair.sum(axis=0), -pair.sum(axis=0)]])
        distance, _ = tree.query(expected)
        seeds.append((int((distance < 0.25 * length[0]).sum()), i, pair))
    seeds.sort(key=lambda s: -s[0])
    return [(i, pair) for _, i, pair in seeds[:200]]


def disc_shift(camera: Camera, camera_from_board: Rigid, centres: Array, radius_mm: float) -> Array:
    """Return the offset (N, 2) px of the centres of the discs' images from the images of their centres (N, 3) mm.

    The former is the centroid of the image: the integral of q over the disc, weighted with the image's area element. To
    first order in the curvature of the projection it is also the centre of the ellipse that fits the border best.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_RINGS)
    r = np.sqrt((nodes + 1) / 2) * radius_mm  # equal areas
    turn = (np.arange(_SPOKES) + 0.5) * (2 * np.pi / _SPOKES)
    within = np.stack([np.outer(r, np.cos(turn)), np.outer(r, np.sin(turn)), np.zeros((_RINGS, _SPOKES))], axis=-1)
    weight = np.repeat(weights, _SPOKES)
    points = centres[:, None] + within.reshape(-1, 3)
    q, J = camera.project_with_jacobian(camera_from_board @ points)
    area = np.abs(np.linalg.det(J @ camera_from_board.rotation[:, :2])) * weight
    mean = np.sum(q * area[..., None], axis=1) / np.sum(area, axis=1)[:, None]
    return np.asarray(mean - camera.project(camera_from_board @ centres))
