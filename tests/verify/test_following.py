"""Displacements of bodies whose feet follow them only upwards: told from both sides, and as sure as that is."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.verify.adjustment.datum_fit import Adjustment, Estimate, FittedPose
from cadcam.verify.adjustment.following import BodyLines, following
from cadcam.verify.adjustment.scatter import EdgeNoise

SIGMA, TAU, PLACES = 0.1, 0.03, 12
STILL = FittedPose(np.zeros(6), np.zeros((6, 6)), np.zeros((6, 0)))
BY_POINT = np.repeat([[0.8, 0.1, 0.0], [0.7, -0.1, 0.0], [0.1, 0.8, 0.0]], PLACES, axis=0)  # the last is a foot
GROUND = np.repeat([[0, 0, 0], [0, 0, 0], [0, 1.0, 0]], PLACES, axis=0)
LEVER = np.repeat([0.0, 0.0, 0.5], PLACES)
ALONG = np.tile(4.0 * np.arange(PLACES), 3)


def measured(rng: np.random.Generator, d: Array, lever: Array) -> Estimate:
    """Return what is told of a body displaced by d (3,) mm, if its feet are taken to have a lever (n,)."""
    noise = EdgeNoise.of(np.full(3 * PLACES, SIGMA), np.repeat(np.arange(3), PLACES), ALONG, TAU)
    common = TAU * np.einsum("ni,ni->n", noise.Z, rng.normal(size=(3, 2))[noise.edge])
    y = BY_POINT @ d + LEVER * max(-d[1], 0.0) + rng.normal(0, SIGMA, 3 * PLACES) + common
    adjustment = Adjustment(y, np.zeros((len(y), 6)), np.zeros((len(y), 0)), noise, np.ones(len(y), bool))
    body = BodyLines(BY_POINT, lever, GROUND, np.zeros_like(GROUND))
    return following(adjustment, np.ones(len(y), bool), body, STILL, basis=np.eye(3)[:, :2], prior_mm=5.0)


@pytest.mark.parametrize("up", [2.0, 0.5, 0.03, 0.0, -0.03, -0.5, -2.0])
def test_a_displacement_is_told_on_either_side_of_the_ground(rng: np.random.Generator, up: float) -> None:
    """150 drawings: chi-square of the two components over 300, at most four of its sigmas above one.

    Where edges happen to disagree sigma is enlarged, so that it is below one; and it is as sure as the photo allows.
    """
    d, square, sure = np.array([0.3, up, 0.0]), 0.0, []
    for _ in range(150):
        told = measured(rng, d, LEVER)
        error = told.value - d[:2]
        square += float(error @ np.linalg.solve(told.covariance, error))
        sure.append(np.sqrt(told.covariance[1, 1]))
    assert 0.4 < square / 300 < 1 + 4 * np.sqrt(2 / 300)
    assert np.median(sure) < 3 * np.hypot(TAU, SIGMA / np.sqrt(PLACES)) / (0.8 - 0.5)


def test_a_foot_taken_to_follow_everywhere_tells_a_wrong_displacement(rng: np.random.Generator) -> None:
    """The control: sunk by 2 mm, a foot without a lever says 0.8 mm or so, surely."""
    told = measured(rng, np.array([0.3, -2.0, 0.0]), np.zeros(3 * PLACES))
    assert abs(told.value[1] + 2.0) > 5 * np.sqrt(told.covariance[1, 1])


def test_a_foot_that_stays_where_its_body_sinks_tells_nothing_of_that(rng: np.random.Generator) -> None:
    """Lever 0.8: the line stays in the photo. Whatever was sunk, the uncertainty is of the size of the prior's 5 mm."""
    stays, across = (
        np.repeat([0.0, 0.0, 0.8], PLACES),
        BY_POINT * np.repeat([[1, 0, 0], [1, 0, 0], [0, 1, 0]], PLACES, 0),
    )
    noise = EdgeNoise.of(np.full(3 * PLACES, SIGMA), np.repeat(np.arange(3), PLACES), ALONG, TAU)
    y = across @ np.array([0.3, 0.0, 0.0]) + rng.normal(0, SIGMA, 3 * PLACES)
    adjustment = Adjustment(y, np.zeros((len(y), 6)), np.zeros((len(y), 0)), noise, np.ones(len(y), bool))
    rows = np.ones(len(y), bool)
    body = BodyLines(across, stays, GROUND, np.zeros_like(GROUND))
    told = following(adjustment, rows, body, STILL, basis=np.eye(3)[:, :2], prior_mm=5.0)
    assert np.sqrt(told.covariance[1, 1]) > 1.0
    assert np.sqrt(told.covariance[0, 0]) < 0.5
