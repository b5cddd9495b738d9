"""What all fits to pixels have in common: residuals, degrees of freedom, noise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.arrays import Array, Locked

_SUSPECT = 2.0  # times the median residual
_CHANCE = 1e-3  # probability that any good view is named


class Fitted(Locked, ABC):
    """A result of least squares on image coordinates; subclasses give residuals, unknowns and observations."""

    __slots__ = ()

    observations: Any  # those of the subclass

    @property
    @abstractmethod
    def residuals(self) -> Array:
        """Return measured minus projected image coordinates (N, e), px."""

    @property
    @abstractmethod
    def unknowns(self) -> int:
        """Return the number of estimated parameters."""

    @property
    def stated_px(self) -> float | None:
        """Return the noise of one image coordinate as stated with the observations, px."""
        stated: float | None = self.observations.sigma_px
        return stated

    @property
    def sum_of_squares(self) -> float:
        """Return the sum of squared residuals, px^2."""
        return float(np.sum(self.residuals**2))

    @property
    def thesis_residual(self) -> float:
        """Return the thesis' residual sqrt(sum of squares / N) for N points, px."""
        return float(np.sqrt(self.sum_of_squares / len(self.residuals)))

    @property
    def dof(self) -> int:
        """Return the degrees of freedom: image coordinates minus unknowns."""
        return self.residuals.size - self.unknowns

    @property
    def sigma0(self) -> float | None:
        """Return the noise of one image coordinate from the residuals, px; None without degrees of freedom."""
        return float(np.sqrt(self.sum_of_squares / self.dof)) if self.dof > 0 else None

    @property
    def noise_px(self) -> float:
        """Return the noise behind every covariance: as stated, else sigma0, else inf.

        Without degrees of freedom and without a stated noise the points fit exactly: the noise is unknown.
        """
        noise = self.sigma0 if self.stated_px is None else self.stated_px
        return np.inf if noise is None else noise

    @property
    def noise_dof(self) -> float:
        """Return the degrees of freedom behind the noise: inf where it was stated."""
        return float(self.dof) if self.stated_px is None else np.inf


def scaled(cofactor: Array, noise: float) -> Array:
    """Return noise^2 times a cofactor matrix; with unknown (infinite) noise inf on its diagonal and zero elsewhere."""
    if np.isfinite(noise):
        return np.asarray(noise**2 * cofactor)
    diagonal = np.eye(cofactor.shape[-1], dtype=bool)
    return np.where(diagonal & (cofactor > 0), np.inf, 0.0)


def freedom_words(dof: int) -> str:
    """Return a number of degrees of freedom in words."""
    return f"{dof} degree{'s' * (dof != 1)} of freedom"


def noise_may_be_times(dof: int) -> float:
    """Return by what factor the true noise may exceed sigma0: its 95 % bound, from chi-square with `dof` degrees."""
    from scipy.special import chdtri

    return float(np.sqrt(dof / chdtri(dof, 0.95))) if dof > 0 else np.inf


def doubted(doubts: Sequence[str]) -> str:
    """Return how many doubts an estimate has, for its repr; "" for none."""
    return f", {len(doubts)} doubt{'s' * (len(doubts) != 1)}: see .doubts" if doubts else ""


def standing_out(count: int, kind: str) -> str:
    """Return how many views or frames fit much worse than the others, for an estimate's repr; "" for none."""
    return f", {count} {kind}{'s' * (count != 1)} worse than the others: see .outlier_{kind}s()" if count else ""


def stand_out(residuals: Array, points: Sequence[int]) -> tuple[int, ...]:
    """Return which of several views (or frames) fit much worse than the others, the worst first.

    residuals (k,): root mean square distance of a view's points, of `points` (k,) each. A view is named if its residual
    is at least twice the median and chance (F test) gives such a view in one calibration of a thousand.
    """
    from scipy.stats import f

    if len(residuals) < 3:
        return ()
    typical, total = float(np.median(residuals)), 2 * sum(points)
    bad = []
    for j in np.argsort(-residuals):
        own = 2 * points[j]
        chance = f.sf((residuals[j] / typical) ** 2, own, total - own) * len(residuals) if typical > 0 else 1.0
        if residuals[j] > _SUSPECT * typical and chance < _CHANCE:
            bad.append(int(j))
    return tuple(bad)
