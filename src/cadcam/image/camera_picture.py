"""Photos of 10, 12 or 14 bits that a camera's software stored in 16, read with the white of their bits.

Software of machine-vision cameras writes Mono10, Mono12 and Mono14 as 16-bit PNG, TIFF or PGM, mostly with the numbers
as the sensor gave them: white is 1023, 4095 or 16383, and no file says which. Divided by 65535 such a photo is nearly
black: its lines drown in the steps of what is computed and shown of it. So white is the least of these that no sample
exceeds. To take 10 bits for 12 or 12 for 10 makes a photo four times as dark or bright, by which nothing is measured
differently; but pictures of one camera need one white, and `full_scale_of` finds it from all of them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cadcam.arrays import Picture
from cadcam.image.decode import Decoded, Stored, finished, frames_in, stored
from cadcam.image.high_bit_depth import tiff_pages
from cadcam.image.picture import MAX_PIXELS, PictureInfo, check_full_scale, file_bytes, filled_from_top, with_info

DEPTHS = (10, 12, 14)  # bits that cameras store in 16, apart from 8 and 16
_WHOLE = 65535
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, slots=True)
class FullScale:
    """The stored value that means white in 16-bit pictures of one camera, and the brightest in all of them."""

    white: float
    brightest: int

    @property
    def bits(self) -> int:
        """Return how many of the 16 bits are used."""
        return int(self.white + 1).bit_length() - 1


def read_camera_picture(
    path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS, full_scale: float | None = None
) -> Picture:
    """Return the picture that a camera's software wrote: as `read_picture`, with the white of 10, 12 or 14 bits in 16.

    White is found from this file alone unless `full_scale` says it; of several pictures of one camera give each the
    `white` of their `full_scale_of`. It counts for samples of more than 8 bits; of bytes white is 255 always. Not
    guessed: the white of PGM files that state their largest value, of TIFF files of 12 bits packed, of PNG files that
    say all 16 bits are significant (sBIT, as ours do), of pictures with transparency, and of samples that fill their 16
    bits from the top.
    """
    return read_camera_picture_with_info(path, max_pixels=max_pixels, full_scale=full_scale)[0]


def read_camera_picture_with_info(
    path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS, full_scale: float | None = None
) -> tuple[Picture, PictureInfo]:
    """Return the picture as `read_camera_picture` does, and where it came from; its `white` is that which was taken."""
    check_full_scale(full_scale)
    data = file_bytes(path)
    return with_info(path, data, _decoded(path, data, max_pixels, full_scale))


def camera_picture_in(data: bytes, name: str) -> Picture:
    """Return the picture in the content of a file, as `read_camera_picture` does; errors call it `name`."""
    return _decoded(name, data, MAX_PIXELS, None).picture


def full_scale_of(paths: Iterable[str | os.PathLike[str]]) -> FullScale | None:
    """Return the one white of all these pictures of one camera; None where it is not in question.

    It is not if the first is of bytes, or says what its white is: of one camera's pictures all are alike. Else all are
    read, up to one that uses more than 14 bits.
    """
    brightest, from_top = 0, True
    for number, path in enumerate(paths):
        data = file_bytes(path)
        held = stored(path, data, max_pixels=MAX_PIXELS)
        if not _is_open(held, data):
            if number == 0:
                return None
            continue
        brightest = max(brightest, int(held.samples.max()))
        from_top = from_top and filled_from_top(held.samples)
        if brightest >= 1 << DEPTHS[-1]:
            break
    return FullScale(_white(brightest, from_top), brightest)


def pictures_in(path: str | os.PathLike[str]) -> int:
    """Return how many pictures a TIFF, GIF or WebP file holds, of which the first is read; thumbnails are none."""
    suffix = Path(path).suffix.lower()
    if suffix in (".tif", ".tiff"):
        return tiff_pages(file_bytes(path))
    return frames_in(file_bytes(path)) if suffix in (".gif", ".webp") else 1


def is_deep(path: str | os.PathLike[str]) -> bool:
    """Return whether a picture's samples have more than 8 bits, so that a white can be stated for it."""
    return stored(path, file_bytes(path), max_pixels=MAX_PIXELS).bits > 8


def _decoded(path: str | os.PathLike[str], data: bytes, max_pixels: int, full_scale: float | None) -> Decoded:
    held = stored(path, data, max_pixels=max_pixels)
    white = held.white
    if held.bits > 8 and full_scale is not None:
        white = full_scale
    elif _is_open(held, data):
        white = _white(int(held.samples.max()), filled_from_top(held.samples))
    return finished(path, held, white)


def _is_open(held: Stored, data: bytes) -> bool:
    """Return whether samples are of 16 bits that may not all be used: nothing in the file says so."""
    samples = held.samples
    sixteen = samples.dtype.kind == "u" and samples.dtype.itemsize == 2 and held.white == _WHOLE
    return sixteen and (samples.ndim == 2 or samples.shape[2] in (1, 3)) and not _says_sixteen(data)


def _says_sixteen(data: bytes) -> bool:
    """Return whether a PNG states that all 16 bits are significant (ISO/IEC 15948, sBIT)."""
    at = data.find(b"sBIT", 0, max(0, data.find(b"IDAT"))) if data.startswith(_PNG) else -1
    return at >= 4 and set(data[at + 4 : at + 4 + int.from_bytes(data[at - 4 : at], "big")]) == {16}


def _white(brightest: int, from_top: bool) -> float:
    if from_top:
        return float(_WHOLE)
    return float(next(((1 << bits) - 1 for bits in DEPTHS if brightest < 1 << bits), _WHOLE))
