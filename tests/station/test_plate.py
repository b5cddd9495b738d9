"""A plate's place: covariance told by its spread, and surveys of something else refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints
from cadcam.station.plate import Plate, place_plate, turn

PLATE = Plate.b4(sigma_mm=0.0)


def laid(angle=0.3, shift=(5000.0, 900.0)):
    return PLATE.reflectors @ turn(angle).T + np.array(shift)


def test_an_exact_survey_gives_the_place_exactly():
    placed = place_plate(PLATE, laid(), sigma_mm=0.1)
    assert placed.angle == pytest.approx(0.3, abs=1e-12)
    assert placed.marks == pytest.approx(PLATE.marks @ turn(0.3).T + [5000.0, 900.0], abs=1e-9)


def test_the_place_scatters_as_its_covariance_says(rng):
    """4000 surveys: variances are good to 2.2 %, so 10 % is more than four sigma of them."""
    true, found = laid(), []
    for _ in range(4000):
        placed = place_plate(PLATE, true + 0.2 * rng.normal(size=true.shape), sigma_mm=0.2)
        found.append([*placed.shift, placed.angle])
    predicted = place_plate(PLATE, true, sigma_mm=0.2).covariance
    scale = np.sqrt(np.diag(predicted))
    assert np.cov(np.array(found).T) / np.outer(scale, scale) == pytest.approx(
        predicted / np.outer(scale, scale), abs=0.1
    )


def test_without_a_stated_noise_the_residuals_tell_it(rng):
    noise = [place_plate(PLATE, laid() + 0.2 * rng.normal(size=(4, 2))).sigma_mm ** 2 for _ in range(2000)]
    assert np.mean(noise) == pytest.approx(0.04, rel=0.08)  # five degrees of freedom: 1.4 % of the mean
    assert place_plate(PLATE, laid() + 0.01 * rng.normal(size=(4, 2))).dof == 5


def test_moves_are_the_derivatives_of_the_marks():
    placed = place_plate(PLATE, laid(), sigma_mm=0.1)
    step = 1e-6
    turned = PLATE.marks @ turn(placed.angle + step).T + placed.shift
    assert placed.moves(placed.marks)[..., 2] == pytest.approx((turned - placed.marks) / step, abs=1e-3)


def test_reflectors_in_a_wrong_order_are_named():
    with pytest.raises(DegenerateGeometry, match="would fit in the order b, a, c, d"):
        place_plate(PLATE, laid()[[1, 0, 2, 3]], sigma_mm=0.2)


def test_a_mirrored_survey_fits_in_no_order():
    """The dissertation's own reflectors are their mirror image; with one of them moved they are not."""
    plate = Plate(PLATE.marks, PLATE.reflectors + np.outer(np.arange(4) == 2, [50.0, 0.0]))
    with pytest.raises(DegenerateGeometry, match="in no order"):
        place_plate(plate, plate.reflectors * [1, -1], sigma_mm=0.2)


def test_a_wrong_number_of_reflectors_is_refused():
    with pytest.raises(BadValue, match="number of surveyed reflectors is 3"):
        place_plate(PLATE, laid()[:3])
    with pytest.raises(TooFewPoints):
        place_plate(Plate(PLATE.marks, [[0, 0]]), [[0, 0]])
    with pytest.raises(DegenerateGeometry, match="at one place"):
        place_plate(Plate(PLATE.marks, [[1, 1], [1, 1]]), [[0, 0], [0, 0]])


def test_names_have_to_be_different():
    with pytest.raises(BadValue, match="a different name"):
        Plate(PLATE.marks[:2], PLATE.reflectors, mark_names=("A", "A"))


@pytest.mark.parametrize("sigma", [-0.1, np.nan, np.inf, "0.1"])
def test_the_noise_of_a_survey_is_no_negative_number(sigma):
    with pytest.raises(BadValue, match=r"sigma_mm of the survey is .*; expected a number of mm from 0 on"):
        place_plate(PLATE, laid(), sigma_mm=sigma)
