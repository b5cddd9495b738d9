"""How edges are searched for in a photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.errors import BadValue
from cadcam.kinds import expect_numbers


@dataclass(frozen=True, slots=True)
class EdgeOptions:
    """How edges are searched for.

    search_px: how far the photo's edges may lie from the start's lines. step_px: distance between samples, and length
    of the cell in which each is measured. reach_px: how far to each side of a line pixels are used; room_px: the least
    of that: samples with less room beside another line are left out. group_px: length of edge whose samples share an
    error.
    """

    search_px: float = 8.0
    step_px: float = 4.0
    reach_px: float = 4.5
    room_px: float = 2.5
    group_px: float = 150.0

    def __post_init__(self) -> None:
        expect_numbers(self)
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise BadValue(name, value, "a positive number of px")


EDGES = EdgeOptions()
