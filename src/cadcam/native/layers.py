"""The C core's part that makes masks what files of labels hold (layers.h), as functions of an array."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Mask
from cadcam.native.core import functions

Box = tuple[int, int, int, int]
_RUNS = 4  # changes a column that there is room for at once


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
