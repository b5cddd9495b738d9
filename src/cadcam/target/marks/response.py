"""Marks fitted with effects of the camera where residuals show them: bent response, motion blur, blur that has a slope.

A nonlinear response, from a gamma or from overexposure, contradicts a linear one on all borders alike. A mark that
moves during the exposure is blurred along its path and not across; a model without motion compensates by a tilt, or
takes borders for covered. A score test on the fit without either decides whether they are fitted. Behind a lens'
opening a tilted mark is blurred more on one side than on the other, s + h . (u, v), and drawn to the sharper side:
where the same test shows it, one more step is made with h free. To first order that is its fit, as h is small.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.native.marks import LOOSE
from cadcam.target.boards.photometric import BLUR, CONTRAST, ITERATIONS, Fit, Normal, fitted, missed
from cadcam.target.marks.mark import Mark
from cadcam.target.marks.model import Geometry, mark_model
from cadcam.target.marks.window import Window

STRAIGHT, BENT, MOVED = 0, 1, LOOSE  # how many of b dx dy are fitted
_SEEN = 30.0  # decrease of chi-square at which they are fitted: by chance once in 2e7 marks
_LONG = 2.0  # blurs: least length of a motion; a shorter one shifts nothing, and pixel squares can look like it
_LONGEST = 2.0  # of the mark's smaller radius: longest motion; one that smears a mark further leaves no mark to see
_STEEPEST = 0.5  # of the blur, over the mark's smaller radius: a steeper slope is a cover's, and no first-order step
# Blur over the smaller radius, or px, and contrast over the range of grey values, below which a fit may be of a mark.
_SOFTEST, _SOFT, _MOST_CONTRAST = 0.8, 3.0, 4.0
_FIRST = 8  # iterations after which fits that cannot be of marks end; a rough fit has as many more
_SHARPEST = 0.4  # of the fitted round blur: what remains of it at least when the motion is separated


def may_be_marks(fit: Fit, window: Window) -> Mask:
    """Return which fits (B,) may be, or become, those of marks.

    The others are of clutter: by a blur that leaves no mark to see, and as much more contrast, any smooth ground fits.
    """
    there = window.weight > 0
    brightest, darkest = (np.where(there, window.values, none) for none in (-np.inf, np.inf))
    span = brightest.max(axis=1, initial=-np.inf) - darkest.min(axis=1, initial=np.inf)
    sharp = fit.parameters[:, BLUR] < np.maximum(_SOFTEST * window.size, _SOFT)
    return np.asarray(sharp & (np.abs(fit.parameters[:, CONTRAST]) < _MOST_CONTRAST * span))


def rough_fit(mark: Mark, geometry: Geometry, start: Array, window: Window, q: Array) -> Fit:
    """Return the fit to whole windows without any effect of the camera, of marks nearly converged."""
    return _plain_fit(mark, geometry, start, window, q, _FIRST)


def fit_as_seen(mark: Mark, geometry: Geometry, start: Array, window: Window, q: Array) -> tuple[Fit, Ids]:
    """Return the fit to whole windows, and the number (B,) of b dx dy in it: all where the start has motion."""

    def part(loose: int, begin: Array, k: Ids, begun: Normal | None = None) -> Fit:
        some = window.subset(k)
        model = mark_model(mark, geometry, loose=loose)
        return fitted(model, begin, some, q[k], some.size, begun=begun)

    every = np.arange(len(q), dtype=np.int32)
    if start[:, geometry.motion].any():
        return part(MOVED, start, every), np.full(len(q), MOVED, np.int32)
    fit = _plain_fit(mark, geometry, start, window, q)
    bend, motion, moved, normal = _asked(mark, geometry, fit, window)
    hopeful = fit.good & may_be_marks(fit, window)
    loose = np.where(motion > _SEEN, MOVED, np.where(bend > _SEEN, BENT, STRAIGHT)) * hopeful
    bent, smeared = (np.flatnonzero(loose == count).astype(np.int32) for count in (BENT, MOVED))
    if bent.size:  # whose first step begins where they were asked
        fit = fit.replaced(part(BENT, fit.parameters[bent], bent, normal.part(bent, geometry.free + BENT)), bent)
    if smeared.size:
        fit = fit.replaced(part(MOVED, moved[smeared], smeared), smeared)
    for count in (STRAIGHT, BENT):
        k = np.flatnonzero((loose == count) & hopeful & fit.good).astype(np.int32)
        if k.size:
            fit = fit.replaced(_sloped(mark, geometry, fit.subset(k), window.subset(k), count), k)
    return fit, loose.astype(np.int32)


def _plain_fit(mark: Mark, geometry: Geometry, start: Array, window: Window, q: Array, most: int = ITERATIONS) -> Fit:
    """Return the fit without b dx dy: after the first iterations only of what may be marks, by at most so many."""
    model = mark_model(mark, geometry, loose=STRAIGHT)
    fit = fitted(model, start, window, q, window.size, iterations=_FIRST)
    k = np.flatnonzero(fit.good & may_be_marks(fit, window)).astype(np.int32)
    if not k.size:
        return fit
    some = window.subset(k)
    return fit.replaced(fitted(model, fit.parameters[k], some, q[k], some.size, iterations=most), k)


def _sloped(mark: Mark, geometry: Geometry, fit: Fit, window: Window, loose: int) -> Fit:
    """Return the fit after the step that a slope of the blur takes, where residuals show one."""
    level = mark_model(mark, geometry, loose=loose)
    n = geometry.free + loose

    def sloped(parameters: Array, pixels: Array, weight: Array | None = None) -> tuple[Array, Array]:
        value, J = level(parameters, pixels, weight)
        return value, np.concatenate([J, J[..., BLUR, None] * pixels[..., :2]], axis=-1)

    (without, both), step, _ = missed(sloped, fit, window, free=(n, n + 2))
    steep = np.hypot(step[:, n], step[:, n + 1]) * window.size / fit.parameters[:, BLUR]
    step = np.where(((both - without > _SEEN) & (steep < _STEEPEST))[:, None], step[:, :n], 0.0)
    parameters = fit.parameters.copy()
    parameters[:, :n] += step
    return replace(fit, q=fit.q + step[:, :2], parameters=parameters)


def _asked(mark: Mark, geometry: Geometry, fit: Fit, window: Window) -> tuple[Array, Array, Array, Normal]:
    """Return the decrease of chi-square (B,) by a nonlinear response and by motion, and parameters with the motion.

    And the normal equations at the fit, of all parameters.

    For motions too short to matter, or too long for a mark, the decrease is 0. A motion of l px towards the angle a
    adds l^2/24 (1 + cos 2(n - a)) to the variance of the blur across a border whose normal is at n. The round part is
    already in the blur; the rest changes the picture, to first order, by l^2/(48 s) cos 2(n - a) times its derivative
    by the blur s.
    """
    whole = mark_model(mark, geometry, loose=MOVED)

    def directed(parameters: Array, pixels: Array, weight: Array | None = None) -> tuple[Array, Array]:
        value, J = whole(parameters, pixels, weight)  # whose derivatives by a motion are 0 without one
        x, y = J[..., 0].copy(), J[..., 1].copy()  # along the normal
        xx, yy = x * x, y * y
        by_blur = J[..., BLUR] / np.maximum(xx + yy, 1e-12)
        J[..., -2], J[..., -1] = by_blur * (xx - yy), by_blur * (2 * x * y)
        return value, J

    n = geometry.free + BENT
    (bend, both), step, normal = missed(directed, fit, window, free=(n, n + 2))
    begin, s = fit.parameters.copy(), fit.parameters[:, BLUR]
    l2 = 48 * s * np.hypot(step[:, n], step[:, n + 1])
    turn = np.arctan2(step[:, n + 1], step[:, n]) / 2
    begin[:, geometry.motion] = np.sqrt(l2)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    begin[:, BLUR] = np.sqrt(np.maximum(s * s - l2 / 24, (_SHARPEST * s) ** 2))
    likely = (l2 > (_LONG * s) ** 2) & (l2 < (_LONGEST * window.size) ** 2)
    return bend, np.where(likely, both - bend, 0.0), begin, normal
