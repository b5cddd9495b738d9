"""Where a lens images directions, and how much it bends straight edges there: a table for the GPU.

Directions (x, y, z) in the camera frame are s = (x, y) / (z + |(x, y, z)|), their stereographic projection: smooth up
to the focal plane and beyond. Pixels are read from the table by linear interpolation, which is off by at most `_OFF_PX`
where it counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import maximum_filter

from cadcam.arrays import Array, Mask, Picture
from cadcam.camera.camera import Camera
from cadcam.cores import blocks, on_cores
from cadcam.render.lines.clip import ViewVolume

LONGEST_PX = 1024.0  # of an edge whose bending is known from that around its ends
_CELLS, _COARSE = 512, 64  # a side, where pixels are known and where bending is
_OFF_PX = 0.1  # well within the margin of 1 px that faces are drawn with
_SHARPEST = 1 / 32  # 1/px; beyond it an edge would be a few px long
_AROUND = 0.15  # of the picture, on each side: there are the outer corners of the faces at its border
_PROBE_PX = 16.0  # half the length of the edges whose images are measured
_TURNS = 8  # directions of such edges through a point


@dataclass(frozen=True, slots=True, eq=False)
class BendTable:
    """`nodes` (N, N, 3) float32: x and y in px of the direction at node (i, j), s = low + (j, i) step, and its bending.

    That is the largest curvature, 1/px, of the image of a straight edge within `LONGEST_PX` / 2 of there; -1 where the
    cell that begins at the node holds directions that the lens does not image, or too unevenly to be interpolated.
    """

    nodes: Picture
    low: Array  # (2,)
    step: Array  # (2,)


def bend_table(camera: Camera, frustum: ViewVolume) -> BendTable:
    """Return the table of a camera for the directions of its frustum and a little more; kept for the last cameras."""
    return _table(camera, tuple(frustum.low.tolist()), tuple(frustum.high.tolist()))


@lru_cache(maxsize=4)
def _table(camera: Camera, low: tuple[float, ...], high: tuple[float, ...]) -> BendTable:
    first, last = (np.asarray(u) / (1 + np.hypot(1, u)) for u in (low, high))
    more = _AROUND * (last - first)
    first, last = np.maximum(first - more, -1.0), np.minimum(last + more, 1.0)
    step = np.maximum(last - first, 1e-12) / (_CELLS - 1)
    at = _grid(first, step, _CELLS)
    q, middle = _pixels(camera, at), _pixels(camera, at[:-1, :-1] + step / 2)
    between = (q[:-1, :-1] + q[1:, :-1] + q[:-1, 1:] + q[1:, 1:]) / 4
    even = np.zeros(q.shape[:2], bool)
    even[:-1, :-1] = np.linalg.norm(between - middle, axis=-1) < _OFF_PX  # False where either is NaN
    bending, measured = _bending(camera, first, step)
    nodes = np.dstack([np.nan_to_num(q), np.where(even & measured, bending, -1.0)])
    return BendTable(nodes.astype(np.float32), first, step)


def _bending(camera: Camera, low: Array, step: Array) -> tuple[Array, Mask]:
    """Return the bending at each node, the largest from there to half of `LONGEST_PX`, and where it is tame."""
    wide = step * (_CELLS / _COARSE)
    d = _directions(_grid(low + wide / 2, wide, _COARSE))
    e1 = np.cross(d, [0.0, 1.0, 0.0])
    e1 /= np.maximum(np.linalg.norm(e1, axis=-1, keepdims=True), 1e-300)
    e2 = np.cross(d, e1)
    q = camera.project(d)
    turn = np.pi * np.arange(_TURNS)[:, None, None, None] / _TURNS
    along = np.cos(turn) * e1 + np.sin(turn) * e2

    def off(angle: Array | float) -> Array:
        """Return q at an angle from d, along every edge through it, less q."""
        return np.asarray(camera.project(np.cos(angle) * d + np.sin(angle) * along) - q)

    with np.errstate(divide="ignore", invalid="ignore"):
        tiny = 0.1 / max(camera.fx, camera.fy)
        angle = np.minimum(_PROBE_PX * tiny / np.linalg.norm(off(tiny), axis=-1, keepdims=True), 0.1)
        one, other = off(angle), off(-angle)
        length = np.linalg.norm(one - other, axis=-1)
        across = np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]) / length
        curvature = np.max(8 * across / length**2, axis=0)  # NaN where any is
        spacing = np.nanmedian(np.linalg.norm(np.diff(q, axis=1), axis=-1)) if np.isfinite(q).any() else np.inf
    tame = curvature < _SHARPEST
    reach = int(np.clip(np.ceil(LONGEST_PX / 2 / max(float(spacing), 1e-3)) + 1, 1, _COARSE)) if tame.any() else 1
    widest = maximum_filter(np.where(tame, curvature, 0.0), 2 * reach + 1, mode="nearest")
    rim = maximum_filter(~tame, 3, mode="nearest")
    finer = _CELLS // _COARSE
    return np.asarray(np.kron(widest, np.ones((finer, finer))), np.float64), ~np.kron(
        rim, np.ones((finer, finer), bool)
    )


def _pixels(camera: Camera, s: Array) -> Array:
    """Return the pixels of directions s (..., 2), NaN of those that the lens does not image."""
    flat = s.reshape(-1, 2)
    parts = on_cores(lambda part: camera.project(_directions(flat[part])), blocks(len(flat)))
    return np.concatenate(parts).reshape(s.shape)


def _directions(s: Array) -> Array:
    """Return unit vectors (..., 3) of s (..., 2)."""
    square = np.sum(s * s, axis=-1, keepdims=True)
    return np.asarray(np.concatenate([2 * s, 1 - square], axis=-1) / (1 + square))


def _grid(low: Array, step: Array, n: int) -> Array:
    """Return points (n, n, 2) from `low` on, x along rows."""
    x, y = (low[k] + step[k] * np.arange(n) for k in range(2))
    return np.stack(np.meshgrid(x, y), axis=-1)
