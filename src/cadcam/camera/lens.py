"""Lenses: how a direction in the camera frame becomes a point of the normalised image plane, and back.

A lens maps a point p = (x, y, z) of the camera frame to m = (mx, my), dimensionless; the camera matrix K then maps m
to pixels. m is in the *distorted* normalised plane: for the ideal lens m = (x, y)/z. Every lens gives NaN for z <= 0
and outside its valid radius, where its own curve turns back and one image point would have two directions.

All lenses pass the same conformance tests (tests/camera/test_lens.py); a new one is a new row there.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from functools import cached_property
from typing import ClassVar

import numpy as np

from cadcam.arrays import Array, Floats, Mask, component_major
from cadcam.camera import radial
from cadcam.camera.perspective import by_point, direction, perspective, perspective_and_scale
from cadcam.errors import BadValue


@dataclass(frozen=True)
class Lens(ABC):
    """The protocol and what all lenses share; the dataclass fields are the coefficients, in order."""

    name: ClassVar[str]

    def __post_init__(self) -> None:
        for name, value in self.parameters.items():
            if not np.isfinite(value):
                raise BadValue(f"lens coefficient {name}", value, "a finite number")

    @property
    def parameters(self) -> dict[str, float]:
        """Return the coefficients by name, in the order of the Jacobian's columns."""
        return {f.name: float(getattr(self, f.name)) for f in fields(self)}

    @property
    @abstractmethod
    def valid_radius(self) -> float:
        """Return the largest tan(angle off the axis) that the lens images; inf where it has no limit below 90 deg."""

    @abstractmethod
    def project(self, p: Floats) -> Array:
        """Return m (..., 2) of points p (..., 3) in the camera frame; NaN for z <= 0 or outside the valid radius."""

    @abstractmethod
    def project_with_jacobians(self, p: Floats) -> tuple[Array, Array, Array]:
        """Return m (..., 2), dm/dp (..., 2, 3) and dm/dcoefficients (..., 2, n)."""

    @abstractmethod
    def unproject(self, m: Floats) -> Array:
        """Return unit directions (..., 3) of m (..., 2); NaN where no direction within the valid radius has this m."""


@dataclass(frozen=True)
class Ideal(Lens):
    """The pinhole without distortion: m = (x, y)/z."""

    name: ClassVar[str] = "ideal"

    @property
    def valid_radius(self) -> float:
        """Return inf: every point in front is imaged."""
        return np.inf

    def project(self, p: Floats) -> Array:
        """Return (x, y)/z; NaN for z <= 0."""
        return perspective(p)

    def project_with_jacobians(self, p: Floats) -> tuple[Array, Array, Array]:
        """Return m, dm/dp and an empty coefficient Jacobian."""
        u, over_z = perspective_and_scale(p)
        identity = component_major(u.shape[:-1], 2, 2)
        identity[..., 0, 0] = identity[..., 1, 1] = 1.0
        return u, by_point(identity, u, over_z), np.zeros((*u.shape, 0))

    def unproject(self, m: Floats) -> Array:
        """Return the unit direction of (mx, my, 1)."""
        return direction(np.asarray(m, dtype=np.float64))


class PlanarLens(Lens):
    """A lens whose distortion acts on the plane u = (x, y)/z; subclasses give `_distort` and the radial curve."""

    @abstractmethod
    def _distort(self, u: Array) -> Array:
        """Return m of u, without any check of validity."""

    @abstractmethod
    def _plane_jacobian(self, u: Array) -> Array:
        """Return dm/du (..., 2, 2), without any check of validity."""

    @abstractmethod
    def _coefficient_jacobian(self, u: Array) -> Array:
        """Return dm/dcoefficients (..., 2, n), without any check of validity."""

    @abstractmethod
    def _undistort(self, m: Array) -> Array:
        """Return u of m, NaN where there is none."""

    def _inside(self, u: Array) -> Mask:
        return np.asarray(u[..., 0] ** 2 + u[..., 1] ** 2 < self.valid_radius**2)

    def project(self, p: Floats) -> Array:
        """Return m; NaN for z <= 0 or outside the valid radius."""
        u = perspective(p)
        inside = self._inside(u)
        with np.errstate(all="ignore"):
            return np.where(inside[..., None], self._distort(u), np.nan)

    def project_with_jacobians(self, p: Floats) -> tuple[Array, Array, Array]:
        """Return m, dm/dp, dm/dcoefficients; NaN as `project`."""
        u, over_z = perspective_and_scale(p)
        with np.errstate(all="ignore"):
            m, dm_dc = self._distort(u), self._coefficient_jacobian(u)
            dm_dp = by_point(self._plane_jacobian(u), u, over_z)
        bad = ~self._inside(u)
        if bad.any():
            m[bad], dm_dp[bad], dm_dc[bad] = np.nan, np.nan, np.nan
        return m, dm_dp, dm_dc

    def unproject(self, m: Floats) -> Array:
        """Return unit directions; NaN where no direction within the valid radius has this m."""
        with np.errstate(all="ignore"):
            u = self._undistort(np.asarray(m, dtype=np.float64))
            u = np.where(self._inside(u)[..., None], u, np.nan)
        return direction(u)


@dataclass(frozen=True)
class BrownConrady(PlanarLens):
    """Radial, tangential, rational and thin-prism distortion in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4.

    With r2 = ux^2 + uy^2 and g = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3):
    mx = ux g + 2 p1 ux uy + p2 (r2 + 2 ux^2) + s1 r2 + s2 r2^2,
    my = uy g + p1 (r2 + 2 uy^2) + 2 p2 ux uy + s3 r2 + s4 r2^2.
    Sources: Brown, "Close-range camera calibration" (1971); the coefficient order is that of OpenCV's calib3d.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0

    name: ClassVar[str] = "brown-conrady"

    @classmethod
    def from_opencv(cls, coefficients: Floats) -> BrownConrady:
        """Return the lens of OpenCV's distortion vector of 4, 5, 8 or 12 numbers (14 when its tilt is zero)."""
        c = np.asarray(coefficients, dtype=np.float64).ravel()
        if c.size == 14 and not c[12:].any():
            c = c[:12]
        if c.size not in (0, 4, 5, 8, 12):
            raise BadValue("number of distortion coefficients", c.size, "0, 4, 5, 8 or 12 (14 with zero tilt)")
        return cls(*(float(x) for x in c))

    @cached_property
    def _radial_limit(self) -> float:
        return radial.rational_limit((self.k1, self.k2, self.k3), (self.k4, self.k5, self.k6))

    @property
    def _prisms(self) -> bool:
        return any((self.s1, self.s2, self.s3, self.s4))

    def _inside(self, u: Array) -> Mask:
        r2 = u[..., 0] ** 2 + u[..., 1] ** 2
        if self._upright_to(float(np.sqrt(np.fmax.reduce(r2, axis=None, initial=0.0)))):
            return ~np.isnan(r2)
        return np.asarray(r2 < self.valid_radius**2)

    def _upright_to(self, radius: float) -> bool:
        """Return whether the mapping surely does not fold up to a radius: a quick bound, often enough.

        dm/du is symmetric, with eigenvalues g and g + 2 r^2 g', plus what decentring and prisms add: in norm at most
        6 r |(p1, p2)| + 2 r |(s1 + 2 s2 r^2, s3 + 2 s4 r^2)|. While the former outweigh the latter it keeps its sense.
        """
        if self.k4 or self.k5 or self.k6 or not radius < np.inf:
            return False
        r2 = radius * radius
        least = 1 + r2 * (3 * min(self.k1, 0) + r2 * (5 * min(self.k2, 0) + r2 * 7 * min(self.k3, 0)))
        prism = np.hypot(abs(self.s1) + 2 * abs(self.s2) * r2, abs(self.s3) + 2 * abs(self.s4) * r2)
        return bool(least > radius * (6 * np.hypot(self.p1, self.p2) + 2 * prism))

    @cached_property
    def valid_radius(self) -> float:
        """Return where the mapping first folds: the Jacobian's determinant vanishes in some direction."""
        return radial.fold_limit(self._plane_jacobian, self._radial_limit) if self._decentred else self._radial_limit

    @property
    def _decentred(self) -> bool:
        return any((self.p1, self.p2, self.s1, self.s2, self.s3, self.s4))

    def _gain(self, r2: Array) -> tuple[Array, Array, Array]:
        """Numerator, denominator of g, and dg/dr2."""
        n = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        d = 1 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6))
        dn = self.k1 + r2 * (2 * self.k2 + r2 * 3 * self.k3)
        dd = self.k4 + r2 * (2 * self.k5 + r2 * 3 * self.k6)
        return n, d, (dn * d - n * dd) / (d * d)

    def _distort(self, u: Array) -> Array:
        x, y = u[..., 0], u[..., 1]
        r2 = x * x + y * y
        n, d, _ = self._gain(r2)
        g = n / d
        mx = x * g + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x) + r2 * (self.s1 + self.s2 * r2)
        my = y * g + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y + r2 * (self.s3 + self.s4 * r2)
        m = component_major(u.shape[:-1], 2)
        m[..., 0], m[..., 1] = mx, my
        return m

    def _plane_jacobian(self, u: Array) -> Array:
        x, y = u[..., 0], u[..., 1]
        r2 = x * x + y * y
        n, d, dg = self._gain(r2)
        g = n / d
        J = component_major(u.shape[:-1], 2, 2)
        J[..., 0, 0] = g + 2 * x * x * dg + 2 * self.p1 * y + 6 * self.p2 * x
        J[..., 0, 1] = 2 * x * y * dg + 2 * self.p1 * x + 2 * self.p2 * y
        J[..., 1, 0] = J[..., 0, 1]
        J[..., 1, 1] = g + 2 * y * y * dg + 6 * self.p1 * y + 2 * self.p2 * x
        if self._prisms:
            prism_x, prism_y = self.s1 + 2 * self.s2 * r2, self.s3 + 2 * self.s4 * r2
            J[..., 0, :] += 2 * u * prism_x[..., None]
            J[..., 1, :] += 2 * u * prism_y[..., None]
        return J

    def _coefficient_jacobian(self, u: Array) -> Array:
        x, y = u[..., 0], u[..., 1]
        r2 = x * x + y * y
        n, d, _ = self._gain(r2)
        out = component_major(u.shape[:-1], 12, 2)
        out = np.swapaxes(out, -1, -2)
        power, falling = r2 / d, -n / d
        for over, under in ((0, 5), (1, 6), (4, 7)):  # k1 k4, k2 k5, k3 k6
            out[..., over] = u * power[..., None]
            out[..., under] = out[..., over] * falling[..., None]
            power = power * r2
        out[..., 0, 2], out[..., 1, 2] = 2 * x * y, r2 + 2 * y * y
        out[..., 0, 3], out[..., 1, 3] = r2 + 2 * x * x, 2 * x * y
        out[..., 0, 8], out[..., 0, 9] = r2, r2 * r2
        out[..., 1, 10], out[..., 1, 11] = r2, r2 * r2
        return out

    def _undistort(self, m: Array) -> Array:
        """Return u through the inverse radial curve; where there is more than that, Newton in the plane from there."""
        rho = np.hypot(m[..., 0], m[..., 1])

        def curve(r: Array) -> tuple[Array, Array]:
            n, d, dg = self._gain(r * r)
            return r * n / d, n / d + 2 * r * r * dg

        r = radial.inverse(curve, rho, self._radial_limit, clamp=self._decentred)
        u = m * np.where(rho > 0, r / np.where(rho > 0, rho, 1.0), 1.0)[..., None]
        return radial.newton_plane(self._distort, self._plane_jacobian, m, u) if self._decentred else u


@dataclass(frozen=True)
class OddRadial(PlanarLens):
    """The thesis' EQ 2.5: a direction at radius r is imaged at r + dr, dr = a1 r + a3 r^3 + a5 r^5 + a7 r^7.

    r is measured from the principal point in units of the focal length, so the coefficients are dimensionless. For
    coefficients A_k on radii in pixels, a_k = A_k f^(k-1) with f the focal length in pixels. a1 cannot be told from the
    focal length; the thesis absorbs it there, and so does calibration unless it is given.
    """

    a1: float = 0.0
    a3: float = 0.0
    a5: float = 0.0
    a7: float = 0.0

    name: ClassVar[str] = "odd-radial"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.a1 <= -1:
            raise BadValue("lens coefficient a1", self.a1, "more than -1, or the axis itself is folded")

    @cached_property
    def valid_radius(self) -> float:
        """Return where dm/dr first vanishes."""
        return radial.polynomial_limit((1 + self.a1, self.a3, self.a5, self.a7))

    def _gain(self, r2: Array) -> tuple[Array, Array]:
        g = 1 + self.a1 + r2 * (self.a3 + r2 * (self.a5 + r2 * self.a7))
        return g, self.a3 + r2 * (2 * self.a5 + r2 * 3 * self.a7)

    def _distort(self, u: Array) -> Array:
        return u * self._gain(np.sum(u * u, axis=-1))[0][..., None]

    def _plane_jacobian(self, u: Array) -> Array:
        return radial.radial_jacobian(u, *self._gain(np.sum(u * u, axis=-1)))

    def _coefficient_jacobian(self, u: Array) -> Array:
        r2 = np.sum(u * u, axis=-1, keepdims=True)
        return np.stack([u * r2**k for k in range(4)], axis=-1)

    def _undistort(self, m: Array) -> Array:
        rho = np.hypot(m[..., 0], m[..., 1])

        def curve(r: Array) -> tuple[Array, Array]:
            g, dg = self._gain(r * r)
            return r * g, g + 2 * r * r * dg

        r = radial.inverse(curve, rho, self.valid_radius)
        return m * np.where(rho > 0, r / np.where(rho > 0, rho, 1.0), 1 / (1 + self.a1))[..., None]


@dataclass(frozen=True)
class Division(PlanarLens):
    """One-parameter division: the ideal point is u = m / (1 + k |m|^2). Source: Fitzgibbon (CVPR 2001), EQ 8."""

    k: float = 0.0

    name: ClassVar[str] = "division"

    @property
    def valid_radius(self) -> float:
        """Return 1/(2 sqrt k) for k > 0, where the curve turns; inf otherwise."""
        return 0.5 / np.sqrt(self.k) if self.k > 0 else np.inf

    def _root(self, u: Array) -> Array:
        return np.asarray(np.sqrt(1 - 4 * self.k * np.sum(u * u, axis=-1)))

    def _distort(self, u: Array) -> Array:
        return u * (2 / (1 + self._root(u)))[..., None]

    def _gain(self, u: Array) -> tuple[Array, Array, Array]:
        """|u|^2, the gain g = 2/(1 + s) with s = sqrt(1 - 4 k |u|^2), and dg/d(k |u|^2) = g^2/s."""
        s, r2 = self._root(u), np.sum(u * u, axis=-1)
        g = 2 / (1 + s)
        return r2, g, g * g / s

    def _plane_jacobian(self, u: Array) -> Array:
        _, g, slope = self._gain(u)
        return radial.radial_jacobian(u, g, slope * self.k)

    def _coefficient_jacobian(self, u: Array) -> Array:
        r2, _, slope = self._gain(u)
        return np.asarray((u * (slope * r2)[..., None])[..., None])

    def _undistort(self, m: Array) -> Array:
        d = 1 + self.k * np.sum(m * m, axis=-1)
        first_branch = self.k * np.sum(m * m, axis=-1) < 1  # beyond it the curve has turned back
        return m / np.where((d > 0) & first_branch, d, np.nan)[..., None]


@dataclass(frozen=True)
class Fisheye(Lens):
    """Kannala-Brandt: |m| = t + k1 t^3 + k2 t^5 + k3 t^7 + k4 t^9 for the angle t off the axis (below 90 deg).

    Source: Kannala and Brandt, "A generic camera model" (2006), EQ 6, with the leading coefficient in the focal length.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    name: ClassVar[str] = "fisheye"

    @cached_property
    def max_angle(self) -> float:
        """Return the largest angle off the axis that is imaged, rad, at most pi/2."""
        return min(radial.polynomial_limit((1.0, self.k1, self.k2, self.k3, self.k4)), np.pi / 2)

    @property
    def valid_radius(self) -> float:
        """Return tan(max_angle)."""
        return float(np.tan(self.max_angle)) if self.max_angle < np.pi / 2 else np.inf

    def _curve(self, t: Array) -> tuple[Array, Array]:
        t2 = t * t
        value = t * (1 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4))))
        slope = 1 + t2 * (3 * self.k1 + t2 * (5 * self.k2 + t2 * (7 * self.k3 + t2 * 9 * self.k4)))
        return value, slope

    def _angle(self, p: Array) -> tuple[Array, Array]:
        """Distance off the axis and angle, the angle NaN where nothing is imaged."""
        r = np.hypot(p[..., 0], p[..., 1])
        t = np.arctan2(r, p[..., 2])
        return r, np.where((p[..., 2] > 0) & (t < self.max_angle), t, np.nan)

    def project(self, p: Floats) -> Array:
        """Return m; NaN for z <= 0 or beyond the largest imaged angle."""
        p = np.asarray(p, dtype=np.float64)
        r, t = self._angle(p)
        on_axis = r == 0
        with np.errstate(all="ignore"):
            g = np.where(on_axis, 1 / p[..., 2], self._curve(t)[0] / np.where(on_axis, 1.0, r))
        return p[..., :2] * np.where(np.isnan(t), np.nan, g)[..., None]

    def project_with_jacobians(self, p: Floats) -> tuple[Array, Array, Array]:
        """Return m, dm/dp, dm/dcoefficients; NaN as `project`."""
        p = np.asarray(p, dtype=np.float64)
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        r, t = self._angle(p)
        safe_r = np.where(r > 0, r, 1.0)
        e = np.where(r[..., None] > 0, p[..., :2] / safe_r[..., None], np.array([1.0, 0.0]))
        with np.errstate(all="ignore"):
            rho, slope = self._curve(t)
            across = np.where(r > 0, rho / safe_r, 1 / z)  # |m| / r, the gain across the radius
            d2 = r * r + z * z
            along, depth = slope * z / d2, -slope * r / d2
        J = np.zeros((*p.shape[:-1], 2, 3))
        J[..., :2] = across[..., None, None] * np.eye(2) + (along - across)[..., None, None] * (
            e[..., :, None] * e[..., None, :]
        )
        J[..., 2] = e * depth[..., None]
        C = np.stack([e * (t ** (2 * k + 1))[..., None] for k in range(1, 5)], axis=-1)
        J[np.isnan(t)] = np.nan
        return np.stack([x, y], axis=-1) * np.where(np.isnan(t), np.nan, across)[..., None], J, C

    def unproject(self, m: Floats) -> Array:
        """Return unit directions; NaN beyond the largest imaged angle."""
        m = np.asarray(m, dtype=np.float64)
        rho = np.hypot(m[..., 0], m[..., 1])
        t = radial.inverse(self._curve, rho, self.max_angle)
        ring = np.where(rho > 0, np.sin(t) / np.where(rho > 0, rho, 1.0), 1.0)
        return np.concatenate([m * ring[..., None], np.cos(t)[..., None]], axis=-1)


LENSES: dict[str, type[Lens]] = {lens.name: lens for lens in (Ideal, BrownConrady, OddRadial, Division, Fisheye)}
