"""Linear regression on grouped data: noise of each datum, scatter within groups, an offset for each group.

    y_i = J_i x + e_group(i) + a_family(group(i)) + n_i
    var n_i = (1 + excess) variance_i + within^2
    var e_g = share expected_g + relative_g own^2,   var a_f = relative_f alike^2,   between^2 = own^2 + alike^2

The measurement noise is known up to a factor: other influences on the brightness beside an edge, such as grain and
texture, shift faint edges more than clear ones, as noise does; a deficient model shifts all alike. Groups of one
family, such as the pieces of one line, share an offset besides their own. Groups may have an expected variance of
offsets, for a reason that they do not share, which may be absent: share is 0 or 1. The other variances are estimated
with x: those within groups by moments, those between groups and families by restricted likelihood (Patterson and
Thompson, Biometrika 58, 1971). With few groups a large variance explains a wrong x as well, and the maximum is not
informative: x and its covariance are averaged over the whole range of both and both shares, weighted by likelihood and
half-Cauchy priors of the usual scale (Gelman, Bayesian Analysis 1, 2006). Data far off their group and groups far off
the rest are downweighted or rejected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.errors import DegenerateGeometry
from cadcam.native.grouped import Tried, reweighted_fit

# Grid of standard deviations between groups, in units of the usual one, and quadrature weights of the half-Cauchy.
_RANGE, _OF_FAMILIES = (np.concatenate([[0.0], np.geomspace(0.05, 60.0, n)]) for n in (17, 9))
_PRIOR, _FAMILY_PRIOR = (np.log(np.gradient(r)) - np.log1p(r**2) for r in (_RANGE, _OF_FAMILIES))


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """The group of each datum (n,), ascending from 0 to G - 1 without gaps; and prior knowledge of the groups' offsets.

    relative (G,): relative variances of their offsets, default all 1. expected (G,): expected variance between them,
    default none. exact (G,): groups without an offset or scatter of their own, taken as exact; whole families are.
    family (G,): ascending indices of the groups' families, default each on its own; family_relative (F,): relative
    variances of the families' common offsets, default all 1.
    """

    of: Longs
    relative: Array | None = None
    expected: Array | None = None
    exact: Mask | None = None
    family: Longs | None = None
    family_relative: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GroupedFit:
    """The parameters x (k,), their covariance (k, k), and the estimated variances and weights of the data.

    excess: share by which variances within groups exceed the known ones; within, between: standard deviations beyond
    that, within groups and of the offset of a group of relative variance 1, of which alike is common to its family.
    weight (n,) in [0, 1]: of each datum by itself; of_group (G,) the same of each group; offset (G,) each group's mean
    residual, sd_offset (G,) its noise, off (G,) the standard deviation assumed for the offset itself. group (n,): of
    each datum, family (G,): of each group. gain (k, n): dx/dy, the response of x to shifts of the data. dof: degrees of
    freedom of the scatter between groups.
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
    dof: float


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

    usual: a usual standard deviation between groups. uneven: groups with an offset are also uneven: within is at least
    this share of between. Robust fits start from x = 0, near which half of the other data must lie. Raises
    `DegenerateGeometry` where the data do not determine a parameter.
    """
    if len(y) < J.shape[1]:
        raise DegenerateGeometry("too few edges were found to determine the pose")
    n = int(groups.of[-1]) + 1 if len(y) else 0
    scatter = np.ones(n) if groups.exact is None else np.asarray(1.0 - groups.exact, np.float64)
    tried, of_group = _tried(groups, scatter, usual), np.ones(n)
    found = reweighted_fit(
        y, J, variance, groups.of, of_group, scatter, tried, uneven=uneven, robust=robust, rounds=iterations
    )
    if found is None:
        raise DegenerateGeometry("the edges found do not determine the pose; restrict the motion or add photos")
    try:
        gain = np.linalg.inv(found.weighed.T @ J) @ found.weighed.T
    except np.linalg.LinAlgError:
        raise DegenerateGeometry("the edges that are believed do not determine the pose") from None
    within, between, alike = (math.sqrt(v) for v in (found.within2, found.own + found.alike, found.alike))
    sd, off = 1 / np.sqrt(np.maximum(found.total, 1e-300)), np.sqrt(found.off)
    about = (found.counts, found.of_group, found.mean, sd, off, groups.of, tried.family)
    common = found.alike / between**2 if between > 0 else 0.0
    exact = scatter[groups.of] == 0
    left = J.shape[1] - float(np.einsum("nk,kn->", J[exact], gain[:, exact]))  # that the exact data do not determine
    dof = _dof(found.of_group * scatter, tried.family, left, common)
    return GroupedFit(found.x, found.covariance, found.excess, within, between, alike, *about, gain, dof)


def _dof(of_group: Array, family: Longs, unknowns: float, common: float) -> float:
    """Return the degrees of freedom of the scatter between groups, at least 1, of which a share is common to families.

    For the sum of its two parts, after B. L. Welch (Biometrika 34, 1947). of_group (G,): weight of each, 0 if exact.
    """
    counts = np.maximum.reduceat(of_group, np.flatnonzero(np.diff(family, prepend=-1)))
    groups, families = (max(float(a.sum()) - unknowns, 1.0) for a in (of_group, counts))
    return 1 / ((1 - common) ** 2 / groups + common**2 / families)


def _tried(groups: Groups, scatter: Array, usual: float) -> Tried:
    """Return the grid of variances between groups: of all sizes, with the expected ones and without."""
    n = len(scatter)
    expected = np.zeros(n) if groups.expected is None else groups.expected * scatter
    shares = (0.0, 1.0) if expected.any() else (0.0,)
    family = first_of_family = np.arange(n)
    if groups.family is not None:
        begins = np.diff(groups.family, prepend=-1) > 0
        family, first_of_family = np.cumsum(begins) - 1, np.flatnonzero(begins)
    families = slice(1) if groups.family is None else slice(None)  # without: no variance between them
    return Tried(
        scatter if groups.relative is None else groups.relative * scatter,
        expected,
        (usual * np.tile(_RANGE, len(shares))) ** 2,
        np.repeat(shares, len(_RANGE)),
        np.tile(_PRIOR, len(shares)),
        family,
        scatter[first_of_family] * (1.0 if groups.family_relative is None else groups.family_relative),
        ((usual * _OF_FAMILIES) ** 2)[families],
        _FAMILY_PRIOR[families],
    )
