"""The best set of k cameras: information adds up, so sets are compared by sums of 3x3 matrices.

What is wanted is that the worst of all limits, in all poses, has the largest test uncertainty ratio: a criterion that a
person understands, but one that says nothing while a feature cannot be measured at all, as with the first camera of a
pair. So three greedy starts that always make headway (the logarithm of the determinant of the information, whose gains
shrink as cameras are added; the mean logarithm of the ratios; a soft minimum of them), and where they cost little some
at random, each then improved by exchanging one camera, the best at last by exchanging two, as long as that helps the
criterion itself. Few candidates are tried out completely.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask
from cadcam.errors import BadValue
from cadcam.plan.ask import Asked

_WEAK = 1e-8  # information in units of a limit that keeps what no camera tells finite: a sigma of 10 000 limits
MEASURED = 0.1  # ratio below which nothing was measured: U is ten times the limit
_ROUNDING = 1e-9
_SHARP = 4.0  # power of the soft minimum
_TRIED = 4000  # sets that are tried out completely
_PAIRS = 3000  # exchanges of two that are tried at a time
_STARTS, _WORK = 12, 1_000_000  # starts at random, at most, and ratios that they may cost in one round of exchanges
_HARDEST, _SHARE = 64, 10  # targets that a change is tried on first, at least, and their share of all, one in so many
_FULLY = 6  # candidates that are tried on all targets at a time
_TOGETHER = 16_000  # ratios at a time: they stay in the cache

Choice = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Score:
    """How good a set is: limits not measured (fewer is better), the worst ratio of the others, the mean log of all."""

    unmeasured: int
    worst: float
    mean_log: float

    @property
    def value(self) -> tuple[float, float, float]:
        """Return it as numbers of which larger is better, the first that differs deciding."""
        return -float(self.unmeasured), self.worst, self.mean_log

    def beats(self, other: Score) -> bool:
        """Return whether it is better by more than rounding: sums in another order are no improvement."""
        if self.unmeasured != other.unmeasured:
            return self.unmeasured < other.unmeasured
        if abs(self.worst - other.worst) > _ROUNDING * max(self.worst, other.worst):
            return self.worst > other.worst
        return self.mean_log > other.mean_log + _ROUNDING


class Problem:
    """Candidates' information on the limits in all poses, ready to be added up; poses and limits become T targets."""

    def __init__(self, information: Array, asked: Asked) -> None:
        """Take information (C, P, L, 3, 3) 1/mm^2 of each candidate by itself."""
        C, P, L = information.shape[:3]
        unit = (asked.value**2)[:, None, None]
        each = _six((information * unit).reshape(C, P * L, 3, 3))
        base = asked.scaled(np.zeros((L, 3, 3))) + _WEAK * np.eye(3)
        self._take(each, _six(np.tile(base, (P, 1, 1))), np.tile(asked.k, P), np.tile(asked.basis, (P, 1, 1)))

    def _take(self, each: Array, base: Array, k: Array, basis: Array) -> None:
        self._each, self._base, self._k, self._basis = each, base, k, basis
        rank = np.rint((basis**2).sum(axis=(-2, -1)))
        self._groups = [(r, np.flatnonzero(rank == r)) for r in (1, 2, 3)]
        self.candidates, _, self.targets = each.shape

    def hardest(self, chosen: Sequence[int]) -> Problem:
        """Return the problem of the targets that a set does worst alone: no set scores better on all than on these."""
        if self.targets <= _HARDEST * _SHARE:
            return self
        at = np.sort(np.argsort(self.ratios(chosen))[: max(_HARDEST, self.targets // _SHARE)])
        part = object.__new__(Problem)
        part._take(np.ascontiguousarray(self._each[..., at]), self._base[:, at], self._k[at], self._basis[at])
        return part

    def ratios(self, chosen: Sequence[int]) -> Array:
        """Return the ratios (T,) of a set."""
        return np.asarray(self._ratios(self.sum(chosen)[None])[0])

    def sum(self, chosen: Sequence[int]) -> Array:
        """Return the information (6, T) of a set, with what is known before."""
        return np.asarray(self._base + self._each[list(chosen)].sum(axis=0))

    def score(self, chosen: Sequence[int]) -> Score:
        """Return how good a set is."""
        return _scores(self.ratios(chosen)[None])[0]

    def with_each(self, before: Array, added: Sequence[int], judge: Callable[[Array, Array], Array]) -> Array:
        """Return judge(information (n, 6, T), ratios (n, T)) of each candidate that is added to a sum `before`."""
        out = []
        step = max(1, _TOGETHER // before.shape[-1])
        for first in range(0, len(added), step):
            total = before + self._each[list(added[first : first + step])]
            out.append(judge(total, self._ratios(total)))
        return np.concatenate(out)

    def _ratios(self, total: Array) -> Array:
        """Return the ratios (n, T) of information (n, 6, T)."""
        out = np.zeros((total.shape[0], total.shape[2]))
        for rank, at in self._groups:
            if len(at):
                C = _inverse(total[..., at])
                variance = _largest(C) if rank == 3 else _spanned(C, self._basis[at], int(rank))
                out[:, at] = 1 / (self._k[at] * np.sqrt(variance))
        return out


@dataclass(frozen=True, slots=True)
class Found:
    """The best set found and its score; whether all sets were tried, how many or from how many starts; exchanges."""

    chosen: Choice
    score: Score
    complete: bool
    sets: int
    exchanges: int


def best_set(
    problem: Problem,
    k: int,
    *,
    fixed: Sequence[int] = (),
    step: Callable[[], None] = lambda: None,
    complete: bool | None = None,
) -> Found:
    """Return the best set of k candidates, those of `fixed` among them and not counted; k may be 0.

    complete: try all sets; default where they are few. step: called at each stage, for a display of progress.
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
    return Found(tuple(sorted(chosen)), problem.score((*fixed, *chosen)), False, len(starts), exchanges + n)


def exhausted(problem: Problem, k: int, *, fixed: Sequence[int] = ()) -> Found:
    """Return the best of all sets of k candidates."""
    free = [c for c in range(problem.candidates) if c not in set(fixed)]
    best: tuple[Score, Choice] | None = None
    tried = 0
    for head in combinations(free, max(k - 1, 0)):
        after = [c for c in free if not head or c > head[-1]]
        if k and not after:
            continue
        before = problem.sum((*fixed, *head))
        scores = _scores(problem.with_each(before, after, _ratios_only)) if k else [problem.score(tuple(fixed))]
        tried += len(scores)
        i = max(range(len(scores)), key=lambda j: scores[j].value)
        if best is None or scores[i].value > best[0].value:
            best = scores[i], (*head, after[i]) if k else ()
    assert best is not None
    return Found(best[1], best[0], True, tried, 0)


def one_fewer(problem: Problem, chosen: Sequence[int], *, fixed: Sequence[int] = ()) -> Score:
    """Return the score of a good set with one camera less than `chosen`: without its least needed, then exchanged."""
    free = [c for c in range(problem.candidates) if c not in set(fixed)]
    sets = [tuple(c for c in chosen if c != gone) for gone in chosen]
    kept = max(sets, key=lambda s: problem.score((*fixed, *s)).value)
    return problem.score((*fixed, *_exchanged(problem, kept, tuple(fixed), free)[0]))


def one_more(problem: Problem, chosen: Sequence[int], *, fixed: Sequence[int] = ()) -> Score:
    """Return the score of a good set with one camera more: with the one that helps most, then exchanged."""
    free = [c for c in range(problem.candidates) if c not in set(fixed)]
    first = ranked(problem, (*fixed, *chosen), free)[0][0]
    return problem.score((*fixed, *_exchanged(problem, (*chosen, first), tuple(fixed), free)[0]))


def ranked(problem: Problem, chosen: Sequence[int], among: Iterable[int]) -> list[tuple[int, Score]]:
    """Return candidates with the score of the set that each makes with the chosen ones, the best first."""
    added = [c for c in among if c not in set(chosen)]
    if not added:
        return []
    scores = _scores(problem.with_each(problem.sum(chosen), added, _ratios_only))
    return sorted(zip(added, scores, strict=True), key=lambda item: item[1].value, reverse=True)


def _ratios_only(total: Array, ratios: Array) -> Array:
    return ratios


def _scores(ratios: Array) -> list[Score]:
    measured: Mask = ratios > MEASURED
    worst = np.where(measured, ratios, np.inf).min(axis=-1)
    worst = np.where(np.isfinite(worst), worst, 0.0)
    mean = np.log(np.maximum(ratios, 1e-9)).mean(axis=-1)
    unmeasured = (~measured).sum(axis=-1)
    return [Score(int(u), float(w), float(m)) for u, w, m in zip(unmeasured, worst, mean, strict=True)]


def _by_information(total: Array, ratios: Array) -> Array:
    return np.asarray(np.log(np.maximum(_determinant(total), 1e-300)).mean(axis=-1))


def _by_mean(total: Array, ratios: Array) -> Array:
    return np.asarray(np.log(ratios).mean(axis=-1))


def _by_softest(total: Array, ratios: Array) -> Array:
    return np.asarray(-np.mean(np.maximum(ratios, 1e-3) ** -_SHARP, axis=-1))


def _greedy(
    problem: Problem, k: int, fixed: Choice, free: Sequence[int], judge: Callable[[Array, Array], Array]
) -> Choice:
    chosen: Choice = ()
    for _ in range(k):
        left = [c for c in free if c not in chosen]
        gains = problem.with_each(problem.sum((*fixed, *chosen)), left, judge)
        chosen = (*chosen, left[int(np.argmax(gains))])
    return chosen


def _exchanged(problem: Problem, chosen: Choice, fixed: Choice, free: Sequence[int]) -> tuple[Choice, int]:
    """Return the set after the best exchanges of one camera, as long as one helps, and how many were made."""
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
    problem: Problem, hard: Problem, kept: Choice, added: Sequence[int], floor: Score
) -> tuple[int, Score] | None:
    """Return the candidate that makes the best set with the kept ones, if that beats a score.

    What cannot beat it on the hardest targets cannot on all: most candidates are settled by these. Not so while some
    are not measured at all: then all targets count.
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
    return bound.worst >= floor.worst * (1 - _ROUNDING)


def _pairs_exchanged(problem: Problem, chosen: Choice, fixed: Choice, free: Sequence[int]) -> tuple[Choice, int]:
    """Return the set after exchanges of two cameras at once, as long as one helps.

    Of the new pair the first is among the best by itself: how many of these are tried depends on how many there are.
    """
    n = 0
    while (better := _pair_exchanged(problem, chosen, fixed, free)) is not None:
        chosen, more = _exchanged(problem, better, fixed, free)
        n += 1 + more
    return chosen, n


def _pair_exchanged(problem: Problem, chosen: Choice, fixed: Choice, free: Sequence[int]) -> Choice | None:
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


def _six(M: Array) -> Array:
    """Return xx yy zz xy xz yz (..., 6, T) of symmetric matrices (..., T, 3, 3), each a run of memory."""
    parts = [M[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return np.ascontiguousarray(np.stack(parts, axis=-2))


def _determinant(S: Array) -> Array:
    xx, yy, zz, xy, xz, yz = np.moveaxis(S, -2, 0)
    return np.asarray(xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz))


def _inverse(S: Array) -> Array:
    """Return the inverses (6, ...) of (..., 6, T)."""
    xx, yy, zz, xy, xz, yz = np.moveaxis(S, -2, 0)
    a, b, c = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
    # scaled information is at least _WEAK in every direction; rounding must not make it less
    det = np.maximum(xx * a + xy * b + xz * c, _WEAK * 1e-3 * np.maximum(a, 1e-300))
    return np.asarray(np.stack([a, xx * zz - xz * xz, xx * yy - xy * xy, b, c, xy * xz - xx * yz]) / det)


def _largest(C: Array) -> Array:
    """Return the largest eigenvalue of symmetric matrices (6, ...), by the cosine of a third of an angle."""
    xx, yy, zz, xy, xz, yz = C
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    p = np.sqrt(np.maximum((a * a + b * b + c * c) / 6 + (xy * xy + xz * xz + yz * yz) / 3, 1e-200))
    half = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / (2 * p**3)
    return np.asarray(mean + 2 * p * np.cos(np.arccos(np.clip(half, -1, 1)) / 3))


def _spanned(C: Array, basis: Array, rank: int) -> Array:
    """Return the largest variance within the first `rank` columns of a basis (T, 3, 3), of covariances (6, n, T)."""

    def form(u: Array, v: Array) -> Array:
        xx, yy, zz, xy, xz, yz = C
        return np.asarray(
            xx * (u[:, 0] * v[:, 0])
            + yy * (u[:, 1] * v[:, 1])
            + zz * (u[:, 2] * v[:, 2])
            + xy * (u[:, 0] * v[:, 1] + u[:, 1] * v[:, 0])
            + xz * (u[:, 0] * v[:, 2] + u[:, 2] * v[:, 0])
            + yz * (u[:, 1] * v[:, 2] + u[:, 2] * v[:, 1])
        )

    one = form(basis[:, :, 0], basis[:, :, 0])
    if rank == 1:
        return np.maximum(one, 1e-300)
    two, mixed = form(basis[:, :, 1], basis[:, :, 1]), form(basis[:, :, 0], basis[:, :, 1])
    return np.maximum((one + two) / 2 + np.hypot((one - two) / 2, mixed), 1e-300)


def as_targets(array: npt.NDArray[np.float64], poses: int) -> Array:
    """Return ratios (T,) as (poses, limits)."""
    return array.reshape(poses, -1)
