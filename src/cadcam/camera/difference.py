"""How far apart two cameras see the same direction: the difference field in pixels."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera


def picture_grid(size: tuple[int, int], columns: int, rows: int) -> Array:
    """Return pixels (rows, columns, 2) spread evenly from edge to edge of the picture."""
    x = np.linspace(-0.5, size[0] - 0.5, columns)
    y = np.linspace(-0.5, size[1] - 0.5, rows)
    return np.stack(np.meshgrid(x, y), axis=-1)


def difference_field(a: Camera, b: Camera, q: Array, *, b_from_a: Array | None = None) -> Array:
    """Return q_b - q_a (..., 2) px: where b images the directions that a sees at its pixels q (..., 2).

    b_from_a is a rotation (3, 3) between the two camera frames, the identity if not given. NaN where a sees no
    direction at q or b does not image it.
    """
    directions = a.unproject(q)
    return b.project(directions if b_from_a is None else directions @ b_from_a.T) - q


def largest_difference(a: Camera, b: Camera) -> float:
    """Return the largest |q_b - q_a| px over a 9 x 9 grid of a's picture; inf where b images less than a."""
    q = picture_grid(a.size, 9, 9)
    seen = ~np.isnan(a.unproject(q)).any(axis=-1)
    distance = np.linalg.norm(difference_field(a, b, q), axis=-1)[seen]
    return float("inf") if np.isnan(distance).any() else float(distance.max(initial=0.0))
