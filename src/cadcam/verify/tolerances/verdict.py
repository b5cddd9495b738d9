"""Verdicts by ISO 14253-1: a deviation with its expanded uncertainty against a limit.

With U = k sigma: PASS if |deviation| <= limit - U, FAIL if |deviation| > limit + U, else UNDECIDED. Conformity, and
non-conformity, are only stated where the uncertainty allows it: a camera too poor to judge never says PASS.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.verify.tolerances.tolerance import Limit, Quantity, Rule

SIMPLE_SHARE = 1 / 3  # largest U relative to the limit with which simple acceptance decides (JCGM 106:2012, 8.2)

_FLAT, _CENTRED = 1e-12, 1e-9  # count as zero: variance by the largest, distance from the centre in sigmas


class Verdict(Enum):
    """The verdict on a limit, or on the part."""

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


def towards(value: Array, covariance: Array, limit: Limit) -> float:
    """Return the standard deviation of a displacement's length, given its components (m,) and their covariance (m, m).

    It is defined by the decision, so that this errs as rarely as for a single component. PASS: the longest displacement
    in the k sigma ellipsoid keeps the limit. If the true one does not, some single direction shows that, and errs by k
    sigma as rarely as any. FAIL: the shortest displacement in the ellipsoid that misses the true one as rarely is
    beyond it.
    """
    from scipy.special import chdtri, ndtr

    size, m = float(np.linalg.norm(value)), len(value)
    if size <= limit.value:
        return (lengths(value, covariance, limit.k)[1] - size) / limit.k
    k = limit.k if m == 1 else float(np.sqrt(chdtri(m, ndtr(-limit.k))))
    return (size - lengths(value, covariance, k)[0]) / limit.k


def lengths(value: Array, covariance: Array, k: float) -> tuple[float, float]:
    """Return the lengths of the shortest and the longest vector d with (d - value)^T V^-1 (d - value) <= k^2.

    At both (V - l) d = -l value with one unknown l: for the longest it is beyond the largest variance, for the shortest
    below zero.
    """
    c, axes = np.linalg.eigh(covariance)
    largest, v = float(c[-1]), axes.T @ value
    if largest <= 0:
        return float(np.linalg.norm(value)), float(np.linalg.norm(value))
    c = np.maximum(c, _FLAT * largest)
    short = 0.0
    if (v**2 / c).sum() > k**2:
        x = _on_ellipsoid(v, c, c, k)
        short = float(np.linalg.norm(x / (x + c) * v))
    v[-1] = np.copysign(max(abs(v[-1]), _CENTRED * np.sqrt(largest)), v[-1])  # a centred one has two longest vectors
    x = _on_ellipsoid(v, c, largest - c, k)
    return short, float(np.linalg.norm((x + largest) / (x + (largest - c)) * v))


def _on_ellipsoid(v: Array, c: Array, gap: Array, k: float) -> float:
    """Return x > 0 where the sum of c v^2 / (x + gap)^2, which falls with x, is k^2."""
    from scipy.optimize import brentq

    most = 2 * float(np.linalg.norm(v)) * np.sqrt(float(c[-1])) / k
    low = 0.5 * abs(float(v[-1])) * np.sqrt(float(c[-1])) / k if not gap[-1] else 0.0
    return float(brentq(lambda x: float((c * (v / (x + gap)) ** 2).sum()) - k**2, low, most, xtol=1e-300))


def overall(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the part's verdict: FAIL if any limit failed, PASS if all passed, else UNDECIDED."""
    said = set(verdicts)
    if Verdict.FAIL in said:
        return Verdict.FAIL
    return Verdict.PASS if said == {Verdict.PASS} else Verdict.UNDECIDED


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Judgement(Brief):
    """A limit of a feature, the measured value (mm; rad for angles; nan where nothing was measured), and the verdict.

    The value is told from the limit's middle, which for most limits is the CAD's own place or size. reason: one line of
    text; remedy: where it could not be decided, what would help; between: the features that a distance is between.
    str() has degrees for angles, as the tolerance file, and tells the value from the CAD; `limit.quantity.per_unit` is
    the factor from rad.
    """

    feature: str
    limit: Limit
    deviation: float
    sigma: float
    verdict: Verdict
    reason: str = ""
    remedy: str = ""
    between: tuple[str, ...] = ()

    @property
    def U(self) -> float:
        """Return the expanded uncertainty k sigma."""
        return self.limit.k * self.sigma

    def __str__(self) -> str:
        """Return it in words, in the unit of the tolerance file."""
        quantity = self.limit.quantity
        what = f"{self.feature}, {quantity.value.partition('_')[0]}"
        if quantity is Quantity.PRESENCE:
            return f"{what}: {self.verdict.value}"
        off = self.deviation + self.limit.middle
        value, U, low, high = (x * quantity.per_unit for x in (off, self.U, *self.limit.bounds))
        limit = f"limits {low:g} to {high:g}" if self.limit.middle else f"limit {high:g}"
        return f"{what}: {value:.3g} +- {U:.2g} {quantity.unit}, {limit} {quantity.unit}: {self.verdict.value}"
