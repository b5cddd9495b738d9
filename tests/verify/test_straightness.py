"""Places at which an edge is seen lie on one line, those of texture anywhere near it."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.verify.edges.shifts import CAPTURE_PX
from cadcam.verify.edges.straightness import on_one_line, scatter_of, straightness_ratio

NONE = np.zeros(0)


def test_scatter_is_that_about_a_line_of_each_piece(rng: np.random.Generator) -> None:
    """Three tilted lines with noise: chi-square of the estimate within 4 standard errors; slopes count for nothing."""
    sigma, n = 0.2, 12
    squares = []
    for _ in range(100):
        along = np.tile(np.arange(n) * 4.0, 3)
        piece = np.repeat(np.arange(3), n)
        offset = rng.normal(0, sigma, 3 * n) + rng.uniform(-0.02, 0.02, 3)[piece] * along + rng.normal(0, 5, 3)[piece]
        squares += ((scatter_of(offset, along, piece) / sigma) ** 2).tolist()
    assert abs(np.mean(squares) - 1) < 4 * np.sqrt(2 / ((n - 2) * len(squares)))


def test_few_places_tell_no_scatter() -> None:
    """Three known places of piece 0 are too few; of piece 1 four are known, on one line exactly; 2 has none."""
    offset = np.array([0.1, np.nan, 0.3, 0.2, 0.5, 1.0, np.nan, 2.0, 2.5, np.nan])
    piece = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1, 2])
    scatter = scatter_of(offset, np.arange(10.0), piece)
    assert np.isnan(scatter[[0, 2]]).all()
    assert scatter[1] == pytest.approx(0.0, abs=1e-12)


def test_places_of_edges_are_on_one_line_and_places_anywhere_are_not(rng: np.random.Generator) -> None:
    """Of candidates with a sigma of 0.3 px nearly all pieces of twelve places are, of such anywhere hardly any."""
    piece, along = np.repeat(np.arange(500), 12), np.tile(np.arange(12) * 4.0, 500)
    edges = scatter_of(rng.normal(0, 0.3, len(piece)), along, piece)
    texture = scatter_of(rng.uniform(-CAPTURE_PX, CAPTURE_PX, len(piece)), along, piece)
    assert on_one_line(edges).mean() > 0.95
    assert on_one_line(texture).mean() < 0.02


def test_what_does_not_tell_edges_from_clutter_adds_nothing() -> None:
    """Clutter that lies on lines as often as the others' edges; no scatter known."""
    others = np.r_[np.full(8, 0.1), 1.0]
    own = 9 / 11
    assert straightness_ratio(np.full(3, 0.1), others, own) == pytest.approx(0.0, abs=1e-12)
    assert straightness_ratio(np.full(3, np.nan), others, 0.1) == pytest.approx(0.0, abs=1e-12)
    assert straightness_ratio(NONE, NONE, 0.1) == pytest.approx(0.0, abs=1e-12)


def test_before_texture_what_lies_on_one_line_is_there_and_what_does_not_is_not() -> None:
    """Each edge adds, up to five to one for a body, two to one against it, which may as well be rough."""
    others, close, loose = np.full(20, 0.1), 0.1, 0.9
    told = [straightness_ratio(np.full(n, close), others, 0.1) for n in range(30)]
    against = [straightness_ratio(np.full(n, loose), others, 0.1) for n in range(30)]
    assert (np.diff(told) > 0)[:3].all()
    assert (np.diff(against) < 0)[:3].all()
    assert told[2] > 1.0
    assert against[2] < -0.5
    assert max(told) < np.log(5)
    assert min(against) > -np.log(2)
