"""Where a photo shows a step of brightness across a line, to a small part of a pixel, and how sure that is.

The step is fitted to the pixels themselves, in a cell along the line: nothing is interpolated, so the noise stays
independent and its share in the position is known. The model is a step blurred by a Gaussian on ground of another
slope on either side,

    I(d) = a + b (d - r(d)) + e r(d) + c Phi(d / s),   r(d) = d Phi(d / s) + s phi(d / s),

linear in all but the position of the step, for which g = dI/d(position) = -c phi(d / s) / s is its last column: one
linear fit, right to first order where the line is near the step, and exact once it lies on it. The slopes matter:
light that bounces between the faces of an inner corner bends the brightness on each side, and a step alone would follow
it. They also cost most of what noise leaves: each is held near nil by how large it is known to be (a ridge). Another
line of the model in the cell, the far border of a thin plate, is one more step at a known place.

Bound: with everything but the position known, a cell of length L has variance 2 sqrt(pi) s sigma^2 / (c^2 L), the
Cramer-Rao bound; the fit reaches 1.1 times its root on wide cells with level ground, 1.6 with both slopes free.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Picture, quantile
from cadcam.native import profiles
from cadcam.native.profiles import StepCells

DARK, BRIGHT = 0.002, 0.998  # beyond these a pixel is clipped
_ROWS = 48  # rows of a photo that tell its noise
_BLURS = np.array([0.5, 0.7, 0.95, 1.3, 1.8, 2.5, 3.5])  # px, tried in `blur_of`
_USUAL = 1  # the blur of these, or the next, that most lenses have
_FAINTEST = 0.025  # contrast of steps that are looked for
_SPREADS = (0.0, 0.7, 1.0, 1.4, 1.7)  # px, tried in `calming`
_CLEAR, _MUCH = 16.0, 0.12  # of a blur that depends on direction: chi square, by how much its logarithm changes
_ACROSS = 0.05  # of the cells that run across the others at least, for that to be told
_TURNS = np.arange(8) * np.pi / 8
_TRIED = np.array([(a, b, t) for a in np.log(_BLURS) for b in np.log(_BLURS) if b >= a for t in _TURNS])
_AROUND = np.array(list(itertools.product((-0.5, 0.0, 0.5), repeat=3)))
_FIRST, _FINER = np.array([0.3, 0.3, np.pi / 8]), 6  # how far apart these are, halved so often
_FEW = 8  # cells that tell the blur at least
_QUANTISED = 1.0 / 255 / math.sqrt(12.0)  # the least noise of an eight-bit photo


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """N fitted steps; nan where the cell leaves the picture.

    contrast (N,): brightness after the step minus before it, along the normal; moment (N,): -contrast times position;
    slopes (N, 2): of the ground before and after, brightness a px; noise (N,): sd of a pixel. sd_contrast (N,) and
    sd_moment (N,) follow from it. clipped (N,): share of pixels that are black or white.
    """

    contrast: Array
    moment: Array
    slopes: Array
    noise: Array
    sd_contrast: Array
    sd_moment: Array
    clipped: Array


@dataclass(frozen=True, slots=True, eq=False)
class StepSums:
    """What the pixels of N cells add up to: their steps but for how firmly slopes are held."""

    sums: Array

    def solved(self, held: Array, *, noise: float = 0.0) -> Steps:
        """Return the steps.

        held (N, 2): variance of a pixel over that of the slopes below and above, 0 leaves a slope free and inf makes it
        nil. noise: least sd of a pixel.
        """
        out = profiles.steps(self.sums, held)
        c, g, _, _, noise_of_cell, Qcc, Qgg, _, clipped = out.T
        sd = np.maximum(noise_of_cell, max(noise, _QUANTISED))
        return Steps(c, g, out[:, 2:4], sd, sd * np.sqrt(Qcc), sd * np.sqrt(Qgg), clipped)


def step_sums(gray: Picture, cells: StepCells) -> StepSums:
    """Return what the pixels of cells add up to."""
    return StepSums(profiles.step_sums(gray, cells, dark=DARK, bright=BRIGHT))


def step_rests(
    gray: Picture, cells: StepCells, sums: StepSums, *, bins: int, width: float
) -> tuple[Array, Array, Array]:
    """Return what steps with free slopes leave over of their cells' pixels, by distance from the line.

    Of N cells: sums of it and numbers of pixels (N, bins), in bins of `width` px whose middle is at the line, and the
    variance (N,) of a pixel; brightness. sums: of these cells.
    """
    return profiles.step_residuals(gray, cells, sums.sums, bins=bins, width=width)


def noise_of(gray: Picture) -> float:
    """Return the sd of a pixel's noise, from the median of second differences that no plane or straight edge passes.

    The mask is that of J. Immerkaer, "Fast noise variance estimation", CVIU 64 (1996); the median instead of his mean
    keeps edges and texture out as long as they fill less than half of the picture.
    """
    height, width = gray.shape
    if min(height, width) < 3:
        return float(_QUANTISED)
    down_by, right_by = max(1, (height - 2) // _ROWS), max(1, (width - 2) // (4 * _ROWS))
    above, here, below = (gray[k : height - 2 + k : down_by].astype(np.float32, copy=False) for k in range(3))
    down = above - 2 * here + below
    left, middle, right = (down[:, k : width - 2 + k : right_by] for k in range(3))
    both = np.abs(left - 2 * middle + right)
    return max(quantile(both, 0.5) / 0.6745 / 6.0, _QUANTISED)


def blur_of(gray: Picture, q: Array, normal: Array, *, reach: Array, half_length: float, default: float = 0.8) -> float:
    """Return the blur s (px) at which steps fit best in cells that lie on strong edges; `default` where none do.

    reach (N,): how far the cells reach along the normal, both ways.
    """
    found = _Misfits(gray, q, normal, reach, half_length).best()[0]
    return found if np.isfinite(found) else default


def blur_matrix(
    gray: Picture, q: Array, normal: Array, *, reach: Array, half_length: float, default: float = 0.8
) -> Array:
    """Return the blur as a covariance B (2, 2) px^2: a step across the unit normal n is blurred by sqrt(n' B n).

    As `blur_of` tells it, alike in all directions, but where the cells clearly ask for another blur in one direction
    than in the other (a score test): motion while the shutter is open.
    """
    misfits = _Misfits(gray, q, normal, reach, half_length)
    even, best = misfits.best()
    if not np.isfinite(even):
        even = default
    elif misfits.depends(best):
        return misfits.matrix()
    return even**2 * np.eye(2)


class _Misfits:
    """What steps of several blurs leave over of their cells, and what that says of the blur.

    It varies far more from cell to cell than with the blur, and cells that no blur fits leave most: only by which share
    it changes is asked of each.
    """

    def __init__(self, gray: Picture, q: Array, normal: Array, reach: Array, half_length: float) -> None:
        self.gray, self.normal = gray, normal
        self.cells = StepCells(q, normal, reach, reach, half_length, float(_BLURS[0]))
        self.left = np.full((len(_BLURS), len(q)), np.nan)  # logarithms
        self.mean, self.asked = np.full(len(_BLURS), np.inf), set[int]()

    def ask(self, k: int) -> None:
        """Fit steps of the k-th blur."""
        self.asked.add(k)
        sums = step_sums(self.gray, replace(self.cells, blur=float(_BLURS[k])))
        found = profiles.steps(sums.sums, np.zeros((len(self.normal), 2)))[:, 4]
        self.left[k] = np.log(found + _QUANTISED)
        there = np.isfinite(found)
        self.mean[k] = np.mean(self.left[k, there]) if there.sum() >= _FEW else np.inf

    def best(self) -> tuple[float, int]:
        """Return the blur at which the cells fit best together, nan where there are too few, and the nearest tried.

        Downhill from an ordinary blur, until blurs to both sides fit worse.
        """
        ask = {_USUAL, _USUAL + 1} if len(self.normal) >= _FEW else set()
        while ask:
            for k in ask:
                self.ask(k)
            best = int(np.argmin(self.mean))
            ask = {max(best - 1, 0), min(best + 1, len(_BLURS) - 1)} - self.asked
        best = int(np.argmin(self.mean))
        if not np.isfinite(self.mean[best]):
            return np.nan, best
        return float(np.exp(parabola(np.log(_BLURS), self.mean, best))), best

    def depends(self, best: int) -> bool:
        """Return whether the blur depends on the direction, clearly (a score test) and by much."""
        if not 0 < best < len(_BLURS) - 1:
            return False
        near = slice(best - 1, best + 2)
        apart = np.diff(np.log(_BLURS[near]))
        falls, rises = np.diff(self.left[near], axis=0) / apart[:, None]
        slope, bend = 0.5 * (falls + rises), 2 * (rises - falls) / apart.sum()
        there = np.isfinite(slope)
        y, x = slope[there] - slope[there].mean(), self._doubled()[there]
        x = x - x.mean(axis=0)
        if not np.linalg.eigvalsh(x.T @ x)[0] > _ACROSS * len(x):
            return False
        score = x.T @ y
        if not np.linalg.norm(np.linalg.solve(x.T @ x, score)) > _MUCH * bend[there].mean():
            return False
        return bool(score @ np.linalg.pinv((x * (y**2)[:, None]).T @ x) @ score > _CLEAR)

    def matrix(self) -> Array:
        """Return the covariance (2, 2) px^2 at which the cells fit best."""
        for k in set(range(len(_BLURS))) - self.asked:
            self.ask(k)
        there = np.isfinite(self.left).all(axis=0)
        left, x = self.left[:, there], self._doubled()[there]
        far, tried = _FIRST, _TRIED
        for _ in range(_FINER):
            middle = tried[int(np.argmin(_misfits(left, x, *tried.T)))]
            tried, far = middle + far * _AROUND, 0.5 * far
            tried[:, :2] = np.clip(tried[:, :2], *np.log(_BLURS[[0, -1]]))
        across, along = np.exp(2 * middle[:2])
        d = np.array([np.cos(middle[2]), np.sin(middle[2])])
        return np.asarray(across * np.eye(2) + (along - across) * np.outer(d, d))

    def _doubled(self) -> Array:
        """Return cosine and sine (N, 2) of twice the normals' angles."""
        nx, ny = self.normal.T
        return np.stack([nx**2 - ny**2, 2 * nx * ny], axis=1)


def _misfits(left: Array, x: Array, across: Array, along: Array, angle: Array) -> Array:
    """Return what cells leave over on average (T,) by logarithms of the blur across an angle and along it (T,).

    left (B, N): of each cell by blur; x (N, 2): cosine and sine of twice the normals' angles.
    """
    share = 0.5 + 0.5 * np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=1) @ x.T
    small, large = np.exp(2 * across)[:, None], np.exp(2 * along)[:, None]
    place = np.interp(0.5 * np.log(small + (large - small) * share), np.log(_BLURS), np.arange(len(_BLURS)))
    k, cell = np.minimum(place.astype(int), len(_BLURS) - 2), np.arange(left.shape[1])
    return np.asarray(np.mean(left[k, cell] + (place - k) * (left[k + 1, cell] - left[k, cell]), axis=1))


def parabola(x: Array, y: Array, best: int) -> float:
    """Return where the parabola through the lowest of equally important places and its neighbours is lowest."""
    if not 0 < best < len(x) - 1 or not np.isfinite(y[best - 1 : best + 2]).all():
        return float(x[best])
    before, after = x[best] - x[best - 1], x[best + 1] - x[best]
    falls, rises = (y[best] - y[best - 1]) / before, (y[best + 1] - y[best]) / after
    bend = (rises - falls) / (before + after)
    shift = -0.5 * (falls + bend * before) / bend if bend > 0 else 0.0
    return float(x[best] + min(max(shift, -before), after))


@dataclass(frozen=True, slots=True, eq=False)
class StepCandidates:
    """Slopes along the normals of N samples, the strongest first; nan where there are no more.

    offset (N, K) px along the normal; slope (N, K) brightness a px, smoothed by 1 px.
    """

    offset: Array
    slope: Array


def step_candidates(
    gray: Picture,
    q: Array,
    normal: Array,
    *,
    half_length: float,
    reach: int,
    noise: float,
    most: int = 4,
    spread: float = 0.0,
    clear: float = 4.0,
) -> StepCandidates:
    """Return where brightness steps along the normals within `reach` px, clearly above the noise.

    spread: by which Gaussian (sd, px) the picture was smoothed; noise: of a pixel before that. clear: how many standard
    deviations of a slope by noise a step has at least.
    """
    of_slope = slope_noise(noise, half_length, spread)
    offset, slope = profiles.candidates(
        gray, q, normal, half_length=half_length, reach=reach, least=max(clear * of_slope, 0.002), most=most
    )
    return StepCandidates(offset, slope)


def slope_noise(noise: float, half_length: float, spread: float = 0.0) -> float:
    """Return the sd that noise gives the slope of a profile, of a picture smoothed by a Gaussian of sd `spread` px.

    The profile is the mean over 2 half_length px along the line, and smoothed by a Gaussian of 1 px across it.
    """
    across2, length = 1 + spread**2, max(2 * half_length, 1.0)
    along = length if spread == 0 else max(length, math.sqrt(4 * math.pi * (length**2 / 12 + spread**2)))
    return noise * math.sqrt(1 / (4 * math.sqrt(math.pi) * across2**1.5) / along)


def calming(noise: float) -> float:
    """Return by which Gaussian (sd, px) a picture is to be smoothed for steps of contrast _FAINTEST to stand out.

    0 where they do as it is. Steps of a sharp picture are 1 px wide, and those of a blurred one all the more in need.
    """
    for spread in _SPREADS:
        height = _FAINTEST / math.sqrt(2 * math.pi * (2 + spread**2))
        if height > 4 * slope_noise(noise, 2.0, spread):
            return spread
    return _SPREADS[-1]
