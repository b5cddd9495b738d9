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
