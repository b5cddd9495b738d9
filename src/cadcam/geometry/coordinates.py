"""The gate for points that a method takes: any leading axes, NaN and inf as they are."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Floats
from cadcam.errors import BadValue
from cadcam.kinds import said


def coordinates(values: Floats, what: str, n: int) -> Array:
    """Return an array (..., n) of float64, not copied where it is one; `BadValue` naming `what` for another shape."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadValue(what, said(values), f"numbers of shape (..., {n})") from None
    if array.shape[-1:] != (n,):
        raise BadValue(what, said(values), f"an array of shape (..., {n})")
    return array
