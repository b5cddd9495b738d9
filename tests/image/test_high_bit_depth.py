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
from cadcam.image.camera_picture import read_camera_picture_with_info
from cadcam.image.decode import stored
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
    return png([row.astype(">u2").tobytes() for row in samples], samples.shape[1], (16, 4))


def png(rows: list[bytes], width: int, kind: tuple[int, int], key: tuple[int, ...] = ()) -> bytes:
    """Return a PNG of these rows, kind: bits a sample and colour type; key: the sample(s) that are transparent."""
    head = struct.pack(">IIBBBBB", width, len(rows), *kind, 0, 0, 0)
    clear = [(b"tRNS", struct.pack(f">{len(key)}H", *key))] if key else []
    body_of_rows = zlib.compress(b"".join(b"\0" + row for row in rows))
    chunks = [(b"IHDR", head), *clear, (b"IDAT", body_of_rows), (b"IEND", b"")]
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


@pytest.mark.parametrize("channels", [1, 3])
def test_the_one_transparent_colour_of_a_deep_png_is_laid_over_white(tmp_path: Path, channels: int) -> None:
    rows = sixteen(GRAY if channels == 1 else RGB)
    key = tuple(int(n) for n in np.atleast_1d(rows[2, 3]))
    packed = [row.astype(">u2").tobytes() for row in rows]
    (tmp_path / "a.png").write_bytes(png(packed, rows.shape[1], (16, {1: 0, 3: 2}[channels]), key))
    expected = rows / 65535
    expected[2, 3] = 1
    assert read_picture(tmp_path / "a.png") == pytest.approx(expected, abs=4 * EPS)


@pytest.mark.parametrize(("bits", "row", "key"), [(1, 1 << 6, 0), (1, 1 << 6, 1), (2, 0b00011011, 1), (4, 0x3C, 3)])
def test_the_transparent_grey_of_few_bits_is_the_one_that_is_meant(
    tmp_path: Path, bits: int, row: int, key: int
) -> None:
    """Templates are cut out of logos, which programs that make PNG files small store like this."""
    n = 8 // bits if bits > 1 else 2
    (tmp_path / "a.png").write_bytes(png([bytes([row])], n, (bits, 0), (key,)))
    values = [row >> (8 - bits * (k + 1)) & ((1 << bits) - 1) for k in range(n)]
    held = stored("a.png", (tmp_path / "a.png").read_bytes(), max_pixels=9)
    assert held.samples[0, :, -1].tolist() == [0 if value == key else 255 for value in values]
    assert held.samples[0, :, 0].tolist() == [value * 255 // ((1 << bits) - 1) for value in values]


def packed_tiff(samples: npt.NDArray[np.uint16]) -> bytes:
    """Return a TIFF of 12 bits a sample, two samples in three bytes, as software of scientific cameras writes it."""
    pairs = samples.reshape(-1, 2)
    raw = b"".join(((int(a) << 12) | int(b)).to_bytes(3, "big") for a, b in pairs)
    tags = {256: samples.shape[1], 257: samples.shape[0], 258: 12, 259: 1, 262: 1, 273: 0, 277: 1, 278: len(samples)}
    tags |= {279: len(raw)}
    tags[273] = 10 + 12 * len(tags) + 4
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4) + raw


@pytest.mark.parametrize("read", [read_picture_with_info, read_camera_picture_with_info])
@pytest.mark.parametrize("brightest", [4095, 600])
def test_a_tiff_of_12_bits_is_white_at_4095_however_dark_it_is(tmp_path: Path, read: Any, brightest: int) -> None:
    samples = np.rint(GRAY * brightest).astype(np.uint16)
    (tmp_path / "a.tif").write_bytes(packed_tiff(samples))
    picture, info = read(tmp_path / "a.tif")
    assert picture == pytest.approx(samples / 4095, abs=2 * EPS)
    assert (info.bits, info.white) == (12, 4095)


def test_signed_bytes_are_refused(tmp_path: Path) -> None:
    """Pillow takes -1 for 255: black would be white."""
    tifffile.imwrite(tmp_path / "a.tif", np.array([[-1, 100]], np.int8))
    with pytest.raises(UnreadableFile, match="8-bit samples are signed"):
        read_picture(tmp_path / "a.tif")


@pytest.mark.parametrize(("values", "kind"), [(GRAY, 2), (RGB, 3)], ids=["grey", "colour"])
def test_plain_text_pgm_and_ppm_keep_every_step_and_their_white(
    tmp_path: Path, values: npt.NDArray[np.float64], kind: int
) -> None:
    """Pillow takes plain PPM to 8 bits, and plain PGM of 12 bits to 16."""
    steps = np.rint(values * 4095).astype(int)
    body = " ".join(map(str, steps.ravel().tolist())).replace(" ", "\r\n", 5)
    path = tmp_path / "a.ppm"
    path.write_text(f"P{kind}\n# of a camera\n10 7\n4095\n# its samples\n{body}\n", newline="")
    picture, info = read_picture_with_info(path)
    assert np.array_equal(picture, np.float32(steps) / np.float32(4095))
    assert (info.bits, info.white, info.used_bits) == (16, 4095, 12)
    assert np.array_equal(read_picture(path, full_scale=8190), np.float32(steps) / np.float32(8190))


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        ("0 4095", "cut off"),
        ("0 1 x 3", "cannot be decoded|cut off"),
        ("0 1 -2 3", "from -2 to 3"),
        ("0 5000 1 2", "outside 0 to 4095"),
    ],
)
def test_plain_samples_that_are_none_are_refused(tmp_path: Path, samples: str, words: str) -> None:
    (tmp_path / "a.pgm").write_text(f"P2 2 2 4095 {samples}")
    with pytest.raises(UnreadableFile, match=words):
        read_picture(tmp_path / "a.pgm")
