"""Survey files: where the plate's reflectors were, for each picture of the plate.

    picture, reflector, x_mm,   y_mm
    p01.pgm, a,         4647.6, 999.5
    p01.pgm, b,         4493.2, 1144.7

Drawing files: where the marks of a block are in its CAD model: name, x_mm, y_mm.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import UnreadableFile
from cadcam.files.points import header_line
from cadcam.files.text import Line, TextFile, lines_of_cells, number_in, read_text, rows_of_cells
from cadcam.station.plate import Plate
from cadcam.whole import write_whole

_SURVEY = ("picture", "reflector", "x_mm", "y_mm")
_DRAWING = ("name", "x_mm", "y_mm")


def read_survey(path: str | os.PathLike[str], plate: Plate) -> dict[str, Array]:
    """Return the surveyed reflectors (M, 2) mm, in the plate's order, by the picture's file name.

    Raises `UnreadableFile` naming the line, or the picture that lacks a reflector.
    """
    file, rows = _table(path, _SURVEY)
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for line, row in rows:
        picture, name = Path(row["picture"]).name, row["reflector"]
        if name not in plate.reflector_names:
            known = ", ".join(plate.reflector_names)
            raise UnreadableFile(path, f"line {line.number} names the reflector {name!r}", f"the plate has {known}")
        if name in found.setdefault(picture, {}):
            raise UnreadableFile(path, f"line {line.number} gives reflector {name!r} of {picture} again", "remove one")
        found[picture][name] = _xy(file, line, row)
    for picture, seen in found.items():
        if missing := [name for name in plate.reflector_names if name not in seen]:
            raise UnreadableFile(path, f"has no reflector {missing[0]!r} for {picture}", "give all of the plate's")
    return {p: np.array([seen[name] for name in plate.reflector_names]) for p, seen in found.items()}


def write_survey(path: str | os.PathLike[str], plate: Plate, surveyed: Mapping[str, Array]) -> None:
    """Write the surveyed reflectors (M, 2) mm by the picture's file name."""
    rows = [
        (picture, name, repr(x), repr(y))
        for picture, places in surveyed.items()
        for name, (x, y) in zip(plate.reflector_names, places.tolist(), strict=True)
    ]
    write_whole(path, rows_of_cells(_SURVEY, rows))


def read_drawing(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Return where the marks (2,) mm are on the drawing, by name. Raises `UnreadableFile` naming the line."""
    file, rows = _table(path, _DRAWING)
    out: dict[str, Array] = {}
    for line, row in rows:
        if row["name"] in out:
            raise UnreadableFile(path, f"line {line.number} names {row['name']!r} a second time", "remove one of them")
        out[row["name"]] = np.array(_xy(file, line, row))
    return out


def write_drawing(path: str | os.PathLike[str], drawn: Mapping[str, Array]) -> None:
    """Write the marks' places (2,) mm on the drawing, by name."""
    rows = [(name, repr(float(p[0])), repr(float(p[1]))) for name, p in drawn.items()]
    write_whole(path, rows_of_cells(_DRAWING, rows))


def _table(
    path: str | os.PathLike[str], columns: tuple[str, ...]
) -> tuple[TextFile, list[tuple[Line, dict[str, str]]]]:
    file = read_text(path)
    lines = list(lines_of_cells(file))
    header = [cell.lower() for cell in header_line(file, lines)]
    for name in columns:
        if name not in header:
            raise UnreadableFile(path, f"has no column {name}", f"name the columns {', '.join(columns)}")
    for line in lines[1:]:
        if len(line.cells) != len(header):
            raise UnreadableFile(path, f"line {line.number} has {len(line.cells)} cells, the header {len(header)}")
    if len(lines) < 2:
        raise UnreadableFile(path, "has a header but no lines below it")
    return file, [(line, dict(zip(header, line.cells, strict=True))) for line in lines[1:]]


def _xy(file: TextFile, line: Line, row: Mapping[str, str]) -> tuple[float, float]:
    x, y = (number_in(file, line.number, f"column {name}", row[name]) for name in ("x_mm", "y_mm"))
    return x, y
