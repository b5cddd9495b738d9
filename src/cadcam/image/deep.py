"""Samples of more than 8 bits in several channels: PNG, TIFF and PNM files that Pillow would reduce to 8 bits.

The functions here raise `ValueError` with the reason in words; `cadcam.image.picture` names the file.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

Samples: TypeAlias = npt.NDArray[Any]
Tags: TypeAlias = dict[int, tuple[int, ...]]

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}  # colour type -> samples a pixel
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_BLOCK = 1024  # rows unfiltered together: long enough for numpy, short enough for the cache


class Deep(NamedTuple):
    """Samples (H, W, C) as stored, the value that means white, and the EXIF orientation as found."""

    samples: Samples
    white: float
    orientation: int


def deep_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) of a file this module must decode, or None where Pillow keeps the full depth."""
    if (
        data.startswith(_PNG)
        and data[12:16] == b"IHDR"
        and len(data) > 25
        and data[24] == 16
        and data[25] in _PNG_CHANNELS
    ):
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if header := _pnm_header(data):
        return header[1], header[2]
    if tags := _deep_tiff_tags(data):
        return tags[256][0], tags[257][0]
    return None


def read_deep(data: bytes) -> Deep:
    """Return the samples of a file for which `deep_size` gave a size."""
    if data.startswith(_PNG):
        return Deep(_read_png(data), 65535.0, _png_orientation(data))
    if data[:1] == b"P":
        return _read_pnm(data)
    return _read_tiff(data)


# PNG (ISO/IEC 15948) ---------------------------------------------------------------------------------------


def _read_png(data: bytes) -> Samples:
    parts = []
    for name, body in _chunks(data):
        if name == b"IHDR":
            width, height, _, colour, _, _, interlace = struct.unpack(">IIBBBBB", body)
        elif name == b"IDAT":
            parts.append(body)
    channels = _PNG_CHANNELS[colour]
    passes = _ADAM7 if interlace else ((0, 0, 1, 1),)
    sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in passes]
    need = sum(h * (1 + w * channels * 2) for w, h in sizes if w > 0 and h > 0)
    raw = np.frombuffer(zlib.decompressobj().decompress(b"".join(parts), need), np.uint8)
    if raw.size < need:
        raise ValueError("its pixel data are cut off")
    out = np.zeros((height, width, channels), np.uint16)
    at = 0
    for (x, y, dx, dy), (w, h) in zip(passes, sizes, strict=True):
        if w > 0 and h > 0:
            lines = raw[at : at + h * (1 + w * channels * 2)].reshape(h, -1)
            at += lines.size
            out[y::dy, x::dx] = _unfiltered(lines, channels * 2).view(">u2").reshape(h, w, channels)
    return out


def _png_orientation(data: bytes) -> int:
    for name, body in _chunks(data):
        if name == b"eXIf" and body[:4] in _TIFF:
            return (_tags(body).get(274) or (1,))[0]
    return 1


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield (name, body) of every chunk, its checksum verified."""
    at, name = len(_PNG), b""
    while name != b"IEND":
        if at + 12 > len(data):
            raise ValueError("the file is cut off")
        length, name = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + length]
        if len(body) < length or at + 12 + length > len(data):
            raise ValueError("the file is cut off")
        if zlib.crc32(body, zlib.crc32(name)) != struct.unpack_from(">I", data, at + 8 + length)[0]:
            raise ValueError(f"chunk {name.decode('latin-1')} at byte {at} is damaged (checksum)")
        yield name, body
        at += 12 + length


def _unfiltered(lines: npt.NDArray[np.uint8], step: int) -> npt.NDArray[np.uint8]:
    """Return the bytes of filtered scan lines (H, 1 + W step), `step` bytes a pixel.

    A byte needs its left, upper and upper-left neighbour, so all bytes of one anti-diagonal can be restored at
    once; the diagonals are views into the padded picture with a stride of one row less one pixel.
    """
    rows, width = lines.shape[0], (lines.shape[1] - 1) // step
    kind = lines[:, 0].astype(np.intp)
    if kind.max() > 4:
        raise ValueError(f"scan line {int(np.argmax(kind > 4))} has the unknown filter {kind.max()}")
    out = np.zeros((rows + 1, (width + 1) * step), np.uint8)  # a zero row above, a zero pixel on the left
    out[1:, step:] = lines[:, 1:]
    for top in range(0, rows, _BLOCK):
        block = out[top : top + _BLOCK + 1]
        if (kind[top : top + _BLOCK] > 0).any():
            _unfilter_block(block, kind[top : top + _BLOCK], step, width)
    return np.ascontiguousarray(out[1:, step:])


def _unfilter_block(block: npt.NDArray[np.uint8], kind: npt.NDArray[np.intp], step: int, width: int) -> None:
    pitch = block.shape[1]
    flat = block.reshape(-1)
    for diagonal in range(width + len(kind) - 1):
        first, last = max(0, diagonal - width + 1), min(len(kind) - 1, diagonal)
        here = (first + 1) * pitch + (diagonal - first + 1) * step

        def along(at: int, count: int = last - first + 1) -> npt.NDArray[np.uint8]:
            return np.lib.stride_tricks.as_strided(flat[at:], (count, step), (pitch - step, 1))

        left, up, corner = (along(here - back).astype(np.int16) for back in (step, pitch, pitch + step))
        chosen = kind[first : last + 1, None]
        zero = np.zeros_like(left)
        guess = np.choose(chosen, [zero, left, up, (left + up) >> 1, _paeth(left, up, corner)])
        target = along(here)
        target += guess.astype(np.uint8)


def _paeth(left: Samples, up: Samples, corner: Samples) -> Samples:
    to_left, to_up = np.abs(up - corner), np.abs(left - corner)
    to_corner = np.abs(left + up - 2 * corner)
    vertical = np.where(to_up <= to_corner, up, corner)
    return np.where((to_left <= to_up) & (to_left <= to_corner), left, vertical)


# PNM -------------------------------------------------------------------------------------------------------

_PNM = re.compile(rb"P([56])(?:\s+(?:#[^\n]*\n\s*)*(\d+))(?:\s+(?:#[^\n]*\n\s*)*(\d+))(?:\s+(?:#[^\n]*\n\s*)*(\d+))\s")


def _pnm_header(data: bytes) -> tuple[int, int, int, int, int] | None:
    """Return (channels, width, height, largest value, first byte) of a binary PGM or PPM of 16-bit samples."""
    found = _PNM.match(data[:4096])
    if found is None or not 255 < int(found[4]) < 65536:
        return None
    return 1 if found[1] == b"5" else 3, int(found[2]), int(found[3]), int(found[4]), found.end()


def _read_pnm(data: bytes) -> Deep:
    header = _pnm_header(data)
    assert header is not None  # deep_size said so
    channels, width, height, largest, start = header
    need = width * height * channels
    if (len(data) - start) // 2 < need:
        raise ValueError("its pixel data are cut off")
    samples = np.frombuffer(data, ">u2", need, start)
    return Deep(samples.reshape(height, width, channels), float(largest), 1)


# TIFF 6.0 --------------------------------------------------------------------------------------------------

_TIFF = (b"II*\0", b"MM\0*")
_TIFF_TYPES = {1: "B", 3: "H", 4: "I"}  # byte, short, long: the types of every tag looked at here


def _order(data: bytes) -> str:
    return "<" if data[:2] == b"II" else ">"


def _entries(data: bytes) -> list[bytes]:
    """Return the 12-byte entries of the first directory."""
    (at,) = struct.unpack_from(_order(data) + "I", data, 4)
    (count,) = struct.unpack_from(_order(data) + "H", data, at)
    if at + 2 + 12 * count > len(data):
        raise ValueError("the file is cut off")
    return [data[at + 2 + 12 * i : at + 14 + 12 * i] for i in range(count)]


def _values(data: bytes, entry: bytes) -> tuple[int, ...]:
    order = _order(data)
    _, kind, count = struct.unpack_from(order + "HHI", entry)
    if kind not in _TIFF_TYPES or not 0 < count <= 16:  # longer ones (strip offsets) are not needed here
        return ()
    form = f"{order}{count}{_TIFF_TYPES[kind]}"
    if struct.calcsize(form) <= 4:
        return struct.unpack_from(form, entry, 8)
    return struct.unpack_from(form, data, struct.unpack_from(order + "I", entry, 8)[0])


def _tags(data: bytes) -> Tags:
    """Return tag -> its values, () for those not looked at here, of the first directory."""
    try:
        return {struct.unpack_from(_order(data) + "H", e)[0]: _values(data, e) for e in _entries(data)}
    except struct.error:
        raise ValueError("the file is cut off") from None


def _deep_tiff_tags(data: bytes) -> Tags | None:
    """Return the tags of the first picture if it has several samples a pixel of more than 8 bits, else None."""
    if data[:4] not in _TIFF:
        return None
    tags = _tags(data)
    several = tags.get(277, (1,))[:1] > (1,)
    return tags if several and max(tags.get(258) or (1,)) > 8 and tags.get(256) and tags.get(257) else None


def _read_tiff(data: bytes) -> Deep:
    """Decode a deep multi-channel TIFF as a grey one, C times as wide: the same bytes under another directory.

    Only the horizontal predictor knows of channels; it is left out of the directory and undone here.
    """
    from PIL import Image

    tags = _deep_tiff_tags(data)
    assert tags is not None  # deep_size said so
    bits, kind, predictor = tags[258][0], (tags.get(339) or (1,))[0], (tags.get(317) or (1,))[0]
    channels, photometric = tags[277][0], (tags.get(262) or (2,))[0]
    layout = (len(set(tags[258])), (tags.get(284) or (1,))[0], predictor)
    known = (bits, kind) in ((16, 1), (32, 3)) and (photometric, channels) in ((1, 2), (2, 3), (2, 4))
    if not known or layout not in ((1, 1, 1), (1, 1, 2)):
        raise ValueError(
            f"this kind of TIFF is not supported ({channels} samples of {bits} bits, format {kind}, colour "
            f"{photometric}, planes {layout[1]}, predictor {predictor})"
        )
    with Image.open(io.BytesIO(_as_grey(data, tags))) as image:
        wide = np.asarray(image)
    samples = wide.astype(wide.dtype.newbyteorder("=")).reshape(tags[257][0], tags[256][0], channels)
    if predictor == 2:
        if kind == 3:
            raise ValueError("horizontal differences of floating-point samples are not supported")
        tile = (tags.get(322) or tags[256])[0]
        for x in range(0, samples.shape[1], tile):
            part = samples[:, x : x + tile]
            np.cumsum(part, axis=1, dtype=samples.dtype, out=part)
    return Deep(samples, 65535.0 if kind == 1 else 1.0, (tags.get(274) or (1,))[0])


def _as_grey(data: bytes, tags: Tags) -> bytes:
    order, channels = _order(data), tags[277][0]
    changed = {
        256: tags[256][0] * channels,
        258: tags[258][0],
        262: 1,
        277: 1,
        339: (tags.get(339) or (1,))[0],
    }
    if tags.get(322):
        changed[322] = tags[322][0] * channels
    gone = {317, 338, 274}  # predictor, extra samples, orientation (applied by the caller)
    kept = {struct.unpack_from(order + "H", e)[0]: e for e in _entries(data)}
    kept = {tag: entry for tag, entry in kept.items() if tag not in gone}
    kept |= {tag: struct.pack(order + "HHII", tag, 4, 1, value) for tag, value in changed.items()}
    directory = struct.pack(order + "H", len(kept)) + b"".join(kept[tag] for tag in sorted(kept)) + bytes(4)
    padding = bytes(len(data) % 2)
    start = struct.pack(order + "I", len(data) + len(padding))
    return b"".join((data[:4], start, data[8:], padding, directory))
