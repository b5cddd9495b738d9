"""Displacements of bodies whose feet follow them only upwards: told from both sides, and as sure as that is."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.verify.adjustment.datum_fit import Adjustment, Estimate, FittedPose
from cadcam.verify.adjustment.following import BodyLines, following, turning
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


def tipped_rib(rng: np.random.Generator, motion: Array) -> tuple[Adjustment, BodyLines]:
    """Return a rib of 160 x 12 x 40 mm, seen from its front at 45 degrees, moved by (6,) mm and rad, and its lines.

    Its foot slides up its front where it sinks, and goes with it where it rises.
    """
    middle = np.array([[0, -6, 0], [0, -6, 40], [0, 6, 40], [80, -6, 20], [-80, -6, 20], [80, 0, 40.0]])
    half = np.array([[70, 0, 0], [70, 0, 0], [70, 0, 0], [0, 0, 15], [0, 0, 15], [0, 4.0, 0]])
    edge, t = np.repeat(np.arange(6), PLACES), np.tile(np.linspace(-1, 1, PLACES), 6)
    p = middle[edge] + t[:, None] * half[edge]
    view = 0.8 * np.array([[1, 0, 0], [0, np.sqrt(0.5), np.sqrt(0.5)]])
    line = half @ view.T
    across = np.column_stack([-line[:, 1], line[:, 0]]) / np.linalg.norm(line, axis=1)[:, None]
    G, ground = (across @ view)[edge], np.where(edge[:, None] == 0, [0, 0, 1.0], 0.0)
    lever = np.where(edge == 0, G[:, 2], 0.0)  # an upright front: the line stays on the ground, where it was
    moved = motion[:3] + np.cross(motion[3:], p - p.mean(axis=0))
    sunk = np.minimum(np.einsum("ni,ni->n", ground, moved), 0.0)
    noise = EdgeNoise.of(np.full(len(p), SIGMA), edge, t * np.linalg.norm(line, axis=1)[edge], TAU)
    common = TAU * np.einsum("ni,ni->n", noise.Z, rng.normal(size=(6, 2))[noise.edge])
    y = np.einsum("ni,ni->n", G, moved) - lever * sunk + rng.normal(0, SIGMA, len(p)) + common
    adjustment = Adjustment(y, np.zeros((len(y), 6)), np.zeros((len(y), 0)), noise, np.ones(len(y), bool))
    return adjustment, BodyLines(G, lever, ground, p)


def test_a_body_that_tips_sinks_by_a_part_of_its_feet(rng: np.random.Generator) -> None:
    """40 drawings of a rib that tips by 2.5 deg along itself: chi-square of its shift and turn, within four sigmas.

    As far as one view shows them. Were all of its feet sunk, or none, that of the turn would be 15 instead of 1, and
    the shift be known to 0.19 mm only.
    """
    motion, every = np.append(np.zeros(3), np.radians([0, 2.5, 1])), np.ones(6 * PLACES, bool)
    motions = np.diag(np.repeat([5.0, np.radians(1.3)], 3))
    seen, sight = np.array([[1, 0, 0], [0, np.sqrt(0.5), np.sqrt(0.5)]]), np.array([[0, np.sqrt(0.5), -np.sqrt(0.5)]])
    square, sure = np.zeros((40, 2)), []
    for i in range(40):
        adjustment, body = tipped_rib(rng, motion)
        told, _ = following(adjustment, every, body, STILL, basis=np.eye(3), prior_mm=5.0, turns=motions[3:, 3:])
        turned = turning(adjustment, every, body, STILL, motions=motions, upright=True).along(sight @ motions[3:])
        told = told.along(seen)
        for k, error in enumerate((told.value, turned.value - sight @ motion[3:])):
            square[i, k] = error @ np.linalg.solve((told, turned)[k].covariance, error) / len(error)
        sure.append(np.sqrt(np.linalg.eigvalsh(told.covariance)[-1]))
    assert square[:, 0].mean() < 1 + 4 * np.sqrt(2 / 80)
    assert square[:, 1].mean() < 1 + 4 * np.sqrt(2 / 40)
    assert np.median(sure) < 0.08
