"""Marks fitted to the pixels that show them: pixels where something covers part of a mark are detected and left out.

A fit to all pixels of a partly covered mark ends between mark and cover. So the fit is repeated without a wedge of the
window, for wedges all around, and the fit that most pixels agree with is taken; pixels that contradict it are left out
with their neighbours, until the set no longer changes. Residuals that are alike along all borders, as from a blur of
another shape, do not shift the mark, and those pixels stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.cores import on_cores
from cadcam.target.boards.photometric import CONTRAST, Fit, Model, fitted
from cadcam.target.marks.lines import shared_by_lines
from cadcam.target.marks.mark import Mark
from cadcam.target.marks.model import Geometry, mark_model, predicted
from cadcam.target.marks.response import BENT, fit_as_seen, may_be_marks
from cadcam.target.marks.window import Window

HIDDEN, _SIGMAS = 0.12, 5.0  # a pixel shows something else: residual over contrast, and over the noise
_ROUNDS = 6  # of leaving out such pixels and refitting
_BESIDE, _MOST_BESIDE = 8.0, 2  # neighbours left out with them: within radius / 8, at most 2 px
_FEW = 0.003  # share of the window that may disagree without another fit
_HOPELESS = 0.45  # rms residual over contrast beyond which leaving out pixels does not help
_ONE_SIDED, _CHANCE = 0.08, 1.5  # mean resultant of the directions of odd pixels; as a multiple of its chance level
_MIDDLE, _ALSO_PLAIN = 0.45, 0.1  # away from borders: share of the grey range; share of odd pixels under a cover
_BETTER = 0.9  # ratio of misfits below which a fit without a wedge is taken
_QUICK, _ENOUGH = 8, 700  # iterations and pixels of a fit without a wedge
_WEDGES = ((8, np.radians(75.0)), (8, np.radians(110.0)))  # how many all around, and half their angle


def clear_fit(
    mark: Mark, geometry: Geometry, start: Array, window: Window, q: Array, *, noise: float
) -> tuple[Fit, Array]:
    """Return the fit without the pixels that show something else, and the weights (B, P) of the pixels kept.

    start (B, n): parameters; q (B, 2): the windows' centres; noise: sd of a grey value.
    """
    fit, loose = fit_as_seen(mark, geometry, start, window, q)
    every, weight = _Windows(mark, geometry, window, q, noise), window.weight
    odd, seen = every.odd(fit)
    suspect = (odd.mean(axis=1) > _FEW) & (fit.misfit < _HOPELESS) & may_be_marks(fit, window)
    plain = _also_plain(odd, seen)
    # A motion that is there explains the borders; one fitted to a cover spreads its contradictions to both sides.
    suspects = np.flatnonzero(suspect & (plain | _one_sided(odd, window) | (loose > BENT))).tolist()

    def treated(i: int) -> tuple[int, tuple[Fit, Array] | None]:
        """Return how many of b dx dy the i-th mark has, and its fit with the weights of its pixels if any is hidden."""
        (one, _), at = every.only(i), slice(i, i + 1)
        begun, gain, count = one.told_apart(start[at], fit.subset(at), int(loose[i]))
        return count, one.cleared(begun, count) if plain[i] or gain < _BETTER else None

    for i, (count, answer) in zip(suspects, on_cores(treated, suspects), strict=True):
        loose[i] = count
        if answer is not None:
            fit, weight = fit.replaced(answer[0], np.array([i])), weight.copy() if weight is window.weight else weight
            weight[i, window.weight[i] > 0] = answer[1]
    model = every.model(max(BENT, int(loose.max(initial=0))))
    return _together(model, fit, window, weight), weight


def _together(model: Model, fit: Fit, window: Window, weight: Array) -> Fit:
    """Return the fit with its covariance enlarged for errors that the pixels of a line share."""
    shared = shared_by_lines(model, fit, window, weight)
    wider = np.stack([np.sqrt(shared), np.ones(len(shared))], axis=-1)
    return replace(fit, covariance=fit.covariance * wider[:, :, None] * wider[:, None, :], shared=shared)


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """The windows of B marks of one kind, q (B, 2) their centres, and the sd of a grey value by noise."""

    mark: Mark
    geometry: Geometry
    window: Window
    q: Array
    noise: float

    def only(self, i: int) -> tuple[_Windows, Mask]:
        """Return one of them without padding, and which of all pixels (P,) are its own."""
        window, there = self.window.only(i)
        return replace(self, window=window, q=self.q[i : i + 1]), there

    def model(self, loose: int) -> Model:
        """Return the model of the marks; loose: as of `mark_model`."""
        return mark_model(self.mark, self.geometry, loose=loose)

    def limit(self, parameters: Array) -> Array:
        """Return the residual (B,) from which a pixel contradicts a mark."""
        return np.maximum(HIDDEN * np.abs(parameters[:, CONTRAST]), _SIGMAS * self.noise)

    def odd(self, fit: Fit) -> tuple[Mask, Array]:
        """Return which pixels (B, P) contradict the marks, and the predicted grey values there."""
        seen = predicted(self.mark, self.geometry, fit.parameters, self.window.pixels)
        off = np.abs(seen - self.window.values) > self.limit(fit.parameters)[:, None]
        return np.asarray(off & (self.window.weight > 0)), seen

    def cleared(self, fit: Fit, loose: int) -> tuple[Fit, Array]:
        """Return the fit of one mark to the pixels (P,) that agree with it, from a first fit."""
        model, weight = self.model(loose), self.window.weight
        for _ in range(_ROUNDS):
            odd, _ = self.odd(fit)
            clear = self.window.weight * ~_widened(odd[0], self.window)
            if clear.sum() <= 3 * self.geometry.free or np.array_equal(clear, weight):
                break
            weight = clear
            fit = fitted(model, fit.parameters, replace(self.window, weight=weight), self.q, self.window.size)
        return fit, weight[0]

    def told_apart(self, start: Array, whole: Fit, loose: int) -> tuple[Fit, float, int]:
        """Return fit and relative misfit of `most_agreed` of one mark, and how many of the b dx dy it frees.

        A cover may look like motion blur: motion is free only where it explains the pixels clearly better. whole: the
        fit to all pixels.
        """
        motion = self.geometry.motion
        still, moving = start.copy(), start.copy()
        still[:, motion], moving[:, motion] = 0.0, whole.parameters[:, motion]
        fit, cost, gain = self.most_agreed(still, min(loose, BENT))
        if loose > BENT:
            other, less, gained = self.most_agreed(moving, loose)
            if less < _BETTER * cost:
                return other, gained, loose
        return fit, gain, min(loose, BENT)

    def most_agreed(self, start: Array, loose: int) -> tuple[Fit, float, float]:
        """Return, of one mark's fits to all pixels and to those outside each wedge, that which most pixels agree with.

        And its misfit, to which no pixel adds more than 1, and that relative to the misfit of the fit to all pixels.
        """
        window = self.window.thinned(_ENOUGH)
        kept = _outside_wedges(window)
        n = len(kept)
        copies = window.subset(np.zeros(n, np.int32))
        copies = replace(copies, weight=copies.weight * kept)
        starts, about = np.repeat(start, n, axis=0), np.repeat(self.q, n, axis=0)
        fit = fitted(self.model(loose), starts, copies, about, copies.size, iterations=_QUICK)
        # judged by all pixels, including those in the wedge
        r = (predicted(self.mark, self.geometry, fit.parameters, copies.pixels) - copies.values) * window.weight
        limit = self.limit(fit.parameters[:1])
        misfit = (r**2 / (r**2 + limit[:, None] ** 2)).sum(axis=1)
        misfit_to_all = max(float(misfit[0]), 1e-12)
        contrast = fit.parameters[:, CONTRAST]
        misfit[~fit.good | (np.sign(contrast) != np.sign(contrast[0]))] = np.inf
        best = int(np.argmin(misfit))
        return fit.subset(slice(best, best + 1)), float(misfit[best]), float(misfit[best]) / misfit_to_all


def _outside_wedges(window: Window) -> Mask:
    """Return masks (M, P) of one window's pixels: all of them, then those outside each wedge."""
    angle = np.arctan2(window.pixels[0, :, 1], window.pixels[0, :, 0])
    masks = [np.ones(len(angle), bool)]
    for count, half_angle in _WEDGES:
        for k in range(count):
            from_axis = np.abs(np.mod(angle - 2 * np.pi * k / count + np.pi, 2 * np.pi) - np.pi)
            masks.append(from_axis > half_angle)
    return np.array(masks)


def _one_sided(odd: Mask, window: Window) -> Mask:
    """Return for which marks (B,) odd pixels lie to one side, beyond chance."""
    direction = window.pixels[..., :2] / np.maximum(np.linalg.norm(window.pixels[..., :2], axis=2, keepdims=True), 1e-9)
    count = np.maximum(odd.sum(axis=1), 1)
    resultant = np.linalg.norm((direction * odd[..., None]).sum(axis=1), axis=1) / count
    return np.asarray(resultant > np.maximum(_ONE_SIDED, _CHANCE / np.sqrt(count)))


def _also_plain(odd: Mask, seen: Array) -> Mask:
    """Return for which marks (B,) plain pixels disagree too, not only those on borders."""
    low, high = (np.nanquantile(seen, q, axis=1, keepdims=True) for q in (0.05, 0.95))
    plain = np.abs(seen - (low + high) / 2) > _MIDDLE * (high - low)
    return np.asarray((odd & plain).sum(axis=1) > _ALSO_PLAIN * odd.sum(axis=1))


def _widened(odd: Mask, window: Window) -> Mask:
    """Return the odd pixels (P,) of one window with their neighbours, except isolated ones, which are noise."""
    from scipy.ndimage import binary_dilation, uniform_filter

    place = np.rint(window.pixels[0, :, :2] - window.pixels[0, 0, :2]).astype(int)
    x, y = (place - place.min(axis=0)).T
    grid = np.zeros((y.max() + 1, x.max() + 1))
    grid[y, x] = odd
    beside = min(int(window.size[0] / _BESIDE), _MOST_BESIDE)
    if beside == 0:
        return odd
    side = 2 * beside + 1
    crowded = grid.astype(bool) & (uniform_filter(grid, side, mode="constant") * side**2 > 2.5)
    return np.asarray(binary_dilation(crowded, np.ones((side, side), bool))[y, x] | odd)
