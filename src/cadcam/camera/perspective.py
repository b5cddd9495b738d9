"""The perspective division, its Jacobian and its inverse: shared by the lenses that distort a plane."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Floats, component_major


def perspective(p: Floats) -> Array:
    """Return u = (x, y)/z (..., 2) of p (..., 3); NaN for z <= 0."""
    return perspective_and_scale(p)[0]


def perspective_and_scale(p: Floats) -> tuple[Array, Array]:
    """Return u = (x, y)/z (..., 2) and 1/z (...,), NaN for z <= 0."""
    p = np.asarray(p, dtype=np.float64)
    z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
    return np.asarray(p[..., :2] / z[..., None]), 1 / z


def by_point(dm_du: Array, u: Array, over_z: Array) -> Array:
    """Return dm/dp (..., 2, 3) of dm/du (..., 2, 2): du/dp = [[1, 0, -ux], [0, 1, -uy]]/z."""
    out = component_major(u.shape[:-1], 2, 3)
    np.multiply(dm_du, over_z[..., None, None], out=out[..., :2])
    np.multiply(out[..., 0], -u[..., :1], out=out[..., 2])
    out[..., 2] -= out[..., 1] * u[..., 1:]
    return out


def direction(u: Array) -> Array:
    """Return the unit direction (..., 3) of (ux, uy, 1)."""
    z = 1 / np.sqrt(1 + u[..., :1] ** 2 + u[..., 1:] ** 2)
    return np.concatenate([u * z, z], axis=-1)
