"""PLY: polygons, ASCII or binary of either byte order, no unit, one part."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Longs
from cadcam.cad.formats.model import Model, assembled, check_indices, numbers, without_mark
from cadcam.cad.formats.polygons import triangulated
from cadcam.errors import UnreadableFile

_AGAIN = "export it again"
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


_INDICES = ("vertex_indices", "vertex_index")  # the lists that are read: texture coordinates may be anything, even NaN
_END = re.compile(rb"[\r\n]end_header[ \t]*(?:\r\n|\r|\n)")  # a line of its own: a comment may say it, too


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    type: str
    count: str = ""  # type of the length in front of a list

    @property
    def size(self) -> int:
        """The number of bytes of one value."""
        return _bytes(self.type)


def _bytes(kind: str) -> int:
    """Return the size of a number of some type, 0 for none."""
    return int(kind[1:] or 0)


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    size: int
    properties: tuple[_Property, ...]

    @property
    def least(self) -> int:
        """The least number of bytes (binary) that one entry takes."""
        return sum(_bytes(p.count or p.type) for p in self.properties)


def read_ply(path: Path, data: bytes) -> Model:
    """Return the polygons of a PLY file, with the colours of its faces or the mean of their vertices'; no textures."""
    data = without_mark(path, data)
    order, elements, body = _header(path, data)
    reader = _Ascii(path, data, body) if order == "ascii" else _Binary(path, data, body, order)
    vertices = np.zeros((0, 3))
    counts, corners = np.zeros(0, np.int64), np.zeros(0, np.int64)
    of_vertices = of_faces = None
    for element in elements:
        columns, lists = reader.read(element)
        if element.name == "vertex":
            vertices, of_vertices = _places(path, columns), _colors(element, columns)
        elif element.name == "face":
            (counts, corners), of_faces = _corners(path, lists), _colors(element, columns)
        elif element.name == "tristrips":
            raise UnreadableFile(path, "holds triangle strips", "export single triangles")
    owner = np.repeat(np.arange(len(counts)), counts)
    check_indices(path, corners, len(vertices), lambda at: f"face {owner[at]}")
    faces, polygon = triangulated(vertices, counts, corners)
    colors = None
    if of_faces is not None:
        colors = of_faces[polygon]
    elif of_vertices is not None:
        colors = of_vertices[faces].mean(axis=1)
    return Model(assembled(path, vertices, faces, face_colors=colors))


def _places(path: Path, columns: Columns) -> npt.NDArray[np.float64]:
    """Return the vertices (V, 3)."""
    for axis in "xyz":
        if axis not in columns:
            raise UnreadableFile(path, f"its vertices have no property {axis!r}", _AGAIN)
    return np.column_stack([columns[axis] for axis in "xyz"])


def _corners(path: Path, lists: Lists) -> tuple[Longs, Longs]:
    """Return how many corners each polygon has, and their vertices."""
    for name in _INDICES:
        if name in lists:
            return lists[name]
    raise UnreadableFile(path, "its faces have no list 'vertex_indices'", _AGAIN)


def _colors(element: _Element, columns: Columns) -> npt.NDArray[np.float64] | None:
    """Return the RGB in [0, 1] of an element's entries, None where it has none."""
    names = ("red", "green", "blue")
    if any(name not in columns for name in names):
        return None
    type_of = {p.name: p.type for p in element.properties}
    whole = {name: np.iinfo(type_of[name]).max if type_of[name][0] in "iu" else 1.0 for name in names}
    rows = np.column_stack([np.asarray(columns[name], float) / whole[name] for name in names])
    return np.where(np.isfinite(rows), np.clip(rows, 0, 1), np.nan)


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], int]:
    """Return the byte order ("ascii", "<", ">"), the elements, and where the body begins."""
    end = _END.search(data)
    if data[:3] != b"ply" or end is None:
        raise UnreadableFile(path, "has no complete PLY header", _AGAIN)
    order, elements = "", []
    for number, line in enumerate(data[: end.start()].decode("latin-1").splitlines(), 1):
        words = line.split()
        try:
            match words:
                case ["format", kind, *_]:
                    order = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]
                case ["element", name, size]:
                    elements.append(_Element(name, int(size), ()))
                case ["property", "list", count, kind, name]:
                    elements[-1] = _with(elements[-1], _Property(name, _TYPES[kind], _TYPES[count]))
                case ["property", kind, name]:
                    elements[-1] = _with(elements[-1], _Property(name, _TYPES[kind]))
        except (KeyError, ValueError, IndexError):
            raise UnreadableFile(path, f"line {number}: cannot make sense of {line!r}", _AGAIN) from None
    if not order:
        raise UnreadableFile(path, "its header names no format", _AGAIN)
    return order, elements, end.end()


def _with(element: _Element, added: _Property) -> _Element:
    if any(p.name == added.name for p in element.properties):
        raise ValueError("a property given twice")
    return _Element(element.name, element.size, (*element.properties, added))


Columns = dict[str, npt.NDArray[np.float64]]
Lists = dict[str, tuple[Longs, Longs]]


class _Binary:
    def __init__(self, path: Path, data: bytes, at: int, order: str) -> None:
        self.path, self.data, self.at, self.order = path, data, at, order

    def read(self, element: _Element) -> tuple[Columns, Lists]:
        """Return the scalar columns and the lists (lengths, values) of the next element."""
        self._room(element, element.size * element.least)
        lists = [p for p in element.properties if p.count]
        if not lists:
            return self._table(element, {}), {}
        fast = self._even(element, lists)
        return fast if fast is not None else self._one_by_one(element)

    def _room(self, element: _Element, need: int) -> None:
        if element.size < 0 or self.at + need > len(self.data):
            raise UnreadableFile(
                self.path,
                f"claims {element.size} entries of {element.name!r}, which take at least {need} bytes from byte "
                f"{self.at} on, but is {len(self.data)} bytes long: truncated",
                _AGAIN,
            )

    def _table(self, element: _Element, lengths: dict[str, int]) -> Columns:
        """Return the columns of entries whose lists all have the given lengths."""
        fields: list[tuple[str, str, tuple[int, ...]]] = []
        for p in element.properties:
            if p.count:
                fields.append((f"count of {p.name}", self.order + p.count, ()))
            fields.append((p.name, self.order + p.type, (lengths[p.name],) if p.count else ()))
        kind = np.dtype(fields)
        need = kind.itemsize * element.size
        self._room(element, need)
        table = np.frombuffer(self.data, kind, element.size, self.at)
        self.at += need
        return {name: table[name] for name, _, _ in fields}

    def _even(self, element: _Element, lists: list[_Property]) -> tuple[Columns, Lists] | None:
        """Return the element if all its entries have lists as long as the first (all triangles), else None."""
        begin = self.at
        lengths = self._first_lengths(element)
        least = sum(p.size * lengths.get(p.name, 1) + _bytes(p.count) for p in element.properties)
        if begin + least * element.size > len(self.data):
            return None
        columns = self._table(element, lengths)
        if any((columns[f"count of {p.name}"] != lengths[p.name]).any() for p in lists):
            self.at = begin
            return None
        found: Lists = {
            p.name: (np.full(element.size, lengths[p.name], np.int64), columns[p.name].ravel().astype(np.int64))
            for p in lists
            if p.name in _INDICES
        }
        return {p.name: columns[p.name] for p in element.properties if not p.count}, found

    def _first_lengths(self, element: _Element) -> dict[str, int]:
        at, lengths = self.at, {}
        for p in element.properties:
            if p.count and element.size:
                length, at = self._number(p.count, at)
                lengths[p.name] = max(length, 0)
                at += p.size * lengths[p.name]
            else:
                at += p.size
                lengths[p.name] = 0 if p.count else 1
        return lengths

    def _number(self, kind: str, at: int) -> tuple[int, int]:
        size = _bytes(kind)
        if at + size > len(self.data):
            raise UnreadableFile(self.path, f"ends at byte {len(self.data)} amid its faces: truncated", _AGAIN)
        raw = self.data[at : at + size]
        value = int.from_bytes(raw, "little" if self.order == "<" else "big", signed=kind[0] == "i")
        return value, at + size

    def _one_by_one(self, element: _Element) -> tuple[Columns, Lists]:
        """Return the columns and lists of an element whose entries differ in length."""
        scalars: dict[str, list[bytes]] = {p.name: [] for p in element.properties if not p.count}
        counts: dict[str, list[int]] = {p.name: [] for p in element.properties if p.count}
        values: dict[str, list[bytes]] = {name: [] for name in counts}
        for _ in range(element.size):
            for p in element.properties:
                n = 1
                if p.count:
                    n, self.at = self._number(p.count, self.at)
                    counts[p.name].append(n)
                    values[p.name].append(self.data[self.at : self.at + n * p.size])
                else:
                    scalars[p.name].append(self.data[self.at : self.at + p.size])
                self.at += n * p.size
                if n < 0 or self.at > len(self.data):
                    raise UnreadableFile(self.path, f"ends at byte {len(self.data)} amid its faces: truncated", _AGAIN)
        lists: Lists = {}
        for p in element.properties:
            if p.count and p.name in _INDICES:
                flat = np.frombuffer(b"".join(values[p.name]), self.order + p.type).astype(np.int64)
                lists[p.name] = (np.array(counts[p.name], np.int64), flat)
        types = {p.name: self.order + p.type for p in element.properties}
        return {name: np.frombuffer(b"".join(raw), types[name]) for name, raw in scalars.items()}, lists


class _Ascii:
    def __init__(self, path: Path, data: bytes, at: int) -> None:
        self.path = path
        self.line = data[:at].count(b"\n") + 1
        self.lines = [line.split() for line in data[at:].splitlines()]
        self.at = 0

    def read(self, element: _Element) -> tuple[Columns, Lists]:
        """Return the scalar columns and the lists (lengths, values) of the next element, one line per entry."""
        rows: list[list[bytes]] = []
        first = self.at
        while len(rows) < element.size and self.at < len(self.lines):
            if self.lines[self.at]:
                rows.append(self.lines[self.at])
            self.at += 1
        if len(rows) < element.size:
            raise UnreadableFile(
                self.path, f"claims {element.size} entries of {element.name!r} but has {len(rows)}: truncated", _AGAIN
            )
        if any(p.count for p in element.properties):
            return self._lists(element, rows, first)
        n = len(element.properties)
        if not n:
            return {}, {}
        table = numbers(rows, n, lambda k: self._complaint(first + k, rows[k], f"{n} numbers"))
        return {p.name: table[:, k] for k, p in enumerate(element.properties)}, {}

    def _complaint(self, row: int, words: list[bytes], wanted: str) -> UnreadableFile:
        """Return the error for a row of the body that is not as expected."""
        shown = b" ".join(words).decode("utf-8", "replace")
        return UnreadableFile(self.path, f"line {self.line + row}: {shown!r} is not {wanted}", "check the line")

    def _lists(self, element: _Element, rows: list[list[bytes]], first: int) -> tuple[Columns, Lists]:
        scalars: dict[str, list[float]] = {p.name: [] for p in element.properties if not p.count}
        counts: dict[str, list[int]] = {p.name: [] for p in element.properties if p.name in _INDICES and p.count}
        values: dict[str, list[int]] = {name: [] for name in counts}
        for k, row in enumerate(rows):
            at = 0
            try:
                for p in element.properties:
                    n = int(row[at]) if p.count else 1
                    if not p.count:
                        scalars[p.name].append(float(row[at]))
                    at += 1
                    if p.count:
                        words = row[at : at + n]
                        if len(words) != n:
                            raise ValueError
                        at += n
                        if p.name in _INDICES:
                            counts[p.name].append(n)
                            values[p.name].extend(_whole(word) for word in words)
            except (ValueError, IndexError, OverflowError):
                raise self._complaint(first + k, row, "a list of vertex numbers") from None
        lists = {name: (np.array(counts[name], np.int64), np.array(values[name], np.int64)) for name in counts}
        return {name: np.array(column) for name, column in scalars.items()}, lists


def _whole(word: bytes) -> int:
    """Return a vertex number, which some writers give a decimal point."""
    value = int(float(word))
    if abs(value) > 10**18:
        raise OverflowError
    return value
