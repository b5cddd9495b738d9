"""Verdicts by ISO 14253-1: a deviation with its expanded uncertainty against a limit.

With U = k sigma: PASS if |deviation| <= limit - U, FAIL if |deviation| > limit + U, else UNDECIDED. Conformity, and
non-conformity, is only said where the uncertainty allows it: a camera too poor to judge never says PASS.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from cadcam.verify.tolerance import Limit, Rule

SIMPLE_SHARE = 1 / 3  # of the limit that U may be where simple acceptance decides (JCGM 106:2012, 8.2)


class Verdict(Enum):
    """What is said of a limit, or of the part."""

    PASS = "PASS"
    FAIL = "FAIL"
    UNDECIDED = "UNDECIDED"
    NOT_FOUND = "NOT FOUND"

    @property
    def exit_code(self) -> int:
        """Return the process' exit code: 0 PASS, 1 FAIL, 3 without a decision (2 is for errors)."""
        return {Verdict.PASS: 0, Verdict.FAIL: 1}.get(self, 3)


def decided(deviation: float, sigma: float, limit: Limit) -> Verdict:
    """Return the verdict on a deviation with standard deviation sigma, both in the limit's unit.

    Simple acceptance compares the deviation alone, where U is at most a third of the limit; else it is UNDECIDED.
    """
    U = limit.k * sigma
    if not (np.isfinite(deviation) and np.isfinite(U)):
        return Verdict.UNDECIDED
    size = abs(deviation)
    if limit.rule is Rule.SIMPLE:
        if limit.value * SIMPLE_SHARE < U:
            return Verdict.UNDECIDED
        return Verdict.PASS if size <= limit.value else Verdict.FAIL
    if size <= limit.value - U:
        return Verdict.PASS
    return Verdict.FAIL if size > limit.value + U else Verdict.UNDECIDED


def overall(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the part's verdict: FAIL if any limit failed, PASS if all passed, else UNDECIDED."""
    said = set(verdicts)
    if Verdict.FAIL in said:
        return Verdict.FAIL
    return Verdict.PASS if said == {Verdict.PASS} else Verdict.UNDECIDED


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """A limit of a feature, what was measured (mm; rad for angles; nan where nothing was) and what follows.

    reason: one line for people.
    """

    feature: str
    limit: Limit
    deviation: float
    sigma: float
    verdict: Verdict
    reason: str = ""

    @property
    def U(self) -> float:
        """Return the expanded uncertainty k sigma."""
        return self.limit.k * self.sigma
