"""Robot poses as written by controllers: each maker's convention by name, read as base_from_flange in mm.

A file does not state whether its six numbers are KUKA's angles or a rotation vector, so the caller names the convention
(`CONVENTIONS`); `cadcam.calibrate.handeye.conventions` tests which of them agree with a camera's motion. Layouts:

text     one pose a line, cells separated by commas, semicolons, tabs or blanks, # comments; with or without a line of
         column names (the convention's, any case, a unit such as X_mm allowed) and with or without a name in front
JSON     [[numbers], ...], [4x4 rows, ...], {"poses": [...]}, {"name": [numbers], ...} or a list of
         {"name": ..., "pose": ...}
YAML     one pose: the matrix "rows, cols, data" that OpenCV and ViSP write
folder   or several files: one pose each, the file's stem its name, in the order of names, numbers counted as numbers
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import LARGEST, Array, Brief
from cadcam.cad.units import unit_name
from cadcam.errors import CadcamError, UnknownName, UnreadableFile
from cadcam.files.robot_conventions import CONVENTIONS
from cadcam.files.text import Line, TextFile, is_number, lines_of_cells, number_in, read_text
from cadcam.geometry.rigid import Rigid
from cadcam.image.suffixes import natural_order
from cadcam.kinds import expect, expect_flag, expect_known, expect_path

_SUFFIXES = (".txt", ".csv", ".json", ".yaml", ".yml")
_NAME_COLUMNS = ("name", "id", "pose", "image", "label")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RobotNumbers(Brief):
    """Poses as in a file: names ("" where none), numbers (n, k), column names in lower case if any.

    unit, angle: of the positions and angles, "" where the column names do not say.
    """

    path: str
    names: tuple[str, ...]
    numbers: Array
    columns: tuple[str, ...] = ()
    unit: str = ""
    angle: str = ""

    def __post_init__(self) -> None:
        _refuse_twice(self.path, self.names)

    @property
    def possible(self) -> tuple[str, ...]:
        """Return the names of the conventions with this many numbers a pose and, if named, these columns and angles."""
        fit = {n: c for n, c in CONVENTIONS.items() if len(c.columns) == self.numbers.shape[1]}
        named = [n for n, c in fit.items() if not self.columns or set(c.columns) == set(self.columns)]
        return tuple(n for n in named if self.angle in ("", fit[n].angle))

    def some(self, rows: Sequence[int]) -> RobotNumbers:
        """Return some of the poses."""
        return replace(self, names=tuple(self.names[i] for i in rows), numbers=self.numbers[list(rows)])

    def poses(self, convention: str, *, unit: str | None = None) -> Rigid:
        """Return base_from_flange (n), mm, of a convention; `UnreadableFile` where the file does not match it."""
        expect_known(convention, "robot pose convention", CONVENTIONS)
        expect(unit, "unit", str, optional=True)
        rule, numbers = CONVENTIONS[convention], self.numbers
        if self.columns and set(rule.columns) == set(self.columns):
            numbers = numbers[:, [self.columns.index(c) for c in rule.columns]]
        elif self.columns or numbers.shape[1] != len(rule.columns):
            has = f"columns {', '.join(self.columns)}" if self.columns else f"{numbers.shape[1]} numbers a pose"
            other = f"; {', '.join(self.possible)} would fit" if self.possible else ""
            raise UnreadableFile(
                self.path, f"has {has}", f"{convention} is {' '.join(rule.columns)} ({rule.meaning}){other}"
            )
        if unit and self.unit and unit_name(unit) != self.unit:
            raise UnreadableFile(self.path, f"says its positions are in {self.unit}", f"not in {unit}")
        if self.angle not in ("", rule.angle):
            has = f"{convention} has {rule.angle or 'none'} ({rule.meaning})"
            raise UnreadableFile(self.path, f"says its angles are in {self.angle}", has)
        try:
            return rule.poses(numbers, unit=unit or self.unit or None)
        except CadcamError as error:
            raise UnreadableFile(self.path, f"does not hold {convention} poses: {error}") from error


def read_robot_poses(
    path: str | os.PathLike[str], *, convention: str, unit: str | None = None, inverted: bool = False
) -> dict[str, Rigid]:
    """Return base_from_flange (mm) by name of a file or folder (layouts: see this module), in its order.

    convention: one of `CONVENTIONS`; unit: of the positions, where the convention or the header does not give it, or to
    override the convention. inverted: the file holds flange_from_base. Poses without a name are called "1", "2", ...
    Raises `UnreadableFile` naming file, line and value.
    """
    expect_flag(inverted, "inverted")
    found = read_robot_numbers(path)
    poses = found.poses(convention, unit=unit)
    poses = poses.inv if inverted else poses
    names = [name or str(i + 1) for i, name in enumerate(found.names)]
    _refuse_twice(found.path, names)
    return dict(zip(names, poses.each, strict=True))


def read_robot_numbers(*paths: str | os.PathLike[str]) -> RobotNumbers:
    """Return the poses of a file, a folder, or several files of one pose each, as numbers, before any convention."""
    for one in paths:
        expect_path(one)
    if len(paths) > 1:
        return _one_each([Path(p) for p in paths], os.fspath(paths[0]))
    path = Path(paths[0])
    if path.is_dir():
        files = [f for f in path.iterdir() if f.suffix.lower() in _SUFFIXES and f.is_file()]
        if not files:
            raise UnreadableFile(path, f"holds no pose file ({', '.join(_SUFFIXES)})", "name the right folder")
        return _one_each(files, str(path))
    file = read_text(paths[0])
    start = file.text.lstrip()[:1]
    if path.suffix.lower() in (".yaml", ".yml"):
        return _from_yaml(file)
    return _from_json(file) if start in ("{", "[") else _from_text(file)


def _refuse_twice(path: str, names: Sequence[str]) -> None:
    twice = next((n for i, n in enumerate(names) if n and n in names[:i]), None)
    if twice is not None:
        raise UnreadableFile(path, f"names two poses {twice!r}", "give each a name of its own")


def _one_each(files: Sequence[Path], label: str) -> RobotNumbers:
    files = sorted(files, key=lambda file: natural_order(file.stem))
    each = [read_robot_numbers(f) for f in files]
    for file, one in zip(files, each, strict=True):
        if one.numbers.shape != (1, each[0].numbers.shape[1]):
            n, k = one.numbers.shape
            raise UnreadableFile(
                file, f"holds {n} poses of {k} numbers", f"one of {each[0].numbers.shape[1]} as in {files[0].name}"
            )
        if (one.columns, one.unit, one.angle) != (each[0].columns, each[0].unit, each[0].angle):
            raise UnreadableFile(file, "names other columns or units", f"the same in each file, as in {files[0].name}")
    names, numbers = tuple(f.stem for f in files), np.concatenate([e.numbers for e in each])
    return replace(each[0], path=label, names=names, numbers=numbers)


def _from_text(file: TextFile) -> RobotNumbers:
    columns, unit, angle, lines = _text_table(file)
    width = len(lines[0].cells)
    named = [i for i, c in enumerate(columns) if c in _NAME_COLUMNS] if columns else _name_in_front(lines[0])
    numbers = [i for i in range(width) if i not in named]
    whats = columns or [f"cell {i + 1}" for i in range(width)]
    names = tuple(line.cells[named[0]] if named else "" for line in lines)
    values = np.array([[number_in(file, line.number, whats[i], line.cells[i]) for i in numbers] for line in lines])
    if values.shape[1] == 16 and not columns:
        values = _without_last_row(file.path, values.reshape(-1, 4, 4))
    return RobotNumbers(file.path, names, values, tuple(columns[i] for i in numbers) if columns else (), unit, angle)


def _text_table(file: TextFile) -> tuple[tuple[str, ...], str, str, list[Line]]:
    """Return the names of the columns, if any, the units of x, y, z and of angles, and the lines, all of one length."""
    lines = list(lines_of_cells(file))
    if not lines:
        raise UnreadableFile(file.path, "holds only comments", "give one pose a line")
    try:
        columns, units, angles = _header(lines[0])
    except UnknownName as error:
        raise UnreadableFile(file.path, f"names a column with an {error}", "robots' positions are lengths") from error
    lines = lines[1:] if columns else lines
    if not lines:
        raise UnreadableFile(file.path, "has column names but no poses", "give one pose a line")
    wanted = len(columns) or len(lines[0].cells)
    for line in lines:
        if len(line.cells) != wanted:
            raise UnreadableFile(
                file.path, f"line {line.number} has {len(line.cells)} cells", f"there are {wanted} in the first line"
            )
    return columns, _one_unit(file, "positions", units), _one_unit(file, "angles", angles), lines


def _one_unit(file: TextFile, what: str, named: set[str]) -> str:
    if len(named) > 1:
        raise UnreadableFile(file.path, f"names {what} in {' and '.join(sorted(named))} at once", "give one unit")
    return next(iter(named), "")


def _header(line: Line) -> tuple[tuple[str, ...], set[str], set[str]]:
    """Return the column names in lower case, and what units of x, y, z and of angles they state; none for numbers."""
    columns, units, angles = list[str](), set[str](), set[str]()
    if sum(is_number(c) for c in line.cells) > len(line.cells) // 2:
        return (), units, angles
    for cell in line.cells:
        match = re.fullmatch(r"([xyz])[_ ]?[\[(]?([a-z]+)?[\])]?", cell.lower())
        if match and match[2]:
            units.add(unit_name(match[2]))
        turn = re.fullmatch(r"(.+?)[_ ]?[\[(]?(deg|rad)[\])]?", cell.lower())
        if turn:
            angles.add(turn[2])
        named = match or turn
        columns.append(named[1] if named else cell.lower())
    return tuple(columns), units, angles


def _name_in_front(line: Line) -> list[int]:
    """Return [0] where the first cell is a name; a number is one only if it cannot belong to the pose."""
    return [0] if not is_number(line.cells[0]) or len(line.cells) in (8, 13, 17) else []


def _from_json(file: TextFile) -> RobotNumbers:
    try:
        value = json.loads(file.text)
    except (ValueError, RecursionError) as error:
        raise UnreadableFile(file.path, f"is not JSON: {error}", "is it cut off?") from None
    value = value["poses"] if isinstance(value, dict) and "poses" in value else value
    if isinstance(value, dict):
        items = [(str(name), pose) for name, pose in value.items()]
    elif isinstance(value, list):
        items = [_named(v) for v in value]
    else:
        items = []
    if not items:
        raise UnreadableFile(file.path, "holds no poses", 'write [[x, y, z, ...], ...] or {"name": [x, y, z, ...]}')
    numbers = [_numbers(file.path, name or str(i + 1), pose) for i, (name, pose) in enumerate(items)]
    if len({len(n) for n in numbers}) > 1:
        raise UnreadableFile(file.path, f"has poses of {sorted({len(n) for n in numbers})} numbers", "give all alike")
    return RobotNumbers(file.path, tuple(name for name, _ in items), np.array(numbers))


def _named(value: Any) -> tuple[str, Any]:
    return (str(value.get("name", "")), value.get("pose")) if isinstance(value, dict) else ("", value)


def _numbers(path: str, name: str, pose: Any) -> list[float]:
    try:
        array = np.array(pose, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if not array.size or not (np.abs(array) <= LARGEST).all() or isinstance(pose, bool):
        raise UnreadableFile(path, f"pose {name!r} is {str(pose)[:60]!r}", "give finite numbers, or 3 or 4 rows of 4")
    if array.size == 16:
        array = _without_last_row(path, array.reshape(1, 4, 4))
    return [float(v) for v in array.ravel()]


def _without_last_row(path: str, matrices: Array) -> Array:
    if np.abs(matrices[:, 3] - [0, 0, 0, 1]).max() > 1e-9:
        i = int(np.argmax(np.abs(matrices[:, 3] - [0, 0, 0, 1]).max(axis=1)))
        raise UnreadableFile(
            path, f"the last row of matrix {i + 1} is {matrices[i, 3].tolist()}", "0 0 0 1, matrices are given in rows"
        )
    return np.asarray(matrices[:, :3].reshape(-1, 12))


def _from_yaml(file: TextFile) -> RobotNumbers:
    """Read rows, cols, data; other YAML is not a pose."""
    found = re.search(r"\bdata:(.*)", file.text, flags=re.DOTALL)
    shape = [re.search(rf"\b{key}:\s*(\d+)", file.text) for key in ("rows", "cols")]
    if found is None or None in shape:
        raise UnreadableFile(file.path, "is not a YAML matrix", 'it has "rows:", "cols:" and "data:" with the numbers')
    cells = [c for c in re.split(r"[\s,\[\]]+|(?:^|\s)-\s", found[1]) if c and c != "-"]
    line = file.text[: found.start()].count("\n") + 1
    numbers: Sequence[float] = [number_in(file, line, f"number {i} of data", c) for i, c in enumerate(cells, 1)]
    rows, cols = (int(m[1]) for m in shape if m)
    if len(numbers) != rows * cols:
        raise UnreadableFile(file.path, f"has {len(numbers)} numbers in data", f"rows x cols is {rows * cols}")
    values = np.array(numbers).reshape(1, -1)
    return RobotNumbers(
        file.path, ("",), _without_last_row(file.path, values.reshape(1, 4, 4)) if values.size == 16 else values
    )
