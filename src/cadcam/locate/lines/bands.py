"""Narrow bands beside a part's lines that its model lacks: contact shadows, print, painted rims, gaps.

A band ends in a step of its own, some pixels beside the line's. A fit of a single step is biased towards it by up to
0.5 px, equally all along the edge, and no covariance shows that. In one cell such a step is hardly visible in the
noise, but in a stretch of cells it is: the residuals of the fits are averaged along it, by distance from the line, and
searched for the step that explains most of them beyond levels, slopes and known lines (a score test). A step that
explains clearly more than noise and texture would is then modelled in every cell as a twin, like another line of the
model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Longs
from cadcam.image.profile import StepSums, parabola, step_rests, step_sums
from cadcam.locate.lines.cells import Cells
from cadcam.locate.lines.edges import Projected
from cadcam.locate.lines.sight import Sight
from cadcam.native.profiles import StepCells, band_gains

_BINS, _WIDTH = 28, 0.5  # number and width, px, of bins of the distance from the line
_FAR = 5.5  # px to each side; with less, steps 1.5 and 3.5 px away can look the same
FARTHEST_PX = 5.0  # largest width of bands
_APART = np.arange(1.0, FARTHEST_PX + 0.01, 0.25)  # px, distances from the line at which a band's end is tested
_TRIED = np.concatenate([-_APART[::-1], _APART])
_COARSE = _TRIED[::2]  # tested first
_TOGETHER = 16  # cells per stretch
_FEW = 3  # fewest cells of a stretch
_ENOUGH = 500  # cells per photo from which only every second stretch is tested, from twice as many every third
_INSIDE = 0.25  # px by which cells must reach farther at least
_CLEAR = 20.0  # variances of noise and texture that a band must explain
_MAYBE = 0.5  # share of that at which places half a pixel apart are tested
_PAST = 2.0  # blurs that cells reach beyond a band's end
_SHORT = 1.5  # blurs between a cell's end and a step that it does not model
_BLURS = np.array([0.6, 0.72, 0.86, 1.0, 1.2])  # by the blur: tried where bands may have been mistaken for it
_BESIDE = 0.3  # share of cells beside bands from which these may have been mistaken for blur
_FEW_BANDS = 0.05  # share of cells beside bands, in half the stretches, below which the other half is not tested
_SAME = 0.02  # tolerance of a blur
LEFT, MOST_PX = 0.2, 0.5  # remaining share of the bias that a band caused; its limit, px


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """The residuals of B stretches of cells.

    of (n,): each cell's stretch, -1 for none; rest, number (B, bins): sums of residuals and numbers of pixels; variance
    (B,) of a pixel; known (B, 2): steps of the model below and above, nan for none; room (B, 2): search range for bands
    below and above.
    """

    of: Longs
    rest: Array
    number: Array
    variance: Array
    known: Array
    room: Array

    def clear(self, some: Longs, known: Array, room: Array, blur: float) -> tuple[Longs, Array]:
        """Return which of some stretches clearly show a step, and where; known (n, 3): steps known there."""
        maybe = np.flatnonzero(self._gains(some, known, room, blur, _COARSE).max(axis=1, initial=0.0) > _MAYBE * _CLEAR)
        gain = self._gains(some[maybe], known[maybe], room[maybe], blur, _TRIED)
        best = np.argmax(gain, axis=1)
        clear = np.flatnonzero(gain[np.arange(len(best)), best] > _CLEAR)
        return maybe[clear], np.array([_peak(gain[k], int(best[k])) for k in clear])

    def _gains(self, some: Longs, known: Array, room: Array, blur: float, tried: Array) -> Array:
        """Return what steps at the places tried explain (n, t) in some stretches."""
        left = self.rest[some], self.number[some], self.variance[some]
        return band_gains(*left, known, room, tried, width=_WIDTH, blur=blur)


def share_beside_bands(sight: Sight, at: Projected, cells: Cells, where: Array) -> float:
    """Return the share of a photo's cells that lies beside bands; where (N,) px along the normals: places of the steps.

    If half of the stretches show none, or hardly any, the others are not tested.
    """
    if not len(cells.which):
        return 0.0
    for every in (2, 1):
        stretches = _stretches(sight, at, cells, where, every=every)
        beside = _any(_found(stretches, cells.blur)[0])[stretches.of]
        share = float(beside[stretches.of >= 0].mean())
        if share < _FEW_BANDS:
            break
    return share


def banded(
    sight: Sight, at: Projected, cells: Cells, where: Array, anew: Mapping[str, float] | None = None
) -> tuple[Cells, Cells, StepSums]:
    """Return cells of the photo's true blur, the same cells with bands modelled, and the sums of the latter.

    where (N,) px along the normals: places of the steps. anew: arguments with which cells are laid out again where
    bands may have been mistaken for blur.
    """
    if not len(cells.which):
        return cells, cells, cells.sums_at(sight, at, where)
    stretches = _stretches(sight, at, cells, where)
    apart, end = _found(stretches, cells.blur)
    plain = cells.sums_at(sight, at, where)
    if not np.isfinite(apart).any():
        return cells, cells, plain
    told, sums = _told(cells, stretches.of, apart, end).settled(sight, at, where)
    if anew is not None and _any(apart)[stretches.of].mean() > _BESIDE:
        blur = _blur(sight, at, cells, where, anew)
        if abs(blur / cells.blur - 1) > _SAME:
            spread = (blur / cells.blur) ** 2 * cells.spread
            return banded(sight, at, Cells.of(sight, at, where=where, spread=spread, **anew), where)
    drawn = _drawn(plain, sums, stretches.of)
    return cells, replace(told, doubt=LEFT * np.where(_any(apart)[stretches.of], drawn, 0.0)), sums


def _blur(sight: Sight, at: Projected, cells: Cells, where: Array, anew: Mapping[str, float]) -> float:
    """Return the blur at which steps fit best with bands modelled."""
    tried, misfit = cells.blur * _BLURS, []
    for blur in tried:
        spread = (blur / cells.blur) ** 2 * cells.spread
        _, told, sums = banded(sight, at, Cells.of(sight, at, where=where, spread=spread, **anew), where)
        noise = sums.solved(told.held).noise
        misfit.append(float(np.mean(np.log(noise[np.isfinite(noise)]))))
    best = int(np.argmin(misfit))
    return float(np.exp(parabola(np.log(tried), np.array(misfit), best)))


def _any(apart: Array) -> npt.NDArray[np.bool_]:
    return np.append(np.isfinite(apart).any(axis=1), False)  # the last entry: cells of no stretch


def _told(cells: Cells, of: Longs, apart: Array, end: Array) -> Cells:
    """Return cells that model steps `apart` (B, 2) px below and above, nan for none, and end before `end`."""
    apart, end = np.vstack([apart, [np.nan, np.nan]])[of], np.vstack([end, [np.inf, np.inf]])[of]
    twins, reach = cells.twins.copy(), np.stack([cells.below, cells.above], axis=1)
    there = np.isfinite(apart)
    twins[there] = np.column_stack([apart[there], np.zeros(there.sum())])
    past = np.minimum(np.abs(apart) + _PAST * cells.blur, cells.room)
    reach = np.minimum(np.where(there, np.fmax(reach, past), reach), end)
    return replace(cells, twins=twins, below=reach[:, 0], above=reach[:, 1])


def _drawn(without: StepSums, told: StepSums, of: Longs) -> Array:
    """Return by how much (n,) px the bands shifted the steps of each cell's stretch."""
    place = []
    for sums in (without, told):
        found = sums.solved(np.zeros((len(of), 2)))
        seen = np.isfinite(found.moment) & np.isfinite(found.contrast)
        moment, contrast = (np.bincount(of + 1, np.where(seen, v, 0.0)) for v in (found.moment, found.contrast))
        with np.errstate(all="ignore"):
            place.append(-moment / contrast)
    with np.errstate(all="ignore"):
        return np.asarray(np.fmin(np.abs(place[0] - place[1]), MOST_PX)[of + 1])


def _stretches(sight: Sight, at: Projected, cells: Cells, where: Array, *, every: int = 1) -> _Stretches:
    """Return the residuals of the step fits along stretches of a photo's lines, or along every `every`-th of them."""
    run = sight.samples.run[cells.which].astype(np.int64)
    count = np.bincount(run)
    place = np.arange(len(run)) - (np.cumsum(count) - count)[run]
    pieces = np.maximum(np.round(count / _TOGETHER), 1).astype(np.int64)[run]
    of = np.cumsum(np.diff(run * len(run) + place * pieces // count[run], prepend=-1) > 0) - 1
    some = np.arange(0, len(run), 1 + len(run) // _ENOUGH)
    some = some[of[some] % every == 0]
    placed, twins = cells.placed(at, where), cells.twins[some]
    below, above = np.minimum(cells.room[some], _FAR).T
    far = StepCells(placed.q[some], placed.normal[some], below, above, cells.half_length, cells.blur, twins)
    sums = step_sums(sight.photo.gray, far)
    rest, number, variance = step_rests(sight.photo.gray, far, sums, bins=_BINS, width=_WIDTH)
    first = np.flatnonzero(np.diff(of[some], prepend=-1))
    index = np.full(int(of[-1]) + 1, -1)
    index[of[some][first]] = np.arange(len(first))
    size = np.diff(first, append=len(below))
    there = np.isfinite(twins[:, :, 0])
    known = np.add.reduceat(there, first, dtype=float)
    places = np.add.reduceat(np.where(there, twins[:, :, 0], 0.0), first) / np.where(known > 0, known, np.nan)
    reach = np.minimum.reduceat(np.stack([below, above], axis=1), first) - _INSIDE
    room = np.where((known > 0) | (np.bincount(of)[of[some][first]] < _FEW)[:, None], 0.0, reach)
    mean = np.add.reduceat(variance, first) / size
    return _Stretches(index[of], np.add.reduceat(rest, first), np.add.reduceat(number, first), mean, places, room)


def _found(s: _Stretches, blur: float) -> tuple[Array, Array]:
    """Return where (B, 2) px below and above bands end, nan where there is none, and where cells have to end.

    A second step is searched for beside the first: on the other side it ends another band; on the same side cells end
    before the farther one.
    """
    n = len(s.rest)
    apart, end = np.full((n, 2), np.nan), np.full((n, 2), np.inf)
    known = np.column_stack([s.known, np.full(n, np.nan)])
    some, first = s.clear(np.arange(n), known, s.room, blur)
    if not len(some):
        return apart, end
    apart[some, (first > 0).astype(int)] = first
    known[some, 2] = first
    again, second = s.clear(some, known[some], s.room[some], blur)
    for k, place in zip(some[again], second, strict=True):
        side = int(place > 0)
        other = apart[k, side]
        if np.isnan(other):
            apart[k, side] = place
        else:
            near, far = sorted((other, place), key=abs)
            apart[k, side], end[k, side] = near, abs(far) - _SHORT * blur
    return apart, end


def _peak(gain: Array, best: int) -> float:
    """Return the position of the maximum of the parabola through the largest gain and its two neighbours."""
    at, around = _TRIED[best], gain[max(best - 1, 0) : best + 2]
    if len(around) < 3 or not around.min() > 0 or _TRIED[best - 1] * _TRIED[best + 1] < 0:
        return float(at)
    before, here, after = around
    return float(at + 0.5 * (after - before) / (2 * here - before - after) * (_TRIED[best + 1] - at))
