"""Regression on grouped data: its covariance is the scatter, and outliers or few groups do not upset it."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.fit.grouped import Groups, grouped_fit
from cadcam.native.grouped import UNKNOWNS, Tried, reweighted_fit

TRUTH = np.array([0.3, -0.2, 0.1])
FAMILY = np.repeat(np.arange(12), np.tile([2, 3, 4, 6], 3))


def data(rng: np.random.Generator, *, groups: int = 40, size: int = 12, between: float = 0.05, excess: float = 0.0):
    """Return y, J, variance, group: lines through TRUTH, each group with a design of its own and an offset."""
    group = np.repeat(np.arange(groups), size)
    J = np.repeat(rng.normal(size=(groups, 3)), size, axis=0) + 0.2 * rng.normal(size=(groups * size, 3))
    sigma = rng.uniform(0.02, 0.06, groups * size)
    noise = np.sqrt(1 + excess) * sigma * rng.normal(size=len(group))
    y = J @ TRUTH + between * rng.normal(size=groups)[group] + noise
    return y, J, sigma**2, group


@pytest.mark.parametrize(("between", "excess"), [(0.0, 0.0), (0.05, 0.0), (0.2, 1.5)])
def test_the_covariance_is_the_scatter_whatever_the_groups_do(
    between: float, excess: float, rng: np.random.Generator
) -> None:
    z2 = []
    for _ in range(120):
        y, J, variance, group = data(rng, between=between, excess=excess)
        fit = grouped_fit(y, J, variance, Groups(group), usual=0.05)
        e = fit.x - TRUTH
        z2.append(e @ np.linalg.solve(fit.covariance, e) / 3)
    assert np.mean(z2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 360))  # chi-square of 360: four of its sd


def test_leaving_the_groups_out_would_make_the_covariance_too_small(rng: np.random.Generator) -> None:
    """The negative control: the same data in groups of one datum are judged several times too sure."""
    z2 = []
    for _ in range(40):
        y, J, variance, group = data(rng, between=0.2)
        fit = grouped_fit(y, J, variance, Groups(np.arange(len(group))), usual=0.05)
        e = fit.x - TRUTH
        z2.append(e @ np.linalg.solve(fit.covariance, e) / 3)
    assert np.mean(z2) > 3


def test_both_variances_are_found(rng: np.random.Generator) -> None:
    y, J, variance, group = data(rng, groups=200, between=0.1, excess=3.0)
    fit = grouped_fit(y, J, variance, Groups(group), usual=0.05)
    assert fit.between == pytest.approx(0.1, rel=0.2)  # 200 groups: 5 percent; the grid of variances: 30
    assert fit.excess == pytest.approx(3.0, rel=0.15)  # 2200 squares: 3 percent of 4
    assert fit.dof == pytest.approx(197, abs=8)


def test_noise_told_too_small_by_one_factor_changes_nothing(rng: np.random.Generator) -> None:
    """A quarter of the variance, noisy and clear data alike: the excess makes up for it."""
    y, J, variance, group = data(rng, groups=100, excess=1.0)
    right, told_less = (grouped_fit(y, J, variance / k, Groups(group), usual=0.05) for k in (1, 4))
    assert 1 + told_less.excess == pytest.approx(4 * (1 + right.excess), rel=0.01)
    sd = np.sqrt(np.diag(right.covariance))
    assert (np.abs(told_less.x - right.x) < 0.1 * sd).all()  # they stop within 0.02 of each other's answers
    np.testing.assert_allclose(np.sqrt(np.diag(told_less.covariance)), sd, rtol=0.03)


def test_groups_and_data_that_lie_far_off_do_not_count(rng: np.random.Generator) -> None:
    y, J, variance, group = data(rng)
    y[group < 4] += 1.5  # a tenth of the edges are shadows
    lone = rng.choice(np.flatnonzero(group >= 4), 20, replace=False)
    y[lone] += 3.0
    fit = grouped_fit(y, J, variance, Groups(group), usual=0.05)
    assert (fit.of_group[:4] == 0).all()
    assert (fit.weight[lone] == 0).all()
    e = fit.x - TRUTH
    assert e @ np.linalg.solve(fit.covariance, e) / 3 < 3
    assert (
        np.abs(grouped_fit(y, J, variance, Groups(group), usual=0.05, robust=False).x - TRUTH).max() > np.abs(e).max()
    )


def test_groups_that_turn_as_well_are_met_better_where_they_are_taken_to_be_uneven(rng: np.random.Generator) -> None:
    """Offsets of sd 0.3 that change by 0.15 to both ends of a group; its design changes from end to end as well."""
    squares, z2 = [], []
    for _ in range(80):
        group, along = np.repeat(np.arange(30), 12), np.tile(np.linspace(-1, 1, 12), 30)
        turn, offset, tilt = rng.normal(size=(30, 3))[group], 0.3 * rng.normal(size=30), 0.15 * rng.normal(size=30)
        J = rng.normal(size=(30, 3))[group] + 0.3 * along[:, None] * turn
        y = J @ TRUTH + offset[group] + along * tilt[group] + 0.02 * rng.normal(size=360)
        fits = [grouped_fit(y, J, np.full(360, 4e-4), Groups(group), usual=0.05, uneven=share) for share in (0.4, 0.0)]
        errors = [fit.x - TRUTH for fit in fits]
        squares.append([e @ e for e in errors])
        z2.append([e @ np.linalg.solve(fit.covariance, e) / 3 for e, fit in zip(errors, fits, strict=True)])
    told, untold = np.mean(squares, axis=0)
    assert told < 0.75 * untold
    assert np.mean(z2, axis=0)[0] < 0.5 * np.mean(z2, axis=0)[1]


def test_few_groups_do_not_run_away(rng: np.random.Generator) -> None:
    """With nine groups and six parameters a huge variance between groups and a huge error explain each other."""
    worst = 0.0
    for _ in range(50):
        group = np.repeat(np.arange(9), 15)
        J = np.repeat(rng.normal(size=(9, 6)), 15, axis=0) + 0.1 * rng.normal(size=(135, 6))
        y = 0.05 * rng.normal(size=9)[group] + 0.1 * rng.normal(size=135)
        fit = grouped_fit(y, J, np.full(135, 0.01), Groups(group), usual=0.05)
        worst = max(worst, float(fit.x @ np.linalg.solve(fit.covariance, fit.x)) / 6)
    assert worst < 8  # the largest of 50 of an F distribution with six degrees of freedom over few


def test_exact_groups_have_no_offset(rng: np.random.Generator) -> None:
    y, J, variance, group = data(rng, between=0.2)
    exact = np.arange(40) >= 38
    y[group >= 38] = J[group >= 38] @ TRUTH
    with_them = grouped_fit(y, J, np.where(group >= 38, 1e-8, variance), Groups(group, exact=exact), usual=0.05)
    assert np.abs((J @ (with_them.x - TRUTH))[group >= 38]).max() < 1e-3


def test_gain_is_how_x_follows_the_data(rng: np.random.Generator) -> None:
    y, J, variance, group = data(rng)
    fit = grouped_fit(y, J, variance, Groups(group), usual=0.05)
    np.testing.assert_allclose(fit.gain @ J, np.eye(3), atol=1e-10)
    step = 1e-4 * rng.normal(size=len(y))
    moved = grouped_fit(y + step, J, variance, Groups(group), usual=0.05).x - fit.x
    assert np.abs(fit.gain @ step - moved).max() < 0.3 * np.abs(moved).max()  # the weights follow the data a little


def plain_average(
    y: np.ndarray, J: np.ndarray, w: np.ndarray, group: np.ndarray, counts: np.ndarray, tried: Tried
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what one round does, from the whole covariance matrix; groups that count half are half as many.

    Half a group is one of half the weights and twice the variance of its offset.
    """
    w, family, each, p = w * counts[group], tried.family[group], [], []
    for v, share, prior in zip(tried.variance, tried.share, tried.prior, strict=True):
        own = (v * tried.free + share * tried.expected) / counts
        for u, more in zip(tried.family_variance, tried.family_prior, strict=True):
            S = np.diag(1 / w) + np.where(group[:, None] == group, own[group], 0.0)
            log_det = float((counts - 1) @ [np.log1p(own[g] * w[group == g].sum()) for g in range(len(counts))])
            S += np.where(family[:, None] == family, u * tried.family_free[family], 0.0)
            W = np.linalg.inv(S)
            log_det += np.linalg.slogdet(S)[1] + np.log(w).sum() + np.linalg.slogdet(J.T @ W @ J)[1]
            x = np.linalg.solve(J.T @ W @ J, J.T @ W @ y)
            each.append((x, np.linalg.inv(J.T @ W @ J)))
            p.append(prior + more - 0.5 * (log_det + (y - J @ x) @ W @ (y - J @ x)))
    p = np.exp(np.array(p) - max(p))
    p /= p.sum()
    mean = sum(p_ * x for p_, (x, _) in zip(p, each, strict=True))
    covariance = sum(p_ * (C + np.outer(x - mean, x - mean)) for p_, (x, C) in zip(p, each, strict=True))
    return mean, covariance, p.reshape(len(tried.prior), -1)


@pytest.mark.parametrize("unit", [1.0, 1e4])
def test_the_core_averages_as_plain_matrices_do(unit: float, rng: np.random.Generator) -> None:
    """unit: of one parameter; rotations and lengths differ as much."""
    y, J, variance, group = data(rng, groups=15, size=6, between=0.1)
    J[:, 1] *= unit
    counts, free, expected = rng.uniform(0.2, 1, 15), np.arange(15.0) < 12, rng.uniform(0, 0.1, 15)
    counts[3:9] = 1.0
    variances, share, prior = np.array([0.0, 1e-4, 0.01, 1.0]), np.array([0.0, 1.0, 0.0, 1.0]), rng.uniform(-1, 0, 4)
    family, of_family = np.repeat(np.arange(6), [1, 4, 2, 3, 3, 2]), rng.uniform(0.5, 2, 6)
    of_family[5] = 0.0
    between = np.array([0.0, 1e-3, 0.1]), rng.uniform(-1, 0, 3)
    tried = Tried(free * 1.0, expected, variances, share, prior, family, of_family, *between)
    scatter = np.ones(15)
    found = reweighted_fit(y, J, variance, group, counts, scatter, tried, uneven=0.0, robust=False, rounds=1)
    x, covariance, p = plain_average(y, J, 1 / variance, group, counts, tried)
    assert found is not None
    scale = np.array([1, unit, 1])
    np.testing.assert_allclose(found.x * scale, x * scale, rtol=0, atol=1e-11)
    size = np.outer(scale, scale)
    np.testing.assert_allclose(found.covariance * size, covariance * size, rtol=1e-10, atol=1e-14)
    means = p.sum(axis=1) @ variances, p.sum(axis=1) @ share, p.sum(axis=0) @ between[0]
    np.testing.assert_allclose([found.own, found.share, found.alike], means, rtol=1e-9, atol=1e-12)  # the unlikeliest


def test_more_parameters_than_the_core_takes_are_refused(rng: np.random.Generator) -> None:
    group = np.repeat(np.arange(30), 3)
    with pytest.raises(BadValue, match=f"at most {UNKNOWNS}"):
        grouped_fit(rng.normal(size=90), rng.normal(size=(90, UNKNOWNS + 1)), np.ones(90), Groups(group), usual=0.05)


def test_what_the_data_leave_open_is_refused(rng: np.random.Generator) -> None:
    y, J, variance, group = data(rng)
    J[:, 2] = 2 * J[:, 1]
    with pytest.raises(DegenerateGeometry):
        grouped_fit(y, J, variance, Groups(group), usual=0.05)
    with pytest.raises(DegenerateGeometry):
        grouped_fit(y[:2], J[:2], variance[:2], Groups(group[:2]), usual=0.05)


def test_groups_expected_to_be_off_count_less_and_the_covariance_knows(rng: np.random.Generator) -> None:
    """Half of the groups are off by 0.3, the others by 0.02: told of it, the fit has less than half the variance."""
    off = np.repeat([0.3, 0.02], 20)
    z2, gain = [], []
    for _ in range(120):
        y, J, variance, group = data(rng, between=0.0)
        y = y + (off * rng.normal(size=40))[group]
        fits = [
            grouped_fit(y, J, variance, Groups(group, expected=expected), usual=0.05) for expected in (off**2, None)
        ]
        errors = [fit.x - TRUTH for fit in fits]
        z2.append(errors[0] @ np.linalg.solve(fits[0].covariance, errors[0]) / 3)
        gain.append([e @ e for e in errors])
    assert np.mean(z2) < 1.0 + 4 * np.sqrt(2 / 360)
    told, untold = np.mean(gain, axis=0)
    assert told < untold / 2


def test_groups_that_err_as_their_noise_does_move_x_no_more_than_noise(rng: np.random.Generator) -> None:
    """Groups of 4 and of 36 data, offsets three and one times as large: x is that of no offsets, its covariance is not.

    Untold of it, x takes all groups to be off alike, small ones less than they are.
    """
    size = np.tile([4, 36], 20)
    group = np.repeat(np.arange(40), size)
    relative = size.mean() / size
    squares, z2 = [], []
    for _ in range(120):
        J = rng.normal(size=(40, 3))[group]
        y = J @ TRUTH + (0.1 * np.sqrt(relative) * rng.normal(size=40))[group] + 0.05 * rng.normal(size=len(group))
        given, both = (y, J, np.full(len(y), 0.0025)), (Groups(group, relative=relative), Groups(group))
        told, untold = (grouped_fit(*given, groups, usual=0.05, robust=False) for groups in both)
        np.testing.assert_allclose(told.x, np.linalg.lstsq(J, y)[0], atol=1e-9)
        errors = [fit.x - TRUTH for fit in (told, untold)]
        squares.append([e @ e for e in errors])
        z2.append(errors[0] @ np.linalg.solve(told.covariance, errors[0]) / 3)
    assert np.mean(z2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 360))  # chi-square of 360: four of its sd
    assert np.mean(squares, axis=0)[0] < 0.8 * np.mean(squares, axis=0)[1]


def families(rng: np.random.Generator, *, alike: float, own: float) -> tuple[np.ndarray, ...]:
    """Return y, J, variance, group: 12 lines (FAMILY) of 2 to 6 pieces, which are off together and each by itself."""
    group = np.repeat(np.arange(45), 8)
    J = (rng.normal(size=(12, 3))[FAMILY] + 0.2 * rng.normal(size=(45, 3)))[group]
    off = alike * rng.normal(size=12)[FAMILY] + own * rng.normal(size=45)
    return J @ TRUTH + off[group] + 0.05 * rng.normal(size=360), J, np.full(360, 0.0025), group


@pytest.mark.parametrize(("alike", "own"), [(0.1, 0.03), (0.1, 0.0), (0.0, 0.1), (0.0, 0.0)])
def test_pieces_of_one_line_that_err_alike_leave_the_covariance_true(
    alike: float, own: float, rng: np.random.Generator
) -> None:
    """Not told of the lines, pieces seem to say more than they do; of no offsets at all 12 lines cannot be sure."""
    z2 = []
    for _ in range(120):
        y, J, variance, group = families(rng, alike=alike, own=own)
        fits = [grouped_fit(y, J, variance, Groups(group, family=f), usual=0.05) for f in (FAMILY, None)]
        z2.append([float((f.x - TRUTH) @ np.linalg.solve(f.covariance, f.x - TRUTH)) / 3 for f in fits])
    told, untold = np.mean(z2, axis=0)
    assert told < 1.0 + 4 * np.sqrt(2 / 360)  # chi-square of 360: four of its sd
    if alike or own:
        assert told > 1.0 - 4 * np.sqrt(2 / 360)
    if alike:
        assert untold > 1.0 + 4 * np.sqrt(2 / 360)


def test_what_lines_have_in_common_is_told_from_what_their_pieces_have(rng: np.random.Generator) -> None:
    """Of 40 pictures: each tells a variance between 12 lines to 40 %, so their mean to 7 %, the grid apart."""
    fits = []
    for _ in range(40):
        y, J, variance, group = families(rng, alike=0.1, own=0.03)
        fits.append(grouped_fit(y, J, variance, Groups(group, family=FAMILY), usual=0.05))
    assert np.sqrt(np.mean([f.alike**2 for f in fits])) == pytest.approx(0.1, rel=0.3)
    own2 = [f.between**2 - f.alike**2 for f in fits]
    assert np.sqrt(np.mean(own2)) == pytest.approx(0.03, rel=0.5)
    assert np.median([f.dof for f in fits]) < 20  # of 9 by lines and 42 by pieces


def test_gain_follows_what_lines_have_in_common(rng: np.random.Generator) -> None:
    """By 45 pieces with offsets of their own and of lines, as whole matrices have it."""
    y, J, variance, group = families(rng, alike=0.1, own=0.05)
    fit, line = grouped_fit(y, J, variance, Groups(group, family=FAMILY), usual=0.05, robust=False), FAMILY[group]
    own, seen = fit.between**2 - fit.alike**2, variance * (1 + fit.excess) + fit.within**2
    V = np.diag(seen) + own * (group[:, None] == group) + fit.alike**2 * (line[:, None] == line)
    plain = np.linalg.solve(J.T @ np.linalg.solve(V, J), np.linalg.solve(V, J).T)
    np.testing.assert_allclose(fit.gain, plain, atol=0.02 * np.abs(plain).max())  # of the last but one spread


def test_what_is_expected_of_groups_but_is_not_there_costs_nothing(rng: np.random.Generator) -> None:
    """Groups are off by nothing: told that half of them are, the fit is as good as untold. Believing it costs half."""
    off = np.repeat([0.3, 0.02], 20)
    squares = []
    for _ in range(120):
        y, J, variance, group = data(rng, between=0.0)
        fits = [
            grouped_fit(y, J, variance, Groups(group, expected=expected), usual=0.05) for expected in (off**2, None)
        ]
        squares.append([float(np.sum((fit.x - TRUTH) ** 2)) for fit in fits])
    told, untold = np.mean(squares, axis=0)
    assert told < 1.1 * untold


def test_what_is_exact_tells_nothing_of_the_scatter(rng: np.random.Generator) -> None:
    """Degrees of freedom are those of the groups that scatter, less what they have to determine by themselves."""
    y, J, variance, group = data(rng)
    alone = grouped_fit(y, J, variance, Groups(group), usual=0.05)
    assert 40 - 3 - 3 < alone.dof <= 40 - 3
    for sigma, unknowns in ((1e3, 3), (1e-6, 0)):  # that say nothing, or all
        more = rng.normal(size=(200, 3))
        of, exact = np.concatenate([group, 40 + np.arange(200)]), np.arange(240) >= 40
        known = np.concatenate([variance, np.full(200, sigma**2)])
        there, rows = np.concatenate([y, more @ TRUTH]), np.concatenate([J, more])
        fit = grouped_fit(there, rows, known, Groups(of, exact=exact), usual=0.05)
        assert fit.dof == pytest.approx(fit.of_group[:40].sum() - unknowns, abs=0.01)


def test_an_unknown_with_a_prior_costs_no_degree_of_freedom_more_than_it_explains(rng: np.random.Generator) -> None:
    y, J, variance, group = data(rng)
    rows = np.block([[J, rng.normal(size=(len(y), 1))], [np.zeros(3), np.ones(1)]])
    of, exact = np.append(group, 40), np.arange(41) == 40
    for sigma, unknowns in ((1e-7, 3), (1e3, 4)):
        known = np.append(variance, sigma**2)
        fit = grouped_fit(np.append(y, 0.0), rows, known, Groups(of, exact=exact), usual=0.05)
        assert fit.dof == pytest.approx(fit.of_group[:40].sum() - unknowns, abs=0.01)
