"""Rotations as plain (..., 3, 3) arrays: exponential, logarithm, Jacobian, quaternions, the nearest rotation.

Formulas: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018), section on SO(3).
Every function broadcasts over leading axes.
"""

from __future__ import annotations

import math

import numpy as np

from cadcam.arrays import Array, Floats
from cadcam.errors import BadValue

EXACT = 1e-6  # largest deviation of R R^T from the identity for a rotation
_ROUNDED = 2e-3  # the same for one with three decimals: 2 sqrt(3) 0.0005 at most


def hat(w: Floats) -> Array:
    """Return the matrix of the cross product, `hat(w) @ v == cross(w, v)`; w (..., 3) -> (..., 3, 3)."""
    w = np.asarray(w, dtype=np.float64)
    out = np.zeros((*w.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return out


def cross(v: Array, w: Array) -> Array:
    """Return v x w of two vectors (3,), bit by bit as `numpy.cross`, which takes twenty times as long for two."""
    (a, b, c), (x, y, z) = v.tolist(), w.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def exp(w: Floats) -> Array:
    """Return the rotation by |w| rad about w (Rodrigues); w (..., 3) -> (..., 3, 3)."""
    w = np.asarray(w, dtype=np.float64)
    W = hat(w)
    if w.ndim == 1:
        sine, versine, _ = _of_one(w)
        return np.eye(3) + sine * W + versine * (W @ W)
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    return np.eye(3) + _sin_over(theta) * W + _versine_over(theta) * (W @ W)


def log(R: Floats) -> Array:
    """Return the rotation vector of R in rad, |w| <= pi; R (..., 3, 3) -> (..., 3).

    Taken through the quaternion, so it keeps full precision near 0 and near pi.
    """
    q = quaternion(R)
    vector, scalar = q[..., 1:], q[..., 0]
    length = np.linalg.norm(vector, axis=-1)
    angle = 2.0 * np.arctan2(length, scalar)
    small = length < 1e-12
    factor = np.where(small, 2.0, angle / np.where(small, 1.0, length))
    return factor[..., None] * vector


def exp_and_left_jacobian(w: Floats) -> tuple[Array, Array]:
    """Return exp(w) and J with exp(w + d) = exp(J d) exp(w) to first order; w (..., 3) -> (..., 3, 3) each.

    They share most of their terms. J is also the V of the rigid motion's exponential.
    """
    w = np.asarray(w, dtype=np.float64)
    sine, versine, rest = _of_one(w) if w.ndim == 1 else _of_many(w)
    W = hat(w)
    WW, one = W @ W, np.eye(3)
    return one + sine * W + versine * WW, one + versine * W + rest * WW


def inverse_left_jacobian(w: Floats) -> Array:
    """Return the inverse (..., 3, 3) of the J of `exp_and_left_jacobian(w)`; finite for |w| < 2 pi."""
    w = np.asarray(w, dtype=np.float64)
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    W = hat(w)
    small = theta < 1e-4
    t = np.where(small, 1.0, theta)
    exact = (1.0 - 0.5 * t * np.cos(t / 2) / np.sin(t / 2)) / t**2
    return np.asarray(np.eye(3) - 0.5 * W + np.where(small, 1 / 12 + theta**2 / 720, exact) * (W @ W))


def quaternion(R: Floats) -> Array:
    """Return the unit quaternion (w, x, y, z), w >= 0, of R; (..., 3, 3) -> (..., 4).

    Shepperd (1978): of four equivalent forms the one with the largest pivot is used.
    """
    R = np.asarray(R, dtype=np.float64)
    r = [[R[..., i, j] for j in range(3)] for i in range(3)]
    d0, d1, d2 = r[0][0], r[1][1], r[2][2]
    a, b, c = r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]
    d, e, f = r[0][1] + r[1][0], r[0][2] + r[2][0], r[1][2] + r[2][1]
    pivots = np.stack([1 + d0 + d1 + d2, 1 + d0 - d1 - d2, 1 - d0 + d1 - d2, 1 - d0 - d1 + d2], axis=-1)
    columns = [(pivots[..., 0], a, b, c), (a, pivots[..., 1], d, e), (b, d, pivots[..., 2], f)]
    columns.append((c, e, f, pivots[..., 3]))
    candidates = np.stack([np.stack(np.broadcast_arrays(*column), axis=-1) for column in columns], axis=-2)
    best = np.argmax(pivots, axis=-1)[..., None, None]
    q = np.take_along_axis(candidates, best, axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0, -q, q))


def from_quaternion(q: Floats) -> Array:
    """Return the rotation of the quaternion (w, x, y, z), normalised first; (..., 4) -> (..., 3, 3)."""
    given = np.asarray(q, dtype=np.float64)
    length = np.linalg.norm(given, axis=-1, keepdims=True)
    if not np.all(length > 0):
        raise BadValue("quaternion", given, "four numbers, not all zero")
    unit = given / length
    V = hat(unit[..., 1:])
    return np.asarray(np.eye(3) + 2.0 * unit[..., :1, None] * V + 2.0 * (V @ V))


def written(R: Floats, *, exact: float = EXACT) -> Array:
    """Return rotations (..., 3, 3) given to three decimals or more, made orthonormal.

    One that is orthonormal to within `exact` is returned unchanged, bit by bit. Raises `BadValue` for deviations that
    rounding does not explain: a scale, a reflection, a singular matrix.
    """
    R = np.asarray(R, dtype=np.float64)
    off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    wrong = ~((off <= _ROUNDED) & (np.linalg.det(R) > 0))
    if wrong.any():
        at = np.argmax(wrong)
        which = f"rotation matrix {at + 1}" if R.ndim > 2 else "rotation"
        raise BadValue(
            which,
            misfit(float(off.flat[at])),
            "an orthonormal, right-handed 3x3 matrix, three decimals at least",
        )
    return np.asarray(np.where((off <= exact)[..., None, None], R, nearest(R)))


def misfit(off: float, *, exact: float = _ROUNDED) -> str:
    """Return the description of a matrix that is no rotation: off by `off`, or, if that is nothing, mirrored."""
    return f"off a rotation by {off:.2g}" if off > exact else "mirrored (its determinant is negative)"


def nearest(M: Floats) -> Array:
    """Return the rotation nearest to M in the Frobenius norm (Arun 1987, through the SVD); (..., 3, 3)."""
    U, _, Vt = np.linalg.svd(np.asarray(M, dtype=np.float64))
    sign = np.linalg.det(U @ Vt)
    U = np.concatenate([U[..., :2], U[..., 2:] * sign[..., None, None]], axis=-1)
    return np.asarray(U @ Vt)


def _sin_over(theta: Array) -> Array:
    return np.sinc(theta / np.pi)


def _versine_over(theta: Array) -> Array:
    """(1 - cos t) / t^2 without cancellation."""
    return 0.5 * np.sinc(theta / (2 * np.pi)) ** 2


def _theta_minus_sin_over(theta: Array) -> Array:
    """(t - sin t) / t^3; the series below t = 0.01, where its next term is under 1e-16."""
    small = np.abs(theta) < 1e-2
    t = np.where(small, 1.0, theta)
    t2 = theta**2
    return np.asarray(np.where(small, 1 / 6 - t2 / 120 + t2**2 / 5040, (t - np.sin(t)) / t**3))


def _of_many(w: Array) -> tuple[Array, Array, Array]:
    """Return sin t / t, (1 - cos t) / t^2, (t - sin t) / t^3 (..., 1, 1) of t = |w|."""
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    return _sin_over(theta), _versine_over(theta), _theta_minus_sin_over(theta)


def _of_one(w: Array) -> tuple[float, float, float]:
    """Return the same numbers for a single vector: motions are made one at a time in inner loops."""
    t = math.hypot(*w.tolist())
    if t < 1e-2:  # series, as above
        t2 = t * t
        return 1 - t2 / 6 + t2**2 / 120 - t2**3 / 5040, 0.5 - t2 / 24 + t2**2 / 720, 1 / 6 - t2 / 120 + t2**2 / 5040
    return math.sin(t) / t, 0.5 * (math.sin(t / 2) / (t / 2)) ** 2, (t - math.sin(t)) / t**3
