"""The photogrammetric lens: the polynomial maps the measured point to the ideal one, not vice versa."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.lens.base import PlanarLens
from cadcam.camera.lens.brown_conrady import BrownConrady


@dataclass(frozen=True, repr=False)
class InverseBrownConrady(PlanarLens):
    """Distorted to ideal, with r2 = mx^2 + my^2 and g = 1 + k1 r2 + k2 r2^2 + k3 r2^3.

    ux = mx g + 2 p1 mx my + p2 (r2 + 2 mx^2),
    uy = my g + p1 (r2 + 2 my^2) + 2 p2 mx my.
    The model of photogrammetry (PhotoModeler, Australis) and of HALCON's polynomial, here with coefficients of the
    normalised plane and OpenCV's names for p1, p2. Source: Brown (1971), EQ 2-3.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    name: ClassVar[str] = "inverse-brown-conrady"

    @cached_property
    def _back(self) -> BrownConrady:
        """Return the same polynomial as a lens that maps m to u."""
        return BrownConrady(self.k1, self.k2, self.p1, self.p2, self.k3)

    @cached_property
    def valid_radius(self) -> float:
        """Return the smallest |u| on the circle of m where the polynomial first folds; inf if it never does."""
        limit = self._back.valid_radius
        if not np.isfinite(limit):
            return np.inf
        phi = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        edge = self._back._distort(limit * np.stack([np.cos(phi), np.sin(phi)], axis=-1))
        return float(np.hypot(edge[:, 0], edge[:, 1]).min())

    def _distort(self, u: Array) -> Array:
        return self._back._undistort(u)

    def _linearised(self, u: Array, terms: Sequence[int]) -> tuple[Array, Array, Array]:
        """At fixed u, dm/dcoefficients = -(du/dm)^-1 du/dcoefficients."""
        m = self._distort(u)
        _, du_dm, du_dc = self._back._linearised(m, terms)
        dm_du = _inverse(du_dm)
        return m, dm_du, -dm_du @ du_dc

    def _undistort(self, m: Array) -> Array:
        return np.where(self._back._inside(m)[..., None], self._back._distort(m), np.nan)


def _inverse(J: Array) -> Array:
    """Return J^-1 of 2x2 matrices; NaN in, NaN out."""
    out = np.zeros_like(J)
    out[..., 0, 0], out[..., 1, 1] = J[..., 1, 1], J[..., 0, 0]
    out[..., 0, 1], out[..., 1, 0] = -J[..., 0, 1], -J[..., 1, 0]
    det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
    return np.asarray(out / det[..., None, None])
