"""Interpolation between the calibrations around a position: weights that add up to one.

Nearest, linear in a triangle of positions, general bilinear through four (EQ 6.13), or the thesis' own set of rules
(6.4.3.5). The surrounding positions come from a Delaunay triangulation, so they need not lie on a perfect grid: four
positions are two triangles joined along their longest common side.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from cadcam.arrays import Array, Floats, frozen
from cadcam.errors import BadValue, TooFewPoints
from cadcam.kinds import expect_known, expect_positive

if TYPE_CHECKING:
    from scipy.spatial import Delaunay

Rule: TypeAlias = Literal["smooth", "bilinear", "linear", "nearest", "b4"]
RULES: tuple[Rule, ...] = ("smooth", "bilinear", "linear", "nearest", "b4")
NEAR_MM = 1000.0  # within this distance of a calibration position, it alone is used (6.4.3.5, rule 1)
_OUTSIDE = 1e-9  # of a triangle's size
_SINGULAR = 1e-3  # of the bilinear equations, coordinates scaled to one


def weights(positions: Floats, at: Floats, rule: Rule, *, extrapolate: bool = False, near_mm: float = NEAR_MM) -> Array:
    """Return the weight (N,) of each calibration position (N, 2) for a measurement at a position (2,), mm.

    "b4": within `near_mm` of a position that one, else bilinear, else linear, else nearest. Where the four positions
    do not allow EQ 6.13, "bilinear" is linear. Outside of the positions raises `BadValue`; within `near_mm` of one, or
    with `extrapolate`, the nearest alone is used there.
    """
    grid, place = frozen(positions, "calibration positions", (None, 2)), frozen(at, "position", (2,))
    expect_known(rule, "rule", ("bilinear", "linear", "nearest", "b4"))
    expect_positive(near_mm, "near_mm", "a number of mm from 0 on", zero=True)
    if not len(grid):
        raise TooFewPoints("interpolation", 0, 1, of="calibration positions")
    check_inside(grid, place, extrapolate=extrapolate, near_mm=near_mm)
    distance = np.linalg.norm(grid - place, axis=1)
    alone = np.eye(len(grid))[int(np.argmin(distance))]
    if rule == "nearest" or (rule == "b4" and distance.min() < near_mm) or distance.min() == 0:
        return np.asarray(alone)
    found = None if rule == "linear" else _bilinear(grid, place)
    found = _linear(grid, place) if found is None else found
    return np.asarray(alone) if found is None else found


def check_inside(positions: Array, at: Array, *, extrapolate: bool, near_mm: float = NEAR_MM) -> None:
    """Raise `BadValue` for a position outside of the calibrated ones and farther than `near_mm` from any of them.

    Positions in a row count within `near_mm` beside it, from end to end.
    """
    if extrapolate or surrounded(positions, at) or _beside_row(positions, at) <= near_mm:
        return
    distance = np.linalg.norm(positions - at, axis=1)
    nearest = int(np.argmin(distance))
    if distance[nearest] <= near_mm:
        return
    low, high = positions.min(axis=0), positions.max(axis=0)
    raise BadValue(
        "camera position",
        f"({at[0]:.1f}, {at[1]:.1f}) mm, {distance[nearest]:.0f} mm from the nearest calibrated one",
        f"one within the calibrated area (x {low[0]:.0f} to {high[0]:.0f}, y {low[1]:.0f} to {high[1]:.0f} mm) or "
        f"within {near_mm:.0f} mm of a position; extrapolation has to be asked for",
    )


def surrounded(positions: Array, at: Array) -> bool:
    """Return whether a position (2,) lies between the others (N, 2): in their convex hull, or on their line."""
    off = positions - at
    if not np.any(off, axis=1).all():
        return True
    around = np.sort(np.arctan2(off[:, 1], off[:, 0]))
    gaps = np.diff(around, append=around[0] + 2 * np.pi)
    return bool(gaps.max() <= np.pi + _OUTSIDE)


def _beside_row(positions: Array, at: Array) -> float:
    """Return how far a position lies from the line of the others, mm; inf beyond its ends and where they have none.

    Without it none would be measured there: no position that is measured lies on a line to the last digit.
    """
    if len(positions) < 2 or not _on_a_line(positions):
        return float("inf")
    centre = positions.mean(axis=0)
    along, across = ((positions - at) @ axis for axis in np.linalg.svd(positions - centre)[2])
    return float(abs(across.mean())) if along.min() <= 0 <= along.max() else float("inf")


def bilinear_weights(corners: Floats, at: Floats) -> Array | None:
    """Return the weights (4,) of four positions (4, 2) at a position by f = a x + b y + c xy + d (EQ 6.13).

    None where four such values do not determine a, b, c, d: x y is then a combination of 1, x, y at these positions.
    """
    p, place = frozen(corners, "four positions", (4, 2)), frozen(at, "position", (2,))
    centre, size = p.mean(axis=0), np.ptp(p, axis=0).max()
    if size == 0:
        return None
    A, b = _monomials((p - centre) / size), _monomials((place - centre) / size)
    s = np.linalg.svd(A, compute_uv=False)
    return None if s[-1] <= _SINGULAR * s[0] else np.asarray(np.linalg.solve(A.T, b))


def _monomials(p: Array) -> Array:
    x, y = p[..., 0], p[..., 1]
    return np.stack([x, y, x * y, np.ones_like(x)], axis=-1)


def _bilinear(grid: Array, at: Array) -> Array | None:
    four = _cell(grid, at)
    found = None if four is None else bilinear_weights(grid[four], at)
    if four is None or found is None:
        return None
    out = np.zeros(len(grid))
    out[four] = found
    return out


def _cell(grid: Array, at: Array) -> list[int] | None:
    """Return the four positions around a place: the triangle it lies in and the one beyond its longest side."""
    if _on_a_line(grid):
        return None
    mesh = _triangles(grid)
    k = int(mesh.find_simplex(at, tol=_OUTSIDE))
    if k < 0:
        return None
    corners = mesh.simplices[k]
    opposite = [np.linalg.norm(grid[corners[i - 1]] - grid[corners[i - 2]]) for i in range(3)]
    beyond = int(mesh.neighbors[k][int(np.argmax(opposite))])
    if beyond < 0:
        return None
    return [*corners.tolist(), *(set(mesh.simplices[beyond].tolist()) - set(corners.tolist()))]


def _linear(grid: Array, at: Array) -> Array | None:
    """Return barycentric weights in the triangle around a place, or along the line of positions; None outside."""
    if _on_a_line(grid):
        return _along_line(grid, at)
    mesh = _triangles(grid)
    k = int(mesh.find_simplex(at, tol=_OUTSIDE))
    if k < 0:
        return None
    inner = mesh.transform[k][:2] @ (at - mesh.transform[k][2])
    out = np.zeros(len(grid))
    out[mesh.simplices[k]] = [*inner, 1 - inner.sum()]
    return out


def _triangles(grid: Array) -> Delaunay:
    return _triangles_of(grid.tobytes(), len(grid))


@lru_cache(maxsize=16)
def _triangles_of(grid: bytes, count: int) -> Delaunay:
    from scipy.spatial import Delaunay

    return Delaunay(np.frombuffer(grid).reshape(count, 2))


def _on_a_line(grid: Array) -> bool:
    s = np.linalg.svd(grid - grid.mean(axis=0), compute_uv=False)
    return len(grid) < 3 or bool(s[1] <= 1e-3 * s[0])


def _along_line(grid: Array, at: Array) -> Array | None:
    if len(grid) == 1:
        return np.ones(1) if bool(np.all(grid[0] == at)) else None
    direction = np.linalg.svd(grid - grid.mean(axis=0))[2][0]
    t = (grid - at) @ direction
    if t.min() > 0 or t.max() < 0:
        return None
    before, after = int(np.argmax(np.where(t <= 0, t, -np.inf))), int(np.argmin(np.where(t >= 0, t, np.inf)))
    out = np.zeros(len(grid))
    share = 0.0 if before == after else -t[before] / (t[after] - t[before])
    out[before] += 1 - share
    out[after] += share
    return out
