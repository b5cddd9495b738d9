"""Several named poses in one file, which must state their direction and unit."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from cadcam.errors import CadcamError, UnknownName, UnreadableFile
from cadcam.files.jsontext import parsed
from cadcam.files.matrix import POSES, pose_in, read_pose, same_way, stated
from cadcam.files.text import Line, TextFile, check_cells, lines_of_cells, number_in, read_text, rows_of_cells
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect, expect_path
from cadcam.whole import write_whole

_ROTATION = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
_NUMBERS = (*_ROTATION, "tx", "ty", "tz")
_COLUMNS = ("name", *_NUMBERS)
_SUFFIXES = (".txt", ".json", ".csv")
_HEADER = "name, r11, r12, r13, r21, ..., r33, tx, ty, tz"


def read_poses(path: str | os.PathLike[str]) -> dict[str, Rigid]:
    """Return camera_from_world (mm) by name, in the order of a poses file or of the names of the files in a folder.

    Text: a comment line with direction and unit, a line of column names, then one pose per line. The name may be left
    out; poses are then named 0000, 0001 ...
        # camera_from_world, mm
        name, r11, r12, r13, r21, r22, r23, r31, r32, r33, tx, ty, tz
        left, 1, 0, 0, 0, 1, 0, 0, 0, 1, -20, 0, 500
    camera_from_part is the same for a part whose own axes are the world, and part_from_camera is its inverse.
    JSON: {"poses": [{"name": "left", "camera_from_world": {"rotation": [[...], ...], "translation_mm": [...]}}, ...]}.
    A folder: each .txt, .json or .csv file in it is a pose file as for `read_pose`, its name that of the pose.
    Raises `UnreadableFile` naming line or key.
    """
    expect_path(path)
    if Path(path).is_dir():
        named = [(file.stem, read_pose(file)) for file in _files_in(Path(path))]
    else:
        file = read_text(path)
        named = list(_in_json(file) if file.text.lstrip().startswith("{") else _in_text(file))
    if not named:
        raise UnreadableFile(path, "holds no pose", "give one a line below the column names")
    poses: dict[str, Rigid] = {}
    for name, pose in named:
        if name in poses:
            raise UnreadableFile(path, f"names two poses {name!r}", "give each a name of its own")
        poses[name] = pose
    return poses


def write_poses(path: str | os.PathLike[str], poses: Mapping[str, Rigid]) -> None:
    """Write camera_from_world (mm) by name as the text that `read_poses` reads, every bit of the numbers kept."""
    expect_path(path)
    expect(poses, "poses", Mapping)
    for name, pose in poses.items():
        expect_motion(pose, f"pose {name!r}")
    rows = (
        [name, *(repr(float(v)) for v in (*pose.rotation.ravel(), *pose.translation))] for name, pose in poses.items()
    )
    write_whole(path, b"# camera_from_world, mm\n" + rows_of_cells(_COLUMNS, rows))


def _files_in(folder: Path) -> list[Path]:
    found = sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file())
    if not found:
        raise UnreadableFile(folder, f"holds no pose file ({', '.join(_SUFFIXES)})", "name the right folder")
    return found


def _in_json(file: TextFile) -> Iterator[tuple[str, Rigid]]:
    listed = 'write "poses": [{"name": ..., "camera_from_world": ...}, ...]'
    for i, place in enumerate(parsed(file).at("poses").items(listed)):
        name = place.at("name").text() if "name" in place.object else f"{i:04d}"
        yield name, pose_in(place, POSES)


def _in_text(file: TextFile) -> Iterator[tuple[str, Rigid]]:
    direction, mm = stated(file, POSES)
    lines = lines_of_cells(file)
    columns = _columns(file, next(lines, Line(1, ())))
    for i, line in enumerate(lines):
        check_cells(file, line, columns)
        cell = dict(zip(columns, line.cells, strict=True))
        numbers = np.array([number_in(file, line.number, c, cell[c]) for c in _NUMBERS])
        try:
            pose = Rigid(so3.written(numbers[:9].reshape(3, 3)), numbers[9:] * mm)
        except CadcamError as error:
            raise UnreadableFile(file.path, f"line {line.number} is not a pose: {error}") from error
        yield cell.get("name", f"{i:04d}"), pose if same_way(direction, POSES[0]) else pose.inv


def _columns(file: TextFile, head: Line) -> tuple[str, ...]:
    """Return the column names, each once, including all numbers."""
    columns = tuple(c.lower() for c in head.cells)
    missing = [c for c in _NUMBERS if c not in columns]
    if len(missing) == len(_NUMBERS):
        raise UnreadableFile(file.path, f"line {head.number} does not name the columns", f"write {_HEADER}")
    for column in columns:
        if column not in _COLUMNS:
            raise UnreadableFile(file.path, f"line {head.number}: {UnknownName('column', column, _COLUMNS)}")
    if missing or len(set(columns)) != len(columns):
        wrong = f"lacks {', '.join(missing)}" if missing else "names a column twice"
        raise UnreadableFile(file.path, f"line {head.number} {wrong}", f"write {_HEADER}")
    return columns
