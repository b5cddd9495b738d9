"""Photos as float32 arrays in [0, 1], read at full depth and the right way up, and written whole or not at all.

A picture is (H, W) grey or (H, W, 3) red, green, blue; `picture[y, x]` is the sample at pixel centre q = (x, y).
Values are those of the file divided by its white: no gamma is undone and no colour profile applied.
"""

from __future__ import annotations

import hashlib
import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Picture
from cadcam.errors import BadValue, UnknownName, UnreadableFile
from cadcam.image.decode import Decoded, finished, first_pixel, orientation_in, stored
from cadcam.image.suffixes import FORMS
from cadcam.kinds import expect_count, expect_path, expect_positive, said
from cadcam.whole import write_whole

MAX_PIXELS = 500_000_000
LUMA = (0.2126, 0.7152, 0.0722)  # ITU-R BT.709

_FOURTEEN_BITS = 1 << 14  # 16-bit numbers below it may be a camera's 10, 12 or 14 bits
_STEP = 16  # samples that are all multiples of it fill their 16 bits from the top (12 bits: by 16; 10 bits: by 64)
_DOUBLED = 257  # ... or were bytes, each written twice
# How a picture is turned when it is read, by its EXIF orientation, 1 to 8 (EXIF 2.32, tag 0x0112).
_TURNS = (
    "",
    "mirrored left to right",
    "turned by 180 degrees",
    "mirrored top to bottom",
    "mirrored and turned by 90 degrees",
    "turned by 90 degrees to the right",
    "mirrored and turned by 90 degrees",
    "turned by 90 degrees to the left",
)
_BRIGHTEST = 100.0  # times white: no lamp in view is brighter, every photo in bytes is
_PACKED = 4  # of zlib's 9: a PNG a tenth longer than by its default, in a third of the time (24 Mpx: 2 s, not 5)
_LONGEST_JPEG = 65500  # px: libjpeg's own limit, a little below that of the format


@dataclass(frozen=True, slots=True)
class PictureInfo:
    """Where a picture came from: file, its hash, size (width, height) as shown, bits a sample, EXIF orientation.

    white: the stored value that was taken as white.
    """

    path: str
    sha256: str
    size: tuple[int, int]
    bits: int
    orientation: int
    white: float

    @property
    def used_bits(self) -> int | None:
        """Return how many bits white fills: 12 where it is 4095; None where it is no such number, as of floats."""
        bits = int(self.white).bit_length()
        return bits if self.white == (1 << bits) - 1 and bits > 1 else None


def read_picture(
    path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS, full_scale: float | None = None
) -> Picture:
    """Return the picture in a PNG, JPEG, TIFF, PGM/PPM, BMP or WebP file, float32 in [0, 1], (H, W) or (H, W, 3).

    EXIF orientation is applied, so rows run down the picture as it is looked at. Transparent pixels are laid over
    white, as a viewer shows them. Of a file with several pictures the first is read. `full_scale` is the stored
    value that means white: by default 255, 65535 or 1.0 by the file's sample type. Of a camera that stores 12 bits
    in 16, `read_camera_picture` finds it. Raises `UnreadableFile` naming file, reason and remedy; a picture of more
    than `max_pixels` (by default 500 million) is refused before it is unpacked.
    """
    return read_picture_with_info(path, max_pixels=max_pixels, full_scale=full_scale)[0]


def read_picture_with_info(
    path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS, full_scale: float | None = None
) -> tuple[Picture, PictureInfo]:
    """Return the picture as `read_picture` does, and where it came from."""
    check_full_scale(full_scale)
    data = file_bytes(path)
    held = stored(path, data, max_pixels=max_pixels)
    return with_info(path, data, finished(path, held, full_scale or held.white))


def turned_in(path: str | os.PathLike[str]) -> str:
    """Return in words how a picture is turned when it is read, as its EXIF orientation says; "" if it is not."""
    return _TURNS[orientation_in(path, file_bytes(path)) - 1]


def check_full_scale(full_scale: float | None, name: str = "full_scale") -> None:
    """Raise `BadValue` naming `name` for what cannot be the stored value of white; None can."""
    if full_scale is not None:
        expect_positive(full_scale, name, "a positive number: the stored value that means white")


def with_info(path: str | os.PathLike[str], data: bytes, read: Decoded) -> tuple[Picture, PictureInfo]:
    """Return a decoded picture, and where it came from."""
    size, digest = (read.picture.shape[1], read.picture.shape[0]), hashlib.sha256(data).hexdigest()
    return read.picture, PictureInfo(os.fspath(path), digest, size, read.bits, read.orientation, read.white)


def write_picture(
    path: str | os.PathLike[str],
    picture: npt.ArrayLike,
    *,
    alpha: npt.ArrayLike | None = None,
    bits: int = 8,
    quality: int = 95,
) -> None:
    """Write a picture as PNG or JPEG by its suffix, whole or not at all; missing folders are made.

    Values are clipped to [0, 1] and rounded. `alpha` (H, W) makes a PNG transparent: 0 is clear, 1 opaque, and the
    picture's colours are not multiplied by it. `bits=16` is for grey PNG, which then says that all 16 are significant
    (so that a dark one is not taken for 12 bits in 16); `quality` for JPEG. Raises `UnknownName` for
    another suffix, `BadValue` for NaN or a wrong shape, `UnwritableFile` where the system refuses.
    """
    expect_path(path)
    suffix = Path(path).suffix.lower()
    if suffix not in FORMS:
        raise UnknownName("picture suffix", suffix, FORMS)
    write_whole(path, encoded(picture, FORMS[suffix], alpha=alpha, bits=bits, quality=quality))


def encoded(
    picture: npt.ArrayLike, form: str, *, alpha: npt.ArrayLike | None = None, bits: int = 8, quality: int = 95
) -> bytes:
    """Return the bytes of a "PNG" or "JPEG" file of the picture; see `write_picture`."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    values = checked(picture)
    if alpha is not None:
        values = _with_alpha(values, alpha, form)
    if bits not in (8, 16) or (bits == 16 and (values.ndim == 3 or form != "PNG")):
        raise BadValue("bits", bits, "8, or 16 for a grey PNG")
    expect_count(quality, "quality", most=100)
    if form == "JPEG" and max(values.shape[:2]) > _LONGEST_JPEG:
        raise BadValue("picture", f"of shape {values.shape}", f"at most {_LONGEST_JPEG} px a side in a JPEG; use PNG")
    samples = np.zeros(values.shape, np.uint8 if bits == 8 else np.uint16)
    for row, some in enumerate(values):  # row by row, as large pictures should not be held once more
        samples[row] = np.clip(some, 0.0, 1.0) * np.float32(np.iinfo(samples.dtype).max) + np.float32(0.5)
    file = io.BytesIO()
    options: dict[str, Any] = {"compress_level": _PACKED}
    if form == "JPEG":
        options = {"quality": quality, "subsampling": 0}
    if bits == 16:
        options["pnginfo"] = PngInfo()
        options["pnginfo"].add(b"sBIT", bytes([16]))
    Image.fromarray(samples).save(file, form, **options)
    return file.getvalue()


def covering(picture: npt.ArrayLike, size: tuple[int, int], place: tuple[float, float]) -> Picture:
    """Return the picture in colour, scaled to cover `size` (width, height) px, cut where it is too long.

    place: which part of what is too long is cut off at the left or top, a share in [0, 1]. In steps of 1/255.
    """
    from PIL import Image

    rgb = (np.clip(to_rgb(picture), 0, 1) * 255 + 0.5).astype(np.uint8)
    scale = min(rgb.shape[1] / size[0], rgb.shape[0] / size[1])
    width, height = scale * size[0], scale * size[1]
    x, y = place[0] * (rgb.shape[1] - width), place[1] * (rgb.shape[0] - height)
    cut = Image.fromarray(rgb).resize(size, Image.Resampling.BILINEAR, box=(x, y, x + width, y + height))
    return np.asarray(np.asarray(cut, np.float32) / np.float32(255), np.float32)


def decoded_jpeg(data: bytes) -> Picture:
    """Return the picture in the bytes of a JPEG that `encoded` made."""
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(np.asarray(image, np.float32) / np.float32(255), np.float32)


def checked(picture: npt.ArrayLike) -> Picture:
    """Return the picture as a float32 array in [0, 1] (not copied if it is one); raise `BadValue` on shape or NaN.

    Bytes and 16-bit numbers, as cameras and OpenCV give them, are divided by 255 and 65535; 16-bit numbers of which
    none needs more than 14 bits are refused, as white may be 1023, 4095 or 16383. Floats may exceed 1, as bright light
    does; those that can only be such numbers made floats are refused.
    """
    if np.ma.is_masked(picture):  # numpy would give what is under the mask
        raise BadValue("picture", "masked in places", "every pixel: picture.filled(0) has a value for those masked")
    try:
        given = np.asarray(picture)
        if given.dtype.kind not in "biuf":
            raise TypeError("neither numbers nor truth values")
        values = np.asarray(given, np.float32)
    except (TypeError, ValueError) as error:
        raise BadValue("picture", said(picture), "numbers of shape (H, W) or (H, W, 3)") from error
    if not (values.ndim == 2 or (values.ndim == 3 and values.shape[2] == 3)) or 0 in values.shape:
        raise BadValue("picture", f"of shape {values.shape}", "shape (H, W) or (H, W, 3), none of them zero")
    if given.dtype == np.uint16:
        _refuse_unknown_white(given)
    if given.dtype in (np.uint8, np.uint16):
        return np.asarray(values / np.float32(np.iinfo(given.dtype).max), np.float32)
    darkest, brightest = values.min(), values.max()  # NaN where any number is
    if not (np.isfinite(darkest) and np.isfinite(brightest)):
        raise BadValue("picture", "not finite at " + first_pixel(~np.isfinite(values)), "finite values")
    if brightest > (1 if given.dtype.kind in "iu" else _BRIGHTEST):
        white = "255, or give uint8" if brightest <= 255 else "255, 4095 (12 bits) or 65535, whichever is its white"
        raise BadValue("picture", f"as bright as {brightest:g}", f"values in [0, 1]: divide by {white}")
    if darkest < 0 and given.dtype.kind == "i":
        raise BadValue("picture", f"of whole numbers down to {darkest:g}", "0 or more: unsigned ones, as cameras give")
    return values


def _refuse_unknown_white(given: npt.NDArray[np.uint16]) -> None:
    """Raise `BadValue` for 16-bit numbers of which it cannot be told what white is; black ones are black anyway."""
    brightest = int(given.max())
    if 0 < brightest < _FOURTEEN_BITS and not filled_from_top(given):
        white = next(w for w in (1023, 4095, 16383) if brightest <= w)
        raise BadValue(
            "picture",
            f"of 16-bit numbers of which none exceeds {brightest}",
            f"it divided by its white: picture / {white} if that is a camera's, picture / 65535 if it is dark",
        )


def filled_from_top(samples: npt.NDArray[np.unsignedinteger[Any]]) -> bool:
    """Return whether 16-bit samples fill their bits from the top: multiples of 16, or bytes written twice."""
    used = int(np.bitwise_or.reduce(samples, axis=None))
    return used % _STEP == 0 or not (samples % _DOUBLED).any()


def to_gray(picture: npt.ArrayLike) -> Picture:
    """Return the (H, W) luma of a picture: ITU-R BT.709 weights on the values as stored (not linear luminance).

    Edges stay where they are and noise stays about uniform in gamma-coded values; a grey picture is returned as it
    is.
    """
    values = checked(picture)
    return values if values.ndim == 2 else values @ np.array(LUMA, np.float32)


def to_rgb(picture: npt.ArrayLike) -> Picture:
    """Return the (H, W, 3) colour picture; grey is repeated three times in a new array."""
    values = checked(picture)
    return values if values.ndim == 3 else np.repeat(values[..., None], 3, axis=2)


def equalized(gray: npt.ArrayLike) -> Picture:
    """Return the (H, W) picture with its grey values replaced by their rank in [0, 1]: a flat histogram.

    Classic histogram equalisation (Gonzalez and Woods, Digital Image Processing, 3.3) with 65536 levels; used by
    the thesis' added pictures (Fig. 3-4). A picture of a single value is returned unchanged.
    """
    values = checked(gray)
    if values.ndim != 2:
        raise BadValue("picture", f"of shape {values.shape}", "a grey picture (H, W); to_gray makes one")
    level = (np.clip(values, 0.0, 1.0) * 65535.0 + 0.5).astype(np.uint16)
    below = np.cumsum(np.bincount(level.ravel(), minlength=65536))
    lowest = below[level.min()]
    if lowest == values.size:
        return values.copy()
    ranks: Picture = ((below - lowest) / (values.size - lowest)).astype(np.float32)
    return ranks[level]


def _with_alpha(picture: Picture, alpha: npt.ArrayLike, form: str) -> Picture:
    """Return red, green, blue and alpha (H, W, 4)."""
    clear = checked(alpha)
    if form != "PNG":
        raise BadValue("alpha", f"given for a {form}", "none: only a PNG can be transparent")
    if clear.shape != picture.shape[:2]:
        raise BadValue("alpha", f"of shape {clear.shape}", f"shape {picture.shape[:2]}, that of the picture")
    return np.concatenate([to_rgb(picture), clear[..., None]], axis=2)


def file_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return the content of a picture file. Raises `UnreadableFile` where there is none."""
    expect_path(path)
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise UnreadableFile(path, "no such file", "check the path") from None
    except IsADirectoryError:
        raise UnreadableFile(path, "is a folder", "name a picture in it") from None
    except (OSError, ValueError) as error:
        raise UnreadableFile(path, getattr(error, "strerror", None) or str(error)) from error
    if not data:
        raise UnreadableFile(path, "is empty", "copy it again from its source")
    return data
