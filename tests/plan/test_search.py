"""The set that is found is the best one, or nearly: against all sets, and against plain linear algebra."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.errors import BadValue
from cadcam.plan.assessment.asked import Asked
from cadcam.plan.assessment.assess import informations
from cadcam.plan.choice.problem import SelectionProblem
from cadcam.plan.choice.search import best_set, exhausted, one_fewer, one_more, ranked
from cadcam.plan.layout import survey
from cadcam.verify.tolerances.tolerance import Limit, Quantity

from .scenes import ring, scene


def random_problem(seed: int, *, candidates: int = 13, targets: int = 25, seen: float = 0.6) -> SelectionProblem:
    """Return cameras at random around random points; each sees some of them, across its ray alone."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (targets, 3))
    eyes = rng.normal(size=(candidates, 3))
    eyes = 3 * eyes / np.linalg.norm(eyes, axis=1, keepdims=True)
    ray = points - eyes[:, None]
    distance = np.linalg.norm(ray, axis=-1)
    ray = ray / distance[..., None]
    shown = rng.random((candidates, targets)) < seen
    weight = 400 * shown * rng.uniform(0.3, 3, (candidates, 1)) / distance**2
    information = weight[..., None, None] * (np.eye(3) - ray[..., :, None] * ray[..., None, :])
    basis = np.tile(np.eye(3), (targets, 1, 1))
    basis[::4, :, 1:] = 0.0  # every fourth is judged along x alone
    limits = tuple(Limit(Quantity.POSITION, v) for v in rng.uniform(1, 4, targets))
    nothing = np.zeros((targets, 3, 3))
    world = np.full(targets, -1)
    asked = Asked(np.arange(targets), limits, basis, np.zeros(targets, bool), nothing, nothing[..., 0], world)
    return SelectionProblem(information[:, None], asked)


@pytest.mark.parametrize("k", [2, 3, pytest.param(4, marks=pytest.mark.slow)])
def test_the_search_is_within_five_percent_of_all_sets(k: int) -> None:
    short = []
    for seed in range(12):
        problem = random_problem(seed)
        found, best = best_set(problem, k, complete=False), exhausted(problem, k)
        assert found.score.unmeasured == best.score.unmeasured
        short.append(found.score.worst / best.score.worst)
        assert not found.score.beats(best.score)
    assert min(short) >= 0.95


def test_trying_changes_on_the_hardest_targets_first_finds_the_same() -> None:
    # 900 targets that three cameras can all measure: most changes are settled by the hardest of them
    problem = random_problem(4, candidates=12, targets=900, seen=1.0)
    assert problem.hardest((0, 1, 2)).targets < problem.targets
    found, best = best_set(problem, 3, complete=False), exhausted(problem, 3)
    assert best.score.unmeasured == 0
    assert found.chosen == best.chosen


def test_the_search_in_a_scene_is_within_five_percent_of_all_sets() -> None:
    seen = survey(scene(14))
    for k in (2, 3, 4):
        found, best = best_set(seen.problem, k, complete=False), exhausted(seen.problem, k)
        assert found.score.unmeasured == best.score.unmeasured
        assert found.score.worst >= 0.95 * best.score.worst


def test_all_sets_means_all_of_them() -> None:
    problem = random_problem(3, candidates=7)
    best = exhausted(problem, 3)
    every = [problem.score(c).value for c in combinations(range(7), 3)]
    assert best.sets == len(every) == 35
    assert best.score.value == pytest.approx(max(every))
    with_two = exhausted(problem, 2, fixed=(5,))
    assert with_two.score.value == pytest.approx(
        max(problem.score((5, *c)).value for c in combinations([0, 1, 2, 3, 4, 6], 2))
    )


def reference(information: Array, asked: Asked, chosen: tuple[int, ...]) -> Array:
    """Return the ratios by numpy's own inverse and eigenvalues."""
    total = information[list(chosen)].sum(axis=0) + asked.known
    weak = 1e-8 * np.eye(3) / (asked.value**2)[:, None, None]  # some are seen by none of them
    sigma, _ = asked.worst(np.linalg.inv(total + weak))
    return np.asarray(asked.value / (asked.k * sigma))


def test_ratios_are_those_of_plain_linear_algebra() -> None:
    seen = survey(scene(10))
    information = informations(seen.visibility, seen.asked, cameras=3)
    for chosen in ((0, 3, 6), (1, 2, 4, 8), tuple(range(10))):
        expected = reference(information, seen.asked, chosen).ravel()
        found = seen.problem.ratios(chosen)
        good = expected > 0.1
        assert good.any()
        # the cosine of a third of an angle loses half of the digits where two eigenvalues meet
        np.testing.assert_allclose(found[good], expected[good], rtol=1e-6)


def test_the_next_view_is_the_best_of_all_single_additions() -> None:
    problem = random_problem(5)
    order = ranked(problem, (2, 7), range(problem.candidates))
    assert len(order) == problem.candidates - 2
    for c, score in order:
        assert score.value == pytest.approx(problem.score((2, 7, c)).value)
    assert [s.value for _, s in order] == sorted((s.value for _, s in order), reverse=True)
    assert exhausted(problem, 1, fixed=(2, 7)).chosen == (order[0][0],)


def test_a_camera_more_never_hurts_and_one_less_never_helps() -> None:
    problem = random_problem(8)
    found = best_set(problem, 3)
    more, fewer = one_more(problem, found.chosen), one_fewer(problem, found.chosen)
    assert (len(more), len(fewer)) == (4, 2)
    assert problem.score(more).value >= found.score.value >= problem.score(fewer).value


def test_fixed_cameras_stay_and_count_apart() -> None:
    problem = random_problem(9)
    found = best_set(problem, 2, fixed=(0, 1), complete=False)
    assert len(found.chosen) == 2
    assert not {0, 1} & set(found.chosen)
    assert best_set(problem, 0, fixed=(0, 1)).score.value == problem.score((0, 1)).value


def test_more_cameras_than_there_are_is_refused() -> None:
    with pytest.raises(BadValue, match="at most the 13 candidates"):
        best_set(random_problem(1), 14)


def test_two_mounts_are_searched_together() -> None:
    both = replace(scene(6), mounts=(ring(6), replace(ring(4, height=200.0), name="low")))
    assert len(survey(both).candidates) == 10
