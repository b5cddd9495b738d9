"""Maps from plane to plane from weighted points, many at a time: similarity, affine map, perspective.

One call fits B maps: p and q are (B, k, 2), w (B, k), and the results are matrices H (B, 3, 3) with
(q, 1) ~ H (p, 1), scaled so that the third coordinate is positive at the points' centre. Points of weight 0 do not
count, so that batches may mix numbers of points. For one map with its covariance see `calibrate.points.flat`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np

from cadcam.arrays import Array

Fitter: TypeAlias = Callable[[Array, Array, Array], Array]
_TINY = 1e-12


def similarities(p: Array, q: Array, w: Array) -> Array:
    """Return scale, rotation, shift, and a reflection where that fits better: least sum of w |q - H p|^2."""
    pc, qc, pm, qm = _centred(p, q, w)
    zp, zq = pc[..., 0] + 1j * pc[..., 1], qc[..., 0] + 1j * qc[..., 1]
    size = np.maximum((w * np.abs(zp) ** 2).sum(axis=1), _TINY)
    kept, mirrored = ((w * zq * z.conj()).sum(axis=1) / size for z in (zp, zp.conj()))
    flip = np.abs(mirrored) > np.abs(kept)
    a = np.where(flip, mirrored, kept)
    s = np.where(flip, -1.0, 1.0)
    A = np.stack([np.stack([a.real, -s * a.imag], -1), np.stack([a.imag, s * a.real], -1)], -2)
    return _shifted(A, pm, qm)


def affinities(p: Array, q: Array, w: Array) -> Array:
    """Return affine maps: least sum of w |q - H p|^2."""
    pc, qc, pm, qm = _centred(p, q, w)
    wp = np.swapaxes(pc * w[..., None], 1, 2)
    moments = wp @ pc
    moments += np.eye(2) * (_TINY * np.trace(moments, axis1=1, axis2=2) + 1e-300)[:, None, None]
    return _shifted(np.swapaxes(np.linalg.solve(moments, wp @ qc), 1, 2), pm, qm)


def perspectives(p: Array, q: Array, w: Array) -> Array:
    """Return homographies: the linear solution in centred and scaled coordinates (Hartley and Zisserman, alg. 4.2)."""
    ps, S = _normalised(p, w)
    qs, T = _normalised(q, w)
    one = np.concatenate([ps, np.ones((*ps.shape[:-1], 1))], axis=-1)
    rows = np.zeros((*ps.shape[:-1], 2, 9))
    rows[..., 0, 0:3] = rows[..., 1, 3:6] = one
    rows[..., 6:9] = -qs[..., None] * one[..., None, :]
    rows *= np.sqrt(w)[..., None, None]
    flat = rows.reshape(len(p), -1, 9)
    _, vectors = np.linalg.eigh(np.swapaxes(flat, 1, 2) @ flat)
    H = np.linalg.inv(T) @ vectors[..., 0].reshape(-1, 3, 3) @ S
    return _facing(H, p, w)


FITTERS: Final[dict[str, tuple[Fitter, int]]] = {
    "similarity": (similarities, 4),
    "affine": (affinities, 6),
    "perspective": (perspectives, 8),
}
"""Each kind of map and the number of its parameters, the simplest first."""


def mapped(H: Array, p: Array) -> Array:
    """Return the images (..., k, 2) of points (..., k, 2) under maps (..., 3, 3); NaN beyond the horizon."""
    u = p @ np.swapaxes(H[..., :2], -1, -2) + H[..., None, :, 2]
    with np.errstate(all="ignore"):
        return np.asarray(u[..., :2] / np.where(u[..., 2:] > 0, u[..., 2:], np.nan))


def depths(H: Array, p: Array) -> Array:
    """Return the third coordinate (..., k) at points (..., k, 2): proportional to their distance from the camera."""
    return np.asarray((p @ H[..., 2, :2, None])[..., 0] + H[..., 2, 2, None])


def _centred(p: Array, q: Array, w: Array) -> tuple[Array, Array, Array, Array]:
    total = np.maximum(w.sum(axis=1), _TINY)[:, None]
    pm, qm = ((x * w[..., None]).sum(axis=1) / total for x in (p, q))
    return p - pm[:, None], q - qm[:, None], pm, qm


def _shifted(A: Array, pm: Array, qm: Array) -> Array:
    H = np.zeros((len(A), 3, 3))
    H[:, :2, :2] = A
    H[:, :2, 2] = qm - (A @ pm[..., None])[..., 0]
    H[:, 2, 2] = 1.0
    return H


def _normalised(x: Array, w: Array) -> tuple[Array, Array]:
    total = np.maximum(w.sum(axis=1), _TINY)[:, None]
    mean = (x * w[..., None]).sum(axis=1) / total
    away = x - mean[:, None]
    spread = np.sqrt((w[..., None] * away**2).sum(axis=(1, 2))[:, None] / (2 * total))
    scale = 1 / np.where(spread > 0, spread, 1.0)
    S = np.zeros((len(x), 3, 3))
    S[:, 0, 0] = S[:, 1, 1] = scale[:, 0]
    S[:, :2, 2] = -mean * scale
    S[:, 2, 2] = 1.0
    return away * scale[..., None], S


def _facing(H: Array, p: Array, w: Array) -> Array:
    total = np.maximum(w.sum(axis=1), _TINY)[:, None]
    middle = (p * w[..., None]).sum(axis=1) / total
    depth = (H[:, 2, :2] * middle).sum(axis=1) + H[:, 2, 2]
    return np.asarray(H / np.where(depth == 0, 1.0, depth)[:, None, None])
