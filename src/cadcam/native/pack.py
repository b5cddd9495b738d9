"""The C core's part that packs the pictures of PNG files (pack.h), as a function of an array."""

from __future__ import annotations

import ctypes as c
import threading
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.errors import NotEnoughMemory
from cadcam.native.core import library

_kept = threading.local()  # the room of a thread: most of it is never touched, and fresh memory would be cleared


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
    room = _room(int(_core().cc_pack_room(width, height)))
    n = _core().cc_pack(rows.ctypes.data, width, height, pixel_bytes, room.ctypes.data, room.size)
    if n < 0:
        raise NotEnoughMemory(f"there is not enough memory to pack a picture of {rows.size} bytes")
    return room[:n].tobytes()


def _room(size: int) -> npt.NDArray[np.uint8]:
    """Return at least so many bytes, this thread's own."""
    if getattr(_kept, "room", None) is None or _kept.room.size < size:
        _kept.room = np.zeros(size, np.uint8)
    room: npt.NDArray[np.uint8] = _kept.room
    return room
