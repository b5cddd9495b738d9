"""Shares of measurements that determine the unknowns best."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.fit.optimal_design import design

PLACES = np.linspace(-1, 1, 201)
PARABOLA = np.stack([np.ones(201), PLACES, PLACES**2], axis=1)
EVEN = np.ones(201)


def information(rows: Array, share: Array) -> float:
    """Return the determinant of the information, to the power of one unknown."""
    return float(np.linalg.det((rows.T * share) @ rows) ** (1 / rows.shape[1]))


def test_a_parabola_is_measured_most_at_its_ends_and_in_the_middle() -> None:
    """The D-optimal design is a third each at -1, 0 and 1 (V. V. Fedorov, Theory of Optimal Experiments, 1972)."""
    best = np.zeros(201)
    best[[0, 100, 200]] = 1 / 3
    even, chosen = EVEN / 201, design(PARABOLA, EVEN, most=1.0, enough=10.0, poor=9.0)
    assert information(PARABOLA, even) < 0.6 * information(PARABOLA, best)
    assert information(PARABOLA, chosen) > 0.85 * information(PARABOLA, best)
    assert chosen[[0, 100, 200]].min() > 1.5 * chosen[[50, 150]].max()


@pytest.mark.parametrize("chosen", [0.0, 0.4, 1.0])
def test_shares_are_mixed_and_add_up(chosen: float) -> None:
    share = np.linspace(1, 2, 201)
    mixed = design(PARABOLA, share, most=chosen, enough=10.0, poor=9.0)
    assert mixed.sum() == pytest.approx(1, abs=1e-12)
    assert (mixed >= (1 - chosen) * share / share.sum() - 1e-15).all()


def test_units_of_the_unknowns_change_little() -> None:
    """Information that is there anyway, a ten thousandth, is in those units."""
    one = design(PARABOLA, EVEN, most=1.0, enough=10.0, poor=9.0)
    other = design(PARABOLA * [1.0, 3.0, 0.5], EVEN, most=1.0, enough=10.0, poor=9.0)
    np.testing.assert_allclose(one, other, rtol=0.02)


def test_unknowns_that_no_measurement_tells_do_no_harm() -> None:
    rows = np.concatenate([PARABOLA, np.zeros((201, 2))], axis=1)
    np.testing.assert_allclose(
        design(rows, EVEN, most=1.0, enough=10.0, poor=9.0),
        design(PARABOLA, EVEN, most=1.0, enough=10.0, poor=9.0),
        rtol=0.02,
    )
    assert np.isfinite(design(np.zeros((5, 3)), np.ones(5), most=0.5)).all()


def test_no_more_is_chosen_than_is_enough() -> None:
    """Evenly measured, the parabola has some 0.7 of the best design's efficiency."""
    best = design(PARABOLA, EVEN, most=1.0, enough=10.0, poor=9.0)
    efficiency = information(PARABOLA, EVEN / 201) / information(PARABOLA, best)
    assert 0.65 < efficiency < 0.7
    np.testing.assert_array_equal(design(PARABOLA, EVEN, enough=0.65), EVEN / 201)
    for most in (0.3, 0.6):
        np.testing.assert_allclose(
            design(PARABOLA, EVEN, most=most, enough=0.9, poor=0.75), (1 - most) / 201 + most * best, rtol=1e-12
        )
    between = design(PARABOLA, EVEN, most=1.0, enough=0.9, poor=0.5)
    share = (0.9 - efficiency) / (0.9 - 0.5)
    np.testing.assert_allclose(between, (1 - share) / 201 + share * best, rtol=1e-3)  # information that is there anyway
