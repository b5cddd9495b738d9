"""How good a set of cameras is: the ratios of all limits in all poses, from the sum of the candidates' information."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.plan.assessment.asked import Asked
from cadcam.plan.choice.packed import inverse, largest, packed, spanned

MEASURED = 0.1  # ratio below which a limit counts as not measured: U is ten times the limit
ROUNDING = 1e-9
_WEAK = 1e-8  # information, in units of a limit, that keeps undetermined directions finite: a sigma of 10 000 limits
_HARDEST, _SHARE = 64, 10  # targets that a change is tried on first: at least so many, or one in so many of all
_TOGETHER = 16_000  # ratios computed at a time, to stay in the cache


@dataclass(frozen=True, slots=True)
class Score:
    """How good a set is: limits not measured (fewer is better), the worst ratio of the others, mean log of all."""

    unmeasured: int
    worst: float
    mean_log: float

    @property
    def value(self) -> tuple[float, float, float]:
        """Return it as a tuple to be compared lexicographically, larger being better."""
        return -float(self.unmeasured), self.worst, self.mean_log

    def beats(self, other: Score) -> bool:
        """Return whether it is better by more than rounding: sums in another order are no improvement."""
        if self.unmeasured != other.unmeasured:
            return self.unmeasured < other.unmeasured
        if abs(self.worst - other.worst) > ROUNDING * max(self.worst, other.worst):
            return self.worst > other.worst
        return self.mean_log > other.mean_log + ROUNDING


class SelectionProblem:
    """The candidates' information on the limits in all poses, ready to be added up; T targets: poses times limits."""

    def __init__(self, information: Array, asked: Asked) -> None:
        """Take information (C, P, L, 3, 3) 1/mm^2 of each candidate by itself."""
        C, P, L = information.shape[:3]
        unit = (asked.value**2)[:, None, None]
        each = packed((information * unit).reshape(C, P * L, 3, 3))
        base = asked.scaled(np.zeros((L, 3, 3))) + _WEAK * np.eye(3)
        self._take(each, packed(np.tile(base, (P, 1, 1))), np.tile(asked.k, P), np.tile(asked.basis, (P, 1, 1)))

    def _take(self, each: Array, base: Array, k: Array, basis: Array) -> None:
        self._each, self._base, self._k, self._basis = each, base, k, basis
        rank = basis.any(axis=-2).sum(axis=-1)
        self._groups = [(r, np.flatnonzero(rank == r)) for r in (1, 2, 3)]
        self.candidates: int
        self.targets: int
        self.candidates, _, self.targets = each.shape

    def hardest(self, chosen: Sequence[int]) -> SelectionProblem:
        """Return the problem of the targets that a set does worst; scores on these bound the scores on all."""
        if self.targets <= _HARDEST * _SHARE:
            return self
        at = np.sort(np.argsort(self.ratios(chosen))[: max(_HARDEST, self.targets // _SHARE)])
        part = object.__new__(SelectionProblem)
        part._take(np.ascontiguousarray(self._each[..., at]), self._base[:, at], self._k[at], self._basis[at])
        return part

    def ratios(self, chosen: Sequence[int]) -> Array:
        """Return the ratios (T,) of a set."""
        return np.asarray(self._ratios(self.sum(chosen)[None])[0])

    def sum(self, chosen: Sequence[int]) -> Array:
        """Return the information (6, T) of a set, including the prior."""
        return np.asarray(self._base + self._each[list(chosen)].sum(axis=0))

    def score(self, chosen: Sequence[int]) -> Score:
        """Return how good a set is."""
        return score_of(self.ratios(chosen))

    def with_each(self, before: Array, added: Sequence[int], judge: Callable[[Array, Array], Array]) -> Array:
        """Return judge(information (n, 6, T), ratios (n, T)) for each candidate added to a sum `before`."""
        out = []
        step = max(1, _TOGETHER // before.shape[-1])
        for first in range(0, len(added), step):
            total = before + self._each[list(added[first : first + step])]
            out.append(judge(total, self._ratios(total)))
        return np.concatenate(out)

    def scores_with_each(self, before: Array, added: Sequence[int]) -> list[Score]:
        """Return the score of the set with each candidate added to a sum `before`."""
        return _scores(self.with_each(before, added, lambda total, ratios: ratios))

    def _ratios(self, total: Array) -> Array:
        """Return the ratios (n, T) of information (n, 6, T)."""
        out = np.zeros((total.shape[0], total.shape[2]))
        for rank, at in self._groups:
            if len(at):
                C = inverse(total[..., at], least=_WEAK)
                variance = largest(C) if rank == 3 else spanned(C, self._basis[at], rank)
                out[:, at] = 1 / (self._k[at] * np.sqrt(variance))
        return out


def score_of(ratios: Array) -> Score:
    """Return how good a set with these ratios (T,) is."""
    return _scores(ratios[None])[0]


def _scores(ratios: Array) -> list[Score]:
    measured: Mask = ratios > MEASURED
    worst = np.where(measured, ratios, np.inf).min(axis=-1)
    worst = np.where(np.isfinite(worst), worst, 0.0)
    mean = np.log(np.maximum(ratios, 1e-9)).mean(axis=-1)
    unmeasured = (~measured).sum(axis=-1)
    return [Score(int(u), float(w), float(m)) for u, w, m in zip(unmeasured, worst, mean, strict=True)]
