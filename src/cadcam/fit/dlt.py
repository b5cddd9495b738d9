"""The direct linear transform, 3D to 2D: the 3x4 matrix of a camera from points, without guess or iteration."""

from __future__ import annotations

from typing import Literal

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.extended_pinhole import uv_from_pixel_matrix, uv_from_pixels
from cadcam.errors import DegenerateGeometry, TooFewPoints, UnknownName
from cadcam.fit.layout import distinct, refuse_flat

Form = Literal["normalised", "c23"]
FORMS: tuple[Form, ...] = ("normalised", "c23")
_RANK = 1e-10  # of twelve normalised columns; rounding leaves about 1e-15


def dlt(p_world: Array, q: Array, *, form: Form = "normalised") -> Array:
    """Return P (3, 4) with (x, y, 1) ~ P (X, Y, Z, 1) for pixels q = (x, y) of world points in mm, N >= 6.

    "normalised": least |A P| over |P| = 1 in coordinates centred and scaled on both sides (Hartley and Zisserman,
    "Multiple View Geometry", algorithm 4.1, its linear part); invariant to units and origins. "c23": the thesis' form,
    the entry that multiplies 1 in the last row set to 1 and the rest by linear least squares on raw numbers (EQ
    2.62-2.65), solved by an orthogonal factorisation in place of the normal equations; its answer depends on the
    world's origin. Raises `TooFewPoints`, or `DegenerateGeometry` with the numbers for points on a line, on a plane,
    or otherwise blind.
    """
    if form not in FORMS:
        raise UnknownName("form of the direct linear transform", form, FORMS)
    if distinct(p_world) < 6:
        raise TooFewPoints("the direct linear transform (different world points)", distinct(p_world), 6)
    refuse_flat(p_world, unknowns=11)
    return _normalised(p_world, q) if form == "normalised" else _c23(p_world, q)


def _normalised(p_world: Array, q: Array) -> Array:
    S, T = _similarity(p_world), _similarity(q)
    X, u = _apply(S, p_world), _apply(T, q)
    one, zero = np.column_stack([X, np.ones(len(X))]), np.zeros((len(X), 4))
    A = np.concatenate(
        [np.column_stack([one, zero, -u[:, :1] * one]), np.column_stack([zero, one, -u[:, 1:] * one])], axis=0
    )
    _, s, Vt = np.linalg.svd(A, full_matrices=False)  # twelve rows at least: Vt is whole
    _refuse_blind(s)
    return np.asarray(np.linalg.inv(T) @ Vt[-1].reshape(3, 4) @ S)


def _c23(p_world: Array, q: Array) -> Array:
    UV = uv_from_pixels(q)
    one, zero = np.column_stack([p_world, np.ones(len(q))]), np.zeros((len(q), 4))
    A = np.zeros((2 * len(q), 11))
    A[0::2] = np.column_stack([one, zero, -UV[:, :1] * p_world])
    A[1::2] = np.column_stack([zero, one, -UV[:, 1:] * p_world])
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    x, _, _, s = np.linalg.lstsq(A / scale, UV.ravel(), rcond=1e-15)
    if s[-1] <= 1e-15 * s[0]:
        raise DegenerateGeometry(
            f"the C23 = 1 form cannot be solved here (singular value ratio {s[-1] / s[0]:.2g}); use the normalised form"
        )
    return np.asarray(uv_from_pixel_matrix(np.append(x / scale, 1.0).reshape(3, 4)))


def _refuse_blind(s: Array) -> None:
    if s[10] <= _RANK * s[0]:
        raise DegenerateGeometry(
            f"the points leave more than one camera matrix possible (singular value ratio {s[10] / s[0]:.2g}): they "
            f"lie "
            "with the camera's centre on a common cubic curve, or on a plane and a line through it; add points "
            "elsewhere"
        )


def _similarity(x: Array) -> Array:
    """Return the homogeneous matrix that moves the centroid of x (N, d) to 0 and the mean distance to sqrt(d)."""
    centre = x.mean(axis=0)
    mean = np.linalg.norm(x - centre, axis=1).mean()
    d = x.shape[1]
    scale = np.sqrt(d) / mean if mean > 0 else 1.0
    out = np.diag([*([scale] * d), 1.0])
    out[:d, d] = -scale * centre
    return out


def _apply(H: Array, x: Array) -> Array:
    return np.asarray(x @ H[:-1, :-1].T + H[:-1, -1])
