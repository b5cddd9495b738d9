"""The C core's part that makes a view's layers what files of labels hold (layers.h), as functions of arrays."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Mask, Picture
from cadcam.native.core import library

Box = tuple[int, int, int, int]
_RUNS = 4  # changes a column that there is room for at once


@cache
def _core() -> c.CDLL:
    core = library()
    pointer, i64, i32 = c.c_void_p, c.c_int64, c.c_int32
    signatures: dict[str, tuple[object, list[object]]] = {
        "cc_depth_steps": (None, [pointer, i64, c.c_float, pointer]),
        "cc_normal_bytes": (None, [pointer, pointer, i64, pointer]),
        "cc_mask_region": (None, [pointer, i32, i32, pointer]),
        "cc_mask_changes": (i64, [pointer, i32, i32, pointer, i64, pointer]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(core, name)
        function.restype, function.argtypes = result, arguments
    return core


def depth_steps(depth: Picture, step: float) -> npt.NDArray[np.uint16]:
    """Return a depth (H, W) mm in steps, big-endian, at most 65535; 0 where there is nothing."""
    depth = np.ascontiguousarray(depth, np.float32)
    out = np.zeros(depth.shape, ">u2")
    _core().cc_depth_steps(depth.ctypes.data, depth.size, step, out.ctypes.data)
    return out


def normal_bytes(depth: Picture, normal: Picture) -> npt.NDArray[np.uint8]:
    """Return unit normals (H, W, 3) as (n + 1)/2 in steps of 1/255; 0 where the depth says that there is nothing."""
    depth, normal = np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(normal, np.float32)
    out = np.zeros(normal.shape, np.uint8)
    _core().cc_normal_bytes(depth.ctypes.data, normal.ctypes.data, depth.size, out.ctypes.data)
    return out


def mask_region(mask: Mask) -> tuple[int, Box]:
    """Return how many pixels of a mask (H, W) are set, and x0, y0, x1, y1, inclusive; -1 throughout where none is."""
    mask, found = np.ascontiguousarray(mask, bool), np.zeros(5, np.int64)
    height, width = mask.shape
    _core().cc_mask_region(mask.ctypes.data, width, height, found.ctypes.data)
    count, x0, y0, x1, y1 = found.tolist()
    return count, (x0, y0, x1, y1)


def mask_changes(mask: Mask) -> npt.NDArray[np.int64]:
    """Return where a mask (H, W), column by column, changes, beginning with not set."""
    mask = np.ascontiguousarray(mask, bool)
    height, width = mask.shape
    scratch, room = np.zeros(width + 1, np.int64), _RUNS * width
    while True:
        out = np.zeros(room, np.int64)
        task = (mask.ctypes.data, width, height, scratch.ctypes.data, room, out.ctypes.data)
        if (n := _core().cc_mask_changes(*task)) <= room:
            return out[:n]
        room = n
