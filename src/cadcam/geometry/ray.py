"""Rays and their closest points: of two rays, or of many to one point.

Everything here works in the plane (d = 2) and in space (d = 3) alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.errors import BadValue
from cadcam.geometry.coordinates import coordinates
from cadcam.kinds import expect


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Ray(Brief):
    """Half-lines origin + t direction, t >= 0: origins (..., d) in mm, unit directions (..., d); d is 2 or 3.

    Directions of any length are normalised, so that t is a distance in mm.
    """

    origin: Array
    direction: Array

    def __post_init__(self) -> None:
        origin = frozen(self.origin, "ray origin", (None,), batched=True)
        direction = frozen(self.direction, "ray direction", (None,), batched=True)
        if origin.shape[-1] not in (2, 3) or origin.shape[-1] != direction.shape[-1]:
            raise BadValue("ray", f"of {origin.shape[-1]} and {direction.shape[-1]} coordinates", "2 or 3 for both")
        length = np.linalg.norm(direction, axis=-1, keepdims=True)
        if not np.all(length > 0):
            raise BadValue("ray direction", "zero", "a vector of any length above 0")
        origin, unit = np.broadcast_arrays(origin, direction / length)
        object.__setattr__(self, "origin", frozen(origin, "ray origin", (None,), batched=True))
        object.__setattr__(self, "direction", frozen(unit, "ray direction", (None,), batched=True))

    def at(self, t: Floats) -> Array:
        """Return the points (..., d) at distances t (...) mm from the origins (EQ 2.163)."""
        return self.origin + np.asarray(t, dtype=np.float64)[..., None] * self.direction

    def along(self, p: Floats) -> Array:
        """Return the distance (...) mm along the rays of the feet of points p (..., d); negative behind the origin."""
        return np.asarray(np.sum((self._points(p) - self.origin) * self.direction, axis=-1))

    def foot(self, p: Floats) -> Array:
        """Return the points (..., d) of the rays' whole lines that are nearest to p (..., d), mm."""
        return self.at(self.along(p))

    def distance(self, p: Floats) -> Array:
        """Return the distances (...) mm of the points p (..., d) from the rays' whole lines."""
        return np.asarray(np.linalg.norm(self._points(p) - self.foot(p), axis=-1))

    def _points(self, p: Floats) -> Array:
        return coordinates(p, "points", self.origin.shape[-1])

    def approach(self, other: Ray) -> Approach:
        """Return the closest points of these rays and the others; NaN where they are parallel.

        For n = V1 x V2 the feet lie at t1 = ((F2-F1) x V2).n/|n|^2 and t2 = ((F2-F1) x V1).n/|n|^2 (EQ 2.164 with its
        signs and indices corrected); here the same is computed from the component of one direction perpendicular to the
        other, so that nearly parallel rays lose no digits.
        """
        expect(other, "other", Ray)
        t = np.stack([_along_to(self, other), _along_to(other, self)], axis=-1)
        feet = np.stack(np.broadcast_arrays(self.at(t[..., 0]), other.at(t[..., 1])), axis=-2)
        return Approach(t, feet, _angle(self.direction, other.direction))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Approach(Brief):
    """Closest points of two rays: along (..., 2) mm on each, feet (..., 2, d) on each, the angle (...) rad between."""

    along: Array
    feet: Array
    angle: Array

    @property
    def point(self) -> Array:
        """Return the middle (..., d) of the shortest connection, mm (EQ 2.165)."""
        return np.asarray(self.feet.mean(axis=-2))

    @property
    def gap(self) -> Array:
        """Return the length (...) of the shortest connection, mm."""
        return np.asarray(np.linalg.norm(self.feet[..., 1, :] - self.feet[..., 0, :], axis=-1))


def nearest_to_all(rays: Ray) -> Array:
    """Return the points (..., d) nearest to V rays each, the last batch axis of `rays` (..., V, d), in mm.

    Least squares of the distances from the whole lines; NaN where all rays are parallel. For two rays it is the middle
    of their shortest connection.
    """
    v = rays.direction
    across = np.eye(v.shape[-1]) - v[..., :, None] * v[..., None, :]
    middle = rays.origin.mean(axis=-2, keepdims=True)
    right = np.einsum("...ij,...j->...i", across, rays.origin - middle)
    shape = (*v.shape[:-2], v.shape[-2] * v.shape[-1])
    Q, R = np.linalg.qr(across.reshape(*shape, v.shape[-1]))
    with np.errstate(all="ignore"):
        blind = np.abs(np.diagonal(R, axis1=-2, axis2=-1)).min(axis=-1) <= 1e-14
        R = np.where(blind[..., None, None], np.nan, R)
        step = _solved(R, np.einsum("...ij,...i->...j", Q, right.reshape(shape)))
    return np.asarray(middle[..., 0, :] + step)


def _along_to(ray: Ray, other: Ray) -> Array:
    """Return t of `ray` at its closest point to `other`."""
    v, w = ray.direction, other.direction
    across = v - np.sum(v * w, axis=-1, keepdims=True) * w
    size = np.sum(across * across, axis=-1)
    with np.errstate(all="ignore"):
        t = np.sum((other.origin - ray.origin) * across, axis=-1) / np.where(size > 1e-30, size, np.nan)
    return np.asarray(t)


def _angle(v: Array, w: Array) -> Array:
    """Return the angle (...) rad between unit vectors, exact near 0 and near pi (Kahan's half-angle form)."""
    return np.asarray(2 * np.arctan2(np.linalg.norm(v - w, axis=-1), np.linalg.norm(v + w, axis=-1)))


def _solved(R: Array, b: Array) -> Array:
    """Return R^-1 b for upper triangular (..., n, n); NaN propagates."""
    n = R.shape[-1]
    x = np.zeros_like(b)
    for i in reversed(range(n)):
        x[..., i] = (b[..., i] - np.sum(R[..., i, i + 1 :] * x[..., i + 1 :], axis=-1)) / R[..., i, i]
    return x
