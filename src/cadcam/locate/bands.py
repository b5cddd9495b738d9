"""Narrow bands beside a part's lines that its model does not have: contact shadows, print, painted rims, gaps.

A band ends in a step of its own, some pixels beside the line's. A fit that knows of one step only is drawn towards it
by up to 0.3 px, the same all along the edge, and no covariance would tell. One cell hardly shows such a step in its
noise, a stretch of them does: what the fits leave over is averaged along it, by distance from the line, and the step
looked for there which explains most of it beyond what levels, slopes and known lines do. Of a step that explains
clearly more than noise and grain would, every cell is told: it is a twin like another line of the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.image.profile import StepSums, step_columns, step_rests
from cadcam.locate.edges import Projected
from cadcam.locate.sight import Cells, Sight

Longs = npt.NDArray[np.int64]
_BINS, _WIDTH = 24, 0.5  # px: by distance from the line
_MIDDLES = (np.arange(_BINS) + 0.5 - 0.5 * _BINS) * _WIDTH
_APART = np.arange(1.0, 5.01, 0.25)  # px: how far from the line a band's end is looked for
_TRIED = np.concatenate([-_APART, _APART])
_TOGETHER = 12  # cells of a stretch
_FEW = 3  # cells of the shortest
_INSIDE = 0.25  # px: so much farther cells reach at least
_CLEAR = 20.0  # variances of noise and grain that a band explains
_PAST = 2.0  # blurs: cells reach so far beyond a band's end
_HARDLY = 1e-3  # of a pixel's weight a cell: a step that hardly differs from what the fit knows


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """Means of what is left over in B stretches of cells.

    of (n,): each cell's stretch; rest, number (B, bins); variance (B,) of a pixel; known (B, bins, k): the columns of
    the fit; free (B, 2): how far below and above a band is looked for, 0 where a line of the model is known.
    """

    of: Longs
    rest: Array
    number: Array
    variance: Array
    known: Array
    free: Array


def banded(sight: Sight, at: Projected, cells: Cells, where: Array, sums: StepSums) -> tuple[Cells, StepSums]:
    """Return cells that know of the bands beside their lines, and their sums; both as given where there are none."""
    if not len(cells.which):
        return cells, sums
    stretches = _stretches(sight, at, cells, where, sums)
    side, apart = _found(stretches, cells.blur)
    if not np.isfinite(apart).any():
        return cells, sums
    twins, reach = cells.twins.copy(), np.stack([cells.below, cells.above], axis=1)
    for k in (0, 1):
        place = apart[stretches.of, k]
        told = np.isfinite(place)
        twins[told, k] = np.column_stack([place[told], np.zeros(told.sum())])
        past = np.minimum(np.abs(place) + _PAST * cells.blur, cells.room[:, k])
        reach[:, k] = np.where(told, np.maximum(reach[:, k], past), reach[:, k])
    cells = replace(cells, twins=twins, below=reach[:, 0], above=reach[:, 1])
    return cells.settled(sight, at, where)


def _stretches(sight: Sight, at: Projected, cells: Cells, where: Array, sums: StepSums) -> _Stretches:
    q, normal = cells.placed(at, where)
    rest, number, variance = step_rests(
        sight.photo.gray, q, normal, sums, below=cells.below, above=cells.above, half_length=cells.half_length,
        blur=cells.blur, twins=cells.twins, bins=_BINS, width=_WIDTH,
    )
    run = sight.samples.run[cells.which].astype(np.int64)
    count = np.bincount(run)
    place = np.arange(len(run)) - (np.cumsum(count) - count)[run]
    pieces = np.maximum(np.round(count / _TOGETHER), 1).astype(np.int64)[run]
    of = np.cumsum(np.diff(run * len(run) + place * pieces // count[run], prepend=-1) > 0) - 1
    first = np.flatnonzero(np.diff(of, prepend=-1))
    number_of, pixels = np.add.reduceat(number, first), number.sum(axis=1)
    mean = np.add.reduceat(rest, first) / np.maximum(number_of, 1)
    of_pixel = np.add.reduceat(variance * pixels, first) / np.maximum(np.add.reduceat(pixels, first), 1)
    twins = cells.twins[:, :, 0]
    there = np.isfinite(twins)
    known = np.add.reduceat(there, first, dtype=float)
    place_of = np.add.reduceat(np.where(there, twins, 0.0), first) / np.maximum(known, 1)
    reach = np.minimum.reduceat(np.stack([cells.below, cells.above], axis=1), first) - _INSIDE
    enough = np.bincount(of)[:, None] >= _FEW
    return _Stretches(
        of, mean, number_of, of_pixel, _known(place_of, known > 0, cells.blur), np.where((known > 0) | ~enough, 0.0, reach)
    )


def _known(places: Array, there: Array, blur: float) -> Array:
    """Return the columns (B, bins, 7) of fits with up to two twins at places (B, 2), where they are there."""
    own = np.broadcast_to(step_columns(_MIDDLES, blur), (len(places), _BINS, 5))
    twins = [_beyond(_MIDDLES - places[:, k, None], side, blur) * there[:, k, None] for k, side in ((0, -1), (1, 1))]
    return np.concatenate([own, np.stack(twins, axis=2)], axis=2)


def _beyond(d: Array, side: Array | int, blur: float) -> Array:
    from scipy.special import ndtr

    return np.asarray(ndtr(side * d / blur))


def _found(s: _Stretches, blur: float) -> tuple[Array, Array]:
    """Return where (B, 2) px below and above bands end, nan where there is none."""
    apart = np.full((len(s.rest), 2), np.nan)
    tried = _beyond(_MIDDLES - _TRIED[:, None], np.sign(_TRIED)[:, None], blur)
    allowed = np.abs(_TRIED) < s.free[:, np.where(_TRIED < 0, 0, 1)]
    gain, _ = _gains(s.rest, s.number, s.variance, s.known, tried, allowed)
    best = np.argmax(gain, axis=1)
    some = np.flatnonzero(gain[np.arange(len(best)), best] > _CLEAR)
    side = (_TRIED[best] > 0).astype(int)
    apart[some, side[some]] = [_peak(_TRIED, gain[k], best[k]) for k in some]
    return side, apart


def _gains(rest, number, variance, known, tried, allowed):
    A = np.einsum("bni,bn,bnj->bij", known, number, known)
    A += 1e-6 * np.eye(A.shape[1])
    cross = np.einsum("bni,bn,tn->bit", known, number, tried)
    factors = np.linalg.solve(A, cross)
    weight = np.einsum("bn,tn->bt", number, tried**2) - np.einsum("bit,bit->bt", cross, factors)
    right = np.einsum("bn,bn->bn", number, rest)
    seen = right @ tried.T - np.einsum("bit,bi->bt", factors, np.einsum("bni,bn->bi", known, right))
    fair = allowed & (weight > _HARDLY * number.sum(axis=1, keepdims=True))
    beta = seen / np.maximum(weight, 1e-9)
    return np.where(fair, seen * beta / np.maximum(variance, 1e-12)[:, None], 0.0), beta


def _peak(x: Array, y: Array, best: int) -> float:
    if not 0 < best < len(x) - 1 or min(y[best - 1], y[best + 1]) <= 0:
        return float(x[best])
    rise = 0.5 * (y[best + 1] - y[best - 1]) / (2 * y[best] - y[best - 1] - y[best + 1])
    return float(x[best] + rise * (x[best + 1] - x[best]))
