"""The result of all readers, and the checks that they share."""

from __future__ import annotations

import codecs
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cadcam.arrays import LARGEST, Array
from cadcam.cad.mesh import Mesh, unique_names
from cadcam.errors import UnreadableFile

Place = Callable[[int], str]


@dataclass(frozen=True, slots=True)
class Model:
    """A mesh in the length unit of its file.

    `unit` is that unit, or None where the format has none; `declared`: whether the file itself names the unit (3MF,
    STEP) and not only the specification of its format (glTF); `notes` list what was left out;
    `unit_mm` is the unit's length where the file states that, too: it may be none of `cadcam.cad.units`.
    """

    mesh: Mesh
    unit: str | None = None
    declared: bool = False
    notes: tuple[str, ...] = ()
    unit_mm: float | None = None


def assembled(
    path: Path,
    vertices: npt.NDArray[np.floating],
    faces: npt.NDArray[np.integer],
    *,
    part: npt.NDArray[np.integer] | None = None,
    names: Sequence[str] = (),
    surface: npt.NDArray[np.integer] | None = None,
    corner_normals: npt.NDArray[np.floating] | None = None,
    face_colors: npt.NDArray[np.floating] | None = None,
    vertex_place: Place = "vertex {}".format,
) -> Mesh:
    """Return the mesh of a file, or raise `UnreadableFile` with the place of the first thing wrong with it.

    Parts without faces are left out; without `names` there is one part, named like the file. A part whose faces all
    have one colour of their own gets that colour.
    """
    if not len(faces):
        what = f"{len(vertices)} vertices but no faces" if len(vertices) else "no geometry"
        raise UnreadableFile(path, f"holds {what}", "export the model as a triangle mesh, not as points or wires")
    check_finite(path, vertices, vertex_place)
    check_indices(path, faces, len(vertices), "face {}".format)
    names = tuple(names) or (path.stem,)
    part = np.zeros(len(faces), np.int32) if part is None else part
    present = np.flatnonzero(np.bincount(part, minlength=len(names)))
    number = np.full(len(names), -1, np.int32)
    number[present] = np.arange(len(present))
    part_colors = np.full((len(names), 3), np.nan, np.float32)
    if face_colors is not None:
        part_colors, face_colors = _shared(np.asarray(face_colors, np.float32), part, len(names))
    return Mesh(
        vertices=np.asarray(vertices, np.float64),
        faces=np.asarray(faces),
        part=number[part],
        surface=np.full(len(faces), -1, np.int32) if surface is None else np.asarray(surface),
        part_names=unique_names([names[i] or path.stem for i in present]),
        part_colors=part_colors[present],
        corner_normals=None if corner_normals is None else np.asarray(corner_normals, np.float32),
        face_colors=face_colors,
    )


def _shared(
    of_faces: npt.NDArray[np.float32], part: npt.NDArray[np.integer], n_parts: int
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32] | None]:
    """Return the colour (P, 3) shared by all faces of a part, and those (F, 3) of the other faces, None without any.

    NaN where there is no such colour.
    """
    low = np.full((n_parts, 3), np.inf, np.float32)
    high = -low
    known = np.nan_to_num(of_faces, nan=-1)  # below every colour
    np.minimum.at(low, part, known)
    np.maximum.at(high, part, known)
    even = ((low == high) & (low >= 0)).all(axis=1, keepdims=True)
    left = np.where(even[part], np.float32(np.nan), of_faces)
    return np.where(even, low, np.float32(np.nan)), None if np.isnan(left).all() else left


def numbers(rows: Sequence[Sequence[bytes]], n: int, complaint: Callable[[int], UnreadableFile]) -> Array:
    """Return the first n words of each row as numbers (N, n); raise `complaint(k)` for the first row k without them."""
    try:
        table = np.array([row[:n] for row in rows], float)
        if table.shape == (len(rows), n):
            return table
    except ValueError:
        pass
    found = []
    for k, row in enumerate(rows):
        try:
            found.append([float(row[i]) for i in range(n)])
        except (ValueError, IndexError):
            raise complaint(k) from None
    return np.array(found, float).reshape(-1, n)


def remedy(text: str, otherwise: str) -> str:
    """Return what is to be done about text that is not the numbers expected: often it has decimal commas."""
    return "write decimal points, not commas" if "," in text else otherwise


def check_finite(path: Path, vertices: npt.NDArray[np.floating], place: Place) -> None:
    """Raise `UnreadableFile` naming the first vertex with a coordinate that is no finite number, or beyond all use."""
    bad = ~(np.abs(vertices) <= LARGEST).all(axis=1)
    if bad.any():
        at = int(np.argmax(bad))
        values = ", ".join(f"{x:g}" for x in vertices[at])
        raise UnreadableFile(
            path, f"{place(at)} is ({values})", f"coordinates must be finite numbers, at most {LARGEST:g} in size"
        )


def check_indices(path: Path, faces: npt.NDArray[np.integer], n_vertices: int, place: Place) -> None:
    """Raise `UnreadableFile` naming the first face that refers to a missing vertex (rows or a flat list)."""
    bad = (faces < 0) | (faces >= n_vertices)
    if bad.any():
        at = tuple(int(i) for i in np.argwhere(bad)[0])
        raise UnreadableFile(
            path,
            f"{place(at[0])} refers to vertex {int(faces[at])}, counted from 0, but the file has {n_vertices} vertices",
            "export it again",
        )


def without_mark(path: Path, data: bytes) -> bytes:
    """Return text without the byte order mark that some programs put before UTF-8; refuse UTF-16, which has it always.

    With it the first word of a file is another: an OBJ file lost its first vertex.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise UnreadableFile(path, "is text in UTF-16", "save it as UTF-8 or ASCII")
    return data.removeprefix(codecs.BOM_UTF8)


def refuse_binary(path: Path, data: bytes, form: str) -> None:
    """Raise `UnreadableFile` if text holds a zero byte, as binary files soon do."""
    at = data.find(b"\0")
    if at >= 0:
        raise UnreadableFile(
            path, f"has a zero byte at byte {at}: not {form} text", "check the suffix, or export it again"
        )
