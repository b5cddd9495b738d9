"""Places for cameras, spread over boxes and arcs."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import BadValue
from cadcam.geometry.plane import axes_across

_MOST = 5000


def in_box(box: Array, count: int) -> Array:
    """Return at most `count` places (n, 3) on a grid in a box (2, 3).

    Sides may be 0: a wall, a line. The spacing is about the same along all sides, with places at both ends of each; a
    side shorter than the spacing has one place, at its middle.
    """
    _check(count)
    size = box[1] - box[0]
    if (size < 0).any():
        raise BadValue("box_mm", box.tolist(), "[lowest corner, highest corner], x, y, z in mm")
    long = size > 0
    if not long.any():
        return box[:1].copy()
    n = np.ones(3, int)
    low, high = 1e-6 * size.max(), 2.1 * float(size.max())
    for _ in range(60):  # bisection of the spacing, for a grid of at most `count` places
        spacing = np.sqrt(low * high)
        n[long] = np.floor(size[long] / spacing).astype(int) + 1
        low, high = (spacing, high) if n.prod() > count else (low, spacing)
    n[long] = np.floor(size[long] / high).astype(int) + 1
    axes = [np.linspace(box[0, i], box[1, i], n[i]) if n[i] > 1 else box[:, i].mean(keepdims=True) for i in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def arc(centre: Array, radius: float, start_deg: float, end_deg: float, count: int, *, axis: Array) -> Array:
    """Return `count` places (n, 3) on an arc around an axis through its centre; angles from x towards y about z.

    About another axis, angles count from the perpendicular direction nearest to x. A full circle has no place twice.
    """
    _check(count)
    if not radius > 0:
        raise BadValue("radius_mm", radius, "a positive number")
    length = float(np.linalg.norm(axis))
    if not length > 0:
        raise BadValue("axis", axis.tolist(), "a vector that is not zero")
    z = axis / length
    x = np.array([1.0, 0, 0]) - z[0] * z
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-6 else axes_across(z)[0]
    over = abs(end_deg - start_deg)
    if over > 360 + 1e-9 or (over == 0 and count > 1):
        raise BadValue("from_deg and to_deg", f"{start_deg:g} and {end_deg:g}", "two angles at most 360 deg apart")
    whole = abs(over - 360) < 1e-9
    angle = np.radians(np.linspace(start_deg, end_deg, count, endpoint=not whole))
    return np.asarray(centre + radius * (np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * np.cross(z, x)))


def _check(count: int) -> None:
    if not 1 <= count <= _MOST:
        raise BadValue("count", count, f"a whole number from 1 to {_MOST}")
