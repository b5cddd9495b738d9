"""The C core's part that solves regressions with errors by group (grouped.h), as a function of arrays."""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass
from functools import cache

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.errors import BadValue
from cadcam.native.core import addresses, doubles, functions

UNKNOWNS = 64  # CC_UNKNOWNS


class _Grouped(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("y", "J", "w", "group", "family", "of_group", "free", "expected")),
        *((name, c.c_void_p) for name in ("variance", "share", "prior")),
        *((name, c.c_void_p) for name in ("family_free", "family_variance", "family_prior")),
        *((name, c.c_int64) for name in ("n", "groups", "families")),
        *((name, c.c_int32) for name in ("k", "tried", "family_tried")),
    )


class _Reweighted(c.Structure):
    _fields_ = (
        ("of", _Grouped),
        *((name, c.c_void_p) for name in ("known", "scatter")),
        ("uneven", c.c_double),
        *((name, c.c_int32) for name in ("robust", "rounds")),
    )


class _Found(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("x", "covariance", "counts", "of_group", "mean", "total", "off", "weighed")),
        *((name, c.c_double) for name in ("excess", "within2", "own", "share", "alike")),
    )


@cache
def _core() -> c.CDLL:
    arguments = [c.POINTER(_Reweighted), c.c_void_p, c.POINTER(_Found)]
    return functions("the fit of poses", {"cc_reweighted_fit": (c.c_int32, arguments)})


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """What variances between groups, and between families of groups, are tried, with their log likelihoods `prior`.

    Of groups it is variance (T,) free (G,) + share (T,) expected (G,); of the families (F,), each with each of the
    former, family_variance (U,) family_free (F,). family (G,): of each group, ascending.
    """

    free: Array
    expected: Array
    variance: Array
    share: Array
    prior: Array
    family: Longs
    family_free: Array
    family_variance: Array
    family_prior: Array


@dataclass(frozen=True, slots=True, eq=False)
class Reweighted:
    """x (k,), its covariance (k, k), and what the last round says of the data.

    counts (n,), of_group (G,): how far data and groups count, 0 to 1. mean, total, off (G,): what is left of each
    group, the weight behind it and the variance that it is taken to have. weighed (n, k): W with x = (W' J)^-1 W' y.
    excess, within2: variance of data beyond the known one. own, share, alike: means, by how likely each is, of the
    variance between groups, of the share of what is expected and of the variance between families.
    """

    x: Array
    covariance: Array
    counts: Array
    of_group: Array
    mean: Array
    total: Array
    off: Array
    weighed: Array
    excess: float
    within2: float
    own: float
    share: float
    alike: float


def reweighted_fit(
    y: Array,
    J: Array,
    variance: Array,
    group: Longs,
    of_group: Array,
    scatter: Array,
    tried: Tried,
    *,
    uneven: float,
    robust: bool,
    rounds: int,
) -> Reweighted | None:
    """Return the fit of y (n,) by J (n, k), with weights found in so many rounds, at least 1; None: x is left open.

    variance (n,): what is known of it; group (n,): ascending numbers. of_group (G,): how far groups count, as long as
    the fit is not robust. scatter (G,): 1, or 0 where data neither scatter within their group nor are doubted. uneven:
    share of what groups are off by that is taken to be within them.
    """
    n, k = J.shape
    if k > UNKNOWNS:
        raise BadValue("parameters of a regression with groups", k, f"at most {UNKNOWNS}")
    groups, families, several = len(of_group), len(tried.family_free), (len(tried.prior), len(tried.family_prior))
    y, J, variance, scatter = doubles(y, J, variance, scatter)
    number = [np.ascontiguousarray(a, np.int64) for a in (group, tried.family)]
    of_groups = doubles(of_group, tried.free, tried.expected, tried.variance, tried.share, tried.prior)
    of_families = doubles(tried.family_free, tried.family_variance, tried.family_prior)
    data = addresses(y, J), addresses(*number, *of_groups, *of_families)
    asked = _Grouped(*data[0], None, *data[1], n, groups, families, k, *several)
    own, each = (k + 1) * (k + 4) // 2 + 1, (k + 1) * (k + 2) // 2 + k + 1
    scratch = np.zeros((groups + families) * own + several[0] * several[1] * each + 4 * n + groups + k)
    of_each = np.zeros(groups), np.zeros(groups), np.zeros(groups), np.zeros(groups)
    out = np.zeros(k), np.zeros((k, k)), np.zeros(n), *of_each, np.zeros((n, k))
    found = _Found(*addresses(*out))
    told = _Reweighted(asked, *addresses(variance, scatter), uneven, robust, rounds)
    if not _core().cc_reweighted_fit(c.byref(told), scratch.ctypes.data, c.byref(found)):
        return None
    return Reweighted(*out, found.excess, found.within2, found.own, found.share, found.alike)
