"""OFF: polygons, no unit, one part."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadcam.cad.formats.model import Model, assembled, check_indices, refuse_binary
from cadcam.cad.formats.polygons import triangulated
from cadcam.errors import UnreadableFile

_REMEDY = "check the line, or export the model again"


def read_off(path: Path, data: bytes) -> Model:
    """Return the polygons of an ASCII OFF file; colours, normals and texture coordinates are passed over."""
    refuse_binary(path, data, "OFF")
    lines = [
        (number, text.split())
        for number, line in enumerate(data.splitlines(), 1)
        if (text := line.split(b"#", 1)[0].strip())
    ]
    if not lines or not lines[0][1][0].endswith(b"OFF") or b"BINARY" in lines[0][1]:
        raise UnreadableFile(path, "does not begin with OFF", "only ASCII OFF files are read; export as PLY or STL")
    if len(lines[0][1]) == 1:
        lines = lines[1:]
    else:
        lines[0] = (lines[0][0], lines[0][1][1:])
    n_vertices, n_faces = (_whole(path, lines, 0, k) for k in (0, 1))
    if n_vertices < 0 or n_faces < 0 or len(lines) - 1 < n_vertices + n_faces:
        raise UnreadableFile(
            path,
            f"claims {n_vertices} vertices and {n_faces} faces but {max(len(lines) - 1, 0)} lines follow: truncated",
            "export the model again",
        )
    rows = lines[1 : 1 + n_vertices]
    try:
        vertices = np.array([words[:3] for _, words in rows], dtype=float).reshape(-1, 3)
    except ValueError:
        vertices = np.array([_three(path, number, words) for number, words in rows]).reshape(-1, 3)
    first = 1 + n_vertices
    counts = np.array([_whole(path, lines, first + i, 0) for i in range(n_faces)], np.int64)
    corners = [_whole(path, lines, first + i, 1 + k) for i in range(n_faces) for k in range(counts[i])]
    number = np.repeat([lines[first + i][0] for i in range(n_faces)], counts)
    flat = np.array(corners, np.int64)
    check_indices(path, flat, n_vertices, lambda at: f"line {number[at]}: the face")
    faces, _ = triangulated(vertices, counts, flat)
    return Model(assembled(path, vertices, faces, vertex_place=lambda at: f"line {rows[at][0]}: vertex {at}"))


def _three(path: Path, number: int, words: list[bytes]) -> list[float]:
    try:
        if len(words) >= 3:
            return [float(word) for word in words[:3]]
    except ValueError:
        pass
    shown = b" ".join(words).decode("utf-8", "replace")
    raise UnreadableFile(path, f"line {number}: vertex {shown!r} is not three numbers", _REMEDY)


def _whole(path: Path, lines: list[tuple[int, list[bytes]]], row: int, column: int) -> int:
    number, words = lines[row] if row < len(lines) else (0, [])
    try:
        return int(words[column])
    except (ValueError, IndexError):
        shown = b" ".join(words).decode("utf-8", "replace")
        raise UnreadableFile(
            path, f"line {number}: {shown!r} lacks a whole number in place {column}", _REMEDY
        ) from None
