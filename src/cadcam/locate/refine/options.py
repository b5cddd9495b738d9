"""How edges are looked for in a photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.errors import BadValue


@dataclass(frozen=True, slots=True)
class EdgeOptions:
    """How edges are looked for.

    search_px: how far from the start's lines the photo's may lie. step_px: length of the cell that a sample stands for.
    reach_px: how far to each side of a line its pixels are used; room_px: the least of that, nearer to another line a
    sample is left out. group_px: length of edge that is taken to err as one.
    """

    search_px: float = 8.0
    step_px: float = 4.0
    reach_px: float = 4.5
    room_px: float = 2.5
    group_px: float = 150.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise BadValue(name, value, "a positive number of px")


EDGES = EdgeOptions()
