"""Predicted uncertainties against sampling; the rate of false alarms at its nominal level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from cadcam.arrays import Array
from cadcam.errors import DegenerateGeometry
from cadcam.verify.adjustment.alarms import either, false_discoveries_below, surely_below, tail_probability
from cadcam.verify.adjustment.datum_fit import Adjustment, FittedPose
from cadcam.verify.adjustment.refits import Refits
from cadcam.verify.adjustment.scatter import EdgeNoise, common_error, improbability, white_scale

EDGES, PLACES, SIGMA = 24, 30, 0.15


def geometry(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return edge numbers (N,), positions along them (N,) px and a pose's Jacobian (N, 6)."""
    edge = np.repeat(np.arange(EDGES), PLACES)
    along = np.tile(4.0 * (np.arange(PLACES) - (PLACES - 1) / 2), EDGES)
    normal = np.repeat(rng.normal(size=(EDGES, 3)), PLACES, axis=0)
    p = np.repeat(rng.normal(0, 100, (EDGES, 3)), PLACES, axis=0) + along[:, None] * np.repeat(
        rng.normal(size=(EDGES, 3)), PLACES, axis=0
    )
    return edge, along, np.concatenate([normal, np.cross(p, normal)], axis=1)


def sampled(rng: np.random.Generator, noise: EdgeNoise, J: Array, C: Array, xi: Array) -> Array:
    common = noise.tau[noise.edge] * np.einsum("ni,ni->n", noise.Z, rng.normal(size=(EDGES, 2))[noise.edge])
    return np.asarray(J @ xi + C @ rng.normal(size=C.shape[1]) + rng.normal(0, noise.sigma) + common)


@pytest.mark.parametrize("tau", [0.0, 0.1])
def test_a_displacement_errs_as_its_covariance_says(rng: np.random.Generator, tau: float) -> None:
    """400 drawings: chi-square of the two components over 800 degrees of freedom, within four of its sigmas.

    Noise, edges' own errors, pose and calibration all are in it; without any one of them it would be off by more.
    """
    edge, along, J = geometry(rng)
    C = 0.05 * rng.normal(size=(len(edge), 3))
    noise = EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, tau)
    rows = edge < 3
    design = J[rows, :2]
    square = 0.0
    for _ in range(400):
        y = sampled(rng, noise, J, C, rng.normal(0, [0.2] * 3 + [2e-3] * 3))
        adjustment = Adjustment(y, J, C, noise, np.ones(len(edge), bool))
        found = adjustment.estimate(rows, design, adjustment.pose(without=rows))
        square += float(found.value @ np.linalg.solve(found.covariance, found.value))
    assert abs(square / 800 - 1) < 4 * np.sqrt(2 / 800)


def test_the_pose_is_that_of_the_datum_s_offsets_alone(rng: np.random.Generator) -> None:
    """Also of edges that belong to the datum in part: by the dense covariance of what is left, to rounding."""
    edge, along, J = geometry(rng)
    C = 0.05 * rng.normal(size=(len(edge), 3))
    noise = EdgeNoise.of(rng.uniform(0.5, 2, len(edge)) * SIGMA, edge, along, 0.1)
    y, datum = rng.normal(0, 0.3, len(edge)), rng.random(len(edge)) < 0.7
    datum[edge < 5] = edge[edge < 5] < 3
    out = edge == 7
    used = datum & ~out
    Z = noise.Z[:, :, None] * np.eye(EDGES)[edge][:, None]  # (N, 2, edges)
    V = np.diag(noise.sigma**2) + noise.tau[0] ** 2 * np.einsum("nie,mie->nm", Z, Z)
    W = np.linalg.solve(V[np.ix_(used, used)], np.column_stack([J, y, C])[used])
    solved = np.linalg.solve(J[used].T @ W[:, :6], J[used].T @ W[:, 6:])
    found = Adjustment(y, J, C, noise, datum).pose(without=out)
    np.testing.assert_allclose(found.xi, solved[:, 0], rtol=1e-8)
    np.testing.assert_allclose(found.by_cause, solved[:, 1:], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(J[used].T @ W[:, :6]), rtol=1e-7, atol=1e-14)


def test_each_cause_is_felt(rng: np.random.Generator) -> None:
    """Leaving any cause out of the covariance makes it smaller: none of them is zero, and they add up."""
    edge, along, J = geometry(rng)
    C = 0.05 * rng.normal(size=(len(edge), 3))
    noise = EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, 0.1)
    rows = edge < 3
    adjustment = Adjustment(np.zeros(len(edge)), J, C, noise, np.ones(len(edge), bool))
    found = adjustment.estimate(rows, J[rows, :2], adjustment.pose(without=rows))
    causes = (found.noise, found.edges, found.pose, found.calibration)
    for cause in causes:
        assert np.linalg.eigvalsh(cause)[0] > 0
    np.testing.assert_allclose(sum(causes), found.covariance, rtol=1e-9)


def test_a_calibration_error_that_the_pose_follows_does_not_count(rng: np.random.Generator) -> None:
    """C = J: the cameras' errors look like a motion of the part; deviations against its datum know nothing of them."""
    edge, along, J = geometry(rng)
    noise = EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, 0.05)
    rows = edge < 3
    adjustment = Adjustment(np.zeros(len(edge)), J, J[:, :3].copy(), noise, np.ones(len(edge), bool))
    found = adjustment.estimate(rows, J[rows, :2], adjustment.pose(without=rows))
    assert np.abs(found.calibration).max() < 1e-12 * np.abs(found.noise).max() + 1e-20


def test_the_common_error_of_edges_is_recovered(rng: np.random.Generator) -> None:
    """Mean of 40 estimates within four standard errors of the truth; noise alone gives nearly none."""
    edge, along, J = geometry(rng)
    sigma, none = np.full(len(edge), SIGMA), np.zeros((len(edge), 0))
    for tau in (0.0, 0.08):
        noise = EdgeNoise.of(sigma, edge, along, tau)
        plain = EdgeNoise.of(sigma, edge, along, 0.0)
        found = [common_error(sampled(rng, noise, J, none, np.zeros(6)), plain, J) for _ in range(40)]
        if tau:
            assert abs(np.mean(found) - tau) < 4 * np.std(found) / np.sqrt(40)
        else:
            assert np.mean(found) < 0.02


def test_what_cameras_do_to_edges_is_not_taken_for_errors_of_their_own(rng: np.random.Generator) -> None:
    """Ten edges whose lens is known poorly: bent by it, they had 169 px in common, and fitted a motion of 252 px.

    Mean of 40 estimates within four standard errors of the truth, which has what cameras do beside it; without that
    they are far larger. What moves no edge is not fitted.
    """
    edge, along, J = geometry(rng)
    bend = np.cos(along / 30.0 + edge)[:, None] * rng.normal(size=(EDGES, 2))[edge]
    C = np.column_stack([0.5 * bend, 0.3 * rng.normal(size=(EDGES, 2))[edge], np.full(len(edge), 1e-6)])
    tau, every = 0.08, np.ones(EDGES, bool)
    noise, plain = (EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, t) for t in (tau, 0.0))
    told, untold = [], []
    for _ in range(40):
        y = sampled(rng, noise, J, C, np.zeros(6))
        adjustment = Adjustment(y, J, C, plain, np.ones(len(edge), bool))
        cameras, rows = adjustment.by_cameras(), np.ones(len(edge), bool)
        assert cameras.shape == (len(edge), 4)
        with_cameras = adjustment.sums_of(rows, beside=cameras)
        refits = Refits(adjustment.sums_of(rows), with_cameras, plain.tau)
        told.append(refits.common_error(every, np.zeros(0, np.int64), with_cameras.of_none(), usual=None))
        untold.append(common_error(y, plain, J))
    assert abs(np.mean(told) - tau) < 4 * np.std(told) / np.sqrt(40)
    assert np.mean(untold) > 2 * tau


def test_the_common_error_beside_cameras_is_that_of_the_dense_covariance(rng: np.random.Generator) -> None:
    """The restricted likelihood of offsets whose covariance has what cameras do as stated, to the search's 1 %."""
    edge, along, J = geometry(rng)
    C = 0.03 * rng.normal(size=(EDGES, 10))[edge]
    noise, plain = (EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, t) for t in (0.08, 0.0))
    y, rows = sampled(rng, noise, J, C, np.zeros(6)), np.ones(len(edge), bool)
    adjustment = Adjustment(y, J, C, plain, rows)
    with_cameras = adjustment.sums_of(rows, beside=adjustment.by_cameras())
    refits = Refits(adjustment.sums_of(rows), with_cameras, plain.tau)
    found = refits.common_error(np.ones(EDGES, bool), np.zeros(0, np.int64), with_cameras.of_none(), usual=None)
    same = edge[:, None] == edge

    def loss(log_tau: float) -> float:
        V = np.diag(plain.sigma**2) + np.exp(2 * log_tau) * same * (plain.Z @ plain.Z.T) + C @ C.T
        W = np.linalg.solve(V, np.column_stack([J, y]))
        N = J.T @ W
        x = np.linalg.solve(N[:, :-1], N[:, -1])
        return float(np.linalg.slogdet(V)[1] + np.linalg.slogdet(N[:, :-1])[1] + y @ (W[:, -1] - W[:, :-1] @ x))

    dense = minimize_scalar(loss, bounds=(np.log(1e-3), np.log(1.0)), method="bounded", options={"xatol": 1e-3})
    assert found == pytest.approx(float(np.exp(dense.x)), rel=0.011)


def test_few_edges_that_happen_to_agree_do_not_say_that_edges_never_err(rng: np.random.Generator) -> None:
    """Three edges, one motion: without a usual error half of the estimates are next to nothing, with it none is.

    What many edges say is believed: of 24 the logarithm of a usual error eight times too small moves theirs by 1/40.
    """
    edge, along, J = geometry(rng)
    few, one, none = edge < 3, J[:, :1], np.zeros((len(edge), 0))
    sigma, usual = np.full(len(edge), SIGMA), 0.01
    noise, plain = EdgeNoise.of(sigma, edge, along, usual), EdgeNoise.of(sigma, edge, along, 0.0)
    some = EdgeNoise.of(sigma[few], edge[few], along[few], 0.0)
    offsets = [sampled(rng, noise, J, none, np.zeros(6))[few] for _ in range(40)]
    assert np.median([common_error(y, some, one[few]) for y in offsets]) < usual / 2
    told = [common_error(y, some, one[few], usual=usual) for y in offsets]
    assert usual / np.e < min(told)
    assert max(told) < 10 * usual
    err = EdgeNoise.of(sigma, edge, along, 8 * usual)
    many = [common_error(sampled(rng, err, J, none, np.zeros(6)), plain, J, usual=usual) for _ in range(40)]
    assert abs(np.mean(many) / (8 * usual) - 1) < 1 / 40 + 4 * np.std(many) / np.mean(many) / np.sqrt(40)


def test_a_value_is_as_sure_as_few_edges_know_their_errors(rng: np.random.Generator) -> None:
    """600 drawings of what edges err by and of four of them, one motion fitted: 95 % of another edge lie in 2 sigma.

    Within four standard errors below. By the likeliest error alone it would be 91 %.
    """
    edge, along, J = geometry(rng)
    few, other, usual, inside = edge < 4, edge == 4, 0.01, 0
    plain = EdgeNoise.of(np.full(len(edge), SIGMA / 5), edge, along, 0.0)
    for _ in range(600):
        noise = replace(plain, tau=np.full(EDGES, usual * np.exp(rng.normal())))
        y = sampled(rng, noise, J, J[:, :0], np.zeros(6))
        tau = common_error(y[few], plain.of_rows(few), J[few], usual=usual)
        adjustment = Adjustment(y, J, J[:, :0], replace(plain, tau=np.full(EDGES, tau)), few)
        variances, value = adjustment.mean(other, np.ones(PLACES), adjustment.pose())
        inside += abs(value) < 2 * np.sqrt(variances.sum())
    assert inside / 600 > 0.9545 - 4 * np.sqrt(0.0455 * 0.9545 / 600)


def test_an_edge_that_is_known_to_err_does_not_make_the_others_err(rng: np.random.Generator) -> None:
    """One edge is off by 50 times what the others are: told so, what they have in common is found as without it."""
    edge, along, J = geometry(rng)
    sigma, none, tau, one = np.full(len(edge), SIGMA), np.zeros((len(edge), 0)), 0.08, np.where(edge == 0, 4.0, 0.0)
    noise = EdgeNoise.of(sigma, edge, along, tau).with_more(one)
    told = EdgeNoise.of(sigma, edge, along, 0.0).with_more(one)
    found = [common_error(sampled(rng, noise, J, none, np.zeros(6)), told, J) for _ in range(40)]
    assert abs(np.mean(found) - tau) < 4 * np.std(found) / np.sqrt(40)


def test_the_scale_of_the_noise_is_recovered_whatever_the_edges_do(rng: np.random.Generator) -> None:
    """One edge's ratio scatters by sqrt(2/28) = 0.27, the root of the median of 24 by 0.034: four of that."""
    edge, along, J = geometry(rng)
    noise = EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, 0.3)
    y = sampled(rng, EdgeNoise.of(1.7 * noise.sigma, edge, along, 0.3), J[:, :0], J[:, :0], np.zeros(0))
    assert white_scale(y, noise) == pytest.approx(1.7, rel=0.14)


def test_the_inverse_covariance_is_that_of_the_full_matrix(rng: np.random.Generator) -> None:
    edge, along, _ = geometry(rng)
    keep = edge < 4
    noise = EdgeNoise.of(rng.uniform(0.1, 0.3, int(keep.sum())), edge[keep], along[keep], 0.2)
    V = np.diag(noise.sigma**2)
    for e in range(4):
        Z = noise.Z * (noise.edge == e)[:, None]
        V += 0.2**2 * Z @ Z.T
    X = rng.normal(size=(len(noise.sigma), 3))
    np.testing.assert_allclose(noise.white(X), np.linalg.solve(V, X), rtol=1e-9, atol=1e-9)
    assert noise.log_determinant() == pytest.approx(np.linalg.slogdet(V)[1], rel=1e-12)


def test_a_datum_that_leaves_a_motion_free_is_refused_naming_it(rng: np.random.Generator) -> None:
    edge, along, J = geometry(rng)
    J[:, 2] = 0.0
    noise = EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, 0.0)
    adjustment = Adjustment(np.zeros(len(edge)), J, J[:, :0], noise, np.ones(len(edge), bool))
    with pytest.raises(DegenerateGeometry, match=r"translation \[0.0, -?0.0, -?1.0"):
        adjustment.pose()


def test_false_alarms_come_as_rarely_as_asked(rng: np.random.Generator) -> None:
    """20 features in place, 4000 pictures, 5 %: the share with any alarm within four standard errors of it."""
    alarms = [false_discoveries_below(rng.uniform(size=20), 0.05).any() for _ in range(4000)]
    assert abs(np.mean(alarms) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 4000)


def test_real_displacements_do_not_make_the_others_suspect(rng: np.random.Generator) -> None:
    """Five of 20 displaced beyond doubt: of all alarms at most 5 % are false, on average."""
    false = []
    for _ in range(2000):
        p = np.concatenate([np.full(5, 1e-12), rng.uniform(size=15)])
        found = false_discoveries_below(p, 0.05)
        assert found[:5].all()
        false.append(found[5:].sum() / found.sum())
    assert np.mean(false) < 0.05


def test_what_was_not_tested_raises_no_alarm() -> None:
    assert false_discoveries_below([np.nan, 1e-9, np.nan], 0.01).tolist() == [False, True, False]
    assert surely_below([np.nan, 1e-9, np.nan], 0.01).tolist() == [False, True, False]


def test_beside_real_displacements_any_false_alarm_is_as_rare_as_asked(rng: np.random.Generator) -> None:
    """Five of 20 displaced beyond doubt, 4000 pictures, 5 %: the share with an alarm within four standard errors."""
    false = []
    for _ in range(4000):
        found = surely_below(np.concatenate([np.full(5, 1e-12), rng.uniform(size=15)]), 0.05)
        assert found[:5].all()
        false.append(found[5:].any())
    assert abs(np.mean(false) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 4000)


def test_two_tests_of_the_same_edges_raise_no_more_alarms_than_one() -> None:
    """The same one, its opposite, another one; 4 sigma of 100,000 draws.

    Half as many again, at the most: where the other is small just where the first is evidence, but not enough.
    """
    rng = np.random.default_rng(4)
    p, another = rng.uniform(size=(2, 100_000))
    for other in (p, 1 - p, another):
        both = np.array([either(a, b) for a, b in zip(p, other, strict=True)])
        for share in (0.05, 0.01, 0.001):
            assert (both <= share).mean() <= share + 4 * np.sqrt(share / len(p))
    worst = np.where(p < 0.005, p + 0.01, np.where((p > 0.01) & (p < 0.015), p - 0.01, p))  # as uniform as p
    both = np.array([either(a, b) for a, b in zip(p, worst, strict=True)])
    assert (both <= 0.01).mean() == pytest.approx(0.015, abs=4 * np.sqrt(0.015 / len(p)))
    assert either(0.014, 1e-9) == 2e-9
    assert either(0.94, 1e-9) == 0.94


def test_edges_that_disagree_make_the_uncertainty_larger_by_as_much(rng: np.random.Generator) -> None:
    """Edges ten times worse than they say: chi-square over its degrees of freedom is near 100, sigma ten times larger.

    Eight edges leave 14 degrees of freedom: the ratio scatters by sqrt(2/14) = 0.38, four of that below and above.
    """
    edge, along, J = geometry(rng)
    keep = edge < 8
    told = EdgeNoise.of(np.full(int(keep.sum()), SIGMA), edge[keep], along[keep], 0.05)
    y = sampled(rng, EdgeNoise.of(told.sigma, edge[keep], along[keep], 0.5), J[keep], J[keep, :0], np.zeros(6))
    adjustment = Adjustment(y, J[keep], J[keep, :0], told, np.ones(len(y), bool))
    rows, fixed = np.ones(len(y), bool), FittedPose(np.zeros(6), np.zeros((6, 6)), np.zeros((6, 0)))
    plain = adjustment.estimate(rows, J[keep, :2], fixed)
    enlarged = adjustment.estimate(rows, J[keep, :2], fixed, enlarged=True)
    assert 100 * (1 - 4 * 0.38) < plain.misfit < 100 * (1 + 4 * 0.38)
    np.testing.assert_allclose(enlarged.covariance, plain.misfit * plain.covariance, rtol=1e-9)


def test_a_displacement_drawn_as_its_prior_says_errs_as_its_covariance_says(rng: np.random.Generator) -> None:
    """Three components of sigma 0.7, one of them hardly seen, drawn 400 times: chi-square within four of its sigmas."""
    edge, along, J = geometry(rng)
    rows = edge < 4
    noise = EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, 0.02)
    fixed = FittedPose(np.zeros(6), np.zeros((6, 6)), np.zeros((6, 0)))
    design = J[rows, :3] * [1.0, 1.0, 0.02]
    square = 0.0
    for _ in range(400):
        y, d = sampled(rng, noise, J, J[:, :0], np.zeros(6)), rng.normal(0, 0.7, 3)
        y[rows] += design @ d
        adjustment = Adjustment(y, J, J[:, :0], noise, np.ones(len(edge), bool))
        error = (found := adjustment.estimate(rows, design, fixed, prior=0.7)).value - d
        square += float(error @ np.linalg.solve(found.covariance, error))
    assert abs(square / 1200 - 1) < 4 * np.sqrt(2 / 1200)


def test_the_body_that_is_off_explains_most_if_it_may_be_displaced(rng: np.random.Generator) -> None:
    """Three of 24 edges are displaced by 1 px as one: were it any other three, the offsets would be less probable."""
    edge, along, J = geometry(rng)
    noise = EdgeNoise.of(np.full(len(edge), SIGMA), edge, along, 0.02)
    y = sampled(rng, noise, J, J[:, :0], np.zeros(6)) + J[:, 0] * (edge // 3 == 5)
    loss = [improbability(y, noise, J, 2.0 * J[:, :3] * (edge // 3 == i)[:, None]) for i in range(EDGES // 3)]
    assert int(np.argmin(loss)) == 5


def test_the_restricted_likelihood_is_that_of_the_full_matrix(rng: np.random.Generator) -> None:
    edge, along, J = geometry(rng)
    keep = edge < 6
    J, K = J[keep], 0.3 * rng.normal(size=(int(keep.sum()), 2))
    noise = EdgeNoise.of(rng.uniform(0.1, 0.3, len(J)), edge[keep], along[keep], 0.2)
    y = rng.normal(size=len(J))
    V = np.diag(noise.sigma**2) + K @ K.T
    for e in range(6):
        Z = noise.Z * (noise.edge == e)[:, None]
        V += 0.2**2 * Z @ Z.T
    r = y - J @ np.linalg.solve(J.T @ np.linalg.solve(V, J), J.T @ np.linalg.solve(V, y))
    expected = np.linalg.slogdet(V)[1] + np.linalg.slogdet(J.T @ np.linalg.solve(V, J))[1] + r @ np.linalg.solve(V, r)
    assert improbability(y, noise, J, K) == pytest.approx(expected, rel=1e-9)


def test_tail_probabilities_are_uniform_where_nothing_is_displaced(rng: np.random.Generator) -> None:
    """Kolmogorov's distance of 2000 of them, the covariance scaled as if known to 12 degrees of freedom."""
    from scipy.stats import kstest

    root = rng.normal(size=(2, 2))
    V = root @ root.T
    p = [tail_probability(root @ rng.normal(size=2), V * rng.chisquare(12) / 12, 12.0) for _ in range(2000)]
    assert kstest(p, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("places", [1, 2, 30])
def test_edges_of_few_places_tell_no_more_of_their_scatter_than_they_have(
    places: int, rng: np.random.Generator
) -> None:
    """What is left about lines is chi-square of the places less what the lines took: of one place an offset alone."""
    left = []
    for _ in range(200):
        edge = np.repeat(np.arange(6), places)
        noise = EdgeNoise.of(np.full(len(edge), SIGMA), edge, 4.0 * rng.uniform(5, 10, len(edge)), 0.0)
        within, lines = noise.about_lines(rng.normal(0, SIGMA, len(edge)))
        assert lines == 6 * min(places, 2)
        left.append(within)
    freedom = 6 * places - 6 * min(places, 2)
    assert np.mean(left) == pytest.approx(freedom, abs=1e-9 + 4 * np.sqrt(2 * freedom / 200))
