"""Masks in the C core as label files hold them (layers.h), as functions of an array."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Mask
from cadcam.native.core import functions

Box = tuple[int, int, int, int]
_RUNS = 4  # changes per column for which there is room at first


@cache
def _core() -> c.CDLL:
    pointer, i64, i32 = c.c_void_p, c.c_int64, c.c_int32
    return functions(
        "the labelling of data sets",
        {
            "cc_mask_region": (None, [pointer, i32, i32, pointer]),
            "cc_mask_changes": (i64, [pointer, i32, i32, pointer, i64, pointer]),
        },
    )


def mask_region(mask: Mask) -> tuple[int, Box]:
    """Return the number of pixels set in a mask (H, W), and the box x0, y0, x1, y1, inclusive; -1 if none is."""
    mask, found = np.ascontiguousarray(mask, bool), np.zeros(5, np.int64)
    height, width = mask.shape
    _core().cc_mask_region(mask.ctypes.data, width, height, found.ctypes.data)
    count, x0, y0, x1, y1 = found.tolist()
    return count, (x0, y0, x1, y1)


def mask_changes(mask: Mask) -> npt.NDArray[np.int64]:
    """Return where a mask (H, W), read column by column, changes, starting with not set."""
    mask = np.ascontiguousarray(mask, bool)
    height, width = mask.shape
    scratch, room = np.zeros(width + 1, np.int64), _RUNS * width
    while True:
        out = np.zeros(room, np.int64)
        task = (mask.ctypes.data, width, height, scratch.ctypes.data, room, out.ctypes.data)
        if (n := _core().cc_mask_changes(*task)) <= room:
            return out[:n]
        room = n
