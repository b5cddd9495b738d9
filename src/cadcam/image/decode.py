"""The content of a picture file as float32 samples: at full depth, divided by its white, laid over white, upright."""

from __future__ import annotations

import io
import os
import struct
import threading
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Picture
from cadcam.errors import BadValue, UnreadableFile
from cadcam.image.high_bit_depth import deep_orientation, deep_size, read_deep, transparent_color

if TYPE_CHECKING:
    from PIL import Image

# Pillow mode -> (mode to convert to, bits a sample, value of white; None where the file does not say)
_MODES: dict[str, tuple[str, int, float | None]] = {
    "1": ("L", 1, 255.0),
    "L": ("L", 8, 255.0),
    "LA": ("LA", 8, 255.0),
    "La": ("LA", 8, 255.0),
    "P": ("RGB", 8, 255.0),
    "PA": ("RGBA", 8, 255.0),
    "RGB": ("RGB", 8, 255.0),
    "RGBX": ("RGB", 8, 255.0),
    "RGBA": ("RGBA", 8, 255.0),
    "RGBa": ("RGBA", 8, 255.0),
    "CMYK": ("RGB", 8, 255.0),
    "YCbCr": ("RGB", 8, 255.0),
    "HSV": ("RGB", 8, 255.0),
    "I;16": ("I;16", 16, 65535.0),
    "I;16L": ("I;16L", 16, 65535.0),
    "I;16B": ("I;16B", 16, 65535.0),
    "I": ("I", 32, None),
    "F": ("F", 32, 1.0),
}
_WHITES = tuple(float((1 << bits) - 1) for bits in (8, 10, 12, 14, 16))
_BITS, _SAMPLE_FORMAT, _SIGNED = 258, 339, 2  # TIFF 6.0
_PARSING = (OSError, ValueError, SyntaxError, TypeError, LookupError, EOFError, OverflowError, struct.error, zlib.error)
_pillow_limit = threading.Lock()  # Pillow's own pixel limit is a module variable


class Decoded(NamedTuple):
    """A picture (H, W) or (H, W, 3) in [0, 1], the right way up; bits a sample, EXIF orientation, white."""

    picture: Picture
    bits: int
    orientation: int
    white: float


class Stored(NamedTuple):
    """What a file holds: samples (H, W) or (H, W, C), bits of each, value of white, orientation, turn yet to do.

    signed: whether the file says that its whole numbers have a sign.
    """

    samples: npt.NDArray[Any]
    bits: int
    white: float | None
    orientation: int
    turn: int
    signed: bool = False


def stored(path: str | os.PathLike[str], data: bytes, *, max_pixels: int) -> Stored:
    """Return the samples in the content of a file called `path`; see `read_picture`, which says what is refused."""
    try:
        return _stored(path, data, max_pixels)
    except UnreadableFile:
        raise
    except MemoryError:
        raise UnreadableFile(path, "does not fit into memory", "crop it or reduce its size") from None
    except _PARSING as error:
        raise UnreadableFile(path, *_explained(error)) from error


def orientation_in(path: str | os.PathLike[str], data: bytes) -> int:
    """Return the EXIF orientation, 1 to 8, in the content of a file called `path`; 1 where none is stated.

    Raises `UnreadableFile` for what is no picture.
    """
    from PIL import Image

    try:
        if deep_size(data) is not None:
            return _valid(deep_orientation(data))
        with _unlimited(), Image.open(io.BytesIO(data)) as image:
            return _orientation(image)
    except _PARSING as error:
        raise UnreadableFile(path, *_explained(error)) from error


def finished(path: str | os.PathLike[str], held: Stored, white: float | None) -> Decoded:
    """Return the picture of a file's samples, `white` the stored value that means white (None: not known)."""
    picture, white = _scaled(path, held, white)
    return Decoded(_upright(_composited(picture), held.turn), held.bits, held.orientation, white)


def _stored(path: str | os.PathLike[str], data: bytes, max_pixels: int) -> Stored:
    with _unlimited():
        return _stored_deep(path, data, max_pixels) or _stored_by_pillow(path, data, max_pixels)


@contextmanager
def _unlimited() -> Iterator[None]:
    """Let Pillow open a picture of any size, which is checked here, and not warn: all is harmless, or checked."""
    from PIL import Image

    with _pillow_limit, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = limit


def _stored_deep(path: str | os.PathLike[str], data: bytes, max_pixels: int) -> Stored | None:
    size = deep_size(data)
    if size is None:
        return None
    _check_size(path, size, max_pixels)
    deep = read_deep(data)
    turn = _valid(deep.orientation)
    return Stored(deep.samples, 8 * deep.samples.dtype.itemsize, deep.white, turn, turn)


def _stored_by_pillow(path: str | os.PathLike[str], data: bytes, max_pixels: int) -> Stored:
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        _check_size(path, image.size, max_pixels)
        orientation = _orientation(image)
        if (key := transparent_color(data)) is not None and image.mode in ("1", "L"):
            # Pillow spreads samples of 1, 2 or 4 bits over 0 to 255, but not the one that is transparent
            image.info["transparency"] = key[0] * 255 // ((1 << data[24]) - 1)
        samples, bits, white = _pillow_samples(image)
        return Stored(samples, bits, white, orientation, _orientation(image), _signed(image))  # Pillow turns TIFF


def _check_size(path: str | os.PathLike[str], size: tuple[int, int], max_pixels: int) -> None:
    width, height = size
    if width < 1 or height < 1:
        raise UnreadableFile(path, f"is {width} x {height} px: no pixels", "export it again from its source")
    if not width * height <= max_pixels:  # NaN is no limit to pass
        raise UnreadableFile(
            path,
            f"is {width} x {height} px = {width * height} pixels, more than the limit of {max_pixels}",
            "if that is its true size, crop or bin it, and its camera by `cadcam convert --crop` or `--binning`",
        )


def _pillow_samples(image: Image.Image) -> tuple[npt.NDArray[Any], int, float | None]:
    if image.mode not in _MODES:
        raise ValueError(f"its colour mode {image.mode} is not supported")
    mode, bits, white = _MODES[image.mode]
    if "transparency" in image.info and mode in ("L", "RGB"):
        mode = "RGBA"
    if image.format == "TIFF":
        stated = image.tag_v2.get(_BITS, (bits,))[0]  # type: ignore[attr-defined]  # of a TIFF
        if bits == 8 and _signed(image):
            raise ValueError("its 8-bit samples are signed")  # Pillow takes -1 for 255
        if bits == 16 and 8 < stated < 16:  # 12, packed: two samples in three bytes
            bits, white = stated, float((1 << stated) - 1)
        if image.mode == "I":  # 32 bits, in which Pillow holds signed ones of 16 as well
            bits = stated
    samples = np.asarray(image if image.mode == mode else image.convert(mode))
    if bits == 32 and samples.dtype == np.int32 and not _signed(image):
        samples = samples.view(np.uint32)  # Pillow has no numbers of 32 bits without a sign
    return samples, bits, white


def frames_in(data: bytes) -> int:
    """Return how many pictures an animation holds; 1 of what is none, or cannot be read."""
    from PIL import Image

    try:
        with _unlimited(), Image.open(io.BytesIO(data)) as image:
            return int(getattr(image, "n_frames", 1))
    except _PARSING:
        return 1


def _signed(image: Image.Image) -> bool:
    """Return whether a file says that its whole numbers have a sign, as only TIFF does."""
    if image.format != "TIFF":
        return False
    return _SIGNED in image.tag_v2.get(_SAMPLE_FORMAT, ())  # type: ignore[attr-defined]  # of a TIFF


def _orientation(image: Image.Image) -> int:
    try:
        return _valid(image.getexif().get(274, 1))
    except _PARSING:  # a damaged EXIF block does not make the pixels unreadable
        return 1


def _valid(value: object) -> int:
    """Return an EXIF orientation 1 to 8; anything else in the tag counts as upright."""
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def _explained(error: BaseException) -> tuple[str, str]:
    """Return reason and remedy for an exception of a decoder."""
    from PIL import UnidentifiedImageError

    if isinstance(error, UnidentifiedImageError):
        return "is not a picture in a format known here", "use PNG, JPEG, TIFF, PGM, PPM, BMP or WebP"
    text = str(error) or type(error).__name__
    if text.startswith("cut off or damaged"):
        return f"is {text}", "copy it again from its source"
    cut = any(word in text for word in ("truncated", "cut off", "not enough", "unrecognized data stream"))
    if cut or isinstance(error, (EOFError, struct.error)):
        return f"is cut off or damaged ({text})", "copy it again from its source"
    return f"cannot be decoded ({text})", "export it again, for instance as PNG"


def _scaled(path: str | os.PathLike[str], held: Stored, white: float | None) -> tuple[Picture, float]:
    """Return samples / white as float32, checked: finite and within [0, 1]; and white."""
    samples = held.samples
    real = samples.dtype.kind == "f"
    if real and not np.isfinite(samples).all():
        where = first_pixel(~np.isfinite(samples))
        raise UnreadableFile(path, f"has a value that is not finite at {where}", "fill such pixels before saving")
    low, high = (samples.min(), samples.max()) if real or white != np.iinfo(samples.dtype).max else (0, 0)
    if white is None:
        kind = f"{'signed ' * held.signed}{held.bits}-bit integer"
        raise UnreadableFile(
            path,
            f"has {kind} samples from {low} to {high}, whose white is not known",
            "say it: --full-scale (full_scale=)",
        )
    if low < 0 or high > white:
        least = _likely_white(float(high)) if real else (1 << int(high).bit_length()) - 1  # the white of their bits
        raise UnreadableFile(
            path,
            f"has values from {low:g} to {high:g}, outside 0 to {white:g}",
            f"pass full_scale={least:g} (the value that means white; --full-scale) or scale it before saving"
            if low >= 0
            else "shift and scale it to 0 ... 1 before saving",
        )
    picture: Picture = np.divide(samples, np.float32(white), dtype=np.float32, casting="same_kind")
    return picture, white


def _likely_white(high: float) -> float:
    """Return what is likely white in samples of floats up to `high`, above 1: that of whole numbers, if they were such.

    Up to 2 they are of a picture in 0 to 1 that goes beyond it.
    """
    return next((white for white in _WHITES if 2 <= high <= white), high)


def _composited(samples: Picture) -> Picture:
    """Return (H, W) or (H, W, 3): alpha, if there, laid over white."""
    if samples.ndim == 2:
        return samples
    if samples.shape[2] in (2, 4):
        alpha = samples[..., -1:]
        samples = samples[..., :-1] * alpha + (1 - alpha)
    if samples.shape[2] == 1:
        return samples[..., 0]
    if samples.shape[2] != 3:
        raise BadValue("picture", f"of {samples.shape[2]} channels", "1 to 4 channels")
    return samples


def _upright(picture: Picture, orientation: int) -> Picture:
    """Return the picture as looked at; EXIF 2.32 tag 0x0112 says on which side the first row and column are."""
    if orientation >= 5:
        picture = picture.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    if orientation in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    return np.ascontiguousarray(picture)


def first_pixel(bad: npt.NDArray[np.bool_]) -> str:
    """Return where the first pixel (y, x) is that is True, as a message says it."""
    y, x = (int(i) for i in np.argwhere(bad)[0][:2])
    return f"pixel (x, y) = ({x}, {y})"
