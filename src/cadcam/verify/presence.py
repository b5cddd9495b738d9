"""Is a feature there at all? Edges seen against edges that ought to be, weighed by what this very picture shows.

Every edge of a feature that should be visible is seen or not. Edges of parts that are there are seen with probability
`seen` (the rest lack contrast); where there is no edge, clutter supports one with probability `clutter`. Both are
counted in the picture itself: `seen` over the other features, `clutter` over decoys, the same lines shifted to where
the model has nothing. The log likelihood ratio L of "there" against "not there" is a sum over edges. By Wald's
inequality (Sequential Analysis, 1947) a feature that is there gives L <= -T with probability of at most exp(-T), and
one that is not gives L >= T as rarely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask
from cadcam.verify.association import best_shift, supported
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


def presence(
    lines: Sightlines, mine: Mask, usable: Mask, support: Mask, clutter: float, elsewhere: float = 0.0
) -> Presence:
    """Return the evidence for a feature with the places `mine` (N,) among those that are `usable` (N,).

    support (N,): which places have an edge of the photo. elsewhere: logarithm of the number of places where the feature
    was looked for, if it was found at another than its own.
    """
    own, others = edges_seen(lines, mine, support), edges_seen(lines, usable & ~mine, support)
    seen = float(np.clip((others.sum() + 1.0) / (len(others) + 2.0), clutter + 0.05, 0.99))
    n, k = len(own), int(own.sum())
    ratio = k * np.log(seen / clutter) + (n - k) * np.log((1 - seen) / (1 - clutter))
    return Presence(n, k, float(ratio - (elsewhere if k else 0.0)))


def edges_seen(lines: Sightlines, rows: Mask, support: Mask) -> Mask:
    """Return for each edge with enough of the places `rows` (N,) whether at least half of these have support."""
    at = np.unique(lines.edge[rows], return_inverse=True)[1].reshape(-1)
    n = np.bincount(at)
    share = np.bincount(at, support[rows]) / np.maximum(n, 1)
    return np.asarray(share[n >= LEAST_PLACES] >= 0.5)


def clutter_of(lines: Sightlines, found: Array, body: Longs, *, reach_px: float) -> float:
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


def _decoy(lines: Sightlines, found: Array, rows: Longs, s: Array) -> tuple[int, int]:
    """Return how many edges of a feature shifted by about s are seen, of how many."""
    normal, offset = lines.normal[rows], found[rows]
    clear = np.abs(normal @ s) > _CLEAR_PX
    if not clear.any():
        return 0, 0
    rows, normal, offset = rows[clear], normal[clear], offset[clear] - (normal[clear] @ s)[:, None]
    about = best_shift(offset, normal, reach_px=1.5)
    seen = edges_seen(lines.select(rows), np.ones(len(rows), bool), supported(offset, normal, about))
    return int(seen.sum()), len(seen)
