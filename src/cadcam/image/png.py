"""PNG files quickly: each row as its difference to the one above, packed by the C core (native/pack.c).

For many pictures a second: some twenty times as fast as Pillow, whose default is about as small
(docs/benchmarks/dataset.md). `picture` writes what people send each other.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Picture
from cadcam.errors import BadValue
from cadcam.native.pack import packed_depth_rows, packed_normal_rows, packed_rows

DEEPEST = 65535  # steps of depth that 16 bits hold
_STEPS_MM = tuple(m * 10.0**e for e in range(-9, 7) for m in (1, 2, 5))
_KINDS = {(2, 1): (8, 0), (3, 1): (8, 2), (2, 2): (16, 0)}  # (axes, bytes a sample) -> bit depth, colour type


def packed(samples: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> bytes:
    """Return the bytes of a PNG file of grey (H, W) or red, green, blue (H, W, 3) bytes, or of grey 16-bit numbers.

    The same samples give the same bytes, anywhere. Raises `BadValue` for another shape or type, `MissingCore` without
    the compiled core.
    """
    kind = (samples.ndim, samples.dtype.itemsize)
    if kind not in _KINDS or samples.dtype.kind != "u" or 0 in samples.shape or samples.shape[2:] not in ((), (3,)):
        raise BadValue("samples", f"{samples.dtype} of shape {samples.shape}", "uint8 (H, W[, 3]) or uint16 (H, W)")
    depth, color = _KINDS[kind]
    height, width = samples.shape[:2]
    rows = np.ascontiguousarray(samples, samples.dtype.newbyteorder(">")).view(np.uint8).reshape(height, -1)
    return _file((width, height), depth, color, packed_rows(rows, rows.shape[1] // width))


def depth_step(farthest: float) -> float:
    """Return the smallest round step in mm with which depths up to `farthest` mm fit in 16 bits."""
    return next((step for step in _STEPS_MM if farthest / step <= DEEPEST), _STEPS_MM[-1])


def packed_depth(depth: Picture, step: float) -> bytes:
    """Return the bytes of a PNG file of a depth (H, W) mm in steps, 16 bits, at most 65535; 0 where it is infinite."""
    height, width = depth.shape
    return _file((width, height), *_KINDS[2, 2], packed_depth_rows(depth, step))


def packed_normals(depth: Picture, normal: Picture) -> bytes:
    """Return the bytes of a PNG file of unit normals (H, W, 3): (n + 1)/2 in bytes; 0 where the depth is infinite."""
    height, width = depth.shape
    return _file((width, height), *_KINDS[3, 1], packed_normal_rows(depth, normal))


def _file(size: tuple[int, int], depth: int, color: int, data: bytes) -> bytes:
    """Return the bytes of a file: its picture's size, bits a sample and colour type, and the packed rows."""
    head = struct.pack(">IIBBBBB", *size, depth, color, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
