"""Holes and pins: the cylinders, or rims, that a drawing tolerances together, one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, significant
from cadcam.cad.pmi.faces import Curve, StepFace
from cadcam.cad.pmi.stated import Stated

_ALIKE = 1e-6  # of directions, and of lengths relative to the radius


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bore(Brief):
    """A hole, or a pin: its axis through `centre` (3,) mm, radius in mm, and the circles (arcs) that are its rims.

    kind: "hole", "pin", or "rim" of which the file does not say what it is the rim of.
    """

    centre: Array
    axis: Array
    radius: float
    kind: str
    rims: tuple[Curve, ...]
    curves: frozenset[int] = frozenset()  # by number, of its faces: two cylinders that share one are one bore

    @property
    def name(self) -> str:
        """Return what it is, with its diameter."""
        return f"{self.kind} {length_words(2 * self.radius)} mm"

    def alike(self, other: Bore) -> bool:
        """Return whether another one is the same, or a piece of it: half a cylinder, say."""
        if abs(self.radius - other.radius) > _ALIKE * self.radius or not self.coaxial(other.centre, other.axis):
            return False
        return not self.curves.isdisjoint(other.curves)

    def coaxial(self, centre: Array, axis: Array) -> bool:
        """Return whether an axis is its own."""
        across = np.cross(centre - self.centre, self.axis)
        near = float(np.linalg.norm(across)) <= 1e3 * _ALIKE * self.radius
        return near and float(np.linalg.norm(np.cross(axis, self.axis))) <= _ALIKE

    def joined(self, other: Bore) -> Bore:
        """Return both as one."""
        rims = {rim.number: rim for rim in (*self.rims, *other.rims)}
        return Bore(self.centre, self.axis, self.radius, self.kind, tuple(rims.values()), self.curves | other.curves)


def bores_of(stated: Stated) -> list[Bore]:
    """Return the holes and pins that a statement is about, the pieces of each as one; none if it is about others."""
    out: list[Bore] = []
    for piece in _pieces(stated):
        same = [bore for bore in out if bore.alike(piece)]
        out = [bore for bore in out if bore not in same]
        for bore in same:
            piece = bore.joined(piece)
        out.append(piece)
    return out


def length_words(mm: float) -> str:
    """Return a length without the digits that a conversion of units leaves."""
    return significant(round(mm, 6) + 0.0, 6)


def _pieces(stated: Stated) -> Iterator[Bore]:
    for face in stated.faces:
        if face.surface == "cylinder":
            yield _of_face(face)
    for curve in stated.curves:
        if np.isfinite(curve.radius):
            yield Bore(curve.centre, curve.axis, curve.radius, "rim", (curve,), frozenset({_place(curve)}))


def _of_face(face: StepFace) -> Bore:
    kind = "hole" if face.hole else "pin"
    whole = Bore(face.origin, face.direction, face.radius, kind, ())
    rims = tuple(c for c in face.curves if np.isfinite(c.radius) and whole.coaxial(c.centre, c.axis))
    middle = np.mean([rim.centre for rim in rims], axis=0) if rims else face.origin
    return Bore(middle, face.direction, face.radius, kind, rims, frozenset(c.number for c in face.curves))


def _place(curve: Curve) -> int:
    """Return a number that arcs of one circle share."""
    return hash(tuple(np.round(curve.centre / curve.radius, 4).tolist()))
