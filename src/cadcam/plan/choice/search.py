"""The best set of k cameras: information adds up, so sets are compared by sums of 3x3 matrices.

The criterion is that the worst of all limits, in all poses, has the largest test uncertainty ratio. That is easy to
understand, but constant while some feature cannot be measured at all, as with the first camera of a pair. So three
greedy starts use criteria that always make progress (the logarithm of the determinant of the information, whose gains
diminish as cameras are added; the mean logarithm of the ratios; a soft minimum of them), with some random starts where
they cost little. Each is improved by exchanging one camera, the best finally by exchanging two, as long as that
improves the criterion itself. With few candidates all sets are tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import BadValue
from cadcam.plan.choice.packed import determinant
from cadcam.plan.choice.problem import ROUNDING, Score, SelectionProblem

_SHARP = 4.0  # power of the soft minimum
_TRIED = 4000  # most sets that are all tried
_PAIRS = 3000  # exchanges of two cameras tried at a time
_STARTS, _WORK = 12, 1_000_000  # random starts, at most, and the ratios that they may cost in one round of exchanges
_FULLY = 6  # candidates that are tried on all targets at a time

Choice = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class BestSet:
    """The best set found and its score; whether all sets were tried, how many or from how many starts; exchanges."""

    chosen: Choice
    score: Score
    complete: bool
    sets: int
    exchanges: int


def best_set(
    problem: SelectionProblem,
    k: int,
    *,
    fixed: Sequence[int] = (),
    step: Callable[[], None] = lambda: None,
    complete: bool | None = None,
) -> BestSet:
    """Return the best set of k candidates, including `fixed`, which do not count; k may be 0.

    complete: try all sets; default where they are few. step: called at each stage, for a progress display.
    """
    free = [c for c in range(problem.candidates) if c not in set(fixed)]
    if not 0 <= k <= len(free):
        raise BadValue("number of cameras", k, f"at most the {len(free)} candidates that there are")
    if complete or (complete is None and comb(len(free), k) <= _TRIED):
        return exhausted(problem, k, fixed=fixed)
    best: tuple[Score, Choice] | None = None
    exchanges = 0
    starts = [_greedy(problem, k, tuple(fixed), free, judge) for judge in (_by_information, _by_mean, _by_softest)]
    rng = np.random.default_rng(len(free))  # a fixed seed: the same scene gives the same set
    spare = min(_STARTS, _WORK // max(len(free) * k * problem.targets, 1))
    starts += [tuple(int(c) for c in rng.choice(free, k, replace=False)) for _ in range(spare)]
    for start in starts:
        chosen, n = _exchanged(problem, start, tuple(fixed), free)
        score = problem.score((*fixed, *chosen))
        exchanges += n
        if best is None or score.value > best[0].value:
            best = score, chosen
        step()
    assert best is not None
    chosen, n = _pairs_exchanged(problem, best[1], tuple(fixed), free)
    step()
    return BestSet(tuple(sorted(chosen)), problem.score((*fixed, *chosen)), False, len(starts), exchanges + n)


def exhausted(problem: SelectionProblem, k: int, *, fixed: Sequence[int] = ()) -> BestSet:
    """Return the best of all sets of k candidates."""
    free = [c for c in range(problem.candidates) if c not in set(fixed)]
    best: tuple[Score, Choice] | None = None
    tried = 0
    for head in combinations(free, max(k - 1, 0)):
        after = [c for c in free if not head or c > head[-1]]
        if k and not after:
            continue
        before = problem.sum((*fixed, *head))
        scores = problem.scores_with_each(before, after) if k else [problem.score(tuple(fixed))]
        tried += len(scores)
        i = max(range(len(scores)), key=lambda j: scores[j].value)
        if best is None or scores[i].value > best[0].value:
            best = scores[i], (*head, after[i]) if k else ()
    assert best is not None
    return BestSet(best[1], best[0], True, tried, 0)


def one_fewer(problem: SelectionProblem, chosen: Sequence[int], *, fixed: Sequence[int] = ()) -> Score:
    """Return the score of a good set with one camera fewer: `chosen` without the least useful, then exchanged."""
    free = [c for c in range(problem.candidates) if c not in set(fixed)]
    sets = [tuple(c for c in chosen if c != gone) for gone in chosen]
    kept = max(sets, key=lambda s: problem.score((*fixed, *s)).value)
    return problem.score((*fixed, *_exchanged(problem, kept, tuple(fixed), free)[0]))


def one_more(problem: SelectionProblem, chosen: Sequence[int], *, fixed: Sequence[int] = ()) -> Score:
    """Return the score of a good set with one camera more: `chosen` with the most useful added, then exchanged."""
    free = [c for c in range(problem.candidates) if c not in set(fixed)]
    first = ranked(problem, (*fixed, *chosen), free)[0][0]
    return problem.score((*fixed, *_exchanged(problem, (*chosen, first), tuple(fixed), free)[0]))


def ranked(problem: SelectionProblem, chosen: Sequence[int], among: Iterable[int]) -> list[tuple[int, Score]]:
    """Return candidates with the score of `chosen` plus each of them, best first."""
    added = [c for c in among if c not in set(chosen)]
    if not added:
        return []
    scores = problem.scores_with_each(problem.sum(chosen), added)
    return sorted(zip(added, scores, strict=True), key=lambda item: item[1].value, reverse=True)


def _by_information(total: Array, ratios: Array) -> Array:
    return np.asarray(np.log(np.maximum(determinant(total), 1e-300)).mean(axis=-1))


def _by_mean(total: Array, ratios: Array) -> Array:
    return np.asarray(np.log(ratios).mean(axis=-1))


def _by_softest(total: Array, ratios: Array) -> Array:
    return np.asarray(-np.mean(np.maximum(ratios, 1e-3) ** -_SHARP, axis=-1))


def _greedy(
    problem: SelectionProblem, k: int, fixed: Choice, free: Sequence[int], judge: Callable[[Array, Array], Array]
) -> Choice:
    chosen: Choice = ()
    for _ in range(k):
        left = [c for c in free if c not in chosen]
        gains = problem.with_each(problem.sum((*fixed, *chosen)), left, judge)
        chosen = (*chosen, left[int(np.argmax(gains))])
    return chosen


def _exchanged(problem: SelectionProblem, chosen: Choice, fixed: Choice, free: Sequence[int]) -> tuple[Choice, int]:
    """Return the set after the best exchanges of one camera, while one improves it, and how many were made."""
    score, n = problem.score((*fixed, *chosen)), 0
    while True:
        before, hard = score, problem.hardest((*fixed, *chosen))
        others, better = [c for c in free if c not in chosen], chosen
        for i in range(len(chosen)):
            kept = chosen[:i] + chosen[i + 1 :]
            found = _best_addition(problem, hard, (*fixed, *kept), others, score)
            if found is not None:
                score, better = found[1], (*kept, found[0])
        if not score.beats(before):
            return chosen, n
        chosen, n = better, n + 1


def _best_addition(
    problem: SelectionProblem, hard: SelectionProblem, kept: Choice, added: Sequence[int], floor: Score
) -> tuple[int, Score] | None:
    """Return the candidate that makes the best set with the kept ones, if that beats a score.

    A set's score on the hardest targets bounds its score on all, so most candidates are ruled out by these alone. That
    does not hold while some targets are not measured at all: then all targets are evaluated.
    """
    if floor.unmeasured or hard is problem:
        order = ranked(problem, kept, added)
        return order[0] if order and order[0][1].beats(floor) else None
    bounds, best = ranked(hard, kept, added), None
    for first in range(0, len(bounds), _FULLY):
        few = [c for c, bound in bounds[first : first + _FULLY] if _may_beat(bound, floor)]
        if not few:
            break
        c, score = ranked(problem, kept, few)[0]
        if score.beats(floor):
            best, floor = (c, score), score
    return best


def _may_beat(bound: Score, floor: Score) -> bool:
    if bound.unmeasured != floor.unmeasured:
        return bound.unmeasured < floor.unmeasured
    return bound.worst >= floor.worst * (1 - ROUNDING)


def _pairs_exchanged(
    problem: SelectionProblem, chosen: Choice, fixed: Choice, free: Sequence[int]
) -> tuple[Choice, int]:
    """Return the set after exchanges of two cameras at once, while one improves it.

    The first of the new pair is among the best single additions: how many are tried depends on how many there are.
    """
    n = 0
    while (better := _pair_exchanged(problem, chosen, fixed, free)) is not None:
        chosen, more = _exchanged(problem, better, fixed, free)
        n += 1 + more
    return chosen, n


def _pair_exchanged(problem: SelectionProblem, chosen: Choice, fixed: Choice, free: Sequence[int]) -> Choice | None:
    """Return a better set with two cameras exchanged, or None."""
    score, pairs = problem.score((*fixed, *chosen)), list(combinations(range(len(chosen)), 2))
    promising, hard = max(1, _PAIRS // max(len(pairs) * len(free), 1)), problem.hardest((*fixed, *chosen))
    for i, j in pairs:
        kept = tuple(c for place, c in enumerate(chosen) if place not in (i, j))
        left = [c for c in free if c not in kept]
        for first, _ in ranked(hard, (*fixed, *kept), left)[:promising]:
            found = _best_addition(problem, hard, (*fixed, *kept, first), left, score)
            if found is not None:
                return (*kept, first, found[0])
    return None
