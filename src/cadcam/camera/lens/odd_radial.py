"""The thesis' radial polynomial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from cadcam.arrays import Array, component_major
from cadcam.camera import radial
from cadcam.camera.lens.base import PlanarLens
from cadcam.errors import BadValue


@dataclass(frozen=True, repr=False)
class OddRadial(PlanarLens):
    """The thesis' EQ 2.5: a direction at radius r is imaged at r + dr, dr = a1 r + a3 r^3 + a5 r^5 + a7 r^7.

    r is measured from the principal point in units of the focal length, so the coefficients are dimensionless. For
    coefficients A_k on radii in pixels, a_k = A_k f^(k-1) with f the focal length in pixels. a1 is indistinguishable
    from a change of the focal length; the thesis absorbs it there, and so does calibration unless it is given.
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

    def _linearised(self, u: Array, terms: Sequence[int]) -> tuple[Array, Array, Array]:
        r2 = np.sum(u * u, axis=-1)
        g, dg = self._gain(r2)
        by_term = np.swapaxes(component_major(u.shape[:-1], len(terms), 2), -1, -2)
        for i, k in enumerate(terms):
            by_term[..., i] = u * (r2**k)[..., None]
        return u * g[..., None], radial.radial_jacobian(u, g, dg), by_term

    def _undistort(self, m: Array) -> Array:
        rho = np.hypot(m[..., 0], m[..., 1])

        def curve(r: Array) -> tuple[Array, Array]:
            g, dg = self._gain(r * r)
            return r * g, g + 2 * r * r * dg

        r = radial.inverse(curve, rho, self.valid_radius)
        return m * np.where(rho > 0, r / np.where(rho > 0, rho, 1.0), 1 / (1 + self.a1))[..., None]
