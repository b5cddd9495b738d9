"""Blocks that share parameters: the same minima and covariances as one dense Jacobian, and what robust losses do."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import DegenerateGeometry, NotConverged, TooFewPoints, UnknownName
from cadcam.fit.block_least_squares import minimise_blocks
from cadcam.fit.least_squares import cofactor, minimise
from cadcam.fit.robust import Loss, noise_of_the_good
from cadcam.fit.schur import Blocks
from cadcam.fit.square_root import factorise


class Decays:
    """y = a_j exp(-b t) + c_j sin(d t): heights a_j, c_j of each block; all share b and d."""

    shared, own = ("rate", "frequency"), ("height", "swing")

    def __init__(self, y, *, measured=None, prior=None):
        self.t = np.linspace(0.1, 3, y.shape[1])
        self.y, self.measured, self.prior = y, measured, prior

    def blocks(self, state):
        (b, d), own = state
        a, c = own[:, :1], own[:, 1:]
        e = np.exp(-b * self.t)
        wave = np.sin(d * self.t)
        r = a * e + c * wave - self.y
        A = np.stack([-a * self.t * e, c * self.t * np.cos(d * self.t)], axis=-1)
        B = np.stack([np.broadcast_to(e, r.shape), np.broadcast_to(wave, r.shape)], axis=-1)
        alone = {}
        if self.prior is not None:
            value, sigma = self.prior
            alone = {"alone_r": np.array([(d - value) / sigma]), "alone_by_shared": np.array([[0, 1 / sigma]])}
        if self.measured is None:
            return Blocks.of(r, A, B, **alone)
        m = self.measured
        return Blocks.of(r * m, A * m[..., None], B * m[..., None], m, **alone)

    def retract(self, state, step):
        return state[0] + step.shared, state[1] + step.own


class Dense:
    """The same residuals as one Jacobian: shared columns first, then each block's."""

    def __init__(self, problem, k):
        self.problem, self.k = problem, k

    def residuals_and_jacobian(self, x):
        blocks = self.problem.blocks((x[:2], x[2:].reshape(self.k, 2)))
        k, n, own = blocks.sizes
        J = np.zeros((k, blocks.r.shape[1], n + k * own))
        J[..., :n] = blocks.by_shared
        for j in range(k):
            J[j, :, n + own * j : n + own * (j + 1)] = blocks.by_own[j]
        p = len(blocks.alone_r)
        below = np.concatenate([blocks.alone, np.zeros((p, k * own))], axis=1)
        return np.concatenate([blocks.r.ravel(), blocks.alone_r]), np.concatenate([J.reshape(-1, J.shape[-1]), below])

    def retract(self, x, step):
        return x + step


def decays(rng, k=5, noise=0.01, rows=12):
    t = np.linspace(0.1, 3, rows)
    own = np.column_stack([rng.uniform(2, 4, k), rng.uniform(0.5, 1.5, k)])
    y = own[:, :1] * np.exp(-0.8 * t) + own[:, 1:] * np.sin(1.9 * t)
    return y + noise * rng.normal(size=y.shape), (np.array([1.0, 1.7]), np.ones((k, 2)))


@pytest.mark.parametrize("prior", [None, (1.9, 0.005)])
@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_blocks_find_the_dense_minimum_and_its_covariance(rng, prior, missing):
    """To rounding: the normal equations lose digits on the way, not at the end."""
    y, start = decays(rng)
    problem = Decays(y, measured=rng.random(y.shape) >= missing, prior=prior)
    solution = minimise_blocks(problem, start)
    dense = minimise(Dense(problem, 5), np.concatenate([start[0], start[1].ravel()]))
    x = np.concatenate([solution.state[0], solution.state[1].ravel()])
    assert x == pytest.approx(dense.state, rel=1e-10)
    C = cofactor(dense.jacobian, [str(i) for i in range(12)])
    known = factorise(solution.weighted, problem.shared, problem.own)
    assert known.shared == pytest.approx(C[:2, :2], rel=1e-8)
    for j in range(5):
        its = slice(2 + 2 * j, 4 + 2 * j)
        assert known.own[j] == pytest.approx(C[its, its], rel=1e-8)
        assert known.cross(j) == pytest.approx(C[:2, its], rel=1e-8)
    assert known.between(1, 3) == pytest.approx(C[4:6, 8:10], rel=1e-8)
    assert solution.blocks.dof == problem.measured.sum() + (prior is not None) - 12
    assert solution.variance == pytest.approx(dense.sum_of_squares / solution.blocks.dof, rel=1e-10)


def test_one_block_and_problems_without_own_or_without_shared_parameters(rng):
    """A single view, a camera with known poses, poses with a known camera: the same solver."""
    y, start = decays(rng)
    full = minimise_blocks(Decays(y), start)

    class Shared(Decays):
        def blocks(self, state):
            b = super().blocks((state[0], full.state[1]))
            return Blocks.of(b.r, b.by_shared, np.zeros((*b.r.shape, 0)))

    class Own(Decays):
        def blocks(self, state):
            b = super().blocks((full.state[0], state[1]))
            return Blocks.of(b.r, np.zeros((*b.r.shape, 0)), b.by_own)

        def retract(self, state, step):
            return state[0], state[1] + step.own

    shared = minimise_blocks(Shared(y), (start[0], np.zeros((5, 0))))
    assert shared.state[0] == pytest.approx(full.state[0], rel=1e-9)
    own = minimise_blocks(Own(y), start)
    assert own.state[1] == pytest.approx(full.state[1], rel=1e-9)
    assert factorise(own.blocks, (), Decays.own).own == pytest.approx(
        factorise(full.blocks, *NAMES).own_alone, rel=1e-8
    )
    J = shared.blocks.by_shared.reshape(-1, 2)
    assert factorise(shared.blocks, Decays.shared, ()).shared == pytest.approx(np.linalg.inv(J.T @ J), rel=1e-8)
    one = minimise_blocks(Decays(y[:1], prior=(1.9, 0.1)), (start[0], start[1][:1]))
    assert factorise(one.blocks, *NAMES).shared.shape == (2, 2)


NAMES = (Decays.shared, Decays.own)


def test_the_sandwich_of_the_scores_is_that_of_the_dense_ones(rng):
    """N^-1 (sum_j g_j g_j^T) N^-1 with the full gradients of the blocks, own parameters included."""
    y, start = decays(rng, k=6, noise=0.05)
    problem = Decays(y)
    solution = minimise_blocks(problem, start)
    known = factorise(solution.blocks, *NAMES)
    r, J = Dense(problem, 6).residuals_and_jacobian(np.concatenate([solution.state[0], solution.state[1].ravel()]))
    g = np.stack([J[12 * j : 12 * j + 12].T @ r[12 * j : 12 * j + 12] for j in range(6)])
    N = np.linalg.inv(J.T @ J)
    sandwich = known.shared @ (known.scores.T @ known.scores) @ known.shared
    assert sandwich == pytest.approx((N @ (g.T @ g) @ N)[:2, :2], rel=1e-6)
    assert np.abs(known.scores.sum(axis=0)).max() < 1e-8 * np.abs(known.scores).max()


class Lines:
    """y = x_j . a + z_j b_j, linear: leaving a block out has an exact answer."""

    def __init__(self, X, Z, y):
        self.X, self.Z, self.y = X, Z, y

    def blocks(self, state):
        return Blocks.of(self.X @ state[0] + self.Z * state[1] - self.y, self.X, self.Z[..., None])

    def retract(self, state, step):
        return state[0] + step.shared, state[1] + step.own


def test_the_jackknife_is_what_leaving_each_block_out_gives(rng):
    X, Z, y = rng.normal(size=(7, 9, 3)), rng.normal(size=(7, 9)), rng.normal(size=(7, 9))
    start = (np.zeros(3), np.zeros((7, 1)))
    whole = minimise_blocks(Lines(X, Z, y), start)
    keep = [np.delete(np.arange(7), j) for j in range(7)]
    left = np.array([minimise_blocks(Lines(X[i], Z[i], y[i]), (start[0], start[1][i])).state[0] for i in keep])
    d = left - whole.state[0]
    expected = d.T @ d * (6 / 7)
    assert factorise(whole.blocks, "abc", "b").jackknifed() == pytest.approx(expected, rel=1e-8)


def test_covariances_by_blocks_cover_errors_that_blocks_share(rng):
    """Each block has an error of its own along one regressor: the classical sigma is too small, the jackknife is not.

    400 problems: a covered share of 0.95 has a standard deviation of 0.011; four of them are allowed.
    """
    inside = np.zeros(2)
    for _ in range(400):
        X, Z = rng.normal(size=(30, 8, 2)) + 1.0, rng.normal(size=(30, 8))
        y = 0.1 * rng.normal(size=(30, 8)) + 0.3 * rng.normal(size=(30, 1)) * X[..., 0]
        found = minimise_blocks(Lines(X, Z, y), (np.zeros(2), np.zeros((30, 1))))
        known = factorise(found.blocks, "ab", "c")
        variances = [found.variance * known.shared[0, 0], known.jackknifed()[0, 0]]
        inside += abs(found.state[0][0]) < 1.96 * np.sqrt(variances)
    classical, jackknife = inside / 400
    assert classical < 0.75
    assert 0.95 - 0.044 < jackknife < 0.95 + 0.044


def test_a_blind_shared_combination_is_named_though_blocks_could_follow(rng):
    class Gauge(Decays):
        """A gain in place of the frequency, free while every block has its own offset: only their product is seen."""

        def blocks(self, state):
            b = super().blocks(state)
            d, c = state[0][1], state[1][:, 1:]
            A, B = b.by_shared.copy(), b.by_own.copy()
            A[..., 1], B[..., 1] = c, d
            return Blocks.of(state[1][:, :1] * np.exp(-state[0][0] * self.t) + c * d - self.y, A, B)

    y, start = decays(rng)
    solution = minimise_blocks(Gauge(y), start)
    with pytest.raises(DegenerateGeometry, match=r"do not determine frequency .*every block free to follow"):
        factorise(solution.blocks, *NAMES)


def test_a_blind_block_is_named(rng):
    y, start = decays(rng)
    measured = np.ones(y.shape, dtype=bool)
    measured[3, 1:] = False
    with pytest.raises(DegenerateGeometry, match="block left03 does not determine the combination"):
        factorise(Decays(y, measured=measured).blocks(start), *NAMES, [f"left{j:02}" for j in range(5)])


def test_blindness_is_seen_to_a_billionth(rng):
    """Two columns that differ by 1e-8: squared, they are one to rounding; the square root tells them apart."""
    X = rng.normal(size=(4, 10, 2))
    X[..., 1] = X[..., 0] + 1e-8 * X[..., 1]
    blocks = Lines(X, rng.normal(size=(4, 10)), np.zeros((4, 10))).blocks((np.zeros(2), np.zeros((4, 1))))
    known = factorise(blocks, "ab", "c")
    length = np.linalg.norm(X.reshape(-1, 2), axis=0)
    assert np.linalg.eigvalsh(known.shared * np.outer(length, length))[-1] ** -0.5 == pytest.approx(1e-8, rel=0.9)
    X[..., 1] = X[..., 0] + 1e-3 * (X[..., 1] - X[..., 0])  # 1e-11
    with pytest.raises(DegenerateGeometry, match="combination"):
        factorise(Blocks.of(blocks.r, X, blocks.by_own), "ab", "c")


@pytest.mark.parametrize("name", ["huber", "cauchy", "tukey"])
@pytest.mark.parametrize("scale", [0.01, None])
def test_robust_losses_find_the_truth_among_outliers(rng, name, scale):
    """A tenth of the points is off by 0.5: those are told, and the answer is within its sigmas as if they were not."""
    y, start = decays(rng, k=8, rows=60)
    wrong = rng.random((8, 30)) < 0.1  # points are pairs of rows
    y += np.repeat(wrong, 2, axis=1) * 0.5
    found = minimise_blocks(Decays(y), start, loss=Loss(name, scale))
    sigma = np.sqrt(found.variance * np.diag(factorise(found.weighted, *NAMES).shared))
    assert (np.abs(found.state[0] - [0.8, 1.9]) < 4 * sigma + 1e-3).all() or name == "huber"
    plain = minimise_blocks(Decays(y), start)
    assert np.abs(found.state[0] - [0.8, 1.9]).max() < 0.3 * np.abs(plain.state[0] - [0.8, 1.9]).max()
    assert found.weights[wrong].max() < 0.5 * found.weights[~wrong].mean()
    assert found.scale == pytest.approx(0.01, rel=0.5)


@pytest.mark.parametrize("name", ["huber", "cauchy", "tukey"])
def test_a_loss_is_the_integral_of_its_weights_and_efficient_to_95_percent(name):
    """The weight is the derivative of the loss; on normal noise it (E psi')^2/E psi^2 is 0.95."""
    loss = Loss(name, 2.0)
    d2 = np.linspace(0.01, 300, 2000)
    step = 1e-5
    slope = (loss.values(d2 + step, 2.0) - loss.values(d2 - step, 2.0)) / (2 * step)
    kink = (2.0 * {"huber": 1.501141, "cauchy": 1e9, "tukey": 5.122986}[name]) ** 2
    smooth = np.abs(d2 - kink) > 0.1
    assert loss.weights(d2, 2.0)[smooth] == pytest.approx(slope[smooth], abs=1e-6)
    r = np.linspace(0, 12, 400001)
    density = r * np.exp(-r * r / 2) * (r[1] - r[0])
    w, stiff = loss.weights(r * r, 1.0), loss.stiffness(r * r, 1.0)
    assert np.sum(stiff * density) ** 2 / np.sum(w * w * r * r / 2 * density) == pytest.approx(0.95, abs=1e-5)


@pytest.mark.parametrize("name", ["huber", "cauchy", "tukey"])
def test_a_robust_fit_s_covariance_and_noise_are_those_of_its_efficiency(rng, name):
    """Information 0.95 of that of least squares where the noise is stated, and the same noise where it is not.

    The inverse of the weighted normal matrix alone has sigmas 9 % too large with Cauchy's loss, 5 % with Tukey's.
    4500 points: means of weights are known to 1 %, the residuals' spread to 1 %.
    """
    y, start = decays(rng, k=30, rows=300)
    plain, robust = (minimise_blocks(Decays(y), start, loss=loss) for loss in (None, Loss(name)))
    one, other = (factorise(found.weighted, *NAMES).shared for found in (plain, robust))
    assert np.sqrt(np.diag(one) / np.diag(other)) == pytest.approx(np.sqrt(0.95), rel=0.03)
    assert np.sqrt([plain.variance, robust.variance]) == pytest.approx(0.01, rel=0.04)


@pytest.mark.slow
def test_answers_of_a_robust_fit_scatter_as_it_says(rng):
    """Of 250 draws the squared errors over their covariance are 2 in the mean, +-0.13; as it was, 1.6."""
    y, start = decays(rng, k=6, noise=0.0, rows=60)
    square = []
    for _ in range(250):
        found = minimise_blocks(Decays(y + 0.01 * rng.normal(size=y.shape)), start, loss=Loss("cauchy"))
        off = found.state[0] - [0.8, 1.9]
        square.append(off @ np.linalg.solve(0.01**2 * factorise(found.weighted, *NAMES).shared, off))
    assert np.mean(square) == pytest.approx(2, abs=2.9 * 0.13)


def test_the_noise_by_the_median_is_sigma_for_normal_noise_and_bears_a_third_outliers(rng):
    """200000 points: the median's standard deviation is 0.2 %."""
    d = np.linalg.norm(3.0 * rng.normal(size=(200000, 2)), axis=1)
    assert noise_of_the_good(d) == pytest.approx(3.0, rel=0.01)
    d[: len(d) // 3] = 1e6
    assert noise_of_the_good(d) < 2 * 3.0


def test_what_is_no_loss_or_no_start_is_refused(rng):
    with pytest.raises(UnknownName, match="unknown loss 'hubert'; did you mean 'huber'"):
        Loss("hubert")
    y, start = decays(rng)
    with pytest.raises(NotConverged, match="cannot start"):
        minimise_blocks(Decays(y), (start[0] * np.nan, start[1]))
    with pytest.raises(TooFewPoints, match="2 blocks"):
        factorise(Decays(y[:1], prior=(1.9, 0.1)).blocks((start[0], start[1][:1])), *NAMES).jackknifed()
