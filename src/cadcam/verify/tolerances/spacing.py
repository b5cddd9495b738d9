"""How far two features of the CAD are apart, and along which way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.errors import BadValue
from cadcam.geometry.plane import axes_across
from cadcam.verify.tolerances.circles import Circles

_ALONG = np.sin(np.radians(0.5))  # of a way to the plane across an axis: it lies in it
_FLAT = 1e-6  # of a feature's distance to the other: extent along the way that is rounding
_ONE_AXIS = 1e-3  # of the radii: distance of axes that are one


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Spacing(Brief):
    """The unit vector `way` (3,) from the second feature to the first, and their distance along it, mm.

    mm: nan where one extends along the way and is no circle across it: then the CAD has no single distance. bases: for
    each the directions (3, m) in which it may be displaced: across its axis, or along the way alone. across (3,): unit
    vector across way and axes, in which a displacement turns the straight line from axis to axis; None where the
    distance counts along the way alone.
    """

    way: Array
    mm: float
    bases: tuple[Array, Array]
    across: Array | None = None

    @classmethod
    def between(cls, first: Sequence[Array], second: Sequence[Array], direction: Array | None) -> Spacing:
        """Return the spacing of two features, each given by the polylines (n, 3) mm of its edges.

        direction (3,): unit vector, of either sign, along which the distance counts; None: straight from axis to axis
        of circles about parallel axes. Raises `BadValue` where the features have no such distance.
        """
        circles = Circles.through(first), Circles.through(second)
        way = _across_axes(*circles) if direction is None else direction
        ends = [_places(lines, of, way) for lines, of in zip((first, second), circles, strict=True)]
        if all(len(end) for end in ends):
            gap = float(ends[0].mean() - ends[1].mean())
            way = way * (-1.0 if gap < 0 else 1.0)
            told = all(np.ptp(end) <= _FLAT * abs(gap) for end in ends)
            mm = abs(gap) if told else float("nan")
        else:
            mm = float("nan")
        one, other = (_basis(of, way) for of in circles)
        axis = None if direction is not None or circles[0] is None else circles[0].axis
        return cls(way, mm, (one, other), None if axis is None else np.cross(axis, way))


def _across_axes(first: Circles | None, second: Circles | None) -> Array:
    """Return the unit vector (3,) between the axes of circles."""
    if first is None or second is None or abs(first.axis @ second.axis) < np.sqrt(1 - _ALONG**2):
        without = "the direction along which it counts; without one, both have to be circles about parallel axes"
        raise BadValue("direction of a distance", "not given", without)
    apart = first.centre - second.centre
    across = apart - (apart @ second.axis) * second.axis
    mm = float(np.linalg.norm(across))
    if mm <= _ONE_AXIS * max(first.radii[-1], second.radii[-1]):
        raise BadValue("distance", "between circles about one axis", "two axes, or a direction")
    return np.asarray(across / mm)


def _places(lines: Sequence[Array], circles: Circles | None, way: Array) -> Array:
    """Return where (n,) mm along the way a feature is: its axis, if it has one across the way, else its edges."""
    if circles is not None and abs(circles.axis @ way) < _ALONG:
        return np.array([circles.centre @ way])
    return np.concatenate([line @ way for line in lines]) if lines else np.zeros(0)


def _basis(circles: Circles | None, way: Array) -> Array:
    if circles is not None and abs(circles.axis @ way) < _ALONG:
        return np.stack(axes_across(circles.axis), axis=1)
    return way[:, None]
