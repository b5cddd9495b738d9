"""Linear regression on data that err in groups: noise of each datum, scatter within groups, an offset for each group.

    y_i = J_i x + e_group(i) + n_i,   var n_i = variance_i + within^2,   var e = between^2

The known variances are the noise of measuring; the two others are estimated with x, by moments (the between one so that
the groups' means scatter as much as they should: R. C. Paule, J. Mandel, J. Res. NBS 87 (1982), less the degrees of
freedom that x takes). Data far off their group and groups far off the rest count less or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.errors import DegenerateGeometry

Longs = npt.NDArray[np.int64]
_FULL, _NONE = 2.5, 4.0  # standard deviations: up to the first a datum counts fully, beyond the second not at all
_ITERATIONS = 12


@dataclass(frozen=True, slots=True, eq=False)
class GroupedFit:
    """The parameters x (k,), their covariance (k, k), and what the data say about themselves.

    within, between: standard deviations beyond the known noise. weight (n,) in [0, 1]: how far each datum counts;
    of_group (G,) the same of each group; offset (G,) each group's mean residual. groups: number that count, in effect.
    """

    x: Array
    covariance: Array
    within: float
    between: float
    weight: Array
    of_group: Array
    offset: Array
    groups: float

    @property
    def dof(self) -> float:
        """Return the degrees of freedom of the scatter between groups, at least 1."""
        return max(self.groups - len(self.x), 1.0)


def grouped_fit(y: Array, J: Array, variance: Array, group: Longs, *, robust: bool = True) -> GroupedFit:
    """Return the fit of y (n,) by J (n, k) with known variances (n,) and group numbers (n,) from 0 without gaps.

    Raises `DegenerateGeometry` where the data leave a parameter open.
    """
    sums = _Sums(J, group)
    x, within2, between2 = np.zeros(J.shape[1]), 0.0, 0.0
    weight, of_group = np.ones(len(y)), np.ones(sums.n)
    covariance = np.eye(len(x))
    for iteration in range(_ITERATIONS):
        w = weight / (variance + within2)
        x_before = x
        x, covariance = sums.solve(y, w, of_group, between2)
        r = y - J @ x
        mean, total = sums.means(r, w)
        within2 = _within(r - mean[group], variance, within2, weight, group, total, w)
        between2 = _between(mean, total, of_group, len(x))
        if robust:
            shrunk = mean * between2 / (between2 + 1 / np.maximum(total, 1e-300))
            weight = _counts((r - shrunk[group]) / np.sqrt(variance + within2))
            of_group = _counts(mean / np.sqrt(between2 + 1 / np.maximum(total, 1e-300)))
        if iteration > 3 and np.abs(x - x_before).max() <= 1e-6 * np.sqrt(np.diag(covariance)).min():
            break
    return GroupedFit(
        x, covariance, float(np.sqrt(within2)), float(np.sqrt(between2)), weight, of_group, mean, float(of_group.sum())
    )


class _Sums:
    """Sums over groups of one design."""

    def __init__(self, J: Array, group: Longs) -> None:
        self.J, self.group = J, group
        self.n = int(group.max()) + 1 if len(group) else 0

    def solve(self, y: Array, w: Array, of_group: Array, between2: float) -> tuple[Array, Array]:
        """Return x and its covariance. With offsets of variance v, a group's weights W become W - f W 1 1' W."""
        J, group = self.J, self.group
        w = w * of_group[group]
        total = np.bincount(group, w, self.n)
        f = between2 / (1 + between2 * total / np.maximum(of_group, 1e-12)) / np.maximum(of_group, 1e-12)
        f[total <= 0] = 0.0
        JW = J * w[:, None]
        sum_J = np.stack([np.bincount(group, JW[:, k], self.n) for k in range(J.shape[1])], axis=1)
        sum_y = np.bincount(group, w * y, self.n)
        A = JW.T @ J - (sum_J * f[:, None]).T @ sum_J
        b = JW.T @ y - sum_J.T @ (f * sum_y)
        scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
        A = A / np.outer(scale, scale)
        if not np.linalg.cond(A) < 1e12:
            raise DegenerateGeometry("the edges found do not determine the pose; restrict the motion or add photos")
        inverse = np.linalg.inv(A) / np.outer(scale, scale)
        return inverse @ b, inverse

    def means(self, r: Array, w: Array) -> tuple[Array, Array]:
        """Return the weighted mean of each group and its total weight."""
        total = np.bincount(self.group, w, self.n)
        return np.bincount(self.group, w * r, self.n) / np.maximum(total, 1e-300), total


def _within(d: Array, variance: Array, now: float, weight: Array, group: Longs, total: Array, w: Array) -> float:
    """Return the variance within groups beyond the known one: where the weighted squares are as large as expected."""
    v = weight / (variance + now) ** 2
    left = 1 - w / np.maximum(total[group], 1e-300)  # the mean takes its share
    expected = v * left
    if not expected.sum() > 0:
        return now
    return max(float((v * d * d - expected * variance).sum() / expected.sum()), 0.0)


def _between(mean: Array, total: Array, of_group: Array, k: int) -> float:
    """Return the variance of the groups' offsets at which their means scatter as they should, 0 if they do already."""
    seen = (total > 0) & (of_group > 0)
    m2, v, weight = mean[seen] ** 2, 1 / total[seen], of_group[seen]
    wanted = float(weight.sum()) - k
    if wanted <= 0 or (weight * m2 / v).sum() <= wanted:
        return 0.0
    low, high = 0.0, float(m2.max() * len(m2))
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if (weight * m2 / (v + middle)).sum() > wanted else (low, middle)
    return 0.5 * (low + high)


def _counts(u: Array) -> Array:
    """Return how far a datum u standard deviations off counts."""
    return np.asarray(np.clip((_NONE - np.abs(u)) / (_NONE - _FULL), 0.0, 1.0))
