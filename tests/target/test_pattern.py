"""Boards as geometry: texts, points, turns, ink."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import BadValue, CadcamError, UnknownName
from cadcam.target.boards.board import Pattern
from cadcam.target.boards.pattern import Chessboard, CircleGrid, parse_pattern

from .shots import TEXTS


def board(text: str) -> Pattern:
    if text.startswith("charuco"):
        pytest.importorskip("cv2", reason="markers come from OpenCV", exc_type=ImportError)
    return parse_pattern(text)


@pytest.mark.parametrize(
    "text",
    [*TEXTS, "chessboard:9x6:12.7mm", "circles:7x6:30.0001234mm:12.3456789mm", "charuco:8x6:30mm:20mm:4X4_50:legacy"],
)
def test_a_board_s_text_reads_back_as_the_board(text: str) -> None:
    assert str(parse_pattern(text)) == text
    assert parse_pattern(str(parse_pattern(text))) == parse_pattern(text)


def test_lengths_are_in_the_unit_they_name() -> None:
    assert parse_pattern("chessboard:9x6:1in") == Chessboard(9, 6, 25.4)
    assert parse_pattern("acircles:4x11:2cm") == CircleGrid(4, 11, 20.0, staggered=True)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("chesboard:9x6:25mm", "did you mean 'chessboard'"),
        ("chessboard:9x6", "chessboard:9x6:25mm"),
        ("chessboard:9x6:25", "with its unit"),
        ("chessboard:9:25mm", "COLUMNSxROWS"),
        ("chessboard:9x6:-25mm", "positive"),
        ("chessboard:9x1:25mm", "2 x 2 at least"),
        ("charuco:5x7:30mm:31mm:4X4_50", "less than the square"),
        ("circles:5x7:30mm:30mm", "discs touch"),
        ("chessboard:9x6:25furlong", "furlong"),
    ],
)
def test_a_wrong_text_is_refused_with_the_right_form(text: str, says: str) -> None:
    with pytest.raises(CadcamError) as error:
        parse_pattern(text)
    assert says in str(error.value)


def test_an_unknown_dictionary_is_named() -> None:
    pytest.importorskip("cv2", reason="dictionaries are OpenCV's", exc_type=ImportError)
    with pytest.raises(UnknownName, match="5X5_100"):
        parse_pattern("charuco:5x7:30mm:20mm:5X5_10").ink()


@pytest.mark.parametrize("text", TEXTS)
def test_the_ink_that_is_printed_is_the_ink_that_is_seen(text: str) -> None:
    """Area and place: the shapes' area, and a check of points drawn at random against the shapes."""
    pattern = board(text)
    rng = np.random.default_rng(3)
    left, top, right, bottom = pattern.outline
    p = rng.uniform([left - 5, top - 5], [right + 5, bottom + 5], (20_000, 2))
    ink = pattern.ink()
    x, y = p[:, :1], p[:, 1:]
    a, b, c, d = ink.rectangles.T if len(ink.rectangles) else np.zeros((4, 0))
    in_rectangle = ((x > a) & (x < c) & (y > b) & (y < d)).any(axis=1)
    u, v, r = ink.discs.T if len(ink.discs) else np.zeros((3, 0))
    in_disc = (np.hypot(x - u, y - v) < r).any(axis=1)
    assert np.array_equal(pattern.black(p), in_rectangle | in_disc)


@pytest.mark.parametrize(
    ("text", "turns"),
    [
        ("chessboard:9x6:25mm", 1),
        ("chessboard:8x6:25mm", 2),
        ("chessboard:7x7:25mm", 2),
        ("chessboard:8x8:25mm", 4),
        ("circles:7x5:25mm", 2),
        ("circles:6x6:25mm", 4),
        ("staggered-circles:4x11:20mm", 1),
        ("staggered-circles:4x10:20mm", 2),
        ("charuco:6x6:30mm:20mm:4X4_50", 1),
    ],
)
def test_turns_counts_the_turns_after_which_the_ink_is_the_same(text: str, turns: int) -> None:
    pattern = board(text)
    left, top, right, bottom = pattern.outline
    middle = np.array([(left + right) / 2, (top + bottom) / 2])
    p = np.random.default_rng(4).uniform(-1.2, 1.2, (4000, 2)) * (middle - [left, top])
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    same = [
        np.array_equal(pattern.black(middle + p @ np.linalg.matrix_power(quarter, k).T), pattern.black(middle + p))
        for k in range(4)
    ]
    assert pattern.turns == sum(same) == turns


def test_a_board_that_is_too_large_is_refused() -> None:
    with pytest.raises(BadValue, match="50000"):
        Chessboard(1000, 1000, 1.0)
