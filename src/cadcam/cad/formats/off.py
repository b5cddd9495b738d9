"""OFF: polygons, no unit, one part."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadcam.cad.formats.model import Model, assembled, check_indices, numbers, refuse_binary, remedy, without_mark
from cadcam.cad.formats.polygons import triangulated
from cadcam.errors import UnreadableFile

_REMEDY = "check the line, or export the model again"
_LARGEST = 10**18  # whole numbers up to this fit 64 bits

Line = tuple[int, list[bytes]]  # its number in the file, its words


def read_off(path: Path, data: bytes) -> Model:
    """Return the polygons of an ASCII OFF file; colours, normals and texture coordinates are ignored."""
    data = without_mark(path, data)
    refuse_binary(path, data, "OFF")
    lines = _lines(path, data)
    n_vertices, n_faces = (_whole(path, lines[0] if lines else (0, []), k) for k in (0, 1))
    if n_vertices < 0 or n_faces < 0 or len(lines) - 1 < n_vertices + n_faces:
        raise UnreadableFile(
            path,
            f"claims {n_vertices} vertices and {n_faces} faces but {len(lines) - 1} lines follow: truncated",
            "export the model again",
        )
    rows, faces = lines[1 : 1 + n_vertices], lines[1 + n_vertices : 1 + n_vertices + n_faces]
    vertices = numbers([words for _, words in rows], 3, lambda k: _bad_vertex(path, rows[k]))
    polygons = [_polygon(path, line) for line in faces]
    counts = np.array([len(polygon) for polygon in polygons], np.int64)
    corners = np.array([corner for polygon in polygons for corner in polygon], np.int64)
    face = np.repeat(np.arange(n_faces), counts)
    check_indices(path, corners, n_vertices, lambda at: f"line {faces[face[at]][0]}: the face")
    triangles, _ = triangulated(vertices, counts, corners)
    return Model(assembled(path, vertices, triangles, vertex_place=lambda at: f"line {rows[at][0]}: vertex {at}"))


def _lines(path: Path, data: bytes) -> list[Line]:
    """Return the lines that are not empty, from the counts of vertices and faces on."""
    lines = [
        (number, text.split())
        for number, line in enumerate(data.splitlines(), 1)
        if (text := line.split(b"#", 1)[0].strip())
    ]
    if not lines or not lines[0][1][0].endswith(b"OFF") or b"BINARY" in lines[0][1]:
        raise UnreadableFile(path, "does not begin with OFF", "only ASCII OFF files are read; export as PLY or STL")
    number, words = lines[0]
    return lines[1:] if len(words) == 1 else [(number, words[1:]), *lines[1:]]


def _polygon(path: Path, line: Line) -> list[int]:
    """Return the vertices of a face: as many as its first number states."""
    count = _whole(path, line, 0)
    if count < 0:
        raise UnreadableFile(path, f"line {line[0]}: a face with {count} corners", _REMEDY)
    return [_whole(path, line, 1 + k) for k in range(count)]


def _bad_vertex(path: Path, line: Line) -> UnreadableFile:
    return UnreadableFile(
        path, f"line {line[0]}: vertex {_shown(line)!r} is not three numbers", remedy(_shown(line), _REMEDY)
    )


def _whole(path: Path, line: Line, column: int) -> int:
    try:
        value = int(line[1][column])
        if abs(value) <= _LARGEST:
            return value
    except (ValueError, IndexError):
        pass
    what = f"line {line[0]}: {_shown(line)!r} lacks a whole number in place {column}"
    raise UnreadableFile(path, what, _REMEDY)


def _shown(line: Line) -> str:
    return b" ".join(line[1]).decode("utf-8", "replace")
