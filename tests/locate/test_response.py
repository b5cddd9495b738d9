"""A camera's gamma moves steps towards their dark side: it is taken out where edges tell it, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from cadcam.fit.grouped import Groups, grouped_fit
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import step_sums
from cadcam.locate.lines.response import _OF_BLUR, _weighed, bend_of
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.native.profiles import StepCells

from ..cad.solids import box
from .photos import CAMERA, noisy, shot, view

BOX = Part.of(box([0, 0, 0], [100, 60, 40]))
SRGB = 2.2


@pytest.fixture(scope="module")
def pose() -> Rigid:
    return view(BOX, (0.5, 0.7, 1.0), away=4.0)


@pytest.fixture(scope="module")
def light(pose: Rigid) -> np.ndarray:
    return shot(BOX, pose)


def squared(picture: np.ndarray, pose: Rigid) -> float:
    found = refine_pose(BOX, [Photo.of(picture, CAMERA)], pose).pose
    xi = (pose.inv @ found.world_from_part).log()
    return float(xi @ np.linalg.solve(found.covariance, xi))


@pytest.mark.parametrize(("dark", "bright"), [(0.5, 0.8), (0.3, 0.6)])
def test_a_step_moves_by_its_lean_for_a_unit_of_gamma(dark: float, bright: float) -> None:
    """To first order: g = 1.1, and what is of second order is under a tenth of it."""
    blur, g = 1.0, 1.1
    fine = np.where(np.arange(64 * 20) < 32 * 20, dark, bright)
    row = (gaussian_filter1d(fine, 20 * blur).reshape(64, 20).mean(axis=1)) ** (1 / g)
    side = np.array([6.0])
    cell = StepCells(np.array([[31.5, 8.0]]), np.array([[1.0, 0.0]]), side, side, 2.0, blur)
    found = step_sums(np.tile(row.astype(np.float32), (16, 1)), cell).solved(np.full((1, 2), np.inf))
    low, high = dark ** (1 / g), bright ** (1 / g)
    expected = -(g - 1) * _OF_BLUR * blur * (high - low) / (high + low)
    assert -found.moment[0] / found.contrast[0] == pytest.approx(expected, rel=0.15)


def test_a_photo_with_gamma_is_measured_as_surely_as_one_without(
    light: np.ndarray, pose: Rigid, rng: np.random.Generator
) -> None:
    """xi C^-1 xi of 6 parameters, mean of 6 photos: 6 +- 1.4; 150 with the shift left in."""
    bent = np.mean([squared(noisy(light ** (1 / SRGB), 0.01, rng), pose) for _ in range(6)])
    straight = np.mean([squared(noisy(light, 0.01, rng), pose) for _ in range(6)])
    assert max(bent, straight) < 6 + 4 * 1.4


def test_a_bend_is_believed_when_it_is_told_and_not_for_being_usual() -> None:
    told, none, unknown = _weighed(1.2, 0.2**2), _weighed(0.05, 0.1**2), _weighed(0.4, 2.0**2)
    assert told is not None
    assert told.excess == pytest.approx(1.2, abs=0.06)
    assert none is not None
    assert unknown is not None
    assert none.excess == unknown.excess == 0.0  # nothing is taken out,
    assert none.sd < 0.05 < unknown.sd < 0.6  # but the doubt is told: up to a fifth of usual bends, by their odds
    doubtful = _weighed(0.9, 0.38**2)
    assert doubtful is not None
    assert 0.4 < doubtful.excess < 0.8
    assert doubtful.sd > 0.3  # there, or not


def test_what_looks_like_a_response_that_darkens_is_left_alone() -> None:
    """y = L^(1/g) of a camera has g of 1 or more: shadows and dark print beside bright borders look like less."""
    assert _weighed(-2.6, 0.3**2) is None
    less = _weighed(-0.5, 0.1**2)
    assert less is not None
    assert less.excess == 0.0
    assert less.sd < 0.01
    hardly = _weighed(0.1, 0.03**2)
    assert hardly is not None
    assert 0 < hardly.excess < 0.1


@pytest.mark.parametrize(("excess", "sd"), [(0.05, 0.1), (0.4, 2.0), (0.3, 0.3)])
def test_what_is_not_taken_out_is_an_error_of_its_mean_square(excess: float, sd: float) -> None:
    """By adding up, as below: the root of the mean of (g - 1)^2, for nothing of it is taken out."""
    bend = np.arange(0.0, 8.0, 1e-4)
    usual = np.exp(-0.5 * ((bend - 0.8) / 0.6) ** 2)
    likely = usual / usual.sum() * np.exp(-0.5 * ((excess - bend) / sd) ** 2)
    odds = 0.25 * likely.sum() / np.exp(-0.5 * (excess / sd) ** 2)
    told = _weighed(excess, sd**2)
    assert told is not None
    assert told.excess == 0.0
    assert told.sd == pytest.approx(np.sqrt(odds / (1 + odds) * (likely @ bend**2) / likely.sum()), rel=1e-3)


@pytest.mark.parametrize(("excess", "sd"), [(1.2, 0.2), (0.9, 0.38), (0.1, 0.03), (0.6, 0.2)])
def test_what_is_expected_of_a_bend_is_its_mean_over_what_it_may_be(excess: float, sd: float) -> None:
    """By adding up over 0 to 8 in steps of 1e-4: a usual bend, or with the greater odds none."""
    bend = np.arange(0.0, 8.0, 1e-4)
    usual = np.exp(-0.5 * ((bend - 0.8) / 0.6) ** 2)
    likely = usual / usual.sum() * np.exp(-0.5 * ((excess - bend) / sd) ** 2)
    odds = 0.25 * likely.sum() / np.exp(-0.5 * (excess / sd) ** 2)
    there, mean = odds / (1 + odds), float(likely @ bend / likely.sum())
    variance = there * float(likely @ bend**2 / likely.sum()) - (there * mean) ** 2
    told = _weighed(excess, sd**2)
    assert told is not None
    assert told.excess == pytest.approx(there * mean, rel=1e-3)
    assert told.sd == pytest.approx(np.sqrt(variance), rel=1e-3)


def test_edges_that_are_surely_off_by_little_count_more_where_a_bend_is_looked_for() -> None:
    """Of 300 fits to 40 edges of unequal scatter the square error is the least possible, to four of its sd.

    Clear edges lean more, as their contrast makes them. Weighed alike, all edges gave 1.8 times as much.
    """
    error, least = [], []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        relative = np.exp(rng.normal(0, 1.2, 40))
        relative /= relative.mean()
        of = np.repeat(np.arange(40), 10)
        lean = 0.25 * rng.choice([-1.0, 1.0], 40) * np.minimum(1, 0.3 / np.sqrt(relative))
        J = rng.normal(size=(40, 3))[of] + 0.1 * rng.normal(size=(400, 3))
        sigma = 0.03 * np.sqrt(relative)[of]
        y = 0.4 * lean[of] + (0.05 * np.sqrt(relative) * rng.normal(size=40))[of] + sigma * rng.normal(size=400)
        fit = grouped_fit(y, J, sigma**2, Groups(of, relative=relative), usual=0.05)
        bend = bend_of(fit, J, lean[of], np.sign(lean)[of], of)
        if bend is not None:
            A = np.column_stack([J.reshape(40, 10, 3).mean(axis=1), lean])
            error.append(bend.excess - 0.4)
            least.append(np.linalg.inv(A.T @ (A / ((0.05**2 + 0.03**2 / 10) * relative)[:, None]))[3, 3])
    assert len(error) > 250
    assert np.mean(np.square(error)) < (1 + 4 * np.sqrt(2 / len(error))) * np.mean(least)
