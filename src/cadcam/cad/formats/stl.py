"""STL: triangles only, no unit; the names of ASCII solids become parts."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.formats.model import Model, assembled, numbers, remedy, without_mark
from cadcam.errors import UnreadableFile

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84
_AGAIN = "export it again as binary STL"


def read_stl(path: Path, data: bytes) -> Model:
    """Return the triangles of an ASCII or binary STL, recognised by the file's length, not by its first word."""
    if len(data) >= _HEADER and len(data) == _HEADER + _RECORD.itemsize * _claimed(data):
        return _binary(path, data)
    data = without_mark(path, data)
    if re.match(rb"\s*solid\b", data[:512].lower()) and re.search(rb"facet|endsolid", data[:4096].lower()):
        return _ascii(path, data)
    if len(data) < _HEADER:
        raise UnreadableFile(path, f"is only {len(data)} bytes long, too short for an STL file", _AGAIN)
    claimed = _claimed(data)
    room, over = divmod(len(data) - _HEADER, _RECORD.itemsize)
    raise UnreadableFile(
        path,
        f"its header (byte 80) claims {claimed} triangles but the {len(data)} bytes of the file hold {room} "
        f"and {over} bytes more: {'truncated' if claimed > room else 'damaged'}, or not an STL file",
        _AGAIN,
    )


def _claimed(data: bytes) -> int:
    return int.from_bytes(data[80:84], "little")


def _binary(path: Path, data: bytes) -> Model:
    corners = np.frombuffer(data, _RECORD, offset=_HEADER)["corners"].reshape(-1, 3)

    def place(vertex: int) -> str:
        triangle, corner = divmod(vertex, 3)
        return f"triangle {triangle}, corner {corner} (byte {_HEADER + 50 * triangle + 12 * corner + 12})"

    return Model(assembled(path, corners, np.arange(len(corners)).reshape(-1, 3), vertex_place=place))


def _ascii(path: Path, data: bytes) -> Model:
    """Return the solids of an ASCII STL, read by its words: line breaks within a solid and case do not matter."""
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    marks = list(re.finditer(rb"^\s*(end)?solid\b[ \t]*([^\n]*)", data, re.MULTILINE | re.IGNORECASE))
    names, parts = [], []
    for mark, after in zip(marks, [*marks[1:], None], strict=True):
        if mark[1] is None:
            names.append(mark[2].decode("utf-8", "replace").strip())
            parts.append(_corners(path, data, mark.end(), len(data) if after is None else after.start()))
    if len(marks) < 2 * len(names):
        raise UnreadableFile(path, f"ends at byte {len(data)} before 'endsolid': truncated", _AGAIN)
    for number, part in enumerate(parts):
        if len(part) % 3:
            raise UnreadableFile(path, f"solid {number} has {len(part)} corners, not a multiple of 3", _AGAIN)
    corners = np.concatenate(parts)
    part_of = np.repeat(np.arange(len(parts)), [len(part) // 3 for part in parts])
    faces = np.arange(len(corners)).reshape(-1, 3)
    return Model(assembled(path, corners, faces, part=part_of, names=names))


def _corners(path: Path, data: bytes, begin: int, end: int) -> Array:
    """Return the three finite numbers (N, 3) that follow each word 'vertex' between two bytes."""
    words = data[begin:end].lower().split(b"vertex")

    def complaint(k: int) -> UnreadableFile:
        at = begin + len(b"vertex".join(words[: k + 1])) + len(b"vertex")
        line = data.count(b"\n", 0, at) + 1
        found = b" ".join(data[at:].split(b"\n", 1)[0].split()).decode("utf-8", "replace")
        what = f"line {line}: vertex {found!r} is not three finite numbers"
        return UnreadableFile(path, what, remedy(found, _AGAIN))

    corners = numbers([word.split(None, 3) for word in words[1:]], 3, complaint)
    bad = ~np.isfinite(corners).all(axis=1)
    if bad.any():
        raise complaint(int(np.argmax(bad)))
    return corners
