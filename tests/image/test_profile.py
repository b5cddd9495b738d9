"""Steps fitted to pixels: exact on what they model, as uncertain as they say, near the bound, and why slopes matter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from cadcam.image.profile import BRIGHT, CANDIDATE_ROOM_PX, blur_matrix, blur_of, noise_of, step_candidates, step_sums
from cadcam.image.sensor.light import Motion
from cadcam.native import profiles
from cadcam.native.core import choose_variant
from cadcam.native.profiles import StepCells

BLUR = 0.8


def blurred_ramp(d: np.ndarray, blur: float) -> np.ndarray:
    return d * ndtr(d / blur) + blur * np.exp(-0.5 * (d / blur) ** 2) / np.sqrt(2 * np.pi)


def picture(
    angle: float, offset: float, *, contrast: float = 0.4, slope: float = 0.004, bend: float = 0.0, blur: float = BLUR
) -> np.ndarray:
    """Return (64, 64) with a step `offset` px beyond the line through the middle, along the normal at `angle`."""
    y, x = np.mgrid[:64, :64] - 31.5
    d = x * np.cos(angle) + y * np.sin(angle) - offset
    return (0.3 + slope * d + contrast * ndtr(d / blur) + bend * blurred_ramp(d, blur)).astype(np.float32)


def cell(
    gray: np.ndarray, angle: float, *, reach: float = 6.0, half_length: float = 5.0, held: float = 0.0, twins=None
):
    normal = np.array([[np.cos(angle), np.sin(angle)]])
    side = np.array([reach])
    one = StepCells(np.array([[31.5, 31.5]]), normal, side, side, half_length, BLUR, twins)
    return step_sums(gray, one).solved(np.full((1, 2), held))


def position(found) -> float:
    return float(-found.moment[0] / found.contrast[0])


ANGLES = np.radians([0.0, 17.0, 45.0, 90.0, 133.0, 200.0, 301.0])


@pytest.mark.parametrize("angle", ANGLES)
def test_a_step_on_the_line_is_found_there_to_the_picture_s_own_rounding(angle: float) -> None:
    found = cell(picture(angle, 0.0, bend=0.01), angle)
    eps = float(np.finfo(np.float32).eps)  # the picture is float32, the integral of the bell good to 8e-8
    assert abs(position(found)) < 20 * eps
    assert found.contrast[0] == pytest.approx(0.4, abs=20 * eps)
    assert found.slopes[0] == pytest.approx([0.004, 0.014], abs=20 * eps)


@pytest.mark.parametrize("offset", [-0.3, 0.1, 0.25])
def test_beside_the_line_the_error_is_of_third_order(offset: float) -> None:
    """Phi(x - e) = Phi - e phi - e^2 x phi / 2 ...: the second order is odd and the cell even, so it drops out."""
    found = position(cell(picture(0.4, offset), 0.4))
    assert abs(found - offset) < 0.6 * abs(offset) ** 3 / BLUR**2 + 1e-4


@pytest.mark.parametrize("held", [0.0, np.inf])
def test_the_predicted_uncertainty_is_the_scatter_of_many_noisy_pictures(held: float, rng: np.random.Generator) -> None:
    clean, sigma = picture(0.7, 0.0, slope=0.0), 0.01
    z = []
    for _ in range(400):
        found = cell((clean + sigma * rng.normal(size=clean.shape)).astype(np.float32), 0.7, held=held)
        z.append(position(found) * found.contrast[0] / found.sd_moment[0])
    assert np.std(z) == pytest.approx(1.0, abs=4 / np.sqrt(2 * 400))  # four sd of a standard deviation from 400
    assert abs(np.mean(z)) < 4 / np.sqrt(400)


@pytest.mark.parametrize(("held", "loss"), [(np.inf, 1.2), (0.0, 1.75)])
def test_a_wide_cell_comes_near_the_cramer_rao_bound(held: float, loss: float) -> None:
    """Bound: var = 2 sqrt(pi) blur sigma^2 / (contrast^2 length), everything but the position known."""
    found = cell(picture(0.0, 0.0, slope=0.0), 0.0, reach=6.0, half_length=5.0, held=held)
    length = 10.0  # columns of pixels: rows at -4.5 .. 4.5
    bound = np.sqrt(2 * np.sqrt(np.pi) * BLUR * found.noise[0] ** 2 / (0.4**2 * length))
    assert 1.0 < found.sd_moment[0] / 0.4 / bound < loss


def test_without_slopes_of_its_own_on_either_side_a_fit_follows_the_light() -> None:
    """The negative control of the bend: held to zero, a bend of 0.02 a pixel drags the step by a tenth of a pixel."""
    gray = picture(0.3, 0.0, bend=0.02)
    assert abs(position(cell(gray, 0.3))) < 1e-5
    assert abs(position(cell(gray, 0.3, held=np.inf))) > 0.1


@pytest.mark.parametrize("slant", [0.0, 0.2])
def test_a_twin_line_in_the_cell_does_not_draw_the_step(slant: float) -> None:
    """And the negative control: not told of it, the fit is off by a tenth of a pixel and more."""
    y, x = np.mgrid[:64, :64] - 31.5
    light = picture(0.0, 0.0) + 0.5 * ndtr((x - 4.0 - slant * y) / BLUR)
    gray = (0.7 * light).astype(np.float32)  # at most 0.93: none of it white
    twins = np.array([[[-np.inf, 0.0], [4.0, slant]]])
    assert abs(position(cell(gray, 0.0, half_length=2.0, twins=twins))) < 1e-3  # a slanted step looks wider across it
    assert abs(position(cell(gray, 0.0, half_length=2.0))) > 0.1


def test_a_cell_that_leaves_the_picture_tells_nothing_and_a_clipped_one_says_so() -> None:
    assert np.isnan(cell(picture(0.0, 0.0), 0.0, reach=40.0).contrast[0])
    assert cell(np.clip(picture(0.0, 0.0, contrast=1.0), 0, 1), 0.0).clipped[0] == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("contrast", [0.75, 1.0, 1.3])
def test_a_step_up_to_white_is_where_the_light_steps(contrast: float, rng: np.random.Generator) -> None:
    """From 0.3 to 1.05, 1.3 and 1.6, of which 1 is shown, in 200 pictures.

    Of a pixel next to white only noise towards the dark is kept. So its sd may be as small as a half normal one's,
    sqrt(1 - 2 / pi), of what is stated, and the mean leans to the dark, by less than half of that.
    """
    light, sigma = picture(0.7, 0.0, slope=0.0, contrast=contrast), 0.01
    found = [
        cell(np.clip(light + sigma * rng.normal(size=light.shape), 0, 1).astype(np.float32), 0.7) for _ in range(200)
    ]
    z = [position(one) * one.contrast[0] / one.sd_moment[0] for one in found]
    error = 4 / np.sqrt(2 * 200)  # four sd of a standard deviation from 200
    assert np.sqrt(1 - 2 / np.pi) - error < np.std(z) < 1 + error
    assert abs(np.mean(z)) < 0.5
    assert np.mean([one.contrast[0] for one in found]) == pytest.approx(contrast, rel=0.05)


@pytest.mark.parametrize(("bright", "sigma"), [(0.95, 0.02), (0.97, 0.01), (0.97, 0.02), (1.0, 0.02)])
def test_a_side_that_noise_makes_white_in_part_is_not_darkened_by_that(
    bright: float, sigma: float, rng: np.random.Generator
) -> None:
    """Without its brighter pixels it was too dark by up to one sd of the noise, and z 0.4 to 2.4 in the mean."""
    light = picture(0.7, 0.0, slope=0.0, contrast=bright - 0.3)
    found = [
        cell(np.clip(light + sigma * rng.normal(size=light.shape), 0, 1).astype(np.float32), 0.7, held=np.inf)
        for _ in range(200)
    ]
    z = [position(one) * one.contrast[0] / one.sd_moment[0] for one in found]
    assert abs(np.mean(z)) < 0.25 + 4 / np.sqrt(200)
    darker = bright - 0.3 - np.mean([one.contrast[0] for one in found])
    assert darker < 0.4 * sigma


def test_white_pixels_say_nothing_of_the_slopes() -> None:
    """Whatever is beyond white, the sums are those of the other pixels alone; the bell's integral is good to 8e-8."""
    shown = np.clip(picture(0.7, 0.0, slope=0.0, contrast=1.3), 0, 1)
    one = StepCells(np.array([[31.5, 31.5]]), np.array([[np.cos(0.7), np.sin(0.7)]]), *[np.array([6.0])] * 2, 5.0, BLUR)
    y, x = np.mgrid[:64, :64] - 31.5
    d, t = x * np.cos(0.7) + y * np.sin(0.7), y * np.cos(0.7) - x * np.sin(0.7)
    kept = d[(np.abs(d) <= 6) & (np.abs(t) <= 5) & (shown < BRIGHT)]
    ramp = blurred_ramp(kept, BLUR)
    sums = step_sums(shown, one).sums[0]
    assert sums[0] == len(kept)
    for k, expected in ((9, (kept - ramp) ** 2), (13, ramp * (kept - ramp)), (14, ramp**2)):  # 3, 3; 4, 3; 4, 4
        assert sums[k] == pytest.approx(expected.sum(), abs=8e-8 * 2 * 6.0**2 * len(kept))


def test_taken_for_what_it_looks_like_a_step_up_to_white_lies_in_the_dark() -> None:
    """The negative control: by a third of a pixel."""
    shown = np.clip(picture(0.0, 0.0, slope=0.0, contrast=1.3), 0, 1)
    side = np.array([6.0])
    one = StepCells(np.array([[31.5, 31.5]]), np.array([[1.0, 0.0]]), side, side, 5.0, BLUR)
    taken = profiles.steps(profiles.step_sums(shown, one, dark=-1.0, bright=2.0), np.full((1, 2), np.inf))
    assert -taken[0, 1] / taken[0, 0] < -0.3
    assert abs(position(cell(shown, 0.0))) < 0.01


def test_every_instruction_set_gives_the_same_steps(rng: np.random.Generator) -> None:
    gray = picture(0.3, 0.1).astype(np.float32)
    q, angle = rng.uniform(15, 48, (50, 2)), rng.uniform(0, 2 * np.pi, 50)
    normal, side = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.full(50, 5.0)
    held, twins = rng.uniform(0, 5, (50, 2)), np.tile([[-5.0, 0.1], [4.0, 0.0]], (50, 1, 1))
    twins[::3, 0], twins[::2, 1] = [-np.inf, 0.0], [np.inf, 0.0]
    each = []
    for level in (0, -1):
        choose_variant(level)
        sums = profiles.step_sums(gray, StepCells(q, normal, side, side, 2.0, BLUR, twins), dark=-1.0, bright=2.0)
        each.append(profiles.steps(sums, held))
    np.testing.assert_allclose(each[0], each[1], rtol=1e-6, atol=1e-9)


def test_every_instruction_set_finds_the_same_candidates(rng: np.random.Generator) -> None:
    gray = np.tile(picture(0.5, 0.3), (2, 2)) + 0.02 * rng.random((128, 128)).astype(np.float32)
    q, angle = rng.uniform(-3, 130, (400, 2)), rng.uniform(0, 2 * np.pi, 400)  # some leave the picture
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    each = []
    for level in (0, -1):
        choose_variant(level)
        each.append(step_candidates(gray, q, normal, half_length=2.0, reach=9, noise=1e-3))
    slow, fast = each
    assert 0.5 < np.isfinite(slow.slope[:, 0]).mean() < 1
    np.testing.assert_allclose(fast.slope, slow.slope, rtol=0, atol=1e-6)  # float32 pictures
    np.testing.assert_allclose(fast.offset, slow.offset, rtol=0, atol=1e-3)  # at least 0.002 steep: a flat top of it


def plain_candidate(gray: np.ndarray, q: np.ndarray, normal: np.ndarray, reach: int) -> tuple[float, float]:
    """Return offset and slope of the steepest place, in numpy: linear between pixels, four places along the line."""
    d, t = np.arange(-reach - 4, reach + 5)[:, None], np.arange(4) - 1.5
    x, y = q[0] + d * normal[0] - t * normal[1], q[1] + d * normal[1] + t * normal[0]
    profile = map_coordinates(gray.astype(float), [y, x], order=1).mean(axis=1)
    k = np.arange(-3, 4)
    slope = np.correlate(profile, k * np.exp(-0.5 * k**2) / np.sqrt(2 * np.pi), "valid")
    best = 1 + int(np.argmax(np.abs(slope[1:-1])))
    before, here, after = slope[best - 1 : best + 2]
    return best - reach - 1 + 0.5 * (before - after) / (before + after - 2 * here), here


def test_candidates_are_what_a_profile_read_plainly_shows(rng: np.random.Generator) -> None:
    gray = picture(0.7, 0.4)
    q, angle = rng.uniform(28, 35, (40, 2)), 0.7 + rng.uniform(-0.5, 0.5, 40)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = step_candidates(gray, q, normal, half_length=2.0, reach=8, noise=1e-3)
    expected = np.array([plain_candidate(gray, *place, 8) for place in zip(q, normal, strict=True)])
    np.testing.assert_allclose(found.offset[:, 0], expected[:, 0], rtol=0, atol=1e-3)
    np.testing.assert_allclose(found.slope[:, 0], expected[:, 1], rtol=0, atol=1e-6)


def test_a_step_is_found_as_near_to_the_pictures_border_as_is_said() -> None:
    """Of a column of pixels, dark to its left and bright to its right, and of what mirrors it at the other border."""
    for away in range(1, 9):
        gray = np.tile(np.arange(24) >= 24 - away, (24, 1)).astype(np.float32)
        step, normal = np.array([[23.5 - away, 12.0]]), np.array([[1.0, 0.0]])
        right = step_candidates(gray, step, normal, half_length=2.0, reach=8, noise=1e-3)
        left = step_candidates(gray[:, ::-1].copy(), 23 - step, normal, half_length=2.0, reach=8, noise=1e-3)
        inside = away - 0.5 > CANDIDATE_ROOM_PX
        assert np.isfinite(right.offset).any() == np.isfinite(left.offset).any() == inside


def test_sums_of_pixels_give_any_steps_that_a_fit_from_the_pixels_would(rng: np.random.Generator) -> None:
    """One gather, solved for several slopes held: as many fits, each by numpy's own least squares."""
    gray, reach, half = picture(0.6, 0.2, bend=0.01), 5.0, 2.0
    q, normal = np.array([[31.5, 31.5]]), np.array([[np.cos(0.6), np.sin(0.6)]])
    side = np.array([reach])
    sums = step_sums(gray, StepCells(q, normal, side, side, half, BLUR))
    y, x = np.mgrid[:64, :64]
    d = (x - 31.5) * normal[0, 0] + (y - 31.5) * normal[0, 1]
    t = (y - 31.5) * normal[0, 0] - (x - 31.5) * normal[0, 1]
    inside = (np.abs(d) <= reach) & (np.abs(t) <= half)
    d, ramp = d[inside], blurred_ramp(d[inside], BLUR)
    bell = np.exp(-0.5 * (d / BLUR) ** 2) / np.sqrt(2 * np.pi) / BLUR
    A = np.column_stack([np.ones(len(d)), ndtr(d / BLUR), bell, d - ramp, ramp])
    for held in rng.uniform(0, 50, (4, 2)):
        prior = np.zeros((2, 5))
        prior[[0, 1], [3, 4]] = np.sqrt(held)
        own = np.linalg.lstsq(np.vstack([A, prior]), np.append(gray[inside], [0, 0]), rcond=None)[0]
        found = sums.solved(held[None])
        got = [found.contrast[0], found.moment[0], *found.slopes[0]]
        np.testing.assert_allclose(got, own[1:], rtol=0, atol=1e-5)  # the normal distribution there is good to 8e-8


@pytest.mark.parametrize("sigma", [0.004, 0.02])
def test_noise_is_told_in_spite_of_edges(sigma: float, rng: np.random.Generator) -> None:
    gray = np.tile(picture(0.5, 0.0), (6, 8))
    noisy = (gray + sigma * rng.normal(size=gray.shape)).astype(np.float32)
    assert noise_of(noisy) == pytest.approx(sigma, rel=0.06)  # 9000 second differences: 1.5 percent, and the edges


@pytest.mark.parametrize("blur", [0.6, 0.9, 1.6])
def test_blur_is_told_by_how_well_steps_fit(blur: float, rng: np.random.Generator) -> None:
    gray = picture(0.5, 0.0, blur=blur)
    gray = (gray + 0.003 * rng.normal(size=gray.shape)).astype(np.float32)
    along = np.linspace(-16, 16, 12)[:, None] * [-np.sin(0.5), np.cos(0.5)]
    normal = np.tile([np.cos(0.5), np.sin(0.5)], (12, 1))
    found = blur_of(gray, 31.5 + along, normal, reach=np.full(12, 6.0), half_length=2.0)
    assert found == pytest.approx(blur, rel=0.12)  # half a step of the blurs tried is 17 percent


@pytest.mark.parametrize("motion", [(0.0, 0.0), (4.0, 3.0), (0.0, -3.0)])
def test_the_blur_of_motion_is_told_by_direction(motion: tuple[float, float], rng: np.random.Generator) -> None:
    """A step across n is blurred by 0.7 px and by a box |n . d| wide, whose variance is a twelfth of its square."""
    y, x = np.mgrid[:96, :96] - 47.5
    sharp = (0.3 + 0.4 * ndtr((30 - np.hypot(x, y)) / 0.7)).astype(np.float32)
    gray = Motion(motion).apply(sharp, rng) + 0.003 * rng.normal(size=sharp.shape)
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = blur_matrix(gray.astype(np.float32), 47.5 + 30 * normal, normal, reach=np.full(60, 7.0), half_length=2.0)
    true = 0.7**2 * np.eye(2) + np.outer(motion, motion) / 12
    for n in ([1.0, 0.0], [0.0, 1.0], [0.8, 0.6], [-0.6, 0.8]):
        assert np.sqrt(n @ found @ n) == pytest.approx(np.sqrt(n @ true @ n), rel=0.2)  # a box is no bell
    if not any(motion):
        np.testing.assert_array_equal(found, found[0, 0] * np.eye(2))


def test_edges_of_one_direction_tell_one_blur(rng: np.random.Generator) -> None:
    gray = (picture(0.5, 0.0, blur=0.9) + 0.003 * rng.normal(size=(64, 64))).astype(np.float32)
    along = np.linspace(-16, 16, 24)[:, None] * [-np.sin(0.5), np.cos(0.5)]
    normal = np.tile([np.cos(0.5), np.sin(0.5)], (24, 1))
    found = blur_matrix(gray, 31.5 + along, normal, reach=np.full(24, 6.0), half_length=2.0)
    np.testing.assert_array_equal(found, found[0, 0] * np.eye(2))


def test_cells_full_of_texture_hardly_change_the_blur(rng: np.random.Generator) -> None:
    """Four of twelve cells have texture of half the step; by the squares they leave they alone would tell it."""
    y = np.mgrid[:64, :64][0] - 31.5
    gray = picture(0.0, 0.0, blur=0.9) + np.where(y > 5.5, 0.2, 0.01) * rng.normal(size=(64, 64))
    q = np.stack([np.full(12, 31.5), 31.5 + np.linspace(-16, 16, 12)], axis=1)
    found = blur_of(gray.astype(np.float32), q, np.tile([1.0, 0.0], (12, 1)), reach=np.full(12, 6.0), half_length=2.0)
    assert found == pytest.approx(0.9, rel=0.15)


def test_twin_edges_are_two_candidates_of_opposite_sign() -> None:
    gray = picture(0.0, -2.0) - picture(0.0, 3.0)  # a bright strip 5 px wide
    found = step_candidates(
        gray, np.array([[31.5, 31.5]]), np.array([[1.0, 0.0]]), half_length=2.0, reach=8, noise=1e-3
    )
    order = np.argsort(found.offset[0])
    np.testing.assert_allclose(found.offset[0][order[:2]], [-2.0, 3.0], atol=0.15)  # half-pixel shoulder, parabola
    assert found.slope[0][order[0]] > 0 > found.slope[0][order[1]]
