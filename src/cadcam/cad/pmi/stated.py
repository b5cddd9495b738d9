"""Tolerances as a STEP file states them: geometric ones, sizes, and the datums that they refer to."""

from __future__ import annotations

from dataclasses import dataclass

from cadcam.arrays import Brief
from cadcam.cad.pmi.faces import Curve, StepFace


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Stated(Brief):
    """A statement of the drawing about faces, or edges, of the part; name: the drawing's own, may be empty."""

    name: str
    faces: tuple[StepFace, ...]
    curves: tuple[Curve, ...]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StatedDatum(Stated):
    """A datum: its letter, and the features that establish it."""

    letter: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StatedTolerance(Stated):
    """A geometric tolerance (ISO 1101): "position", "surface profile", "flatness" ..., and the width of its zone in mm.

    diametral: whether the zone is a cylinder of that diameter; outside_mm: how much of an unequally disposed zone lies
    outside the material; modifiers: in words ("maximum material requirement"); datums: letters in the order of their
    precedence, "A-B" of a common one.
    """

    characteristic: str
    mm: float
    diametral: bool
    datums: tuple[str, ...]
    modifiers: tuple[str, ...] = ()
    outside_mm: float | None = None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StatedSize(Stated):
    """A size or a distance: "diameter", "thickness", "linear distance" ..., nominal and limits in mm.

    None where the file does not state them. fit: the tolerance class of ISO 286 (H7) where limits are stated so. other:
    what a distance is to; None of a size.
    """

    kind: str
    nominal_mm: float | None
    limits_mm: tuple[float, float] | None
    fit: str = ""
    other: Stated | None = None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Pmi(Brief):
    """All semantic PMI of a STEP file that is a tolerance; others: what else is toleranced, in words."""

    tolerances: tuple[StatedTolerance, ...] = ()
    sizes: tuple[StatedSize, ...] = ()
    datums: tuple[StatedDatum, ...] = ()
    others: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        """Return whether anything is toleranced."""
        return bool(self.tolerances or self.sizes or self.others)
