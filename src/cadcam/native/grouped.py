"""The C core's part that solves regressions with errors by group (grouped.h), as a function of arrays."""

from __future__ import annotations

import ctypes as c
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.errors import BadValue
from cadcam.native.core import library

UNKNOWNS = 16  # CC_UNKNOWNS
Longs = npt.NDArray[np.int64]


class _Grouped(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("y", "J", "w", "group", "of_group", "free", "expected")),
        *((name, c.c_void_p) for name in ("variance", "share", "prior")),
        *((name, c.c_int64) for name in ("n", "groups")),
        *((name, c.c_int32) for name in ("k", "tried")),
    )


@cache
def _core() -> c.CDLL:
    core = library()
    core.cc_grouped_fit.argtypes = [c.POINTER(_Grouped), *[c.c_void_p] * 4]
    core.cc_grouped_fit.restype = c.c_int32
    return core


def averaged_fit(
    y: Array,
    J: Array,
    w: Array,
    group: Longs,
    *,
    of_group: Array,
    free: Array,
    expected: Array,
    variance: Array,
    share: Array,
    prior: Array,
) -> tuple[Array, Array, Array] | None:
    """Return x (k,), its covariance (k, k) and how likely each of the variances tried is (T,); None: x is left open.

    Data y (n,), J (n, k) with weights w (n,) and ascending group numbers (n,). Groups count of_group (G,) times; the
    variance between them is variance (T,) free (G,) + share (T,) expected (G,), with log likelihoods `prior` (T,).
    """
    groups, tried, k = len(of_group), len(prior), J.shape[1]
    if k > UNKNOWNS:
        raise BadValue("parameters of a regression with groups", k, f"at most {UNKNOWNS}")
    doubles = [np.ascontiguousarray(a, np.float64) for a in (y, J, w, of_group, free, expected, variance, share, prior)]
    number = np.ascontiguousarray(group, np.int64)
    at = [a.ctypes.data for a in doubles]
    data = _Grouped(*at[:3], number.ctypes.data, *at[3:], len(y), groups, k, tried)
    scratch = np.zeros(groups * ((k + 1) * (k + 4) // 2 + 1) + tried * k * (k + 1))
    out = np.zeros(k), np.zeros((k, k)), np.zeros(tried)
    found = _core().cc_grouped_fit(c.byref(data), scratch.ctypes.data, *(a.ctypes.data for a in out))
    return out if found else None
