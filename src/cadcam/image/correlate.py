"""Template search in any orientation: peaks of the normalised correlation, to a fraction of a pixel.

The search runs on means of blocks of pixels (`Template.coarsest`), at every position and orientation; the best of its
maxima climb, on finer and finer levels, to the peak of the normalised correlation in position, angle and, if asked for,
scale. The climb is inverse compositional (S. Baker and I. Matthews, Lucas-Kanade 20 years on, IJCV 2004) on the
correlation coefficient, so that gain and offset of the grey levels do not matter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Locked, Mask, Picture, frozen
from cadcam.errors import BadValue
from cadcam.image.match_covariance import peak_covariances
from cadcam.image.pyramid import Pyramid
from cadcam.image.template import Template
from cadcam.kinds import expect, expect_count, expect_numbers, expect_positive
from cadcam.native.correlate import registered, searched

_FULL_TURN = (-math.pi, math.pi)
_FINER = 2.5  # ratio from level to level
_SMOOTHED = 0.1  # by how much a correlation may rise from fine to coarse pixels and still be kept
_ROUGH, _SETTLED = 0.03, 0.001  # px of a level: last step of a climb, between levels and at the end
_MORE = 64  # times as many maxima are refined where those left out might hold the best peak
_LEAST_BETWEEN = 0.5  # of what an exact match may lose between pixels: with more, it is noise, and nothing is ruled out
_MOST_NEAR = 1024  # of maxima that might yet be the best and climb on
_MOST = 2e12  # products of a search: some 40 s of one core with AVX2
# Steps of a climb, at most; along what a picture hardly shows they are many. Peaks of this share of the best score
# climb to their end; lower ones, mostly false, would take most of the time.
_STEPS, _TO_THE_END, _HIGH = 8, 40, 0.8
# times that a peak beyond the outline is sought inside: by half as far each, of an edge that meets it at 45 deg
_INWARDS = 4
_REACH, _LEAST_REACH = 0.25, 3.0  # how far a climb may go: share of the template, and px of a level, at least


@dataclass(frozen=True, slots=True)
class CorrelateOptions:
    """What is searched for.

    angles: range (rad), from the picture's x axis towards its y axis; scales: least and largest. count: peaks to
    return; least_score: of a peak, 0 to 1. apart: peaks nearer than this share of the template's smaller side, and
    rotated by less than as many radians, are one. either_sign: a template of reversed contrast matches as well.
    least_contrast: least standard deviation of the grey levels under a match. candidates: coarse maxima that are
    refined; 64 times as many where one left out might become the best peak, as in large pictures.
    """

    angles: tuple[float, float] = _FULL_TURN
    scales: tuple[float, float] = (1.0, 1.0)
    count: int = 3
    least_score: float = 0.4
    apart: float = 0.3
    either_sign: bool = False
    least_contrast: float = 0.004
    candidates: int = 256

    def __post_init__(self) -> None:
        expect_numbers(self)
        if not 0 <= self.angles[1] - self.angles[0] <= 2 * math.pi + 1e-9:
            raise BadValue("angles", self.angles, "(from, to) in rad, at most a full turn")
        if not 0.1 <= self.scales[0] <= self.scales[1] <= 10:
            raise BadValue("scales", self.scales, "(least, largest) between 0.1 and 10")
        expect_count(self.count, "count")
        expect_count(self.candidates, "candidates")
        if not 0 < self.least_score <= 1:
            raise BadValue("least_score", self.least_score, "a number above 0, at most 1")
        expect_positive(self.apart, "apart", "a number above 0")
        expect_positive(self.least_contrast, "least_contrast", "a number from 0 on", zero=True)

    @property
    def motions(self) -> int:
        """Return how many motions are free: two shifts and a rotation, and the scale where it has a range."""
        return 4 if self.scales[1] > self.scales[0] else 3


ANY_ANGLE = CorrelateOptions()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Peaks(Locked):
    """Peaks of the normalised correlation, best first.

    q (N, 2) px: the template's centre; angle (N,) rad from the picture's x towards its y axis; scale (N,); score (N,)
    in [-1, 1]; covariance (N, 4, 4) of (x, y, angle, scale), from the grey levels that the template does not explain;
    of what it does not show, as the place along an edge, that of anywhere searched. complete: whether no
    maximum of the coarse search was dropped that could have become a better first peak.
    """

    q: Array
    angle: Array
    scale: Array
    score: Array
    covariance: Array
    complete: bool = True

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.score))
        shapes = {"q": (n, 2), "angle": (n,), "scale": (n,), "score": (n,), "covariance": (n, 4, 4)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen(getattr(self, name), f"peaks' {name}", shape))

    def __len__(self) -> int:
        return len(self.score)

    def __repr__(self) -> str:
        if not len(self):
            return "Peaks(none)"
        x, y = self.q[0]
        best = f"score {self.score[0]:.3f} at ({x:.2f}, {y:.2f}) px, turned by {np.degrees(self.angle[0]):.2f} deg"
        return f"Peaks({len(self)}, the best: {best}, scale {self.scale[0]:.4g})"

    @property
    def gap(self) -> Array:
        """Return by how much (N,) each peak's |score| exceeds that of the next one; nan for the last."""
        return np.append(-np.diff(np.abs(self.score)), np.nan)[: len(self)]

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (N, 4) of x, y (px), angle (rad) and scale."""
        return np.asarray(np.sqrt(np.einsum("nii->ni", self.covariance)))

    def at(self, uv: Array) -> Array:
        """Return where (N, M, 2) px template points (M, 2), in px from its centre, lie for each peak."""
        c, s = self.scale * np.cos(self.angle), self.scale * np.sin(self.angle)
        R = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        return np.asarray(self.q[:, None] + np.asarray(uv, np.float64) @ np.swapaxes(R, -1, -2))


def correlate(gray: npt.ArrayLike, template: Template, *, options: CorrelateOptions = ANY_ANGLE) -> Peaks:
    """Return the best peaks of a template in a grey picture (H, W) in [0, 1]; empty if there are none.

    The template must lie in the picture, to one pixel. Where nothing reaches least_score, the search is repeated once
    with finer pixels, unless that takes minutes (`complete` is then false). Raises `BadValue`, also for a search that
    itself takes minutes, and `MissingCore` where cadcam was installed without its C core.
    """
    expect(template, "template", Template)
    expect(options, "options", CorrelateOptions)
    picture = Pyramid(gray)
    factor = template.coarsest()
    if _products(picture, template, factor, options) > _MOST:
        _refuse_endless(picture, template, factor, options)
    peaks = _search(picture, template, factor, options)
    finer = max(1, round(factor / 1.7))
    if not len(peaks) and factor > 1:
        if _products(picture, template, finer, options) > _MOST:
            return replace(peaks, complete=False)
        peaks = _search(picture, template, finer, options)
    return peaks


def _products(picture: Pyramid, template: Template, factor: int, options: CorrelateOptions) -> float:
    """Return how many products the search at a level takes."""
    return template.effort(factor, options.angles, options.scales) * picture.size[0] * picture.size[1] / factor**2


def _refuse_endless(picture: Pyramid, template: Template, factor: int, options: CorrelateOptions) -> NoReturn:
    (width, height), (w, h) = picture.size, template.size
    why = "whose pixels differ from one to the next, as noise does" if factor < 4 else "at many angles and scales"
    takes = f"takes {_products(picture, template, factor, options):.1g} products, at most {_MOST:.0g} are made"
    raise BadValue(
        "template",
        f"{w} x {h} px, {why}: to search {width} x {height} px {takes}",
        "a template with structure several px wide, fewer angles or scales (--angles, --scales), or a picture cut out"
        " around where it may be",
    )


def register(
    gray: npt.ArrayLike, template: Template, start: npt.ArrayLike, *, options: CorrelateOptions = ANY_ANGLE
) -> Peaks:
    """Return the peaks near starts (N, 4): x, y (px), angle (rad), scale; lost ones and duplicates are left out."""
    picture = Pyramid(gray)
    poses = np.array(start, np.float64).reshape(-1, 4)
    for level in _levels(template.coarsest()):
        poses, score = _refined(picture, template, level, poses, options.motions)
        poses = poses[score != 0]
    return _peaks(picture, template, poses, options)


def _search(picture: Pyramid, template: Template, factor: int, options: CorrelateOptions) -> Peaks:
    found, worst = _searched(picture, template, factor, options), template.worst(factor)
    poses, _, left = found.maxima(options.candidates)
    keep = 8 * (options.count + 1)
    peaks, lost = _climbed(picture, template, factor, poses, options, keep=keep)
    best = _best_score(peaks, options)
    if left > worst * best:
        poses, coarse, left = found.maxima(_MORE * options.candidates)
        poses = poses[coarse > worst * best]
        keep = max(keep, len(poses))
    elif lost <= best:
        return peaks
    peaks, lost = _climbed(picture, template, factor, poses, options, keep=keep, rival=best)
    best = _best_score(peaks, options)
    return replace(peaks, complete=left <= worst * best and lost <= best)


def _best_score(peaks: Peaks, options: CorrelateOptions) -> float:
    return float(np.abs(peaks.score[:1]).max(initial=options.least_score))


def _climbed(
    picture: Pyramid,
    template: Template,
    factor: int,
    poses: Array,
    options: CorrelateOptions,
    *,
    keep: int,
    rival: float = math.inf,
) -> tuple[Peaks, float]:
    """Return the peaks that maxima of a level, best first, climb to, and the most that one left behind might reach.

    keep: how many climb on to the next level; more where more might yet reach the score `rival`, as where the picture
    shows the same thing many times: coarse pixels do not tell which of them is the best.
    """
    turned = poses[: max(64, len(poses) // 4)]
    twins = template.twins(factor) if options.angles == _FULL_TURN else np.zeros(0)
    poses = np.concatenate([poses, *(turned + np.array([0, 0, turn, 0]) for turn in twins)])
    poses[:, 2] = _wrapped(poses[:, 2])
    lost = 0.0
    for level in _levels(factor):
        poses, score = _refined(picture, template, level, poses, options.motions)
        between = max(template.between(level), _LEAST_BETWEEN)
        near = np.count_nonzero((np.abs(score) if options.either_sign else score) >= between * rival)
        most = max(keep, min(int(near), _MOST_NEAR))
        poses, score, left = _best_apart(template, poses, score, options, most, options.least_score - _SMOOTHED)
        lost = max(lost, min(left / between, 1.0))
        keep = max(keep // 4, options.count + 1)
    return _peaks(picture, template, poses, options), lost


def _levels(factor: int) -> Iterator[int]:
    """Yield the levels from the coarsest to single pixels."""
    while factor > 1:
        yield factor
        factor = max(1, round(factor / _FINER))
    yield 1


@dataclass(frozen=True, slots=True, eq=False)
class _Coarse:
    """The search at a level: best correlation and its orientation at each position, in a margin.

    motions: angle and scale of each orientation; least: correlation of what is worth a climb; alike: rad below which
    neighbours are one maximum.
    """

    best: Picture
    which: Ids
    motions: Array
    least: float
    alike: float
    factor: int
    margin: int

    def maxima(self, most: int) -> tuple[Array, Array, float]:
        """Return at most as many maxima, best first: poses (N, 4) in px of the picture, scores; the best score left."""
        least = _threshold(self.best, self.least, 8 * most)
        at = _maxima(self.best, self.which, self.motions[:, 0], least, self.alike)
        score = self.best.ravel()[at].astype(np.float64)
        left = float(score[most]) if len(at) > most else least if least > self.least else 0.0
        y, x = np.divmod(at[:most], self.best.shape[1])
        q = (np.stack([x, y], axis=1) + 0.5 - self.margin) * self.factor - 0.5  # from the centre of a block
        return np.concatenate([q, self.motions[self.which.ravel()[at[:most]]]], axis=1), score[:most], left


def _searched(picture: Pyramid, template: Template, factor: int, options: CorrelateOptions) -> _Coarse:
    oriented, motions = template.orientations(factor, options.angles, options.scales)
    margin = 1 + oriented.spare  # one that lies in the picture as it is turned, where others would not, is searched for
    plane = np.pad(picture.level(factor), margin, mode="edge")
    best, which = searched(plane, oriented, least_variance=options.least_contrast**2, either_sign=options.either_sign)
    least = 0.8 * template.worst(factor) * options.least_score
    return _Coarse(best, which, motions, least, 2.5 * template.step(factor), factor, margin)


def _threshold(best: Picture, least: float, most: int) -> float:
    """Return `least`, or the score that `most` positions reach if more reach `least`."""
    if best.size <= most:
        return least
    return max(least, float(np.partition(best.ravel(), best.size - most)[best.size - most]))


def _maxima(best: Picture, which: Ids, angles: Array, least: float, alike: float) -> npt.NDArray[np.intp]:
    """Return the flat indices, best first, of maxima that no neighbour of similar angle exceeds."""
    width = best.shape[1]
    score, number = best.ravel(), which.ravel()
    inner = np.zeros(best.shape, bool)
    inner[1:-1, 1:-1] = best[1:-1, 1:-1] > least
    at = np.flatnonzero(inner)
    for step in (-1, 1, -width, width, -width - 1, -width + 1, width - 1, width + 1):
        higher = score[at + step] > score[at]
        same = ~_turned(angles[number[at + step]], angles[number[at]], alike)
        at = at[~(higher & same)]
    order: npt.NDArray[np.intp] = np.argsort(-score[at], kind="stable")
    return at[order]


def _refined(
    picture: Pyramid,
    template: Template,
    factor: int,
    poses: Array,
    motions: int,
    *,
    cubic: bool = False,
    iterations: int = _STEPS,
) -> tuple[Array, Array]:
    """Return poses (px of the picture) climbed to their peaks at a level, and the correlation there."""
    if not len(poses):
        return poses, np.zeros(0)
    local = poses.copy()
    local[:, :2] = (local[:, :2] + 0.5) / factor - 0.5
    local, score = registered(
        picture.level(factor),
        template.settling(motions) if cubic else template.points(factor, motions),
        local,
        cubic=cubic,
        iterations=iterations,
        settled=_SETTLED if cubic else _ROUGH,
        reach=max(_LEAST_REACH, _REACH * min(template.size) / factor),
    )
    local[:, :2] = (local[:, :2] + 0.5) * factor - 0.5
    return local, score


def _best_apart(
    template: Template, poses: Array, score: Array, options: CorrelateOptions, count: int, least: float
) -> tuple[Array, Array, float]:
    """Return the best poses that differ in place or angle, best first; and the best score of another one, or 0."""
    size = np.abs(score) if options.either_sign else score
    order = np.argsort(-size, kind="stable")
    order = order[(size[order] >= least) & (size[order] > 0)]  # 0: lost on the way
    x, y, angle = poses[order, :3].T.copy()
    near = options.apart * min(template.size)
    free = np.ones(len(order), bool)
    kept: list[int] = []
    while len(kept) < count and free.any():
        k = int(free.argmax())
        kept.append(int(order[k]))
        dx, dy = x - x[k], y - y[k]
        free &= (dx * dx + dy * dy >= near * near) | _turned(angle, angle[k], options.apart)
        free[k] = False
    left = float(size[order[free.argmax()]]) if free.any() else 0.0
    return poses[kept], score[kept], left


def _peaks(picture: Pyramid, template: Template, poses: Array, options: CorrelateOptions) -> Peaks:
    """Return the peaks near poses, by cubic interpolation."""
    refined = partial(_refined, picture, template, 1, cubic=True)
    poses, score = refined(poses, options.motions)
    high = (np.abs(score) >= _HIGH * np.abs(score).max(initial=0.0)) & (score != 0)
    poses[high], score[high] = refined(poses[high], options.motions, iterations=_TO_THE_END)
    for _ in range(_INWARDS):  # along an edge that runs out of the picture it is as good inside
        out = np.flatnonzero(high & (score != 0))
        out = out[~_in_picture(poses[out], template, picture.level(1))]
        poses[out, :2] -= _overhang(poses[out], template, picture.level(1))
        poses[out], score[out] = refined(poses[out], options.motions)
    poses, score, _ = _best_apart(template, poses, score, options, len(poses), options.least_score)
    allowed = _within(poses, template, options) & _in_picture(poses, template, picture.level(1))
    poses, score = poses[allowed][: options.count], score[allowed][: options.count]
    poses[:, 2] = _wrapped(poses[:, 2])
    plane, points = picture.level(1), template.settling(options.motions)
    range_of = _searched_over(picture, template, options)

    def climb(starts: Array, steps: int, free: int) -> tuple[Array, Array]:
        there, worth = refined(starts, free, iterations=steps)
        return there, np.where(_in_picture(there, template, plane), worth, 0.0)

    covariance = peak_covariances(plane, points, poses, score, range_of, climb)
    return Peaks(poses[:, :2], poses[:, 2], poses[:, 3], score, covariance)


def _searched_over(picture: Pyramid, template: Template, options: CorrelateOptions) -> Array:
    """Return over how many px in x and y, rad, and shares of the scale a template is looked for."""
    step = template.step(template.coarsest())
    turn, growth = options.angles[1] - options.angles[0], math.log(options.scales[1] / options.scales[0])
    return np.array([*picture.size, min(turn + step, 2 * math.pi), growth + step])


def _within(poses: Array, template: Template, options: CorrelateOptions) -> Mask:
    """Return which poses have angles and scales in the range asked for, within the reach of a climb."""
    slack = 0.5 * template.step(template.coarsest())
    low, high = options.angles
    turned = np.abs(_wrapped(poses[:, 2] - 0.5 * (low + high))) <= 0.5 * (high - low) + slack
    scale = np.abs(np.log(poses[:, 3]) - 0.5 * math.log(options.scales[0] * options.scales[1]))
    return np.asarray(turned & (scale <= 0.5 * math.log(options.scales[1] / options.scales[0]) + slack))


def _in_picture(poses: Array, template: Template, picture: Picture) -> Mask:
    return np.asarray((np.abs(_overhang(poses, template, picture)) <= 1).all(axis=1))


def _overhang(poses: Array, template: Template, picture: Picture) -> Array:
    """Return by how many px (N, 2) in x and y the template lies beyond the picture's outermost pixels; 0 within."""
    points = template.points(1, 3)
    u, v = points.u[: points.count], points.v[: points.count]
    extent = np.array([[a, b] for a in (u.min(), u.max()) for b in (v.min(), v.max())], np.float64)
    corners = extent if template.mask.all() else np.stack([u, v], axis=1).astype(np.float64)
    c, s = (poses[:, 3] * f(poses[:, 2]) for f in (np.cos, np.sin))
    x = poses[:, :1] + c[:, None] * corners[:, 0] - s[:, None] * corners[:, 1]
    y = poses[:, 1:2] + s[:, None] * corners[:, 0] + c[:, None] * corners[:, 1]
    h, w = picture.shape
    beyond = [
        np.minimum(a.min(axis=1), 0) + np.maximum(a.max(axis=1) - last, 0) for a, last in ((x, w - 1), (y, h - 1))
    ]
    return np.stack(beyond, axis=1)


def _turned(a: Array, b: Array | float, by: float) -> Mask:
    """Return whether angles (rad, at most a turn apart) differ by at least `by`."""
    apart = np.abs(a - b)
    return np.asarray((apart >= by) & (apart <= 2 * math.pi - by))


def _wrapped(angle: Array) -> Array:
    """Return angles (rad) in [-pi, pi)."""
    return np.asarray((angle + math.pi) % (2 * math.pi) - math.pi)
