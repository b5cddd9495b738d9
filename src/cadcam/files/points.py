"""Points files: world points and their pixels, one per line.

    # anything behind a hash is a comment
    name, X_mm, Y_mm, Z_mm, x_px, y_px
    A1,   0.0,  80.0, -1040.0, 159.0, 187.1

Cells are separated by commas, semicolons, tabs or blanks. The header names the columns:
X Y Z           the world point, in the unit of `unit=` (default mm), or X_mm, X_m, X_in ... which state it;
x_px y_px       the pixel (column, row), (0, 0) the centre of the top-left pixel; or
U V             the same as in the thesis: U the row (down), V the column (to the right), same origin;
name, sigma_px  optional; every other column is ignored.
A lowercase u, v is refused: OpenCV's u is a column and the thesis' U is a row, and a wrong guess is a mirrored camera.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.units import MM, unit_name
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, UnknownName, UnreadableFile
from cadcam.files.text import (
    Line,
    TextFile,
    check_cells,
    is_number,
    lines_of_cells,
    number_in,
    read_text,
    rows_of_cells,
)
from cadcam.kinds import expect, expect_known, expect_names, expect_path
from cadcam.whole import write_whole

_WORLD = re.compile(r"([XYZxyz])(?:[_ ]?[\[(]?([A-Za-z]+)[\])]?)?")
NAME_COLUMNS = ("name", "id", "point", "label")


@dataclass(frozen=True, slots=True)
class _Layout:
    """The columns of a file: indices of X Y Z, of (x, y) = (column, row), of name and sigma (-1 for none)."""

    header: tuple[str, ...]
    world: tuple[int, int, int]
    pixel: tuple[int, int]
    name: int
    sigma: int
    mm: float


def read_points(
    path: str | os.PathLike[str],
    *,
    unit: str | None = None,
    columns: Sequence[str] | None = None,
    header: Sequence[str] | None = None,
    sigma_px: float | None = None,
) -> Observations:
    """Return the observations in a points file (layout: see this module), world points in mm, pixels (column, row).

    unit: of X, Y, Z where the header does not state it. columns: the two image columns, such as ("U1", "V1"), where the
    file has several pairs. header: the column names of a file that has no header line. sigma_px: noise of one pixel
    coordinate, where the file does not state it. Raises `UnreadableFile` naming file, line, column, value and remedy.
    """
    file = read_text(path)
    lines = list(lines_of_cells(file))
    if header is None:
        header, lines = header_line(file, lines), lines[1:]
    layout = _layout(file, expect_names(header, "header"), unit, columns)
    if not lines:
        raise UnreadableFile(path, "has a header but no points", "add one line for each point")
    table = np.array([_numbers(file, layout, line) for line in lines])
    names = tuple(line.cells[layout.name] for line in lines) if layout.name >= 0 else ()
    _refuse_repeats(file, lines, table, names)
    sigma = sigma_px if layout.sigma < 0 else _one_sigma(file, layout, lines, sigma_px)
    return Observations(
        table[:, :3] * layout.mm, table[:, 3:], names, sigma_px=sigma, source=file.path, sha256=file.sha256
    )


def write_points(path: str | os.PathLike[str], observations: Observations) -> None:
    """Write the observations as CSV (name, X_mm, Y_mm, Z_mm, x_px, y_px[, sigma_px]), whole or not at all.

    Numbers keep every bit: `read_points` returns the same ones. Raises `BadValue` for a name that is not one line.
    """
    expect_path(path)
    expect(observations, "observations", Observations)
    sigma = () if observations.sigma_px is None else (repr(float(observations.sigma_px)),)
    header = ("name", "X_mm", "Y_mm", "Z_mm", "x_px", "y_px", *(("sigma_px",) if sigma else ()))
    points = zip(observations.names, observations.p_world, observations.q, strict=True)
    rows = ([name, *(repr(float(v)) for v in (*p, *q)), *sigma] for name, p, q in points)
    write_whole(path, rows_of_cells(header, rows))


def header_line(file: TextFile, lines: list[Line]) -> tuple[str, ...]:
    """Return the column names on the first line that is not empty; an error if it holds numbers."""
    if not lines:
        raise UnreadableFile(file.path, "holds only comments", "add a header such as X,Y,Z,x_px,y_px and the points")
    first = lines[0]
    if all(is_number(cell) for cell in first.cells):
        raise UnreadableFile(
            file.path,
            f"line {first.number} should name the columns but holds {len(first.cells)} numbers",
            "put a line such as X,Y,Z,x_px,y_px (or X,Y,Z,U,V) first, or give the names: --header (header=)",
        )
    return first.cells


def _layout(file: TextFile, header: tuple[str, ...], unit: str | None, columns: Sequence[str] | None) -> _Layout:
    twice = next((h for i, h in enumerate(header) if h and h in header[:i]), None)
    if twice is not None:
        raise UnreadableFile(file.path, f"column {twice!r} stands twice in the header", "give each its own name")
    pixel = pixel_columns(file, header, columns)
    world, mm = _world_columns(file, header, unit, taken=pixel)
    lower = [h.lower() for h in header]
    name = next((lower.index(n) for n in NAME_COLUMNS if n in lower), -1)
    sigma = lower.index("sigma_px") if "sigma_px" in lower else -1
    strange = next((h for i, h in enumerate(header) if lower[i].startswith("sigma") and i != sigma), None)
    if strange is not None:
        raise UnreadableFile(file.path, f"column {strange!r} is not understood", "name it sigma_px, or remove it")
    return _Layout(header, world, pixel, name, sigma, mm)


def _world_columns(
    file: TextFile, header: tuple[str, ...], unit: str | None, *, taken: Sequence[int]
) -> tuple[tuple[int, int, int], float]:
    """Return the indices of X, Y, Z and the millimetres in their unit."""
    found: dict[str, tuple[int, str]] = {}
    strange: dict[str, UnknownName] = {}
    for i, cell in enumerate(header):
        match = _WORLD.fullmatch(cell)
        if i in taken or match is None or match[2] == "px" or (match[1].islower() and not match[2]):
            continue
        try:
            found.setdefault(match[1].upper(), (i, unit_name(match[2]) if match[2] else ""))
        except UnknownName as error:
            strange[match[1].upper()] = error
    if missing := [axis for axis in "XYZ" if axis not in found]:
        why = f"{strange[missing[0]]}; " if missing[0] in strange else ""
        raise UnreadableFile(
            file.path,
            f"has no column for {', '.join(missing)} (columns: {', '.join(header)})",
            f"{why}name the world point's columns X,Y,Z (mm) or X_m,Y_m,Z_m ...",
        )
    x, y, z = (found[axis][0] for axis in "XYZ")
    return (x, y, z), MM[_one_unit(file, {u for _, u in found.values() if u}, unit)]


def _one_unit(file: TextFile, named: set[str], given: str | None) -> str:
    if len(named) > 1:
        raise UnreadableFile(
            file.path, f"the world point is in {' and '.join(sorted(named))} at once", "leave one unit"
        )
    in_file = next(iter(named), None)
    asked = in_file or "mm" if given is None else unit_name(given)
    if in_file not in (None, asked):
        problem = f"names the world point's columns in {in_file}"
        raise UnreadableFile(file.path, problem, f"ask for no other unit, not for {asked}")
    return asked


def pixel_columns(file: TextFile, header: tuple[str, ...], columns: Sequence[str] | None) -> tuple[int, int]:
    """Return the indices of the pixel's column x and row y."""
    pairs = _pixel_pairs(header)
    listed = f"(columns: {', '.join(header)})"
    if columns is not None:
        return _chosen_pair(pairs, header, columns)
    if len(pairs) == 1:
        return next(iter(pairs.values()))
    if pairs:
        options = " or ".join(f"{a},{b}" for a, b in pairs)
        raise UnreadableFile(
            file.path,
            f"has {len(pairs)} pairs of image columns {listed}",
            f"choose one: --columns {options}",
        )
    if {"u", "v"} <= set(header):
        raise UnreadableFile(
            file.path,
            "columns u, v are ambiguous: OpenCV's u is the column, the dissertation's U the row",
            "rename them to x_px,y_px (column, row) or to U,V (row, column)",
        )
    raise UnreadableFile(
        file.path, f"has no image point {listed}", "name its columns x_px,y_px (column, row) or U,V (row, column)"
    )


def _pixel_pairs(header: tuple[str, ...]) -> dict[tuple[str, str], tuple[int, int]]:
    """Return the pairs of image columns by their names, each with the indices of x and y."""
    pairs = {}
    for i, cell in enumerate(header):
        if match := re.fullmatch(r"U(\w*)", cell):
            other, x_first = f"V{match[1]}", False
        elif match := re.fullmatch(r"x(\w*)_px", cell):
            other, x_first = f"y{match[1]}_px", True
        else:
            continue
        if other in header:
            j = header.index(other)
            pairs[cell, other] = (i, j) if x_first else (j, i)
    return pairs


def _chosen_pair(
    pairs: dict[tuple[str, str], tuple[int, int]], header: tuple[str, ...], columns: Sequence[str]
) -> tuple[int, int]:
    for name in expect_names(columns, "columns"):
        expect_known(name, "column", header)
    for pair, indices in pairs.items():
        if set(pair) == set(columns):
            return indices
    expected = " or ".join(f"{a},{b}" for a, b in pairs) or "x_px,y_px or U,V in the header"
    raise BadValue("columns", ",".join(columns), expected)


def _numbers(file: TextFile, layout: _Layout, line: Line) -> list[float]:
    """Return X, Y, Z in the file's unit and x, y in px."""
    check_cells(file, line, layout.header)
    where = (*layout.world, *layout.pixel)
    return [number_in(file, line.number, f"column {layout.header[i]}", line.cells[i]) for i in where]


def _one_sigma(file: TextFile, layout: _Layout, lines: list[Line], given: float | None) -> float:
    values = {number_in(file, s.number, "column sigma_px", s.cells[layout.sigma]): s.number for s in lines}
    values = values if given is None else {given: 0, **values}
    if len(values) > 1:
        raise UnreadableFile(
            file.path,
            f"has different sigma_px: {', '.join(f'{v:g}' for v in sorted(values)[:4])}",
            "give one value for all points",
        )
    (sigma,) = values
    if sigma <= 0:
        raise UnreadableFile(file.path, f"line {values[sigma]}, column sigma_px is {sigma:g}", "give a positive number")
    return sigma


def _refuse_repeats(file: TextFile, lines: list[Line], table: Array, names: tuple[str, ...]) -> None:
    """Refuse a point given twice: it would count twice in the fit and make every sigma too small."""
    by_numbers: dict[tuple[float, ...], int] = {}
    by_name: dict[str, int] = {}
    for line, row in zip(lines, table.tolist(), strict=True):
        earlier = by_numbers.setdefault(tuple(row), line.number)
        if earlier != line.number:
            what = f"repeats the point of line {earlier} ({', '.join(f'{v:g}' for v in row)})"
            raise UnreadableFile(file.path, f"line {line.number} {what}", "remove one of them")
    for line, name in zip(lines, names, strict=False):
        if not name:
            raise UnreadableFile(file.path, f"line {line.number} has no name", "name every point, or none")
        if (earlier := by_name.setdefault(name, line.number)) != line.number:
            what = f"has the name {name!r} of line {earlier}"
            raise UnreadableFile(file.path, f"line {line.number} {what}", "give each point its own")
