from __future__ import annotations

import io
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from cadcam.errors import BadValue, MissingExtra, UnknownName, UnreadableFile, UnwritableFile
from cadcam.image.camera_picture import pictures_in
from cadcam.image.picture import (
    equalized,
    read_picture,
    read_picture_with_info,
    to_gray,
    to_rgb,
    write_picture,
)

GRAY8 = np.arange(35, dtype=np.uint8).reshape(5, 7) * 7
RGB8 = np.stack([GRAY8, GRAY8[::-1], 255 - GRAY8], axis=2)


def png(samples: np.ndarray, filters: list[int], exif: bytes = b"") -> bytes:
    """Encode 16-bit samples (H, W, C) with the given filter a row, byte by byte as ISO/IEC 15948 section 9 says."""
    height, width, channels = samples.shape
    step, lines = 2 * channels, samples.astype(">u2").view(np.uint8).reshape(height, -1).astype(int)
    raw = bytearray()
    for y, kind in zip(range(height), filters, strict=True):
        raw.append(kind)
        for i, value in enumerate(lines[y]):
            left = lines[y, i - step] if i >= step else 0
            up = lines[y - 1, i] if y else 0
            corner = lines[y - 1, i - step] if y and i >= step else 0
            p = left + up - corner
            nearest = min((abs(p - left), 0, left), (abs(p - up), 1, up), (abs(p - corner), 2, corner))[2]
            raw.append((value - (0, left, up, (left + up) // 2, nearest)[kind]) % 256)
    head = struct.pack(">IIBBBBB", width, height, 16, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    chunks = [(b"IHDR", head), (b"eXIf", exif), (b"IDAT", zlib.compress(bytes(raw))), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
        if body or name == b"IEND"
    )


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.png", {}),
        ("a.bmp", {}),
        ("a.tif", {"compression": "tiff_lzw"}),
        ("a.webp", {"lossless": True}),
        ("a.ppm", {}),
    ],
)
@pytest.mark.parametrize("stored", [GRAY8, RGB8], ids=["gray", "rgb"])
def test_eight_bit_files_give_their_stored_values_over_255(tmp_path, name, options, stored):
    Image.fromarray(stored).save(tmp_path / name, **options)
    picture = read_picture(tmp_path / name)
    assert picture.dtype == np.float32
    if name == "a.webp" and stored.ndim == 2:
        stored = RGB8[..., [0, 0, 0]]  # WebP has no grey
    np.testing.assert_array_equal(picture, stored.astype(np.float32) / np.float32(255))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
def test_all_eight_exif_orientations_are_applied(tmp_path, orientation, name):
    image = Image.fromarray(RGB8.repeat(8, 0).repeat(8, 1))
    exif = Image.Exif()
    exif[274] = orientation
    image.save(tmp_path / name, exif=exif)
    with Image.open(tmp_path / name) as stored:
        expected = np.asarray(ImageOps.exif_transpose(stored), np.float32) / np.float32(255)
    picture, info = read_picture_with_info(tmp_path / name)
    np.testing.assert_array_equal(picture, expected)
    assert info.orientation == orientation
    assert info.size == (picture.shape[1], picture.shape[0])


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_sixteen_bit_png_keeps_every_bit_whatever_its_row_filters(tmp_path, rng, channels):
    samples = rng.integers(0, 65536, (1030, 5, channels), dtype=np.uint16)  # longer than one block of rows
    samples[..., 1:] += samples[..., :1] // 2
    if channels == 4:
        samples[..., -1] = 65535
    filters = rng.integers(0, 5, 1030).tolist()
    (tmp_path / "a.png").write_bytes(png(samples, filters))
    picture, info = read_picture_with_info(tmp_path / "a.png")
    stored = np.rint(picture.astype(float) * 65535).astype(int)
    np.testing.assert_array_equal(stored, samples[..., 0] if channels < 3 else samples[..., :3])
    assert info.bits == 16


def test_sixteen_bit_png_obeys_its_exif_chunk(tmp_path, rng):
    samples = rng.integers(0, 65536, (3, 5, 3), dtype=np.uint16)
    exif = Image.Exif()
    exif[274] = 6
    (tmp_path / "a.png").write_bytes(png(samples, [4, 4, 4], exif.tobytes()[6:]))
    expected = np.rot90(samples, -1) / np.float32(65535)
    np.testing.assert_allclose(read_picture(tmp_path / "a.png"), expected, atol=1e-6)


def test_transparent_pixels_are_laid_over_white(tmp_path):
    rgba = np.zeros((1, 3, 4), np.uint8)
    rgba[0, :, 0] = 255
    rgba[0, :, 3] = [0, 51, 255]
    Image.fromarray(rgba).save(tmp_path / "a.png")
    expected = [[[1, 1, 1], [1, 0.8, 0.8], [1, 0, 0]]]
    np.testing.assert_allclose(read_picture(tmp_path / "a.png"), expected, atol=2e-7)


def test_one_bit_and_palette_files_read_as_grey_and_colour(tmp_path):
    bits = GRAY8 > 100
    Image.fromarray(bits).save(tmp_path / "bits.png")
    np.testing.assert_array_equal(read_picture(tmp_path / "bits.png"), bits.astype(np.float32))
    Image.fromarray(RGB8).quantize(35).save(tmp_path / "palette.png")
    np.testing.assert_allclose(read_picture(tmp_path / "palette.png"), RGB8 / 255.0, atol=1e-6)


def test_sixteen_bit_grey_survives_png_tiff_and_pgm(tmp_path, rng):
    stored = rng.integers(0, 65536, (4, 6), dtype=np.uint16)
    Image.fromarray(stored).save(tmp_path / "a.png")
    Image.fromarray(stored).save(tmp_path / "a.tif")
    (tmp_path / "a.pgm").write_bytes(b"P5\n# a comment\n6 4\n65535\n" + stored.astype(">u2").tobytes())
    for name in ("a.png", "a.tif", "a.pgm"):
        picture = read_picture(tmp_path / name)
        np.testing.assert_array_equal(np.rint(picture.astype(float) * 65535), stored, err_msg=name)


def test_a_pgm_of_twelve_bits_is_white_at_its_own_largest_value(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5 2 1 4095\n" + np.array([0, 4095], ">u2").tobytes())
    np.testing.assert_array_equal(read_picture(tmp_path / "a.pgm"), [[0, 1]])


def test_sixteen_bit_ppm_keeps_every_bit(tmp_path, rng):
    stored = rng.integers(0, 65536, (4, 6, 3), dtype=np.uint16)
    (tmp_path / "a.ppm").write_bytes(b"P6 6 4 65535\n" + stored.astype(">u2").tobytes())
    np.testing.assert_array_equal(np.rint(read_picture(tmp_path / "a.ppm").astype(float) * 65535), stored)


def deep_tiff(stored: np.ndarray, **options: object) -> bytes:
    file = io.BytesIO()
    tifffile.imwrite(file, stored, photometric="rgb", **options)
    return file.getvalue()


@pytest.mark.parametrize(
    "options", [{}, {"compression": "zlib"}, {"byteorder": ">"}, {"bigtiff": True}, {"tile": (16, 16)}]
)
def test_sixteen_bit_colour_tiff_keeps_every_bit(tmp_path, rng, options):
    stored = rng.integers(0, 65536, (40, 30, 3), dtype=np.uint16)
    (tmp_path / "a.tif").write_bytes(deep_tiff(stored, **options))
    np.testing.assert_array_equal(np.rint(read_picture(tmp_path / "a.tif").astype(float) * 65535), stored)


def test_planes_of_a_colour_tiff_become_channels(tmp_path, rng):
    stored = rng.integers(0, 65536, (40, 30, 3), dtype=np.uint16)
    (tmp_path / "a.tif").write_bytes(deep_tiff(np.moveaxis(stored, -1, 0), planarconfig="separate"))
    np.testing.assert_array_equal(np.rint(read_picture(tmp_path / "a.tif").astype(float) * 65535), stored)


def test_a_codec_that_is_not_installed_is_named_as_an_extra(tmp_path, monkeypatch):
    def refuse(self: object, *args: object, **options: object) -> None:
        raise ValueError("<COMPRESSION.LZW: 5> requires the 'imagecodecs' package")

    (tmp_path / "a.tif").write_bytes(deep_tiff(np.zeros((4, 5, 3), np.uint16)))
    monkeypatch.setattr(tifffile.TiffPage, "asarray", refuse)
    with pytest.raises(MissingExtra, match=r'16-bit samples needs an optional package: pip install "cadcam\[codecs\]"'):
        read_picture(tmp_path / "a.tif")


def test_float_colour_tiff_is_read(tmp_path, rng):
    stored = rng.random((4, 6, 3), dtype=np.float32)
    (tmp_path / "a.tif").write_bytes(deep_tiff(stored))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif"), stored)


def test_float_values_outside_zero_to_one_are_refused_until_the_caller_says_what_is_white(tmp_path):
    Image.fromarray(np.array([[0, 200.0]], np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(UnreadableFile, match=r"a\.tif: has values from 0 to 200, .*full_scale=255 "):
        read_picture(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif", full_scale=400), [[0, 0.5]])
    with pytest.raises(BadValue, match="full_scale"):
        read_picture(tmp_path / "a.tif", full_scale=0)


@pytest.mark.parametrize(("high", "white"), [(1.25, 1.25), (255.0, 255), (900.0, 1023), (4000.0, 4095), (7e4, 70000)])
def test_of_floats_a_likely_white_is_suggested(tmp_path, high, white):
    Image.fromarray(np.array([[0, high]], np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(UnreadableFile, match=rf"pass full_scale={white:g} \(the value"):
        read_picture(tmp_path / "a.tif")


@pytest.mark.parametrize(("kind", "said"), [(np.int16, "signed 16"), (np.int32, "signed 32"), (np.uint32, "32")])
def test_whole_numbers_without_a_known_white_are_named_as_they_are_stored(tmp_path, kind, said):
    tifffile.imwrite(tmp_path / "a.tif", np.array([[0, 900]], kind))
    with pytest.raises(UnreadableFile, match=f"a.tif: has {said}-bit integer samples from 0 to 900, whose white is"):
        read_picture(tmp_path / "a.tif")
    np.testing.assert_allclose(read_picture(tmp_path / "a.tif", full_scale=1000), [[0, 0.9]])


def test_whole_numbers_of_32_bits_without_a_sign_have_all_their_bits(tmp_path):
    """Half of them were negative, and no full scale helped."""
    tifffile.imwrite(tmp_path / "a.tif", np.array([[0, 2**31, 2**32 - 1]], np.uint32))
    with pytest.raises(UnreadableFile, match="has 32-bit integer samples from 0 to 4294967295, whose white"):
        read_picture(tmp_path / "a.tif")
    np.testing.assert_allclose(read_picture(tmp_path / "a.tif", full_scale=2**32 - 1), [[0, 0.5, 1]], rtol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_float_picture_with_a_hole_is_refused_at_its_pixel(tmp_path, bad):
    stored = np.zeros((3, 4), np.float32)
    stored[1, 2] = bad
    Image.fromarray(stored).save(tmp_path / "a.tif")
    with pytest.raises(UnreadableFile, match=r"not finite at pixel \(x, y\) = \(2, 1\)"):
        read_picture(tmp_path / "a.tif")


def test_missing_folder_empty_and_foreign_files_are_one_clear_error_each(tmp_path):
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("not a picture")
    for name, reason in [("none.png", "no such file"), ("", "is a folder"), ("empty.png", "is empty")]:
        with pytest.raises(UnreadableFile, match=reason):
            read_picture(tmp_path / name)
    with pytest.raises(UnreadableFile, match=r"text\.png: is not a picture in a format known here; use PNG"):
        read_picture(tmp_path / "text.png")


SAVED = {
    "a.png": {},
    "a.jpg": {},
    "a.bmp": {},
    "a.tif": {},
    "lzw.tif": {"compression": "tiff_lzw"},
    "a.ppm": {},
    "a.webp": {},
    "deep.png": {},
    "deep.tif": {},
    "deep.ppm": {},
}


def saved(name: str, rng: np.random.Generator) -> bytes:
    stored = rng.integers(0, 65536, (24, 32, 3), dtype=np.uint16)
    whole = io.BytesIO()
    if name == "deep.png":
        whole.write(png(stored, [4] * 24))
    elif name == "deep.ppm":
        whole.write(b"P6 32 24 65535\n" + stored.tobytes())
    elif name == "deep.tif":
        whole.write(deep_tiff(stored, compression="zlib"))
    else:
        form = Image.registered_extensions()[Path(name).suffix]
        Image.fromarray((stored >> 8).astype(np.uint8)).save(whole, form, **SAVED[name])
    return whole.getvalue()


@pytest.mark.parametrize("name", SAVED)
def test_a_file_cut_anywhere_gives_one_error_and_no_warning(tmp_path, rng, name, capfd):
    data = saved(name, rng)
    for share in (0.002, 0.02, 0.1, 0.5, 0.9):
        (tmp_path / name).write_bytes(data[: max(1, int(share * len(data)))])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(UnreadableFile, match=name):
                read_picture(tmp_path / name)
    assert capfd.readouterr().err == ""  # libtiff and libpng write there


@pytest.mark.parametrize("name", SAVED)
def test_a_file_with_changed_bytes_is_read_or_refused_but_never_crashes(tmp_path, rng, name):
    data = saved(name, rng)
    for _ in range(60):
        damaged = bytearray(data)
        for at in rng.integers(0, min(len(data), rng.choice([40, 400, 10**9])), 3):
            damaged[at] = rng.integers(256)
        (tmp_path / name).write_bytes(damaged)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                picture = read_picture(tmp_path / name, max_pixels=10_000_000)
            except UnreadableFile:
                continue
        assert picture.min() >= 0
        assert picture.max() <= 1


def test_a_damaged_chunk_of_a_deep_png_is_named(tmp_path):
    data = bytearray(png(np.zeros((5, 7, 3), np.uint16), [0] * 5))
    data[data.index(b"IDAT") + 12] ^= 1
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(UnreadableFile, match="IDAT"):
        read_picture(tmp_path / "a.png")


def test_a_picture_above_the_pixel_limit_is_refused_by_size_before_it_is_unpacked(tmp_path):
    Image.fromarray(GRAY8).save(tmp_path / "a.png")
    (tmp_path / "deep.png").write_bytes(png(np.zeros((5, 7, 3), np.uint16), [0] * 5))
    for name in ("a.png", "deep.png"):
        with pytest.raises(UnreadableFile, match=r"is 7 x 5 px = 35 pixels.*limit of 34; .*or `--binning`$"):
            read_picture(tmp_path / name, max_pixels=34)
        with pytest.raises(UnreadableFile, match="more than the limit of nan"):
            read_picture(tmp_path / name, max_pixels=float("nan"))  # type: ignore[arg-type]  # a limit nobody exceeds
        assert read_picture(tmp_path / name, max_pixels=35).shape[:2] == (5, 7)


def test_a_picture_beyond_pillows_own_limit_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    Image.fromarray(GRAY8).save(tmp_path / "a.png")
    assert read_picture(tmp_path / "a.png").shape == (5, 7)
    assert Image.MAX_IMAGE_PIXELS == 10


def test_a_header_that_promises_a_huge_picture_costs_no_memory(tmp_path):
    head = struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 16, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + head + struct.pack(">I", zlib.crc32(b"IHDR" + head))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with pytest.raises(UnreadableFile, match="more than the limit"):
        read_picture(tmp_path / "a.png")


def test_a_ppm_without_pixels_is_refused(tmp_path):
    (tmp_path / "a.ppm").write_bytes(b"P6 0 5 65535\n")
    with pytest.raises(UnreadableFile, match="no pixels"):
        read_picture(tmp_path / "a.ppm")


def test_written_pictures_read_back_within_half_a_level(tmp_path, rng):
    color = rng.random((6, 8, 3), dtype=np.float32)
    write_picture(tmp_path / "new" / "a.png", color)
    np.testing.assert_allclose(read_picture(tmp_path / "new" / "a.png"), color, atol=0.5 / 255 + 1e-6)
    write_picture(tmp_path / "b.png", color[..., 0], bits=16)
    np.testing.assert_allclose(read_picture(tmp_path / "b.png"), color[..., 0], atol=0.5 / 65535 + 1e-6)
    write_picture(tmp_path / "c.jpg", np.full((16, 16), 0.5))
    np.testing.assert_allclose(read_picture(tmp_path / "c.jpg"), 0.5, atol=2 / 255)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.png", "c.jpg", "new"]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    (tmp_path / "a.png").write_bytes(b"old")
    for picture in (np.full((2, 2), np.nan), np.zeros((2, 2, 4)), np.zeros((0, 2))):
        with pytest.raises(BadValue, match="picture"):
            write_picture(tmp_path / "a.png", picture)
    with pytest.raises(UnknownName, match=r"unknown picture suffix '.gif'"):
        write_picture(tmp_path / "a.gif", np.zeros((2, 2)))
    with pytest.raises(BadValue, match="bits"):
        write_picture(tmp_path / "a.png", np.zeros((2, 2, 3)), bits=16)
    with pytest.raises(UnwritableFile, match=r"a\.png"):
        write_picture(tmp_path / "a.png" / "b.png", np.zeros((2, 2)))
    (tmp_path / "c.png").mkdir()
    with pytest.raises(UnwritableFile, match="folder"):
        write_picture(tmp_path / "c.png", np.zeros((2, 2)))
    assert (tmp_path / "a.png").read_bytes() == b"old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "c.png"]


def test_a_written_file_has_the_permissions_that_new_files_get_and_keeps_those_it_had(tmp_path):
    """Not those of a temporary file, which only its owner may read."""
    (tmp_path / "plain").touch()
    picture = tmp_path / "a.png"
    write_picture(picture, np.zeros((2, 2)))
    assert picture.stat().st_mode == (tmp_path / "plain").stat().st_mode
    picture.chmod(0o640)
    write_picture(picture, np.ones((2, 2)))
    assert picture.stat().st_mode & 0o777 == 0o640


def test_a_name_too_long_for_the_system_is_refused(tmp_path):
    with pytest.raises(UnwritableFile, match="too long"):
        write_picture(tmp_path / (300 * "x" + ".png"), np.zeros((2, 2)))


def test_grey_and_colour_convert_by_bt709_luma():
    np.testing.assert_allclose(to_gray([[[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]])[0], [0.2126, 0.7152, 0.0722, 1])
    np.testing.assert_array_equal(to_rgb([[0.25]]), [[[0.25] * 3]])
    np.testing.assert_array_equal(to_gray([[0.25]]), [[0.25]])


def test_equalized_grey_values_are_their_ranks_and_keep_their_order(rng):
    gray = rng.random((100, 100), dtype=np.float32) ** 2
    flat = equalized(gray)
    order = np.argsort(gray.ravel())
    assert (np.diff(flat.ravel()[order]) >= 0).all()
    # the lowest level of 65536 holds x**2 < 0.5/65535: 0.3 % of the pixels, all given rank 0
    np.testing.assert_allclose(np.sort(flat.ravel()), np.linspace(0, 1, gray.size), atol=0.01)
    assert abs(flat.mean() - 0.5) < 0.01
    assert equalized(np.full((3, 3), 0.25)).max() == 0.25


def test_equalizing_keeps_black_black_however_much_of_it_there_is():
    """A half-black picture of three levels: the ranks are counted above the lowest one."""
    np.testing.assert_allclose(equalized([[0.1, 0.1, 0.1, 0.1, 0.5, 0.5, 0.9, 0.9]]), [[0, 0, 0, 0, 0.5, 0.5, 1, 1]])


def test_real_photos_are_read_as_their_own_size(shared):
    for path, size in [(shared("data/dbat_camcal"), None), (shared("data/visp_mbt_cube"), None)]:
        photo = next(p for p in sorted(path.rglob("*")) if p.suffix.lower() in (".jpg", ".png", ".pgm"))
        picture, info = read_picture_with_info(photo)
        assert picture.max() <= 1
        assert info.size == picture.shape[1::-1]
        assert size is None or info.size == size


def test_alpha_is_stored_beside_colours_that_it_does_not_change(tmp_path):
    rng = np.random.default_rng(11)
    rgb, alpha = rng.integers(0, 256, (5, 7, 3)), rng.integers(0, 256, (5, 7))
    write_picture(tmp_path / "a.png", rgb / 255, alpha=alpha / 255)
    with Image.open(tmp_path / "a.png") as stored:
        assert stored.mode == "RGBA"
        assert np.array_equal(np.asarray(stored), np.dstack([rgb, alpha]))
    over_white = rgb / 255 * (alpha / 255)[..., None] + (1 - alpha / 255)[..., None]
    assert np.abs(read_picture(tmp_path / "a.png") - over_white).max() < 1e-6


@pytest.mark.parametrize(
    ("name", "alpha", "message"),
    [("a.jpg", np.ones((5, 7)), "only a PNG"), ("a.png", np.ones((7, 5)), "that of the picture")],
)
def test_alpha_that_cannot_be_stored_is_refused(tmp_path, name, alpha, message):
    with pytest.raises(BadValue, match=message):
        write_picture(tmp_path / name, np.ones((5, 7)), alpha=alpha)
    assert not list(tmp_path.iterdir())


def test_a_picture_too_long_for_a_jpeg_is_refused_before_the_encoder_sees_it(tmp_path):
    with pytest.raises(BadValue, match="at most 65500 px a side in a JPEG; use PNG"):
        write_picture(tmp_path / "a.jpg", np.zeros((1, 65501), np.float32))
    write_picture(tmp_path / "a.jpg", np.zeros((1, 65500), np.float32))
    assert read_picture(tmp_path / "a.jpg").shape == (1, 65500)


@pytest.mark.parametrize("suffix", [".gif", ".webp", ".tif"])
def test_a_file_of_several_pictures_is_known_as_one(tmp_path, suffix):
    """An animated GIF was one frame without a word."""
    rng = np.random.default_rng(1)
    frames = [Image.fromarray(rng.integers(0, 255, (8, 9), np.uint8)) for _ in range(3)]
    frames[0].save(tmp_path / f"three{suffix}", save_all=True, append_images=frames[1:])
    frames[0].save(tmp_path / f"one{suffix}")
    assert pictures_in(tmp_path / f"three{suffix}") == 3
    assert pictures_in(tmp_path / f"one{suffix}") == 1
    (tmp_path / f"none{suffix}").write_bytes(b"nothing")
    assert pictures_in(tmp_path / f"none{suffix}") == 1
