"""OpenEXR files of float pictures: numbers of any size, infinity included, as compositing and vision tools read them.

Layout: "OpenEXR File Layout" (openexr.com, technical documentation): magic number, version, attributes, a table of
offsets, then one block a scan line. Compression ZIPS: a line's bytes, even ones before odd ones, as differences,
deflated.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_path
from cadcam.whole import write_whole

_MAGIC, _VERSION, _ZIPS, _FLOAT = 20000630, 2, 2, 2


def write_exr(path: str | os.PathLike[str], channels: Mapping[str, npt.ArrayLike]) -> None:
    """Write named float32 channels, each (H, W), all of one size; whole or not at all.

    Usual names: R, G, B, A; Z for depth. Raises `BadValue` on shapes, `UnwritableFile` where the system refuses.
    """
    expect_path(path)
    expect(channels, "channels", Mapping)
    layers = {name: np.ascontiguousarray(channels[name], "<f4") for name in sorted(channels)}
    shapes = {layer.shape for layer in layers.values()}
    if len(shapes) != 1 or len(shape := shapes.pop()) != 2 or 0 in shape:
        raise BadValue("EXR channels", {n: a.shape for n, a in layers.items()}, "arrays (H, W) of one size")
    for name in layers:
        if not 0 < len(name.encode()) < 32 or "\0" in name:
            raise BadValue("EXR channel", repr(name), "a name of 1 to 31 bytes")
    write_whole(path, _file(layers, shape[1], shape[0]))


def _file(layers: dict[str, npt.NDArray[np.float32]], width: int, height: int) -> bytes:
    head = _header(layers, width, height)
    rows = [b"".join(layer[y].tobytes() for layer in layers.values()) for y in range(height)]
    blocks = [struct.pack("<ii", y, len(packed := _packed(row))) + packed for y, row in enumerate(rows)]
    offsets = len(head) + 8 * height + np.cumsum([0, *(len(block) for block in blocks[:-1])])
    return head + offsets.astype("<u8").tobytes() + b"".join(blocks)


def _header(layers: Mapping[str, object], width: int, height: int) -> bytes:
    names = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", _FLOAT, 0, 1, 1) for name in layers) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = (
        (b"channels", b"chlist", names),
        (b"compression", b"compression", bytes([_ZIPS])),
        (b"dataWindow", b"box2i", window),
        (b"displayWindow", b"box2i", window),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    )
    stored = (name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value for name, kind, value in attributes)
    return struct.pack("<ii", _MAGIC, _VERSION) + b"".join(stored) + b"\0"


def _packed(line: bytes) -> bytes:
    """Return a line deflated as ZIPS does, or as it is where that is no shorter, which readers tell by its length."""
    raw = np.frombuffer(line, np.uint8)
    mixed = np.concatenate([raw[::2], raw[1::2]])
    mixed[1:] = np.diff(mixed) + np.uint8(128)  # modulo 256
    packed = zlib.compress(mixed.tobytes(), 4)
    return packed if len(packed) < len(line) else line
