"""The Kannala-Brandt fisheye."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from cadcam.arrays import Array
from cadcam.camera import radial
from cadcam.camera.lens.axial import AxialLens


@dataclass(frozen=True, repr=False)
class Fisheye(AxialLens):
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

    def _curve(self, t: Array) -> tuple[Array, Array]:
        t2 = t * t
        value = t * (1 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4))))
        slope = 1 + t2 * (3 * self.k1 + t2 * (5 * self.k2 + t2 * (7 * self.k3 + t2 * 9 * self.k4)))
        return value, slope

    def _coefficient_slopes(self, t: Array) -> Array:
        return np.stack([t ** (2 * k + 1) for k in range(1, 5)], axis=-1)
