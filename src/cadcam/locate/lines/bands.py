"""Narrow bands beside a part's lines that its model lacks: contact shadows, print, painted rims, gaps.

A band ends in a step of its own, some pixels beside the line's. A fit of a single step is biased towards it by up to
0.5 px, equally all along the edge, and no covariance shows that. In one cell such a step is hardly visible in the
noise, but in a stretch of cells it is: the residuals of the fits are averaged along it, by distance from the line, and
searched for the step that explains most of them beyond levels, slopes and known lines (a score test). A step that
explains clearly more than noise and texture would is then modelled in every cell as a twin, like another line of the
model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.image.profile import StepSums, parabola, step_rests, step_sums
from cadcam.locate.lines.cells import Cells
from cadcam.locate.lines.edges import Projected, numbered, pieces_of
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
_ENOUGH = 500  # cells per photo from which only every second one is tested, from twice as many every third
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
class _Bands:
    """The bands beside n cells: apart (n, 2) px, where they end below and above, nan for none.

    end (n, 2) px: where cells have to end because of a second step on the same side, inf for none.
    """

    apart: Array
    end: Array

    @property
    def beside(self) -> Mask:
        """Return which cells (n,) have a band."""
        return np.asarray(np.isfinite(self.apart).any(axis=1))


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

    def bands(self, blur: float) -> _Bands:
        """Return the bands beside the cells.

        A second step is searched for beside the first: on the other side it ends another band; on the same side cells
        end before the farther one.
        """
        n = len(self.rest)
        apart, end = np.full((n + 1, 2), np.nan), np.full((n + 1, 2), np.inf)  # the last row: cells of no stretch
        known = np.column_stack([self.known, np.full(n, np.nan)])
        some, first = self._clear(np.arange(n), known, blur)
        apart[some, (first > 0).astype(int)] = first
        known[some, 2] = first
        again, second = self._clear(some, known, blur) if len(some) else (some, first)
        for k, place in zip(again, second, strict=True):
            side = int(place > 0)
            if np.isnan(apart[k, side]):
                apart[k, side] = place
            else:
                near, far = sorted((apart[k, side], place), key=abs)
                apart[k, side], end[k, side] = near, abs(far) - _SHORT * blur
        return _Bands(apart[self.of], end[self.of])

    def _clear(self, some: Longs, known: Array, blur: float) -> tuple[Longs, Array]:
        """Return which of some stretches clearly show a step, and where; known (B, 3): steps known in all of them."""
        maybe = some[self._gains(some, known, blur, _COARSE).max(axis=1, initial=0.0) > _MAYBE * _CLEAR]
        gain = self._gains(maybe, known, blur, _TRIED)
        best = np.argmax(gain, axis=1)
        clear = np.flatnonzero(gain[np.arange(len(best)), best] > _CLEAR)
        return maybe[clear], np.array([_peak(gain[k], int(best[k])) for k in clear])

    def _gains(self, some: Longs, known: Array, blur: float, tried: Array) -> Array:
        """Return what steps at the places tried explain (n, t) in some stretches."""
        left = self.rest[some], self.number[some], self.variance[some]
        return band_gains(*left, known[some], self.room[some], tried, width=_WIDTH, blur=blur)


def share_beside_bands(sight: Sight, at: Projected, cells: Cells, where: Array) -> float:
    """Return the share of a photo's cells that lies beside bands; where (N,) px along the normals: places of the steps.

    If half of the stretches show none, or hardly any, the others are not tested.
    """
    if not len(cells.which):
        return 0.0
    for every in (2, 1):
        stretches = _stretches(sight, at, cells, where, every=every)
        share = float(stretches.bands(cells.blur).beside[stretches.of >= 0].mean())
        if share < _FEW_BANDS:
            break
    return share


def banded(
    sight: Sight, at: Projected, cells: Cells, where: Array, *, anew: bool = False
) -> tuple[Cells, Cells, StepSums]:
    """Return cells of the photo's true blur, the same cells with bands modelled, and the sums of the latter.

    where (N,) px along the normals: places of the steps. anew: whether cells are laid out again where bands may have
    been mistaken for blur.
    """
    plain = cells.sums_at(sight, at, where)
    if not len(cells.which):
        return cells, cells, plain
    stretches = _stretches(sight, at, cells, where)
    bands = stretches.bands(cells.blur)
    if not bands.beside.any():
        return cells, cells, plain
    if anew and bands.beside.mean() > _BESIDE:
        blur = _blur(sight, at, cells, where)
        if abs(blur / cells.blur - 1) > _SAME:
            return banded(sight, at, _blurred(sight, at, cells, where, blur), where)
    told, sums = _told(cells, bands).settled(sight, at, where)
    drawn = _drawn(plain, sums, stretches.of)
    return cells, replace(told, doubt=LEFT * np.where(bands.beside, drawn, 0.0)), sums


def _blur(sight: Sight, at: Projected, cells: Cells, where: Array) -> float:
    """Return the blur at which steps fit best with bands modelled."""
    tried, misfit = cells.blur * _BLURS, []
    for blur in tried:
        _, told, sums = banded(sight, at, _blurred(sight, at, cells, where, blur), where)
        noise = sums.solved(told.held).noise
        misfit.append(float(np.mean(np.log(noise[np.isfinite(noise)]))))
    best = int(np.argmin(misfit))
    return float(np.exp(parabola(np.log(tried), np.array(misfit), best)))


def _blurred(sight: Sight, at: Projected, cells: Cells, where: Array, blur: float) -> Cells:
    """Return cells laid out again for another blur, px."""
    return Cells.of(sight, at, cells.size, where=where, spread=(blur / cells.blur) ** 2 * cells.spread)


def _told(cells: Cells, bands: _Bands) -> Cells:
    """Return cells that model the steps in which bands end."""
    twins, reach = cells.twins.copy(), np.stack([cells.below, cells.above], axis=1)
    there = np.isfinite(bands.apart)
    twins[there] = np.column_stack([bands.apart[there], np.zeros(there.sum())])
    past = np.minimum(np.abs(bands.apart) + _PAST * cells.blur, cells.room)
    reach = np.minimum(np.where(there, np.fmax(reach, past), reach), bands.end)
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
    of = numbered(pieces_of(sight.samples.run[cells.which], _TOGETHER))
    some = np.arange(0, len(of), 1 + len(of) // _ENOUGH)
    some = some[of[some] % every == 0]
    placed, twins = cells.placed(at, where), cells.twins[some]
    reach = np.minimum(cells.room[some], _FAR)
    below, above = reach.T
    far = StepCells(placed.q[some], placed.normal[some], below, above, cells.size.half_length, cells.blur, twins)
    sums = step_sums(sight.photo.gray, far)
    rest, number, variance = step_rests(sight.photo.gray, far, sums, bins=_BINS, width=_WIDTH)
    first = np.flatnonzero(np.diff(of[some], prepend=-1))  # cell of each stretch, among some
    few = np.bincount(of)[of[some][first]] < _FEW
    known, room = _known_and_room(twins[:, :, 0], reach, first, few)
    index = np.full(int(of[-1]) + 1, -1)
    index[of[some][first]] = np.arange(len(first))
    mean = np.add.reduceat(variance, first) / np.diff(first, append=len(some))
    return _Stretches(index[of], np.add.reduceat(rest, first), np.add.reduceat(number, first), mean, known, room)


def _known_and_room(twins: Array, reach: Array, first: Longs, few: Mask) -> tuple[Array, Array]:
    """Return the model's mean steps (B, 2) px beside stretches, nan for none, and the room (B, 2) px for bands.

    No room is left on the side of a known step, nor beside stretches of few cells. twins, reach (n, 2) px: the steps
    below and above each cell, and its extent; first (B,): each stretch's first cell.
    """
    there = np.isfinite(twins)
    count = np.add.reduceat(there, first, dtype=float)
    known = np.add.reduceat(np.where(there, twins, 0.0), first) / np.where(count > 0, count, np.nan)
    room = np.minimum.reduceat(reach, first) - _INSIDE
    return known, np.where((count > 0) | few[:, None], 0.0, room)


def _peak(gain: Array, best: int) -> float:
    """Return the position of the maximum of the parabola through the largest gain and its two neighbours."""
    at, around = _TRIED[best], gain[max(best - 1, 0) : best + 2]
    if len(around) < 3 or not around.min() > 0 or _TRIED[best - 1] * _TRIED[best + 1] < 0:
        return float(at)
    before, here, after = around
    return float(at + 0.5 * (after - before) / (2 * here - before - after) * (_TRIED[best + 1] - at))
