"""The yardsticks of the locating benchmarks measure what they say they do."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from scipy.special import ndtr

from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part

bound = importlib.import_module("locate_bound")
errors = importlib.import_module("locate_errors")
ground = importlib.import_module("locate_ground")

CAMERA = Camera.from_focal((640, 480), 700.0, fy=690.0, skew=1.5, lens=BrownConrady(-0.2, 0.1, 1e-3, -5e-4))
POSE = Rigid.exp(np.array([0.0, 0, 0, 0.5, -0.6, 0.2])) @ Rigid()
PLACE = Rigid(POSE.rotation, np.array([10.0, -15.0, 400.0]))


@pytest.fixture(scope="module")
def part():
    return Part.of(box((-40, -30, -20), (40, 30, 20), name="box"))


def blurred_step(x, place, blur, contrast):
    return contrast * ndtr((x - place) / blur)


@pytest.mark.parametrize(("blur", "contrast"), [(0.6, 0.2), (0.9, 0.5), (1.5, 0.3)])
def test_no_fit_of_a_step_scatters_less_than_its_information_says_and_the_best_reaches_it(blur, contrast, rng):
    """4000 rows of pixels, the step anywhere in one; the sample variance errs by 2 %, 4.5 of that are allowed."""
    n, noise = 4000, 0.01
    x, truth = np.arange(-12.0, 13.0), rng.uniform(-0.5, 0.5, (n, 1))
    y = blurred_step(x, truth, blur, contrast) + noise * rng.standard_normal((n, len(x)))
    place = truth.copy()
    for _ in range(4):
        slope = -contrast / blur * np.exp(-(((x - place) / blur) ** 2) / 2) / np.sqrt(2 * np.pi)
        misfit = y - blurred_step(x, place, blur, contrast)
        place = place + (slope * misfit).sum(axis=1, keepdims=True) / (slope**2).sum(axis=1, keepdims=True)
    variance = np.var(place - truth)
    assert variance * bound.edge_information(contrast, blur, noise) == pytest.approx(1, abs=4.5 * np.sqrt(2 / n))


def test_contrast_and_blur_of_a_drawn_edge_come_out_again(rng):
    """A step at 0.3 rad, blurred by 0.8 px: bilinear sampling is accounted for on average, within 5 %."""
    angle, blur, contrast = 0.3, 0.8, 0.4
    normal = np.array([np.cos(angle), np.sin(angle)])
    y, x = np.mgrid[:120, :160]
    gray = 0.2 + blurred_step((x - 80) * normal[0] + (y - 60) * normal[1], 0.0, blur, contrast)
    along = np.arange(-40.0, 41)[:, None] * (-normal[1], normal[0])
    q = np.array([80.0, 60.0]) + along
    s = bound.Samples(
        q, np.tile(normal, (len(q), 1)), np.zeros((len(q), 3)), np.arange(len(q)) // bound.PIECE, np.zeros(len(q))
    )
    means, lengths = bound.profiles(gray, s)
    assert lengths.sum() == pytest.approx(len(q) * bound.STEP_PX)
    found = bound.blur_of(means, lengths)
    assert found == pytest.approx(blur, rel=0.05)
    assert bound.contrasts(means, found) == pytest.approx(np.full(len(means), contrast), rel=0.05)


def test_samples_lie_on_the_edges_a_step_apart(part):
    """Steps differ by rounding to whole numbers of them, and by the lens; the nine visible edges bring the rest."""
    s = bound.samples(part, CAMERA, PLACE)
    length = part.lines.draw(CAMERA, PLACE).visible.length_px.sum()
    assert len(s.q) * bound.STEP_PX == pytest.approx(length, rel=0.01)
    assert CAMERA.project(s.p) == pytest.approx(s.q)
    on = np.sort(np.abs(PLACE.inv @ s.p) - (40, 30, 20), axis=1)
    assert np.abs(on[:, 1:]).max() < 1e-9  # two coordinates of a point on a box's edge are the box's own
    assert np.linalg.norm(s.normal, axis=1) == pytest.approx(np.ones(len(s.q)))


def test_edges_move_along_their_normals_as_the_motion_says(part, rng):
    """Central differences through the projection, of shifts and turns about the centroid; error 1e-4 of the slope."""
    s = bound.samples(part, CAMERA, PLACE)
    centre = PLACE.translation
    J = bound.motion(CAMERA, s, centre)
    about = Rigid(translation=centre)
    h = 1e-5
    for k, xi in enumerate(h * np.eye(6)):
        ahead, back = (CAMERA.project(about @ Rigid.exp(x) @ about.inv @ s.p) for x in (xi, -xi))
        slope = ((ahead - back) / (2 * h) * s.normal).sum(axis=1)
        assert np.abs(slope - J[:, k]).max() < 1e-4 * np.abs(J[:, k]).max()


def test_the_area_under_the_curve_counts_pairs_with_ties_half(rng):
    right, wrong = rng.integers(3, 9, 40) / 10, rng.integers(0, 6, 55) / 10
    pairs = np.sign(right[:, None] - wrong)
    assert errors.auc(right, wrong) == pytest.approx(((pairs + 1) / 2).mean())
    assert errors.auc([1.0, 0.9], [0.1]) == 1
    assert np.isnan(errors.auc([], [0.1]))


def test_normalised_errors_of_a_true_covariance_have_mean_square_one(rng):
    """20000 errors of mixed units: the mean of chi-squared over six is one within 4.5 standard errors of 0.4 %."""
    root = rng.standard_normal((6, 6)) * np.array([1, 1, 5, 1e-3, 1e-3, 1e-4])[:, None]
    xi = rng.standard_normal((20000, 6)) @ root.T
    squares = [errors.squared(x, root @ root.T) for x in xi[:2000]]
    assert np.mean(squares) / 6 == pytest.approx(1, abs=4.5 * np.sqrt(2 / 6 / 2000))
    assert errors.squared(xi[0], np.zeros((6, 6))) == np.inf


@pytest.mark.parametrize(("blur", "reach"), [(0.6, 3.0), (0.9, 4.0), (0.9, 9.0)])
@pytest.mark.parametrize("slopes", [False, True])
def test_unknown_levels_cost_a_fit_as_much_as_they_are_said_to(blur, reach, slopes):
    """The variance of the place in a linear fit with fine pixels: 40 in a px, which is 1e-3 of an integral."""
    d = np.arange(-reach, reach, 0.025) + 0.0125
    bell, step = np.exp(-0.5 * (d / blur) ** 2) / (np.sqrt(2 * np.pi) * blur), ndtr(d / blur)
    ramp = d * step + blur**2 * bell
    columns = [bell, np.ones_like(d), step, *([ramp, d - ramp] if slopes else [])]
    design = np.column_stack(columns)
    variance = np.linalg.inv(design.T @ design)[0, 0] / 0.025  # noise 1 in a px of profile
    least = 1 / float(bound.edge_information(np.ones(1), blur, 1.0)[0])
    assert ground.unknown_levels(blur, reach, slopes=slopes) == pytest.approx(np.sqrt(variance / least), rel=3e-3)


def test_on_level_ground_the_best_fit_knows_all_but_the_levels():
    """Pixels a px apart, blurred by 1 px, sample the step as well as a continuum to 1e-3; 12 px to each side."""
    level = ground.Ground(np.zeros((13, 13)), 40.0)
    best = ground.best_fit(level, 1.0, 0.01)
    assert best.total == pytest.approx(best.by_noise)
    assert best.by_noise == pytest.approx(ground.unknown_levels(1.0, 12.5), rel=3e-3)


def test_the_best_fit_on_rough_ground_errs_as_its_samples_do(rng):
    """Ground that strays at random from the edge on, 6000 stretches fitted by the weights that it must lead to.

    No other linear fit, of known ground or straight, does better: the negative control is a fit that ignores it.
    """
    n, noise, blur = 12, 0.01, 0.9
    i = np.arange(n + 1)
    walk = ground.Ground(4e-4 * np.minimum.outer(i, i), 40.0)
    best = ground.best_fit(walk, blur, noise)
    d = np.arange(-n, n + 1)
    side = [np.cumsum(0.02 * rng.standard_normal((6000, n + 1)) * (i > 0), axis=1)[:, np.abs(d)] for _ in range(2)]
    rough = side[0] * ndtr(-d / blur) + side[1] * ndtr(d / blur)
    y = rough + noise / np.sqrt(40) * rng.standard_normal(rough.shape)
    bell = np.exp(-0.5 * (d / blur) ** 2) / (np.sqrt(2 * np.pi) * blur)
    design = np.column_stack([np.ones(len(d)), ndtr(d / blur), bell])
    least = 1 / np.sqrt(float(bound.edge_information(np.ones(1), blur, noise)[0]) * 40)
    plain = np.std(np.linalg.lstsq(design, y.T)[0][2]) / least
    weight = np.linalg.inv(np.cov(y.T))
    fitted = np.linalg.solve(design.T @ weight @ design, design.T @ weight @ y.T)[2]
    assert np.std(fitted) / least == pytest.approx(best.total, rel=4.5 / np.sqrt(2 * 6000))
    assert plain > 1.5 * best.total
    assert best.by_noise < best.total
