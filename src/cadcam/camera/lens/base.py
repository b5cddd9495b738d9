"""The protocol of lenses, and what those that act on the plane (x, y)/z have in common."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from cadcam.arrays import LARGEST, Array, Floats, Mask, in_parts
from cadcam.camera.perspective import by_point, direction, perspective, perspective_and_scale
from cadcam.errors import BadValue
from cadcam.kinds import expect_number, said


@dataclass(frozen=True)
class Lens(ABC):
    """The protocol and what all lenses share; the dataclass fields are the coefficients, in order."""

    name: ClassVar[str]
    start: ClassVar[Mapping[str, float]] = {}  # initial values where the derivative vanishes at zero

    def __post_init__(self) -> None:
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            if not isinstance(value, (float, int, np.floating, np.integer)):
                raise BadValue(f"lens coefficient {name}", said(value), "a number; a list of them is given as *list")
            expect_number(value, f"lens coefficient {name}")
            number = float(value)
            if not math.isfinite(number):
                raise BadValue(f"lens coefficient {name}", number, "a finite number")
            if abs(number) > LARGEST:  # products of several coefficients must not overflow
                raise BadValue(f"lens coefficient {name}", number, f"a number of at most {LARGEST:g} in size")
            object.__setattr__(self, name, number)

    @property
    def parameters(self) -> dict[str, float]:
        """Return the coefficients by name, in the order of the Jacobian's columns."""
        return {f.name: float(getattr(self, f.name)) for f in fields(self)}

    def __repr__(self) -> str:
        told = ", ".join(f"{name}={value:.6g}" for name, value in self.parameters.items() if value)
        return f"{type(self).__name__}({told})"

    @property
    @abstractmethod
    def valid_radius(self) -> float:
        """Return the largest tan(angle off the axis) that the lens images; inf where it has no limit below 90 deg."""

    @abstractmethod
    def project(self, p: Floats) -> Array:
        """Return m (..., 2) of points p (..., 3) in the camera frame; NaN for z <= 0 or outside the valid radius."""

    @abstractmethod
    def project_with_jacobians(self, p: Floats, terms: Sequence[int] | None = None) -> tuple[Array, Array, Array]:
        """Return m (..., 2), dm/dp (..., 2, 3) and dm/dcoefficients (..., 2, n).

        terms: which coefficients, in that order; None: all.
        """

    @abstractmethod
    def unproject(self, m: Floats) -> Array:
        """Return unit directions (..., 3) of m (..., 2); NaN where no direction within the valid radius has this m."""


class PlanarLens(Lens):
    """A lens whose distortion acts on the plane u = (x, y)/z; subclasses give it, its derivatives and its inverse."""

    @abstractmethod
    def _distort(self, u: Array) -> Array:
        """Return m of u, without any check of validity."""

    @abstractmethod
    def _linearised(self, u: Array, terms: Sequence[int]) -> tuple[Array, Array, Array]:
        """Return m, dm/du (..., 2, 2) and dm/dcoefficients (..., 2, n) by those of `terms`, without any check."""

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

    def project_with_jacobians(self, p: Floats, terms: Sequence[int] | None = None) -> tuple[Array, Array, Array]:
        """Return m, dm/dp, dm/dcoefficients; NaN as `project`."""
        u, over_z = perspective_and_scale(p)
        with np.errstate(all="ignore"):
            m, dm_du, dm_dc = self._linearised(u, range(len(self.parameters)) if terms is None else terms)
            dm_dp = by_point(dm_du, u, over_z)
        bad = ~self._inside(u)
        if bad.any():
            m[bad], dm_dp[bad], dm_dc[bad] = np.nan, np.nan, np.nan
        return m, dm_dp, dm_dc

    def unproject(self, m: Floats) -> Array:
        """Return unit directions; NaN where no direction within the valid radius has this m."""
        return in_parts(self._directions, np.asarray(m, dtype=np.float64))

    def _directions(self, m: Array) -> Array:
        with np.errstate(all="ignore"):
            u = self._undistort(m)
            return direction(np.where(self._inside(u)[..., None], u, np.nan))
