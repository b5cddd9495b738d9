"""Markov chains sample what they are given, and say so when they do not."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import NotConverged
from cadcam.fit.sampling import (
    BEST_ACCEPTANCE,
    NotMixed,
    Walk,
    effective_size,
    metropolis,
    refuse_unmixed,
    split_r_hat,
)

COVARIANCE = np.array([[4.0, 1.8, 0.0], [1.8, 1.0, 0.2], [0.0, 0.2, 0.25]])
MEAN = np.array([10.0, -3.0, 0.5])
FACTOR = np.linalg.cholesky(COVARIANCE)


def log_normal(x):
    y = np.linalg.solve(FACTOR, (x - MEAN).T)
    return -0.5 * np.sum(y**2, axis=0)


def chains(rng, walk, *, density=log_normal, factor=FACTOR, count=16, spread=2.0):
    starts = MEAN + spread * rng.standard_normal((count, 3)) @ FACTOR.T
    return metropolis(density, starts, factor, walk, rng=rng)


def autoregressive(rng, rho, shape):
    noise = rng.standard_normal(shape)
    x = np.zeros(shape)
    x[:, 0] = noise[:, 0]
    for i in range(1, shape[1]):
        x[:, i] = rho * x[:, i - 1] + np.sqrt(1 - rho**2) * noise[:, i]
    return x


def test_the_chains_have_the_moments_of_their_density(rng):
    """Within 4.5 standard errors by the effective size; a proposal that were not symmetric would show at once."""
    kept = chains(rng, Walk(6000, 500, 4))
    draws, size = kept.draws.reshape(-1, 3), effective_size(kept.draws)
    sigma = np.sqrt(np.diag(COVARIANCE))
    assert np.all(np.abs(draws.mean(axis=0) - MEAN) < 4.5 * sigma / np.sqrt(size))
    error = np.abs(np.cov(draws.T) - COVARIANCE) / np.outer(sigma, sigma)
    assert error.max() < 4.5 * np.sqrt(2 / size.min())


def test_forbidden_states_are_never_kept(rng):
    """A half-normal density: mean sqrt(2/pi), nothing below zero."""

    def density(x):
        return np.where(x[:, 0] > 0, -0.5 * x[:, 0] ** 2, -np.inf)

    kept = metropolis(density, np.abs(rng.standard_normal((16, 1))), np.eye(1), Walk(4000, 500, 4), rng=rng)
    size = effective_size(kept.draws)[0]
    assert kept.draws.min() > 0
    assert kept.draws.mean() == pytest.approx(np.sqrt(2 / np.pi), abs=4.5 * np.sqrt((1 - 2 / np.pi) / size))


def test_burn_in_finds_the_step_that_is_accepted_as_often_as_it_should(rng):
    kept = chains(rng, Walk(2000, 1000, 10, scale=50.0))
    assert kept.acceptance == pytest.approx(BEST_ACCEPTANCE, abs=0.05)
    assert 1.0 < kept.scale < 5.0


def test_without_burn_in_nothing_is_adapted(rng):
    assert chains(rng, Walk(40, 0, 10, scale=0.37)).scale == pytest.approx(0.37, rel=1e-12)


def test_equal_generators_give_equal_chains():
    one, other = (chains(np.random.default_rng(3), Walk(100, 50, 10)).draws for _ in range(2))
    assert np.array_equal(one, other)


def test_the_progress_is_called_for_every_kept_state(rng):
    calls = []
    starts = np.repeat(MEAN[None], 4, axis=0)
    metropolis(log_normal, starts, FACTOR, Walk(50, 5, 10), rng=rng, progress=lambda: calls.append(1))
    assert len(calls) == 5


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_the_effective_size_is_that_of_a_known_process(rng, rho):
    """An autoregressive process of coefficient rho has C M (1 - rho)/(1 + rho) effective draws; estimated to 10 %."""
    size = effective_size(autoregressive(rng, rho, (16, 2000, 4)))
    assert size.mean() == pytest.approx(16 * 2000 * (1 - rho) / (1 + rho), rel=0.1)


def test_r_hat_is_one_for_chains_that_agree(rng):
    assert np.all(np.abs(split_r_hat(rng.standard_normal((8, 1000, 3))) - 1) < 0.005)


@pytest.mark.parametrize("how", ["place", "spread", "drift"])
def test_r_hat_sees_chains_that_differ(rng, how):
    """Another place, the same place with another spread (which only the folded one sees), and a drift in all chains."""
    draws = rng.standard_normal((8, 1000, 1))
    if how == "place":
        draws[0] += 3
    elif how == "spread":
        draws[:4] *= 3
    else:
        draws += np.linspace(0, 3, 1000)[None, :, None]
    assert split_r_hat(draws)[0] > 1.05


def test_chains_that_hardly_step_are_refused(rng):
    """The negative control: started apart and stepping by a thousandth of a sigma they stay where they began."""
    kept = chains(rng, Walk(2000, 0, 10, scale=1e-3))
    with pytest.raises(NotMixed, match=r"R-hat of \w+ is .* take more steps") as refused:
        refuse_unmixed(kept.draws, ["one", "two", "three"])
    assert isinstance(refused.value, NotConverged)
    assert refused.value.r_hat > 2
    assert kept.acceptance > 0.99  # every step is taken: acceptance alone tells nothing


def test_chains_that_never_move_are_refused(rng):
    draws = np.repeat(rng.standard_normal((8, 1, 2)), 50, axis=1)
    with pytest.raises(NotMixed):
        refuse_unmixed(draws, ["one", "two"])
    with pytest.raises(NotMixed):
        refuse_unmixed(np.ones((8, 50, 2)), ["one", "two"])


def test_good_chains_are_let_through(rng):
    r_hat, size = refuse_unmixed(chains(rng, Walk(3000, 500, 10)).draws, ["one", "two", "three"])
    assert r_hat.max() < 1.03
    assert size.min() > 400
