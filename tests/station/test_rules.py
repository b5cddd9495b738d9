"""Weights of calibrations: each rule is exact for the functions it is named after, and none looks outside unasked."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import BadValue, TooFewPoints, UnknownName
from cadcam.station.interpolation import bilinear_weights, check_inside, weights

X, Y = np.meshgrid([0.0, 4000.0, 8000.0], [0.0, 2000.0, 4000.0, 6000.0], indexing="ij")
GRID = np.column_stack([X.ravel(), Y.ravel()])


@pytest.fixture
def jittered(rng):
    return GRID + rng.uniform(-150, 150, GRID.shape)


def places(rng, count=60):
    return rng.uniform([300, 300], [7700, 5700], (count, 2))


@pytest.mark.parametrize("rule", ["nearest", "linear", "bilinear", "b4"])
def test_weights_add_up_to_one(jittered, rng, rule):
    for at in places(rng):
        assert weights(jittered, at, rule).sum() == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    ("rule", "function"),
    [
        ("linear", lambda p: 3 - 2e-3 * p[..., 0] + 5e-4 * p[..., 1]),
        ("bilinear", lambda p: 3 - 2e-3 * p[..., 0] + 5e-4 * p[..., 1] + 1e-7 * p[..., 0] * p[..., 1]),
    ],
)
def test_each_rule_is_exact_for_its_own_functions(jittered, rng, rule, function):
    for at in places(rng):
        assert weights(jittered, at, rule) @ function(jittered) == pytest.approx(function(at), abs=1e-9)


def test_bilinear_takes_the_four_corners_of_the_cell(rng):
    for at in places(rng):
        used = GRID[weights(GRID, at, "bilinear") != 0]
        low, high = np.floor(at / [4000, 2000]) * [4000, 2000], np.ceil(at / [4000, 2000]) * [4000, 2000]
        assert (used >= low).all()
        assert (used <= high).all()


def test_the_dissertation_s_rule_takes_one_position_alone_when_it_is_near():
    assert weights(GRID, [300.0, 300.0], "b4").tolist() == [1.0, *[0.0] * 11]
    assert np.count_nonzero(weights(GRID, [2000.0, 1000.0], "b4")) == 4


def test_four_positions_on_a_diamond_do_not_determine_the_bilinear_form():
    diamond = np.array([[0, 1000], [1000, 0], [0, -1000], [-1000, 0]], float)
    assert bilinear_weights(diamond, [100.0, 50.0]) is None
    found = weights(diamond, [100.0, 50.0], "bilinear", near_mm=1.0)
    assert found @ diamond == pytest.approx([100, 50])


def test_positions_in_a_row_are_interpolated_along_it():
    row = np.array([[0, 0], [1000, 0], [3000, 0]], float)
    assert weights(row, [1500.0, 20.0], "linear") == pytest.approx([0, 0.75, 0.25])


@pytest.mark.parametrize("rule", ["linear", "bilinear", "b4"])
@pytest.mark.parametrize("degrees", [0.0, 30.0])
def test_a_camera_on_a_rail_is_between_its_positions_though_none_is_exactly_on_it(rule, degrees):
    along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    across = along[::-1] * [-1, 1]
    rail = np.array([4000.0, 300.0]) + np.outer([0.0, 4000.0, 8000.0], along) + np.outer([1.0, -2.0, 2.0], across)
    assert weights(rail, rail[0] + 2000 * along + 3 * across, rule) == pytest.approx([0.5, 0.5, 0], abs=1e-3)
    for place in (rail[0] + 2000 * along + 1100 * across, rail[0] - 1100 * along):
        with pytest.raises(BadValue):
            weights(rail, place, rule)


@pytest.mark.parametrize("rule", ["nearest", "linear", "bilinear", "b4"])
def test_outside_is_refused_unless_asked_for(rule):
    for place in ([10_500.0, 3000.0], [-2500.0, 3000.0], [4000.0, 8500.0], [4000.0, -2500.0]):
        with pytest.raises(BadValue, match="extrapolation has to be asked for"):
            weights(GRID, place, rule)
    assert weights(GRID, [10_500.0, 2900.0], rule, extrapolate=True).argmax() == 9  # (8000, 2000)


def test_a_metre_beside_the_outermost_position_still_counts_as_there():
    check_inside(GRID, np.array([8900.0, 4000.0]), extrapolate=False)
    with pytest.raises(BadValue):
        check_inside(GRID, np.array([8900.0, 4000.0]), extrapolate=False, near_mm=500.0)


def test_an_unknown_rule_is_named():
    with pytest.raises(UnknownName, match="did you mean 'bilinear'"):
        weights(GRID, [1000.0, 1000.0], "bilinea")


def test_no_positions_and_distances_that_are_none_are_refused():
    with pytest.raises(TooFewPoints, match="1 calibration position"):
        weights(np.zeros((0, 2)), [0.0, 0.0], "linear")
    with pytest.raises(BadValue, match="near_mm"):
        weights(GRID, [0.0, 0.0], "linear", near_mm=np.nan)
    with pytest.raises(BadValue, match="position"):
        bilinear_weights(GRID[:4], [0.0, 0.0, 0.0])
