"""Candidate places and shapes of a mark in a picture: three searches, and a first screening of their results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Index, Picture
from cadcam.errors import BadValue
from cadcam.native.correlate import shrunken
from cadcam.target.boards.chess import corner_candidates
from cadcam.target.boards.circles import elliptic_blobs
from cadcam.target.boards.pyramid import reduced
from cadcam.target.marks.cross import cross, template
from cadcam.target.marks.fit import fit_marks, likeness
from cadcam.target.marks.mark import Mark
from cadcam.target.marks.spots import spots

METHODS = ("auto", "spots", "correlation", "blobs", "saddles")
_STEP = 1.3  # ratio of successive radii within a range
_WINDOWS = (0.08, 0.025, 0.25)  # of the picture's longer side, over which blobs are separated from their ground
_LEVELS = (1.0, 0.5, 0.25)
_LEAST_SIDE = 120  # px of a reduced picture
_LEAST_CORRELATION = 0.5
_NEAR = 0.85  # likeness at which a candidate is close enough without refinement
_LEAST_APPROACHED = 0.6  # score of a fit in a reduced picture
_LEAST_LIKENESS, _ROUGH_LIKENESS = 0.6, 0.2
_SOFT, _ROUGH_SOFT = 0.15, 0.3  # blur over radius of compared pictures while places are still inexact
_MANY, _SPARSER = 2000, 2  # candidates from which a quick likeness, on every second row and column, is taken first
_ERROR = 0.25  # largest error of the quick likeness
_LEAST_INSIDE = 0.4  # share of a mark inside the picture, below which no fit is accepted
_SMALL, _BLUR = 8.0, 1.5  # px: radius of a mark in the reduced picture, and the initial blur
_LEAST_WIDTH = 2.5  # px: least width of a ring or disc whose border is used by `spots`
_CHANGE = 3.0  # largest ratio of areas before and after the fit in the reduced picture
_SAME = 0.5  # of the size: nearer candidates are the same


@dataclass(frozen=True, slots=True, eq=False)
class MarkCandidates:
    """Places q (N, 2) px and shapes (N, 2, 2) px per mm."""

    q: Array
    shapes: Array

    def __len__(self) -> int:
        return len(self.q)

    def subset(self, which: Index) -> MarkCandidates:
        """Return those that `which` selects, in its order."""
        return MarkCandidates(self.q[which], self.shapes[which])


def mark_candidates(gray: Picture, mark: Mark, method: str, radii: tuple[float, float] | None) -> MarkCandidates:
    """Return where a search finds the mark, likely ones first for each size; radii: least and largest, px."""
    if method == "blobs":
        return _joined(list(_blobs(gray, mark, radii)))
    if radii is None:
        raise BadValue(
            "radius_px", None, f"the radius of {mark} in the picture, or (least, largest), for method {method!r}"
        )
    if method == "saddles":
        if mark.core is not None:
            raise BadValue("method", method, f"another one: {mark} has a disc in its middle, not a crossing of edges")
        return _saddles(gray, mark, float(np.sqrt(radii[0] * radii[1])))
    count = 1 + int(np.ceil(np.log(radii[1] / radii[0]) / np.log(_STEP) - 1e-9))
    sizes = np.geomspace(*radii, count) if count > 1 else np.array([np.sqrt(radii[0] * radii[1])])
    look = _spots if method == "spots" else _correlation
    parts = []
    for size in sizes.tolist():
        q = look(gray, mark, size)
        parts.append(MarkCandidates(q, np.tile(size / mark.radius * np.eye(2), (len(q), 1, 1))))
    return _joined(parts)


def screened(
    gray: Picture, mark: Mark, seen: MarkCandidates, *, most: int, margin: float, rough: bool = False
) -> MarkCandidates:
    """Return at most `most` candidates that look like the mark as they are, best first, one at each place.

    rough: whether places and shapes are known only to a fifth of the size; likeness is then that of blurred pictures.
    """
    if not len(seen):
        return seen
    least, soft = (_ROUGH_LIKENESS, _ROUGH_SOFT) if rough else (_LEAST_LIKENESS, _SOFT)
    if len(seen) > _MANY:  # a photo full of clutter: most of it is told from the mark by a quarter of the pixels
        quick = likeness(gray, mark, seen.q, seen.shapes, margin=margin, soft=soft, sparser=_SPARSER)
        seen = seen.subset(np.flatnonzero(quick > least - _ERROR))
    alike = likeness(gray, mark, seen.q, seen.shapes, margin=margin, soft=soft)
    order = np.argsort(-alike, kind="stable")
    order = order[alike[order] > least]
    size = mark.radius * np.sqrt(np.abs(np.linalg.det(seen.shapes)))
    return seen.subset(_apart(seen.q, size, order, most))


def approached(gray: Picture, mark: Mark, seen: MarkCandidates, margin: float, *, enough: int | None) -> MarkCandidates:
    """Return the candidates that are marks in a picture reduced until they are small, with refined places and shapes.

    At that size a circle at about the right place is close enough to the ellipse of a tilted mark for a fit to
    converge. One is left at each place. enough: the number of marks in the picture; where as many look right at once,
    the others are not tried.
    """
    if not len(seen):
        return seen
    size = mark.radius * np.sqrt(np.abs(np.linalg.det(seen.shapes)))
    factors = np.maximum(1, (size / _SMALL).astype(int))
    alike = likeness(gray, mark, seen.q, seen.shapes, margin=margin, soft=_SOFT)
    factors[alike > _NEAR] = 0
    parts = [seen.subset(factors == 0)]
    if enough is not None and len(parts[0]) >= enough:
        return parts[0]
    for factor in np.unique(factors[factors > 0]).tolist():
        some = seen.subset(np.flatnonzero(factors == factor).astype(np.int32))
        small = shrunken(gray, factor)
        fit = fit_marks(
            small, mark, (some.q + 0.5) / factor - 0.5, some.shapes / factor, margin=margin, blur=_BLUR, roughly=True
        )
        change = np.linalg.det(fit.image_from_mark) / np.linalg.det(some.shapes / factor)
        alike = fit.good & (fit.score > _LEAST_APPROACHED) & (change < _CHANGE) & (change > 1 / _CHANGE)
        parts.append(MarkCandidates((fit.q + 0.5) * factor - 0.5, fit.image_from_mark * factor).subset(alike))
    return screened(gray, mark, _joined(parts), most=len(seen), margin=margin)


def _apart(q: Array, size: Array, order: Index, most: int) -> Index:
    """Return those of `order` without an earlier one within half their size."""
    from scipy.spatial import cKDTree

    if not len(order):
        return order
    tree = cKDTree(q[order])
    free = np.ones(len(order), bool)
    kept: list[int] = []
    for k in range(len(order)):
        if not free[k]:
            continue
        kept.append(k)
        if len(kept) == most:
            break
        free[tree.query_ball_point(q[order[k]], _SAME * size[order[k]])] = False
    return np.asarray(order[kept], np.int64)


def _spots(gray: Picture, mark: Mark, radius: float) -> Array:
    rings = mark.sectors[mark.full, :2] * (radius / mark.radius)
    if not len(rings):
        raise BadValue("method", "spots", f"'saddles' for {mark}, which has no whole ring")
    clear = rings[:, 1] - rings[:, 0] >= _LEAST_WIDTH
    part = (rings[:, 1] - rings[:, 0]) / rings[:, 1]  # share of the radius that may change: 1 for a disc
    inner, outer = rings[np.argmax(np.where(clear, part, part - 1))].tolist()
    return spots(gray, outer, outer - inner, dark=not mark.light)[0]


def _correlation(gray: Picture, mark: Mark, radius: float) -> Array:
    if not mark.concentric:
        raise BadValue(
            "method", "correlation", f"'spots' or 'blobs' for {mark}, which does not look the same at any turn"
        )
    return cross(gray, template(mark, radius), least=_LEAST_CORRELATION)[0]


def _blobs(gray: Picture, mark: Mark, radii: tuple[float, float] | None) -> Iterator[MarkCandidates]:
    """Yield the elliptic blobs that may be the mark's central disc, for several sizes of picture and window."""
    if mark.core is None:
        raise BadValue("method", "blobs", f"another one: {mark} has no disc in its middle")
    radius, inked = mark.core
    for level in _LEVELS:
        if level < 1 and level * max(gray.shape) < _LEAST_SIDE:
            break
        small, full = reduced(gray, level)
        for window in _WINDOWS if level == 1 else _WINDOWS[:2]:
            blobs = elliptic_blobs(small, max(5, round(window * max(small.shape))), light=inked == mark.light)
            if not len(blobs.q):
                continue
            U, s, _ = np.linalg.svd(blobs.moments)
            shapes = 2 / radius / level * (U * np.sqrt(s)[:, None, :]) @ np.swapaxes(U, 1, 2)
            size, minor = mark.radius * np.linalg.svd(shapes, compute_uv=False).T
            fits = _LEAST_INSIDE * np.pi * size * minor < gray.size
            if radii is not None:
                fits &= (size > radii[0] / 1.5) & (size < radii[1] * 1.5)
            yield MarkCandidates(full(blobs.q[fits]), shapes[fits])


def _saddles(gray: Picture, mark: Mark, radius: float) -> MarkCandidates:
    """Return the crossings of two edges, with x along the edge from which increasing angles are dark."""
    corners = corner_candidates(gray, float(np.clip(radius / 6, 1.0, 3.0)))
    first, second = corners.directions.T
    swap = (corners.kind > 0) == mark.light
    x, y = np.where(swap, second, first), np.where(swap, first + np.pi, second)
    y = np.where(np.mod(y - x, 2 * np.pi) > np.pi, y + np.pi, y)
    shapes = np.stack([np.cos(x), np.cos(y), np.sin(x), np.sin(y)], axis=-1).reshape(-1, 2, 2)
    return MarkCandidates(corners.q, shapes * (radius / mark.radius))


def _joined(parts: list[MarkCandidates]) -> MarkCandidates:
    if not parts:
        return MarkCandidates(np.zeros((0, 2)), np.zeros((0, 2, 2)))
    return MarkCandidates(np.concatenate([p.q for p in parts]), np.concatenate([p.shapes for p in parts]))
