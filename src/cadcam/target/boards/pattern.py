"""Calibration boards as geometry: their points and their ink (`board` has what they have in common)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Floats, Ids, Longs, Mask
from cadcam.errors import BadValue, UnknownName
from cadcam.kinds import expect
from cadcam.target.boards.board import Ink, Pattern, check_counts, check_length, grid, length_mm, length_text


@dataclass(frozen=True)
class Chessboard(Pattern):
    """`columns` x `rows` *inner* corners of squares of `square_mm`; the square above and left of the first is black."""

    square_mm: float

    kind: ClassVar[str] = "chessboard"

    def __post_init__(self) -> None:
        check_counts(self.columns, self.rows, 2)
        check_length("square", self.square_mm)

    @property
    def cells(self) -> Ids:
        """Return (column, row) of each inner corner."""
        return grid(self.columns, self.rows)

    @property
    def cell_mm(self) -> float:
        """Return the side of a square."""
        return self.square_mm

    @property
    def outline(self) -> tuple[float, float, float, float]:
        """Return the outer border of the squares."""
        s = self.square_mm
        return -s, -s, self.columns * s, self.rows * s

    def black(self, p: Floats) -> Mask:
        """Return whether p lies in a black square."""
        column, row = _floors(np.asarray(p, dtype=np.float64) / self.square_mm)
        inside = _within(column, -1, self.columns) & _within(row, -1, self.rows)
        return np.asarray(inside & ((column + row) % 2 == 0))

    def color(self, cell: tuple[int, ...]) -> int:
        """Return whether the square above and left of the corner is white; each quarter turn inverts it."""
        return (cell[0] + cell[1]) % 2

    def _same_when(self, turn: int, places: set[tuple[int, ...]], high: npt.NDArray[np.int32]) -> bool:
        if turn % 2 and self.columns != self.rows:
            return False
        # the first square, black, moves to where square (columns, 0), (columns, rows) or (0, rows) was
        return ((0, self.columns, self.columns + self.rows, self.rows)[turn]) % 2 == 0

    def ink(self) -> Ink:
        """Return the black squares."""
        square = grid(self.columns + 1, self.rows + 1)
        black = square[square.sum(axis=1) % 2 == 0] - 1
        return Ink(np.hstack([black, black + 1]) * self.square_mm, np.zeros((0, 3)))

    def __str__(self) -> str:
        return f"chessboard:{self.columns}x{self.rows}:{length_text(self.square_mm)}"


@dataclass(frozen=True)
class Charuco(Pattern):
    """A chessboard of `columns` x `rows` *squares* with a marker of OpenCV's `dictionary` in each white one.

    Its points are the inner corners, numbered along the rows from 0, as OpenCV does; markers too. The first square is
    black, or white if `legacy` (OpenCV before 4.6 with an even number of rows).
    """

    square_mm: float
    marker_mm: float
    dictionary: str
    legacy: bool = False

    kind: ClassVar[str] = "charuco"

    def __post_init__(self) -> None:
        check_counts(self.columns, self.rows, 3)
        check_length("square", self.square_mm)
        check_length("marker", self.marker_mm)
        if self.marker_mm >= self.square_mm:
            raise BadValue("marker", f"{self.marker_mm:g} mm", f"less than the square's {self.square_mm:g} mm")

    @property
    def cells(self) -> Ids:
        """Return (column, row) of each inner corner."""
        return grid(self.columns - 1, self.rows - 1)

    @property
    def cell_mm(self) -> float:
        """Return the side of a square."""
        return self.square_mm

    @property
    def outline(self) -> tuple[float, float, float, float]:
        """Return the outer border of the squares."""
        s = self.square_mm
        return -s, -s, (self.columns - 1) * s, (self.rows - 1) * s

    @property
    def turns(self) -> int:
        """Return 1: the markers identify every corner."""
        return 1

    @property
    def _white_first(self) -> int:
        return int(self.legacy and self.rows % 2 == 0)

    @property
    def marker_squares(self) -> Ids:
        """Return the square (column, row), counted from (0, 0), of each marker in the order of their numbers."""
        square = grid(self.columns, self.rows)
        return np.asarray(square[(square.sum(axis=1) + self._white_first) % 2 == 1])

    def black(self, p: Floats) -> Mask:
        """Return whether p lies in a black square or on a black module of a marker."""
        place = np.asarray(p, dtype=np.float64) / self.square_mm + 1
        column, row = _floors(place)
        inside = _within(column, 0, self.columns) & _within(row, 0, self.rows)
        white = (column + row + self._white_first) % 2 == 1
        ink = inside & ~white
        there = inside & white
        ink[there] = self._marker_black(place[there], column[there], row[there])
        return np.asarray(ink)

    def _marker_black(self, place: Array, column: Longs, row: Longs) -> Mask:
        """Return the ink of the markers at places (N, 2), in units of a square, in white squares (N,)."""
        bits = self.marker_bits()
        number = np.zeros((self.rows, self.columns), dtype=np.int64)
        cells = self.marker_squares
        number[cells[:, 1], cells[:, 0]] = np.arange(len(cells))
        modules, side = bits.shape[1], self.marker_mm / self.square_mm
        x, y = (
            np.floor((place[:, i] - at - (1 - side) / 2) / side * modules).astype(np.int64)
            for i, at in enumerate((column, row))
        )
        on = _within(x, 0, modules) & _within(y, 0, modules)
        on[on] = bits[number[row[on], column[on]], y[on], x[on]]
        return on

    def marker_bits(self) -> Mask:
        """Return the black modules (M, n, n) of the board's markers, their black frame included."""
        from cadcam.target.boards.opencv import marker_bits

        return marker_bits(self.dictionary, len(self.marker_squares))

    def ink(self) -> Ink:
        """Return the black squares and the black modules of the markers, adjacent ones joined."""
        square = grid(self.columns, self.rows)
        black = square[(square.sum(axis=1) + self._white_first) % 2 == 0] - 1
        shapes = [np.hstack([black, black + 1]) * self.square_mm]
        for (column, row), bits in zip(self.marker_squares.tolist(), self.marker_bits(), strict=True):
            module = self.marker_mm / len(bits)
            corner = np.array([column - 1, row - 1]) * self.square_mm + (self.square_mm - self.marker_mm) / 2
            shapes += [np.tile(corner, 2) + module * np.array([run]) for run in _runs(bits)]
        return Ink(np.concatenate(shapes), np.zeros((0, 3)))

    def __str__(self) -> str:
        lengths = f"{length_text(self.square_mm)}:{length_text(self.marker_mm)}"
        return f"charuco:{self.columns}x{self.rows}:{lengths}:{self.dictionary}" + ":legacy" * self.legacy


@dataclass(frozen=True)
class CircleGrid(Pattern):
    """`columns` x `rows` black discs, `spacing_mm` apart.

    `staggered`: every second row is shifted by half a step (OpenCV's asymmetric grid): rows are `spacing_mm` apart,
    discs in a row twice as much. diameter_mm: None if it is to be measured in the picture.
    """

    spacing_mm: float
    diameter_mm: float | None = None
    staggered: bool = False

    kind: ClassVar[str] = "circles"

    def __post_init__(self) -> None:
        check_counts(self.columns, self.rows, 2)
        check_length("spacing", self.spacing_mm)
        if self.diameter_mm is not None:
            check_length("diameter", self.diameter_mm)
            if self.diameter_mm >= self.nearest_mm:
                raise BadValue("diameter", f"{self.diameter_mm:g} mm", f"less than {self.nearest_mm:g} mm: discs touch")

    @property
    def cells(self) -> Ids:
        """Return (column, row) of each disc; in a staggered grid columns count half steps."""
        cells = grid(self.columns, self.rows)
        if self.staggered:
            cells[:, 0] = 2 * cells[:, 0] + cells[:, 1] % 2
        return cells

    @property
    def cell_mm(self) -> float:
        """Return the spacing."""
        return self.spacing_mm

    @property
    def nearest_mm(self) -> float:
        """Return the distance between the two nearest centres."""
        return self.spacing_mm * (np.sqrt(2.0) if self.staggered else 1.0)

    @property
    def printed_diameter_mm(self) -> float:
        """Return the diameter, half the distance between neighbours if none was given."""
        return self.nearest_mm / 2 if self.diameter_mm is None else self.diameter_mm

    @property
    def outline(self) -> tuple[float, float, float, float]:
        """Return the box around all discs."""
        r = self.printed_diameter_mm / 2
        right, bottom = (self.cells.max(axis=0) * self.spacing_mm).tolist()
        return -r, -r, right + r, bottom + r

    def black(self, p: Floats) -> Mask:
        """Return whether p lies on a disc."""
        place = np.asarray(p, dtype=np.float64) / self.spacing_mm
        r = self.printed_diameter_mm / 2 / self.spacing_mm
        inked = np.zeros(place.shape[:-1], dtype=bool)
        step = 2.0 if self.staggered else 1.0
        for shift in (0, 1) if self.staggered else (0,):
            counts = self.columns, (self.rows + 1 - shift) // 2 if self.staggered else self.rows
            x, y = (_off_nearest(place[..., i] - shift, step, count) for i, count in enumerate(counts))
            inked |= x * x + y * y < r * r
        return inked

    def ink(self) -> Ink:
        """Return the discs."""
        radius = np.full((len(self.cells), 1), self.printed_diameter_mm / 2)
        return Ink(np.zeros((0, 4)), np.hstack([self.cells * self.spacing_mm, radius]))

    def __str__(self) -> str:
        name = "staggered-circles" if self.staggered else "circles"
        diameter = "" if self.diameter_mm is None else f":{length_text(self.diameter_mm)}"
        return f"{name}:{self.columns}x{self.rows}:{length_text(self.spacing_mm)}{diameter}"


FORMS = {
    "chessboard": "chessboard:9x6:25mm (inner corners: side of a square)",
    "charuco": "charuco:8x11:20mm:15mm:5X5_100 (squares: side of a square: side of a marker: dictionary[:legacy])",
    "circles": "circles:7x6:30mm (discs: distance of centres[:diameter])",
    "staggered-circles": "staggered-circles:4x11:20mm (discs: distance of rows[:diameter]; OpenCV's asymmetric grid)",
}


def parse_pattern(text: str) -> Pattern:
    """Return the board of a text such as chessboard:9x6:25mm; lengths carry a unit (um, mm, cm, m, in).

    Raises `UnknownName` for another kind of board, `BadValue` with an example of the right form.
    """
    expect(text, "board", str)
    kind, *parts = text.strip().split(":")
    kind = {"asymmetric-circles": "staggered-circles", "acircles": "staggered-circles"}.get(kind, kind)
    if kind not in FORMS:
        raise UnknownName("kind of board", kind, FORMS)
    legacy = kind == "charuco" and parts[-1:] == ["legacy"]
    parts = parts[:-1] if legacy else parts
    least, most = {"chessboard": (2, 2), "charuco": (4, 4)}.get(kind, (2, 3))
    if not least <= len(parts) <= most:
        raise BadValue("board", repr(text), FORMS[kind])
    columns, rows = _counts(parts[0], text, kind)
    if kind == "chessboard":
        return Chessboard(columns, rows, _millimetres(parts[1], text, kind))
    if kind == "charuco":
        square, marker = (_millimetres(part, text, kind) for part in parts[1:3])
        return Charuco(columns, rows, square, marker, parts[3].upper().removeprefix("DICT_"), legacy)
    diameter = _millimetres(parts[2], text, kind) if len(parts) == 3 else None
    return CircleGrid(columns, rows, _millimetres(parts[1], text, kind), diameter, kind == "staggered-circles")


def _floors(place: Array) -> tuple[Longs, Longs]:
    """Return the column and the row (...) of places (..., 2) in units of a cell."""
    column, row = (np.floor(place[..., i]).astype(np.int64) for i in (0, 1))
    return column, row


def _within(index: Longs, low: int, high: int) -> Mask:
    return np.asarray((index >= low) & (index < high))


def _off_nearest(x: Array, step: float, count: int) -> Array:
    """Return how far each x is from the nearest of 0, step ... (count - 1) step."""
    return np.asarray(x - np.rint(x / step).clip(0, count - 1) * step)


def _counts(part: str, text: str, kind: str) -> tuple[int, int]:
    columns, cross, rows = part.lower().partition("x")
    if not (cross and columns.isdecimal() and rows.isdecimal()):
        raise BadValue(f"size {part!r} of board", repr(text), f"COLUMNSxROWS, as in {FORMS[kind]}")
    return int(columns), int(rows)


def _millimetres(part: str, text: str, kind: str) -> float:
    return length_mm(part, "board", text, FORMS[kind])


def _runs(bits: Mask) -> list[tuple[int, int, int, int]]:
    """Return the runs of black modules along the rows, (left, top, right, bottom) in modules."""
    out = []
    for y, row in enumerate(bits):
        change = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
        out += [(int(a), y, int(b), y + 1) for a, b in change.reshape(-1, 2)]
    return out
