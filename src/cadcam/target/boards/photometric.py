"""Marks fitted to the grey values themselves: position, shape, levels and blur together, each mark with a covariance.

The same damped Gauss-Newton runs over all marks of a picture at once, arrays (marks, pixels, parameters). Where the
model is the picture's own (blurred edges, uniform noise) this is the maximum-likelihood position. Both models are
point-symmetric about the position, so that blur of any symmetric shape, gain and offset leave it unbiased.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from cadcam.arrays import Array, Index, Mask, Picture

Model: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]  # (parameters, pixels) -> grey values, their slopes

CONTRAST, BLUR = 4, 5  # their places among the parameters of either model
_TOGETHER = 200_000  # numbers of a Jacobian held at a time: what comes up on the way stays in the cache
_ITERATIONS = 25
_CLOSE, _LEVEL = 1e-4, 1e-3  # px: a step below it is the last, unless the squares still fall by this share
_STUCK = 1e7  # of the damping: no step goes down any more


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """B fitted marks: positions q (B, 2) px, covariance (B, 2, 2) px^2, parameters (B, n), and how well they fit.

    misfit: rms of the residuals by the mark's contrast; good: whether the fit ended inside its window, with a contrast.
    shared: variance of x, in which the pixels of a line stand together, by that of independent ones.
    """

    q: Array
    covariance: Array
    parameters: Array
    misfit: Array
    good: Mask
    shared: Array

    def subset(self, which: Index | slice) -> Fit:
        """Return the marks that `which` selects."""
        return Fit(*(getattr(self, name)[which] for name in Fit.__slots__))

    def replaced(self, part: Fit, which: Index) -> Fit:
        """Return the fits with those at `which` taken from `part`."""
        arrays = {name: getattr(self, name).copy() for name in Fit.__slots__}
        for name in arrays:
            arrays[name][which] = getattr(part, name)
        return Fit(**arrays)


@dataclass(frozen=True, slots=True, eq=False)
class WindowPixels:
    """Grey values (B, P) of B windows; their pixels (B, P, 2 or more), u, v relative to q (B, 2) first; weights (B, P).

    What follows u, v is what else a model wants to know of a pixel.
    """

    values: Array
    pixels: Array
    weight: Array

    def part(self, which: Index | slice) -> WindowPixels:
        """Return the pixels of the windows that `which` selects."""
        return WindowPixels(self.values[which], self.pixels[which], self.weight[which])


def fit_corners(gray: Picture, q: Array, directions: Array, reach: Array, *, blur: float = 1.0) -> Fit:
    """Return the crossings of two edges near q (B, 2): chessboard corners.

    directions (B, 2): the angles of the two edges, rad; reach (B,): the window's radius in px, less than the distance
    to any other edge; blur: a guess, px. Model: m + g.(u, v) + c erf(d1/(sqrt2 s)) erf(d2/(sqrt2 s)) with d the
    distance from either edge: the exact picture of a right-angled corner under a Gaussian blur s.
    Parameters: x y angle1 angle2 c s m gx gy.
    """
    values, pixels, there = patches(gray, q, reach)
    wanted = np.hypot(pixels[..., 0], pixels[..., 1]) <= reach[:, None]
    weight = (wanted & there).astype(np.float64)
    start = np.zeros((len(q), 9))
    start[:, 2:4] = directions
    start[:, BLUR] = blur
    n = weight.sum(axis=1)
    start[:, 6] = (values * weight).sum(axis=1) / n
    sign = _corner(start + np.eye(9)[4], pixels)[0] - start[:, 6:7]
    start[:, 4] = (sign * values * weight).sum(axis=1) / np.maximum((sign**2 * weight).sum(axis=1), 1e-9)
    fit = fitted(_corner, start, WindowPixels(values, pixels, weight), q, reach)
    return replace(fit, good=fit.good & whole(weight, wanted))


def fit_discs(gray: Picture, q: Array, moments: Array, reach: Array) -> Fit:
    """Return the centres of the ellipses near q (B, 2): the discs' *pictures*, not where their centres are seen.

    moments (B, 2, 2): second moments of each ellipse's area, px^2; reach (B,): the window, an ellipse as many times as
    large. Model: m + g.(u, v) + c Phi(-d/s) with d the distance from the ellipse w^T A w = 1 to first order.
    Parameters: x y A11 A12 c s m gx gy A22.
    """
    A = np.linalg.inv(4 * moments)
    minor, major = 2 * np.sqrt(np.linalg.eigvalsh(moments)).T
    values, pixels, there = patches(gray, q, reach * major)
    rho2 = np.einsum("bki,bij,bkj->bk", pixels, A, pixels)
    wanted = rho2 <= reach[:, None] ** 2
    weight = (wanted & there).astype(np.float64)
    start = np.zeros((len(q), 10))
    start[:, 2], start[:, 3], start[:, 9] = A[:, 0, 0], A[:, 0, 1], A[:, 1, 1]
    start[:, 5] = 1.0
    inside, outside = (rho2 < 1) & (weight > 0), (rho2 >= 1) & (weight > 0)
    start[:, 6] = (values * outside).sum(axis=1) / np.maximum(outside.sum(axis=1), 1)
    start[:, 4] = (values * inside).sum(axis=1) / np.maximum(inside.sum(axis=1), 1) - start[:, 6]
    fit = fitted(_disc, start, WindowPixels(values, pixels, weight), q, minor)
    return replace(fit, good=fit.good & whole(weight, wanted))


def _corner(parameters: Array, pixels: Array) -> tuple[Array, Array]:
    x, y, a1, a2, c, s, m, gx, gy = (parameters[:, None, i] for i in range(9))
    u, v = pixels[..., 0] - x, pixels[..., 1] - y
    J = np.zeros((*u.shape, 9))
    (e1, d1, slope1), (e2, d2, slope2) = (_edge(u, v, a, s) for a in (a1, a2))
    across1, across2 = c * slope1 * e2, c * slope2 * e1  # by d1, by d2
    J[..., 0] = -(across1 * np.sin(a1) + across2 * np.sin(a2))
    J[..., 1] = across1 * np.cos(a1) + across2 * np.cos(a2)
    J[..., 2] = across1 * (u * np.cos(a1) + v * np.sin(a1))
    J[..., 3] = across2 * (u * np.cos(a2) + v * np.sin(a2))
    J[..., 4] = e1 * e2
    J[..., 5] = -(across1 * d1 + across2 * d2) / s
    J[..., 6], J[..., 7], J[..., 8] = 1.0, pixels[..., 0], pixels[..., 1]
    return np.asarray(m + gx * pixels[..., 0] + gy * pixels[..., 1] + c * e1 * e2), J


def _edge(u: Array, v: Array, angle: Array, s: Array) -> tuple[Array, Array, Array]:
    """Return the blurred step across an edge, the distance d from it, and the step's slope by d."""
    from scipy.special import erf

    d = u * np.sin(angle) - v * np.cos(angle)
    t = d / s
    return erf(t * np.sqrt(0.5)), d, np.sqrt(2 / np.pi) * np.exp(-0.5 * t * t) / s


def _disc(parameters: Array, pixels: Array) -> tuple[Array, Array]:
    from scipy.special import ndtr

    x, y, A11, A12, c, s, m, gx, gy, A22 = (parameters[:, None, i] for i in range(10))
    u, v = pixels[..., 0] - x, pixels[..., 1] - y
    a, b = A11 * u + A12 * v, A12 * u + A22 * v  # A w
    rho = np.sqrt(np.maximum(u * a + v * b, 1e-12))
    g = np.sqrt(np.maximum(a * a + b * b, 1e-12))
    d = (rho - 1) * rho / g  # the implicit function over its gradient
    t = d / s
    slope = -c * np.exp(-0.5 * t * t) / (np.sqrt(2 * np.pi) * s)

    def by(drho: Array, dg: Array) -> Array:
        return np.asarray(slope * ((2 * rho - 1) * drho / g - d * dg / g))

    J = np.zeros((*u.shape, 10))
    J[..., 0] = by(-a / rho, -(a * A11 + b * A12) / g)
    J[..., 1] = by(-b / rho, -(a * A12 + b * A22) / g)
    J[..., 2] = by(u * u / (2 * rho), a * u / g)
    J[..., 3] = by(u * v / rho, (a * v + b * u) / g)
    J[..., 9] = by(v * v / (2 * rho), b * v / g)
    cover = ndtr(-t)
    J[..., 4], J[..., 5] = cover, -slope * t
    J[..., 6], J[..., 7], J[..., 8] = 1.0, pixels[..., 0], pixels[..., 1]
    return m + gx * pixels[..., 0] + gy * pixels[..., 1] + c * cover, J


def whole(weight: Array, wanted: Mask) -> Mask:
    """Return whether the windows lie nearly wholly in the picture."""
    return np.asarray(weight.sum(axis=1) > 0.7 * wanted.sum(axis=1))


def patches(gray: Picture, q: Array, reach: Array, step: int = 1) -> tuple[Array, Array, Mask]:
    """Return grey values (B, P), their pixels relative to q (B, P, 2), and which of them the picture has.

    step: of the rows and columns that are taken.
    """
    half = int(np.ceil((reach.max(initial=1.0) + 1) / step)) * step
    side = np.arange(-half, half + 1, step)
    dx, dy = (d.ravel() for d in np.meshgrid(side, side))
    middle = np.rint(q).astype(np.int64)
    x, y = middle[:, :1] + dx, middle[:, 1:] + dy
    height, width = gray.shape
    there = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    pixels = np.stack([x - q[:, :1], y - q[:, 1:]], axis=-1)
    values = gray[y.clip(0, height - 1), x.clip(0, width - 1)].astype(np.float64)
    return values, pixels, np.asarray(there)


def fitted(
    model: Model, start: Array, window: WindowPixels, q: Array, size: Array, *, iterations: int = _ITERATIONS
) -> Fit:
    """Return the fit of a model whose first two parameters are x, y relative to q; size (B,): how far it may go, px.

    Parameters beyond those by which the model gives slopes are held. iterations: at most.
    """
    count, n = start.shape
    step = max(1, _TOGETHER // max(n * window.values.shape[1], 1))
    parts = [slice(i, i + step) for i in range(0, max(count, 1), step)]
    each = [_minimised(model, start[at], window.part(at), iterations=iterations) for at in parts]
    parameters, covariance, cost = (np.concatenate(column) for column in zip(*each, strict=True))
    rms = np.sqrt(cost / np.maximum(window.weight.sum(axis=1), 1))
    misfit = rms / np.maximum(np.abs(parameters[:, CONTRAST]), 1e-9)
    good = np.isfinite(parameters).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    good &= np.hypot(parameters[:, 0], parameters[:, 1]) < 0.5 * size
    good &= parameters[:, BLUR] < size
    return Fit(q + parameters[:, :2], covariance[:, :2, :2], parameters, misfit, good, np.ones(count))


def missed(model: Model, fit: Fit, window: WindowPixels, *, free: tuple[int, ...]) -> tuple[Array, Array]:
    """Return by how much chi-square (F, B) would fall with the first `free` parameters of the model free.

    And the step (B, n) of the last of those. To first order, from where the fit without them ended, by the variance
    that would be left then (a score test).
    """
    H, g, cost = _normal(model, fit.parameters, window)
    scale = 1 / np.sqrt(np.maximum(np.einsum("bii->bi", H), 1e-300))
    H, g = H * scale[:, :, None] * scale[:, None, :], g * scale
    steps = [-(np.linalg.pinv(H[:, :n, :n], rcond=1e-12, hermitian=True) @ g[:, :n, None])[..., 0] for n in free]
    falls = np.stack([-(g[:, :n] * step).sum(axis=1) for n, step in zip(free, steps, strict=True)])
    left = np.maximum(cost - falls[-1], 1e-3 * cost) / np.maximum(window.weight.sum(axis=1) - free[-1], 1.0)
    return np.asarray(falls / np.maximum(left, 1e-300)), np.asarray(steps[-1] * scale)


def _minimised(model: Model, start: Array, window: WindowPixels, *, iterations: int) -> tuple[Array, Array, Array]:
    """Return parameters, their covariance and sum of squares: Levenberg-Marquardt, a damping for each mark."""
    state, damping = start.copy(), np.full(len(start), 1e-3)
    H, g, cost = _normal(model, state, window)
    n = H.shape[1]
    going = np.arange(len(start))
    for _ in range(iterations):
        D = np.einsum("bii->bi", H[going])
        A = H[going] + np.eye(n) * (damping[going, None] * D + 1e-12)[:, None, :]
        step = -np.linalg.solve(A, g[going, :, None])[..., 0]
        trial = state[going]
        trial[:, :n] += step
        trial[:, BLUR] = np.abs(trial[:, BLUR]).clip(0.2, 50.0)
        H2, g2, cost2 = _normal(model, trial, window.part(going))
        better = cost2 <= cost[going]
        won = going[better]
        settled = better & (np.hypot(step[:, 0], step[:, 1]) < _CLOSE) & (cost2 > (1 - _LEVEL) * cost[going])
        state[won], H[won], g[won], cost[won] = trial[better], H2[better], g2[better], cost2[better]
        damping[going] = np.where(better, damping[going] / 5, damping[going] * 8).clip(1e-9, 1e9)
        going = going[~settled & (damping[going] < _STUCK)]
        if not going.size:
            break
    noise = cost / np.maximum(window.weight.sum(axis=1) - n, 1.0)
    scale = 1 / np.sqrt(np.maximum(np.einsum("bii->bi", H), 1e-300))
    cofactor = np.linalg.pinv(H * scale[:, :, None] * scale[:, None, :], rcond=1e-12, hermitian=True)
    scale = np.minimum(scale, 1e6)  # a parameter that the pixels do not see at all
    cofactor = cofactor * scale[:, :, None] * scale[:, None, :]
    return state, noise[:, None, None] * cofactor, cost


def _normal(model: Model, state: Array, window: WindowPixels) -> tuple[Array, Array, Array]:
    """Return J^T J, J^T r and r^T r of each window's weighted residuals r."""
    with np.errstate(all="ignore"):
        predicted, J = model(state, window.pixels)
    r = (predicted - window.values) * window.weight
    J *= window.weight[..., None]
    if not (np.isfinite(r).all() and np.isfinite(J).all()):
        r, J = np.nan_to_num(r, nan=1e3, posinf=1e3, neginf=1e3), np.nan_to_num(J)
    Jt = np.swapaxes(J, 1, 2)
    return Jt @ J, (Jt @ r[..., None])[..., 0], np.sum(r * r, axis=1)
