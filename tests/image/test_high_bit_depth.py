"""Deep samples keep depth, sign and channels where Pillow would reduce, reverse or refuse them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import tifffile

from cadcam.errors import UnreadableFile
from cadcam.image.picture import read_picture, read_picture_with_info

GRAY = np.linspace(0, 1, 70).reshape(7, 10)
RGB = np.stack([GRAY, GRAY[::-1], 1 - GRAY], axis=2)
HALF = 0.5 / 65535  # of a step: stored values are rounded
EPS = float(np.finfo(np.float32).eps)


def sixteen(values: npt.ArrayLike) -> npt.NDArray[np.uint16]:
    """Return values in [0, 1] as 16-bit numbers."""
    return np.asarray(np.rint(np.asarray(values) * 65535), np.uint16)


def with_channels(colours: npt.ArrayLike, *more: float) -> npt.NDArray[np.uint16]:
    """Return colours with further channels, each of one value."""
    return sixteen(np.dstack([np.asarray(colours), *(np.full(GRAY.shape, value) for value in more)]))


def gray_alpha_png(samples: npt.NDArray[np.uint16]) -> bytes:
    """Return a PNG of colour type 4, grey with alpha, 16 bits each."""
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in samples)
    head = struct.pack(">IIBBBBB", samples.shape[1], samples.shape[0], 16, 4, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )


@pytest.mark.parametrize("stored", [sixteen(1 - GRAY), np.float32(1 - GRAY)], ids=["16 bits", "floats"])
def test_deep_grey_tiff_of_which_0_is_white_is_no_negative(tmp_path: Path, stored: npt.NDArray[Any]) -> None:
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="miniswhite")
    picture, info = read_picture_with_info(tmp_path / "a.tif")
    assert picture == pytest.approx(GRAY, abs=HALF + 2 * EPS)
    assert info.bits == 8 * stored.itemsize


@pytest.mark.parametrize("dtype", [np.float16, np.float64])
@pytest.mark.parametrize("values", [GRAY, RGB], ids=["grey", "colour"])
def test_floats_of_any_length_are_read(tmp_path: Path, dtype: type[np.floating[Any]], values: npt.NDArray[Any]) -> None:
    kind: Any = "rgb" if values.ndim == 3 else "minisblack"
    tifffile.imwrite(tmp_path / "a.tif", values.astype(dtype), photometric=kind)
    eps = max(float(np.finfo(dtype).eps), EPS)
    assert read_picture(tmp_path / "a.tif") == pytest.approx(values, abs=eps)


def test_grey_with_alpha_keeps_16_bits(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(gray_alpha_png(with_channels(GRAY, 0.5)))
    picture, info = read_picture_with_info(tmp_path / "a.png")
    assert info.bits == 16
    alpha = float(sixteen(0.5)) / 65535
    assert picture == pytest.approx(GRAY * alpha + 1 - alpha, abs=HALF + 4 * EPS)


@pytest.mark.parametrize("more", [(0.5,), (0.5, 0.1)])
def test_a_channel_that_no_file_calls_transparency_is_none(tmp_path: Path, more: tuple[float, ...]) -> None:
    """A fourth channel may be infrared, a selection, a depth: laid over white by it, a picture would be another."""
    kinds = ["unspecified"] * len(more)
    tifffile.imwrite(tmp_path / "a.tif", with_channels(RGB, *more), photometric="rgb", extrasamples=kinds)
    assert read_picture(tmp_path / "a.tif") == pytest.approx(RGB, abs=HALF + 2 * EPS)


def test_colours_stored_multiplied_by_their_alpha_are_those_of_the_picture(tmp_path: Path) -> None:
    a, b = tmp_path / "a.tif", tmp_path / "b.tif"
    tifffile.imwrite(a, with_channels(RGB, 0.5), photometric="rgb", extrasamples=["unassalpha"])
    tifffile.imwrite(b, with_channels(0.5 * RGB, 0.5), photometric="rgb", extrasamples=["assocalpha"])
    assert read_picture(b) == pytest.approx(read_picture(a), abs=4 * HALF)  # each rounded, one of them doubled


def test_a_damaged_file_says_so_once(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", with_channels(RGB), photometric="rgb")
    whole = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(whole[: len(whole) - 100])
    with pytest.raises(UnreadableFile) as told:
        read_picture(tmp_path / "a.tif")
    assert str(told.value).count("cut off or damaged") == 1
