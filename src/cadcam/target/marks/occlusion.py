"""Marks fitted to the pixels that show them: pixels where something covers part of a mark are detected and left out.

A fit to all pixels of a partly covered mark ends between mark and cover. So the fit is repeated without a wedge of the
window, for wedges all around, and the fit that most pixels agree with is taken; pixels that contradict it are left out
with their neighbours, until the set no longer changes. Residuals that are alike along all borders, as from a blur of
another shape, do not shift the mark, and those pixels stay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.target.boards.cores import on_cores
from cadcam.target.boards.photometric import CONTRAST, Fit, Model, fitted
from cadcam.target.marks.lines import shared_by_lines
from cadcam.target.marks.mark import Mark
from cadcam.target.marks.model import Geometry, mark_model, predicted
from cadcam.target.marks.response import BENT, fit_as_seen
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
    weight = window.weight
    odd, seen = _odd(mark, geometry, fit, window, noise)
    suspect = (odd.mean(axis=1) > _FEW) & (fit.misfit < _HOPELESS)
    plain = _also_plain(odd, seen, window)
    suspects = np.flatnonzero(suspect & (plain | _one_sided(odd, window))).tolist()

    def treated(i: int) -> tuple[int, tuple[Fit, Array] | None]:
        """Return how many of b dx dy the i-th mark has, and its fit with the weights of its pixels if any is hidden."""
        one, at = window.only(i)[0], slice(i, i + 1)
        begun, gain, count = _told_apart(mark, geometry, int(loose[i]), start[at], fit.subset(at), one, q[at], noise)
        if not plain[i] and gain >= _BETTER:
            return count, None
        model = mark_model(mark, geometry, loose=count)
        return count, _cleared(mark, geometry, model, begun, one, q[at], noise)

    for i, (count, answer) in zip(suspects, on_cores(treated, suspects), strict=True):
        loose[i] = count
        if answer is not None:
            fit, weight = fit.replaced(answer[0], np.array([i])), weight.copy() if weight is window.weight else weight
            weight[i, window.weight[i] > 0] = answer[1]
    model = mark_model(mark, geometry, loose=max(BENT, int(loose.max(initial=0))))
    return _together(model, fit, window, weight), weight


def _together(model: Model, fit: Fit, window: Window, weight: Array) -> Fit:
    """Return the fit with its covariance enlarged for errors that the pixels of a line share."""
    shared = shared_by_lines(model, fit, window, weight)
    wider = np.stack([np.sqrt(shared), np.ones(len(shared))], axis=-1)
    return replace(fit, covariance=fit.covariance * wider[:, :, None] * wider[:, None, :], shared=shared)


def _cleared(
    mark: Mark, geometry: Geometry, model: Model, fit: Fit, window: Window, q: Array, noise: float
) -> tuple[Fit, Array]:
    """Return the fit of one mark to the pixels (P,) that agree with it, from a first fit."""
    weight = window.weight
    for _ in range(_ROUNDS):
        odd, _ = _odd(mark, geometry, fit, window, noise)
        clear = window.weight * ~_widened(odd[0], window)
        if clear.sum() <= 3 * geometry.free or np.array_equal(clear, weight):
            break
        weight = clear
        fit = fitted(model, fit.parameters, replace(window, weight=weight), q, window.size)
    return fit, weight[0]


def _told_apart(
    mark: Mark, geometry: Geometry, loose: int, start: Array, whole: Fit, window: Window, q: Array, noise: float
) -> tuple[Fit, float, int]:
    """Return fit and relative misfit of `_most_agreed`, and how many of the parameters b dx dy it frees.

    A cover may look like motion blur: motion is free only where it explains the pixels clearly better.
    """
    still, moving = start.copy(), start.copy()
    still[:, geometry.motion], moving[:, geometry.motion] = 0.0, whole.parameters[:, geometry.motion]
    fit, cost, gain = _most_agreed(mark, geometry, min(loose, BENT), still, window, q, noise)
    if loose > BENT:
        other, less, gained = _most_agreed(mark, geometry, loose, moving, window, q, noise)
        if less < _BETTER * cost:
            return other, gained, loose
    return fit, gain, min(loose, BENT)


def _most_agreed(
    mark: Mark, geometry: Geometry, loose: int, start: Array, window: Window, q: Array, noise: float
) -> tuple[Fit, float, float]:
    """Return, of the fits to all pixels and to those outside each wedge, the one that most pixels agree with.

    And its misfit, to which no pixel adds more than 1, and that relative to the misfit of the fit to all pixels.
    """
    model = mark_model(mark, geometry, loose=loose)
    window = window.thinned(_ENOUGH)
    kept = _outside_wedges(window)
    n = len(kept)
    copies = window.subset(np.zeros(n, np.int32))
    copies = replace(copies, weight=copies.weight * kept)
    starts, about = np.repeat(start, n, axis=0), np.repeat(q, n, axis=0)
    fit = fitted(model, starts, copies, about, copies.size, iterations=_QUICK)
    # judged by all pixels, including those in the wedge
    r = (predicted(mark, geometry, fit.parameters, copies.pixels) - copies.values) * window.weight
    limit = _limit(fit.parameters[:1], noise)
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


def _limit(parameters: Array, noise: float) -> Array:
    return np.maximum(HIDDEN * np.abs(parameters[:, CONTRAST]), _SIGMAS * noise)


def _odd(mark: Mark, geometry: Geometry, fit: Fit, window: Window, noise: float) -> tuple[Mask, Array]:
    """Return which pixels (B, P) contradict the marks, and the predicted grey values there."""
    seen = predicted(mark, geometry, fit.parameters, window.pixels)
    off = np.abs(seen - window.values) > _limit(fit.parameters, noise)[:, None]
    return np.asarray(off & (window.weight > 0)), seen


def _one_sided(odd: Mask, window: Window) -> Mask:
    """Return for which marks (B,) odd pixels lie to one side, beyond chance."""
    direction = window.pixels[..., :2] / np.maximum(np.linalg.norm(window.pixels[..., :2], axis=2, keepdims=True), 1e-9)
    count = np.maximum(odd.sum(axis=1), 1)
    resultant = np.linalg.norm((direction * odd[..., None]).sum(axis=1), axis=1) / count
    return np.asarray(resultant > np.maximum(_ONE_SIDED, _CHANCE / np.sqrt(count)))


def _also_plain(odd: Mask, seen: Array, window: Window) -> Mask:
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
