"""Templates among hundreds alike, faint ones, and ones whose scale hardly shows: found, and known as stated."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.errors import BadValue, MissingCore
from cadcam.image.correlate import CorrelateOptions, correlate, register
from cadcam.image.template import Template
from cadcam.native import core

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SIDE = 40


def tile(*, marked: bool) -> Array:
    """Return an L on grey (SIDE, SIDE), with a small mark or without: in coarse pixels they hardly differ."""
    out = np.full((SIDE, SIDE), 0.5)
    out[8:32, 8:16] = out[24:32, 8:32] = 0.9
    if marked:
        out[11:14, 24:27] = 0.1
    return out


def corner(x: float, y: float, angle: float, size: int, *, contrast: float) -> Array:
    """Return what a template sees, turned by an angle at (x, y), of a soft corner of 60 degrees at the origin."""
    v, u = np.mgrid[:size, :size] - (size - 1) / 2
    c, s = math.cos(angle), math.sin(angle)
    px, py = x + c * u - s * v, y + s * u + c * v
    sides = [np.tanh((px * math.cos(a) + py * math.sin(a)) / 1.2) for a in (0.3, 0.3 + math.radians(120))]
    return np.asarray(0.5 + contrast * (1 + sides[0]) * (1 + sides[1]) / 4)


def test_one_among_hundreds_that_look_alike_is_found(rng: np.random.Generator) -> None:
    """400 others lie as the coarse pixels do, the one looked for between them: its coarse maximum is the lowest."""
    template = Template(tile(marked=True))
    factor = template.coarsest()
    pitch = factor * math.ceil(1.5 * SIDE / factor)
    picture = np.full((20 * pitch + SIDE, 20 * pitch + SIDE), 0.5)
    for top in range(0, 20 * pitch, pitch):
        for left in range(0, 20 * pitch, pitch):
            picture[top : top + SIDE, left : left + SIDE] = tile(marked=False)
    at = 7 * pitch + factor // 2
    picture[7 * pitch : 8 * pitch, 7 * pitch : 8 * pitch] = 0.5
    picture[at : at + SIDE, at : at + SIDE] = tile(marked=True)
    picture += rng.normal(scale=0.002, size=picture.shape)
    peaks = correlate(picture, template)
    assert peaks.complete
    assert peaks.q[0] == pytest.approx([at + (SIDE - 1) / 2] * 2, abs=0.05)
    assert peaks.gap[0] > 0.01


@pytest.mark.parametrize(
    ("contrast", "noise", "scales"), [(0.12, 0.02, (1.0, 1.0)), (0.4, 0.01, (0.9, 1.1))], ids=["faint", "scale"]
)
def test_noise_in_the_template_is_not_taken_for_what_it_shows(
    contrast: float, noise: float, scales: tuple[float, float], rng: np.random.Generator
) -> None:
    """A corner's scale shows by the little that lies beyond its two lines; a faint one is as noisy as its slopes.

    The mean square error by the covariance is 1 +- 4 sqrt(2/n) over n numbers, of which those of one match go together
    (n = 2 a match), cubic interpolation allowing half as much again, as it keeps of a picture's noise what is slow.
    """
    motions, trials, normalised = (4 if scales[1] > scales[0] else 3), 50, []
    for _ in range(trials):
        x, y, angle = rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-math.pi, math.pi)
        patch = corner(x, y, angle, 48, contrast=contrast) + rng.normal(scale=noise, size=(48, 48))
        seen = corner(0, 0, 0, 161, contrast=contrast) + rng.normal(scale=noise, size=(161, 161))
        start = [80 + x, 80 + y, angle, 1.0]
        peaks = register(seen, Template(patch), [start], options=CorrelateOptions(scales=scales, least_score=0.1))
        turn = (peaks.angle[0] - angle + math.pi) % (2 * math.pi) - math.pi
        error = np.array([*(peaks.q[0] - start[:2]), turn, peaks.scale[0] - 1])[:motions]
        normalised.append(error / peaks.sigma[0, :motions])
    mean_square = np.mean(np.square(normalised), axis=0)
    assert (mean_square < 1.5 + 4 * math.sqrt(2 / trials)).all(), mean_square
    assert (mean_square > 1 / (1.5 + 4 * math.sqrt(2 / trials))).all(), mean_square


def test_a_climb_that_runs_away_is_left_out() -> None:
    """Where a picture shows nothing of a template, steps grow without bound, and nothing is there to be returned."""
    starts = np.column_stack([np.full(20, 150.0), np.full(20, 100.0), np.linspace(-3, 3, 20), np.ones(20)])
    for seed in range(10):
        rng = np.random.default_rng(seed)
        template = Template(rng.uniform(size=(30, 30)))
        picture = 0.5 + rng.normal(scale=1e-3, size=(200, 300))
        assert len(register(picture, template, starts, options=CorrelateOptions(scales=(0.8, 1.25)))) == 0


@pytest.mark.parametrize("count", [7919, 2 * 6000, 89 * 89])
def test_covariances_do_not_hang_on_how_many_pixels_count(count: int, rng: np.random.Generator) -> None:
    """By a thousand of the pixels sigmas are what they are by those of a mask with a few pixels more, to 10 %.

    A ratio of sums over 1024 points is known to 1 / sqrt(1024), 3 %; of the worst of three motions thrice that.
    """
    y, x = np.mgrid[:130, :130]
    gray = 0.5 + 0.2 * np.sin(x / 3.0) * np.cos(y / 4.0) + 0.1 * np.sin((x + y) / 7.0)
    picture = np.pad(gray, 40, mode="reflect") + rng.normal(scale=0.01, size=(210, 210))
    sigmas = []
    for n in (count, count + 11):
        mask = np.zeros(gray.size, bool)
        mask[:n] = True
        template = Template(gray, mask=mask.reshape(gray.shape))
        peaks = register(picture, template, [[104.5, 104.5, 0.0, 1.0]])
        sigmas.append(peaks.sigma[0, :3])
    np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=0.1)


def test_climbs_that_ran_away_are_not_followed() -> None:
    """They have the score 0, and so had passed where coarse pixels are asked for no more: of 60 seeds, this one."""
    rng = np.random.default_rng(16)
    x, y, angle = rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-math.pi, math.pi)
    patch = corner(x, y, angle, 48, contrast=0.4) + rng.normal(scale=0.01, size=(48, 48))
    seen = corner(0, 0, 0, 161, contrast=0.4) + rng.normal(scale=0.01, size=(161, 161))
    peaks = correlate(seen, Template(patch), options=CorrelateOptions(scales=(0.9, 1.1), least_score=0.1))
    assert peaks.q[0] == pytest.approx([80 + x, 80 + y], abs=0.3)


def board(size: int, squares: int) -> Array:
    """Return a chessboard of gaps (bright) between squares (dark), seen a little from the side: no two alike."""
    v, u = np.mgrid[:size, :size] / size
    depth = 1 + 0.02 * u + 0.01 * v
    dark = np.ones((size, size))
    for along in (u, v):
        off = np.abs((squares * along / depth) % 1 - 0.5) - 0.3
        dark *= 0.5 * (1 - np.tanh(off * size / squares))
    return np.asarray(0.9 - 0.7 * dark)


@pytest.mark.parametrize("count", [1, 6])
def test_the_crossing_of_a_board_that_was_cut_out_is_found_among_all_others(
    rng: np.random.Generator, count: int
) -> None:
    """At coarse pixels 200 others resemble it as well or better: which is the best shows at single ones only."""
    picture = board(600, 12) + rng.normal(scale=0.005, size=(600, 600))
    x, y = 267, 221
    peaks = correlate(picture, Template(picture[y : y + 64, x : x + 64]), options=CorrelateOptions(count=count))
    assert peaks.score[0] == pytest.approx(1, abs=1e-4)
    assert peaks.q[0] == pytest.approx([x + 31.5, y + 31.5], abs=0.01)
    assert peaks.complete


def test_a_search_that_takes_minutes_is_refused_and_its_remedy_works(rng: np.random.Generator) -> None:
    noise = Template(rng.uniform(size=(64, 64)))
    with pytest.raises(BadValue, match=r"as noise does: to search 4000 x 3000 px takes .* cut out around"):
        correlate(np.zeros((3000, 4000)), noise)
    cut = rng.uniform(size=(200, 300))
    cut[50:114, 90:154] = noise.gray
    assert correlate(cut, noise).q[0] == pytest.approx([121.5, 81.5], abs=0.01)


def test_finer_pixels_are_left_out_where_they_take_minutes_and_that_is_told(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    template, picture = Template(tile(marked=True)), rng.uniform(size=(200, 200))
    assert not len(correlate(picture, template))
    assert correlate(picture, template).complete
    products = template.effort(template.coarsest(), (-math.pi, math.pi), (1, 1)) * 200 * 200 / template.coarsest() ** 2
    monkeypatch.setattr("cadcam.image.correlate._MOST", products)
    assert not correlate(picture, template).complete
