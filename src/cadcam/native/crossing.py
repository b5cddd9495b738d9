"""Intersections of segments in the C core (crossing.h), as a function of arrays."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.errors import NotEnoughMemory
from cadcam.native.core import addresses, doubles, functions

Flat = tuple[Array, Array, Array, Array]  # ends a, b (N, 2) and inverse depths wa, wb (N,)


class _Flat(c.Structure):
    _fields_ = (*((name, c.c_void_p) for name in ("a", "b", "wa", "wb")), ("n", c.c_int64))


@cache
def _core() -> c.CDLL:
    flat, pointer = c.POINTER(_Flat), c.c_void_p
    return functions(
        "the removal of hidden lines", {"cc_crossings": (c.c_int64, [flat, flat, pointer, c.c_int64, pointer, pointer])}
    )


def crossings(lines: Flat, borders: Flat, slack: Array) -> tuple[Longs, Array]:
    """Return (line index, fraction s of its image) of the crossings with borders, each lengthened by its slack (M,)."""
    kept = [doubles(*arrays) for arrays in (lines, borders, (slack,))]
    one, other = (_Flat(*addresses(*arrays), len(arrays[0])) for arrays in kept[:2])
    room = len(lines[0]) + len(borders[0])
    while True:
        line, s = np.zeros(room, np.int64), np.zeros(room)
        found = _core().cc_crossings(c.byref(one), c.byref(other), *addresses(*kept[2]), room, *addresses(line, s))
        if found < 0:
            raise NotEnoughMemory(f"there is not enough memory for the crossings of {len(lines[0])} segments")
        if found <= room:
            return line[:found], s[:found]
        room = found
