"""Symmetric 3x3 matrices packed as six numbers xx yy zz xy xz yz: operations on many, in closed form."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array


def packed(M: Array) -> Array:
    """Return the packed form (..., 6, T) of symmetric matrices (..., T, 3, 3), contiguous in T."""
    parts = [M[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return np.ascontiguousarray(np.stack(parts, axis=-2))


def determinant(S: Array) -> Array:
    """Return the determinants (..., T) of (..., 6, T)."""
    xx, yy, zz, xy, xz, yz = np.moveaxis(S, -2, 0)
    return np.asarray(xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz))


def inverse(S: Array, *, least: float) -> Array:
    """Return the inverses (6, ...) of (..., 6, T), whose eigenvalues are at least `least` despite rounding."""
    xx, yy, zz, xy, xz, yz = np.moveaxis(S, -2, 0)
    a, b, c = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
    det = np.maximum(xx * a + xy * b + xz * c, least * 1e-3 * np.maximum(a, 1e-300))
    return np.asarray(np.stack([a, xx * zz - xz * xz, xx * yy - xy * xy, b, c, xy * xz - xx * yz]) / det)


def largest(C: Array) -> Array:
    """Return the largest eigenvalue of symmetric matrices (6, ...), by the trigonometric solution of the cubic."""
    xx, yy, zz, xy, xz, yz = C
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    p = np.sqrt(np.maximum((a * a + b * b + c * c) / 6 + (xy * xy + xz * xz + yz * yz) / 3, 1e-200))
    half = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / (2 * p**3)
    return np.asarray(mean + 2 * p * np.cos(np.arccos(np.clip(half, -1, 1)) / 3))


def spanned(C: Array, basis: Array, rank: int) -> Array:
    """Return the largest variance within the first `rank` columns of a basis (T, 3, 3), of covariances (6, n, T)."""

    def form(u: Array, v: Array) -> Array:
        xx, yy, zz, xy, xz, yz = C
        return np.asarray(
            xx * (u[:, 0] * v[:, 0])
            + yy * (u[:, 1] * v[:, 1])
            + zz * (u[:, 2] * v[:, 2])
            + xy * (u[:, 0] * v[:, 1] + u[:, 1] * v[:, 0])
            + xz * (u[:, 0] * v[:, 2] + u[:, 2] * v[:, 0])
            + yz * (u[:, 1] * v[:, 2] + u[:, 2] * v[:, 1])
        )

    one = form(basis[:, :, 0], basis[:, :, 0])
    if rank == 1:
        return np.maximum(one, 1e-300)
    two, mixed = form(basis[:, :, 1], basis[:, :, 1]), form(basis[:, :, 0], basis[:, :, 1])
    return np.maximum((one + two) / 2 + np.hypot((one - two) / 2, mixed), 1e-300)
