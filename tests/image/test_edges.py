from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr

from cadcam.errors import BadValue
from cadcam.image.edges import EdgePoints, canny, distance_to_edges

SIZE = (60, 50)
CENTRE = np.array([(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2])
CONTRAST = 0.6


def step(angle: float, shift: float, blur: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a picture of a blurred step, integrated over each pixel's square, and the step's unit normal."""
    node, weight = np.polynomial.legendre.leggauss(6)
    n = np.array([math.cos(angle), math.sin(angle)])
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    d = (x - CENTRE[0]) * n[0] + (y - CENTRE[1]) * n[1] - shift
    parts = (
        0.25 * wu * wv * ndtr((d + 0.5 * (u * n[0] + v * n[1])) / blur)
        for u, wu in zip(node, weight, strict=True)
        for v, wv in zip(node, weight, strict=True)
    )
    return 0.2 + CONTRAST * sum(parts), n


@pytest.mark.parametrize("blur", [0.5, 0.7, 1.0])
def test_a_step_at_any_angle_is_found_within_a_hundredth_of_a_pixel(rng, blur):
    # measured: at most 0.007, 0.0013, 0.0004 px; what is left is the pixel's square not being a Gaussian
    for angle, shift in zip(rng.uniform(0, 2 * np.pi, 20), rng.uniform(-1, 1, 20), strict=True):
        gray, n = step(angle, shift, blur)
        edges = canny(gray)
        inside = ((edges.q > 4) & (edges.q < np.array(SIZE) - 5)).all(axis=1)
        assert inside.sum() > 30
        error = (edges.q[inside] - CENTRE) @ n - shift
        assert np.abs(error).max() < 0.01
        assert (edges.normal[inside] @ n > math.cos(math.radians(0.2))).all()


def test_strength_is_the_height_a_gaussian_blurred_step_has():
    edges = canny(step(0.3, 0.0, 0.8)[0])
    inside = np.abs(edges.q - CENTRE).max(axis=1) < 15
    expected = CONTRAST / math.sqrt(2 * math.pi * (0.8**2 + 1 / 12 + 1.0**2))
    np.testing.assert_allclose(edges.strength[inside], expected, rtol=0.002)


def test_scatter_in_noise_is_near_the_cramer_rao_bound(rng):
    # Fisher information per px of edge length: c^2 / (2 sqrt(pi) b s^2). The mean over 40 px of edge scatters
    # 1.3 times the bound (sigma 1, b 0.7); 80 trials know that factor to 8 %, so 1.65 is three sigmas and some.
    blur, noise, length, offsets = 0.7, 0.02, 40, []
    for angle, shift in zip(rng.uniform(0, 2 * np.pi, 80), rng.uniform(-1, 1, 80), strict=True):
        gray, n = step(angle, shift, blur)
        edges = canny(gray + rng.normal(0, noise, gray.shape), low=0.04, high=0.06)
        across = (edges.q - CENTRE) @ n - shift
        along = (edges.q - CENTRE) @ np.array([-n[1], n[0]])
        offsets.append(across[(np.abs(along) < length / 2) & (np.abs(across) < 3)].mean())
    total_blur = math.hypot(blur, math.sqrt(1 / 12))
    bound = math.sqrt(2 * math.sqrt(math.pi) * total_blur / length) * noise / CONTRAST
    assert 0.8 < np.std(offsets) / bound < 1.65
    assert abs(np.mean(offsets)) < 4 * np.std(offsets) / math.sqrt(len(offsets))


def test_x_is_the_column_and_pixel_centres_are_whole_numbers():
    gray = np.zeros((20, 40))
    gray[:, 11:] = 0.8
    gray[:, 10] = 0.2  # a quarter of the pixel -1/2 .. 1/2 about x = 10 is bright: the step is at 10.25
    edges = canny(gray)
    middle = edges.q[np.abs(edges.q[:, 1] - 10) < 5]
    np.testing.assert_allclose(middle[:, 0], 10.25, atol=0.06)  # aliased for want of blur: 0.04 off
    np.testing.assert_array_equal(np.sort(middle[:, 1]), np.arange(6, 15))
    np.testing.assert_allclose(edges.normal, np.tile([1.0, 0.0], (len(edges), 1)), atol=1e-6)
    assert edges.mask((40, 20))[10, 10]
    assert edges.mask((40, 20)).sum() == len(edges)


def test_a_weak_stretch_stays_only_on_a_curve_that_is_strong_somewhere():
    gray = np.zeros((60, 60))
    gray[:30, 15:25] = 0.5
    gray[30:, 15:25] = 0.2  # joined to the strong half
    gray[:, 40:50] = 0.2  # alone
    edges = canny(gray, low=0.03, high=0.1)
    assert (edges.q[:, 0] < 30).all()
    on_weak = np.abs(edges.q - [14.5, 45]).max(axis=1) < 10
    assert on_weak.sum() == 19
    assert (canny(gray, low=0.03, high=0.03).q[:, 0] > 30).any()


@pytest.mark.parametrize(("share", "kept"), [(0.5, True), (0.35, False)])
def test_by_default_a_curve_goes_on_down_to_two_fifths_of_what_starts_it(share, kept):
    start = 8 / 255 / math.sqrt(2 * math.pi * (1 + 0.7**2))  # the default in a picture without noise
    contrast = start * math.sqrt(2 * math.pi)  # of a step that sharp; half a pixel beside it the slope is 0.88 of that
    gray = np.zeros((60, 60))
    gray[:30, 15:25] = 1.3 * contrast
    gray[30:, 15:25] = share * contrast
    edges = canny(gray)
    assert (np.abs(edges.q - [14.5, 45]).max(axis=1) < 10).any() == kept


def test_flat_and_noisy_pictures_have_almost_no_edges_by_default(rng):
    assert len(canny(np.full((50, 60), 0.5))) == 0
    for noise in (0.001, 0.01, 0.1):
        edges = canny(0.5 + rng.normal(0, noise, (300, 300)))
        assert len(np.unique(edges.chain)) <= 3  # 90000 pixels x 4e-6
    assert len(canny(np.zeros((1, 1)))) == 0


def test_chains_number_separate_curves():
    y, x = np.mgrid[:80, :100]
    gray = (np.hypot(x - 25, y - 40) < 15).astype(float) + (np.hypot(x - 70, y - 40) < 20)
    edges = canny(gray)
    assert set(edges.chain) == {0, 1}
    assert len(np.unique(edges.chain[edges.q[:, 0] < 45])) == 1


def random_edges(rng: np.random.Generator, n: int) -> EdgePoints:
    angle = rng.uniform(-np.pi, np.pi, n)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    return EdgePoints(rng.uniform(0, 50, (n, 2)), normal, np.ones(n), np.zeros(n, int))


def test_distances_agree_with_trying_every_edge_point(rng):
    edges, q = random_edges(rng, 300), rng.uniform(-10, 60, (200, 2))
    normal = random_edges(rng, 200).normal
    far = np.linalg.norm(q[:, None] - edges.q, axis=2)
    np.testing.assert_allclose(distance_to_edges(edges, q), far.min(axis=1))
    for within in (math.radians(1), math.radians(20), math.pi / 2):
        agrees = np.abs(normal @ edges.normal.T) >= math.cos(within) - 1e-12
        expected = np.where(agrees, far, np.inf).min(axis=1)
        np.testing.assert_allclose(distance_to_edges(edges, q, normal=normal, within=within), expected)


def test_distance_without_any_edge_is_infinite_and_of_nan_is_nan(rng):
    q = [[1.0, 2.0], [np.nan, 0.0]]
    for normal in (None, [[1.0, 0.0], [1.0, 0.0]]):
        found = distance_to_edges(random_edges(rng, 0), q, normal=normal)
        np.testing.assert_array_equal(found, [np.inf, np.nan])


def test_bad_arguments_are_named():
    gray = np.zeros((5, 5))
    for options in ({"sigma": 0.0}, {"sigma": math.nan}, {"low": 2.0, "high": 1.0}, {"low": math.nan}):
        with pytest.raises(BadValue, match=next(iter(options))):
            canny(gray, **options)
    with pytest.raises(BadValue, match="to_gray"):
        canny(np.zeros((5, 5, 3)))
    with pytest.raises(BadValue, match="q is of shape"):
        EdgePoints(np.zeros((3, 2)), np.zeros((2, 2)), np.zeros(2), np.zeros(2))
