"""Axially symmetric lenses: |m| is a function of the angle off the axis."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, Floats, in_parts
from cadcam.camera import radial
from cadcam.camera.lens.base import Lens


class AxialLens(Lens):
    """A lens whose image of a direction at angle t off the axis lies at |m| = rho(t) with the same azimuth.

    A subclass gives the curve with its slope, its derivatives by the coefficients and the largest angle it images.
    """

    @property
    @abstractmethod
    def max_angle(self) -> float:
        """Return the largest angle off the axis that is imaged, rad, at most pi/2."""

    @abstractmethod
    def _curve(self, t: Array) -> tuple[Array, Array]:
        """Return rho(t) and drho/dt."""

    @abstractmethod
    def _coefficient_slopes(self, t: Array) -> Array:
        """Return drho/dcoefficients (..., n)."""

    @property
    def valid_radius(self) -> float:
        """Return tan(max_angle)."""
        return float(np.tan(self.max_angle)) if self.max_angle < np.pi / 2 else np.inf

    def _angle(self, p: Array) -> tuple[Array, Array]:
        """Distance off the axis, and the angle, NaN outside the imaged range."""
        r = np.hypot(p[..., 0], p[..., 1])
        t = np.arctan2(r, p[..., 2])
        return r, np.where((p[..., 2] > 0) & (t < self.max_angle), t, np.nan)

    def project(self, p: Floats) -> Array:
        """Return m; NaN for z <= 0 or beyond the largest imaged angle."""
        p = np.asarray(p, dtype=np.float64)
        r, t = self._angle(p)
        with np.errstate(all="ignore"):
            g = self._curve(t)[0] / np.where(r > 0, r, 1.0)  # on the axis rho = 0, whatever the divisor
        return p[..., :2] * np.where(np.isnan(t), np.nan, g)[..., None]

    def project_with_jacobians(self, p: Floats, terms: Sequence[int] | None = None) -> tuple[Array, Array, Array]:
        """Return m, dm/dp, dm/dcoefficients; NaN as `project`."""
        p = np.asarray(p, dtype=np.float64)
        z = p[..., 2]
        r, t = self._angle(p)
        safe_r = np.where(r > 0, r, 1.0)
        e = np.where(r[..., None] > 0, p[..., :2] / safe_r[..., None], np.array([1.0, 0.0]))
        with np.errstate(all="ignore"):
            rho, slope = self._curve(t)
            across = np.where(r > 0, rho / safe_r, slope / z)  # |m| / r, the gain perpendicular to the radius
            d2 = r * r + z * z
            along, depth = slope * z / d2, -slope * r / d2
            slopes = self._coefficient_slopes(t)
            C = e[..., :, None] * (slopes if terms is None else slopes[..., list(terms)])[..., None, :]
        J = np.zeros((*p.shape[:-1], 2, 3))
        J[..., :2] = across[..., None, None] * np.eye(2) + (along - across)[..., None, None] * (
            e[..., :, None] * e[..., None, :]
        )
        J[..., 2] = e * depth[..., None]
        J[np.isnan(t)], C[np.isnan(t)] = np.nan, np.nan
        return p[..., :2] * np.where(np.isnan(t), np.nan, across)[..., None], J, C

    def unproject(self, m: Floats) -> Array:
        """Return unit directions; NaN beyond the largest imaged angle."""
        return in_parts(self._directions, np.asarray(m, dtype=np.float64))

    def _directions(self, m: Array) -> Array:
        rho = np.hypot(m[..., 0], m[..., 1])
        t = radial.inverse(self._curve, rho, self.max_angle)
        ring = np.where(rho > 0, np.sin(t) / np.where(rho > 0, rho, 1.0), 1.0)
        return np.concatenate([m * ring[..., None], np.cos(t)[..., None]], axis=-1)
