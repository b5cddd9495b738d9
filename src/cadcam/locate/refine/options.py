"""How edges are searched for in a photo."""

from __future__ import annotations

from dataclasses import dataclass

from cadcam.kinds import expect_positive


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
        for name in self.__slots__:
            expect_positive(getattr(self, name), name, "a positive number of px")


EDGES = EdgeOptions()
