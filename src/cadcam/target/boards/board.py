"""What boards and plates have in common: points on an integer grid, and ink.

A board's frame: the origin is its first point, x along a row to the right, y down the printed board, z into the paper,
all in mm; so a camera that looks at the upright board sees x to its right and y downwards. Points run along the rows.
Every board also lies on an integer grid (`cells`), whose neighbourhoods `cadcam.target.boards.lattice` finds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Floats, Ids, Mask, frozen
from cadcam.cad.units import MM, unit_name
from cadcam.errors import BadValue

MAX_POINTS = 50_000
LARGEST_MM = 1e6  # longest length in a text: no board is a kilometre


@dataclass(frozen=True, slots=True, eq=False)
class Ink:
    """Black shapes: rectangles (N, 4) = left, top, right, bottom, and discs (M, 3) = x, y, radius, mm.

    sectors (K, 6) of rings: x, y, inner and outer radius, from and to in rad. ground (0 or 1, 4): a black rectangle in
    which the sectors are holes.
    """

    rectangles: Array
    discs: Array
    sectors: Array = field(default_factory=lambda: np.zeros((0, 6)))
    ground: Array = field(default_factory=lambda: np.zeros((0, 4)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "rectangles", frozen(self.rectangles, "rectangles", (None, 4)))
        object.__setattr__(self, "discs", frozen(self.discs, "discs", (None, 3)))
        object.__setattr__(self, "sectors", frozen(self.sectors, "sectors", (None, 6)))
        object.__setattr__(self, "ground", frozen(self.ground, "ground", (None, 4)))


@dataclass(frozen=True)
class Pattern(ABC):
    """What all boards share; `columns` and `rows` count points (for ChArUco boards: squares)."""

    columns: int
    rows: int

    kind: ClassVar[str]

    @property
    @abstractmethod
    def cells(self) -> Ids:
        """Return each point's grid coordinates (N, 2), whole numbers (column, row); a cell's size is `cell_mm`."""

    @property
    @abstractmethod
    def cell_mm(self) -> float:
        """Return the distance of neighbouring cells in mm."""

    @property
    @abstractmethod
    def outline(self) -> tuple[float, float, float, float]:
        """Return (left, top, right, bottom) of all ink in mm."""

    @abstractmethod
    def black(self, p: Floats) -> Mask:
        """Return whether the board's plane is inked at p (..., 2) mm."""

    @property
    def points(self) -> Array:
        """Return the points (N, 3) in the board's frame, mm, z = 0."""
        return np.column_stack([self.cells * self.cell_mm, np.zeros(len(self.cells))])

    @property
    def size_mm(self) -> tuple[float, float]:
        """Return width and height of the ink in mm."""
        left, top, right, bottom = self.outline
        return right - left, bottom - top

    @property
    def turns(self) -> int:
        """Return the number of rotations that look the same: 1 if a picture shows which corner is the first."""
        places = {tuple(c) for c in self.cells.tolist()}
        high = self.cells.max(axis=0)
        return 1 + sum(self._same_when(turn, places, high) for turn in (1, 2, 3))

    def _same_when(self, turn: int, places: set[tuple[int, ...]], high: npt.NDArray[np.int32]) -> bool:
        turned = {_turned(place, turn, high) for place in places}
        return turned == places and all(self.color(place) == self.color(_turned(place, turn, high)) for place in places)

    def color(self, cell: tuple[int, ...]) -> int:
        """Return 0 or 1: kinds of points that a picture tells apart once the rotation of the board is given."""
        return 0

    @abstractmethod
    def ink(self) -> Ink:
        """Return what is printed."""

    @abstractmethod
    def __str__(self) -> str:
        """Return the text that `parse_pattern` reads."""


def length_mm(part: str, what: str, text: str, form: str) -> float:
    """Return the length in `part`, such as 25mm, of a longer text; `BadValue` names `what` and the right form."""
    digits = part.rstrip("abcdefghijklmnopqrstuvwxyzµμABCDEFGHIJKLMNOPQRSTUVWXYZ\"'")
    unit = part[len(digits) :].strip()
    try:
        value = float(digits)
    except ValueError:
        raise BadValue(f"length {part!r} of {what}", repr(text), f"a length, as in {form}") from None
    if not unit:
        raise BadValue(f"length {part!r} of {what}", repr(text), f"a length with its unit, as in {form}")
    mm = value * MM[unit_name(unit)]
    if abs(mm) > LARGEST_MM:
        raise BadValue(f"length {part!r} of {what}", repr(text), f"a length of at most {LARGEST_MM:g} mm")
    return mm


def length_text(mm: float) -> str:
    """Return a length as `length_mm` reads it, to twelve digits, so that lengths given in other units stay short."""
    return f"{mm:.12g}mm"


def grid(columns: int, rows: int) -> Ids:
    """Return (column, row) of columns x rows places, along the rows."""
    row, column = np.divmod(np.arange(columns * rows, dtype=np.int32), np.int32(columns))
    return np.column_stack([column, row]).astype(np.int32)


def _turned(cell: tuple[int, ...], turn: int, high: npt.NDArray[np.int32]) -> tuple[int, int]:
    x, y = cell
    for k in range(turn):
        x, y = int(high[1 - k % 2]) - y, x
    return x, y


def check_counts(columns: int, rows: int, least: int) -> None:
    """Raise `BadValue` for fewer than least columns or rows, or more than `MAX_POINTS` points."""
    if min(columns, rows) < least or columns * rows > MAX_POINTS:
        raise BadValue("board size", f"{columns} x {rows}", f"{least} x {least} at least, {MAX_POINTS} points at most")


def check_length(what: str, value: float) -> None:
    """Raise `BadValue` for a length that is not positive."""
    if not (np.isfinite(value) and value > 0):
        raise BadValue(what, f"{value:g} mm", "a positive length")
