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
NONE = np.zeros((3, 0))


def measured(rng: np.random.Generator, d: Array, lever: Array) -> Estimate:
    """Return what is told of a body displaced by d (3,) mm, if its feet are taken to have a lever (n,)."""
    noise = EdgeNoise.of(np.full(3 * PLACES, SIGMA), np.repeat(np.arange(3), PLACES), ALONG, TAU)
    common = TAU * np.einsum("ni,ni->n", noise.Z, rng.normal(size=(3, 2))[noise.edge])
    y = BY_POINT @ d + LEVER * max(-d[1], 0.0) + rng.normal(0, SIGMA, 3 * PLACES) + common
    adjustment = Adjustment(y, np.zeros((len(y), 6)), np.zeros((len(y), 0)), noise, np.ones(len(y), bool))
    body = BodyLines(BY_POINT, lever, GROUND, np.zeros_like(GROUND))
    return following(adjustment, np.ones(len(y), bool), body, STILL, basis=np.eye(3)[:, :2], prior_mm=5.0, turns=NONE)[
        0
    ]


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
    told = following(adjustment, rows, body, STILL, basis=np.eye(3)[:, :2], prior_mm=5.0, turns=NONE)[0]
    assert np.sqrt(told.covariance[1, 1]) > 1.0
    assert np.sqrt(told.covariance[0, 0]) < 0.5


def told_of_a_box(rng: np.random.Generator, d: Array, w: Array, turns: Array) -> Estimate:
    """Return what is told of a box, seen from above by its eight upright and lying edges, shifted and turned by w."""
    middle = np.array(
        [[0, 30, 0], [0, -30, 0], [50, 0, 0], [-50, 0, 0], [50, 30, 9], [-50, 30, 9], [0, 30, 9], [50, 0, 9]]
    )
    along = np.array([[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0], [0.2, 0.1, 1], [0.2, 0.1, 1], [1, 0, 0], [0, 1, 0]])
    t, edge = np.tile(4.0 * (np.arange(PLACES) - 5.5), 8), np.repeat(np.arange(8), PLACES)
    across = np.cross(along, [0, 0, 1.0])[edge]
    p, G = middle[edge] + t[:, None] * along[edge], 0.8 * across / np.linalg.norm(across, axis=1)[:, None]
    noise = EdgeNoise.of(np.full(len(p), SIGMA), edge, t, TAU)
    common = TAU * np.einsum("ni,ni->n", noise.Z, rng.normal(size=(8, 2))[edge])
    y = np.einsum("ni,ni->n", G, d + np.cross(w, p - p.mean(axis=0))) + rng.normal(0, SIGMA, len(p)) + common
    adjustment = Adjustment(y, np.zeros((len(y), 6)), np.zeros((len(y), 0)), noise, np.ones(len(y), bool))
    body, every = BodyLines(G, np.zeros(len(y)), np.zeros_like(p), p), np.ones(len(y), bool)
    return following(adjustment, every, body, STILL, basis=np.eye(3)[:, :2], prior_mm=5.0, turns=turns)[0]


def test_a_body_that_turns_too_is_displaced_by_what_its_middle_is(rng: np.random.Generator) -> None:
    """60 drawings of 0.7 deg about each axis: chi-square of 120 components within four of its sigmas.

    Its sigma is a third of that of a shift alone; of bodies that do not turn it is the same within 5 %.
    """
    turns, square, sigmas = np.eye(3) * 1.25 / 60, 0.0, []
    for _ in range(60):
        d, w = np.array([*rng.normal(0, 1, 2), 0.0]), rng.normal(0, np.radians(0.7), 3)
        state = rng.bit_generator.state
        told = told_of_a_box(rng, d, w, turns)
        error = told.value - d[:2]
        square += float(error @ np.linalg.solve(told.covariance, error))
        rng.bit_generator.state = state
        shifted = told_of_a_box(rng, d, w, NONE)
        rng.bit_generator.state = state
        still = [told_of_a_box(rng, d, 0 * w, as_well) for as_well in (turns, NONE)]
        sigmas.append([np.sqrt(e.covariance[0, 0]) for e in (told, shifted, *still)])
    assert 1 - 4 * np.sqrt(2 / 120) < square / 120 < 1 + 4 * np.sqrt(2 / 120)
    turned, alone, still_by_both, still_alone = np.median(sigmas, axis=0)
    assert turned < 0.35 * alone
    assert still_by_both < 1.05 * still_alone
