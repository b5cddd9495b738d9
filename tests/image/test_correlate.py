"""Templates are found where they are, in any orientation, as exactly as the covariance says, and nowhere else."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from cadcam.arrays import Array
from cadcam.errors import BadValue, MissingCore
from cadcam.image.correlate import CorrelateOptions, correlate, register
from cadcam.image.template import Template
from cadcam.native import core

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SIGMA = 0.02


def textured(rng: np.random.Generator, shape: tuple[int, int] = (240, 320)) -> Array:
    """Return a smooth random picture: band-limited, so that a cubic spline through its pixels is the picture."""
    values = gaussian_filter(rng.normal(size=shape), 2.0)
    return 0.5 + 0.15 * values / values.std()


def seen_at(picture: Array, x: float, y: float, angle: float, size: tuple[int, int], scale: float = 1.0) -> Array:
    """Return what lies in the picture under a template of a size (w, h) centred at (x, y), turned by angle."""
    v, u = np.mgrid[: size[1], : size[0]].astype(float)
    u, v = scale * (u - (size[0] - 1) / 2), scale * (v - (size[1] - 1) / 2)
    c, s = math.cos(angle), math.sin(angle)
    sampled: Array = map_coordinates(picture, [y + s * u + c * v, x + c * u - s * v], order=5, mode="nearest")
    return sampled


def turn_between(a: float, b: float) -> float:
    return (a - b + math.pi) % (2 * math.pi) - math.pi


def test_errors_are_those_that_the_covariance_predicts(rng: np.random.Generator) -> None:
    """Over 60 matches x 3 coordinates the mean square normalised error is 1 +- 4 sqrt(2/180), cubic interpolation and
    the noise in the template's own slopes allowing 15 % more. A bias of one sigma would double it."""
    normalised = []
    for _ in range(60):
        picture = textured(rng, (160, 200))
        x, y, angle = rng.uniform(40, 160), rng.uniform(40, 120), rng.uniform(-math.pi, math.pi)
        patch = seen_at(picture, x, y, angle, (48, 48)) + rng.normal(scale=SIGMA, size=(48, 48))
        peaks = correlate(picture + rng.normal(scale=SIGMA, size=picture.shape), Template(patch))
        error = [*(peaks.q[0] - [x, y]), turn_between(peaks.angle[0], angle)]
        normalised.append(np.linalg.solve(np.linalg.cholesky(peaks.covariance[0, :3, :3]), error))
    mean_square = float(np.mean(np.square(normalised)))
    assert abs(mean_square - 1) < 4 * math.sqrt(2 / 180) + 0.15


@pytest.mark.parametrize("size", [(31, 31), (64, 64), (90, 40), (33, 70)])
def test_templates_of_any_shape_are_found(size: tuple[int, int], rng: np.random.Generator) -> None:
    picture = textured(rng)
    patch = seen_at(picture, 151.3, 118.6, 2.1, size)
    peaks = correlate(picture, Template(patch))
    assert np.abs(peaks.q[0] - [151.3, 118.6]).max() < 0.02
    assert abs(turn_between(peaks.angle[0], 2.1)) < math.radians(0.05)
    assert peaks.score[0] > 0.99
    assert peaks.complete


def test_gain_and_offset_change_nothing(rng: np.random.Generator) -> None:
    picture = textured(rng)
    patch = seen_at(picture, 120.0, 90.0, -0.7, (48, 48))
    plain, dimmed = (correlate(p, Template(patch)) for p in (picture, 0.3 * picture + 0.4))
    assert np.allclose(plain.q[0], dimmed.q[0], atol=1e-3)  # float32 and the climb's last step
    assert plain.score[0] == pytest.approx(dimmed.score[0], abs=1e-4)


def test_what_is_there_twice_has_no_gap_and_what_is_there_once_has_one(rng: np.random.Generator) -> None:
    picture = textured(rng)
    patch = seen_at(picture, 80.0, 80.0, 0.0, (41, 41))
    once = correlate(picture, Template(patch))
    doubled = picture.copy()
    doubled[120:161, 200:241] = patch
    twice = correlate(doubled, Template(patch))
    assert once.gap[0] > 0.2
    assert twice.gap[0] < 1e-3
    assert {tuple(q) for q in np.rint(twice.q[:2])} == {(80.0, 80.0), (220.0, 140.0)}
    assert np.isnan(twice.gap[-1])


def test_a_template_that_looks_the_same_after_a_quarter_turn_has_four_peaks(rng: np.random.Generator) -> None:
    square = np.zeros((51, 51))
    square[12:39, 12:39] = 1
    square = gaussian_filter(square, 1.0)
    picture = gaussian_filter(rng.normal(size=(200, 200)), 2) * 0.05
    picture[80:131, 60:111] += seen_at(square, 25, 25, 0.4, (51, 51))
    peaks = correlate(picture, Template(square), options=CorrelateOptions(count=6, least_score=0.8))
    assert len(peaks) == 4
    assert np.allclose(peaks.q, [85, 105], atol=0.1)
    angles = np.sort((peaks.angle - peaks.angle[0]) % (2 * math.pi))
    assert np.allclose(angles, np.arange(4) * math.pi / 2, atol=0.01)


def test_what_the_mask_leaves_out_does_not_matter(rng: np.random.Generator) -> None:
    picture = textured(rng)
    patch = seen_at(picture, 140.0, 100.0, 1.1, (56, 56))
    mask = np.ones(patch.shape, bool)
    mask[:, :20] = False
    patch[:, :20] = rng.uniform(size=(56, 20))
    masked = correlate(picture, Template(patch, mask=mask))
    assert np.abs(masked.q[0] - [140, 100]).max() < 0.02
    assert masked.score[0] > 0.99
    plain = correlate(picture, Template(patch))
    assert not len(plain) or plain.score[0] < 0.9  # the control: without its mask the template does not fit


def test_the_scale_is_found_with_the_rest(rng: np.random.Generator) -> None:
    picture = textured(rng)
    patch = seen_at(picture, 150.4, 110.2, 0.3, (48, 48), scale=1.13)
    options = CorrelateOptions(angles=(-1.0, 1.0), scales=(0.8, 1.25))
    peaks = correlate(picture, Template(patch), options=options)
    assert np.abs(peaks.q[0] - [150.4, 110.2]).max() < 0.03
    assert peaks.scale[0] == pytest.approx(1.13, abs=0.002)
    assert peaks.sigma[0, 3] > 0
    assert correlate(picture, Template(patch)).scale.tolist().count(1.0) == len(correlate(picture, Template(patch)))


def test_reversed_contrast_matches_only_if_asked(rng: np.random.Generator) -> None:
    picture = textured(rng)
    template = Template(1 - seen_at(picture, 150.0, 110.0, 0.5, (48, 48)))
    asked = correlate(picture, template, options=CorrelateOptions(either_sign=True))
    assert asked.score[0] < -0.99
    assert np.abs(asked.q[0] - [150, 110]).max() < 0.02
    plain = correlate(picture, template)
    assert not len(plain) or plain.score[0] < 0.8


def test_angles_that_were_not_asked_for_are_not_found(rng: np.random.Generator) -> None:
    picture = textured(rng)
    template = Template(seen_at(picture, 150.0, 110.0, 1.0, (48, 48)))
    near = correlate(picture, template, options=CorrelateOptions(angles=(0.8, 1.3)))
    far = correlate(picture, template, options=CorrelateOptions(angles=(-1.3, -0.8)))
    assert near.score[0] > 0.99
    assert not len(far) or far.score[0] < 0.8
    fixed = correlate(
        picture, Template(seen_at(picture, 150.0, 110.0, 0.0, (48, 48))), options=CorrelateOptions(angles=(0, 0))
    )
    assert abs(fixed.angle[0]) < 1e-3


def test_nothing_is_found_where_nothing_is(rng: np.random.Generator) -> None:
    template = Template(textured(rng, (48, 48)))
    assert not len(correlate(np.full((200, 200), 0.5), template))
    noise = correlate(rng.uniform(size=(200, 200)), template, options=CorrelateOptions(least_score=0.5))
    assert not len(noise)
    assert not len(correlate(textured(rng, (30, 30)), template))  # smaller than the template


def test_peaks_lie_in_the_picture_and_at_its_very_border(rng: np.random.Generator) -> None:
    picture = textured(rng)
    for x, y in ((23.5, 23.5), (295.5, 23.5), (23.5, 215.5), (295.5, 215.5)):
        peaks = correlate(picture, Template(seen_at(picture, x, y, 0.0, (48, 48))))
        assert np.abs(peaks.q[0] - [x, y]).max() < 0.05
    box = np.array([[-23.5, -23.5], [23.5, -23.5], [23.5, 23.5], [-23.5, 23.5]])
    corners = correlate(picture, Template(seen_at(picture, 23.5, 23.5, 0.0, (48, 48)))).at(box)
    assert corners.min() > -1.01
    assert (corners < [320.01, 240.01]).all()


@pytest.mark.parametrize(
    ("size", "scales", "x", "y", "angle"),
    [
        ((96, 24), (1.0, 1.0), 160.0, 11.5, 0.0),
        ((96, 24), (1.0, 1.0), 11.5, 120.0, 90.0),
        ((24, 96), (1.0, 1.0), 307.5, 150.0, 180.0),
        ((96, 24), (1.0, 1.0), 47.5, 227.5, 180.0),
        ((48, 48), (1.0, 2.0), 23.5, 23.5, 0.0),
    ],
)
def test_where_a_template_would_not_fit_turned_otherwise_or_larger_it_is_found(
    size: tuple[int, int], scales: tuple[float, float], x: float, y: float, angle: float, rng: np.random.Generator
) -> None:
    picture = textured(rng)
    template = Template(seen_at(picture, x, y, math.radians(angle), size))
    peaks = correlate(picture, template, options=CorrelateOptions(scales=scales))
    assert np.abs(peaks.q[0] - [x, y]).max() < 0.05
    assert abs(turn_between(peaks.angle[0], math.radians(angle))) < math.radians(0.1)


def test_a_near_start_climbs_to_the_peak_that_the_search_finds(rng: np.random.Generator) -> None:
    picture = textured(rng)
    template = Template(seen_at(picture, 150.3, 110.8, 0.5, (48, 48)))
    searched = correlate(picture, template)
    climbed = register(picture, template, [[152.0, 109.0, 0.45, 1.0]])
    assert np.allclose(climbed.q[0], searched.q[0], atol=0.003)  # both end with steps below 0.001 px
    assert (
        not len(register(picture, template, [[250.0, 60.0, -2.0, 1.0]]))
        or register(picture, template, [[250.0, 60.0, -2.0, 1.0]]).score[0] < 0.9
    )


def test_instruction_sets_agree(rng: np.random.Generator) -> None:
    """To a thousandth of a pixel: sums are ordered differently, but every step converges to the same peak."""
    if core.choose_variant(-1) == "baseline":
        pytest.skip("this processor has the baseline only")
    picture = textured(rng)
    template = Template(seen_at(picture, 150.3, 110.8, -2.5, (48, 48)))
    try:
        core.choose_variant(-1)
        fast = correlate(picture, template)
        core.choose_variant(0)
        slow = correlate(picture, template)
    finally:
        core.choose_variant(-1)
    assert np.allclose(fast.q[0], slow.q[0], atol=1e-3)
    assert np.allclose(fast.score, slow.score, atol=1e-4)


@pytest.mark.parametrize(
    ("gray", "mask", "words"),
    [
        (np.full((20, 20), 0.5), None, "flat"),
        (np.eye(4), None, "16 pixels that count; expected at least 25"),
        (np.eye(20), np.zeros((20, 20), bool), "0 pixels that count"),
        (np.eye(20), np.ones((10, 10), bool), "mask is of shape"),
        (np.full((20, 20), np.nan), None, "nan|finite"),
    ],
)
def test_useless_templates_are_refused(gray: Array, mask: Array | None, words: str) -> None:
    with pytest.raises(BadValue, match=words):
        Template(gray, mask=mask)


@pytest.mark.parametrize(
    "options",
    [{"angles": (1.0, 0.0)}, {"angles": (0.0, 7.0)}, {"scales": (0.0, 1.0)}, {"scales": (2.0, 1.0)}, {"count": 0}],
)
def test_impossible_wishes_are_refused(options: dict) -> None:
    with pytest.raises(BadValue):
        CorrelateOptions(**options)


def test_a_colour_picture_is_taken_by_its_grey_levels(rng: np.random.Generator) -> None:
    picture = textured(rng)
    template = Template(seen_at(picture, 150.0, 110.0, 0.5, (48, 48)))
    colour = correlate(np.repeat(picture[..., None], 3, axis=2), template)
    assert np.allclose(colour.q[0], [150, 110], atol=0.02)


def test_a_template_turned_as_the_picture_has_it_stands_out_more(rng: np.random.Generator) -> None:
    """Tables 3.15 and 3.16: with the right rotation of the feature both the peak and its gap to the next are larger."""
    picture = textured(rng)
    patch = seen_at(picture, 150.0, 110.0, math.radians(8), (48, 48))
    unturned = correlate(picture, Template(patch), options=CorrelateOptions(angles=(0, 0), least_score=0.2))
    turned = correlate(picture, Template(patch), options=CorrelateOptions(angles=(-0.5, 0.5), least_score=0.2))
    assert turned.score[0] > unturned.score[0] + 0.1
    assert turned.gap[0] > unturned.gap[0] + 0.1


def test_peaks_are_told_by_the_best() -> None:
    gray = np.random.default_rng(5).uniform(size=(60, 80))
    peaks = correlate(gray, Template(gray[10:41, 20:51]), options=CorrelateOptions(angles=(0.0, 0.0), count=2))
    assert repr(peaks).startswith(f"Peaks({len(peaks)}, the best: score 1.000 at (35.00, 25.00) px, turned by ")
    empty = np.zeros((0, 2)), *[np.zeros(0)] * 3, np.zeros((0, 4, 4))
    assert repr(type(peaks)(*empty)) == "Peaks(none)"
