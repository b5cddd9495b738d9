"""A shadow inside holes moves a part of each rim: the datum's pose is as unsure as that makes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo
from cadcam.verify.deviations.measured import MeasuredEdges
from cadcam.verify.edges.sightlines import STEP_PX, erring_alike
from cadcam.verify.edges.survey import Survey, surveyed
from cadcam.verify.tolerances.tolerance import whole_parts

from .drilled import CAMERA, OBLIQUE, drilled, part, photographed


def seen(rng: np.random.Generator) -> Survey:
    shot = Photo.of(photographed(drilled(), rng, OBLIQUE, CAMERA), CAMERA, OBLIQUE)
    return surveyed(part(), [shot], Rigid(), whole_parts(part().scene), reach_px=8.0)


def bent(survey: Survey) -> np.ndarray:
    """Return which edges (E,) turn by more than a right angle: rims."""
    lines = survey.lines
    n = lines.edge.max() + 1
    mean = np.stack([np.bincount(lines.edge, lines.normal[:, k], n) for k in range(2)]) / np.bincount(lines.edge)
    return np.asarray(np.hypot(*mean) < 0.5)


def test_the_pieces_of_a_datum_s_rims_err_each_by_itself(rng: np.random.Generator) -> None:
    lines = (survey := seen(rng)).lines
    round_ = bent(survey)[lines.edge]
    number, along = erring_alike(lines, np.ones(len(lines), bool))
    assert round_.any()
    for one in np.unique(lines.edge):
        pieces = np.unique(number[lines.edge == one])
        assert len(pieces) >= 3 if bent(survey)[one] else len(pieces) <= 2
        for piece in pieces:
            places = np.sort(along[number == piece])
            assert np.diff(places).max(initial=0.0) < 4 * STEP_PX  # the one through which the rim begins is whole, too
    whole, same = erring_alike(lines, np.zeros(len(lines), bool))
    np.testing.assert_array_equal(whole, lines.edge)
    np.testing.assert_array_equal(same, lines.along)


def test_a_pose_held_by_rims_of_which_a_quarter_is_shaded_knows_that(rng: np.random.Generator) -> None:
    """Each by 0.25 px in a random quarter, always to the same side: chi-square was 11 times what it should be."""
    survey = seen(rng)
    lines, way = survey.lines, np.arctan2(*survey.lines.normal.T)
    rims = np.flatnonzero(bent(survey))
    every, squares = np.ones(len(lines), bool), []
    only = replace(survey, usable=survey.usable & bent(survey)[lines.edge])
    for _ in range(20):
        offset = rng.normal(0, 0.03, len(lines))
        for rim in rims:
            dark = (lines.edge == rim) & (np.cos(way - rng.uniform(0, 2 * np.pi)) > np.cos(np.pi / 4))
            offset[dark] += 0.25
        matched = replace(survey.matched, offset=offset, sigma=np.full(len(lines), 0.03))
        pose = MeasuredEdges.of(replace(only, matched=matched), every, every, np.eye(6)).adjustment.pose()
        squares.append(float(pose.xi @ np.linalg.solve(pose.covariance, pose.xi)) / 6)
    assert np.mean(squares) < 5
