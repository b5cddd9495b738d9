"""Wavefront OBJ: polygons, no unit; objects and groups, or without those materials, become parts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Longs
from cadcam.cad.formats.model import Model, assembled, check_indices, numbers, refuse_binary, remedy, without_mark
from cadcam.cad.formats.polygons import triangulated
from cadcam.errors import UnreadableFile

_REMEDY = "check the line, or export the model again"


@dataclass(slots=True)
class _ObjLines:
    """The relevant lines: vertices and faces with their line numbers, and the group of each face."""

    vertices: list[bytes] = field(default_factory=list)
    vertex_line: list[int] = field(default_factory=list)
    faces: list[bytes] = field(default_factory=list)
    face_line: list[int] = field(default_factory=list)
    vertices_before: list[int] = field(default_factory=list)
    owner: list[int] = field(default_factory=list)
    labels: dict[tuple[str, str, str], int] = field(default_factory=dict)
    libraries: list[str] = field(default_factory=list)


def read_obj(path: Path, data: bytes) -> Model:
    """Return the faces of an OBJ file; normals, texture coordinates, lines and free-form curves are ignored.

    A part is named after its object or group ("object/group" where both differ), or its material in a file that has
    neither. The colour of a face is the diffuse colour of its material, if the material library is beside the file,
    else the mean of its vertices' colours (three numbers after their positions).
    """
    data = without_mark(path, data)
    refuse_binary(path, data, "OBJ")
    lines = _sorted_out(data)
    vertices = _vertices(path, lines)
    counts, corners = _corners(path, lines)
    before = np.repeat(np.array(lines.vertices_before, np.int64), counts)
    _no_zero(path, lines, counts, corners)
    corners = np.where(corners < 0, corners + before, corners - 1)
    line_of_corner = np.repeat(np.array(lines.face_line), counts)
    check_indices(path, corners, len(vertices), lambda at: f"line {line_of_corner[at]}: the face")
    faces, polygon = triangulated(vertices, counts, corners)
    part, names = _parts(lines)
    colors = _colors(path, lines)[polygon]
    if painted := _vertex_colors(lines):
        mean = np.array(painted).reshape(-1, 3)[faces].mean(axis=1)
        colors = np.where(np.isnan(colors), mean, colors)
    mesh = assembled(
        path,
        vertices,
        faces,
        part=part[polygon],
        names=names,
        face_colors=colors,
        vertex_place=lambda at: f"line {lines.vertex_line[at]}: vertex {at + 1}",
    )
    return Model(mesh)


def _sorted_out(data: bytes) -> _ObjLines:
    found = _ObjLines()
    label = ["", "", ""]
    owner = -1
    for number, line in _whole_lines(data):
        key = line[:2]
        if key in (b"v ", b"v\t"):
            found.vertices.append(line[2:].partition(b"#")[0])  # of names a # is part
            found.vertex_line.append(number)
        elif key in (b"f ", b"f\t"):
            if owner < 0:
                owner = found.labels.setdefault((label[0], label[1], label[2]), len(found.labels))
            found.faces.append(line[2:].partition(b"#")[0])
            found.face_line.append(number)
            found.vertices_before.append(len(found.vertices))
            found.owner.append(owner)
        elif key in (b"vn", b"vt", b"#", b"# "):
            continue
        else:
            owner = _relabelled(line.strip(), label, found, owner)
    return found


def _whole_lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    r"""Yield each line and its number, joined with the next where it ends in a backslash, unless it is a comment.

    The path of a folder in a comment, `# C:\parts\`, would take the first vertex with it.
    """
    begun, first = b"", 0
    for number, raw in enumerate(data.splitlines(), 1):
        line = (begun + raw).lstrip()
        if line.endswith(b"\\") and not line.startswith(b"#"):
            begun, first = line[:-1] + b" ", first or number
            continue
        yield first or number, line
        begun, first = b"", 0
    if begun:
        yield first, begun


def _relabelled(line: bytes, label: list[str], found: _ObjLines, owner: int) -> int:
    """Process a line that names something; return -1 where the faces that follow belong elsewhere."""
    word, *rest = line.split(None, 1) or [b""]
    value = b"".join(rest).decode("utf-8", "replace")
    if word == b"mtllib":
        found.libraries.append(value)
    for k, name in enumerate((b"o", b"g", b"usemtl")):
        if word == name:
            label[k] = value
            return -1
    return owner


def _vertices(path: Path, lines: _ObjLines) -> npt.NDArray[np.float64]:
    """Return positions (V, 3); further numbers on a line (weight, colour) are ignored."""

    def complaint(k: int) -> UnreadableFile:
        text = lines.vertices[k].decode("utf-8", "replace").strip()
        return UnreadableFile(
            path, f"line {lines.vertex_line[k]}: vertex {text!r} is not three numbers", remedy(text, _REMEDY)
        )

    return numbers([line.split(None, 3) for line in lines.vertices], 3, complaint)


def _corners(path: Path, lines: _ObjLines) -> tuple[Longs, Longs]:
    """Return corners per face (N,) and the vertex numbers as written, one face after the other."""
    plain = re.sub(rb"/\S*", b"", b"\n".join(lines.faces)).split(b"\n")  # vertex numbers only
    words = [line.split() for line in plain] if lines.faces else []
    counts = np.array([len(line) for line in words], np.int64)
    if len(counts) and counts.min() < 3:
        at = int(np.argmin(counts))
        raise UnreadableFile(path, f"line {lines.face_line[at]}: a face with {counts[at]} corners", _REMEDY)
    try:
        return counts, np.array([word for line in words for word in line], dtype="S").astype(np.int64)
    except (ValueError, OverflowError):
        pass
    for line, number, text in zip(words, lines.face_line, lines.faces, strict=True):
        if not all(re.fullmatch(rb"-?\d{1,18}", word) for word in line):
            shown = text.decode("utf-8", "replace").strip()
            raise UnreadableFile(path, f"line {number}: face {shown!r} is not a list of vertex numbers", _REMEDY)
    raise UnreadableFile(path, "holds faces that are not lists of vertex numbers", _REMEDY)


def _no_zero(path: Path, lines: _ObjLines, counts: Longs, corners: Longs) -> None:
    if (corners == 0).any():
        at = int(np.searchsorted(np.cumsum(counts), np.argmax(corners == 0), side="right"))
        raise UnreadableFile(path, f"line {lines.face_line[at]}: vertex number 0", "OBJ counts vertices from 1")


def _parts(lines: _ObjLines) -> tuple[Longs, list[str]]:
    """Return the part of each face and the names of the parts."""
    named = any(key[0] or key[1] for key in lines.labels)
    names: dict[str, int] = {}
    part_of_label = []
    for obj, group, material in lines.labels:
        name = "/".join(dict.fromkeys(w for w in (obj, group) if w)) if named else material
        part_of_label.append(names.setdefault(name, len(names)))
    owner = np.array(part_of_label or [0], np.int64)[np.array(lines.owner, np.int64)]
    return owner, list(names)


def _colors(path: Path, lines: _ObjLines) -> npt.NDArray[np.float64]:
    """Return the diffuse colour of each face's material (N, 3), NaN where it is not known."""
    known = _diffuse(path, lines.libraries)
    nothing = (np.nan, np.nan, np.nan)
    of_label = [known.get(material, nothing) for _, _, material in lines.labels] or [nothing]
    return np.array(of_label)[np.array(lines.owner, np.int64)]


def _vertex_colors(lines: _ObjLines) -> list[list[float]]:
    """Return the colours in [0, 1] after all positions; nothing unless every vertex has three more numbers."""
    if not lines.vertices or len(lines.vertices[0].split()) != 6:
        return []
    try:
        colors = [[float(word) for word in line.split()[3:]] for line in lines.vertices]
    except ValueError:
        return []
    return colors if all(len(c) == 3 and min(c) >= 0 and max(c) <= 1 for c in colors) else []


def _diffuse(path: Path, libraries: list[str]) -> dict[str, tuple[float, float, float]]:
    """Return the diffuse colour of each material in those libraries that can be read."""
    colors: dict[str, tuple[float, float, float]] = {}
    for library in libraries:
        material = ""
        for line in _library(path.parent, library).splitlines():
            words = line.split()
            if words[:1] == ["newmtl"]:
                material = line.split(None, 1)[1].strip() if len(words) > 1 else ""
            elif words[:1] == ["Kd"] and len(words) >= 4:
                try:
                    r, g, b = (min(max(float(word), 0.0), 1.0) for word in words[1:4])
                except ValueError:
                    continue
                colors[material] = (r, g, b)
    return colors


def _library(folder: Path, names: str) -> str:
    """Return the text of a material library: of the file of this name, blanks and all, or of the several it names."""
    for files in ([names], names.split()):
        texts = []
        for name in files:
            with suppress(OSError):  # a missing colour is no reason to reject a model
                texts.append((folder / name).read_text("utf-8", "replace"))
        if texts:
            return "\n".join(texts)
    return ""
