"""The C core's part that solves regressions with errors by group (grouped.h), as a function of arrays."""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass
from functools import cache

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.errors import BadValue
from cadcam.native.core import addresses, doubles, functions

UNKNOWNS = 16  # CC_UNKNOWNS


class _Grouped(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("y", "J", "w", "group", "family", "of_group", "free", "expected")),
        *((name, c.c_void_p) for name in ("variance", "share", "prior")),
        *((name, c.c_void_p) for name in ("family_free", "family_variance", "family_prior")),
        *((name, c.c_int64) for name in ("n", "groups", "families")),
        *((name, c.c_int32) for name in ("k", "tried", "family_tried")),
    )


@cache
def _core() -> c.CDLL:
    return functions("the fit of poses", {"cc_grouped_fit": (c.c_int32, [c.POINTER(_Grouped), *[c.c_void_p] * 4])})


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


def averaged_fit(
    y: Array, J: Array, w: Array, group: Longs, of_group: Array, tried: Tried
) -> tuple[Array, Array, Array] | None:
    """Return x (k,), its covariance (k, k) and how likely each of the variances tried is (T, U); None: x is left open.

    Data y (n,), J (n, k) with weights w (n,) and ascending group numbers (n,). Groups count of_group (G,) times.
    """
    k, several, families = J.shape[1], (len(tried.prior), len(tried.family_prior)), len(tried.family_free)
    if k > UNKNOWNS:
        raise BadValue("parameters of a regression with groups", k, f"at most {UNKNOWNS}")
    data = doubles(y, J, w)
    number = [np.ascontiguousarray(a, np.int64) for a in (group, tried.family)]
    of_groups = doubles(of_group, tried.free, tried.expected, tried.variance, tried.share, tried.prior)
    of_families = doubles(tried.family_free, tried.family_variance, tried.family_prior)
    asked = _Grouped(*addresses(*data, *number, *of_groups, *of_families), len(y), len(of_group), families, k, *several)
    own, each = (k + 1) * (k + 4) // 2 + 1, (k + 1) * (k + 2) // 2 + k
    scratch = np.zeros((len(of_group) + families) * own + several[0] * several[1] * each)
    out = np.zeros(k), np.zeros((k, k)), np.zeros(several)
    found = _core().cc_grouped_fit(c.byref(asked), *addresses(scratch, *out))
    return out if found else None
