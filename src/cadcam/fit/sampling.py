"""Markov chains over a density known up to a factor, and whether they have mixed: acceptance, R-hat, effective size.

Random-walk Metropolis (Metropolis et al. 1953) with steps shaped by a covariance, all chains stepping as one batch of
arrays. The scale of the steps is adapted during burn-in only (Robbins and Monro 1951; the target acceptance of Roberts,
Gelman, Gilks 1997), so what is kept is a Markov chain with one kernel. R-hat is the rank-normalised split R-hat and the
effective sample size the split one of Vehtari, Gelman, Simpson, Carpenter, Buerkner (2021), sections 3 and 4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, frozen
from cadcam.errors import NotConverged

LogDensity = Callable[[Array], Array]  # (C, n) -> (C,), -inf where impossible
Progress = Callable[[], None]

BEST_ACCEPTANCE = 0.234  # of a random walk in many dimensions
BEST_SCALE = 2.38  # over sqrt(dimensions), for a normal density sampled with steps of its own covariance
R_HAT_USELESS, R_HAT_GOOD = 1.1, 1.01


class NotMixed(NotConverged):
    """The chains do not agree on the distribution: their results would depend on their starts."""

    def __init__(self, name: str, r_hat: float, effective: float) -> None:
        super().__init__(
            f"the Markov chains have not mixed: R-hat of {name} is {r_hat:.3g} ({R_HAT_GOOD:g} or less is good, "
            f"{R_HAT_USELESS:g} the limit; effective sample size {effective:.0f}); take more steps, or fix a parameter "
            "that the points hardly determine"
        )
        self.name: str = name
        self.r_hat: float = r_hat
        self.effective: float = effective


@dataclass(frozen=True, slots=True)
class Walk:
    """Parameters of the chains. thin: one state in so many is kept; scale: of first steps, in sigmas per dimension^1/2.

    Without burn-in nothing is adapted.
    """

    steps: int
    burn_in: int = 1000
    thin: int = 10
    scale: float = BEST_SCALE


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """The kept states of C chains: draws (C, M, n), the share of accepted proposals, and the scale of these steps."""

    draws: Array
    acceptance: float
    scale: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "draws", frozen(self.draws, "draws", (None, None, None)))


def metropolis(
    log_density: LogDensity,
    starts: Array,
    factor: Array,
    walk: Walk,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Chains:
    """Return the kept states of chains from `starts` (C, n); factor (n, n): factor @ factor.T is the steps' covariance.

    `progress` is called after every kept state of the chains.
    """
    x, density = starts.copy(), log_density(starts)
    scale = walk.scale / np.sqrt(x.shape[1])

    def step() -> float:
        proposed = x + scale * rng.standard_normal(x.shape) @ factor.T
        then = log_density(proposed)
        taken = np.log(rng.random(len(x))) < then - density
        x[taken], density[taken] = proposed[taken], then[taken]
        return float(taken.mean())

    for i in range(walk.burn_in):
        scale *= np.exp((step() - BEST_ACCEPTANCE) / (1 + i) ** 0.6)
    kept = np.zeros((walk.steps // walk.thin, *x.shape))
    accepted = 0.0
    for state in kept:
        accepted += sum(step() for _ in range(walk.thin))
        state[:] = x
        if progress is not None:
            progress()
    share = accepted / max(len(kept) * walk.thin, 1)
    return Chains(np.swapaxes(kept, 0, 1), share, scale * float(np.sqrt(x.shape[1])))


def refuse_unmixed(draws: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Return R-hat and effective size (n,) of draws (C, M, n); `NotMixed` naming the worst beyond the limit."""
    r_hat, effective = split_r_hat(draws), effective_size(draws)
    worst = int(np.argmax(np.where(np.isnan(r_hat), np.inf, r_hat)))
    if not r_hat[worst] <= R_HAT_USELESS:
        raise NotMixed(names[worst], float(r_hat[worst]), float(effective[worst]))
    return r_hat, effective


def split_r_hat(draws: Array) -> Array:
    """Return the rank-normalised split R-hat (n,) of draws (C, M, n), the larger of those of location and of spread.

    1 for chains that sample the same distribution; NaN for draws that never move.
    """
    halves = _halves(draws)
    folded = np.abs(halves - np.median(halves, axis=(0, 1)))
    return np.maximum(_r_hat(_normal_scores(halves)), _r_hat(_normal_scores(folded)))


def effective_size(draws: Array) -> Array:
    """Return the effective sample size (n,) of the means of draws (C, M, n); 0 if they never move."""
    halves = _halves(draws)
    count = halves.shape[0] * halves.shape[1]
    within, total = _within_and_total(halves)
    correlation = 1 - (within - _autocovariance(halves).mean(axis=0)) / np.where(total > 0, total, 1.0)
    tau = np.array([_integrated(correlation[:, i]) for i in range(draws.shape[2])])
    size = np.minimum(count / tau, count * np.log10(max(count, 10)))
    return np.where(total > 0, size, 0.0)


def _halves(draws: Array) -> Array:
    M = draws.shape[1] // 2
    return np.concatenate([draws[:, :M], draws[:, -M:]])


def _within_and_total(draws: Array) -> tuple[Array, Array]:
    """Return the mean variance within chains and the estimate of the total variance, (n,) each."""
    M = draws.shape[1]
    within = draws.var(axis=1, ddof=1).mean(axis=0)
    between = draws.mean(axis=1).var(axis=0, ddof=1)
    return within, within * (M - 1) / M + between


def _r_hat(draws: Array) -> Array:
    within, total = _within_and_total(draws)
    return np.sqrt(np.where(within > 0, total / np.where(within > 0, within, 1.0), np.where(total > 0, np.inf, np.nan)))


def _normal_scores(draws: Array) -> Array:
    from scipy.special import ndtri
    from scipy.stats import rankdata

    flat = draws.reshape(-1, draws.shape[2])
    rank = rankdata(flat, axis=0)
    return np.asarray(ndtri((rank - 0.375) / (len(flat) + 0.25))).reshape(draws.shape)


def _autocovariance(draws: Array) -> Array:
    """Return the autocovariance (C, M, n) of each chain by the fast Fourier transform."""
    M = draws.shape[1]
    spectrum = np.fft.rfft(draws - draws.mean(axis=1, keepdims=True), n=2 * M, axis=1)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, n=2 * M, axis=1)[:, :M] / (M - 1))


def _integrated(correlation: Array) -> float:
    """Return the integrated autocorrelation time: Geyer's initial monotone sequence (1992) of pairs."""
    pairs = correlation[: len(correlation) // 2 * 2].reshape(-1, 2).sum(axis=1)
    pairs[0] = max(pairs[0], 1e-12)
    end = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    return float(-1 + 2 * np.minimum.accumulate(pairs[:end]).sum())
