"""The C core's part that packs the pictures of PNG files (pack.h), as a function of an array."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.errors import NotEnoughMemory
from cadcam.native.core import library

_LIKELY = 0.6  # of a picture's size, even of noise: the room that is tried first


@cache
def _core() -> c.CDLL:
    core = library()
    core.cc_pack.argtypes = [c.c_void_p, c.c_int64, c.c_int64, c.c_int32, c.c_void_p, c.c_int64]
    core.cc_pack_room.argtypes = [c.c_int64, c.c_int64]
    core.cc_pack.restype = core.cc_pack_room.restype = c.c_int64
    return core


def packed_rows(rows: npt.NDArray[np.uint8], pixel_bytes: int) -> bytes:
    """Return rows (H, bytes) of pixels, in PNG's order of bytes, as a PNG file holds them. Raises `NotEnoughMemory`."""
    height, width = rows.shape
    rows = np.ascontiguousarray(rows)
    enough = int(_core().cc_pack_room(width, height))
    for room in (min(int(_LIKELY * rows.size) + 4096, enough), enough):
        out = np.zeros(room, np.uint8)
        n = _core().cc_pack(rows.ctypes.data, width, height, pixel_bytes, out.ctypes.data, room)
        if n >= 0:
            return out[:n].tobytes()
    raise NotEnoughMemory(f"there is not enough memory to pack a picture of {rows.size} bytes")
