"""The ends of a distance that a drawing states, and the direction along which they are so far apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.cad.pmi.bores import bores_of
from cadcam.cad.pmi.faces import Curve, StepFace
from cadcam.cad.pmi.stated import Stated, StatedSize

_PARALLEL = 1e-6  # of unit vectors
_AS_STATED = 1e-4  # of a distance, by which the CAD's may differ from what its drawing says


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class End(Brief):
    """What a distance is from, or to: a hole or pin about `axis` (3,), or planes across `normal` (3,).

    at (3,) mm: a place on the axis, or midway between the planes; name: in words, with the diameter.
    """

    name: str
    at: Array
    curves: tuple[Curve, ...]
    axis: Array | None = None
    normal: Array | None = None

    @classmethod
    def of(cls, stated: Stated) -> End | None:
        """Return the end that a statement's faces, or edges, are; None for more than one, or other kinds."""
        bores = bores_of(stated)
        planes = [face for face in stated.faces if face.surface == "plane"]
        if len(bores) == 1 and not planes:
            bore = bores[0]
            return cls(bore.name, bore.centre, bore.rims, axis=bore.axis)
        if bores or not planes or len(planes) < len(stated.faces):
            return None
        normal = planes[0].direction
        if any(np.linalg.norm(np.cross(face.direction, normal)) > _PARALLEL for face in planes):
            return None
        curves = tuple(curve for face in planes for curve in face.curves[: face.outer])
        return cls("face", _middle(planes, normal), curves, normal=normal)


def ends_of(distance: StatedSize) -> tuple[tuple[End, End], Array | None] | None:
    """Return the two ends of a distance, and the direction (3,) along which they are as far apart as it says.

    No direction: from axis to axis. None: they are not so far apart in the CAD, or no such ends; or it is no distance.
    """
    if distance.other is None or distance.nominal_mm is None:
        return None
    one, other = End.of(distance), End.of(distance.other)
    if one is None or other is None:
        return None
    apart = one.at - other.at
    for way in _ways(one, other):
        # Straight from axis to axis is across them.
        across = apart if one.axis is None or way is not None else apart - (apart @ one.axis) * one.axis
        mm = float(np.linalg.norm(across)) if way is None else abs(float(apart @ way))
        if abs(mm - distance.nominal_mm) <= _AS_STATED * distance.nominal_mm:
            return (one, other), way
    return None


def _ways(one: End, other: End) -> Sequence[Array | None]:
    """Return the directions along which two ends may be apart; None: straight from axis to axis."""
    normals = [end.normal for end in (one, other) if end.normal is not None]
    axes = [end.axis for end in (one, other) if end.axis is not None]
    if normals:
        along = [n for n in normals[1:] if np.linalg.norm(np.cross(n, normals[0])) > _PARALLEL]
        across = [axis for axis in axes if abs(axis @ normals[0]) > _PARALLEL]
        return [] if along or across else [normals[0]]
    if np.linalg.norm(np.cross(axes[0], axes[1])) > _PARALLEL:
        return []
    return [None, *(way for way in np.eye(3) if abs(way @ axes[0]) < _PARALLEL)]


def _middle(planes: Sequence[StepFace], normal: Array) -> Array:
    """Return a place (3,) mm midway between the outermost of parallel planes."""
    off = [float(face.origin @ normal) for face in planes]
    at = planes[0].origin
    return np.asarray(at + ((min(off) + max(off)) / 2 - at @ normal) * normal)
