"""The winding number of a closed surface about a point: one inside, zero outside."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array


def winding_number(corners: Array, point: Array) -> float:
    """Return the winding number of triangles (F, 3, 3) about a point (3,): 1 inside a closed outward surface, else 0.

    The sum of their signed solid angles over 4 pi, after Van Oosterom and Strackee, "The solid angle of a plane
    triangle" (1983). -1 inside a surface wound inwards; an open surface gives a fraction.
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    return float(np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi))
