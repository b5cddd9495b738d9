"""Beside bands all lines are shifted to the same side: with that in the model, the covariance is true."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from cadcam.geometry.rigid import Rigid
from cadcam.locate.refine.regression import Regression
from cadcam.locate.refine.solution import PoseSolution

LINES, PIECES, EACH, SIGMA = 24, 3, 8, 0.08  # lines, pieces of each, samples of these, px
UNIT = np.array([1, 1, 0.3, 200, 200, 300])  # px by a unit of the twist
NOTHING = np.zeros(0), np.zeros((0, 6)), np.zeros(0)
PIECE = np.repeat(np.arange(LINES * PIECES), EACH)
LINE = PIECE // PIECES


def asked(
    rng: np.random.Generator, *, line: float, piece: float, drawn: float, bands: bool, white: Any = None
) -> tuple[Regression, Any]:
    """Return a regression and what it is asked: the part stands right, its lines are seen off by these px (sd).

    drawn: by so much all of them are seen off towards bright; white (n,): by how much those up to white may be, px.
    """
    n = len(PIECE)
    row = (rng.normal(size=(LINES, 6))[LINE] + 0.2 * rng.normal(size=(LINES * PIECES, 6))[PIECE]) * UNIT
    contrast = rng.choice([-0.3, 0.4], LINES)[LINE]
    offset = line * rng.normal(size=LINES)[LINE] + piece * rng.normal(size=LINES * PIECES)[PIECE]
    offset += SIGMA * rng.normal(size=n) - drawn * np.sign(contrast)
    measured = SimpleNamespace(
        usable=np.ones(n, bool),
        offset=offset,
        sigma=np.full(n, SIGMA),
        contrast=contrast,
        doubt=np.zeros(n),
        white=np.zeros(n) if white is None else white,
    )
    sight = SimpleNamespace(samples=SimpleNamespace(chain=np.zeros(n, int)))
    regression = Regression(cast(Any, [sight]), [np.stack([PIECE, LINE], axis=1)], bands)
    return regression, ([SimpleNamespace(row=row)], [measured], NOTHING, np.eye(6))


def squares(rng: np.random.Generator, *, bands: bool) -> float:
    """Return the mean of x C^-1 x / 6 over 60 pictures with bands."""
    z2 = []
    for _ in range(60):
        regression, given = asked(rng, line=0.08, piece=0.03, drawn=0.05 * rng.normal(), bands=bands)
        fit = regression.step(*given, 12, on_lines=True)
        z2.append(float(fit.x @ np.linalg.solve(fit.covariance, fit.x)) / 6)
    return float(np.mean(z2))


def test_beside_bands_the_covariance_is_true(rng: np.random.Generator) -> None:
    told, untold = squares(rng, bands=True), squares(rng, bands=False)
    assert told == pytest.approx(1.0, abs=4 * np.sqrt(2 / 360))  # chi-square of 360: four of its sd
    assert untold > 1.5 * told


def test_what_draws_all_lines_is_an_unknown_that_stays_in_the_offsets(rng: np.random.Generator) -> None:
    """Beside it the pose is all that comes back, and edges are seen where they are seen: off towards bright."""
    regression, given = asked(rng, line=0.0, piece=0.0, drawn=0.1, bands=True)
    fit = regression.step(*given, 12, on_lines=True)
    assert fit.x.shape == (6,)
    assert fit.covariance.shape == (6, 6)
    assert fit.gain.shape == (6, len(PIECE) + 1)
    seen = -np.sign(given[1][0].contrast[::EACH])
    sd = SIGMA / np.sqrt(LINES * PIECES * EACH)
    assert np.mean(seen * fit.offset[:-1]) == pytest.approx(0.1, abs=0.02 + 4 * sd)  # held to be 0.05 px, or less


def test_what_steps_up_to_white_share_is_an_unknown_of_each_photo(rng: np.random.Generator) -> None:
    """Half of the lines are up to white, all off by one error: the covariance is true, and twice too small without."""
    told, untold = [], []
    up = (np.arange(LINES) % 2)[LINE] * 0.1
    for _ in range(60):
        regression, given = asked(rng, line=0.0, piece=0.03, drawn=0.0, bands=False, white=up)
        given[1][0].offset += up * rng.normal()
        for white, squares in ((up, told), (np.zeros(len(LINE)), untold)):
            given[1][0].white = white
            fit = regression.step(*given, 12, on_lines=True)
            assert fit.x.shape == (6,)
            squares.append(float(fit.x @ np.linalg.solve(fit.covariance, fit.x)) / 6)
    assert np.mean(told) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 360))
    assert np.mean(untold) > 1.5 * np.mean(told)


def test_of_very_many_photos_with_white_those_that_have_least_share_an_unknown(rng: np.random.Generator) -> None:
    """From eleven photos on there was no pose."""
    regression, given = asked(rng, line=0.0, piece=0.03, drawn=0.0, bands=False)
    (at,), (m,), nothing, B = given
    photos = 70
    white = [SimpleNamespace(**{**vars(m), "white": np.full(len(PIECE), 0.02 + 0.001 * k)}) for k in range(photos)]
    drawn = regression._drawn(cast(Any, white), 58)
    assert drawn.shape == (photos * len(PIECE), 58)
    np.testing.assert_allclose(np.sort(drawn.sum(axis=1)), np.sort(np.concatenate([w.white for w in white])))
    assert sorted(np.count_nonzero(drawn, axis=0)) == [len(PIECE)] * 57 + [13 * len(PIECE)]
    pieces = [of + k * len(PIECE) for k, of in enumerate(regression.pieces * photos)]
    several = Regression(list(regression.sights) * photos, pieces)
    fit = several.step([at] * photos, cast(Any, white), nothing, B, 4, on_lines=True)
    assert fit.x.shape == (6,)


def test_a_fit_untold_of_bands_keeps_its_pose_and_is_less_sure_of_it(rng: np.random.Generator) -> None:
    regression, given = asked(rng, line=0.06, piece=0.03, drawn=0.05, bands=False)
    fit = regression.step(*given, 12, on_lines=True)
    places, measured, _, B = given
    before = PoseSolution([], Rigid(), Rigid.exp(fit.x), B, places, measured, fit, [], regression, NOTHING)
    beside = before.beside_its_bands()
    assert beside.pose is before.pose
    assert beside.regression.bands
    assert np.trace(beside.fit.covariance * UNIT**2) > 1.2 * np.trace(fit.covariance * UNIT**2)
