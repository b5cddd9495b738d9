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
    search = _Search.of(problem, fixed)
    if not 0 <= k <= len(search.free):
        raise BadValue("number of cameras", k, f"at most the {len(search.free)} candidates that there are")
    if complete or (complete is None and comb(len(search.free), k) <= _TRIED):
        return exhausted(problem, k, fixed=fixed)
    best: tuple[Score, Choice] | None = None
    exchanges = 0
    starts = search.starts(k)
    for start in starts:
        chosen, n = search.exchanged(start)
        score = search.score(chosen)
        exchanges += n
        if best is None or score.value > best[0].value:
            best = score, chosen
        step()
    assert best is not None
    chosen, n = search.pairs_exchanged(best[1])
    step()
    return BestSet(tuple(sorted(chosen)), search.score(chosen), False, len(starts), exchanges + n)


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


def one_fewer(problem: SelectionProblem, chosen: Sequence[int], *, fixed: Sequence[int] = ()) -> Choice:
    """Return a good set with one camera fewer: `chosen` without the least useful, then exchanged."""
    search = _Search.of(problem, fixed)
    kept = max((tuple(c for c in chosen if c != gone) for gone in chosen), key=lambda s: search.score(s).value)
    return search.exchanged(kept)[0]


def one_more(problem: SelectionProblem, chosen: Sequence[int], *, fixed: Sequence[int] = ()) -> Choice:
    """Return a good set with one camera more: `chosen` with the most useful added, then exchanged."""
    search = _Search.of(problem, fixed)
    first = ranked(problem, (*fixed, *chosen), search.free)[0][0]
    return search.exchanged((*chosen, first))[0]


def ranked(problem: SelectionProblem, chosen: Sequence[int], among: Iterable[int]) -> list[tuple[int, Score]]:
    """Return candidates with the score of `chosen` plus each of them, best first."""
    added = [c for c in among if c not in set(chosen)]
    if not added:
        return []
    scores = problem.scores_with_each(problem.sum(chosen), added)
    return sorted(zip(added, scores, strict=True), key=lambda item: item[1].value, reverse=True)


def _by_information(total: Array, ratios: Array) -> Array:
    """Return the mean log determinant of the information (n, 6, T): D-optimality, which always grows."""
    return np.asarray(np.log(np.maximum(determinant(total), 1e-300)).mean(axis=-1))


def _by_mean(total: Array, ratios: Array) -> Array:
    """Return the mean logarithm of the ratios (n, T)."""
    return np.asarray(np.log(ratios).mean(axis=-1))


def _by_softest(total: Array, ratios: Array) -> Array:
    """Return a soft minimum of the ratios (n, T)."""
    return np.asarray(-np.mean(np.maximum(ratios, 1e-3) ** -_SHARP, axis=-1))


@dataclass(frozen=True, slots=True)
class _Search:
    """A search for sets of candidates: those that are fixed, in every set, and those that are free to be chosen.

    Sets are given without the fixed candidates.
    """

    problem: SelectionProblem
    fixed: Choice
    free: Choice

    @classmethod
    def of(cls, problem: SelectionProblem, fixed: Sequence[int]) -> _Search:
        """Return the search in which all candidates but the fixed ones are free."""
        return cls(problem, tuple(fixed), tuple(c for c in range(problem.candidates) if c not in set(fixed)))

    def score(self, chosen: Choice) -> Score:
        """Return how good a set is."""
        return self.problem.score((*self.fixed, *chosen))

    def starts(self, k: int) -> list[Choice]:
        """Return sets of k candidates to improve: greedy ones, and random ones as far as they cost little."""
        greedy = [self._greedy(k, judge) for judge in (_by_information, _by_mean, _by_softest)]
        rng = np.random.default_rng(len(self.free))  # a fixed seed: the same scene gives the same set
        spare = min(_STARTS, _WORK // max(len(self.free) * k * self.problem.targets, 1))
        return greedy + [tuple(int(c) for c in rng.choice(self.free, k, replace=False)) for _ in range(spare)]

    def _greedy(self, k: int, judge: Callable[[Array, Array], Array]) -> Choice:
        """Return the set of k candidates, each the best to add to those before it."""
        chosen: Choice = ()
        for _ in range(k):
            left = [c for c in self.free if c not in chosen]
            gains = self.problem.with_each(self.problem.sum((*self.fixed, *chosen)), left, judge)
            chosen = (*chosen, left[int(np.argmax(gains))])
        return chosen

    def exchanged(self, chosen: Choice) -> tuple[Choice, int]:
        """Return the set after the best exchanges of one camera, while one improves it, and how many were made."""
        score, n = self.score(chosen), 0
        while True:
            before, hard = score, self.problem.hardest((*self.fixed, *chosen))
            others, better = [c for c in self.free if c not in chosen], chosen
            for i in range(len(chosen)):
                kept = chosen[:i] + chosen[i + 1 :]
                found = _best_addition(self.problem, hard, (*self.fixed, *kept), others, score)
                if found is not None:
                    score, better = found[1], (*kept, found[0])
            if not score.beats(before):
                return chosen, n
            chosen, n = better, n + 1

    def pairs_exchanged(self, chosen: Choice) -> tuple[Choice, int]:
        """Return the set after exchanges of two cameras at once, while one improves it, and how many were made.

        Exchanges of one that follow from these are among them.
        """
        n = 0
        while (better := self._pair_exchanged(chosen)) is not None:
            chosen, more = self.exchanged(better)
            n += 1 + more
        return chosen, n

    def _pair_exchanged(self, chosen: Choice) -> Choice | None:
        """Return a better set with two cameras exchanged, or None.

        The first of the new pair is among the best single additions: how many are tried depends on how many there are.
        """
        score, pairs = self.score(chosen), list(combinations(range(len(chosen)), 2))
        promising = max(1, _PAIRS // max(len(pairs) * len(self.free), 1))
        hard = self.problem.hardest((*self.fixed, *chosen))
        for i, j in pairs:
            kept = tuple(c for place, c in enumerate(chosen) if place not in (i, j))
            left = [c for c in self.free if c not in kept]
            for first, _ in ranked(hard, (*self.fixed, *kept), left)[:promising]:
                found = _best_addition(self.problem, hard, (*self.fixed, *kept, first), left, score)
                if found is not None:
                    return (*kept, first, found[0])
        return None


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
    """Return whether a set may beat a score, given a bound of its own."""
    if bound.unmeasured != floor.unmeasured:
        return bound.unmeasured < floor.unmeasured
    return bound.worst >= floor.worst * (1 - ROUNDING)
