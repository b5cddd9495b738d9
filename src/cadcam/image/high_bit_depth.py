"""Samples of more than 8 bits that Pillow would reduce to 8, turn to negatives or not read: of PNG, TIFF and PPM files.

These are those of several channels, grey TIFF of which 0 is white, and floats of 16 or 64 bits. PNG is decoded by
libspng (pyspng), TIFF by tifffile, with its codecs (the extra `codecs`) where a file is compressed with more than
deflate. The functions raise `ValueError` with the reason in words; `picture` names the file.
"""

from __future__ import annotations

import io
import re
import struct
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from cadcam.errors import MissingExtra

Samples: TypeAlias = npt.NDArray[Any]

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: slice(1), 2: slice(3), 4: slice(0, 4, 3), 6: slice(4)}  # colour type -> which of RGBA
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PPM = re.compile(
    rb"P([2356])(?:\s+(?:#[^\n]*\n\s*)*(\d+))(?:\s+(?:#[^\n]*\n\s*)*(\d+))(?:\s+(?:#[^\n]*\n\s*)*(\d+))\s"
)
_CUT = "cut off or damaged"
_ZERO_IS_WHITE, _ZERO_IS_BLACK, _RGB = 0, 1, 2  # TIFF 6.0, PhotometricInterpretation
_PREMULTIPLIED, _ALPHA = 1, 2  # ... and ExtraSamples; any other says nothing of transparency


class Deep(NamedTuple):
    """Samples (H, W, C) as stored, the value that means white, and the EXIF orientation as found."""

    samples: Samples
    white: float
    orientation: int


def deep_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) of a file this module must decode, or None where Pillow keeps the full depth."""
    if data.startswith(_PNG):
        if len(data) < 26 or data[24] != 16 or data[25] not in _PNG_CHANNELS:
            return None
        if data[25] == 0 and transparent_color(data) is None:
            return None  # of grey Pillow keeps 16 bits, but not which of them is transparent
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if header := _ppm_header(data):
        return header.width, header.height
    return _tiff_size(data) if data[:4] in _TIFF else None


def read_deep(data: bytes) -> Deep:
    """Return the samples of a file for which `deep_size` gave a size."""
    if data.startswith(_PNG):
        return Deep(_read_png(data), 65535.0, _png_orientation(data))
    return _read_ppm(data) if data[:1] == b"P" else _read_tiff(data)


def _read_png(data: bytes) -> Samples:
    import pyspng
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        image.verify()  # every chunk's checksum, which pyspng does not look at
    try:
        samples: Samples = pyspng.c.spng_decode_image_bytes(data, pyspng.c.SPNG_FMT_RGBA16)
    except RuntimeError as error:
        raise ValueError(f"{_CUT} ({str(error).removeprefix('pyspng: ')})") from None
    seen, key = samples[..., _PNG_CHANNELS[data[25]]], transparent_color(data)
    if key is None or data[25] not in (0, 2):
        return seen
    clear = (seen == np.array(key, np.uint16)).all(axis=2, keepdims=True)  # pyspng would call every pixel opaque
    return np.concatenate([seen, np.where(clear, 0, 65535).astype(np.uint16)], axis=2)


def transparent_color(data: bytes) -> tuple[int, ...] | None:
    """Return the stored sample (grey) or samples (red, green, blue) that a PNG without alpha calls transparent.

    None without any, and for palettes, whose entries each have an opacity. Source: ISO/IEC 15948, tRNS.
    """
    at = 8 if data.startswith(_PNG) and data[25:26] in (b"\0", b"\2") else len(data)
    while at + 8 <= len(data) and (name := data[at + 4 : at + 8]) != b"IDAT":
        size = int.from_bytes(data[at : at + 4], "big")
        if name == b"tRNS":
            count = 1 if data[25] == 0 else 3
            return struct.unpack_from(f">{count}H", data, at + 8) if size == 2 * count else None
        at += 12 + size
    return None


def deep_orientation(data: bytes) -> int:
    """Return the EXIF orientation in a file for which `deep_size` gave a size, as found; 1 where there is none."""
    if data.startswith(_PNG):
        return _png_orientation(data)
    return 1 if data[:1] == b"P" else _tiff_orientation(_tiff_page(data))


def _tiff_orientation(page: Any) -> int:
    orientation = page.tags.get(274)
    return int(orientation.value) if orientation else 1


def _png_orientation(data: bytes) -> int:
    """Return the orientation in the eXIf chunk; Pillow decodes all pixels to look for it, so only if it is there."""
    if b"eXIf" not in data:
        return 1
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return int(image.getexif().get(274, 1))


class _PpmHeader(NamedTuple):
    plain: bool  # samples as text
    channels: int
    width: int
    height: int
    largest: int
    start: int  # first byte of the samples


def _ppm_header(data: bytes) -> _PpmHeader | None:
    """Return the header of a PGM or PPM of 16-bit samples, None for any other file."""
    found = _PPM.match(data[:4096])
    if found is None or not 255 < int(found[4]) < 65536:
        return None
    kind = int(found[1])
    width, height, largest = (int(found[k]) for k in (2, 3, 4))
    return _PpmHeader(kind < 5, 1 if kind in (2, 5) else 3, width, height, largest, found.end())


def _read_ppm(data: bytes) -> Deep:
    header = _ppm_header(data)
    if header is None:
        raise ValueError("not a 16-bit PGM or PPM")
    need = header.width * header.height * header.channels
    if header.plain:
        text = re.sub(rb"#[^\r\n]*", b"", data[header.start :])
        samples: Samples = np.fromstring(text, np.int64, sep=" ")[:need]  # told how many, it invents those missing
    else:
        samples = np.frombuffer(data[header.start : header.start + 2 * need], ">u2")
    if len(samples) < need:
        raise ValueError("its pixel data are cut off")
    if not 0 <= int(samples.min()) <= int(samples.max()) < 65536:
        raise ValueError(f"its samples go from {samples.min()} to {samples.max()}, which are not 16 bits")
    shape = (header.height, header.width, header.channels)
    return Deep(samples.astype(np.uint16).reshape(shape), float(header.largest), 1)


def _tiff_page(data: bytes) -> Any:
    """Return the first page of a TIFF."""
    import logging

    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # what it logs is raised here, or harmless
    try:
        return tifffile.TiffFile(io.BytesIO(data)).pages[0]
    except Exception as error:  # tifffile raises whatever a damaged directory happens to trip over
        raise ValueError(f"{_CUT} ({error})") from None


def tiff_pages(data: bytes) -> int:
    """Return how many pictures a TIFF holds beside those reduced from another, as thumbnails; 1 for any other file."""
    if data[:4] not in _TIFF:
        return 1
    try:
        pages = _tiff_page(data).parent.pages
        return max(1, sum(not (page.is_reduced or page.is_mask) for page in pages))
    except Exception:  # tifffile's, as for the first page; whoever reads that says what is wrong
        return 1


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    page = _tiff_page(data)
    kind = page.dtype.kind if page.dtype is not None else ""
    deep = page.bitspersample > 8 and (page.samplesperpixel > 1 or page.photometric == _ZERO_IS_WHITE)
    deep |= kind == "f" and page.bitspersample != 32
    return (page.imagewidth, page.imagelength) if deep else None


def _read_tiff(data: bytes) -> Deep:
    page = _tiff_page(data)
    try:
        samples = np.asarray(page.asarray())
    except Exception as error:
        if "imagecodecs" in str(error):
            kind = f"a {page.compression.name}-compressed TIFF of {page.bitspersample}-bit samples"
            raise MissingExtra(kind, "codecs", "imagecodecs") from None
        raise ValueError(f"{_CUT} ({error})") from None
    if page.planarconfig == 2 and samples.ndim == 3:  # one plane a channel
        samples = np.moveaxis(samples, 0, -1)
    photometric, real = int(page.photometric), samples.dtype.kind == "f"
    known = samples.ndim in (2, 3) and photometric in (_ZERO_IS_WHITE, _ZERO_IS_BLACK, _RGB)
    if not known or not (real or samples.dtype == np.uint16):
        raise ValueError(f"this kind of TIFF is not supported (samples {samples.dtype}, colour model {photometric})")
    white = 1.0 if real else float((1 << page.bitspersample) - 1)
    if photometric == _ZERO_IS_WHITE:
        samples = samples.dtype.type(white) - samples
    return Deep(_seen(page, samples, white), white, _tiff_orientation(page))


def _seen(page: Any, samples: Samples, white: float) -> Samples:
    """Return the channels that are seen: colour or grey, and alpha where the file says that a channel is it."""
    if samples.ndim == 2:
        return samples
    colours, extra = (3 if int(page.photometric) == _RGB else 1), tuple(int(kind) for kind in page.extrasamples)
    if len(extra) == samples.shape[2] - colours and extra[:1] == (_ALPHA,):
        return samples[..., : colours + 1]
    if len(extra) == samples.shape[2] - colours and extra[:1] == (_PREMULTIPLIED,):
        return _unmultiplied(samples[..., : colours + 1], white)
    return samples[..., :colours]


def _unmultiplied(samples: Samples, white: float) -> Samples:
    """Return samples whose colours were stored multiplied by their alpha as if they were not."""
    alpha = samples[..., -1:].astype(np.float64) / white
    colours = np.minimum(samples[..., :-1] / np.maximum(alpha, 1e-12), white)
    return np.concatenate([colours.astype(samples.dtype), samples[..., -1:]], axis=2)
