"""Marks fitted to the grey values: position, shape, levels and blur together, with a covariance for each mark.

One damped Gauss-Newton iteration runs over all marks of a picture at once, in arrays (marks, pixels, parameters). Where
the model is true of the picture (blurred edges, uniform noise), the position is the maximum-likelihood estimate. Both
models are point-symmetric about the position, so that blur of any symmetric shape, gain and offset do not bias it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from cadcam.arrays import Array, Index, Mask, Picture
from cadcam.cores import on_cores

CONTRAST, BLUR = 4, 5  # columns of these parameters in either model
_GROUND = (6, 7, 8)  # columns of m, gx, gy
_BATCH = 200_000  # elements of a Jacobian computed at a time, so that intermediate results stay in the cache
ITERATIONS = 25  # of a fit, at most
_STEP_PX, _FALL = 1e-4, 1e-3  # converged: smaller shifts, and a relative decrease of the sum of squares below this
_MOST_DAMPING = 1e7  # at which no step reduces the cost any more


class Model(Protocol):
    """The picture that parameters (B, n) predict at pixels (B, P, 2 or more)."""

    def __call__(self, parameters: Array, pixels: Array, weight: Array | None = None, /) -> tuple[Array, Array]:
        """Return grey values (B, P) and derivatives (B, P, n or fewer); anything finite where weight (B, P) is 0."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """B fitted marks: positions q (B, 2) px, covariance (B, 2, 2) px^2, parameters (B, n), and how well they fit.

    misfit: rms of the residuals over the mark's contrast; good: whether the fit ended inside its window, with contrast.
    shared: variance of x if the pixels of a line share errors, relative to that for independent pixels.
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

    The columns after u, v are whatever else a model needs to know of a pixel.
    """

    values: Array
    pixels: Array
    weight: Array

    def part(self, which: Index | slice) -> WindowPixels:
        """Return the pixels of the windows that `which` selects."""
        return WindowPixels(self.values[which], self.pixels[which], self.weight[which])


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """J^T J (B, n, n), J^T r (B, n) and r^T r (B,) of B windows' residuals r."""

    H: Array
    g: Array
    cost: Array

    def part(self, which: Index | slice, free: int | None = None) -> Normal:
        """Return those of the windows that `which` selects; free: of so many parameters, the first."""
        return Normal(self.H[which, :free, :free], self.g[which, :free], self.cost[which])


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
    level = (values * weight).sum(axis=1) / n
    start[:, _GROUND[0]] = level
    sign = _corner(start + np.eye(9)[CONTRAST], pixels)[0] - level[:, None]
    start[:, CONTRAST] = (sign * values * weight).sum(axis=1) / np.maximum((sign**2 * weight).sum(axis=1), 1e-9)
    fit = fitted(_corner, start, WindowPixels(values, pixels, weight), q, reach)
    return replace(fit, good=fit.good & whole(weight, wanted))


def fit_discs(gray: Picture, q: Array, moments: Array, reach: Array) -> Fit:
    """Return the centres of the ellipses near q (B, 2): of the discs' *images*, not the images of their centres.

    moments (B, 2, 2): second moments of each ellipse's area, px^2; reach (B,): the window's size in units of the
    ellipse. Model: m + g.(u, v) + c Phi(-d/s) with d the distance from the ellipse w^T A w = 1 to first order.
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
    start[:, BLUR] = 1.0
    inside, outside = (rho2 < 1) & (weight > 0), (rho2 >= 1) & (weight > 0)
    level = (values * outside).sum(axis=1) / np.maximum(outside.sum(axis=1), 1)
    start[:, _GROUND[0]] = level
    start[:, CONTRAST] = (values * inside).sum(axis=1) / np.maximum(inside.sum(axis=1), 1) - level
    fit = fitted(_disc, start, WindowPixels(values, pixels, weight), q, minor)
    return replace(fit, good=fit.good & whole(weight, wanted))


def _corner(parameters: Array, pixels: Array, _: Array | None = None) -> tuple[Array, Array]:
    """Return the grey values (B, P) of the model of `fit_corners`, and their derivatives (B, P, 9)."""
    x, y, angle1, angle2, contrast, blur = (parameters[:, None, i] for i in range(6))
    u, v = pixels[..., 0] - x, pixels[..., 1] - y
    step1, d1, slope1 = _blurred_step(u, v, angle1, blur)
    step2, d2, slope2 = _blurred_step(u, v, angle2, blur)
    by_d1, by_d2 = contrast * slope1 * step2, contrast * slope2 * step1
    ground, J = _ground(parameters, pixels)
    J[..., 0] = -(by_d1 * np.sin(angle1) + by_d2 * np.sin(angle2))
    J[..., 1] = by_d1 * np.cos(angle1) + by_d2 * np.cos(angle2)
    J[..., 2] = by_d1 * (u * np.cos(angle1) + v * np.sin(angle1))
    J[..., 3] = by_d2 * (u * np.cos(angle2) + v * np.sin(angle2))
    J[..., CONTRAST] = step1 * step2
    J[..., BLUR] = -(by_d1 * d1 + by_d2 * d2) / blur
    return np.asarray(ground + contrast * step1 * step2), J


def _blurred_step(u: Array, v: Array, angle: Array, blur: Array) -> tuple[Array, Array, Array]:
    """Return the blurred step across an edge, from -1 to 1, the distance d from the edge, and the derivative by d."""
    from scipy.special import erf

    d = u * np.sin(angle) - v * np.cos(angle)
    t = d / blur
    return erf(t * np.sqrt(0.5)), d, np.sqrt(2 / np.pi) * np.exp(-0.5 * t * t) / blur


def _disc(parameters: Array, pixels: Array, _: Array | None = None) -> tuple[Array, Array]:
    """Return the grey values (B, P) of the model of `fit_discs`, and their derivatives (B, P, 10)."""
    from scipy.special import ndtr

    x, y, A11, A12, contrast, blur = (parameters[:, None, i] for i in range(6))
    A22 = parameters[:, None, 9]
    u, v = pixels[..., 0] - x, pixels[..., 1] - y
    a, b = A11 * u + A12 * v, A12 * u + A22 * v  # A w
    radius = np.sqrt(np.maximum(u * a + v * b, 1e-12))  # sqrt(w^T A w): 1 on the ellipse
    norm = np.sqrt(np.maximum(a * a + b * b, 1e-12))  # |A w|; the gradient of `radius` is A w / radius
    d = (radius - 1) * radius / norm
    t = d / blur
    by_d = -contrast * np.exp(-0.5 * t * t) / (np.sqrt(2 * np.pi) * blur)

    def derivative(of_radius: Array, of_norm: Array) -> Array:
        """Return the derivative of the grey values from those of radius and norm: the chain rule through d."""
        return np.asarray(by_d * ((2 * radius - 1) * of_radius / norm - d * of_norm / norm))

    ground, J = _ground(parameters, pixels)
    J[..., 0] = derivative(-a / radius, -(a * A11 + b * A12) / norm)
    J[..., 1] = derivative(-b / radius, -(a * A12 + b * A22) / norm)
    J[..., 2] = derivative(u * u / (2 * radius), a * u / norm)
    J[..., 3] = derivative(u * v / radius, (a * v + b * u) / norm)
    J[..., 9] = derivative(v * v / (2 * radius), b * v / norm)
    inside = ndtr(-t)
    J[..., CONTRAST], J[..., BLUR] = inside, -by_d * t
    return ground + contrast * inside, J


def _ground(parameters: Array, pixels: Array) -> tuple[Array, Array]:
    """Return the ground m + g.(u, v) of either model (B, P), and a Jacobian with its columns set, the others zero."""
    level, by_x, by_y = (parameters[:, None, i] for i in _GROUND)
    ground = level + by_x * pixels[..., 0] + by_y * pixels[..., 1]
    J = np.zeros((*ground.shape, parameters.shape[1]))
    J[..., _GROUND[0]] = 1.0
    J[..., _GROUND[1]], J[..., _GROUND[2]] = pixels[..., 0], pixels[..., 1]
    return ground, J


def whole(weight: Array, wanted: Mask) -> Mask:
    """Return whether the windows lie nearly wholly in the picture."""
    return np.asarray(weight.sum(axis=1) > 0.7 * wanted.sum(axis=1))


def patches(gray: Picture, q: Array, reach: Array, step: int = 1) -> tuple[Array, Array, Mask]:
    """Return grey values (B, P), their pixels relative to q (B, P, 2), and which of them are inside the picture.

    step: every how many rows and columns are used.
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
    model: Model,
    start: Array,
    window: WindowPixels,
    q: Array,
    size: Array,
    *,
    iterations: int = ITERATIONS,
    begun: Normal | None = None,
) -> Fit:
    """Return the fit of a model whose first two parameters are x, y relative to q; size (B,): largest shift, px.

    Parameters without a derivative in the model are held fixed. iterations: at most. begun: the normal equations at the
    start, where they are known.
    """
    count, n = start.shape
    step = max(1, _BATCH // max(n * window.values.shape[1], 1))
    parts = [slice(i, i + step) for i in range(0, max(count, 1), step)]

    def part(at: slice) -> tuple[Array, Array, Array]:
        known = None if begun is None else begun.part(at)
        return _minimised(model, start[at], window.part(at), iterations=iterations, begun=known)

    each = on_cores(part, parts)
    parameters, covariance, cost = (np.concatenate(column) for column in zip(*each, strict=True))
    rms = np.sqrt(cost / np.maximum(window.weight.sum(axis=1), 1))
    misfit = rms / np.maximum(np.abs(parameters[:, CONTRAST]), 1e-9)
    good = np.isfinite(parameters).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    good &= np.hypot(parameters[:, 0], parameters[:, 1]) < 0.5 * size
    good &= parameters[:, BLUR] < size
    return Fit(q + parameters[:, :2], covariance[:, :2, :2], parameters, misfit, good, np.ones(count))


def missed(model: Model, fit: Fit, window: WindowPixels, *, free: tuple[int, ...]) -> tuple[Array, Array, Normal]:
    """Return the decrease of chi-square (F, B) to expect if the first `free` (F) parameters of the model were free.

    The step (B, n) for the last entry of `free`, and the normal equations. A score test: to first order from the fit
    without them, in units of the variance that would then remain.
    """
    H, g, cost = _normal(model, fit.parameters, window)
    normal = Normal(H, g, cost)
    scale = 1 / np.sqrt(np.maximum(np.einsum("bii->bi", H), 1e-300))
    H, g = _scaled(H, scale), g * scale
    steps = [-(np.linalg.pinv(H[:, :n, :n], rcond=1e-12, hermitian=True) @ g[:, :n, None])[..., 0] for n in free]
    falls = np.stack([-(g[:, :n] * step).sum(axis=1) for n, step in zip(free, steps, strict=True)])
    left = np.maximum(cost - falls[-1], 1e-3 * cost) / np.maximum(window.weight.sum(axis=1) - free[-1], 1.0)
    return np.asarray(falls / np.maximum(left, 1e-300)), np.asarray(steps[-1] * scale), normal


def _minimised(
    model: Model, start: Array, window: WindowPixels, *, iterations: int, begun: Normal | None
) -> tuple[Array, Array, Array]:
    """Return parameters, their covariance and sum of squares: Levenberg-Marquardt, each mark with its own damping."""
    state, damping = start.copy(), np.full(len(start), 1e-3)
    H, g, cost = _normal(model, state, window) if begun is None else (begun.H.copy(), begun.g.copy(), begun.cost.copy())
    n = H.shape[1]
    active = np.arange(len(start))
    for _ in range(iterations):
        step = _damped_step(H[active], g[active], damping[active])
        trial = state[active]
        trial[:, :n] += step
        trial[:, BLUR] = np.abs(trial[:, BLUR]).clip(0.2, 50.0)
        H_trial, g_trial, cost_trial = _normal(model, trial, window.part(active))
        better = cost_trial <= cost[active]
        converged = better & (np.hypot(step[:, 0], step[:, 1]) < _STEP_PX) & (cost_trial > (1 - _FALL) * cost[active])
        won = active[better]
        state[won], H[won], g[won], cost[won] = trial[better], H_trial[better], g_trial[better], cost_trial[better]
        damping[active] = np.where(better, damping[active] / 5, damping[active] * 8).clip(1e-9, 1e9)
        active = active[~converged & (damping[active] < _MOST_DAMPING)]
        if not active.size:
            break
    variance = cost / np.maximum(window.weight.sum(axis=1) - n, 1.0)
    return state, variance[:, None, None] * _cofactor(H), cost


def _damped_step(H: Array, g: Array, damping: Array) -> Array:
    D = np.einsum("bii->bi", H)
    damped = H + np.eye(H.shape[1]) * (damping[:, None] * D + 1e-12)[:, None, :]
    return np.asarray(-np.linalg.solve(damped, g[:, :, None])[..., 0])


def _cofactor(H: Array) -> Array:
    """Return the inverses of normal matrices (B, n, n), or the pseudo-inverse where the rank is deficient."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("bii->bi", H), 1e-300))
    inverse = np.asarray(np.linalg.pinv(_scaled(H, scale), rcond=1e-12, hermitian=True), np.float64)
    return _scaled(inverse, np.asarray(scale.clip(max=1e6)))  # limited for parameters that no pixel depends on


def _scaled(H: Array, scale: Array) -> Array:
    return np.asarray(H * scale[:, :, None] * scale[:, None, :])


def _normal(model: Model, state: Array, window: WindowPixels) -> tuple[Array, Array, Array]:
    """Return J^T J, J^T r and r^T r of each window's weighted residuals r."""
    with np.errstate(all="ignore"):
        predicted, J = model(state, window.pixels, window.weight)
    r = (predicted - window.values) * window.weight
    J *= window.weight[..., None]
    if not (np.isfinite(r).all() and np.isfinite(J).all()):
        r, J = np.nan_to_num(r, nan=1e3, posinf=1e3, neginf=1e3), np.nan_to_num(J)
    Jt = np.swapaxes(J, 1, 2)
    return Jt @ J, (Jt @ r[..., None])[..., 0], np.sum(r * r, axis=1)
