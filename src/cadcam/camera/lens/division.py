"""The one-parameter division model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cadcam.arrays import Array
from cadcam.camera import radial
from cadcam.camera.lens.base import PlanarLens


@dataclass(frozen=True, repr=False)
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

    def _linearised(self, u: Array, terms: Sequence[int]) -> tuple[Array, Array, Array]:
        """With s = sqrt(1 - 4 k |u|^2) the gain is g = 2/(1 + s), and dg/d(k |u|^2) = g^2/s."""
        s, r2 = self._root(u), np.sum(u * u, axis=-1)
        g = 2 / (1 + s)
        slope = g * g / s
        by_k = (u * (slope * r2)[..., None])[..., None]
        return u * g[..., None], radial.radial_jacobian(u, g, slope * self.k), by_k[..., [0] * len(terms)]

    def _undistort(self, m: Array) -> Array:
        d = 1 + self.k * np.sum(m * m, axis=-1)
        first_branch = self.k * np.sum(m * m, axis=-1) < 1  # beyond it the curve has turned back
        return m / np.where((d > 0) & first_branch, d, np.nan)[..., None]
