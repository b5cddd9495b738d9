"""The C core's part that asks a rendered view what it shows (seen.h), as a function of arrays."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture
from cadcam.native.core import library


@cache
def _core() -> c.CDLL:
    core = library()
    pointer, i64, i32, real = c.c_void_p, c.c_int64, c.c_int32, c.c_double
    core.cc_seen.argtypes = [pointer, pointer, i32, i32, *[real] * 4, i64, *[pointer] * 3]
    core.cc_seen_lines.argtypes = [pointer, pointer, i32, i32, pointer, real, real, i64, *[pointer] * 6]
    for name in ("cc_seen", "cc_seen_lines"):
        getattr(core, name).restype = None
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


def seen_lines(
    depth: Picture,
    normal: Picture,
    K: Array,
    ends: tuple[Array, Array, Array, Array],
    samples: npt.NDArray[np.int64],
    *,
    slack: float,
    steepest: float,
) -> Mask:
    """Return which samples of lines, one after the other, such a view of an undistorted camera shows.

    ends: a, b (n, 2) in the plane (x, y)/z and their 1/z (n,); samples (n,): how many each line has (seen.h).
    """
    depth, normal = np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(normal, np.float32)
    arrays = [np.ascontiguousarray(array, np.float64) for array in (K, *ends)]
    samples = np.ascontiguousarray(samples, np.int64)
    out = np.zeros(int(samples.sum()), np.uint8)
    camera, *lines = (array.ctypes.data for array in arrays)
    height, width = depth.shape
    view = (depth.ctypes.data, normal.ctypes.data, width, height, camera, slack, steepest)
    _core().cc_seen_lines(*view, len(samples), *lines, samples.ctypes.data, out.ctypes.data)
    return out.astype(bool)
