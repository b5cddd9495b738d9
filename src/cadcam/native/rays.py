"""First hits of rays in the C core (rays.h), as a function of arrays."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.native.core import Handle, addresses, doubles, functions


@cache
def _core() -> c.CDLL:
    pointer, i64 = c.c_void_p, c.c_int64
    return functions(
        "casting rays",
        {
            "cc_rays_new": (pointer, [pointer, pointer, i64]),
            "cc_rays_free": (None, [pointer]),
            "cc_rays_first": (None, [pointer, i64, pointer, pointer, pointer, pointer]),
        },
    )


class NativeRays(Handle):
    """Triangles that rays are cast at: vertices (V, 3) finite, faces (F, 3) indices into them, both copied."""

    def __init__(self, vertices: Array, faces: Ids) -> None:
        vertices, faces = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32)
        made = _core().cc_rays_new(*addresses(vertices, faces), len(faces))
        super().__init__(made, _core().cc_rays_free, f"a tree of {len(faces)} triangles")

    def first_hit(self, origins: Array, directions: Array, reach: Array) -> Ids:
        """Return the first face (N,) that rays from origins along directions (N, 3) meet up to reach (N,), or -1."""
        origins, directions, reach = doubles(origins, directions, reach)
        out = np.zeros(len(origins), np.int32)
        _core().cc_rays_first(self.address, len(origins), *addresses(origins, directions, reach, out))
        return out
