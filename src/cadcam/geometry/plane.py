"""Planes in space: distances, feet, and intersections with rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.coordinates import coordinates
from cadcam.geometry.ray import Ray
from cadcam.geometry.rotation import hat
from cadcam.kinds import expect

_COLLINEAR = 1e-9  # width over length below which points determine no plane
_GRAZING = 1e-12  # sine of the angle between ray and plane below which they count as parallel


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plane(Brief):
    """The points p with normal . p = offset: unit normals (..., 3), offsets (...) in mm along them."""

    normal: Array
    offset: Array

    def __post_init__(self) -> None:
        normal = frozen(self.normal, "plane normal", (3,), batched=True)
        offset = frozen(self.offset, "plane offset", (), batched=True)
        length = np.linalg.norm(normal, axis=-1)
        if not np.all(length > 0):
            raise BadValue("plane normal", "zero", "a vector of any length above 0")
        object.__setattr__(self, "normal", frozen(normal / length[..., None], "plane normal", (3,), batched=True))
        object.__setattr__(self, "offset", frozen(offset / length, "plane offset", (), batched=True))

    @classmethod
    def through(cls, point: Floats, normal: Floats) -> Plane:
        """Return the plane through a point (..., 3) mm, perpendicular to a normal (..., 3) of any length."""
        normal = frozen(normal, "plane normal", (3,), batched=True)
        return cls(normal, np.sum(normal * coordinates(point, "point of the plane", 3), axis=-1))

    @classmethod
    def from_points(cls, points: Floats) -> Plane:
        """Return the plane nearest to points (N, 3) mm by least squares of their distances.

        The normal's largest coordinate is positive. Raises `DegenerateGeometry` for fewer than three points or points
        on a line.
        """
        p = frozen(points, "points of a plane", (None, 3))
        centre = p.mean(axis=0) if len(p) else np.zeros(3)
        _, s, Vt = np.linalg.svd(p - centre, full_matrices=True)
        if len(p) < 3 or s[1] <= _COLLINEAR * s[0]:
            raise DegenerateGeometry(f"{len(p)} points on a line or at one place give no plane; add a point beside it")
        normal = Vt[2] * np.sign(Vt[2, np.argmax(np.abs(Vt[2]))])
        return cls.through(centre, normal)

    def distance(self, p: Floats) -> Array:
        """Return the distances (...) mm of points (..., 3), positive on the normal's side."""
        return np.asarray(np.sum(coordinates(p, "points", 3) * self.normal, axis=-1) - self.offset)

    def foot(self, p: Floats) -> Array:
        """Return the points (..., 3) of the planes nearest to p (..., 3), mm."""
        p = coordinates(p, "points", 3)
        return np.asarray(p - self.distance(p)[..., None] * self.normal)

    def meet(self, rays: Ray) -> Array:
        """Return the intersections (..., 3) mm of rays in space with planes; NaN where parallel or behind the rays."""
        expect(rays, "rays", Ray)
        towards = np.sum(rays.direction * self.normal, axis=-1)
        with np.errstate(all="ignore"):
            t = -self.distance(rays.origin) / np.where(np.abs(towards) > _GRAZING, towards, np.nan)
        return rays.at(np.where(t >= 0, t, np.nan))

    @property
    def single(self) -> bool:
        """Return whether it is one plane, and no batch."""
        return self.normal.ndim == 1 and self.offset.ndim == 0

    @property
    def basis(self) -> Array:
        """Return two unit vectors (..., 3, 2) that span the plane."""
        return np.stack(axes_across(self.normal), axis=-1)


def axes_across(normal: Array) -> tuple[Array, Array]:
    """Return two unit vectors (..., 3) perpendicular to unit normals (..., 3) and each other; 0 for a zero normal."""
    crossed = hat(normal)
    axis = np.eye(3)[np.abs(normal).argmin(axis=-1)]
    first = crossed @ axis[..., None]
    first = first / np.maximum(np.sqrt((first**2).sum(axis=-2, keepdims=True)), np.finfo(float).tiny)
    return first[..., 0], (crossed @ first)[..., 0]
