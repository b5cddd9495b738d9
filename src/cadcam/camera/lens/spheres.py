"""Lenses that first project onto a sphere or ellipsoid: extended unified and double sphere, both in closed form.

Only directions in front of the camera (z > 0) are imaged, as everywhere in this package.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.lens.axial import AxialLens
from cadcam.errors import BadValue


@dataclass(frozen=True, repr=False)
class ExtendedUnified(AxialLens):
    """m = (x, y)/(alpha d + (1 - alpha) z) with d = sqrt(beta (x^2 + y^2) + z^2).

    alpha = 0 is the ideal lens; beta = 1 the unified model of Mei and Rives with xi = alpha/(1 - alpha) and the focal
    length f/(1 - alpha). Source: Khomutenko, Garcia, Martinet, "An enhanced unified camera model" (2016), EQ 9.
    """

    alpha: float = 0.0
    beta: float = 1.0

    name: ClassVar[str] = "extended-unified"
    start: ClassVar[Mapping[str, float]] = {"alpha": 0.5}

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0 <= self.alpha <= 1 and self.beta > 0):
            raise BadValue("lens coefficients (alpha, beta)", (self.alpha, self.beta), "0 <= alpha <= 1 and beta > 0")

    @property
    def max_angle(self) -> float:
        """Return pi/2: below it the curve is increasing, its slope having the sign of alpha z/d + 1 - alpha > 0."""
        return np.pi / 2

    def _curve(self, t: Array) -> tuple[Array, Array]:
        s, c = np.sin(t), np.cos(t)
        d = np.sqrt(self.beta * s * s + c * c)
        below = self.alpha * d + (1 - self.alpha) * c
        return s / below, (self.alpha * c / d + 1 - self.alpha) / (below * below)

    def _coefficient_slopes(self, t: Array) -> Array:
        s, c = np.sin(t), np.cos(t)
        d = np.sqrt(self.beta * s * s + c * c)
        below = self.alpha * d + (1 - self.alpha) * c
        by_alpha, by_beta = d - c, self.alpha * s * s / (2 * d)
        return np.asarray(-np.stack([by_alpha, by_beta], axis=-1) * (s / (below * below))[..., None])


@dataclass(frozen=True, repr=False)
class DoubleSphere(AxialLens):
    """m = (x, y)/(alpha d2 + (1 - alpha)(xi d1 + z)), d1 = |p|, d2 = sqrt(x^2 + y^2 + (xi d1 + z)^2).

    As published: the focal length is in K, and the slope on the axis is 1/(1 + xi). Source: Usenko, Demmel, Cremers,
    "The double sphere camera model" (3DV 2018), EQ 40-45.
    """

    xi: float = 0.0
    alpha: float = 0.0

    name: ClassVar[str] = "double-sphere"
    start: ClassVar[Mapping[str, float]] = {"alpha": 0.5}

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (-1 < self.xi <= 1 and 0 <= self.alpha <= 1):
            raise BadValue("lens coefficients (xi, alpha)", (self.xi, self.alpha), "-1 < xi <= 1 and 0 <= alpha <= 1")

    @cached_property
    def max_angle(self) -> float:
        """Return the angle where cos t + xi = -w d2, EQ 43-45: the curve's turn (alpha > 1/2) or its pole; or pi/2."""
        low, high = sorted((self.alpha, 1 - self.alpha))
        w2 = (low / high) ** 2
        c = -self.xi * (1 - w2) - np.sqrt(w2 * max(0.0, 1 - self.xi**2 * (1 - w2)))
        return float(np.arccos(np.clip(c, 0.0, 1.0)))

    def _parts(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Return sin t, cos t, d2 and the denominator, for |p| = 1."""
        s, c = np.sin(t), np.cos(t)
        d2 = np.sqrt(1 + self.xi * (2 * c + self.xi))
        return s, c, d2, self.alpha * d2 + (1 - self.alpha) * (self.xi + c)

    def _curve(self, t: Array) -> tuple[Array, Array]:
        s, c, d2, below = self._parts(t)
        rise = (1 + self.xi * c) * (self.alpha * (c + self.xi) / d2 + 1 - self.alpha)
        return s / below, rise / (below * below)

    def _coefficient_slopes(self, t: Array) -> Array:
        s, c, d2, below = self._parts(t)
        by_xi = self.alpha * (c + self.xi) / d2 + 1 - self.alpha
        by_alpha = d2 - self.xi - c
        return -np.stack([by_xi, by_alpha], axis=-1) * (s / (below * below))[..., None]
