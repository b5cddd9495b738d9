"""Where a feature is according to the photo's edges near its lines: the best supported shift, and a rim's growth.

Each place has a few candidates, offsets along its normal. Candidates agree with a rigid shift s if they equal n . s,
and with a rim that is larger all round if they are to each other as the rim's widening has them.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.verify.edges.sightlines import pieces

CAPTURE_PX = 1.5  # how far a candidate may be from the shifted model and still support the shift
NEAR_PX = 1.5  # shifts up to this count as the nominal place
# Amid four nodes a shift still has 7/8 of its support or more at the nearest: 1 - (step / sqrt(2) / capture)^2.
_GRID_PX = CAPTURE_PX / 2
_GAIN_SAMPLES, _GAIN_SHARE = 3.0, 0.10  # least gain in support over the nominal place: places, share
_GUESSES, _GUESSES_APART_PX = 6, 2.0  # most guesses of a body's place, and their least distance
_GUESS_SHARE = 0.5  # least support of the other guesses relative to the best
# Share of a rim's places that each px of growth and shift has to gain: a hole's other rim beside its own one, of which
# each gives half of the candidates, is otherwise as good as one that is larger, and displaced.
_PER_PX = 0.02
_WAYS = 3  # pieces of a rim, facing different ways, that distinguish its size from a shift


def best_shift(
    offset: Array, normal: Array, *, reach_px: float, free: Array | None = None, worth: Array | None = None
) -> Array:
    """Return the shift (2,) px that most of the candidates `offset` (n, K) support, to the grid's step.

    free (n, K): those that may be evidence of a shift away from the nominal place, by default all. worth (n,): how much
    each place counts, by default 1.
    """
    worth = np.ones(len(offset)) if worth is None else worth
    grid = _grid(reach_px)
    near = np.hypot(*grid.T) <= NEAR_PX
    score = np.zeros(len(grid))
    score[near] = support(offset, normal, grid[near], worth)
    if not near.all():
        score[~near] = support(offset if free is None else free, normal, grid[~near], worth)
    best = int(np.argmax(score - 1e-6 * np.hypot(*grid.T)))
    gain = score[best] - score[near].max()
    if gain <= max(_GAIN_SAMPLES, _GAIN_SHARE * float(worth.sum())):
        best = int(np.flatnonzero(near)[np.argmax(score[near] - 1e-6 * np.hypot(*grid[near].T))])
    return np.asarray(grid[best])


def guessed_shifts(offset: Array, normal: Array, *, reach_px: float) -> Array:
    """Return shifts (k, 2) px that many of the candidates `offset` (n, K) support, best first, clearly separated."""
    grid = _grid(reach_px)
    score = support(offset, normal, grid) - 1e-6 * np.hypot(*grid.T)
    out: list[Array] = []
    least = _GUESS_SHARE * score.max()
    while len(out) < _GUESSES and score.max() >= least:
        out.append(grid[int(np.argmax(score))])
        score[np.hypot(*(grid - out[-1]).T) < _GUESSES_APART_PX] = -np.inf
    return np.array(out).reshape(-1, 2)


def all_round(edge: Longs, normal: Array) -> Longs:
    """Return the edges (N,) with normals (N, 2) that face so many ways that size is distinguishable from a shift."""
    _, first = np.unique(pieces(edge, normal), return_index=True)
    edges, ways = np.unique(edge[first], return_counts=True)
    return np.asarray(edges[ways >= _WAYS])


def grown(
    offset: Array, free: Array, normal: Array, widening: Array, shift: Array, *, reach_px: float
) -> tuple[float, Array]:
    """Return by how many px a rim is larger than drawn, and the shift (2,) px then; 0 and its body's if it is not.

    offset, free (n, K): its candidates, and those that no other line of the model explains; normal (n, 2): out of the
    rim; widening (n,): how far they move along it for each px by which the rim is larger on the average; shift
    (2,) px: of its body, which a larger rim may have led astray: the nominal place is tried as well. Of growths and
    shifts with nearly the same support the least is taken. The gain over the nominal size must be as large as for a
    shift, and all round: in most of each of its pieces, where no other line, such as a hole's other rim, is drawn in
    its place.
    """
    piece = pieces(np.zeros(len(normal), np.int64), normal)
    near = np.unique(np.concatenate([shift + _grid(NEAR_PX), _grid(NEAR_PX)]), axis=0)
    nominal = float(support(offset, normal, near).max())
    sizes = np.arange(-int(reach_px / _GRID_PX), int(reach_px / _GRID_PX) + 1) * _GRID_PX
    scores = np.array([support(free - g * widening[:, None], normal, near) for g in sizes])
    unlike = _PER_PX * len(offset) * (np.abs(sizes)[:, None] + np.hypot(*near.T))
    size, place = np.unravel_index(np.argmax(scores - unlike), scores.shape)
    if scores[size, place] - nominal <= max(_GAIN_SAMPLES, _GAIN_SHARE * len(offset)):
        return 0.0, shift
    by_size = sizes[size] * widening[:, None]
    there, anyhow = (supported(found - by_size, normal, near[place]) for found in (free, offset))
    seen, asked = np.bincount(piece, there), np.bincount(piece, there | ~anyhow)
    if not ((seen > 0) & (2 * seen >= asked)).all():
        return 0.0, shift
    return float(sizes[size]), near[place]


def supported(offset: Array, normal: Array, shift: Array) -> Mask:
    """Return which places (n,) have a candidate (n, K) within `CAPTURE_PX` of a shift (2,)."""
    off = np.abs(np.where(np.isfinite(offset), offset, np.inf) - (normal @ shift)[:, None])
    return np.asarray((off <= CAPTURE_PX).any(axis=1))


def support(offset: Array, normal: Array, shifts: Array, worth: Array | None = None) -> Array:
    """Return how many places (n,) have a candidate (n, K) near each shift (m, 2), weighted by closeness.

    worth (n,): by how much each place counts, by default 1.
    """
    used = np.isfinite(offset).any(axis=1)
    o = np.where(np.isfinite(offset[used]), offset[used], 1e6)
    expected = shifts @ normal[used].T  # (m, n)
    off = np.full(expected.shape, np.inf)
    for k in range(o.shape[1]):
        if (o[:, k] < 1e6).any():
            np.minimum(off, np.abs(o[:, k] - expected), out=off)
    closeness = np.maximum(1 - (off / CAPTURE_PX) ** 2, 0)
    return np.asarray(closeness.sum(axis=1) if worth is None else closeness @ worth[used])


def _grid(reach: float) -> Array:
    steps = np.arange(-int(reach / _GRID_PX), int(reach / _GRID_PX) + 1) * _GRID_PX
    x, y = np.meshgrid(steps, steps)
    grid = np.stack([x.ravel(), y.ravel()], axis=1)
    return np.asarray(grid[np.hypot(*grid.T) <= reach])
