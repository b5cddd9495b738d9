"""The variability of a calibrated camera's parameters: first order, Monte Carlo, Markov chain (thesis, section 2.4).

Three methods, which agree where the noise is small:
`first_order_variability`   the estimator's derivative: equals `CameraEstimate.covariance`, or with noisy points, too;
`monte_carlo_variability`   Method A, EQ 2.177-2.179: repeated estimates from synthetic observations of the camera;
`markov_chain_variability`  Method B, EQ 2.180-2.187: Metropolis over the likelihood of the measured pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Brief, frozen
from cadcam.calibrate.points.camera import Method
from cadcam.calibrate.variability.repeated import (
    estimates,
    free_of,
    model_of,
    refuse_method,
    response,
    seen_exactly,
    unwrapped,
)
from cadcam.camera.estimate import CameraEstimate
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.global_search import polished
from cadcam.fit.least_squares import cofactor
from cadcam.fit.sampling import LogDensity, Progress, Walk, metropolis, refuse_unmixed
from cadcam.kinds import expect, expect_count, expect_positive

BLOCK = 256  # draws per block; each block's noise is drawn whole, so that longer runs begin with the same draws
CHAINS = 64
_THIN = 10
_LONG = 10_000  # steps of a chain: hundreds of autocorrelation times, or R-hat is dominated by its own noise
_SPREAD = 2.0  # sigmas of the chains' starts: wider than the distribution, so that R-hat detects poor mixing


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FirstOrder(Brief):
    """The covariance (n, n) of the free parameters `names` to first order in the noise, about `exact` (n,)."""

    names: tuple[str, ...]
    exact: Array
    covariance: Array

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "exact", frozen(self.exact, "exact", (n,)))
        object.__setattr__(self, "covariance", frozen(self.covariance, "covariance", (n, n)))

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (n,) in mm, rad, px."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """Return the correlation matrix (n, n)."""
        return _correlation(self.covariance)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Variability(Brief):
    """Draws (C, M, n) of the free parameters `names` in C chains (one, where they are independent), mm, rad, px.

    exact: the values (n,) about which they were made. sigma_px, sigma_mm: noise of one coordinate of pixels and of
    world points. failed: draws without a solution, left out. r_hat, effective (n,), acceptance: of Markov chains
    (`cadcam.fit.sampling`); independent draws have R-hat 1 and count fully. Angles are continuous about `exact`.
    """

    names: tuple[str, ...]
    exact: Array
    draws: Array
    sigma_px: float
    sigma_mm: float
    failed: int
    r_hat: Array
    effective: Array
    acceptance: float

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "draws", frozen(self.draws, "draws", (None, None, n)))
        for name in ("exact", "r_hat", "effective"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, (n,)))

    @property
    def values(self) -> Array:
        """Return all draws (C M, n)."""
        return self.draws.reshape(-1, len(self.names))

    @property
    def mean(self) -> Array:
        """Return the means (n,), EQ 2.177."""
        return np.asarray(self.values.mean(axis=0))

    @property
    def mean_error(self) -> Array:
        """Return the standard errors (n,) of `mean`."""
        return np.asarray(self.sigma / np.sqrt(self.effective))

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (n,), EQ 2.178."""
        return np.asarray(self.values.std(axis=0))

    @property
    def minimum(self) -> Array:
        """Return the smallest values (n,); with more draws they fall."""
        return np.asarray(self.values.min(axis=0))

    @property
    def maximum(self) -> Array:
        """Return the largest values (n,); with more draws they grow."""
        return np.asarray(self.values.max(axis=0))

    @property
    def covariance(self) -> Array:
        """Return the covariance (n, n), EQ 2.179."""
        return np.atleast_2d(np.cov(self.values.T, bias=True))

    @property
    def correlation(self) -> Array:
        """Return the correlation matrix (n, n)."""
        return _correlation(self.covariance)

    def quantile(self, probability: float) -> Array:
        """Return the quantiles (n,) of the draws."""
        return np.asarray(np.quantile(self.values, probability, axis=0))


def first_order_variability(
    estimate: CameraEstimate, *, sigma_px: float | None = None, sigma_mm: float = 0.0, method: Method = "reprojection"
) -> FirstOrder:
    """Return the covariance of the free parameters for noise in every pixel and every world coordinate.

    sigma_px^2 G G^T + sigma_mm^2 H H^T, G and H the derivatives of the estimate by `method` with respect to pixels and
    world points; without the second term this is `CameraEstimate.covariance`. The weights stay equal, as in the
    estimators. sigma_px: default the estimate's `noise_px`. Raises `BadValue` where that is unknown.
    """
    expect(estimate, "estimate", CameraEstimate)
    refuse_method(method, estimate)
    noise = noise_of(estimate, sigma_px, sigma_mm)
    model, state = model_of(estimate)
    G, H = response(estimate, method)
    exact = free_of(model, model.parameters(state))
    return FirstOrder(estimate.free, exact, noise**2 * G @ G.T + sigma_mm**2 * H @ H.T)


def monte_carlo_variability(
    estimate: CameraEstimate,
    *,
    rng: np.random.Generator,
    draws: int = 2000,
    sigma_px: float | None = None,
    sigma_mm: float = 0.0,
    method: Method = "reprojection",
    progress: Progress | None = None,
) -> Variability:
    """Return the estimates from synthetic observations of the estimated camera: Method A of the thesis.

    Its points, imaged exactly, get normal noise of sigma_px (default: the estimate's `noise_px`) per coordinate, the
    world points sigma_mm; each draw is estimated by `method`: least squares started at the estimate, or a linear
    transform ("dlt-c23" is the thesis'). An equal `rng` gives equal draws, and longer runs begin with the same ones.
    `progress` is called after each of ceil(draws/256) blocks. Raises `BadValue` for unknown noise, `DegenerateGeometry`
    if more than half of the draws have no solution.
    """
    expect(estimate, "estimate", CameraEstimate)
    expect(rng, "rng", np.random.Generator)
    refuse_method(method, estimate)
    noise = noise_of(estimate, sigma_px, sigma_mm)
    model, state = model_of(estimate)
    exact, q_exact = free_of(model, model.parameters(state)), seen_exactly(estimate)
    found = []
    for count in blocks(draws):
        q = q_exact + noise * rng.standard_normal((BLOCK, *q_exact.shape))[:count]
        p = model.p_world + sigma_mm * rng.standard_normal((BLOCK, *model.p_world.shape))[:count]
        some = replace(model, p_world=p, q=q)
        values, good = estimates(some, np.repeat(state[None], count, axis=0), method, noise_px=noise)
        found.append(unwrapped(values[good], model.free, exact))
        if progress is not None:
            progress()
    return independent(model.free, exact, np.concatenate(found), draws, noise, sigma_mm)


def markov_chain_variability(
    estimate: CameraEstimate,
    *,
    rng: np.random.Generator,
    walk: Walk | None = None,
    chains: int = CHAINS,
    sigma_px: float | None = None,
    progress: Progress | None = None,
) -> Variability:
    """Return draws of the free parameters by the likelihood of the measured pixels: Method B of the thesis.

    The density is exp(-sum of squares/(2 sigma_px^2)), with a flat prior in the thesis' parameters; sigma_px: default
    the estimate's `noise_px`. Random-walk Metropolis, `chains` chains of `walk` (default 1,000,000 steps in all) whose
    starts are spread twice as wide as the first-order covariance, which also shapes their steps; the step size is tuned
    in burn-in only. `exact` is the least-squares optimum. `progress` is called after each of walk.steps/walk.thin kept
    states of all chains. Raises `NotMixed` if the chains do not agree, `BadValue` for unknown noise.
    """
    expect(estimate, "estimate", CameraEstimate)
    expect(rng, "rng", np.random.Generator)
    noise = noise_of(estimate, sigma_px)
    if chains < 2:
        raise BadValue("number of chains", chains, "2 at least: one alone cannot show that it has not mixed")
    walk = walk_of(1_000_000, chains) if walk is None else walk
    model, state = model_of(estimate)
    best = polished(model, state[None])[0].state
    exact, density = free_of(model, model.parameters(best)), log_likelihood(model, best, noise)
    factor = noise * np.asarray(np.linalg.cholesky(cofactor(model.jacobian_by_parameters(best), model.free)))
    starts = _possible_starts(density, exact, _SPREAD * factor, chains, rng)
    kept = metropolis(density, starts, factor, walk, rng=rng, progress=progress)
    r_hat, effective = refuse_unmixed(kept.draws, model.free)
    draws = unwrapped(kept.draws, model.free, exact)
    return Variability(model.free, exact, draws, noise, 0.0, 0, r_hat, effective, kept.acceptance)


def chains_for(steps: int) -> int:
    """Return the number of chains to divide steps among: each long enough to forget its start."""
    return min(CHAINS, max(4, steps // _LONG))


def walk_of(steps: int, chains: int = CHAINS) -> Walk:
    """Return the walk of each chain for about `steps` steps of all chains together, after a burn-in of a tenth more."""
    each = -(-steps // (chains * _THIN)) * _THIN
    if each < 4 * _THIN:
        raise BadValue("number of Markov steps", steps, f"{4 * _THIN * chains} at least for {chains} chains")
    return Walk(each, burn_in=max(500, each // 10), thin=_THIN)


def noise_of(estimate: CameraEstimate, sigma_px: float | None, sigma_mm: float = 0.0) -> float:
    """Return the given pixel noise, else the estimate's; `BadValue` if there is none or it is not valid."""
    noise = estimate.noise_px if sigma_px is None else sigma_px
    expect_positive(noise, "sigma_px", "a positive number of px; state it, the residuals do not tell it here")
    expect_positive(sigma_mm, "sigma_mm", "the noise of a world coordinate, 0 mm or more", zero=True)
    return float(noise)


def blocks(draws: int) -> Iterator[int]:
    """Yield the number of draws of each block; `BadValue` for too few draws."""
    expect_count(draws, "number of draws", least=2, expected="2 at least; 2000 know a sigma to 1.6 %")
    for begin in range(0, int(draws), BLOCK):
        yield min(BLOCK, int(draws) - begin)


def independent(
    names: tuple[str, ...], exact: Array, values: Array, asked: int, noise: float, sigma_mm: float
) -> Variability:
    """Return independent draws (M, n) of `asked`; `DegenerateGeometry` if fewer than half of them have a solution."""
    if 2 * len(values) < asked:
        raise DegenerateGeometry(
            f"{asked - len(values)} of {asked} draws have no camera at {noise:.3g} px of noise: the points are too few "
            "or too near each other for it; fix parameters, or add points"
        )
    n = len(names)
    failed, full = asked - len(values), np.full(n, float(len(values)))
    return Variability(names, exact, values[None], noise, sigma_mm, failed, np.ones(n), full, 1.0)


def log_likelihood(model: CameraModel, state: Array, noise: float) -> LogDensity:
    """Return log L (C,) as a function of the free parameters (C, n), the others as in `state`; noise: px."""
    held = model.parameters(state)

    def density(values: Array) -> Array:
        full = np.repeat(held[None], len(values), axis=0)
        full[:, model.columns] = values
        return np.asarray(-model.costs(model.from_parameters(full)) / (2 * noise**2))

    return density


def _possible_starts(density: LogDensity, exact: Array, factor: Array, chains: int, rng: np.random.Generator) -> Array:
    """Return normal draws (C, n) about `exact`; those that are not cameras are drawn again, nearer."""
    starts = exact + rng.standard_normal((chains, len(exact))) @ factor.T
    while (bad := ~np.isfinite(density(starts))).any():
        starts[bad] = exact + (starts[bad] - exact) / 2
    return starts


def _correlation(covariance: Array) -> Array:
    sigma = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sigma, sigma))
