"""Brightness steps across a line: their positions to a small fraction of a pixel, and the uncertainty of these.

The step is fitted to the pixels themselves, in a cell along the line: nothing is interpolated, so the noise stays
independent and its effect on the position is known. The model is a step blurred by a Gaussian, on ground of a different
slope on either side,

    I(d) = a + b (d - r(d)) + e r(d) + c Phi(d / s),   r(d) = d Phi(d / s) + s phi(d / s),

linear in all but the position of the step, for which g = dI/d(position) = -c phi(d / s) / s is the last column: one
linear fit, right to first order where the line is near the step, and exact once it lies on it. The slopes matter:
light reflected between the faces of an inner corner bends the brightness on each side, and a step alone would follow
it. They also increase the noise of the position most: each is held near zero according to its prior variance (a ridge).
Another line of the model in the cell, the far border of a thin plate, is one more step at a known place.

A white pixel says that the light was at least that: it is left out. How high a step up to white is, and so where it
is, follows from the blurred rest of it; taken as what it looks like, it would lie too far on the dark side, by up to
the blur. Noise makes some pixels white of a side that is not. Without them it would look darker than it is; so rows of
pixels along the line are white, by their means (`native/step.c`).

Bound: with everything but the position known, a cell of length L has variance 2 sqrt(pi) s sigma^2 / (c^2 L), the
Cramer-Rao bound; the fit reaches 1.1 times its root on wide cells with level ground, 1.6 with both slopes free.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Mask, Picture, quantile
from cadcam.native import profiles
from cadcam.native.profiles import StepCells

# Beyond these a pixel is clipped: white in a JPEG file ripples, by 2 % where its quality is 85.
DARK, BRIGHT = 0.002, 0.975
# Share of white pixels from which nothing tells the slope of a cell's white side; sd of that slope then, at least, 1/px
_WHITE, _BEYOND_WHITE = 0.1, 0.01
_ROWS = 48  # rows of a photo from which its noise is estimated
_SHARP = 0.8  # px: blur of a sharp photo
_BLURS = np.array([0.5, 0.7, 0.95, 1.3, 1.8, 2.5, 3.5])  # px, tried in `blur_of`
_USUAL = 1  # index of the blur that, with the next one, most lenses have
_FAINTEST = 0.025  # contrast of the faintest steps searched for
_SPREADS = (0.0, 0.7, 1.0, 1.4, 1.7)  # px, tried in `calming`
_CLEAR, _MUCH = 16.0, 0.12  # blur that depends on direction: least chi square, least change of its logarithm
_ACROSS = 0.05  # least share of cells across the others' direction for that to be decided
_TURNS = np.arange(8) * np.pi / 8
_TRIED = np.array([(a, b, t) for a in np.log(_BLURS) for b in np.log(_BLURS) if b >= a for t in _TURNS])
_AROUND = np.array(list(itertools.product((-0.5, 0.0, 0.5), repeat=3)))
_FIRST, _FINER = np.array([0.3, 0.3, np.pi / 8]), 6  # their spacing, and how often it is halved
_FEW = 8  # fewest cells from which the blur is estimated
_QUANTISED = 1.0 / 255 / math.sqrt(12.0)  # the least noise of an eight-bit photo
CANDIDATE_ROOM_PX = 4.0  # how far beyond a candidate its profile goes: the smoothing's kernel, and a place more


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """N fitted steps; nan where the cell leaves the picture.

    contrast (N,): brightness after the step minus before it, along the normal; moment (N,): -contrast times position;
    slopes (N, 2): of the ground before and after, brightness per px; noise (N,): sd of a pixel, from which sd_contrast
    (N,) and sd_moment (N,) follow. clipped (N,): share of black or white pixels.
    """

    contrast: Array
    moment: Array
    slopes: Array
    noise: Array
    sd_contrast: Array
    sd_moment: Array
    clipped: Array

    def without(self, which: Mask) -> Steps:
        """Return the steps with some (N,) of them unknown, nan."""
        known = np.where(which, np.nan, 1.0)
        c, g, noise = (a * known for a in (self.contrast, self.moment, self.noise))
        sd_c, sd_g = self.sd_contrast * known, self.sd_moment * known
        return Steps(c, g, self.slopes * known[:, None], noise, sd_c, sd_g, self.clipped)


@dataclass(frozen=True, slots=True, eq=False)
class StepSums:
    """Sums over the pixels of N cells: their steps, up to how strongly slopes are held."""

    sums: Array

    @property
    def white(self) -> Array:
        """Return the share (N,) of each cell's pixels that are white."""
        return 1 - self.sums[:, 0] / np.maximum(self.sums[:, profiles.STEP_ALL], 1)

    def solved(self, held: Array, *, noise: float = 0.0) -> Steps:
        """Return the steps.

        held (N, 2): variance of a pixel over that of the slopes below and above; 0 leaves a slope free and inf makes it
        0. noise: least sd of a pixel.
        """
        least = (max(noise, _QUANTISED) / _BEYOND_WHITE) ** 2 * (self.white > _WHITE)
        out = profiles.steps(self.sums, np.maximum(held, least[:, None]))
        c, g, _, _, noise_of_cell, Qcc, Qgg, _, clipped = out.T
        sd = np.maximum(noise_of_cell, max(noise, _QUANTISED))
        return Steps(c, g, out[:, 2:4], sd, sd * np.sqrt(Qcc), sd * np.sqrt(Qgg), clipped)


def step_sums(gray: Picture, cells: StepCells) -> StepSums:
    """Return the sums over the pixels of cells."""
    return StepSums(profiles.step_sums(gray, cells, dark=DARK, bright=BRIGHT))


def step_rests(
    gray: Picture, cells: StepCells, sums: StepSums, *, bins: int, width: float
) -> tuple[Array, Array, Array]:
    """Return the residuals of steps with free slopes in their cells, by distance from the line.

    For N cells: their sums and numbers of pixels (N, bins), in bins of `width` px centred at the line, and the variance
    (N,) of a pixel; brightness. sums: those of these cells.
    """
    return profiles.step_residuals(gray, cells, sums.sums, bright=BRIGHT, bins=bins, width=width)


def noise_of(gray: Picture) -> float:
    """Return the sd of a pixel's noise, from the median of a second difference that planes and straight edges cancel.

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


def blur_of(gray: Picture, q: Array, normal: Array, *, reach: Array, half_length: float) -> float:
    """Return the blur s (px) that fits the steps best in cells on strong edges; 0.8 where there are too few.

    reach (N,): how far the cells reach along the normal, both ways.
    """
    found = _Misfits(gray, q, normal, reach, half_length).best()[0]
    return found if np.isfinite(found) else _SHARP


def blur_matrix(gray: Picture, q: Array, normal: Array, *, reach: Array, half_length: float) -> Array:
    """Return the blur as a covariance B (2, 2) px^2: a step across the unit normal n is blurred by sqrt(n' B n).

    As by `blur_of`, equal in all directions, unless the cells clearly require a different blur in different directions
    (a score test): motion while the shutter is open.
    """
    misfits = _Misfits(gray, q, normal, reach, half_length)
    even, best = misfits.best()
    if not np.isfinite(even):
        even = _SHARP
    elif misfits.depends(best):
        return misfits.matrix()
    return even**2 * np.eye(2)


class _Misfits:
    """The residuals of steps of several blurs in their cells, as evidence of the blur.

    They vary far more from cell to cell than with the blur, and are largest in cells that no blur fits: so only the
    relative change in each cell is used.
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
        """Return the blur that fits all cells best, nan where there are too few, and the index of the nearest tried.

        Descends from an ordinary blur until the blurs on both sides fit worse.
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
        """Return whether the blur depends on the direction, significantly (a score test) and by much."""
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
    """Return the mean residuals (T,) of cells for blurs across an angle and along it, given as logarithms (T,).

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

    offset (N, K) px along the normal; slope (N, K) brightness per px, smoothed by 1 px.
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
    """Return where brightness steps along the normals within `reach` px, significantly above the noise.

    spread: sd (px) of the Gaussian by which the picture was smoothed; noise: of a pixel before that. clear: least slope
    of a step, in standard deviations by noise.
    """
    of_slope = slope_noise(noise, half_length, spread)
    offset, slope = profiles.candidates(
        gray, q, normal, half_length=half_length, reach=reach, least=max(clear * of_slope, 0.002), most=most
    )
    return StepCandidates(offset, slope)


def slope_noise(noise: float, half_length: float, spread: float) -> float:
    """Return the sd of a profile's slope due to noise, in a picture smoothed by a Gaussian of sd `spread` px.

    The profile is the mean over 2 half_length px along the line, smoothed by a Gaussian of 1 px across it.
    """
    across2, length = 1 + spread**2, max(2 * half_length, 1.0)
    along = length if spread == 0 else max(length, math.sqrt(4 * math.pi * (length**2 / 12 + spread**2)))
    return noise * math.sqrt(1 / (4 * math.sqrt(math.pi) * across2**1.5) / along)


def calming(noise: float) -> float:
    """Return the sd (px) of the Gaussian that must smooth a picture for steps of contrast _FAINTEST to stand out.

    0 where they do without. Steps of a sharp picture are 1 px wide, and those of a blurred one need it all the more.
    """
    for spread in _SPREADS:
        height = _FAINTEST / math.sqrt(2 * math.pi * (2 + spread**2))
        if height > 4 * slope_noise(noise, 2.0, spread):
            return spread
    return _SPREADS[-1]
