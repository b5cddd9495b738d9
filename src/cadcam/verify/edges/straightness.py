"""Do the places at which an edge is seen lie on one line? An edge's do; those that texture has near it lie anywhere."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.verify.edges.shifts import CAPTURE_PX

_ON_LINE_PX = CAPTURE_PX / np.sqrt(12.0)  # half the scatter of places that lie anywhere within what is captured
_LEAST_TOLD = 4  # places whose scatter about a line tells something
_ROUGHER, _AS_STRAIGHT = 0.5, 0.1  # probability that a body is rougher than others; that its trace is as straight as it


def scatter_of(offset: Array, along: Array, piece: Longs) -> Array:
    """Return how the offsets (n,) px of each piece of edge (P,) scatter about a straight line, a standard deviation.

    along (n,) px: where on the edge they are; piece (n,): on which piece, 0 ... . nan where fewer than `_LEAST_TOLD`
    offsets are known (not nan).
    """
    have = np.isfinite(offset)
    y, t, at = offset[have], along[have], piece[have]
    size = int(piece.max(initial=-1)) + 1
    n = np.bincount(at, minlength=size)
    y, t = (x - (np.bincount(at, x, size) / np.maximum(n, 1))[at] for x in (y, t))
    run = np.bincount(at, t * t, size)
    slope = np.bincount(at, t * y, size) / np.where(run > 0, run, 1.0)
    square = np.bincount(at, (y - slope[at] * t) ** 2, size)
    return np.where(n >= _LEAST_TOLD, np.sqrt(square / np.maximum(n - 2, 1)), np.nan)


def on_one_line(scatter: Array) -> Mask:
    """Return which edges (n,) have their places on one line, by their scatter (px)."""
    return np.asarray(scatter < _ON_LINE_PX)


def straightness_ratio(mine: Array, others: Array, clutter: float) -> float:
    """Return what the straightness of a body's edges adds to L, the log likelihood ratio of "present" to "absent".

    mine (n,) px: how the places of its edges scatter about their lines, nan where that is not known; others (m,): the
    same of the edges of other bodies; clutter: of what is seen where nothing is, the share that lies on one line. This
    never decides alone: a body may be rougher than others, or less sharp; and where it is absent, a straight trace or
    shadow of it may be left.
    """
    mine, others = mine[np.isfinite(mine)], others[np.isfinite(others)]
    own = (on_one_line(others).sum() + 1.0) / (len(others) + 2.0)
    straight = on_one_line(mine)
    told = straight.sum() * np.log(own / clutter) + (~straight).sum() * np.log((1 - own) / (1 - clutter))
    there = np.logaddexp(np.log1p(-_ROUGHER) + told, np.log(_ROUGHER))
    return float(there - np.logaddexp(np.log1p(-_AS_STRAIGHT), np.log(_AS_STRAIGHT) + told))
