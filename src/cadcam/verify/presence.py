"""Is a feature there at all? Edges seen against edges that ought to be, weighed by what this very picture shows.

Every edge of a feature that should be visible is seen or not. Edges of parts that are there are seen with probability
`seen` (the rest lack contrast); where there is no edge, clutter supports one with probability `clutter`. Both are counted
in the picture itself: `seen` over the other features, `clutter` over decoys, the same lines shifted to where the model
has nothing. The log likelihood ratio L of "there" against "not there" is a sum over edges. By Wald's inequality
(Sequential Analysis, 1947) a feature that is there gives L <= -T with probability of at most exp(-T), and one that is
not gives L >= T as rarely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask
from cadcam.verify.association import best_shift, supported
from cadcam.verify.candidates import Candidates
from cadcam.verify.sightlines import Sightlines

Longs = npt.NDArray[np.int64]
LEAST_PLACES = 4  # of an edge that can say anything
_DECOY_SHARE = 0.65  # of the reach at which decoys stand
_CLEAR_PX = 3.5  # from its own place before a decoy counts
_DECOYS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Presence:
    """What a feature's edges say: how many should be visible, how many are seen, and L (natural logarithm)."""

    expected: int
    seen: int
    log_ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class EdgeCounts:
    """Edges (E,) that should be visible: the body each belongs to, and whether it was seen."""

    body: Longs
    seen: Mask

    def presence(self, body: int, *, clutter: float, elsewhere: float = 0.0) -> Presence:
        """Return the evidence for a body; elsewhere: logarithm of the number of places it was looked for in vain."""
        mine = self.body == body
        others = self.seen[~mine & np.isin(self.body, self._there())]
        seen = (others.sum() + 1.0) / (len(others) + 2.0)
        seen = float(np.clip(seen, clutter + 0.05, 0.99))
        n, k = int(mine.sum()), int(self.seen[mine].sum())
        ratio = k * np.log(seen / clutter) + (n - k) * np.log((1 - seen) / (1 - clutter))
        return Presence(n, k, float(ratio - (elsewhere if k else 0.0)))

    def _there(self) -> Longs:
        """Return the bodies of which something is seen: what is missing says nothing about contrast."""
        return np.unique(self.body[self.seen])


def counted(lines: Sightlines, body: Longs, support_of: Mask) -> EdgeCounts:
    """Return which edges of bodies (N,), -1 for none, have support in at least half of their places."""
    used = body >= 0
    edge = lines.edge[used]
    number, first, at = np.unique(edge, return_index=True, return_inverse=True)
    n = np.bincount(at.reshape(-1), minlength=len(number))
    share = np.bincount(at.reshape(-1), support_of[used], minlength=len(number)) / np.maximum(n, 1)
    long = n >= LEAST_PLACES
    return EdgeCounts(body[used][first][long], share[long] >= 0.5)


def clutter_of(lines: Sightlines, found: Candidates, body: Longs, *, reach_px: float) -> float:
    """Return how often an edge is seen where there is none: over decoys, each shifted about to where it fits best."""
    hits, tries = 1.0, 10.0  # a share of 0.1 is believed until counted otherwise
    radius = _DECOY_SHARE * reach_px
    angles = np.pi * (np.arange(_DECOYS) + 0.5) / _DECOYS * 2
    for number in np.unique(body[body >= 0]):
        for photo in np.unique(lines.photo[body == number]):
            rows = np.flatnonzero((body == number) & (lines.photo == photo))
            for a in angles:
                s = radius * np.array([np.cos(a), np.sin(a)])
                one, all_ = _decoy(lines, found, rows, s)
                hits, tries = hits + one, tries + all_
    return float(np.clip(hits / tries, 0.01, 0.6))


def _decoy(lines: Sightlines, found: Candidates, rows: Longs, s: Array) -> tuple[int, int]:
    """Return how many edges of a feature shifted by about s are seen, of how many."""
    normal, offset = lines.normal[rows], found.offset[rows]
    clear = np.abs(normal @ s) > _CLEAR_PX
    if not clear.any():
        return 0, 0
    rows, normal, offset = rows[clear], normal[clear], offset[clear] - (normal[clear] @ s)[:, None]
    about = best_shift(offset, normal, reach_px=1.5)
    edges = counted(lines.select(rows), np.zeros(len(rows), np.int64), supported(offset, normal, about))
    return int(edges.seen.sum()), len(edges.seen)
