"""Matrices of numbers in text files, and poses: these must state their direction and unit."""

from __future__ import annotations

import json
import os
import re
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.units import MM, unit_name
from cadcam.errors import CadcamError, UnknownName, UnreadableFile
from cadcam.files.jsontext import Place, parsed
from cadcam.files.text import TextFile, comments_of, number_in, read_text
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_DIRECTIONS = ("camera_from_world", "world_from_camera")
_MOTIONS = ("new_from_old", "old_from_new")
POSES = (*_DIRECTIONS, "camera_from_part", "part_from_camera")  # of a list of poses: the part is the world
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")


def read_matrix(path: str | os.PathLike[str], *, rows: int, columns: int) -> Array:
    """Return the (rows, columns) numbers of a text file, one row a line, or a JSON list of rows; # starts a comment.

    Raises `UnreadableFile` naming line, column and value.
    """
    return _matrix(read_text(path), ((rows, columns),))


def read_pose(path: str | os.PathLike[str]) -> Rigid:
    """Return camera_from_world (mm) of a pose file.

    Text: a comment line that says direction and unit, then 3 or 4 rows of 4 numbers:
        # camera_from_world, mm
        1 0 0 0
        0 1 0 0
        0 0 1 500
    Three decimals of a rotation suffice: the nearest exact one is taken.
    JSON: {"camera_from_world": {"rotation": [[...], ...], "translation_mm": [...]}}, as in a camera file; the name may
    be world_from_camera and the unit any of translation_m, translation_in ... A camera file with a pose serves, too.
    """
    return rigid_in(read_text(path), _DIRECTIONS)


def read_motion(path: str | os.PathLike[str]) -> Rigid:
    """Return new_from_old (mm) of a motion file: p_new = new_from_old @ p_old for whatever is moved.

    As a pose file, with '# new_from_old, mm' (or old_from_new) on its first line, or the same as a key in JSON.
    """
    return rigid_in(read_text(path), _MOTIONS)


def rigid_in(file: TextFile, directions: tuple[str, str]) -> Rigid:
    """Return the first of two directions (mm), of which the file may give either."""
    if file.text.lstrip().startswith("{"):
        return pose_in(parsed(file), directions)
    direction, mm = stated(file, directions)
    matrix = _matrix(file, ((3, 4), (4, 4))).copy()
    matrix[:3, 3] *= mm
    try:
        matrix[:3, :3] = so3.written(matrix[:3, :3])
        pose = Rigid.from_matrix(matrix)
    except CadcamError as error:
        raise UnreadableFile(file.path, f"is not a pose: {error}") from error
    return pose if direction == directions[0] else pose.inv


def pose_at(place: Place) -> Rigid:
    """Return the motion b_from_a in a JSON object {"rotation": 3x3, "translation_mm": 3} (or translation_m ...)."""
    place.only("rotation", *(f"translation_{u}" for u in MM))
    keys = [u for u in MM if f"translation_{u}" in place.object]
    if len(keys) != 1:
        raise place.error("needs one translation with its unit", 'such as "translation_mm": [0, 0, 500]')
    rotation = place.at("rotation").array((3, 3))
    translation = place.at(f"translation_{keys[0]}").array((3,)) * MM[keys[0]]
    return place.build(lambda: Rigid(so3.written(rotation), translation))


def pose_as_json(b_from_a: Rigid) -> dict[str, Any]:
    """Return the JSON object that `pose_at` reads."""
    return {"rotation": b_from_a.rotation.tolist(), "translation_mm": b_from_a.translation.tolist()}


def pose_in(place: Place, directions: tuple[str, ...]) -> Rigid:
    """Return the first of these directions (mm) in a JSON object with one of them as key."""
    said = [d for d in directions if d in place.object]
    if len(said) != 1:
        if any("_part" in key for key in place.object) and not any("_part" in direction for direction in directions):
            raise place.error("holds the pose of a part", "cadcam.read_part_pose reads it")
        raise place.error("needs one pose", f'such as "{directions[0]}": {{"rotation": ..., "translation_mm": ...}}')
    pose = pose_at(place.at(said[0]))
    return pose if same_way(said[0], directions[0]) else pose.inv


def same_way(direction: str, other: str) -> bool:
    """Return whether two directions, such as camera_from_part and camera_from_world, lead to one frame."""
    return direction.partition("_from_")[0] == other.partition("_from_")[0]


def stated(file: TextFile, directions: tuple[str, ...]) -> tuple[str, float]:
    """Return direction and millimetres per unit stated in a comment line; `UnreadableFile` if there is none."""
    said = re.compile(rf"({'|'.join(directions)})[\s,:]+(?:in\s+)?([A-Za-z]+)\.?")
    remedy = f"add a first line such as '# {directions[0]}, mm' (or {directions[1]}; or m, cm, in ...)"
    found = [m for line in comments_of(file) if (m := said.fullmatch(line))]
    if len(found) != 1:
        if "_part" in file.text and not any("_part" in direction for direction in directions):
            raise UnreadableFile(file.path, "holds the pose of a part", "cadcam.read_part_pose reads it")
        raise UnreadableFile(file.path, "does not say which pose it is, and in which unit", remedy)
    try:
        return found[0][1], MM[unit_name(found[0][2])]
    except UnknownName as error:
        raise UnreadableFile(file.path, f"names an {error}", remedy) from None


def _matrix(file: TextFile, shapes: tuple[tuple[int, int], ...]) -> Array:
    rows = _json_rows(file) if file.text.lstrip().startswith("[") else _text_rows(file)
    shape = (len(rows), len(rows[0]) if rows else 0)
    if shape not in shapes or any(len(row) != shape[1] for row in rows):
        wanted = " or ".join(f"{r}x{c}" for r, c in shapes)
        lengths = ", ".join(str(len(row)) for row in rows[:6])
        raise UnreadableFile(
            file.path, f"has {len(rows)} rows of {lengths or 'no'} numbers", f"give a {wanted} matrix, one row a line"
        )
    return np.array(rows)


def _text_rows(file: TextFile) -> list[list[float]]:
    rows = []
    for number, line in enumerate(file.text.splitlines(), start=1):
        cells = _cells(line.split("#")[0])
        if cells:
            rows.append([number_in(file, number, f"number {i}", c) for i, c in enumerate(cells, start=1)])
    return rows


def _cells(line: str) -> list[str]:
    """Return the cells between blanks, commas, semicolons and brackets; commas between blanks are decimal."""
    cells = [c for c in re.split(r"[\s;\[\]]+", line) if c]
    with_commas = [c for c in cells if "," in c]
    if len(cells) > 1 and with_commas and all(_DECIMAL_COMMA.fullmatch(c) for c in with_commas):
        return cells  # `number_in` reports what is wrong with them
    return [c for cell in cells for c in cell.split(",") if c]


def _json_rows(file: TextFile) -> list[list[float]]:
    try:
        rows = json.loads(file.text)
    except (ValueError, RecursionError):
        return _text_rows(file)  # rows in brackets as numpy prints them
    if isinstance(rows, list) and all(isinstance(row, list) for row in rows):
        return [[number_in(file, i, f"number {j}", str(c)) for j, c in enumerate(r, 1)] for i, r in enumerate(rows, 1)]
    raise UnreadableFile(file.path, "is a list but not one of rows", "write [[1, 2, 3, 4], [...], ...]")
