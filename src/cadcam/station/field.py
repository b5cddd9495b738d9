"""How the mechanics deviate from place to place: a random field, inferred from the calibrated positions.

Deflection and twist are smooth and repeatable (6.4.3.2), but nothing was measured between the calibrated positions.
Each axis is modelled as an unknown constant plus a Gaussian field. Its smoothness (twice differentiable or infinitely
often: Matern covariances of smoothness 5/2 and infinity), its amplitude and its lengths along x and y are not chosen
but averaged over, on a grid, weighted by the restricted likelihood of the calibrated values and a prior from the theory
of beams: lengths are about half the work area, within a factor of two. So any rule of interpolation, being a set of
weights, has a predicted error, and one set of weights is the best.
Source: Rasmussen and Williams, "Gaussian Processes for Machine Learning" (2006), EQ 4.17, section 2.7; Stein,
"Interpolation of Spatial Data" (1999), section 1.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.errors import TooFewPoints

_AMPLITUDES, _LENGTHS = np.geomspace(0.1, 6.0, 7), np.geomspace(0.2, 3.0, 7)  # by the deviations' range; by the extent
_SMOOTHNESS = (2.5, np.inf)
_USUAL, _FACTOR = 0.4, 2.0  # prior of the length: median over the extent, factor of one standard deviation
_LEAST_PROBABLE = 1e-3


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DeviationField(Brief):
    """The field at N positions (N, 2): for each axis its hypotheses and their probabilities.

    hypotheses: two arrays (H, 4) of amplitude, length x, length y in mm, and smoothness; probability: two arrays (H,);
    noise (2, N, N): covariance of the calibrated values.
    """

    positions: Array
    hypotheses: tuple[Array, Array]
    probability: tuple[Array, Array]
    noise: Array

    def weights(self, at: Floats) -> Array:
        """Return the best weights (2, n, N) of the calibrated positions at n places (n, 2), for x and for y.

        They add up to one, so that a constant deviation is reproduced.
        """
        places = frozen(at, "positions", (None, 2))
        return np.stack([self._weights(axis, places) for axis in (0, 1)])

    def error_covariance(self, at: Floats, weights: Floats) -> Array:
        """Return the covariance (2, n, n) mm^2, per axis, of weights (2, n, N) . deviations - that at places (n, 2).

        The weights have to add up to one. Errors of the calibrated values themselves are not included.
        """
        places, W = frozen(at, "positions", (None, 2)), frozen(weights, "weights", (2, None, len(self.positions)))
        both = np.concatenate([places, self.positions])
        A = np.concatenate([-np.broadcast_to(np.eye(len(places)), (2, len(places), len(places))), W], axis=2)
        out = [A[axis] @ self._covariance(axis, both) @ A[axis].T for axis in (0, 1)]
        return np.asarray(np.stack(out))

    def lengths(self) -> Array:
        """Return the typical (geometric mean) lengths (2, 2) mm over which x and y deviations change, along x and y."""
        pairs = zip(self.probability, self.hypotheses, strict=True)
        return np.stack([np.exp(p @ np.log(h[:, 1:3])) for p, h in pairs])

    def _covariance(self, axis: int, places: Array) -> Array:
        total = np.zeros((len(places), len(places)))
        for h, p in zip(self.hypotheses[axis], self.probability[axis], strict=True):  # at once they fill the memory
            total += p * _covariances(h[None], places, places)[0]
        return total

    def _weights(self, axis: int, places: Array) -> Array:
        h, ones = self.hypotheses[axis], np.ones(len(self.positions))
        back = np.linalg.inv(_covariances(h, self.positions, self.positions) + self.noise[axis])
        k = _covariances(h, places, self.positions)  # (H, n, N)
        bk, b1 = k @ back, back @ ones
        lacking = (1 - bk.sum(axis=2)) / b1.sum(axis=1)[:, None]
        each = bk + lacking[:, :, None] * b1[:, None, :]
        return np.asarray(np.einsum("h,hnN->nN", self.probability[axis], each))


def fit_field(positions: Floats, deviations: Floats, noise: Floats) -> DeviationField:
    """Return the field inferred from deviations (N, 2) mm at positions (N, 2).

    noise (2, N, N): covariance of the deviations' errors, for x and for y.
    """
    grid = frozen(positions, "positions", (None, 2))
    if not len(grid):
        raise TooFewPoints("a field of deviations", 0, 1, of="positions")
    m = frozen(deviations, "deviations", (len(grid), 2))
    N = frozen(noise, "noise of the deviations", (2, len(grid), len(grid)))
    (hx, px), (hy, py) = (_weighed(grid, m[:, axis], N[axis]) for axis in (0, 1))
    return DeviationField(grid, (hx, hy), (px, py), N)


def _candidates(grid: Array, m: Array) -> tuple[Array, Array]:
    """Return hypotheses (H, 4), and the logarithms of their prior probabilities."""
    extent = np.maximum(np.ptp(grid, axis=0), 1.0)
    extent = np.maximum(extent, 0.1 * extent.max())
    size = max(float(np.ptp(m)), 0.1)
    axes = (_AMPLITUDES * size, _LENGTHS * extent[0], _LENGTHS * extent[1], np.array(_SMOOTHNESS))
    hypotheses = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 4)
    off = np.log(hypotheses[:, 1:3] / (_USUAL * extent)) / np.log(_FACTOR)
    return hypotheses, -0.5 * np.sum(off**2, axis=1)


def _weighed(grid: Array, m: Array, noise: Array) -> tuple[Array, Array]:
    """Return the hypotheses of noticeable probability, and their probabilities given m (N,)."""
    hypotheses, before = _candidates(grid, m)
    K = _covariances(hypotheses, grid, grid) + noise + 1e-9 * np.eye(len(grid))
    back, ones = np.linalg.inv(K), np.ones(len(grid))
    b1 = back @ ones
    total = b1.sum(axis=1)
    misfit = np.einsum("i,hij,j->h", m, back, m) - (b1 @ m) ** 2 / total
    log_p = before - 0.5 * (np.linalg.slogdet(K)[1] + np.log(total) + misfit)
    p = np.exp(log_p - log_p.max())
    kept = p >= _LEAST_PROBABLE
    return hypotheses[kept], p[kept] / p[kept].sum()


def _covariances(hypotheses: Array, a: Array, b: Array) -> Array:
    """Return the covariances (H, n, m) between places (n, 2) and (m, 2)."""
    d = (a[:, None] - b[None])[None] / hypotheses[:, None, None, 1:3]
    r2 = np.sum(d * d, axis=-1)
    r = np.sqrt(5.0 * r2)
    rough = np.isfinite(hypotheses[:, 3])[:, None, None]
    shape = np.where(rough, (1 + r + r * r / 3) * np.exp(-r), np.exp(-0.5 * r2))
    return np.asarray(hypotheses[:, 0, None, None] ** 2 * shape)
