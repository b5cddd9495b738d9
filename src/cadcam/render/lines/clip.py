"""Segments clipped to what a camera can image, and the plane u = (x, y)/z in which straight edges stay straight.

The lens bends lines only from u to pixels; all visibility is decided before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.camera.camera import Camera

WIDEST = 200.0  # |u| beyond this is less than 0.3 deg from the focal plane
_BORDER_STEP = 8.0  # px between the border points that bound the picture in u


@dataclass(frozen=True, slots=True, eq=False)
class ViewVolume:
    """z >= near (mm), low <= u <= high and |u| < radius: a convex region that holds all the camera images."""

    near: float
    low: Array
    high: Array
    radius: float

    @classmethod
    def of(cls, camera: Camera, *, near: float, margin_px: float) -> ViewVolume:
        """Return the smallest one around the picture widened by `margin_px` on every side."""
        radius = camera.lens.valid_radius * (1 - 1e-9)
        u = _border_directions(camera, margin_px)
        limit = min(radius, WIDEST)
        if not np.isfinite(u).all():  # the border exceeds the lens' range: everything within that may be in the picture
            return cls(near, np.full(2, -limit), np.full(2, limit), radius)
        u = u[:, :2] / np.maximum(u[:, 2:], 1e-9)
        return cls(near, np.maximum(u.min(axis=0), -limit), np.minimum(u.max(axis=0), limit), radius)

    def clip(self, a: Array, b: Array) -> tuple[Array, Array, Mask]:
        """Return t0, t1 (N,) of the part a + t (b - a) inside, and whether there is one; a, b (N, 3) mm."""
        t0, t1 = np.zeros(len(a)), np.ones(len(a))
        for fa, fb in zip(self._inside(a), self._inside(b), strict=True):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = fa / (fa - fb)
            t0 = np.where(fa < 0, np.where(fb < 0, 2.0, np.maximum(t0, t)), t0)
            t1 = np.where((fb < 0) & (fa >= 0), np.minimum(t1, t), t1)
        if np.isfinite(self.radius):
            t0, t1 = _clip_to_cone(a, b - a, t0, t1, self.radius)
        return t0, t1, t0 < t1

    def holds(self, p: Array) -> bool:
        """Return whether all points p (N, 3) mm lie inside, so that no segment between them needs clipping."""
        if not all(bool((side >= 0).all()) for side in self._inside(p)):
            return False
        return not np.isfinite(self.radius) or bool((_beyond_cone(p, self.radius) < 0).all())

    def _inside(self, p: Array) -> list[Array]:
        """Signed, linear in p, and >= 0 on the inner side of each plane."""
        x, y, z = p[:, 0], p[:, 1], p[:, 2]
        sides = [x - self.low[0] * z, y - self.low[1] * z, self.high[0] * z - x, self.high[1] * z - y]
        return [z - self.near, *sides]


@lru_cache(maxsize=8)
def _border_directions(camera: Camera, margin: float) -> Array:
    """Return the directions (N, 3) of points around the picture, cached by camera."""
    x0, x1 = -0.5 - margin, camera.width - 0.5 + margin
    y0, y1 = -0.5 - margin, camera.height - 0.5 + margin
    x = np.linspace(x0, x1, int((x1 - x0) / _BORDER_STEP) + 2)
    y = np.linspace(y0, y1, int((y1 - y0) / _BORDER_STEP) + 2)
    sides = [np.stack(np.broadcast_arrays(*side), axis=-1) for side in ((x, y0), (x, y1), (x0, y), (x1, y))]
    return camera.unproject(np.concatenate(sides))


def _beyond_cone(p: Array, radius: float) -> Array:
    """Return x^2 + y^2 - (radius z)^2."""
    return np.asarray(p[:, 0] ** 2 + p[:, 1] ** 2 - (radius * p[:, 2]) ** 2)


def _clip_to_cone(a: Array, d: Array, t0: Array, t1: Array, radius: float) -> tuple[Array, Array]:
    """Narrow [t0, t1] to x^2 + y^2 < (radius z)^2; convex in front of the camera, so one stretch at most remains."""
    weight = np.array([1.0, 1.0, -radius * radius])
    A, B, C = (np.sum(p * q * weight, axis=1) for p, q in ((d, d), (a, d), (a, a)))
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(B * B - A * C, 0.0))
        larger = -(B + np.copysign(root, B))  # the quadratic without cancellation
        roots = np.sort(np.nan_to_num(np.stack([larger / A, C / larger]), nan=0.0, posinf=2.0, neginf=-1.0), axis=0)
    knots = np.stack([t0, np.clip(roots[0], t0, t1), np.clip(roots[1], t0, t1), t1])
    start, end = np.full_like(t0, 2.0), np.full_like(t1, -1.0)
    for k in range(3):
        middle = (knots[k] + knots[k + 1]) / 2
        inside = (A * middle * middle + 2 * B * middle + C < 0) & (knots[k] < knots[k + 1])
        start = np.where(inside, np.minimum(start, knots[k]), start)
        end = np.where(inside, np.maximum(end, knots[k + 1]), end)
    return start, end


@dataclass(frozen=True, slots=True, eq=False)
class FlatSegments:
    """Clipped segments in the plane u: end points `a`, `b` (N, 2), inverse depths `wa`, `wb` (N,) in 1/mm.

    Along a segment w = 1/z is linear in the fraction s of its image; `t0`, `t1` are the clipped ends on the unclipped
    segment in space.
    """

    a: Array
    b: Array
    wa: Array
    wb: Array
    t0: Array
    t1: Array

    @classmethod
    def whole(cls, p: Array, vertices: Ids) -> FlatSegments:
        """Return the images of segments between points `vertices` (N, 2) of p (V, 3), all of them inside."""
        u, w = p[:, :2] / p[:, 2:], 1 / p[:, 2]
        one, other = vertices[:, 0], vertices[:, 1]
        return cls(u[one], u[other], w[one], w[other], np.zeros(len(one)), np.ones(len(one)))

    @classmethod
    def of(cls, a: Array, b: Array, t0: Array, t1: Array) -> FlatSegments:
        """Return the images of a + t (b - a) for t in [t0, t1]; a, b (N, 3) in the camera frame."""
        p, q = a + t0[:, None] * (b - a), a + t1[:, None] * (b - a)
        return cls(p[:, :2] / p[:, 2:], q[:, :2] / q[:, 2:], 1 / p[:, 2], 1 / q[:, 2], t0, t1)

    def __len__(self) -> int:
        return len(self.t0)

    def select(self, which: Mask | np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> FlatSegments:
        """Return the chosen segments."""
        return FlatSegments(*(getattr(self, name)[which] for name in self.__slots__))

    def in_space(self, index: np.ndarray[tuple[int, ...], np.dtype[np.int64]], s: Array) -> Array:
        """Return t on the unclipped segment of the fraction s of the image of segment `index`."""
        wa, wb, t0, t1 = self.wa[index], self.wb[index], self.t0[index], self.t1[index]
        return np.asarray(t0 + (t1 - t0) * s * wb / (s * wb + (1 - s) * wa))

    def in_image(self, index: np.ndarray[tuple[int, ...], np.dtype[np.int64]], t: Array) -> Array:
        """Return the fraction s of the image of segment `index` at t on the unclipped segment in space."""
        wa, wb, t0, t1 = self.wa[index], self.wb[index], self.t0[index], self.t1[index]
        t = (t - t0) / (t1 - t0)
        return np.asarray(t * wa / (t * wa + (1 - t) * wb))
