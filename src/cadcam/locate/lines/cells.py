"""Cells on the part's lines, and the steps that are measured in them.

A cell is a short stretch of line with the pixels to both sides, as far as no other line affects them. It models the
light there, so that the step at another place is again a linear fit to the same pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.image.profile import Steps, StepSums, step_sums
from cadcam.locate.lines.edges import EdgeSamples, Projected
from cadcam.locate.lines.sight import Sight
from cadcam.native.profiles import StepCells, along_runs

_APART = 1.5  # blurs: a cell ends that far before the next line
_PAST, _TWIN = 2.0, 3.0  # blurs: it ends that far beyond a twin, which must be that far away
_REACH = 3.0  # blurs: least reach to each side, to separate levels and slopes from the step
_ALIKE = 0.1  # share by which blurs may differ that are treated as one
_LINEAR = 1.2  # blurs: distance up to which a linear fit is valid
_CLEAR = 4.0  # sd of one cell: least contrast of an edge
_SURE = 8.0  # sd of one cell: contrast that needs no support by neighbours
_CLIPPED = 0.7  # share of black or white pixels from which a cell is unusable
# Blurs by which steps up to white may be off, all of a stretch alike: their height follows from the photo's blur, which
# other steps tell, if there are so many; else nothing tells it well (0.05 to 0.1 px, and 0.35 px, in overexposed
# pictures of edges).
_WHITE, _ALL_WHITE, _TELLING = 0.12, 0.5, 12
# Cells to each side on the same run over which contrast, noise and slopes are averaged. The averages are far less noisy
# than a cell's own, so that the weights of an edge's samples do not flicker.
_CONTRAST, _STRETCH = 3, 10
_LEAST_PAIRS = 4  # fewest pairs of neighbouring cells on a run from which the noise of slopes is estimated
_MEDIAN_CHI2 = 0.4549  # of the square of a standard normal variable


@dataclass(frozen=True, slots=True)
class CellSize:
    """Half the length of cells along their line, how far they reach to each side, and what they need there, px."""

    half_length: float
    reach: float
    room: float


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Which of a sight's samples have room for a cell, the cells' extents, and the parameters of their fits.

    size: as asked for; which (N,): numbers of the samples; below, above (N,) px: extent, more than asked for where blur
    needs it; held (N, 2): how strongly the slopes are held (`image.profile.StepSums`); bow (N,) px: distance along
    the normal of the step of a curved line from its tangent, averaged over the cell; spread (2, 2) px^2: the photo's
    blur (`image.profile.blur_matrix`), blurs (N,) px: across each cell's line. twins (N, 2, 2): other steps in them, as
    in `EdgeSamples`; room (N, 2) px: largest possible extent below and above; doubt (N,) px: error that the steps of a
    stretch of line may share. first: the sums at the initial places, which the first measurement needs again.
    """

    size: CellSize
    which: Longs
    below: Array
    above: Array
    held: Array
    bow: Array
    spread: Array
    blurs: Array
    twins: Array
    room: Array
    doubt: Array
    first: StepSums | None = None

    @classmethod
    def of(
        cls, sight: Sight, at: Projected, size: CellSize, *, where: Array | None = None, spread: Array | None = None
    ) -> Cells:
        """Return the cells of a sight.

        where (N,) px along the normals: approximate places of the steps, default on the lines. spread (2, 2) px^2: the
        blur, default as measured on the strongest lines.

        The ground's slopes are held according to their average in the stretch of line around each cell, which has
        little noise: where the ground is level they cost no accuracy, where light bends it they are free.
        """
        if spread is None:
            spread = sight.blur(at, half_length=size.half_length, reach_px=size.reach)
        samples, blur = sight.samples, np.sqrt(np.einsum("ij,ij->i", at.normal @ spread, at.normal))
        room = _room(samples, blur)
        below, above = np.minimum(room, np.maximum(size.reach, _REACH * blur)[:, None]).T
        apart = np.minimum(*np.abs(samples.twins[:, :, 0].T)) > _TWIN * blur
        enough = (below >= size.room) & (above >= size.room)
        which = np.flatnonzero(apart & enough & at.imaged)
        unsettled = cls(
            size,
            which,
            below[which],
            above[which],
            held=np.zeros((len(which), 2)),
            bow=_bow(at, samples.run, size.half_length, blur)[which],
            spread=spread,
            blurs=blur[which],
            twins=samples.twins[which],
            room=room[which],
            doubt=np.zeros(len(which)),
        )
        cells, sums = unsettled.settled(sight, at, where)
        return replace(cells, first=sums)

    def with_twins_moved(self, by: Array) -> Cells:
        """Return the same cells with the twins of all the samples moved, by (N, 2) px relative to them."""
        twins = self.twins.copy()
        twins[:, :, 0] += by[self.which]
        return replace(self, twins=twins, first=None)

    @property
    def blur(self) -> float:
        """Return the blur (px) across the cells' lines, on average."""
        return float(np.sqrt(self.blurs @ self.blurs / n if (n := len(self.blurs)) else np.trace(self.spread) / 2))

    def alike(self) -> list[tuple[Longs, float]]:
        """Return groups of cells of similar blur: their numbers, and that blur, px."""
        if not len(self.blurs) or np.ptp(self.blurs) <= _ALIKE * self.blurs[0]:
            return [(np.arange(len(self.blurs)), self.blur)]
        of = np.round(np.log(self.blurs) / _ALIKE)
        return [(own, float(self.blurs[own].mean())) for own in (np.flatnonzero(of == one) for one in np.unique(of))]

    def settled(self, sight: Sight, at: Projected, where: Array | None) -> tuple[Cells, StepSums]:
        """Return the cells with slopes held according to the photo, and their sums."""
        sums = self.sums_at(sight, at, where)
        found, run = self.steps(sums, np.zeros((len(self.which), 2)), sight), sight.samples.run[self.which]
        slope2 = along_runs(found.slopes, run, _STRETCH) ** 2
        held = along_runs(found.noise**2, run, _STRETCH)[:, None] / np.maximum(slope2, 1e-12)
        return replace(self, held=np.where(np.isfinite(held), held, 0.0)), sums

    def steps(self, sums: StepSums, held: Array, sight: Sight) -> Steps:
        """Return the steps; nan where white covers all of a step's bright side, and so the step itself."""
        found = sums.solved(held, noise=0.5 * sight.noise)
        covered = self.white(sums, found.contrast) >= 1.0
        return found.without(covered) if covered.any() else found

    def white(self, sums: StepSums, contrast: Array) -> Array:
        """Return how many pixels (n,) are white, as a share of the step's bright side."""
        return sums.white * (self.below + self.above) / np.where(contrast > 0, self.above, self.below)

    def placed(self, at: Projected, where: Array | None) -> StepCells:
        """Return the cells in the picture; where (N,) px: shift of each along the normal."""
        normal = at.normal[self.which]
        aside = self.bow if where is None else self.bow + where[self.which]
        q = at.q[self.which] + aside[:, None] * normal
        return StepCells(q, normal, self.below, self.above, self.size.half_length, self.blur, self.twins)

    def sums_at(self, sight: Sight, at: Projected, where: Array | None) -> StepSums:
        """Return the sums over the cells' pixels; where (N,) px: shift of each cell along the normal."""
        placed, alike = self.placed(at, where), self.alike()
        if len(alike) == 1:
            return step_sums(sight.photo.gray, placed)
        each = [step_sums(sight.photo.gray, placed.select(own, blur)).sums for own, blur in alike]
        order = np.argsort(np.concatenate([own for own, _ in alike]))
        return StepSums(np.concatenate(each)[order])


@dataclass(frozen=True, slots=True, eq=False)
class StepOffsets:
    """Offsets (N,) px of the photo's steps from the model's lines, their sd by noise, contrast, and which are usable.

    doubt (N,) px: error that all steps of a stretch of line may share; white (N,) px, along the normals: error that all
    steps up to white of a photo may share.
    """

    offset: Array
    sigma: Array
    contrast: Array
    usable: Mask
    doubt: Array
    white: Array


def measured_steps(
    sight: Sight, at: Projected, cells: Cells, where: Array, *, sums: StepSums | None = None, as_lines: bool = False
) -> StepOffsets:
    """Return the steps' offsets by a linear fit at places `where` (N,) px along the samples' normals.

    sums: of the cells there, if known. as_lines: slopes are held according to the mean of each run of cells. Held
    according to each cell alone, slopes that are lost in its noise bias all steps of a run alike, by more than their
    mean is uncertain; free slopes bias nothing, at 1.4 times the noise.

    The fit is valid near the step: a place must be right to about the blur.
    """
    n = len(sight.samples)
    offset, sigma, contrast = (np.full(n, np.nan) for _ in range(3))
    usable, doubt, white = np.zeros(n, bool), np.zeros(n), np.zeros(n)
    which = cells.which
    if not len(which):
        return StepOffsets(offset, sigma, contrast, usable, doubt, white)
    sums = cells.sums_at(sight, at, where) if sums is None else sums
    found, run = cells.steps(sums, cells.held, sight), sight.samples.run[which]
    c, sd_c = along_runs(found.contrast, run, _CONTRAST), _sd_contrast(sight, found, run)
    sure = np.abs(found.contrast) > _SURE * found.sd_contrast  # its sign may change along a line
    c = np.where(sure, found.contrast, c)
    more = np.sqrt(along_runs(found.noise**2, run, _STRETCH)) / found.noise
    placed = cells.steps(sums, _held_as_lines(sums, run), sight) if as_lines else found
    with np.errstate(all="ignore"):
        shift, sigma[which] = -placed.moment / c, placed.sd_moment * more / np.abs(c)
        near = np.abs(shift) < _LINEAR * np.maximum(cells.blurs, 0.7)
        usable[which] = (np.abs(c) > _CLEAR * sd_c) & near & (found.clipped < _CLIPPED)
        offset[which] = where[which] + shift
    blur_told = np.count_nonzero(usable[which] & (sums.white == 0)) >= _TELLING
    by_white = (_WHITE if blur_told else _ALL_WHITE) * cells.blurs * cells.white(sums, c)
    contrast[which], doubt[which], white[which] = c, np.hypot(cells.doubt, by_white), np.sign(c) * by_white
    return StepOffsets(offset, sigma, contrast, usable, doubt, white)


def _held_as_lines(sums: StepSums, run: Ids) -> Array:
    """Return how strongly slopes (n, 2) are held by each run as a whole: according to its mean slope, or the usual one.

    The mean slope over k cells has k times the information of a single one, so it is held that much less. The prior
    variance of slopes follows from these means, less their noise: the median over all runs, and more for a run whose
    own is larger. The noise of slopes is estimated from the differences between neighbouring cells.
    """
    found = sums.solved(np.zeros((len(run), 2)))
    number = np.unique(run, return_inverse=True)[1].reshape(-1)
    known = np.isfinite(found.slopes).all(axis=1) & np.isfinite(found.noise)
    slopes, noise2 = np.where(known[:, None], found.slopes, 0.0), np.where(known, found.noise**2, 0.0)
    count = np.maximum(np.bincount(number, known), 1.0)
    mean = np.asarray(np.stack([np.bincount(number, s) for s in slopes.T], axis=1) / count[:, None])
    pair = np.flatnonzero((number[1:] == number[:-1]) & known[1:] & known[:-1])
    pairs = np.bincount(number[pair], minlength=len(count))
    apart2 = 0.5 * (slopes[pair + 1] - slopes[pair]) ** 2
    differ = np.stack([np.bincount(number[pair], a, len(count)) for a in apart2.T], axis=1)
    told = pairs >= _LEAST_PAIRS
    if not told.any():
        return np.zeros((len(run), 2))
    by_noise = np.asarray(differ[told] / (pairs * count)[told, None], np.float64)
    usual = max(float(np.median(mean[told] ** 2 / _MEDIAN_CHI2 - by_noise)), 0.0)
    slope2 = np.maximum(usual, mean**2)
    slope2[told] = np.maximum(usual, mean[told] ** 2 - by_noise)
    noise2_of_run = np.bincount(number, noise2) / count
    held = noise2_of_run[:, None] / np.maximum(count[:, None] * slope2, 1e-12)
    return np.asarray(held[number])


def _sd_contrast(sight: Sight, found: Steps, run: Ids) -> Array:
    """Return the sd (n,) that a contrast is compared with: that of a single cell, because texture runs along lines.

    Where lines are searched for in spite of noise, that of the mean over neighbours under white noise.
    """
    variance = found.sd_contrast**2
    if sight.photo.calm is not None:
        n = len(run)
        first, last = np.searchsorted(run, run), np.searchsorted(run, run, side="right") - 1
        averaged = np.minimum(np.arange(n) + _CONTRAST, last) - np.maximum(np.arange(n) - _CONTRAST, first) + 1
        variance = variance * (1 - np.minimum(sight.noise / found.noise, 1) ** 2 * (1 - 1 / averaged))
    return np.sqrt(along_runs(variance, run, _CONTRAST))


def _room(samples: EdgeSamples, blur: Array) -> Array:
    """Return the extents (N, 2) px that cells may have below and above their lines.

    That is short of the next line, or past it where that is a twin.
    """
    next_line, blur = np.stack([samples.below, samples.above], axis=1), blur[:, None]
    past = np.minimum(next_line + _PAST * blur, samples.beyond - _APART * blur)
    return np.asarray(np.maximum(next_line - _APART * blur, past))


def _bow(at: Projected, run: Ids, half_length: float, blur: Array) -> Array:
    """Return the mean distance (N,) px along the normal, over each cell, of a curved line's step from its tangent.

    A line of curvature k is k t^2 / 2 off its tangent at t, so k half_length^2 / 6 on average, and blur moves its step
    towards the inside of the curve, by k blur^2 / 2. The neighbours on the line, at distance s, are k s^2 / 2 off.
    """
    before, here, after = at.q[:-2], at.q[1:-1], at.q[2:]
    apart2 = 0.5 * sum(np.einsum("ij,ij->i", away, away) for away in (after - here, before - here))
    curvature = np.zeros(len(run))
    with np.errstate(invalid="ignore", divide="ignore"):
        bent = np.einsum("ij,ij->i", before + after - 2 * here, at.normal[1:-1]) / apart2
    curvature[1:-1] = np.where((run[2:] == run[:-2]) & np.isfinite(bent), bent, 0.0)
    first, last = np.flatnonzero(np.diff(run, prepend=-1)), np.flatnonzero(np.diff(run, append=-1))
    curvature[first], curvature[last] = curvature[np.minimum(first + 1, last)], curvature[np.maximum(last - 1, first)]
    return curvature * (half_length**2 / 6 + blur**2 / 2)
