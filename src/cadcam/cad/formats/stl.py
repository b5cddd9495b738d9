"""STL: triangles only, no unit; the names of ASCII solids become parts."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cadcam.cad.formats.model import Model, assembled
from cadcam.errors import UnreadableFile

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84
_AGAIN = "export it again as binary STL"


def read_stl(path: Path, data: bytes) -> Model:
    """Return the triangles of an ASCII or binary STL; the two are told apart by the length, not the first word."""
    if len(data) >= _HEADER and len(data) == _HEADER + _RECORD.itemsize * _claimed(data):
        return _binary(path, data)
    if re.match(rb"\s*solid\b", data[:512].lower()) and re.search(rb"facet|endsolid", data[:4096].lower()):
        return _ascii(path, data)
    if len(data) < _HEADER:
        raise UnreadableFile(path, f"is only {len(data)} bytes long, too short for an STL file", _AGAIN)
    claimed = _claimed(data)
    room = (len(data) - _HEADER) / _RECORD.itemsize
    raise UnreadableFile(
        path,
        f"its header (byte 80) claims {claimed} triangles but the {len(data)} bytes of the file hold {room:.1f}: "
        + ("truncated, or not an STL file" if claimed > room else "damaged, or not an STL file"),
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
    """Return the solids of an ASCII STL, read by its words: line breaks and case do not matter."""
    text = data.lower()
    names, begins = [], []
    for match in re.finditer(rb"^[ \t]*solid\b[ \t]*([^\r\n]*)", data, re.MULTILINE | re.IGNORECASE):
        names.append(match[1].decode("utf-8", "replace").strip())
        begins.append(match.start())
    ends = len(re.findall(rb"^\s*endsolid\b", text, re.MULTILINE))
    if ends < len(names):
        raise UnreadableFile(path, f"ends at byte {len(data)} before 'endsolid': truncated", _AGAIN)
    vertices: list[npt.NDArray[np.float64]] = []
    counts: list[int] = []
    for begin, end in zip(begins, [*begins[1:], len(text)], strict=True):
        words = text[begin:end].split(b"vertex")[1:]
        numbers = _numbers(path, data, words, begin)
        if len(numbers) % 3:
            raise UnreadableFile(path, f"solid {len(counts)} has {len(numbers)} corners, not a multiple of 3", _AGAIN)
        vertices.append(numbers)
        counts.append(len(numbers) // 3)
    corners = np.concatenate(vertices)
    part = np.repeat(np.arange(len(counts)), counts)
    mesh = assembled(path, corners, np.arange(len(corners)).reshape(-1, 3), part=part, names=names)
    return Model(mesh)


def _numbers(path: Path, data: bytes, words: list[bytes], begin: int) -> npt.NDArray[np.float64]:
    """Return the three numbers (N, 3) that follow each word 'vertex'."""
    triples = [word.split(None, 3)[:3] for word in words]
    try:
        array = np.array(triples, dtype=float).reshape(-1, 3)
        if np.isfinite(array).all():
            return array
    except ValueError:
        pass
    at, text = begin, data.lower()
    for triple in triples:
        at = text.index(b"vertex", at) + 6
        if not _three_finite(triple):
            line = data.count(b"\n", 0, at) + 1
            found = b" ".join(data[at:].split(b"\n", 1)[0].split()).decode("utf-8", "replace")
            raise UnreadableFile(path, f"line {line}: vertex {found!r} is not three finite numbers", _AGAIN)
    raise UnreadableFile(path, "holds corners that are not three numbers", _AGAIN)


def _three_finite(words: list[bytes]) -> bool:
    try:
        return len(words) == 3 and all(np.isfinite(float(word)) for word in words)
    except ValueError:
        return False
