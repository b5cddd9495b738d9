"""What a layout says beside its cameras: what each is there for, and what one more or one less would make of it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from cadcam.plan.choice.problem import MEASURED, Score
from cadcam.plan.layout import CandidateSurvey, next_cameras, plan_layout, survey
from cadcam.plan.scene.layout_scene import Sigmas
from cadcam.plan.what_if import what_if
from cadcam.report.layout.words import headline

from .scenes import ring, scene


@pytest.fixture(scope="module")
def seen() -> CandidateSurvey:
    return survey(scene(8, mounts=(ring(8),)))


def same(score: Score) -> Any:
    """Return what a score is but for the order in which cameras are added up."""
    return pytest.approx(score.value, rel=1e-12)


@pytest.mark.parametrize(("k", "numbers"), [(1, (1, 2)), (2, (2, 3)), (3, (2, 3, 4)), (8, (7, 8))])
def test_growth_is_told_for_one_camera_less_and_one_more_where_there_can_be(
    seen: CandidateSurvey, k: int, numbers: tuple[int, ...]
) -> None:
    """One camera alone measures nothing here, and there are eight."""
    layout = plan_layout(seen, k)
    assert tuple(n for n, _ in layout.growth) == numbers
    growth = dict(layout.growth)
    assert growth[k].value == same(layout.found.score)
    assert growth[k].value == same(seen.problem.score(layout.chosen))
    scores = [score for _, score in layout.growth]
    assert not any(fewer.beats(more) for fewer, more in pairwise(scores))
    assert layout.all_of_them.value == same(seen.problem.score(range(8)))
    assert not scores[-1].beats(layout.all_of_them)


def test_a_role_is_what_is_lost_without_the_camera(seen: CandidateSurvey) -> None:
    layout = plan_layout(seen, 3)
    poses, limits = len(seen.poses), len(seen.asked)

    def measured(chosen: tuple[int, ...]) -> np.ndarray:
        return (seen.problem.ratios(chosen).reshape(poses, limits) > MEASURED).all(axis=0)

    for camera, role in zip(layout.chosen, layout.roles, strict=True):
        others = tuple(c for c in layout.chosen if c != camera)
        assert role.without.value == same(seen.problem.score(others))
        assert role.only_it == int((measured(layout.chosen) & ~measured(others)).sum())
        assert role.sees == int(seen.visibility[camera].seen.all(axis=0).sum())
    assert max(role.only_it for role in layout.roles) > 0
    assert {role.sees for role in layout.roles} != {0}


def test_of_a_camera_that_is_moved_every_table_states_the_errors_as_shared() -> None:
    """The search adds up each place's information; what is said beside the set is what is stated of such a set."""
    moved = survey(scene(8, mounts=(replace(ring(8), one_camera=True),), calibration=Sigmas(0.1, 1e-4, 0.5, 0.5)))
    layout = plan_layout(moved, 5)
    assert dict(layout.growth)[5].worst == pytest.approx(layout.assessment.worst, rel=1e-12)
    assert layout.assessment.worst != pytest.approx(layout.found.score.worst, rel=1e-3)  # sharing matters here
    table = {w.change: w.worst for w in what_if(layout)}
    for camera, role in zip(layout.cameras, layout.roles, strict=True):
        assert role.without.unmeasured == 0
        assert role.without.worst == pytest.approx(table[f"without {camera.name}"], rel=1e-12)
    demanding = replace(layout, survey=replace(moved, scene=replace(moved.scene, tur=1e6)))
    assert headline(demanding).startswith("one camera at 5 places reaches 1/1e+06 for 0 of 6 limits; worst: ")
    (_, best), *others = next_cameras(moved, layout.chosen)
    stated = [moved.assess((*layout.chosen, i)).worst for i in range(8) if i not in layout.chosen]
    assert best.worst == pytest.approx(max(stated), rel=1e-12)
    assert sorted(score.worst for _, score in others) == pytest.approx(sorted(stated)[:-1], rel=1e-12)


def test_the_next_view_is_one_more_camera(seen: CandidateSurvey) -> None:
    layout = plan_layout(seen, 2)
    (best, score), *others = next_cameras(seen, layout.chosen)
    assert best.name not in {camera.name for camera in layout.cameras}
    assert len(others) == 8 - 2 - 1
    assert score.value == same(seen.problem.score((*layout.chosen, seen.candidates.index(best))))
    assert not score.beats(dict(layout.growth)[3])  # which exchanges the others, too
