"""Where a third of the lines are mismatched, the others determine the pose."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from cadcam.arrays import Array
from cadcam.fit.grouped import Groups, grouped_fit
from cadcam.geometry.rigid import Rigid
from cadcam.locate.refine.agreement import agreed
from cadcam.locate.refine.regression import Regression
from cadcam.locate.refine.solution import PoseSolution

GROUPS, EACH, SIGMA = 40, 6, 0.04  # edges, samples of each, px


def fitted(off: Array, rng: np.random.Generator) -> PoseSolution:
    """Return a fit that believes all edges, each of which is off by so much (GROUPS,) px from where the part stands."""
    group = np.repeat(np.arange(GROUPS), EACH)
    row = rng.normal(size=(GROUPS, 6))[group] * [1, 1, 0.3, 200, 200, 300] + 0.05 * rng.normal(size=(len(group), 6))
    y = off[group] + SIGMA * rng.normal(size=len(group))
    fit = grouped_fit(y, row, np.full(len(group), SIGMA**2), Groups(group), usual=0.05, robust=False)
    seen = cast(
        Any,
        ([SimpleNamespace(row=row)], [SimpleNamespace(usable=np.ones(len(group), bool), doubt=np.zeros(len(group)))]),
    )
    nothing = np.zeros(0), np.zeros((0, 6)), np.zeros(0)
    return PoseSolution([], Rigid(), Rigid.exp(fit.x), np.eye(6), *seen, fit, [], Regression([], []), nothing)


def moved_px(pose: Rigid) -> float:
    return float(np.linalg.norm(pose.log() * [1, 1, 0.3, 200, 200, 300]))


def test_most_edges_outvote_those_that_were_taken_for_others(rng: np.random.Generator) -> None:
    """A third is off by 3 px, all to one side: believed, it makes all look loose; the others are off by noise."""
    loose = fitted(np.where(np.arange(GROUPS) % 3 == 0, 3.0, 0.0), rng)
    assert loose.fit.between > 0.25
    assert moved_px(loose.pose) > 0.5
    closer = agreed(loose)
    assert closer
    assert moved_px(closer[0]) < 6 * SIGMA  # six motions, each by edges that are off by up to their noise


def test_edges_that_all_scatter_outvote_nothing(rng: np.random.Generator) -> None:
    """A model that is not quite the part: no motion puts many more edges right than the fitted one."""
    loose = fitted(0.8 * rng.normal(size=GROUPS), rng)
    assert loose.fit.between > 0.25
    assert agreed(loose) == []


def test_where_all_edges_agree_nothing_is_tried(rng: np.random.Generator) -> None:
    assert agreed(fitted(np.zeros(GROUPS), rng)) == []


def test_the_motion_that_moves_no_edge_far_is_among_those_tried(rng: np.random.Generator) -> None:
    """A third of the edges, any of them, is off by 2 px to one side; others may be put right by motions farther off."""
    for _ in range(5):
        loose = fitted(np.where(rng.permutation(GROUPS) % 3 == 0, 2.0, 0.0), rng)
        poses = agreed(loose)
        assert 1 <= len(poses) <= 2
        assert moved_px(poses[-1]) < 6 * SIGMA
