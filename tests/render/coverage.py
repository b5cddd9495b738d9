"""Which triangle each pixel centre sees, by brute force: the judge of all renderers.

Shares nothing with them but the meaning of a camera: every triangle that may be in a square of pixels is tried at each
of their rays, by signs of volumes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid

SIDE = 8  # px of a square


def brute_force(
    vertices: np.ndarray, faces: np.ndarray, camera: Camera, pose: Rigid, *, number: Any = np.longdouble
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return face (H, W) seen (-1 = none), its 1/z, and that of the next face behind (0 = none)."""
    ray = camera.unproject(camera.pixel_grid()).astype(number)
    d = ray / ray[..., 2:]
    p = (vertices.astype(number) @ pose.rotation.T.astype(number) + pose.translation)[faces]
    x0, y0, x1, y1 = _boxes(p)
    edges, inverse_depth = _planes(p)
    shape = d.shape[:2]
    face, best, second = np.full(shape, -1), np.zeros(shape, number), np.zeros(shape, number)
    for y, x in np.ndindex(-(-shape[0] // SIDE), -(-shape[1] // SIDE)):
        square = np.s_[y * SIDE : (y + 1) * SIDE, x * SIDE : (x + 1) * SIDE]
        rays = d[square].reshape(-1, 3)
        u = rays[np.isfinite(rays[:, 0]), :2]
        if not len(u):
            continue
        (left, top), (right, bottom) = u.min(axis=0), u.max(axis=0)
        near = np.flatnonzero((x0 <= right) & (x1 >= left) & (y0 <= bottom) & (y1 >= top))
        found = _nearest(rays, near, edges, inverse_depth)
        face[square], best[square], second[square] = (layer.reshape(face[square].shape) for layer in found)
    return face, best, second


def _boxes(p: np.ndarray) -> np.ndarray:
    """Return the least x/z, y/z and the largest (4, F) of triangles p (F, 3, 3): all if the focal plane cuts one."""
    with np.errstate(divide="ignore", invalid="ignore"):
        u = p[..., :2] / p[..., 2:]
    low, high = u.min(axis=1) - 1e-9, u.max(axis=1) + 1e-9
    cut, behind = (p[..., 2] <= 0).any(axis=1), (p[..., 2] <= 0).all(axis=1)
    low[cut], high[cut] = -np.inf, np.inf
    low[behind] = np.inf
    return np.ascontiguousarray(np.concatenate([low, high], axis=1).T)


def _planes(p: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the inward planes (F, 3) through the eye and each edge, and n (F, 3) with 1/z = n . ray: 0 edge-on."""
    a, b, c = np.moveaxis(p, 1, 0)
    normal = np.cross(b - a, c - a)
    whole = np.einsum("fi,fi->f", normal, a)[:, None]
    edges = [np.cross(*pair) * np.sign(whole) for pair in ((b, c), (c, a), (a, b))]
    return edges, normal / np.where(whole == 0, np.inf, whole)


def _nearest(
    d: np.ndarray, face: np.ndarray, edges: list[np.ndarray], inverse_depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest (N,) of some faces along each ray d (N, 3), its 1/z, and that of the next."""
    inside = np.full((len(d), len(face)), True)
    for n in edges:
        inside &= _products(d, n[face]) > 0
        hit = inside.any(axis=0)
        inside, face = inside[:, hit], face[hit]
    if not len(face):
        return np.full(len(d), -1), *np.zeros((2, len(d)), d.dtype)
    w = np.where(inside, _products(d, inverse_depth[face]), 0)
    row, first = np.arange(len(d)), w.argmax(axis=1)
    best = w[row, first]
    w[row, first] = 0
    return np.where(best > 0, face[first], -1), best, w.max(axis=1)


def _products(d: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return the scalar products (N, F) of d (N, 3) and n (F, 3), summed in one order whatever their number."""
    return d[:, :1] * n[:, 0] + d[:, 1:2] * n[:, 1] + d[:, 2:] * n[:, 2]
