"""What the dissertation's programs calib (Prog 4) and bilinear (Prog 6) computed, as printed."""

from __future__ import annotations

import numpy as np


def column_scales(C):
    """Return calib's scales x and y mm/px, aspect and angle of the columns in rad of a (U, V) matrix.

    These are norms of the matrix' columns, right only where C22 = 1 stands for t = 1 at the plate.
    """
    M = np.asarray(C)[:2, :2]
    nx, ny = np.linalg.norm(M, axis=0)
    return 1 / nx, 1 / ny, ny / nx, np.arccos(M[:, 0] @ M[:, 1] / (nx * ny))


def rectangle_shares(one, opposite, at):
    """Return (s, t), a position's coordinates in the upright rectangle between two corners."""
    return (np.array(at) - one) / (np.array(opposite) - one)


def rectangle_weights(s, t):
    """Return the weights (4,) of the corners (0, 0), (0, 1), (1, 0), (1, 1) at (s, t)."""
    return np.array([(1 - s) * (1 - t), (1 - s) * t, s * (1 - t), s * t])
