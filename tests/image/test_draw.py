from __future__ import annotations

import math

import numpy as np
import pytest

from cadcam.errors import BadValue, UnknownName
from cadcam.image.draw import draw_points, draw_polylines, draw_text

BLACK = np.zeros((110, 120), np.float32)
WHITE = (1.0, 1.0, 1.0)
MIDDLE = np.array([60.0, 55.0])


def ink(*lines: object, picture: np.ndarray = BLACK, **options: object) -> np.ndarray:
    return draw_polylines(picture, lines, color=WHITE, **options)[..., 0].astype(float)


def centre_across(gray: np.ndarray, middle: np.ndarray, angle: float) -> float:
    y, x = np.mgrid[: gray.shape[0], : gray.shape[1]]
    across = (y - middle[1]) * math.cos(angle) - (x - middle[0]) * math.sin(angle)
    return float((gray * across).sum() / gray.sum())


@pytest.mark.parametrize("width", [0.5, 1.0, 1.5, 2.0, 3.3])
@pytest.mark.parametrize("degrees", [0, 90, 180, 10, 35, 57, 115, 200, 305])
def test_the_ink_of_a_line_is_centred_on_it(rng, width, degrees):
    # half a pixel misplaced would be 0.5 px; the tent filter leaves 1e-3 (its ends included) off the diagonals
    angle = math.radians(degrees)
    u = 40 * np.array([math.cos(angle), math.sin(angle)])
    for middle in MIDDLE + rng.uniform(-0.5, 0.5, (5, 2)):
        gray = ink([middle - u, middle + u], width=width)
        assert abs(centre_across(gray, middle, angle)) < 1e-3


def test_on_the_diagonals_the_centre_keeps_to_a_hundredth_of_a_pixel(rng):
    for angle in np.pi / 4 * np.array([1, 3, 5, 7]):
        u = 40 * np.array([math.cos(angle), math.sin(angle)])
        for middle in MIDDLE + rng.uniform(-0.5, 0.5, (5, 2)):
            assert abs(centre_across(ink([middle - u, middle + u]), middle, angle)) < 0.012


def test_a_pixel_on_the_line_is_where_its_whole_numbers_say():
    gray = ink([(30, 20), (30, 90)], width=1)
    assert np.argmax(gray[50]) == 30
    np.testing.assert_allclose(gray[50, 28:33], [0, 0.125, 0.75, 0.125, 0], atol=1e-6)
    assert gray[20, 30] > 0.4 > gray[18, 30]  # a round end about y = 20


@pytest.mark.parametrize("width", [0.3, 1.0, 1.5, 4.0])
def test_the_ink_of_a_line_is_its_length_times_its_width(rng, width):
    for angle in rng.uniform(0, 2 * np.pi, 10):
        u, middle = np.array([math.cos(angle), math.sin(angle)]), MIDDLE + rng.uniform(-0.5, 0.5, 2)
        short, long = (ink([middle - half * u, middle + half * u], width=width).sum() for half in (15, 40))
        # the difference of two lengths has no ends in it; the tent's ripple at 45 degrees is 2 to 4 %
        assert abs((long - short) / (50 * width) - 1) < 0.03


def test_drawing_on_a_large_canvas_and_cropping_is_drawing_on_the_crop(rng):
    line = rng.uniform(-300, 600, (60, 2))
    big = draw_polylines(np.zeros((500, 560)), [line + np.array([200, 180])], color=WHITE, dash=(7, 4))
    small = draw_polylines(np.zeros((120, 140)), [line], color=WHITE, dash=(7, 4))
    np.testing.assert_allclose(small, big[180:300, 200:340], atol=1e-5)


@pytest.mark.parametrize("dash", [None, (6.0, 4.0)])
def test_points_ten_million_pixels_away_draw_the_line_they_belong_to(dash):
    near = [(-100.0, 20.0 + 110 * 0.25), (210.0, 20.0 - 200 * 0.25)]
    far = [(10 - 1e7, 20 + 0.25e7), (10 + 1e7, 20 - 0.25e7)]
    if dash is None:
        np.testing.assert_allclose(ink(far), ink(near), atol=1e-5)  # 1e7 eps is 2e-9 px
    assert 0.3 < ink(far, dash=dash).sum() / ink(near).sum() <= 1.0001
    assert ink([(1e7, 1e7), (2e7, 1e7)], [(-5, -1e7), (-5, 1e7)]).sum() == 0


def test_corners_crossings_and_repeats_are_no_darker_than_the_line():
    line = [(20.3, 20.1), (80.2, 60.7)]
    once = draw_polylines(BLACK, [line], color=WHITE, opacity=0.4)
    twice = draw_polylines(BLACK, [line, line[::-1]], color=WHITE, opacity=0.4)
    np.testing.assert_allclose(once, twice, atol=1e-6)
    divided = np.column_stack([np.linspace(20.3, 80.2, 37), np.linspace(20.1, 60.7, 37)])
    np.testing.assert_allclose(draw_polylines(BLACK, [divided], color=WHITE, opacity=0.4), once, atol=1e-5)
    crossing = draw_polylines(BLACK, [line, [(20, 60), (80, 20)]], color=WHITE, opacity=0.4, width=5)
    assert crossing.max() == np.float32(0.4)


def test_colour_and_opacity_are_blended_over_the_picture():
    red = draw_polylines(np.full((20, 20), 0.5), [[(0, 10), (19, 10)]], color=(1, 0, 0.5), width=4, opacity=0.5)
    np.testing.assert_allclose(red[10, 10], [0.75, 0.25, 0.5])
    np.testing.assert_array_equal(red[0, 0], [0.5, 0.5, 0.5])


def test_the_given_picture_is_not_changed():
    picture = np.zeros((20, 20, 3), np.float32)
    draw_polylines(picture, [[(0, 10), (19, 10)]], color=WHITE)
    draw_points(picture, [[5, 5]], color=WHITE)
    draw_text(picture, (2, 10), "x", color=WHITE)
    assert not picture.any()


def test_nan_and_infinite_points_interrupt_the_line():
    whole = [(10, 10), (30, 10), (np.nan, np.nan), (60, 10), (90, 12), (np.inf, 3), (90, 50), (70, 60)]
    parts = [[(10, 10), (30, 10)], [(60, 10), (90, 12)], [(90, 50), (70, 60)]]
    for dash in (None, (5, 3)):
        np.testing.assert_allclose(ink(whole, dash=dash), ink(*parts, dash=dash), atol=1e-6)
    assert ink().sum() == ink([(np.nan, np.nan)]).sum() == ink([(50, 50)]).sum() == ink(np.zeros((0, 2))).sum() == 0


def test_dashes_have_their_lengths_and_run_on_through_vertices():
    gray = ink([(10, 50), (110, 50)], width=2, dash=(12, 8))[50]
    on = gray > 0.5
    starts = np.flatnonzero(np.diff(on.astype(int)) == 1) + 1
    np.testing.assert_array_equal(np.diff(starts), 20)
    assert abs(on.mean() * 120 - 5 * 12) <= 5
    divided = np.column_stack([np.linspace(10, 110, 41), np.full(41, 50.0)])
    np.testing.assert_allclose(ink(divided, width=2, dash=(12, 8))[50], gray, atol=1e-5)


@pytest.mark.parametrize("mark", ["plus", "cross", "circle"])
def test_marks_are_centred_on_their_points(mark):
    q = np.array([40.3, 30.7])
    gray = draw_points(BLACK, [q, [np.nan, 1]], color=WHITE, mark=mark, size=11)[..., 0].astype(float)
    y, x = np.mgrid[:110, :120]
    centre = np.array([(gray * x).sum(), (gray * y).sum()]) / gray.sum()
    np.testing.assert_allclose(centre, q, atol=0.02)  # the round ends' share
    rows, columns = np.nonzero(gray > 0.3)
    span = 11 / math.sqrt(2) if mark == "cross" else 11
    assert np.ptp(columns) == pytest.approx(span, abs=2)
    assert np.ptp(rows) == pytest.approx(span, abs=2)


def test_text_starts_at_its_point_and_is_cut_at_the_picture_s_edge():
    gray = draw_text(BLACK, (20, 50), "Hxgj", color=WHITE, height=20)[..., 0]
    rows, columns = np.nonzero(gray > 0.5)
    assert 20 <= columns.min() <= 23
    assert abs((rows.min() + rows.max()) / 2 - 50) <= 1
    for q in [(-20, 50), (110, 50), (50, -3), (50, 112), (1e9, -1e9), (-1e9, 1e9)]:
        moved = draw_text(BLACK, q, "Hxgj", color=WHITE, height=20)[..., 0]
        assert moved.shape == gray.shape
        assert moved.sum() < gray.sum()
    assert draw_text(BLACK, (20, 50), "", color=WHITE).sum() == 0


def test_bad_arguments_are_named():
    line = [(0, 0), (5, 5)]
    for what, options in [
        ("width", {"width": 0}),
        ("width", {"width": math.nan}),
        ("above 0 and below 10000 px", {"width": 1e9}),
        ("opacity", {"opacity": 1.5}),
        ("color", {"color": (255, 0, 0)}),
        ("color", {"color": (0.5,)}),
        ("dash", {"dash": (0, 3)}),
    ]:
        with pytest.raises(BadValue, match=what):
            draw_polylines(BLACK, [line], **{"color": WHITE, **options})
    with pytest.raises(BadValue, match="polyline is of shape"):
        draw_polylines(BLACK, [[(0, 0, 0)]], color=WHITE)
    with pytest.raises(UnknownName, match="did you mean 'circle'"):
        draw_points(BLACK, [(1, 1)], color=WHITE, mark="circel")
