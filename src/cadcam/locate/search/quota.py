"""How many poses a search keeps from stage to stage, and how many of them at one place in the photo.

A part that shows well is fitted by hundreds of poses that are nearly right. If it is there once, these may have all the
room that there is. If it is there several times, they would crowd out other instances: places share the room.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cadcam.arrays import Array, Longs


class Quota(NamedTuple):
    """times: how many times as many poses are kept as for one part; share: of these, the most at one place."""

    times: int
    share: float

    def of(self, usual: int) -> int:
        """Return how many poses are kept, where usually so many are."""
        return self.times * usual

    @property
    def shared(self) -> bool:
        """Return whether places share the room."""
        return self.share < 1

    def best(self, score: Array, place: Longs, usual: int) -> Longs:
        """Return which of N poses with scores (N,) at places with numbers (N,) are kept, best first."""
        order = np.argsort(-score, kind="stable")
        if self.shared:
            by_place = np.argsort(place[order], kind="stable")
            there = place[order][by_place]
            rank = np.zeros(len(order), np.int64)  # of each pose among those at its place
            rank[by_place] = np.arange(len(order)) - np.searchsorted(there, there)
            order = order[rank < self.share * self.of(usual)]
        return order[: self.of(usual)]


ONCE = Quota(1, 1.0)
MANY = Quota(3, 0.04)


def places_of(middle: Array, step: float) -> Longs:
    """Return numbers (N,), the same where points (N, 3) in a camera are seen in one cell, `step` (rad) wide."""
    cells = np.floor(middle[:, :2] / middle[:, 2:] / step)
    return np.unique(cells, axis=0, return_inverse=True)[1].ravel()
