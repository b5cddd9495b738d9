"""The C core's part that asks a rendered view what it shows (seen.h), as a function of arrays."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np

from cadcam.arrays import Array, Mask, Picture
from cadcam.native.core import library


@cache
def _core() -> c.CDLL:
    core = library()
    pointer, i64, i32, real = c.c_void_p, c.c_int64, c.c_int32, c.c_double
    core.cc_seen.argtypes = [pointer, pointer, i32, i32, *[real] * 4, i64, *[pointer] * 3]
    core.cc_seen.restype = None
    return core


def seen(
    depth: Picture, normal: Picture, focal: tuple[float, float], p: Array, q: Array, *, slack: float, steepest: float
) -> Mask:
    """Return which points (n,) a view of depth (H, W) and normals (H, W, 3) shows: p (n, 3) mm, q (n, 2) px."""
    depth, normal = np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(normal, np.float32)
    p, q = np.ascontiguousarray(p, np.float64), np.ascontiguousarray(q, np.float64)
    out = np.zeros(len(p), np.uint8)
    height, width = depth.shape
    places = (array.ctypes.data for array in (p, q, out))
    _core().cc_seen(depth.ctypes.data, normal.ctypes.data, width, height, *focal, slack, steepest, len(p), *places)
    return out.astype(bool)
