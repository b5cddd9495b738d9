"""Mechanics and vision told apart, against the truth of a simulated hall."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import BadValue, TooFewPoints
from cadcam.station.cross_prediction import cross_predictions, split


def test_exact_pairs_are_split_exactly(rng):
    m = rng.normal(size=(6, 2))
    found = split(m[:, None] - m[None])
    assert found.mechanics == pytest.approx(m - m.mean(axis=0), abs=1e-12)
    assert found.vision == pytest.approx([0, 0], abs=1e-12)
    assert found.closure == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize("n", [2, 3, 12])
def test_what_the_mechanics_leave_over_is_a_share_of_the_vision_s_error(rng, n):
    """Of 300 tables of independent errors: a single pair is known to 3 %."""
    found = [split(rng.normal(0, 0.4, (n, n, 2))) for _ in range(300)]
    vision, left = (np.sqrt(np.mean(np.square([getattr(s, what) for s in found]))) for what in ("vision", "closure"))
    assert vision == pytest.approx(0.4, rel=0.12)
    assert left == pytest.approx(0.4 * np.sqrt((n - 2) / (2 * n)), rel=0.12, abs=1e-12)


def test_vision_s_sigma_comes_back_from_noisy_pairs(rng):
    m = 10 * rng.normal(size=(15, 2))
    found = split(m[:, None] - m[None] + [0.6, 0.3] * rng.normal(size=(15, 15, 2)))
    assert found.vision == pytest.approx([0.6, 0.3], rel=0.25)  # 105 pairs: 7 % of a sigma
    assert np.abs(found.mechanics - (m - m.mean(axis=0))).max() < 0.6


def test_the_map_of_a_hall_is_its_mechanics_within_a_tenth_of_a_millimetre(calibrated):
    """20 mm of deflection; the survey of 0.1 mm, four reflectors, leaves 0.05 mm."""
    for one in calibrated.values():
        seen = one.station.map()
        assert 10 < seen.split.worst < 25
        assert np.sqrt(np.mean(one.map_error**2)) < 0.1
        assert np.sqrt(np.mean((one.map_error / seen.sigma) ** 2)) == pytest.approx(1, abs=0.5)  # 28 numbers: 13 %


def test_single_marks_scatter_about_as_pixels_and_plate_let_expect(calibrated):
    """The plate's own errors are one draw of sixteen numbers, about half of which the matrix takes up: 25 % each."""
    for one in calibrated.values():
        seen = one.station.map()
        assert seen.vision / seen.predicted == pytest.approx(1, abs=0.7)


def test_a_reference_position_has_deviation_zero(stations):
    seen = stations["6"].map(reference=4)
    assert seen.deviation[4] == pytest.approx([0, 0], abs=1e-12)
    assert seen.sigma[4] == pytest.approx([0, 0], abs=1e-6)
    with pytest.raises(BadValue, match="reference position"):
        stations["6"].map(reference=99)


def test_cross_predictions_of_a_position_itself_are_zero(stations):
    d = cross_predictions(stations["6"].positions)
    assert np.abs(d[np.eye(15, dtype=bool)]).max() == 0
    assert np.abs(d).max() > 5


def test_a_table_that_is_none_is_refused():
    with pytest.raises(TooFewPoints):
        split(np.zeros((1, 1, 2)))
    with pytest.raises(BadValue, match="square table"):
        split(np.zeros((2, 3, 2)))
    with pytest.raises(BadValue, match="not finite"):
        split(np.full((3, 3, 2), np.nan))
