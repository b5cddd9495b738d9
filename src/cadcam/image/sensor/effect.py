"""What every effect of a sensor is: a frozen value that turns one picture into another."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Protocol, SupportsFloat

import numpy as np

from cadcam.arrays import Picture
from cadcam.errors import BadValue
from cadcam.kinds import expect_number

_TOGETHER = 1 << 20  # numbers of a picture computed at a time


class Effect(Protocol):
    """One thing that happens to light, charge or signal; 0 is black and 1 the full scale throughout.

    Pictures are (H, W) or (H, W, 3) float32 and may leave [0, 1] between two effects: only a sensor clips.
    """

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture after the effect; chance comes from `rng` alone."""
        ...


def in_rows(picture: Picture) -> Iterator[slice]:
    """Yield the rows of a picture in blocks: what is computed in double precision is held of one block at a time."""
    step = max(1, _TOGETHER // max(picture[:1].size, 1))
    for top in range(0, len(picture), step):
        yield slice(top, min(top + step, len(picture)))


def in_columns(picture: Picture) -> Iterator[slice]:
    """Yield the columns of a picture in blocks, as `in_rows` does its rows."""
    step = max(1, _TOGETHER // max(picture[:, :1].size, 1))
    for left in range(0, picture.shape[1], step):
        yield slice(left, min(left + step, picture.shape[1]))


def check(what: str, value: float, low: float = -math.inf, high: float = math.inf, *, above: bool = False) -> None:
    """Raise `BadValue` unless low <= value <= high (low < value, if `above`) and the value is finite."""
    expect_number(value, what)
    if math.isfinite(value) and (low < value if above else low <= value) and value <= high:
        return
    bounds = [f"above {low:g}" if above else f"of at least {low:g}"] * math.isfinite(low)
    bounds += [f"at most {high:g}"] * math.isfinite(high)
    raise BadValue(what, value, f"a number {' and '.join(bounds)}" if bounds else "a finite number")


def check_pair(what: str, value: tuple[float, float]) -> None:
    """Raise `BadValue` unless the value is two finite numbers."""
    two = isinstance(value, (tuple, list)) and len(value) == 2 and all(isinstance(v, SupportsFloat) for v in value)
    if not two or not all(math.isfinite(v) for v in value):
        raise BadValue(what, value, "two finite numbers (x, y)")
