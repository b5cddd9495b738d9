"""Tables 2.14 to 2.22 of the dissertation: what is reproduced, and what its own numbers cannot be.

The dissertation's noise is sqrt(SS/22) a coordinate: 0.5122 px in position 1, 0.6048 px in position 2.
"""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.calibrate.variability.alternating import alternating_externals
from cadcam.calibrate.variability.methods import (
    first_order_variability,
    log_likelihood,
    markov_chain_variability,
    monte_carlo_variability,
    walk_of,
)
from cadcam.camera.extended_pinhole import NAMES
from cadcam.camera.lens import BrownConrady

DEGREES = np.where(np.isin(NAMES, ("a", "b", "c", "skew")), np.degrees(1.0), 1.0)
DRAWS = 2000  # as the thesis has
U0_V0 = [NAMES.index("U0"), NAMES.index("V0")]


def index(*names):
    return [NAMES.index(name) for name in names]


@pytest.fixture(scope="module")
def linear(points, size):
    """Both positions by the thesis' own transform, C23 = 1."""
    return {i: calibrate_camera(points("2_7", i), size, method="dlt-c23") for i in (1, 2)}


@pytest.fixture(scope="module")
def best(points, size):
    return {i: calibrate_camera(points("2_7", i), size) for i in (1, 2)}


def thesis_noise(estimate):
    return float(np.sqrt(estimate.sum_of_squares / 22))


@pytest.fixture(scope="module")
def method_a(linear):
    """2000 draws of each position, estimated as the thesis does."""
    return {
        i: monte_carlo_variability(
            e, rng=np.random.default_rng(i), draws=DRAWS, sigma_px=thesis_noise(e), method="dlt-c23"
        )
        for i, e in linear.items()
    }  # fmt: skip


@pytest.fixture(scope="module")
def method_b(best, linear):
    return markov_chain_variability(
        best[1], rng=np.random.default_rng(3), walk=walk_of(200_000), sigma_px=thesis_noise(linear[1])
    )


@pytest.fixture(scope="module")
def printed(shared):
    """The rows of a table by number, as arrays; names and comments left out."""

    def rows(number):
        lines = shared(f"thesis/tables/table_{number}.csv").read_text().splitlines()
        return np.array([[float(x) for x in s.split(",")[1:]] for s in lines if s[0] != "#" and s[:2] != "k,"])

    return rows


def test_the_noise_is_what_golden_says(golden, linear):
    for i, noise in ((1, 0.5122), (2, 0.6048)):
        assert thesis_noise(linear[i]) == pytest.approx(noise, abs=5e-5)


@pytest.mark.parametrize("position", [1, 2])
def test_method_a_gives_the_golden_means_sigmas_and_correlations(golden, method_a, position):
    """The tolerances of golden.json: 4 standard errors of 2000 draws."""
    study = method_a[position]
    for what, value in (
        ("sd", DEGREES * study.sigma), ("mean", DEGREES * study.mean), ("corr", study.correlation)
    ):  # fmt: skip
        entry = golden(f"mcA.pos{position}.{what}")
        assert np.all(np.abs(value - np.array(entry["value"])) <= np.array(entry["tol"])), what


@pytest.mark.parametrize(("position", "number"), [(1, "2_14"), (2, "2_19")])
def test_method_a_gives_the_printed_means_and_sigmas(printed, method_a, position, number):
    """4.5 standard errors of the 2000 printed and 2000 own draws, and half a printed digit."""
    _, mean, sd = printed(number)[:, :3].T
    sigma = DEGREES * method_a[position].sigma
    error = np.sqrt(1 / DRAWS + 1 / DRAWS)
    half_digit = np.array([0.005] * 6 + [5e-6, 0.005, 5e-6, 0.005, 0.005])
    assert np.all(np.abs(mean - DEGREES * method_a[position].mean) < 4.5 * error * sigma + half_digit)
    assert np.all(np.abs(sd - sigma) < 4.5 * error / np.sqrt(2) * sigma + half_digit)


@pytest.mark.parametrize(("position", "number"), [(1, "2_14"), (2, "2_19")])
def test_the_printed_extremes_are_those_of_2000_draws(printed, method_a, position, number):
    """Of M normal draws the largest is below x with probability Phi(x)^M: each within its central 99.9 %."""
    from scipy.special import ndtri

    _, mean, _, low, high = printed(number)[:, :5].T
    sigma = DEGREES * method_a[position].sigma
    nearest, farthest = (float(ndtri(p ** (1 / DRAWS))) for p in (5e-4, 1 - 5e-4))
    for extreme in ((mean - low) / sigma, (high - mean) / sigma):
        assert np.all((nearest < extreme) & (extreme < farthest))


@pytest.mark.parametrize(("position", "number"), [(1, "2_15"), (2, "2_20")])
def test_method_a_gives_the_printed_correlations(printed, method_a, position, number):
    """4.5 standard errors (1 - r^2)/sqrt(M) of both, and half a printed digit."""
    r = method_a[position].correlation
    tolerance = 4.5 * np.sqrt(1 / DRAWS + 1 / DRAWS) * (1 - r**2) + 0.0051
    assert np.all(np.abs(printed(number) - r) < tolerance)


def test_the_columns_of_table_2_14_are_exact_mean_sd_min_max(printed, linear):
    """The scanned heads are shifted by a cell; read so, the columns are in order and the first is Table 2.9."""
    exact, mean, sd, low, high, mean_b, sd_b = printed("2_14").T
    assert exact == pytest.approx(DEGREES * linear[1].values, abs=0.0051)
    assert np.all((low < mean) & (mean < high))
    assert np.all((sd > 0) & (sd < high - low))
    assert np.all((low < mean_b) & (mean_b < high))
    assert np.all((sd_b / sd > 0.9) & (sd_b / sd < 1.3))


def test_the_shift_of_the_mean_is_the_linear_transforms_bias(linear, method_a, best):
    """Table 2.14: the mean focal length lies 4.8 px below the exact one; it goes with the noise squared.

    Least squares at the same noise is off by less than a twentieth of a sigma.
    """
    focal = NAMES.index("focal")
    shift = (method_a[1].mean - method_a[1].exact)[focal]
    half = monte_carlo_variability(
        linear[1], rng=np.random.default_rng(8), sigma_px=thesis_noise(linear[1]) / 2, method="dlt-c23", draws=3000
    )
    error = half.mean_error[focal]
    assert shift == pytest.approx(-4.85, abs=4 * method_a[1].mean_error[focal])
    assert (half.mean - half.exact)[focal] == pytest.approx(shift / 4, abs=4 * error)
    least = monte_carlo_variability(best[1], rng=np.random.default_rng(9), draws=3000, sigma_px=thesis_noise(linear[1]))
    assert np.all(np.abs(least.mean - least.exact) < 0.05 * least.sigma + 4 * least.mean_error)


def test_method_b_has_the_spread_of_method_a(method_a, method_b):
    """Least squares is up to 7 % sharper than the linear transform (a, b, c, U0, V0): the sigmas differ by no more."""
    ratio = method_b.sigma / method_a[1].sigma
    assert method_b.effective.min() > 3000
    assert np.all((ratio > 0.88) & (ratio < 1.05))
    assert np.abs(method_b.correlation - method_a[1].correlation).max() < 0.12


def test_method_b_gives_the_printed_correlations_that_matter(printed, method_b):
    """Table 2.16: b-U0, a-V0 and Z-focal; the small ones are those of a chain that has not mixed."""
    table, r = printed("2_16"), method_b.correlation
    for one, other in (("b", "U0"), ("a", "V0"), ("Z", "focal")):
        i, j = index(one, other)
        assert r[i, j] == pytest.approx(table[i, j], abs=0.02)


def implied_draws(mean, first, centre):
    """How many independent draws about `centre` have a mean as far off: chi-square over squared distance."""
    off = mean / DEGREES - centre
    return len(off) / float(off @ np.linalg.solve(first.covariance, off))


def test_the_printed_method_b_is_a_chain_that_has_not_mixed(printed, best, linear, method_b):
    """A million steps, but means as far off as those of some eight independent draws, wherever they are centred.

    Our own chain of a fifth of the steps has thousands of them, and its means are where they should be.
    """
    mean, sd = printed("2_14")[:, 5:].T
    first = first_order_variability(best[1], sigma_px=thesis_noise(linear[1]))
    assert implied_draws(mean, first, best[1].values) < 16
    assert implied_draws(mean, first, linear[1].values) < 16
    assert implied_draws(DEGREES * method_b.mean, first, best[1].values) > 300
    assert np.std(np.log(sd / (DEGREES * first.sigma))) > 0.1  # 0.016 for two thousand draws
    assert np.abs(np.log(method_b.sigma / first.sigma)).max() < 0.06


def test_steps_that_ignore_the_correlations_hardly_mix(best, linear):
    """The dissertation's generator moves each parameter by itself: a million such steps are some sixty draws."""
    from cadcam.calibrate.variability.repeated import model_of
    from cadcam.fit.sampling import NotMixed, Walk, metropolis, refuse_unmixed

    noise = thesis_noise(linear[1])
    first = first_order_variability(best[1], sigma_px=noise)
    model, state = model_of(best[1])
    rng = np.random.default_rng(5)
    starts = first.exact + 2 * rng.standard_normal((64, 11)) @ np.linalg.cholesky(first.covariance).T
    density = log_likelihood(model, state, noise)
    walk = walk_of(200_000)
    kept = metropolis(density, starts, np.diag(first.sigma), Walk(walk.steps, walk.burn_in, 10), rng=rng)
    with pytest.raises(NotMixed):
        refuse_unmixed(kept.draws, NAMES)


@pytest.mark.parametrize(("spread_mm", "spread_deg"), [(30, 3), (200, 10), (600, 30)])
def test_alternating_externals_free_nothing_while_the_points_stay_in_view(best, linear, spread_mm, spread_deg):
    """Tables 2.17 and 2.18: with visible poses the errors stay as correlated, U0 and V0 as unknown, as in one pose."""
    study = alternating_externals(
        best[1],
        rng=np.random.default_rng(6),
        spread_mm=spread_mm,
        spread_deg=spread_deg,
        sigma_px=thesis_noise(linear[1]),
        draws=1500,
    )
    a, b, z, focal, u0, v0 = index("a", "b", "Z", "focal", "U0", "V0")
    r = study.errors.correlation
    assert r[b, u0] < -0.84
    assert r[a, v0] > 0.84
    assert r[z, focal] > 0.84
    assert np.all(study.errors.sigma[U0_V0] > 6)
    # with the drawn externals everything looks uncorrelated, as Table 2.18 has it: 4.5 standard errors of 1500
    assert np.abs(study.correlation_with_drawn[:6, 6:]).max() < 4.5 / np.sqrt(1500)


def test_table_2_17_takes_poses_that_do_not_see_the_points(printed, linear):
    """With every rotation allowed 1 pose in 100 sees the points; then the sigmas are those printed, to 25 %.

    The range of the poses is not printed, and a few poses near a degenerate one make much of each sigma.
    """
    study = alternating_externals(
        linear[1],
        rng=np.random.default_rng(1),
        spread_mm=100,
        spread_deg=180,
        sigma_px=thesis_noise(linear[1]),
        method="dlt",
        visible=False,
    )
    sd = printed("2_17")[:, 2]
    assert (DEGREES * study.errors.sigma)[6:] == pytest.approx(sd, rel=0.25)
    seen = seeing_poses(linear[1], study.drawn)
    assert seen.mean() < 0.02


def seeing_poses(estimate, drawn):
    from cadcam.calibrate.variability.repeated import model_of

    model, _ = model_of(estimate)
    held = np.repeat(estimate.values[None, 6:], len(drawn), axis=0)
    q = model.pixels(model.from_parameters(np.column_stack([drawn, held])))
    return estimate.camera.sees(q).all(axis=-1)


def test_the_c23_form_fails_where_the_world_origin_comes_near_the_focal_plane(linear):
    """C23 = 1 divides by the origin's depth: among visible poses the worst have it near zero, and sigma grows.

    The normalised form does not care.
    """
    spread = {"spread_mm": 200, "spread_deg": 10, "sigma_px": thesis_noise(linear[1]), "draws": 500}
    sigma = {
        method: alternating_externals(linear[1], rng=np.random.default_rng(2), method=method, **spread).errors.sigma
        for method in ("dlt", "dlt-c23")
    }
    focal = NAMES.index("focal")
    assert sigma["dlt"][focal] < 8
    assert sigma["dlt-c23"][focal] > 3 * sigma["dlt"][focal]


def v0_in_sigmas(one, other):
    return (one.value("V0") - other.value("V0")) / np.hypot(one.sigma("V0"), other.sigma("V0"))


def test_the_moved_principal_point_is_no_flat_optimum_but_a_missing_lens_term(best, points, size):
    """Section 2.4.2: V0 differs by 44 px between the positions, 4.5 sigma: more than any flatness allows.

    With one radial term the residuals fall to a third, an F of 158 and 279 with 1 and 20 degrees of freedom (17.2
    has a probability of 0.05 %), and V0 agrees within a sigma.
    """
    assert v0_in_sigmas(best[1], best[2]) > 4
    radial = {i: calibrate_camera(points("2_7", i), size, lens=BrownConrady(), free_lens=("k1",)) for i in (1, 2)}
    for i, f in ((1, 158), (2, 279)):
        better = radial[i]
        ratio = (best[i].sum_of_squares - better.sum_of_squares) / (better.sum_of_squares / better.dof)
        assert ratio == pytest.approx(f, abs=2)
        assert better.thesis_residual < best[i].thesis_residual / 2.8
    assert abs(v0_in_sigmas(radial[1], radial[2])) < 1
