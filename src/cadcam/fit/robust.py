"""Robust losses on the residual vector of an image point, and the noise of the inliers.

A loss replaces d^2, the squared distance of a point, by scale^2 rho((d/(c scale))^2) c^2 with rho(s) = s for small s:
in the limit of small distances nothing changes. Each loss has the constant c at which it keeps 95 % efficiency on
two-dimensional normal noise of standard deviation `scale` per coordinate. Source of the losses: Huber, "Robust
Statistics" (1981); Zhang, "Parameter estimation techniques" (1997), table 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cadcam.arrays import Array
from cadcam.kinds import expect, expect_known, expect_numbers, expect_positive

LossName = Literal["squared", "huber", "cauchy", "tukey"]

_TUNING: dict[LossName, float] = {"squared": 1.0, "huber": 1.501141, "cauchy": 2.548638, "tukey": 5.122986}
_FARTHEST = 12.0  # of a normal distribution, in its sigmas
_MEDIAN_DISTANCE = float(np.sqrt(2 * np.log(2)))  # of a two-dimensional normal distribution, over sigma per coordinate


@dataclass(frozen=True, slots=True)
class Loss:
    """The weight of a point by its distance.

    name: "squared", "huber" (outliers act with constant force), "cauchy" (ever less), "tukey" (beyond 5.1 scales none).
    scale: the standard deviation of one coordinate of a good point, in the residuals' unit; None estimates it with the
    fit, from the median distance of all points.
    """

    name: LossName = "squared"
    scale: float | None = None

    def __post_init__(self) -> None:
        expect(self.name, "loss", str)
        expect_numbers(self)
        expect_known(self.name, "loss", _TUNING)
        if self.scale is not None:
            expect_positive(self.scale, "scale of the loss", "a positive number in the unit of the residuals, or None")

    @property
    def is_squared(self) -> bool:
        """Return whether it is plain least squares."""
        return self.name == "squared"

    def values(self, d2: Array, scale: float) -> Array:
        """Return the loss (...,) of squared distances (...,)."""
        s, unit = self._relative(d2, scale)
        if self.name == "huber":
            return np.where(s <= 1, s, 2 * np.sqrt(s) - 1) * unit
        if self.name == "cauchy":
            return np.log1p(s) * unit
        if self.name == "tukey":
            return (1 - (1 - np.minimum(s, 1)) ** 3) / 3 * unit
        return d2

    def weights(self, d2: Array, scale: float) -> Array:
        """Return rho'(s) (...,), the weight of a point in reweighted least squares."""
        s, _ = self._relative(d2, scale)
        if self.name == "huber":
            return np.asarray(1 / np.sqrt(np.maximum(s, 1)))
        if self.name == "cauchy":
            return 1 / (1 + s)
        if self.name == "tukey":
            return np.asarray((1 - np.minimum(s, 1)) ** 2)
        return np.ones_like(d2)

    def stiffness(self, d2: Array, scale: float) -> Array:
        """Return the mean derivative of the weighted residual vector by the residual, over its two directions.

        rho'(s) + s rho''(s): what enters the covariance of an M-estimator.
        """
        s, _ = self._relative(d2, scale)
        w = self.weights(d2, scale)
        if self.name == "huber":
            return np.where(s <= 1, 1.0, 0.5 * w)
        if self.name == "cauchy":
            return np.asarray(w * w)
        if self.name == "tukey":
            return np.asarray(w - 2 * np.minimum(s, 1) * (1 - np.minimum(s, 1)))
        return w

    def excess(self, scale: float) -> float:
        """Return by how much the inverse of the weighted normal matrix exceeds the covariance, for unit normal noise.

        Weights below 1 take away more information than the M-estimator loses: its covariance is E[psi^2]/E[psi']^2
        (Huber 1981, section 7.6) of that of least squares, not 1/E[w]. scale: of the loss, in units of the noise.
        """
        r = np.linspace(0.0, _FARTHEST, 2401)
        density = r * np.exp(-r * r / 2) * r[1]
        w, stiff = self.weights(r * r, scale), self.stiffness(r * r, scale)
        psi2 = (w * r) ** 2 / 2  # of one coordinate
        return float((stiff @ density) ** 2 / ((psi2 @ density) * (w @ density)))

    def _relative(self, d2: Array, scale: float) -> tuple[Array, float]:
        unit = (_TUNING[self.name] * scale) ** 2
        return d2 / unit, unit


def noise_of_the_good(distances: Array) -> float:
    """Return the standard deviation of one coordinate from the median of the points' distances (N,): half may be wrong.

    The median absolute deviation in two dimensions; 0 if half of the points fit exactly.
    """
    return float(np.median(distances)) / _MEDIAN_DISTANCE
