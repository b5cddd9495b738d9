"""Climbing poses: what few lines tell is held; edges judged one by one; poses of one basin recognised as one."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.native.fields import PLACE, SECTORS, Belief, Eye, Planes, PoseEdges, firsts


@pytest.mark.parametrize(("most", "apart"), [(200, 0.0), (200, 0.4), (7, 0.4), (200, 9.0)])
def test_the_first_of_poses_that_are_near_each_other_is_kept(most: int, apart: float, rng: np.random.Generator) -> None:
    corners = rng.choice(rng.uniform(0, 1, (40, 4, 3)), 200) + rng.uniform(0, 0.1, (200, 4, 3))
    kept: list[int] = []
    for k in range(len(corners)):
        if len(kept) < most and all(np.linalg.norm(corners[k] - corners[j], axis=1).max() > apart for j in kept):
            kept.append(k)
    assert firsts(corners, most, apart).tolist() == kept


def test_of_no_poses_none_is_kept() -> None:
    assert len(firsts(np.zeros((0, 4, 3)), 5, 1.0)) == 0


def test_what_an_edge_says_is_bounded_and_edges_are_judged_one_by_one(rng: np.random.Generator) -> None:
    """Over a field that is equally sure everywhere the sum over lines is known; that of no places is nothing."""
    sure, belief = 0.6, Belief(even=0.15, nats=4.0, most=4.0, seen=0.9)
    planes = Planes(np.full((SECTORS, 40, 40), round(255 * sure), np.uint8), *np.zeros((2, SECTORS), np.float32))
    eye = Eye(planes, np.array([[20.0, 0, 19.5], [0, 20.0, 19.5], [0, 0, 1]]), np.eye(3), np.zeros(3))
    places = np.zeros(90, PLACE)
    places["p"] = rng.uniform(-0.5, 0.5, (90, 3)) + np.array([0, 0, 1.5])
    places["p"][60:] += [50, 0, 0]  # outside the picture: these say nothing
    places["tangent"], places["weight"] = [1.0, 0, 0], 1.0
    line = np.maximum(np.arange(90) - 19, 0).astype(np.int32)  # twenty on the first, then one each
    poses = np.tile(np.concatenate([np.eye(3).ravel(), np.zeros(3)]), (3, 1))
    share = np.array([1.0, 0.1, 1.0])
    views = PoseEdges([eye], places, np.zeros((3, 1), np.int64), np.array([[90], [90], [0]], np.int32))
    found = views.evidence(0, poses, 0.8, line, share, belief)
    gain = np.bincount(line[:60], minlength=71)[None] * ((sure - 0.15) * 4.0 * share[:, None])
    expected = np.log(0.1 + 0.9 * np.exp(np.minimum(gain, 4.0))).sum(axis=1)
    assert gain.max() > 4.0 > gain[1].max() > 0
    assert np.allclose(found[:2], expected[:2], rtol=1e-12)
    assert found[2] == 0


def test_a_motion_that_few_places_tell_is_held_by_how_far_the_others_slide() -> None:
    """One place is 2 px beside its line, and fifty on a line along the motion: these tell nothing of it."""
    values = np.zeros((SECTORS, 60, 60), np.uint8)
    values[:, 10, :] = values[:, :, 50] = 255
    eye = Eye(
        Planes(values, *np.zeros((2, SECTORS), np.float32)),
        np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1]]),
        np.eye(3),
        np.zeros(3),
    )
    places = np.zeros(51, PLACE)
    places["p"] = [*((x, 10.0, 1.0) for x in np.linspace(2, 40, 50)), (48.0, 40.0, 1.0)]
    places["tangent"], places["weight"] = [*[(1.0, 0, 0)] * 50, (0, 1.0, 0)], 1.0
    edges = PoseEdges([eye], places, np.zeros((1, 1), np.int64), np.array([[51]], np.int32))
    pose = np.concatenate([np.eye(3).ravel(), np.zeros(3)])[None]
    along = np.eye(6)[:, :1]
    free, held = (edges.climb(pose, along, (2.0, 1.0), held=share)[0][0, 9] for share in (0.0, 0.05))
    pull = np.exp(-0.5)  # of a line 2 px off under a Gaussian of 2 px; of the places on their line 1
    assert free == pytest.approx(2 / 1.01, rel=1e-6)  # a motion is damped by a hundredth of its own pull, too
    assert held == pytest.approx(2 * pull / (1.01 * pull + 0.05 * 50), rel=1e-6)
