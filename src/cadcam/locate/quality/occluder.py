"""Things before the part: regions with straight borders that the photo shows, in which hardly any line of the part is.

A cover, an arm or a box hides all lines behind its border, and the border goes on beyond the part's outline. That tells
it from a model that is too long or misplaced: where the true part ends the lines of the model end at a border as well,
but that border ends with the part. Borders are straight in space, and are looked for as a camera without distortion
would see them. They are found by their edge points (R. Duda and P. Hart, Use of the Hough transformation to detect
lines and curves in pictures, CACM 15, 1972), each voting only for lines across its gradient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.edges import canny
from cadcam.locate.lines.sight import Sight
from cadcam.locate.quality.absent import LEAST
from cadcam.locate.quality.shown import near_px
from cadcam.locate.quality.support import ASKED, ShownLines, with_room

CONSTRAINTS = 2  # that a border meets by being chosen: its direction and place
_AROUND, _AROUND_PX = 0.4, 15.0  # how far from the part borders are looked for: share of its size, and px
_DIRECTIONS, _BIN_PX, _LEAST_POINTS = 64, 2.0, 15  # of the Hough transform
_MOST_PEAKS, _MOST_BORDERS = 60, 12
_ON_PX, _LIKE = (3.0, 2.0, 1.5), np.cos(np.radians(12))  # distance and direction of a border's points, round by round
_CELL_PX, _FILLED = 3.0, 0.6  # cells along a border; share of them that have an edge point where it is seen
_BEYOND, _BEYOND_PX = 0.15, 12.0  # how far it is followed beyond the part: share of its length before it, and px
_BEHIND, _CHANCES = 0.15, 1.2  # largest share of shown samples behind it: at least, and relative to that by chance
_MOST_BEHIND = 0.6  # largest share of all samples behind it
_CLEAR_PX = 1.5  # nearer to the border samples are left as they are
_ALONG = np.sin(np.radians(22.5))  # share of a direction from which it is named for an axis
_SIDES = {
    (1, 0): "right",
    (-1, 0): "left",
    (0, 1): "bottom",
    (0, -1): "top",
    (1, 1): "lower right",
    (1, -1): "upper right",
    (-1, 1): "lower left",
    (-1, -1): "upper left",
}


def covered(sights: Sequence[Sight], world_from_part: Rigid, scatter: float) -> tuple[list[Mask], int]:
    """Return of each sight which samples (N,) are behind occluders that the photos show, and how many borders in all.

    scatter: sd (px) of the common error of each edge.
    """
    near, behind, borders = near_px(sights, scatter), [], 0
    for sight in sights:
        its, count = _covered(sight, world_from_part, near, ASKED // len(sights))
        behind.append(its)
        borders += count
    return behind, borders


def side_words(sights: Sequence[Sight], world_from_part: Rigid, behind: Sequence[Mask]) -> str:
    """Return on which side of the part, as pictured, samples (N,) of each sight are: "right", "lower left" ...

    Of several photos, each in which there are some is named: "left (photo 'east'), top (photo 'west')".
    """
    said = []
    for sight, its in zip(sights, behind, strict=True):
        q = sight.project(world_from_part).q
        imaged = np.isfinite(q).all(axis=1)
        if not (its & imaged).any() or its[imaged].all():
            continue
        away = q[its & imaged].mean(axis=0) - 0.5 * (q[imaged].min(axis=0) + q[imaged].max(axis=0))
        x, y = (int(np.sign(d)) * bool(abs(d) > _ALONG * np.hypot(*away)) for d in away)
        name = f" (photo {sight.photo.viewpoint.name!r})" * (len(sights) > 1)
        said.append(_SIDES[x, y] + name)
    return ", ".join(said)


@dataclass(frozen=True, slots=True, eq=False)
class _Border:
    """A straight line normal @ q = level that the photo shows; along (n,) px: where on it edge points lie."""

    normal: Array
    level: float
    along: Array

    @classmethod
    def through(cls, q: Array) -> _Border:
        """Return the line of least squares through edge points (n, 2)."""
        middle = q.mean(axis=0)
        normal = np.linalg.svd(q - middle, full_matrices=False)[2][1]
        tangent = np.array([-normal[1], normal[0]])
        return cls(normal, float(middle @ normal), q @ tangent)

    def turned(self) -> _Border:
        """Return the same border with its other side in front."""
        return _Border(-self.normal, -self.level, -self.along)

    def beyond(self, q: Array) -> Array:
        """Return how far (n,) px places q (n, 2) are behind the border."""
        return np.asarray(q @ self.normal - self.level)

    def span(self, hull: Array) -> tuple[float, float]:
        """Return where (px along it) the border enters and leaves a convex outline (n, 2); nan where it does not."""
        d, further = self.beyond(hull), np.roll(hull, -1, axis=0)
        crossed = (d < 0) != (np.roll(d, -1) < 0)
        if crossed.sum() != 2:
            return np.nan, np.nan
        share = d[crossed] / (d - np.roll(d, -1))[crossed]
        t = (hull[crossed] + share[:, None] * (further - hull)[crossed]) @ self.tangent
        return float(t.min()), float(t.max())

    def clipped(self, span: tuple[float, float], by: _Border) -> tuple[float, float]:
        """Return the part of a span that lies behind another border; nan where none does."""
        across = float(by.normal @ self.tangent)
        cut = (by.level - self.level * float(by.normal @ self.normal)) / across if across else np.inf
        low, high = (max(span[0], cut), span[1]) if across > 0 else (span[0], min(span[1], cut))
        return (low, high) if low < high else (np.nan, np.nan)

    def filled(self, low: float, high: float) -> float:
        """Return the share of the cells between two places along the border that have an edge point."""
        n = max(int((high - low) / _CELL_PX), 1)
        cell = np.floor((self.along - low) / (high - low) * n)
        return len(np.unique(cell[(cell >= 0) & (cell < n)])) / n

    @property
    def tangent(self) -> Array:
        """Return its direction (2,)."""
        return np.array([-self.normal[1], self.normal[0]])


def _covered(sight: Sight, world_from_part: Rigid, near: float, most: int) -> tuple[Mask, int]:
    """Return which samples (N,) of a sight are behind an occluder, and how many borders that has."""
    none = np.zeros(len(sight.samples), bool)
    lines = ShownLines.of(with_room(sight, most), world_from_part, near)
    q = _straight(sight.photo.camera, lines.q)
    known = np.isfinite(q).all(axis=1)
    q, here = q[known], lines.here[known]
    if len(q) < 2 * LEAST:
        return none, 0
    region = _region(_borders(sight, lines.q), q, here, max(_BEHIND, _CHANCES * float(lines.share[1:].mean())))
    if not region:
        return none, 0
    at = _straight(sight.photo.camera, sight.project(world_from_part).q)
    with np.errstate(invalid="ignore"):
        return np.all([b.beyond(at) > _CLEAR_PX for b in region], axis=0), len(region)


def _straight(camera: Camera, q: Array) -> Array:
    """Return places (n, 2) px where a pinhole camera of the same focal length would see them; nan beyond its field."""
    ray = camera.unproject(q)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(ray[:, 2:] > 0, camera.fx * ray[:, :2] / ray[:, 2:], np.nan))


def _borders(sight: Sight, seen: Array) -> list[_Border]:
    """Return the straight lines that a photo shows around the part's, which are at seen (n, 2) px; longest first."""
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    pad = _AROUND * float((high - low).max()) + _AROUND_PX
    (x0, y0), (x1, y1) = np.maximum(low - pad, 0).astype(int), (high + pad).astype(int) + 1
    edges = canny(sight.photo.lines[y0:y1, x0:x1])
    side = 0.5 * np.column_stack([-edges.normal[:, 1], edges.normal[:, 0]])
    ends = [_straight(sight.photo.camera, edges.q + (x0, y0) + s * side) for s in (-1, 1)]
    along = ends[1] - ends[0]
    known = np.isfinite(along).all(axis=1)
    along, place = along[known], 0.5 * (ends[0] + ends[1])[known]
    normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.hypot(*along.T)[:, None]
    out: list[_Border] = []
    for direction, level in _peaks(place, normal):
        on = _near(place, normal, direction, level)
        if on.sum() >= _LEAST_POINTS:
            out.append(_Border.through(place[on]))
            place, normal = place[~on], normal[~on]  # a point belongs to one border
        if len(out) == _MOST_BORDERS:
            break
    return out


def _peaks(place: Array, normal: Array) -> list[tuple[Array, float]]:
    """Return lines (normal (2,), level px) on which many edge points (n, 2) of such normals lie, most first."""
    found: list[tuple[int, Array, float]] = []
    for angle in (np.arange(_DIRECTIONS) + 0.5) * np.pi / _DIRECTIONS:
        n = np.array([np.cos(angle), np.sin(angle)])
        level = place[np.abs(normal @ n) > np.cos(1.5 * np.pi / _DIRECTIONS)] @ n
        if len(level) < _LEAST_POINTS:
            continue
        lowest = np.floor(level.min())
        votes = np.bincount(((level - lowest) / _BIN_PX).astype(np.intp), minlength=2)
        votes = votes[1:] + votes[:-1]  # of two bins each, so that no line is cut by a bin's border
        best = np.flatnonzero(
            (votes >= _LEAST_POINTS) & (votes >= np.r_[0, votes[:-1]]) & (votes > np.r_[votes[1:], 0])
        )
        found += [(int(votes[k]), n, float(lowest + (k + 1) * _BIN_PX)) for k in best]
    found.sort(key=lambda peak: -peak[0])
    return [(n, level) for _, n, level in found[:_MOST_PEAKS]]


def _near(place: Array, normal: Array, n: Array, level: float) -> Mask:
    """Return which edge points (n, 2) lie on the line that is fitted to those near a rough one; none if too few do."""
    on = np.zeros(len(place), bool)
    for on_px in _ON_PX:
        on = np.asarray((np.abs(place @ n - level) < on_px) & (np.abs(normal @ n) > _LIKE))
        if on.sum() < _LEAST_POINTS:
            return on
        line = _Border.through(place[on])
        n, level = line.normal, line.level
    return on


def _region(borders: Sequence[_Border], q: Array, here: Mask, most: float) -> tuple[_Border, ...]:
    """Return the one or two borders behind both of which at most that share of the samples (n,) is shown.

    Those with most samples behind them, of all that the photo shows (`_shows`); empty where there are none.
    """
    from scipy.spatial import ConvexHull, QhullError

    sides = [s for b in borders for s in (b, b.turned())]
    try:
        hull = q[ConvexHull(q).vertices]
    except QhullError:  # a plate seen on its edge: all samples on one line
        return ()
    if not sides:
        return ()
    behind = np.array([b.beyond(q) > _CLEAR_PX for b in sides], np.float64)
    count, visible = behind @ behind.T, (behind * here) @ behind.T
    may_be = (count >= LEAST) & (visible <= most * count) & (count <= _MOST_BEHIND * len(q))
    pairs = np.argwhere(np.triu(may_be))
    for i, k in pairs[np.argsort(-count[tuple(pairs.T)], kind="stable")]:
        if _shows(sides[i], sides[k], hull):
            return (sides[i],) if i == k else (sides[i], sides[k])
    return ()


def _shows(one: _Border, other: _Border, hull: Array) -> bool:
    """Return whether the photo shows both borders where they bound the region, and that they go on beyond the part."""
    return all(_goes_on(b, c, hull) for b, c in {id(one): (one, other), id(other): (other, one)}.values())


def _goes_on(border: _Border, other: _Border, hull: Array) -> bool:
    """Return whether a border is seen before the part's outline, as far as it is behind the other, and beyond it."""
    whole = low, high = border.span(hull)
    if border is not other:
        low, high = border.clipped(whole, other)
    if not np.isfinite(low) or border.filled(low, high) < _FILLED:
        return False
    far = max(_BEYOND * (high - low), _BEYOND_PX)
    before = low == whole[0] and border.filled(low - far, low) >= _FILLED
    after = high == whole[1] and border.filled(high, high + far) >= _FILLED
    return before or after
