"""Chapter 4 and Appendix A of the dissertation, and their misprints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.target.marks.cross import cross, surface, taps, template
from cadcam.target.marks.ideal import marks_picture
from cadcam.target.marks.mark import Mark, bulls_eye
from cadcam.target.marks.subpixel import Peak, autocorrelation

PRINTED = Peak(8.0, 1.72, 4)  # EQ 4.3
MARK = bulls_eye(40.0, 80.0, 120.0)  # a disc in a ring, as in Fig. 4-2
RADIUS = 9.0  # px: its template is 23 x 23, as the dissertation's


def _seen(shift: Array, mark: Mark = MARK, radius: float = RADIUS) -> Picture:
    """Return a picture, without noise, of a mark whose centre lies `shift` px from pixel (20, 20)."""
    cx, cy = np.array([20.0, 20.0]) + shift
    camera = Camera.from_focal((41, 41), 600.0, cx=cx, cy=cy)
    pose = Rigid(np.eye(3), [0, 0, 600.0 * mark.radius / radius])
    return marks_picture([mark], camera, [pose], blur_px=0.6, background=0.9)


def test_the_function_has_the_golden_values_of_eq_4_3(golden: Callable[[str], dict[str, Any]]) -> None:
    row = golden("fpeak.a8p1.72")
    assert np.allclose(PRINTED(np.arange(-4, 5), 0.0), row["value"], atol=row["tol"])


def test_a_and_p_do_not_carry_over_to_another_l() -> None:
    """Table 4.1 uses a = 8, p = 1.72 of l = 4 with l = 5, 9, 4, 7: another function each time."""
    assert PRINTED(1.0, 0.0) == pytest.approx(0.478, abs=5e-4)
    assert Peak(8.0, 1.72, 9)(1.0, 0.0) == pytest.approx(0.833, abs=5e-4)


def test_eq_4_5_prints_a_mean_square() -> None:
    window = PRINTED(*np.meshgrid(np.arange(-4, 5) - 0.3, np.arange(-4, 5.0)))
    square = np.mean((PRINTED(*np.meshgrid(np.arange(-4, 5), np.arange(-4, 5.0))) - window) ** 2)
    assert PRINTED.rms_at(window, (0, 0)) == pytest.approx(np.sqrt(square), rel=1e-12)


def test_the_printed_rms_of_peak_1_at_zero_is_impossible() -> None:
    """Triangle inequality: two functions' distances from the peak differ by at most their own. 0.0102 would do."""
    peak = Peak(8.0, 1.72, 5)
    y, x = np.mgrid[-5:6, -5:6]
    apart = np.sqrt(np.mean((peak(x, y) - peak(x - 0.14, y - 0.36)) ** 2))
    assert np.sqrt(0.102) - np.sqrt(0.0091) > 3 * apart
    assert np.sqrt(0.0102) - np.sqrt(0.0091) < apart


def test_the_mark_lies_at_minus_the_argument_of_eq_4_4(shared: Callable[[str], Path]) -> None:
    """f(x + dx) moves the function by -dx. Tables 4.2 and 4.3 print (dx, dy), Table 4.1 their negatives."""
    ideal = template(MARK, RADIUS)
    peak = Peak.of_template(ideal)
    window, top = surface(_seen(np.array([0.3, -0.2])), np.array([[20.0, 20.0]]), taps(ideal), peak.l)
    d, _ = peak.shift(window[0])
    assert np.allclose(top[0] - d, [20.3, 19.8], atol=0.05)
    first, second = (
        np.loadtxt(shared(f"thesis/tables/table_4_{k}.csv"), delimiter=",", comments="#", skiprows=3) for k in (1, 2)
    )
    middle = second[second[:, 1] == 1.72]
    assert np.allclose(middle[:, 2:4], -first[:, 1:3])


@pytest.mark.parametrize(("a", "p"), [(7.0, 1.72), (9.0, 1.72), (8.0, 1.64), (8.0, 1.8)])
def test_the_position_hardly_depends_on_a_and_p(a: float, p: float) -> None:
    """Tables 4.2, 4.3: by at most 0.02 px for shifts below half a pixel (peaks 1, 3, 4)."""
    true = Peak(8.0, 1.72, 4)
    y, x = np.mgrid[-4:5, -4:5]
    window = true(x - 0.14, y - 0.36)
    d, _ = Peak(a, p, 4).shift(window)
    assert np.allclose(d, [-0.14, -0.36], atol=0.02)


def test_the_grid_search_ends_at_the_grid_point_next_to_the_minimum() -> None:
    y, x = np.mgrid[-4:5, -4:5]
    window = PRINTED(x - 0.147, y + 0.362)
    d, rms = PRINTED.shift(window)
    assert np.allclose(d, [-0.147, 0.362], atol=1e-6)
    on_grid, rms_on_grid = PRINTED.shift(window, grid=0.02)
    assert np.abs(on_grid - d).max() <= 0.0101
    assert rms <= rms_on_grid
    assert np.allclose(on_grid / 0.02, np.rint(on_grid / 0.02), atol=1e-9)


def _errors(zero_mean: bool) -> Array:
    """Return the errors of the dissertation's method at 16 places within a pixel, without noise."""
    ideal = template(MARK, RADIUS)
    fitted = Peak.of_template(ideal)
    errors = []
    for shift in np.random.default_rng(2).uniform(-0.5, 0.5, (16, 2)):
        seen = _seen(shift)
        window, top = surface(seen, np.array([[20.0, 20.0]]), taps(ideal), fitted.l, zero_mean=zero_mean)
        errors.append(top[0] - fitted.shift(window[0])[0] - 20 - shift)
    return np.array(errors)


def test_without_means_taken_off_the_correlation_cannot_have_the_shape_of_eq_4_3() -> None:
    """EQ 7.1 of positive pictures stays far above exp(-8); fitted all the same, it is off several times as far."""
    ideal = template(MARK, RADIUS)
    assert autocorrelation(ideal, zero_mean=False).min() > 0.4
    assert autocorrelation(ideal).min() < 0
    good, poor = (float(np.sqrt(np.mean(_errors(z) ** 2))) for z in (True, False))
    assert good < 0.04  # its floor: f is not quite the correlation's shape
    assert poor > 0.05
    assert poor > 2 * good


def test_program_cross_finds_by_slices_what_the_whole_template_would_find(rng: np.random.Generator) -> None:
    """Its two coarse sweeps lose none of six marks, and no more is found."""
    camera = Camera.from_focal((200, 140), 600.0)
    places = [np.array([x, y, 4000.0]) for x in (-400.0, 0.0, 400.0) for y in (-230.0, 230.0)]
    poses = [Rigid(np.eye(3), p) for p in places]
    picture = marks_picture([MARK] * 6, camera, poses, blur_px=0.6, background=0.9, noise=0.03, rng=rng)
    q, score = cross(picture, template(MARK, 600.0 * 60 / 4000))
    truth = camera.project(np.array(places))
    assert len(q) == 6
    assert np.linalg.norm(q[:, None] - truth, axis=2).min(axis=1).max() < 0.5
    assert score.min() > 0.9
