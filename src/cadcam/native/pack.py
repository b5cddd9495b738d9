"""PNG picture data packed by the C core (pack.h), as functions of arrays."""

from __future__ import annotations

import ctypes as c
import threading
from collections.abc import Callable
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Picture
from cadcam.errors import NotEnoughMemory
from cadcam.native.core import addresses, functions

_kept = threading.local()  # a thread's buffer: most of it is never touched, and fresh memory would have to be cleared


@cache
def _core() -> c.CDLL:
    pointer, i64, i32 = c.c_void_p, c.c_int64, c.c_int32
    return functions(
        "the packing of PNG files",
        {
            "cc_pack": (i64, [pointer, i64, i64, i32, pointer, i64]),
            "cc_pack_depth": (i64, [pointer, i32, i32, c.c_float, pointer, i64]),
            "cc_pack_normals": (i64, [pointer, pointer, i32, i32, pointer, i64]),
            "cc_pack_room": (i64, [i64, i64]),
        },
    )


def packed_rows(rows: npt.NDArray[np.uint8], pixel_bytes: int) -> bytes:
    """Return rows (H, bytes) of pixels, in PNG's byte order, as PNG image data. Raises `NotEnoughMemory`."""
    height, width = rows.shape
    rows = np.ascontiguousarray(rows)
    return _packed(height, width, lambda out: _core().cc_pack(rows.ctypes.data, width, height, pixel_bytes, *out))


def packed_depth_rows(depth: Picture, step: float) -> bytes:
    """Return a depth (H, W) mm in steps, at most 65535, as a PNG file of 16 bits holds it; 0 where it is infinite."""
    depth = np.ascontiguousarray(depth, np.float32)
    height, width = depth.shape
    return _packed(height, 2 * width, lambda out: _core().cc_pack_depth(depth.ctypes.data, width, height, step, *out))


def packed_normal_rows(depth: Picture, normal: Picture) -> bytes:
    """Return unit normals (H, W, 3) as (n + 1)/2 in steps of 1/255, as a PNG file holds them; 0 where depth is inf."""
    depth, normal = np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(normal, np.float32)
    height, width = depth.shape
    places = addresses(depth, normal)
    return _packed(height, 3 * width, lambda out: _core().cc_pack_normals(*places, width, height, *out))


def _packed(rows: int, row_bytes: int, pack: Callable[[tuple[int, int]], int]) -> bytes:
    """Return what a function of the core packs into a buffer of that size."""
    room = _room(int(_core().cc_pack_room(row_bytes, rows)))
    n = pack((room.ctypes.data, room.size))
    if n < 0:
        raise NotEnoughMemory(f"there is not enough memory to pack a picture of {rows * row_bytes} bytes")
    return room[:n].tobytes()


def _room(size: int) -> npt.NDArray[np.uint8]:
    """Return a buffer of at least this size, owned by this thread."""
    if getattr(_kept, "room", None) is None or _kept.room.size < size:
        _kept.room = np.zeros(size, np.uint8)
    room: npt.NDArray[np.uint8] = _kept.room
    return room
