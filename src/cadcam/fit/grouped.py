"""Linear regression on data that err in groups: noise of each datum, scatter within groups, an offset for each group.

    y_i = J_i x + e_group(i) + a_family(group(i)) + n_i
    var n_i = (1 + excess) variance_i + within^2
    var e_g = share expected_g + relative_g own^2,   var a_f = relative_f alike^2,   between^2 = own^2 + alike^2

The noise of measuring is known but for a factor: what else acts on the brightness beside an edge, grain and texture,
shifts faint edges more than clear ones, as noise does; what a model lacks shifts all alike. Groups of one family, such
as the pieces of one line, have an offset in common as well as their own. By what groups are off for a reason that they
do not share alike is expected, but may not be there: share is 0 or 1. The other variances are estimated with x: those
within groups by moments, those between groups and families by restricted likelihood (Patterson and Thompson, Biometrika
58, 1971). With few of them a large variance explains a wrong x as well, and a maximum says little: x and its covariance
are averaged over the whole range of both and both shares, each with its likelihood and half-Cauchy priors of usual size
(Gelman, Bayesian Analysis 1, 2006). Data far off their group and groups far off the rest count less or not at all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Longs, Mask, quantile
from cadcam.errors import DegenerateGeometry
from cadcam.native.grouped import Tried, averaged_fit

_FULL, _NONE = 2.5, 4.0  # standard deviations: up to the first a datum counts fully, beyond the second not at all
_SETTLED = 0.02  # standard deviations that x may still move
# Variances between groups, roots, in usual ones, and how much of the range each stands for: half-Cauchy.
_RANGE, _OF_FAMILIES = (np.concatenate([[0.0], np.geomspace(0.05, 60.0, n)]) for n in (17, 9))
_PRIOR, _FAMILY_PRIOR = (np.log(np.gradient(r)) - np.log1p(r**2) for r in (_RANGE, _OF_FAMILIES))


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Which of G groups each datum is of (n,), ascending numbers, none left out; and what is known of how groups err.

    relative (G,): how the variances of their offsets compare, default all 1. expected (G,): variance between them that
    is to be expected, default none. exact (G,): groups without an offset or scatter of their own, believed as they are;
    whole families are. family (G,): ascending numbers of what groups belong to, default none to anything;
    family_relative (F,): how the variances of what these have in common compare, default all 1.
    """

    of: Longs
    relative: Array | None = None
    expected: Array | None = None
    exact: Mask | None = None
    family: Longs | None = None
    family_relative: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GroupedFit:
    """The parameters x (k,), their covariance (k, k), and what the data say about themselves.

    excess: share by which variances within groups exceed the known ones; within, between: standard deviations beyond
    that, within groups and of the offset of a group of relative variance 1, of which alike is common to its family.
    weight (n,) in [0, 1]: how far each datum counts by itself; of_group (G,) the same of each group; offset (G,) each
    group's mean residual, sd_offset (G,) its noise, off (G,) the sd that the offset itself is taken to have. group
    (n,): of each datum, family (G,): of each group. gain (k, n): dx/dy, by which what shifts the data shifts x.
    """

    x: Array
    covariance: Array
    excess: float
    within: float
    between: float
    alike: float
    weight: Array
    of_group: Array
    offset: Array
    sd_offset: Array
    off: Array
    group: Longs
    family: Longs
    gain: Array

    @property
    def dof(self) -> float:
        """Return the degrees of freedom of the scatter between groups, at least 1.

        Of its two parts together, as B. L. Welch adds them (Biometrika 34, 1947).
        """
        counts = np.maximum.reduceat(self.of_group, np.flatnonzero(np.diff(self.family, prepend=-1)))
        groups, families = (max(float(a.sum()) - len(self.x), 1.0) for a in (self.of_group, counts))
        common = (self.alike / self.between) ** 2 if self.between > 0 else 0.0
        return 1 / ((1 - common) ** 2 / groups + common**2 / families)


def grouped_fit(
    y: Array,
    J: Array,
    variance: Array,
    groups: Groups,
    *,
    usual: float,
    uneven: float = 0.0,
    robust: bool = True,
    iterations: int = 12,
) -> GroupedFit:
    """Return the fit of y (n,) by J (n, k) with known variances (n,) of data that err in groups.

    usual: a usual standard deviation between groups. uneven: groups that are off are so unevenly: within is at least
    this share of between. Robust fits start from x = 0, near which half of the other data must lie. Raises
    `DegenerateGeometry` where the data leave a parameter open.
    """
    sums, group = _Sums(y, J, groups), groups.of
    free = sums.free[group]
    x, spread, off = np.zeros(J.shape[1]), (0.0, 0.0), _Off(usual**2, 0.0, 0.0)
    weight, of_group = np.ones(len(y)), np.ones(sums.n)
    if robust:
        weight, of_group, spread = _first_weights(y, variance, sums)
    covariance, mean, total = np.eye(len(x)), np.zeros(sums.n), np.ones(sums.n)
    seen_variance = _grown(variance, free, spread)
    w, of_group_then = weight / seen_variance, of_group
    for _ in range(iterations):
        w, of_group_then, x_before = weight / seen_variance, of_group, x
        x, covariance, off = sums.solve(w, of_group, usual)
        r = y - J @ x
        mean, total = sums.means(r, w)
        share = w / np.maximum(total[group], 1e-300)
        excess, within2 = _spread((r - mean[group]) ** 2, variance, weight * free / seen_variance**2, share)
        spread = excess, max(within2, uneven**2 * min(off.own + off.alike, _median_square(mean[sums.free > 0])))
        seen_variance = _grown(variance, free, spread)
        if (np.abs(x - x_before) <= _SETTLED * np.sqrt(np.diag(covariance))).all():
            break
        if robust:
            its = sums.variance(off)
            seen = its + 1 / np.maximum(total, 1e-300)
            weight = _counts(free * (r - (mean * its / seen)[group]) / np.sqrt(seen_variance))
            of_group = _counts(sums.free * mean / np.sqrt(seen))
    sd = 1 / np.sqrt(np.maximum(total, 1e-300))
    gain = sums.gain(w, of_group_then, off)
    within, between, alike = (math.sqrt(v) for v in (spread[1], off.own + off.alike, off.alike))
    about = (weight, of_group, mean, sd, np.sqrt(sums.variance(off)), group, sums.family)
    return GroupedFit(x, covariance, spread[0], within, between, alike, *about, gain)


@dataclass(frozen=True, slots=True)
class _Off:
    """Variances by which groups are off: of their own, alike in their family, and the share of what was expected."""

    own: float
    alike: float
    share: float


class _Sums:
    """Sums over groups of one design."""

    def __init__(self, y: Array, J: Array, groups: Groups) -> None:
        self.y, self.J, self.group = y, J, groups.of
        self.first = np.flatnonzero(np.diff(groups.of, prepend=-1))
        self.n = len(self.first)
        self.free = np.ones(self.n) if groups.exact is None else np.asarray(1.0 - groups.exact, np.float64)
        self.relative = self.free if groups.relative is None else groups.relative * self.free
        self.expected = np.zeros(self.n) if groups.expected is None else groups.expected * self.free
        told = np.arange(self.n) if groups.family is None else groups.family
        self.first_of_family = np.flatnonzero(np.diff(told, prepend=-1))
        self.family = np.cumsum(np.diff(told, prepend=told[:1]) > 0, dtype=np.int64)
        in_common = 1.0 if groups.family_relative is None else groups.family_relative
        self.family_free = self.free[self.first_of_family] * in_common
        self.families_tried = slice(1) if groups.family is None else slice(None)  # without: no variance between them
        if len(y) < J.shape[1]:
            raise DegenerateGeometry("too few edges were found to determine the pose")

    def solve(self, w: Array, of_group: Array, usual: float) -> tuple[Array, Array, _Off]:
        """Return x, its covariance, and by what groups are off, averaged over what it may be.

        With offsets of variance v, a group's weights W become W - f W 1 1' W with f = v / (1 + v 1' W 1).
        """
        shares = [0.0, 1.0] if self.expected.any() else [0.0]  # without and with what is expected
        variance, share = (usual * np.tile(_RANGE, len(shares))) ** 2, np.repeat(shares, len(_RANGE))
        of_groups = (self.relative, self.expected, variance, share, np.tile(_PRIOR, len(shares)))
        common, prior = (a[self.families_tried] for a in ((usual * _OF_FAMILIES) ** 2, _FAMILY_PRIOR))
        tried = Tried(*of_groups, self.family, self.family_free, common, prior)
        found = averaged_fit(self.y, self.J, w, self.group, of_group, tried)
        if found is None:
            raise DegenerateGeometry("the edges found do not determine the pose; restrict the motion or add photos")
        x, covariance, p = found
        own, alike = p.sum(axis=1), p.sum(axis=0)
        return x, covariance, _Off(float(own @ variance), float(alike @ common), float(own @ share))

    def own(self, off: _Off) -> Array:
        """Return the variance (G,) of each group's own offset."""
        return np.asarray(off.own * self.relative + off.share * self.expected)

    def variance(self, off: _Off) -> Array:
        """Return the variance (G,) of each group's offset, its own and its family's."""
        return self.own(off) + off.alike * self.family_free[self.family]

    def gain(self, w: Array, of_group: Array, off: _Off) -> Array:
        """Return dx/dy (k, n) for given weights and variances of groups."""
        w, counts, own = w * of_group[self.group], np.maximum(of_group, 1e-12), self.own(off)
        total = np.add.reduceat(w, self.first)
        grown = 1 + own * total / counts
        JW = self.J * w[:, None]
        sums = np.add.reduceat(JW, self.first, axis=0)
        v = off.alike * self.family_free
        f = v / (1 + v * np.add.reduceat(total / grown, self.first_of_family))
        common = f[:, None] * np.add.reduceat(sums / grown[:, None], self.first_of_family, axis=0)
        taken = (own / counts)[:, None] * sums + common[self.family]
        VJ = JW - w[:, None] * (taken / grown[:, None])[self.group]
        try:
            return np.asarray(np.linalg.inv(VJ.T @ self.J) @ VJ.T)
        except np.linalg.LinAlgError:
            raise DegenerateGeometry("the edges that are believed do not determine the pose") from None

    def means(self, r: Array, w: Array) -> tuple[Array, Array]:
        """Return the weighted mean of each group and its total weight."""
        total = np.add.reduceat(w, self.first)
        return np.add.reduceat(w * r, self.first) / np.maximum(total, 1e-300), total


def _first_weights(y: Array, variance: Array, sums: _Sums) -> tuple[Array, Array, tuple[float, float]]:
    """Return weights of data and groups, and the spread within groups, as they look from x = 0, by medians."""
    group, free = sums.group, sums.free > 0
    if not free.any():
        return np.ones(len(y)), np.ones(sums.n), (0.0, 0.0)
    mean, _ = sums.means(y, 1 / variance)
    within2 = _median_square((y - mean[group])[free[group]])
    mean, _ = sums.means(y, 1 / (variance + within2))
    weight = _counts((y - mean[group]) / np.sqrt(variance + within2))
    of_group = _counts(mean / np.sqrt(max(_median_square(mean[free]), 1e-300)))
    return np.where(free[group], weight, 1.0), np.where(free, of_group, 1.0), (0.0, within2)


def _median_square(d: Array) -> float:
    """Return the variance of the good half of deviations, 0 of none."""
    return quantile(d * d, 0.5) / 0.455 if len(d) else 0.0


def _grown(variance: Array, free: npt.NDArray[np.floating], spread: tuple[float, float]) -> Array:
    """Return all variance (n,) of data within their group, from the known and the spread: excess and within^2."""
    return np.asarray(variance * (1 + spread[0] * free) + spread[1] * free)


def _spread(squares: Array, known: Array, weight: Array, share: Array) -> tuple[float, float]:
    """Return excess and variance within groups beyond the known one: where weighted squares are as large as expected.

    share: of its group's weight that each datum has, the part of its variance that the group's mean takes away.
    """
    left = weight * (1 - share)
    a, b, c = float(left @ known**2), float(left @ known), float(left.sum())
    beyond = weight * squares - left * known
    p, q = float(beyond @ known), float(beyond.sum())
    if not c > 0:
        return 0.0, 0.0
    det = a * c - b * b
    if det > 1e-9 * a * c:
        excess, within2 = (c * p - b * q) / det, (a * q - b * p) / det
        if excess >= 0 and within2 >= 0:
            return excess, within2
    gain_p, gain_q = max(p, 0.0) ** 2 / a, max(q, 0.0) ** 2 / c
    return (max(p, 0.0) / a, 0.0) if gain_p >= gain_q else (0.0, max(q, 0.0) / c)


def _counts(u: Array) -> Array:
    """Return how far a datum u standard deviations off counts."""
    return np.asarray(np.minimum(np.maximum((_NONE - np.abs(u)) / (_NONE - _FULL), 0.0), 1.0))
