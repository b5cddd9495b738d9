"""OpenEXR files: a reader written from the layout alone gets every bit back; so does OpenEXR's own where it is."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import BadValue
from cadcam.image.exr import write_exr

RNG = np.random.default_rng(5)
SHAPES = [(1, 1), (1, 7), (7, 1), (23, 33)]


def pictures(shape: tuple[int, int]) -> dict[str, np.ndarray]:
    """Noise that deflating makes no shorter, and a plane with infinity that it makes much shorter."""
    plane = np.full(shape, 1.5, np.float32)
    plane[0, 0] = np.inf
    return {"Z": plane, "A": RNG.normal(size=shape).astype(np.float32)}


def read(path: Path, names: list[str], shape: tuple[int, int]) -> dict[str, np.ndarray]:
    data = path.read_bytes()
    assert data[:8] == struct.pack("<ii", 20000630, 2)
    at = 8
    while data[at]:  # name, type, size, value
        for _ in range(2):
            at = data.index(b"\0", at) + 1
        at += 4 + struct.unpack_from("<i", data, at)[0]
    offsets = struct.unpack_from(f"<{shape[0]}Q", data, at + 1)
    out = {name: np.zeros(shape, np.float32) for name in names}
    for y, offset in enumerate(offsets):
        row, size = struct.unpack_from("<ii", data, offset)
        line = data[offset + 8 : offset + 8 + size]
        assert row == y
        if size < 4 * shape[1] * len(names):
            mixed = np.cumsum(np.frombuffer(zlib.decompress(line), np.uint8).astype(int) - 128)
            mixed = (mixed + 128).astype(np.uint8)
            half = (len(mixed) + 1) // 2
            plain = np.zeros(len(mixed), np.uint8)
            plain[::2], plain[1::2] = mixed[:half], mixed[half:]
            line = plain.tobytes()
        for name, values in zip(sorted(names), np.frombuffer(line, "<f4").reshape(len(names), -1), strict=True):
            out[name][y] = values
    return out


@pytest.mark.parametrize("shape", SHAPES)
def test_every_bit_comes_back(tmp_path: Path, shape: tuple[int, int]) -> None:
    channels = pictures(shape)
    write_exr(tmp_path / "a.exr", channels)
    for name, layer in read(tmp_path / "a.exr", list(channels), shape).items():
        assert np.array_equal(layer, channels[name]), name


@pytest.mark.parametrize("shape", SHAPES)
def test_openexr_reads_the_same(tmp_path: Path, shape: tuple[int, int]) -> None:
    reader = pytest.importorskip("OpenEXR", reason="OpenEXR's own reader is not installed")
    channels = pictures(shape)
    write_exr(tmp_path / "a.exr", channels)
    stored = reader.File(str(tmp_path / "a.exr")).channels()
    assert {name: stored[name].pixels.tolist() for name in stored} == {n: a.tolist() for n, a in channels.items()}


@pytest.mark.parametrize(
    "wrong", [{}, {"Z": np.zeros(3)}, {"Z": np.zeros((0, 3))}, {"A": np.zeros((2, 2)), "B": np.zeros((2, 3))}]
)
def test_layers_of_no_common_size_are_refused_and_nothing_is_written(
    tmp_path: Path, wrong: dict[str, np.ndarray]
) -> None:
    with pytest.raises(BadValue):
        write_exr(tmp_path / "a.exr", wrong)
    with pytest.raises(BadValue, match="name of 1 to 31 bytes"):
        write_exr(tmp_path / "a.exr", {"": np.zeros((2, 2))})
    assert not list(tmp_path.iterdir())
