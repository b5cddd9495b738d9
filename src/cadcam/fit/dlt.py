"""The direct linear transform: the matrix of a camera of any dimension from points, without a guess or iteration.

3D to 2D (3x4), plane to picture (3x3) and plane to line (2x3) differ only in the number of coordinates: every image
coordinate of a point is one equation that is linear in the matrix.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import DegenerateGeometry, TooFewPoints
from cadcam.fit.extents import distinct, refuse_flat
from cadcam.kinds import expect_known

Form = Literal["normalised", "c23"]
FORMS: tuple[Form, ...] = ("normalised", "c23")
_RANK = 1e-10  # of the normalised columns; rounding leaves about 1e-15
_WORDS = {(3, 2): "camera", (2, 2): "plane", (2, 1): "line camera"}


def dlt(p_world: Array, q: Array, *, form: Form = "normalised") -> Array:
    """Return P (e+1, d+1) with (q, 1) ~ P (p, 1) for image points q (N, e) of world points p (N, d) in mm.

    (d, e) is (3, 2) for a camera in space (N >= 6), (2, 2) for a plane (N >= 4), (2, 1) for a line camera (N >= 5).
    "normalised": least |A P| over |P| = 1 in coordinates centred and scaled on both sides (Hartley and Zisserman,
    "Multiple View Geometry", algorithm 4.1, its linear part); invariant to units and origins. "c23": the thesis' form,
    the last entry of P set to 1 and the rest by linear least squares on raw numbers (EQ 2.7-2.9, 2.62-2.65, 6.5-6.7),
    solved by an orthogonal factorisation in place of the normal equations; its answer depends on the world's origin.
    The sign of P is that of its last entry, or arbitrary. Raises `TooFewPoints`, or `DegenerateGeometry` with the
    numbers for points on a line, in space on a plane, or otherwise blind.
    """
    expect_known(form, "form of the direct linear transform", FORMS)
    d, e = p_world.shape[1], q.shape[1]
    unknowns = (d + 1) * (e + 1) - 1
    need = -(-unknowns // e)
    if distinct(p_world) < need:
        raise TooFewPoints(
            f"the direct linear transform of a {_WORDS[d, e]} (different world points)", distinct(p_world), need
        )
    refuse_flat(p_world, unknowns=unknowns)
    return _normalised(p_world, q) if form == "normalised" else _last_is_one(p_world, q)


def _normalised(p_world: Array, q: Array) -> Array:
    S, T = _similarity(p_world), _similarity(q)
    A = _equations(_apply(S, p_world), _apply(T, q))
    missing = A.shape[1] - A.shape[0]
    if missing > 0:  # as many equations as unknowns: the last row of Vt is their null vector
        A = np.concatenate([A, np.zeros((missing, A.shape[1]))])
    _, s, Vt = np.linalg.svd(A, full_matrices=False)
    _refuse_blind(s, (p_world.shape[1], q.shape[1]))
    return np.asarray(np.linalg.inv(T) @ Vt[-1].reshape(len(T), len(S)) @ S)


def _last_is_one(p_world: Array, q: Array) -> Array:
    A = _equations(p_world, q)
    scale = np.linalg.norm(A[:, :-1], axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    x, _, _, s = np.linalg.lstsq(A[:, :-1] / scale, -A[:, -1], rcond=1e-15)
    if s[-1] <= 1e-15 * s[0]:
        raise DegenerateGeometry(
            f"the C23 = 1 form cannot be solved here (singular value ratio {s[-1] / s[0]:.2g}); use the normalised form"
        )
    return np.append(x / scale, 1.0).reshape(q.shape[1] + 1, p_world.shape[1] + 1)


def _equations(p: Array, q: Array) -> Array:
    """Return A (eN, (e+1)(d+1)): P_j . (p, 1) - q_j P_e . (p, 1) = 0 for every image coordinate j."""
    one = np.column_stack([p, np.ones(len(p))])
    n, e = one.shape[1], q.shape[1]
    A = np.zeros((e, len(p), (e + 1) * n))
    for j in range(e):
        A[j, :, j * n : (j + 1) * n] = one
        A[j, :, e * n :] = -q[:, j : j + 1] * one
    return A.reshape(e * len(p), (e + 1) * n)


def _refuse_blind(s: Array, dimensions: tuple[int, int]) -> None:
    if s[-2] <= _RANK * s[0]:
        where = {
            (3, 2): "with the camera's centre on a common cubic curve, or on a plane and a line through it",
            (2, 2): "all but one on a line, or there are only three of them and repeats",
            (2, 1): "with the camera's centre on a common conic, or all but one on a line",
        }[dimensions]
        raise DegenerateGeometry(
            f"the points leave more than one camera matrix possible (singular value ratio {s[-2] / s[0]:.2g}): they "
            f"lie {where}; add points elsewhere"
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
