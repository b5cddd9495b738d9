"""A template to be found in pictures, prepared for every pixel size that the search uses.

Level `factor` works on means over factor x factor px, of the template and of the picture. The preparation is done once
per template and kept, so that many pictures can be searched.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture, frozen
from cadcam.errors import BadValue
from cadcam.image.picture import to_gray
from cadcam.image.profile import noise_of
from cadcam.native.correlate import Orientations, Points

LEAST_POINTS = 25  # fewest pixels that count: fewer match anywhere
_TAPS = 90  # pixels of the coarsest level: with fewer, the picture resembles the template too often
_RIM = 0.85  # px of a level that the template's rim moves between two orientations
_SMEARED = 0.55  # least correlation, at a level, between a template and itself half a step off in every motion
_TWIN = 0.5  # correlation from which a rotated template is equivalent to itself
# H. Farid and E. Simoncelli, Differentiation of discrete multidimensional signals, 2004: a slope, and the mean across;
# of noise they keep an eighth of what central differences do
_DERIVED = (-0.104550, -0.292315, 0.0, 0.292315, 0.104550)
_ACROSS = (0.037659, 0.249153, 0.426375, 0.249153, 0.037659)
_STANDS_OUT = 5.0  # sigma of a slope: of a million pixels of noise, 4 have a steeper one
_RIM_PX, _ROOM = 2, 16  # px: reach of these; least side of a template that has a rim to spare
_INSIDE = 0.99  # share of a block's pixels that must count


class Template:
    """A grey template (h, w) in [0, 1]; its origin is its centre ((w - 1)/2, (h - 1)/2).

    mask (h, w): which pixels count, by default all. Raises `BadValue` for one that is too small or without contrast.
    """

    def __init__(self, gray: npt.ArrayLike, *, mask: npt.ArrayLike | None = None) -> None:
        self.gray: Picture = frozen(to_gray(gray), "template", (None, None), np.float32)
        whole = np.ones(self.gray.shape, bool)
        self.mask: Mask = frozen(whole if mask is None else mask, "mask", self.gray.shape, bool)
        count, spread = int(self.mask.sum()), float(np.std(self.gray[self.mask])) if self.mask.any() else 0.0
        if count < LEAST_POINTS:
            raise BadValue("template", f"{count} pixels that count", f"at least {LEAST_POINTS}")
        if spread < 1e-4:
            raise BadValue("template", f"flat (standard deviation {spread:.1g})", "one with contrast: corners, texture")
        self._sum = _integral(np.where(self.mask, self.gray, self.gray[self.mask].mean()))
        self._counted = _integral(self.mask.astype(np.float64))
        self._points: dict[tuple[int, int], Points] = {}
        self._orientations: dict[tuple[object, ...], tuple[Orientations, Array]] = {}
        self._twins: dict[int, Array] = {}
        self._worst: dict[int, float] = {}
        self._between: dict[int, float] = {}
        self._coarsest = 0  # unknown yet
        self.round_radius: float = self._round_radius()

    def __repr__(self) -> str:
        counted = "" if self.mask.all() else f", {self.mask.mean():.0%} of them count"
        return f"Template({self.size[0]} x {self.size[1]} px{counted})"

    @property
    def size(self) -> tuple[int, int]:
        """Return (width, height) in px."""
        return self.gray.shape[1], self.gray.shape[0]

    def structured(self) -> int:
        """Return how many of the pixels that count lie on a border or texture: their slope stands out of the noise."""
        of_noise = noise_of(self.gray) * math.hypot(*_DERIVED) * math.hypot(*_ACROSS)
        slope = np.hypot(*_smooth_slopes(self.gray))
        return int(np.count_nonzero(self.mask & (slope > _STANDS_OUT * of_noise)))

    def _round_radius(self) -> float:
        """Return the radius in px of the disc about the centre that counts throughout; 0 if it holds too little."""
        y, x = np.indices(self.mask.shape) - (np.array(self.mask.shape) - 1)[:, None, None] / 2
        distance = np.hypot(x, y)
        outside = distance[~self.mask].min(initial=np.inf)
        radius = float(min(outside - 0.5, min(self.mask.shape) / 2))
        return radius if math.pi * radius**2 >= 0.6 * self.mask.sum() else 0.0

    def coarsest(self) -> int:
        """Return the largest factor at which the template is still distinguishable from its surroundings."""
        if not self._coarsest:
            factor = max(1, math.isqrt(int(self.mask.sum()) // _TAPS))
            while factor > 1 and (self._taps(factor) < _TAPS or self.worst(factor) < _SMEARED):
                factor -= 1
            self._coarsest = factor
        return self._coarsest

    def worst(self, factor: int) -> float:
        """Return the least correlation at a level of the template with itself half a pixel and half a step off."""
        if factor not in self._worst:
            self._worst[factor] = self._least_when_off(factor)
        return self._worst[factor]

    def _least_when_off(self, factor: int) -> float:
        dx, dy = _disc(self._reach(factor))
        inside = self._inside(dx, dy, 0.0, 1.0, factor)
        dx, dy = dx[inside], dy[inside]
        if len(dx) < 9:
            return 0.0
        half = 0.5 * self.step(factor)
        at_rest = self._values(dx, dy, 0.0, 1.0, factor)
        off = np.array([[0.5, 0.5, half], [0.5, -0.5, -half], [-0.5, 0.5, -half], [-0.5, -0.5, half]])[..., None]
        moved = self._values(dx + off[:, 0], dy + off[:, 1], off[:, 2], 1.0, factor)
        return min(_correlation(at_rest, other) for other in moved)

    def between(self, factor: int) -> float:
        """Return the correlation at a level of the template with itself read midway between pixels.

        An exact match has at least about that much there, wherever the picture's blocks of pixels lie.
        """
        if factor not in self._between:
            dx, dy = _disc(self._reach(factor))
            inside = self._inside(dx, dy, 0.0, 1.0, factor)
            dx, dy = dx[inside], dy[inside]
            about = [self._values(dx + x, dy + y, 0.0, 1.0, factor) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
            at_rest = self._values(dx, dy, 0.0, 1.0, factor)
            self._between[factor] = _correlation(at_rest, np.mean(about, axis=0)) if len(dx) else 0.0
        return self._between[factor]

    def effort(self, factor: int, angles: tuple[float, float], scales: tuple[float, float]) -> float:
        """Return how many products a search at a level takes for each of its pixels: orientations times taps."""
        reach = self._reach(factor) * max(scales)
        return len(_motions(self.step(factor), angles, scales)) * max(1.0, math.pi * reach**2)

    def step(self, factor: int) -> float:
        """Return the angle (rad) between two orientations at a level; also the logarithm of the ratio of two scales."""
        return _RIM / max(self._reach(factor), 1.0)

    def orientations(
        self, factor: int, angles: tuple[float, float], scales: tuple[float, float]
    ) -> tuple[Orientations, Array]:
        """Return the template on the grid of a level at all angles and scales, and these (K, 2); computed once."""
        key = (factor, angles, scales)
        if key not in self._orientations:
            self._orientations[key] = self._oriented(factor, _motions(self.step(factor), angles, scales))
        return self._orientations[key]

    def points(self, factor: int, motions: int) -> Points:
        """Return the template's points at a level, in its px, with derivatives by 3 (shifts, rotation) or 4 motions."""
        if (factor, motions) not in self._points:
            self._points[factor, motions] = self._made_points(factor, motions)
        return self._points[factor, motions]

    def settling(self, motions: int) -> Points:
        """Return single pixels as `points` does, with slopes of little noise: for the last climb, and what it is worth.

        The slopes of `points` hold all the noise. With it a template is found again that was cut out of the same
        picture; but along what a template hardly shows, its noise counts as structure, and climbs end before the peak.
        """
        if (0, motions) not in self._points:
            y, x = np.nonzero(self.mask)
            slope, full = ((gx[y, x], gy[y, x]) for gx, gy in (_smooth_slopes(self.gray), _slopes(self.gray)))
            u, v = self._from_centre(x, y)
            beside = _neighbours(self.gray)[y, x]
            self._points[0, motions] = _normalised(u, v, self.gray[y, x], slope, motions, full=full, beside=beside)
        return self._points[0, motions]

    def twins(self, factor: int) -> Array:
        """Return the rotations (rad), other than none, that leave the template much the same."""
        if factor not in self._twins:
            oriented, poses = self.orientations(factor, (-math.pi, math.pi), (1.0, 1.0))
            alike = oriented.weight @ oriented.weight[0]
            peak = (alike >= np.roll(alike, 1)) & (alike > np.roll(alike, -1)) & (alike > _TWIN)
            turn = poses[:, 0] - poses[0, 0]
            away = np.minimum(turn, 2 * math.pi - turn) > 2.5 * self.step(factor)
            self._twins[factor] = turn[peak & away]
        return self._twins[factor]

    def _taps(self, factor: int) -> int:
        dx, dy = _disc(self._reach(factor))
        return int(self._inside(dx, dy, 0.0, 1.0, factor).sum())

    def _reach(self, factor: int) -> float:
        """Return the radius in px of a level within which its taps lie."""
        if self.round_radius:
            return (self.round_radius - factor / 2) / factor
        y, x = np.nonzero(self.mask)
        h, w = self.mask.shape
        return float(np.hypot(x - (w - 1) / 2, y - (h - 1) / 2).max()) / factor

    def _oriented(self, factor: int, motions: Array) -> tuple[Orientations, Array]:
        dx, dy = _disc(self._reach(factor) * float(motions[:, 1].max()))
        angle, scale = motions[:, :1], motions[:, 1:]
        inside = self._inside(dx, dy, angle, scale, factor)
        used = inside.any(axis=0)
        dx, dy, inside = dx[used], dy[used], inside[:, used]
        weight = self._values(dx, dy, angle, scale, factor) * inside
        weight -= inside * (weight.sum(axis=1) / np.maximum(inside.sum(axis=1), 1))[:, None]
        weight /= np.maximum(np.linalg.norm(weight, axis=1), 1e-12)[:, None]
        masks = inside[:1] if (inside == inside[0]).all() else inside
        return Orientations.of(dx, dy, weight, masks), motions

    def _template_px(
        self, dx: Array, dy: Array, angle: float | Array, scale: float | Array, factor: int
    ) -> tuple[Array, Array]:
        """Return where in the template (px) the offsets (px of a level) lie when it is rotated and scaled."""
        c, s = factor * np.cos(angle) / scale, factor * np.sin(angle) / scale
        h, w = self.gray.shape
        return c * dx + s * dy + (w - 1) / 2, -s * dx + c * dy + (h - 1) / 2

    def _values(self, dx: Array, dy: Array, angle: float | Array, scale: float | Array, factor: int) -> Array:
        return _mean_about(self._sum, *self._template_px(dx, dy, angle, scale, factor), factor / scale)

    def _inside(self, dx: Array, dy: Array, angle: float | Array, scale: float | Array, factor: int) -> Mask:
        """Return which offsets count: within the round part if there is one, else those covered by the mask."""
        if self.round_radius:
            return np.asarray(np.hypot(dx, dy) <= self._reach(factor) * scale + 0 * angle)
        return _mean_about(self._counted, *self._template_px(dx, dy, angle, scale, factor), factor / scale) >= _INSIDE

    def _made_points(self, factor: int, motions: int) -> Points:
        if factor == 1:
            y, x = np.nonzero(self.mask)
            gx, gy = _slopes(self.gray)
            return _normalised(*self._from_centre(x, y), self.gray[y, x], (gx[y, x], gy[y, x]), motions)
        h, w = self.gray.shape
        v, u = (a.ravel() for a in np.meshgrid(_centres(h, factor), _centres(w, factor), indexing="ij"))
        x, y = u * factor + (w - 1) / 2, v * factor + (h - 1) / 2
        kept = _mean_about(self._counted, x, y, factor) >= _INSIDE
        if kept.sum() < LEAST_POINTS:
            kept = _mean_about(self._counted, x, y, factor) > 0.5
        u, v, x, y = u[kept], v[kept], x[kept], y[kept]
        return _normalised(u, v, _mean_about(self._sum, x, y, factor), self._slopes_at(x, y, factor), motions)

    def _from_centre(self, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp]) -> tuple[Array, Array]:
        h, w = self.gray.shape
        return x - (w - 1) / 2, y - (h - 1) / 2

    def _slopes_at(self, x: Array, y: Array, factor: int) -> tuple[Array, Array]:
        """Return the template's slope per px of a level, by central differences within it."""

        def between(axis: int, last: int) -> Array:
            at = (x, y)[axis]
            before, after = np.maximum(at - 1, 0), np.minimum(at + 1, last)
            places = [(p, y) if axis == 0 else (x, p) for p in (before, after)]
            ends = [_mean_about(self._sum, px, py, factor) for px, py in places]
            return np.asarray((ends[1] - ends[0]) / np.maximum(after - before, 1e-9) * factor)

        h, w = self.gray.shape
        return between(0, w - 1), between(1, h - 1)


def _slopes(gray: Picture) -> tuple[Array, Array]:
    """Return the slopes (h, w) per px by x and y: differences, central within."""
    values = gray.astype(np.float64)
    return np.asarray(np.gradient(values, axis=1)), np.asarray(np.gradient(values, axis=0))


def _smooth_slopes(gray: Picture) -> tuple[Array, Array]:
    """Return the slopes (h, w) per px by x and y, smoothed, of the picture mirrored at its outline; none at the rim."""
    from scipy.ndimage import correlate1d

    def along(axis: int) -> Array:
        across = correlate1d(gray.astype(np.float64), _ACROSS, axis=1 - axis, mode="mirror")
        return _within_rim(np.asarray(correlate1d(across, _DERIVED, axis=axis, mode="mirror")))

    return along(1), along(0)


def _neighbours(gray: Picture) -> Array:
    """Return the mean (h, w) of the eight pixels about each, of the picture mirrored at its outline."""
    from scipy.ndimage import uniform_filter

    values = gray.astype(np.float64)
    return np.asarray((9 * uniform_filter(values, 3, mode="mirror") - values) / 8)


def _within_rim(slope: Array) -> Array:
    """Return slopes without those at the rim, unless a template has hardly any others.

    Differences to one side alone hold the rim's own noise, which pulls the scale as a true edge does; those of a
    picture mirrored there turn the edges that run out of it.
    """
    return np.pad(slope[_RIM_PX:-_RIM_PX, _RIM_PX:-_RIM_PX], _RIM_PX) if min(slope.shape) >= _ROOM else slope


def _normalised(
    u: Array,
    v: Array,
    value: npt.NDArray[np.floating],
    slope: tuple[Array, Array],
    motions: int,
    *,
    full: tuple[Array, Array] | None = None,
    beside: Array | None = None,
) -> Points:
    """Return points of zero mean and unit norm, with slopes by shifts, rotation, scale beside gain and offset.

    slope: by x and y, with which a picture is compared; full: that of what it shows there, where it is another. beside:
    what resembles the value but has not its noise. By it the gain of a picture is what it is; by the value itself it is
    too small by the share of the noise, and a motion that adds contrast would make up for that.
    """
    off = value.astype(np.float64) - value.mean(dtype=np.float64)
    length = max(float(np.linalg.norm(off)), 1e-12)
    unit = off / length
    J = _by_motions(u, v, slope, motions) / length
    J = J - J.mean(axis=1, keepdims=True)
    like = unit if beside is None else beside - beside.mean()
    J = J - ((J @ unit) / (like @ unit))[:, None] * like
    return Points.of(u, v, unit, J, seen=None if full is None else _by_motions(u, v, full, motions) / length)


def _by_motions(u: Array, v: Array, slope: tuple[Array, Array], motions: int) -> Array:
    """Return the slopes (m, N) by shifts, rotation and scale of those by x and y."""
    gx, gy = slope
    return np.stack([gx, gy, gy * u - gx * v, gx * u + gy * v][:motions])


def _disc(radius: float) -> tuple[Array, Array]:
    """Return the offsets (dx, dy) of the pixels whose centres lie in a disc about one of them."""
    n = math.floor(radius)
    dy, dx = (a.ravel().astype(np.float64) for a in np.mgrid[-n : n + 1, -n : n + 1])
    kept = np.hypot(dx, dy) <= radius
    return dx[kept], dy[kept]


def _centres(length: int, factor: int) -> Array:
    """Return the centres of the blocks of a level relative to the template's centre, in its px."""
    n = max(length // factor, 1)
    return np.asarray(np.arange(n) - (n - 1) / 2, np.float64)


def _motions(step: float, angles: tuple[float, float], scales: tuple[float, float]) -> Array:
    """Return (angle, scale) (K, 2) such that any in the ranges is at most half a step from one of them."""
    turn, stretch = angles[1] - angles[0], math.log(scales[1] / scales[0])
    if turn >= 2 * math.pi - 1e-9:
        n = math.ceil(2 * math.pi / step)
        angle = angles[0] + np.arange(n) * (2 * math.pi / n)
    else:
        angle = np.linspace(angles[0], angles[1], math.ceil(turn / step) + 1)
    scale = scales[0] * np.exp(np.linspace(0, stretch, math.ceil(stretch / step) + 1))
    return np.stack(np.meshgrid(angle, scale, indexing="ij"), axis=-1).reshape(-1, 2)


def _integral(values: npt.NDArray[np.floating]) -> Array:
    """Return the sums (h + 1, w + 1) over all pixels above and to the left."""
    out = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    out[1:, 1:] = np.cumsum(np.cumsum(values, axis=0, dtype=np.float64), axis=1)
    return out


def _mean_about(integral: Array, x: Array, y: Array, side: float | Array) -> Array:
    """Return the mean over squares of a side (px) about points, treating pixels as squares; 0 beyond the picture."""
    h, w = integral.shape
    left, right = (np.clip(x + 0.5 + d, 0, w - 1) for d in (-side / 2, side / 2))
    top, bottom = (np.clip(y + 0.5 + d, 0, h - 1) for d in (-side / 2, side / 2))
    total = _at(integral, right, bottom) - _at(integral, left, bottom) - _at(integral, right, top)
    return np.asarray((total + _at(integral, left, top)) / side**2)


def _at(integral: Array, x: Array, y: Array) -> Array:
    width, flat = integral.shape[1], integral.ravel()
    i, j = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), integral.shape[0] - 2)
    a, b, at = x - i, y - j, j * width + i
    upper, lower = (flat.take(k) + a * (flat.take(k + 1) - flat.take(k)) for k in (at, at + width))
    return np.asarray(upper + b * (lower - upper))


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12))
