"""Photos of 10, 12 and 14 bits in 16 are read with the white of their bits, one for all of a camera's photos."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import tifffile
from PIL import Image

from cadcam.errors import BadValue, UnreadableFile
from cadcam.image.camera_picture import (
    FullScale,
    camera_picture_in,
    full_scale_of,
    is_deep,
    read_camera_picture,
    read_camera_picture_with_info,
)
from cadcam.image.picture import read_picture, write_picture


def ramp(brightest: int, *, step: int = 1) -> npt.NDArray[np.uint16]:
    """Return samples (6, 8) from 0 to `brightest` in multiples of `step`."""
    return np.asarray(np.linspace(0, brightest // step, 48).round() * step, np.uint16).reshape(6, 8)


def save(path: Path, samples: npt.NDArray[np.uint16]) -> Path:
    """Write samples as they are."""
    if path.suffix == ".tif":
        tifffile.imwrite(path, samples, photometric="rgb" if samples.ndim == 3 else "minisblack")
    elif path.suffix == ".pgm":
        height, width = samples.shape
        path.write_bytes(b"P5 %d %d 65535\n" % (width, height) + samples.astype(">u2").tobytes())
    else:
        Image.fromarray(samples).save(path)
    return path


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.pgm"])
@pytest.mark.parametrize(
    ("brightest", "white"),
    [(700, 1023), (1023, 1023), (1024, 4095), (3891, 4095), (4096, 16383), (16383, 16383), (16384, 65535)],
)
def test_white_is_the_least_depth_that_no_sample_exceeds(tmp_path: Path, name: str, brightest: int, white: int) -> None:
    stored = ramp(brightest)
    picture, info = read_camera_picture_with_info(save(tmp_path / name, stored))
    assert (info.white, info.bits) == (white, 16)
    np.testing.assert_array_equal(picture, stored / np.float32(white))
    assert full_scale_of([tmp_path / name]) == FullScale(white, brightest)
    assert full_scale_of([tmp_path / name]).bits == white.bit_length()  # type: ignore[union-attr]
    np.testing.assert_array_equal(camera_picture_in((tmp_path / name).read_bytes(), name), picture)


def test_colour_counts_by_its_brightest_channel(tmp_path: Path) -> None:
    stored = np.stack([ramp(200), ramp(3000), ramp(900)], axis=2)
    np.testing.assert_array_equal(read_camera_picture(save(tmp_path / "a.tif", stored)), stored / np.float32(4095))


@pytest.mark.parametrize(
    "stored",
    [ramp(16 * 700, step=16), ramp(64 * 50, step=64), ramp(257 * 14, step=257), np.zeros((6, 8), np.uint16)],
    ids=["12 bits", "10 bits", "bytes", "black"],
)
def test_dark_samples_that_fill_their_bits_from_the_top_need_nothing(
    tmp_path: Path, stored: npt.NDArray[np.uint16]
) -> None:
    np.testing.assert_array_equal(read_camera_picture(save(tmp_path / "a.png", stored)), stored / np.float32(65535))
    assert full_scale_of([tmp_path / "a.png"]) == FullScale(65535, int(stored.max()))


@pytest.mark.parametrize("brightest", [1023, 2500, 4095])
def test_twelve_bits_above_are_the_picture_of_twelve_bits_below(tmp_path: Path, brightest: int) -> None:
    """Their whites, 16 times 4095 and 65535, differ by 15; a dark one is the same once its white is stated."""
    below, above = save(tmp_path / "below.png", ramp(brightest)), save(tmp_path / "above.png", 16 * ramp(brightest))
    stated = 1023 * 16 if brightest < 1024 else None
    one, other = read_camera_picture(below), read_camera_picture(above, full_scale=stated)
    np.testing.assert_allclose(other, one, rtol=0, atol=15 / 65535 + 2 * np.finfo(np.float32).eps)


def test_a_dark_picture_of_ours_is_not_taken_for_twelve_bits(tmp_path: Path) -> None:
    dark = ramp(4000) / np.float32(65535)
    write_picture(tmp_path / "ours.png", dark, bits=16)
    assert read_camera_picture(tmp_path / "ours.png") == pytest.approx(dark, abs=1e-9)
    assert full_scale_of([tmp_path / "ours.png"]) is None
    np.testing.assert_array_equal(read_picture(tmp_path / "ours.png"), read_camera_picture(tmp_path / "ours.png"))


def test_what_a_file_says_of_its_white_stands(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5 2 1 4095\n" + np.array([0, 900], ">u2").tobytes())
    assert read_camera_picture(tmp_path / "a.pgm") == pytest.approx(np.array([[0, 900 / 4095]]), abs=1e-7)
    assert full_scale_of([tmp_path / "a.pgm"]) is None


def test_transparency_is_nobody_s_twelve_bits(tmp_path: Path) -> None:
    stored = np.full((6, 8, 4), 3000, np.uint16)
    stored[..., 3] = 65535
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="rgb", extrasamples=["unassalpha"])
    assert read_camera_picture(tmp_path / "a.tif") == pytest.approx(np.full((6, 8, 3), 3000 / 65535), abs=1e-6)


def test_pictures_of_one_camera_have_one_white(tmp_path: Path) -> None:
    files = [save(tmp_path / f"{n}.png", ramp(n)) for n in (800, 1100, 300)]
    found = full_scale_of(files)
    assert found == FullScale(4095, 1100)
    for file, n in zip(files, (800, 1100, 300), strict=True):
        assert read_camera_picture(file, full_scale=found.white).max() == pytest.approx(n / 4095)
    files.append(save(tmp_path / "bright.png", ramp(40000)))
    assert full_scale_of(files) == FullScale(65535, 40000)


def test_dark_and_bright_pictures_filled_from_the_top_have_one_white(tmp_path: Path) -> None:
    dark = save(tmp_path / "dark.png", ramp(64 * 50, step=64))
    assert full_scale_of([dark, save(tmp_path / "bright.png", ramp(64 * 1000, step=64))]) == FullScale(65535, 64000)


def test_bytes_are_none_of_it(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 4), 100, np.uint8)).save(tmp_path / "a.png")
    assert not is_deep(tmp_path / "a.png")
    assert is_deep(save(tmp_path / "b.png", ramp(900)))
    assert full_scale_of([tmp_path / "a.png", tmp_path / "b.png"]) is None
    for full_scale in (None, 4095):
        np.testing.assert_array_equal(
            read_camera_picture(tmp_path / "a.png", full_scale=full_scale), 100 / np.float32(255)
        )


def test_the_caller_s_white_stands_and_one_that_a_sample_exceeds_is_refused(tmp_path: Path) -> None:
    file = save(tmp_path / "a.png", ramp(1100))
    assert read_camera_picture(file, full_scale=65535).max() == pytest.approx(1100 / 65535)
    said = r"a\.png: has values from 0 to 1100, outside 0 to 1023; pass full_scale=2047 "
    with pytest.raises(UnreadableFile, match=said):
        read_camera_picture(file, full_scale=1023)
    with pytest.raises(BadValue, match="full_scale"):
        read_camera_picture(file, full_scale=-1)
