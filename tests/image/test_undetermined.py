"""What a template does not show is not known, whatever its noise looks like; what it shows is as known as before."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.errors import MissingCore
from cadcam.image import match_covariance
from cadcam.image.correlate import ANY_ANGLE, CorrelateOptions, Peaks, correlate
from cadcam.image.template import Template
from cadcam.image.undetermined import undetermined
from cadcam.native import core
from cadcam.native.correlate import pulls

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SHAPE, SIDE = (200, 240), 48
# A place anywhere in a picture lies within sqrt(3) sd of the middle along its sides, times sqrt(2) along a diagonal; an
# angle within sqrt(3). The middle is known to a pixel of a hundred.
ANYWHERE = math.sqrt(6) * 1.02
WAVES = [(0.31, 0.05, 1.0), (-0.12, 0.27, 2.0), (0.21, 0.43, 5.0), (0.07, -0.19, 4.0), (0.39, -0.33, 0.5)]


def shown(kind: str, u: Array, v: Array) -> Array:
    """Return what there is at (u, v) px from the middle of a picture."""
    across = 0.5 + 0.5 * np.tanh(u / 0.8)
    if kind == "corner":
        return np.asarray(0.3 + 0.4 * across * (0.5 + 0.5 * np.tanh(v / 0.8)))
    if kind == "disc":
        return np.asarray(0.3 + 0.2 * (1 - np.tanh((np.hypot(u, v) - 15) / 0.8)))
    if kind == "strip":
        return np.asarray(0.3 + 0.2 * (np.tanh((u + 7) / 0.8) - np.tanh((u - 7) / 0.8)))
    if kind == "texture":
        return np.asarray(0.5 + 0.07 * sum(np.sin(a * u + b * v + c) for a, b, c in WAVES))
    if kind == "grid":
        return np.asarray(0.5 + 0.15 * np.sin(u / 2.5) + 0.15 * np.sin(v / 2.5))
    return np.asarray(0.3 + 0.4 * (across if kind == "edge" else np.exp(-0.5 * (u / 1.5) ** 2)))


def taken(
    kind: str,
    at: tuple[float, float],
    angle: float,
    shape: tuple[int, int],
    noise: float,
    rng: np.random.Generator,
    scale: float = 1.0,
) -> Array:
    """Return a picture of it with noise, in eight bits, its middle at a place, turned by an angle and scaled."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    x, y = (x - at[0]) / scale, (y - at[1]) / scale
    c, s = math.cos(angle), math.sin(angle)
    picture = shown(kind, c * x + s * y, c * y - s * x) + rng.normal(scale=noise, size=shape)
    return np.asarray(np.round(np.clip(picture, 0, 1) * 255) / 255)


def matched(
    kind: str, noise: tuple[float, float], rng: np.random.Generator, options: CorrelateOptions = ANY_ANGLE
) -> tuple[Peaks, Template, Array, float, float]:
    """Return the peaks of a template of something in a picture of it, where it lies, its angle, and the picture's.

    Of what half a turn leaves the same, the place is that for the angle found.
    """
    there, own = rng.uniform(-math.pi, math.pi, 2)
    if options.angles != ANY_ANGLE.angles:
        own = there - rng.uniform(*options.angles)
    scale = rng.uniform(*options.scales)
    off, middle = rng.uniform(-1, 1, 2), np.array(SHAPE[::-1]) / 2
    template = Template(
        taken(kind, ((SIDE - 1) / 2 - off[0], (SIDE - 1) / 2 - off[1]), own, (SIDE, SIDE), noise[0], rng)
    )
    picture = taken(kind, (middle[0], middle[1]), there, SHAPE, noise[1], rng, scale)
    peaks, turn = correlate(picture, template, options=options), there - own
    if kind in ("line", "strip") and abs(wrapped(peaks.angle[0] - turn)) > math.pi / 2:
        turn += math.pi
    c, s = scale * math.cos(turn), scale * math.sin(turn)
    q = middle + np.array([c * off[0] - s * off[1], s * off[0] + c * off[1]])
    return peaks, template, q, turn, there


def wrapped(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi


NOISES = [(0.012, 0.012), (0.0, 0.012), (0.012, 0.0), (0.03, 0.03)]


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("kind", ["edge", "line"])
def test_along_an_edge_the_place_is_anywhere(kind: str, noise: tuple[float, float], rng: np.random.Generator) -> None:
    """Noise has a best peak somewhere along it, hundreds of times as far off as that peak is wide."""
    for _ in range(5):
        peaks, template, q, _, direction = matched(kind, noise, rng)
        along = np.array([-math.sin(direction), math.cos(direction)])
        sigma = math.sqrt(along @ peaks.covariance[0, :2, :2] @ along)
        assert abs(along @ (peaks.q[0] - q)) < ANYWHERE * sigma
        assert sigma > min(SHAPE) / math.sqrt(12) * 0.99
        told = undetermined(peaks, template)[0]
        assert len(told.along) == 1
        assert abs(np.array(told.along[0]) @ along) > 0.999
        assert not told.angle
        assert not told.scale


ABOUT_UPRIGHT = CorrelateOptions(angles=(-0.02, 0.02))
# rms of N normalised errors is 1 +- 1 / sqrt(2 N): 3.5 times that, and 0.1 of sigmas that are themselves estimates
DRAWS, WITHIN = 10 * len(NOISES), 0.1 + 3.5 / math.sqrt(20 * len(NOISES))


@pytest.mark.slow
@pytest.mark.parametrize("options", [ANY_ANGLE, ABOUT_UPRIGHT])
@pytest.mark.parametrize("kind", ["edge", "line", "strip"])
def test_across_an_edge_the_place_is_as_known_as_the_edge(
    kind: str, options: CorrelateOptions, rng: np.random.Generator
) -> None:
    """An open direction off by what the slopes leave unknown makes it ten times less known: 0.1 to 0.3 here."""
    across, angle = [], []
    for k in range(DRAWS):
        peaks, template, q, turn, direction = matched(kind, NOISES[k % len(NOISES)], rng, options)
        n, C = np.array([math.cos(direction), math.sin(direction)]), peaks.covariance[0]
        across.append(n @ (peaks.q[0] - q) / math.sqrt(n @ C[:2, :2] @ n))
        angle.append(wrapped(peaks.angle[0] - turn) / peaks.sigma[0, 2])
        told = undetermined(peaks, template)[0]
        assert (len(told.along), told.angle) == (1, False)
        assert abs(np.array(told.along[0]) @ n) < 2e-3
    for error in across, angle:
        assert math.sqrt(np.mean(np.square(error))) == pytest.approx(1, abs=WITHIN)


@pytest.mark.parametrize("options", [ANY_ANGLE, ABOUT_UPRIGHT])
@pytest.mark.parametrize("kind", ["corner", "texture"])
def test_what_has_a_place_is_known_as_stated_in_every_direction(
    kind: str, options: CorrelateOptions, rng: np.random.Generator
) -> None:
    errors = []
    for k in range(DRAWS):
        peaks, template, q, turn, _ = matched(kind, NOISES[k % len(NOISES)], rng, options)
        error = np.array([*(peaks.q[0] - q), wrapped(peaks.angle[0] - turn)])
        errors.append(np.linalg.solve(np.linalg.cholesky(peaks.covariance[0, :3, :3]), error))
        assert not undetermined(peaks, template)[0]
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(1, abs=WITHIN)


@pytest.mark.parametrize("kind", ["edge", "corner"])
def test_what_only_rounding_blurs_is_known_as_stated(kind: str, rng: np.random.Generator) -> None:
    """Rounding leaves most at edges, alike along them; between pixels a wrong spline errs alike along them as well.

    Taken for noise all over the template, it made an edge's angle 11, a corner's place 4 times as good as it is.
    """
    errors = []
    for _ in range(DRAWS):
        peaks, _, q, turn, _ = matched(kind, (0.0, 0.0), rng, ABOUT_UPRIGHT)
        error = np.array([*(peaks.q[0] - q), wrapped(peaks.angle[0] - turn)])
        C = peaks.covariance[0, :3, :3]
        errors.append(np.linalg.solve(np.linalg.cholesky(C), error) if kind == "corner" else error[2:] / C[2, 2] ** 0.5)
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(1, abs=WITHIN)


@pytest.mark.parametrize("side", [1, 4])
def test_what_pulls_at_a_peak_is_that_of_a_spline_summed_over_squares(side: int, rng: np.random.Generator) -> None:
    """By SciPy's spline through all of the picture, and every square's sum written out."""
    from scipy.ndimage import map_coordinates, spline_filter

    picture = taken("texture", (20.0, 20.0), 0.0, (48, 50), 0.01, rng)
    points = Template(taken("texture", (10.0, 9.0), 0.2, (20, 21), 0.01, rng)).settling(4)
    pose = np.array([24.3, 22.9, 0.3, 1.07])
    u, v, value, J = (
        a[..., : points.count].astype(np.float64) for a in (points.u, points.v, points.value, points.slope)
    )
    spline = spline_filter(picture)

    def seen(at: Array) -> Array:
        c, s = at[3] * math.cos(at[2]), at[3] * math.sin(at[2])
        where = [at[1] + s * u + c * v, at[0] + c * u - s * v]
        return np.asarray(map_coordinates(spline, where, order=3, prefilter=False))

    off = seen(pose) - seen(pose).mean()
    gain, (angle, scale) = off @ value, pose[2:]
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    by = 1e-4 * np.array([[c, s, 0, 0], [-s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, scale]])
    slopes = np.stack([(seen(pose + d) - seen(pose - d)) / 2e-4 for d in by])
    pull = J * (off / gain - value)
    left, top = np.rint(u - u.min()), np.rint(v - v.min())
    corners = [(i, j) for i in range(1 - side, 21) for j in range(1 - side, 20)]
    squares = [(left >= i) & (left < i + side) & (top >= j) & (top < j + side) for i, j in corners]
    sums = np.stack([pull[:, square].sum(axis=1) for square in squares])
    moment, shown = (a[0] for a in pulls(picture.astype(np.float32), points, pose, side))
    assert moment == pytest.approx(sums.T @ sums / side**2, rel=1e-3, abs=1e-3 * np.abs(moment).max())
    assert shown == pytest.approx(J @ slopes.T / gain, rel=1e-3, abs=1e-3 * np.abs(shown).max())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["edge", "line"])
def test_along_an_edge_of_any_scale_the_place_is_anywhere(kind: str, rng: np.random.Generator) -> None:
    """Noise mixes the shift along it with the growth: the one known, the range of the other would be taken for both."""
    options = CorrelateOptions(angles=(-0.02, 0.02), scales=(0.87, 1.15))
    for k in range(DRAWS):
        peaks, template, q, _, direction = matched(kind, NOISES[k % len(NOISES)], rng, options)
        along = np.array([-math.sin(direction), math.cos(direction)])
        sigma = math.sqrt(along @ peaks.covariance[0, :2, :2] @ along)
        assert abs(along @ (peaks.q[0] - q)) < ANYWHERE * sigma
        assert sigma > min(SHAPE) / math.sqrt(12) * 0.9
        assert len(undetermined(peaks, template)[0].along) == 1


@pytest.mark.parametrize("noise", NOISES)
def test_of_a_disc_the_angle_is_anything(noise: tuple[float, float], rng: np.random.Generator) -> None:
    for _ in range(5):
        peaks, template, _, turn, _ = matched("disc", noise, rng)
        assert abs(wrapped(peaks.angle[0] - turn)) < ANYWHERE * peaks.sigma[0, 2]
        told = undetermined(peaks, template)[0]
        assert told.angle
        assert not told.along


@pytest.mark.parametrize(
    ("kind", "noise"),
    [
        pytest.param(kind, noise, marks=[pytest.mark.slow] * (kind == "grid" and noise in NOISES[:2]))
        for kind in ("corner", "grid")
        for noise in NOISES
    ],
)
def test_what_has_a_place_is_not_called_undetermined(
    kind: str, noise: tuple[float, float], rng: np.random.Generator
) -> None:
    """A grid has many: each is a peak of its own, and where that is is known."""
    for _ in range(5):
        peaks, template, q, turn, _ = matched(kind, noise, rng)
        assert not undetermined(peaks, template)[0]
        if kind == "corner":
            error = np.array([*(peaks.q[0] - q), wrapped(peaks.angle[0] - turn)])
            assert (np.abs(error) < 5 * peaks.sigma[0, :3]).all()


def test_the_peaks_of_noise_would_be_taken_for_an_edge_s_place(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The guard, broken: every peak has slopes on both sides that agree."""
    monkeypatch.setattr(match_covariance, "_CLEARLY", -1.0)
    worst = 0.0
    for _ in range(5):
        peaks, _, q, _, direction = matched("edge", (0.012, 0.012), rng)
        along = np.array([-math.sin(direction), math.cos(direction)])
        worst = max(worst, abs(along @ (peaks.q[0] - q)) / math.sqrt(along @ peaks.covariance[0, :2, :2] @ along))
    assert worst > 5


def test_an_exact_step_is_found_across_and_nowhere_along() -> None:
    """Along it nothing changes at all: there is no slope to climb by."""
    step = np.where(np.arange(240) < 120, 0.2, 0.8)
    peaks = correlate(np.tile(step, (200, 1)), Template(np.tile(step[96:144], (48, 1))))
    assert peaks.q[0, 0] == pytest.approx(119.5, abs=0.01)
    assert peaks.sigma[0, 0] < 0.01
    assert peaks.sigma[0, 1] == pytest.approx(200 / math.sqrt(12))


@pytest.mark.parametrize("noise", [(0.0, 0.012), (0.012, 0.0)])
def test_an_edge_without_noise_is_found_in_any_direction(noise: tuple[float, float], rng: np.random.Generator) -> None:
    """The steps of eight bits do not send a climb along it away; where all of it is alike, it is found inside."""
    middle = ((SIDE - 1) / 2, (SIDE - 1) / 2)
    for degrees in (-90.1, 8.85, 45.0, 81.27, 96.84, 134.9):
        for _ in range(4):
            template = Template(taken("edge", middle, math.radians(degrees - 0.5), (SIDE, SIDE), noise[0], rng))
            picture = taken("edge", (120.0, 100.0), math.radians(degrees), SHAPE, noise[1], rng)
            assert len(correlate(picture, template, options=CorrelateOptions(angles=(0.0, 0.0))))
