"""Marks fitted to those of their pixels that show them: what covers a part of a mark is found out and left out.

A fit to all pixels of a mark that is covered in part settles between the two. So it is repeated without a wedge of the
window, for wedges all around; of these fits the one is taken that most pixels agree with, and pixels that contradict it
are left out, with their neighbours, until nothing changes. What a blur of another form leaves on all borders alike
shifts nothing, and those pixels stay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.target.boards.photometric import CONTRAST, Fit, Model, fitted
from cadcam.target.marks.lines import shared_by_lines
from cadcam.target.marks.mark import Mark
from cadcam.target.marks.model import Geometry, mark_model, predicted
from cadcam.target.marks.response import BENT, fit_as_seen
from cadcam.target.marks.window import Window

HIDDEN, _SIGMAS = 0.12, 5.0  # residual by contrast, and by the noise, of a pixel that shows something else
_ROUNDS = 6  # fits without those
_BESIDE, _MOST_BESIDE = 8.0, 2  # of a mark's radius, and px: so near to what shows something else pixels are left out
_FEW = 0.003  # share of the window that may disagree without another fit
_HOPELESS = 0.45  # rms of the residuals by contrast: nothing that leaving pixels out would mend
_ONE_SIDED, _CHANCE = 0.08, 1.5  # resultant of the directions of odd pixels, and by what chance makes of so many
_MIDDLE, _ALSO_PLAIN = 0.45, 0.1  # grey values so far from the middle are plain; of what a cover hides as many are
_BETTER = 0.9  # of the misfit: what leaving out a wedge must bring
_QUICK, _ENOUGH = 8, 700  # iterations of a fit without a wedge, and its pixels
_WEDGES = ((8, np.radians(75.0)), (8, np.radians(110.0)))  # how many, and how far to either side they reach


def clear_fit(
    mark: Mark, geometry: Geometry, start: Array, window: Window, q: Array, *, noise: float
) -> tuple[Fit, Array]:
    """Return the fit with pixels left out that show something else, and the weights (B, P) of those kept.

    start (B, n): parameters; q (B, 2): about which the windows lie; noise: sd of a grey value.
    """
    fit, loose = fit_as_seen(mark, geometry, start, window, q)
    weight = window.weight
    odd, seen = _odd(mark, geometry, fit, window, noise)
    suspect = (odd.mean(axis=1) > _FEW) & (fit.misfit < _HOPELESS)
    plain = _also_plain(odd, seen, window)
    for i in np.flatnonzero(suspect & (plain | _one_sided(odd, window))).tolist():
        one, there = window.only(i)
        at = slice(i, i + 1)
        begun, gain, loose[i] = _told_apart(mark, geometry, int(loose[i]), start[at], fit.subset(at), one, q[at], noise)
        if plain[i] or gain < _BETTER:
            model = mark_model(mark, geometry, loose=int(loose[i]))
            part, clear = _cleared(mark, geometry, model, begun, one, q[at], noise)
            fit, weight = fit.replaced(part, np.array([i])), weight.copy()
            weight[i, there] = clear
    model = mark_model(mark, geometry, loose=max(BENT, int(loose.max(initial=0))))
    return _together(model, fit, window, weight), weight


def _together(model: Model, fit: Fit, window: Window, weight: Array) -> Fit:
    """Return the fit with the covariance that the pixels of a line leave where they go together."""
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
    """Return what `_most_agreed` does, and how many of b dx dy are in it: a cover may look like motion, and is not."""
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

    And its misfit, to which no pixel adds more than 1, and that by the one of the fit to all.
    """
    model = mark_model(mark, geometry, loose=loose)
    window = window.thinned(_ENOUGH)
    angle = np.arctan2(window.pixels[0, :, 1], window.pixels[0, :, 0])
    masks = [np.ones(len(angle), bool)]
    for count, half in _WEDGES:
        for k in range(count):
            away = np.abs(np.mod(angle - 2 * np.pi * k / count + np.pi, 2 * np.pi) - np.pi)
            masks.append(away > half)
    n = len(masks)
    many = window.subset(np.zeros(n, np.int32))
    many = replace(many, weight=many.weight * np.array(masks))
    starts, about = np.repeat(start, n, axis=0), np.repeat(q, n, axis=0)
    fit = fitted(model, starts, many, about, many.size, iterations=_QUICK)
    r = (predicted(mark, geometry, fit.parameters, many.pixels) - many.values) * window.weight
    limit = _limit(fit.parameters[:1], noise)
    cost = (r**2 / (r**2 + limit[:, None] ** 2)).sum(axis=1)
    whole = max(float(cost[0]), 1e-12)
    cost[~fit.good | (np.sign(fit.parameters[:, CONTRAST]) != np.sign(fit.parameters[0, CONTRAST]))] = np.inf
    best = int(np.argmin(cost))
    return fit.subset(slice(best, best + 1)), float(cost[best]), float(cost[best]) / whole


def _limit(parameters: Array, noise: float) -> Array:
    return np.maximum(HIDDEN * np.abs(parameters[:, CONTRAST]), _SIGMAS * noise)


def _odd(mark: Mark, geometry: Geometry, fit: Fit, window: Window, noise: float) -> tuple[Mask, Array]:
    """Return which pixels (B, P) contradict the marks, and the grey values that those would have there."""
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
    """Return the odd pixels (P,) of one window with those beside them; single ones are left alone, they are noise."""
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
