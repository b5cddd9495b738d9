"""Single marks as geometry: concentric borders, with sectors for marks that have a direction or a number.

A mark's frame: the origin is its centre, x to the right, y down the print, z into the paper, all in mm; angles go from
x towards y. Everything here is black on white; `light` inverts it (white dots on a black ground).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from cadcam.arrays import Array, Brief, Floats, Longs, Mask, frozen
from cadcam.errors import BadValue, UnknownName
from cadcam.kinds import expect
from cadcam.target.boards.board import Ink, length_mm, length_text

Sector: TypeAlias = tuple[float, float, float, float]  # inner and outer radius, mm; from and to, rad

FULL = 2 * math.pi
_QUARTER = math.pi / 2
CODE_BITS = 12


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mark(Brief):
    """One mark: `sectors` (K, 4) of rings are its ink, inner and outer radius in mm, from and to in rad.

    They do not overlap; a full turn is a ring, one from radius 0 a disc. name: the text that `parse_mark` reads.
    number: of a coded mark.
    """

    name: str
    sectors: Array
    light: bool = False
    number: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "sectors", frozen(self.sectors, "sectors", (None, 4)))
        inner, outer, start, stop = self.sectors.T
        turn = stop - start
        if not len(self.sectors) or (inner < 0).any() or (outer <= inner).any() or (turn <= 0).any():
            raise BadValue("sectors", self.sectors.tolist(), "0 <= inner < outer, from < to")
        if (turn > FULL + 1e-9).any():
            raise BadValue("sectors", self.sectors.tolist(), "at most a full turn each")

    @property
    def radius(self) -> float:
        """Return the radius of the outermost ink, mm."""
        return float(self.sectors[:, 1].max())

    @property
    def full(self) -> Mask:
        """Return which sectors are whole rings or discs."""
        return np.asarray(self.sectors[:, 3] - self.sectors[:, 2] > FULL - 1e-9)

    @property
    def concentric(self) -> bool:
        """Return whether the mark looks the same under every rotation."""
        return bool(self.full.all())

    @property
    def rings(self) -> Mark:
        """Return the mark with its whole rings and discs only: the part that is the same under every rotation."""
        return self if self.concentric else Mark(f"rings of {self.name}", self.sectors[self.full], self.light)

    @property
    def core(self) -> tuple[float, bool] | None:
        """Return (radius mm, inked) of the mark's central disc; None where its middle is not a disc."""
        whole = self.sectors[self.full]
        if not len(whole):
            return None
        nearest = whole[np.argmin(whole[:, 0])]
        if (self.sectors[~self.full, 0] < nearest[0]).any():
            return None
        return (float(nearest[1]), True) if nearest[0] == 0 else (float(nearest[0]), False)

    @property
    def turns(self) -> int:
        """Return the number of rotations under which the mark looks the same; 0 if all."""
        if self.concentric:
            return 0
        return next(n for n in range(8, 0, -1) if self._same_turned(FULL / n))

    def _same_turned(self, by: float) -> bool:
        angles = (np.arange(720) + 0.5) * (FULL / 720)
        radii = np.unique(self.sectors[~self.full, :2])
        middle = (radii[1:] + radii[:-1]) / 2
        rays = (
            np.stack([np.cos(angles), np.sin(angles)], axis=-1),
            np.stack([np.cos(angles + by), np.sin(angles + by)], axis=-1),
        )
        first, second = (self.inked(middle[:, None, None] * ray) for ray in rays)
        return bool((first != second).mean() < 0.01)

    def inked(self, p: Floats) -> Mask:
        """Return whether the sectors cover p (..., 2) mm, whichever colour they have."""
        p = np.asarray(p, dtype=np.float64)
        radius = np.hypot(p[..., 0], p[..., 1])
        angle = np.zeros_like(radius) if self.full.all() else np.arctan2(p[..., 1], p[..., 0])
        inside = np.zeros(radius.shape, dtype=bool)
        for inner, outer, start, stop in self.sectors.tolist():
            ring = (radius >= inner) & (radius < outer)
            inside |= ring if stop - start > FULL - 1e-9 else ring & (np.mod(angle - start, FULL) < stop - start)
        return inside

    def __str__(self) -> str:
        return self.name


def dot(diameter: float) -> Mark:
    """Return a black disc."""
    return _concentric("dot", (diameter,))


def ring(inner: float, outer: float) -> Mark:
    """Return a black ring, by its diameters."""
    return _concentric("ring", (inner, outer), first_black=False)


def dot_and_ring(disc: float, inner: float, outer: float) -> Mark:
    """Return a disc in a ring, by their diameters (the dissertation's template, Fig. 4-2 and 6-3)."""
    return _concentric("dot-ring", (disc, inner, outer))


def bulls_eye(*diameters: float) -> Mark:
    """Return borders of these diameters: black inside the first, white up to the second, black up to the third ..."""
    if len(diameters) % 2 == 0:
        raise BadValue("borders", list(diameters), "an odd number: the outermost closes black ink")
    return _concentric("bullseye", diameters)


def angle_mark(disc: float, inner: float, outer: float) -> Mark:
    """Return a disc in a ring with a gap of a sixth of a turn where its x axis points: it shows its direction."""
    _check_growing("angle", (disc, inner, outer))
    gap = FULL / 12
    sectors = [(0.0, disc / 2, 0.0, FULL), (inner / 2, outer / 2, gap, FULL - gap)]
    return Mark(_name("angle", (disc, inner, outer)), np.array(sectors))


def chess_mark(diameter: float) -> Mark:
    """Return a disc of two black and two white quarters: the corner of a chessboard, at its centre."""
    _check_growing("chess", (diameter,))
    r = diameter / 2
    return Mark(_name("chess", (diameter,)), np.array([(0, r, 0, _QUARTER), (0, r, 2 * _QUARTER, 3 * _QUARTER)]))


def coded_ring(number: int, disc: float, inner: float, outer: float, *, bits: int = CODE_BITS) -> Mark:
    """Return a disc in a ring of `bits` sectors, black where number has a 1; its first bit starts at the x axis.

    The number is read at any rotation: it must be the least of its cyclic shifts (`ring_numbers` lists them), as is
    usual for ring codes (Schneider and Sinnreich, ISPRS Archives 29 B5, 1992). A gap separates ring and disc.
    """
    _check_growing("coded", (disc, inner, outer))
    if number not in ring_numbers(bits):
        raise BadValue("number", number, f"one of the {len(ring_numbers(bits))} ring numbers of {bits} bits")
    on = np.array([number >> k & 1 for k in range(bits)], dtype=bool)
    sectors: list[Sector] = [(0.0, disc / 2, 0.0, FULL)]
    sectors += [(inner / 2, outer / 2, a * FULL / bits, b * FULL / bits) for a, b in _runs(on)]
    suffix = "" if bits == CODE_BITS else f":{bits}"
    return Mark(_name(f"coded:{number}", (disc, inner, outer)) + suffix, np.array(sectors), number=number)


def ring_numbers(bits: int) -> tuple[int, ...]:
    """Return the numbers of `bits` bits that are the least of their cyclic shifts, all of which differ."""
    if not 4 <= bits <= 16:
        raise BadValue("bits", bits, "4 to 16")
    top = (1 << bits) - 1

    def turned(n: int) -> list[int]:
        return [(n << k & top) | n >> (bits - k) for k in range(bits)]

    return tuple(n for n in range(1, top) if min(t := turned(n)) == n and len(set(t)) == bits)


def renumbered(mark: Mark, number: int) -> Mark:
    """Return the coded mark of the same geometry with another number."""
    if mark.number is None:
        raise BadValue("mark", str(mark), "a coded mark")
    text = mark.name.removeprefix("light-").split(":")
    other = parse_mark(":".join([text[0], str(number), *text[2:]]))
    return inverted(other) if mark.light else other


def inverted(mark: Mark) -> Mark:
    """Return the mark white on black."""
    name = mark.name.removeprefix("light-") if mark.light else f"light-{mark.name}"
    return Mark(name, mark.sectors, not mark.light, mark.number)


FORMS = {
    "dot": "dot:30mm (diameter)",
    "ring": "ring:20mm:30mm (diameters of its borders)",
    "dot-ring": "dot-ring:30mm:60mm:90mm (diameters: disc, white, ring)",
    "bullseye": "bullseye:20mm:40mm:60mm:80mm:100mm (diameters of its borders from the middle, black inside the first)",
    "angle": "angle:30mm:60mm:90mm (disc, white, ring open where its x axis points)",
    "chess": "chess:60mm (diameter; two black and two white quarters)",
    "coded": "coded:37:30mm:45mm:60mm[:12] (number, disc, white, ring of coded sectors[:bits])",
}


def parse_mark(text: str) -> Mark:
    """Return the mark of a text such as dot-ring:30mm:60mm:90mm; the prefix "light-" makes it white on black.

    Lengths are diameters with a unit. Raises `UnknownName` for another kind, `BadValue` with an example.
    """
    expect(text, "mark", str)
    stripped = text.strip()
    if stripped.startswith("light-"):
        return inverted(parse_mark(stripped.removeprefix("light-")))
    kind, *parts = stripped.split(":")
    if kind not in FORMS:
        raise UnknownName("kind of mark", kind, FORMS)
    if kind == "coded":
        return _parsed_code(parts, text)
    least, most = {"dot": (1, 1), "ring": (2, 2), "bullseye": (1, 99), "chess": (1, 1)}.get(kind, (3, 3))
    if not least <= len(parts) <= most:
        raise BadValue("mark", repr(text), FORMS[kind])
    lengths = [length_mm(part, "mark", text, FORMS[kind]) for part in parts]
    make: dict[str, Callable[..., Mark]] = {
        "dot": dot,
        "ring": ring,
        "dot-ring": dot_and_ring,
        "bullseye": bulls_eye,
        "angle": angle_mark,
        "chess": chess_mark,
    }
    return make[kind](*lengths)


def _parsed_code(parts: list[str], text: str) -> Mark:
    if len(parts) not in (4, 5) or not all(p.isdecimal() for p in (parts[0], *parts[4:])):
        raise BadValue("mark", repr(text), FORMS["coded"])
    disc, inner, outer = (length_mm(part, "mark", text, FORMS["coded"]) for part in parts[1:4])
    return coded_ring(int(parts[0]), disc, inner, outer, bits=int(parts[4]) if len(parts) == 5 else CODE_BITS)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MarkSheet(Brief):
    """Marks at `places` (N, 2) mm in one plane: a calibration plate, or a sheet of marks to cut out.

    Its frame: z = 0, x to the right, y down the print. It can be drawn by `ideal.board_picture` and printed by
    `sheet.write_sheet` as a board can. Marks are all dark or all light.
    """

    marks: tuple[Mark, ...]
    places: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "marks", tuple(self.marks))
        object.__setattr__(self, "places", frozen(self.places, "places", (len(self.marks), 2)))
        if not self.marks or len({mark.light for mark in self.marks}) > 1:
            raise BadValue("marks", [str(m) for m in self.marks][:5], "one mark at least, all dark or all light")

    @classmethod
    def grid(cls, marks: tuple[Mark, ...], columns: int, rows: int, spacing_mm: float) -> MarkSheet:
        """Return columns x rows marks `spacing_mm` apart, along the rows; one mark is repeated."""
        if min(columns, rows) < 1 or len(marks) not in (1, columns * rows):
            raise BadValue("grid of marks", f"{columns} x {rows} for {len(marks)} marks", "as many places as marks")
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        each = marks * (columns * rows) if len(marks) == 1 else marks
        plate = cls(each, np.asarray(np.column_stack([x.ravel(), y.ravel()]) * spacing_mm, np.float64))
        plate.check_apart()
        return plate

    def check_apart(self) -> None:
        """Raise `BadValue` naming the first two marks that overlap."""
        radius = np.array([mark.radius for mark in self.marks])
        for i in range(1, len(self.marks)):
            apart = np.hypot(*(self.places[:i] - self.places[i]).T) - radius[:i] - radius[i]
            if (apart < 0).any():
                j = int(np.argmin(apart))
                raise BadValue(
                    "marks", f"{self.marks[j]} and {self.marks[i]}, {-apart[j]:.4g} mm into each other", "apart"
                )

    @property
    def light(self) -> bool:
        """Return whether the marks are white on black."""
        return self.marks[0].light

    @property
    def points(self) -> Array:
        """Return the marks' centres (N, 3) in the plate's frame, mm."""
        return np.column_stack([self.places, np.zeros(len(self.places))])

    @property
    def cell_mm(self) -> float:
        """Return the largest mark's radius: the least white margin of a plate."""
        return max(mark.radius for mark in self.marks)

    @property
    def outline(self) -> tuple[float, float, float, float]:
        """Return (left, top, right, bottom) of all ink, mm."""
        radius = np.array([[mark.radius] for mark in self.marks])
        ground = self.cell_mm if self.light else 0.0
        low, high = (self.places - radius).min(axis=0) - ground, (self.places + radius).max(axis=0) + ground
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @property
    def size_mm(self) -> tuple[float, float]:
        """Return width and height of all ink, mm."""
        left, top, right, bottom = self.outline
        return right - left, bottom - top

    def black(self, p: Floats) -> Mask:
        """Return whether the plate is black at p (..., 2) mm."""
        p = np.asarray(p, dtype=np.float64)
        inside = self._inked(p)
        if not self.light:
            return inside
        left, top, right, bottom = self.outline
        ground = (p[..., 0] >= left) & (p[..., 0] <= right) & (p[..., 1] >= top) & (p[..., 1] <= bottom)
        return np.asarray(ground & ~inside)

    def _inked(self, p: Array) -> Mask:
        """Return whether the sectors of a mark cover p (..., 2) mm."""
        radius = np.array([mark.radius for mark in self.marks])
        inside: Mask = np.zeros(p.shape[:-1], dtype=bool)
        for size in np.unique(radius):  # the nearest of all may be a small mark beside the large one that covers p
            inside |= self._inked_by(np.flatnonzero(radius == size), p)
        return np.asarray(inside)

    def _inked_by(self, some: Longs, p: Array) -> Mask:
        """Return whether the sectors of the nearest of some marks of one size cover p (..., 2) mm."""
        from scipy.spatial import cKDTree

        first = self.marks[int(some[0])]
        if len(some) == 1:
            return first.inked(p - self.places[some[0]])
        inside, places = np.zeros(p.shape[:-1], dtype=bool), self.places[some]
        reach = first.radius * 1.0001
        near = np.asarray(cKDTree(places).query(p, distance_upper_bound=reach)[1])
        kinds: dict[int, Mark] = {id(self.marks[i]): self.marks[i] for i in some}
        which = np.array([id(self.marks[i]) for i in some] + [0])[near]
        for key, mark in kinds.items():
            at = which == key
            inside[at] = mark.inked(p[at] - places[near[at]])
        return np.asarray(inside)

    def ink(self) -> Ink:
        """Return what is printed; where marks are light, the ground with holes."""
        sectors = [
            np.column_stack([np.tile(place, (len(mark.sectors), 1)), mark.sectors])
            for mark, place in zip(self.marks, self.places, strict=True)
        ]
        ground = np.array([self.outline]) if self.light else np.zeros((0, 4))
        return Ink(np.zeros((0, 4)), np.zeros((0, 3)), np.concatenate(sectors), ground)

    def __str__(self) -> str:
        first = str(self.marks[0])
        return first if len(self.marks) == 1 else f"{len(self.marks)} marks, {first} ..."


def _concentric(kind: str, diameters: tuple[float, ...], *, first_black: bool = True) -> Mark:
    _check_growing(kind, diameters)
    r = np.array([0.0] * first_black + [d / 2 for d in diameters]).reshape(-1, 2)
    return Mark(_name(kind, diameters), np.column_stack([r, np.zeros(len(r)), np.full(len(r), FULL)]))


def _check_growing(kind: str, diameters: tuple[float, ...]) -> None:
    finite = all(math.isfinite(d) and d > 0 for d in diameters)
    if not (diameters and finite and all(a < b for a, b in pairwise(diameters))):
        raise BadValue(
            f"diameters of {kind}", list(diameters), "positive lengths in mm, each larger than the one before"
        )


def _name(kind: str, diameters: tuple[float, ...]) -> str:
    return ":".join([kind, *map(length_text, diameters)])


def _runs(on: Mask) -> list[tuple[int, int]]:
    """Return the runs (from, to) of a circle's ones; the last may go beyond its end."""
    n = len(on)
    first = int(np.argmin(on))  # a zero: no run crosses it
    turned = np.roll(on, -first)
    change = np.flatnonzero(np.diff(np.concatenate([[False], turned, [False]]).astype(np.int8)))
    return [(int(a) + first, int(b) + first) for a, b in change.reshape(-1, 2)] if n else []
