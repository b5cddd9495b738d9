"""Variability in words: bias, curvature, poor mixing and heavy tails are said where they are, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.variability.alternating import Alternating
from cadcam.calibrate.variability.methods import FirstOrder, Variability
from cadcam.calibrate.variability.projection_map import ProjectionMap
from cadcam.camera.extended_pinhole import NAMES
from cadcam.report.variability import alternating_tables, correlation_table, map_table, markov_table, monte_carlo_table

N = len(NAMES)
FIRST = FirstOrder(NAMES, np.arange(N) + 1.0, np.diag(np.full(N, 0.01**2)))


def study(draws, *, failed=0, r_hat=1.0, effective=None, chains=1):
    size = draws.shape[0] if effective is None else effective
    return Variability(
        NAMES,
        FIRST.exact,
        draws.reshape(chains, -1, N),
        0.5,
        0.0,
        failed,
        np.full(N, r_hat),
        np.full(N, float(size)),
        0.23,
    )


@pytest.fixture
def draws(rng):
    return FIRST.exact + 0.01 * rng.standard_normal((4000, N))


def text(table):
    return "\n".join(table.lines())


def test_what_agrees_with_first_order_raises_no_doubt(draws):
    table = text(monte_carlo_table(study(draws), FIRST, method="least squares"))
    assert "warning" not in table
    assert "lies off" not in table
    assert "left out" not in table
    assert table.count("\n") == 2 + N + 2


def test_angles_are_shown_in_degrees(draws):
    rows = {row[0]: row for row in monte_carlo_table(study(draws), FIRST, method="").rows}
    assert float(rows["a"][1]) == pytest.approx(np.degrees(4.0), abs=0.01)
    assert float(rows["a"][3]) == pytest.approx(np.degrees(0.01), rel=0.05)
    assert float(rows["X"][1]) == 1.0
    assert rows["a"][-1] == "deg"


def test_a_biased_mean_is_named_with_its_sigmas(draws):
    draws[:, NAMES.index("focal")] -= 0.009
    table = text(monte_carlo_table(study(draws), FIRST, method="a linear transform"))
    assert "the mean lies off the value in the first column: focal -0." in table


def test_a_spread_unlike_first_order_is_warned_of(draws):
    i = NAMES.index("U0")
    draws[:, i] = FIRST.exact[i] + 1.5 * (draws[:, i] - FIRST.exact[i])
    assert "warning: sigma differs from first order: U0 +" in text(
        monte_carlo_table(study(draws), FIRST, method="least squares")
    )


def test_failed_draws_are_counted(draws):
    assert "17 draws without an answer" in text(monte_carlo_table(study(draws, failed=17), FIRST, method=""))


def test_poor_mixing_is_warned_of(draws):
    good = text(markov_table(study(draws, chains=4, effective=3000), FIRST))
    poor = text(markov_table(study(draws, chains=4, r_hat=1.05, effective=90), FIRST))
    assert "warning" not in good
    assert "warning: R-hat of X is 1.050" in poor
    assert "warning: 90 effective draws know a sigma to 7 %" in poor


def test_heavy_tails_are_warned_of(draws):
    i = NAMES.index("focal")
    draws[:20, i] += 1.0
    alternating = Alternating(study(draws), draws[:, :6])
    plain = Alternating(study(FIRST.exact + (draws[20:] - FIRST.exact)), draws[20:, :6])
    assert "a few extreme draws make sigma" in text(alternating_tables(alternating, FIRST, method="")[0])
    assert "warning" not in text(alternating_tables(plain, FIRST, method="")[0])


def test_correlations_have_two_decimals():
    table = text(correlation_table("C", ("a", "V0"), np.array([[1.0, 0.9923], [0.9923, 1.0]])))
    assert "0.99" in table
    assert "1.00" in table


def test_the_map_says_what_is_unseen():
    sigma = np.array([[np.nan, 1.0], [0.5, 0.25]])
    table = map_table(ProjectionMap([-0.5, 99.5], [-0.5, 49.5], sigma, "on a plane", np.zeros((1, 2))))
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["top left"][-1] == "unseen"
    assert rows["best"] == ("99.5", "49.5", "0.25")
