"""Visibility of points among triangles by brute force in float64: independent reference for the fast code.

Every triangle whose box in the picture plane holds a point's image is tried against it, by signs of volumes. A triangle
hides a point if it meets the open segment to the eye and the point lies more than the tolerance off its plane.
"""

from __future__ import annotations

import numpy as np

CELLS = 96


def seen(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, eye: np.ndarray, tolerance: np.ndarray
) -> np.ndarray:
    """Return which points (N, 3) the eye (3,) sees; all of them lie in front of the plane through the eye."""
    corners = vertices[faces] - eye  # (F, 3, 3)
    points = points - eye
    axis = points.mean(axis=0)
    axis /= np.linalg.norm(axis)
    right = np.linalg.svd(axis[None])[2][1]
    frame = np.stack([right, np.cross(axis, right), axis])
    image = _flat(points @ frame.T)
    low, high = image.min(axis=0) - 1e-9, image.max(axis=0) + 1e-9
    first, last = _cells_of_triangles(corners @ frame.T, low, high)
    cell = np.clip(((image - low) / (high - low) * CELLS).astype(int), 0, CELLS - 1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    flat = area == 0
    normal = normal / np.where(flat, 1, area)[:, None]
    result = np.ones(len(points), bool)
    for row in range(CELLS):
        in_row = np.flatnonzero(cell[:, 1] == row)
        near_row = np.flatnonzero((first[:, 1] <= row) & (row <= last[:, 1]) & ~flat)
        for column in np.unique(cell[in_row, 0]):
            samples = in_row[cell[in_row, 0] == column]
            f = near_row[(first[near_row, 0] <= column) & (column <= last[near_row, 0])]
            result[samples] = ~_blocked(corners[f], normal[f], points[samples], tolerance[samples])
    return result


def _flat(p: np.ndarray) -> np.ndarray:
    return p[..., :2] / p[..., 2:]


def _cells_of_triangles(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest cell (F, 2) of each triangle; those reaching behind the eye cover everything."""
    behind = (corners[..., 2] <= 1e-6 * np.abs(corners).max()).any(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        image = (_flat(corners) - low) / (high - low) * CELLS
    first, last = np.floor(image.min(axis=1) - 1e-6), np.floor(image.max(axis=1) + 1e-6)
    first[behind], last[behind] = 0, CELLS
    return first, last


def _blocked(corners: np.ndarray, normal: np.ndarray, points: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Return which points some triangle hides from the origin."""
    anchor = np.einsum("fi,fi->f", normal, corners[:, 0])
    of_point = points @ normal.T - anchor  # heights of point and eye above each plane
    between = (np.abs(of_point) > tolerance[:, None]) & (of_point * -anchor < 0)
    sample, face = np.nonzero(between)
    p, (a, b, c) = points[sample], np.moveaxis(corners[face], 1, 0)
    volumes = [np.einsum("ni,ni->n", p, np.cross(x, y)) for x, y in ((a, b), (b, c), (c, a))]
    inside = np.all([v >= 0 for v in volumes], axis=0) | np.all([v <= 0 for v in volumes], axis=0)
    out = np.zeros(len(points), bool)
    out[sample[inside]] = True
    return out
