"""Where in a picture a mark may be, and in which shape: three searches, and the first look at what they bring."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Picture
from cadcam.errors import BadValue
from cadcam.target.chess import corner_candidates
from cadcam.target.circles import elliptic_blobs
from cadcam.target.cross import cross, template
from cadcam.target.levels import reduced
from cadcam.target.mark import Mark
from cadcam.target.mark_fit import likeness
from cadcam.target.spots import spots

METHODS = ("auto", "spots", "correlation", "blobs", "saddles")
_STEP = 1.3  # from radius to radius, where a range is given
_WINDOWS = (0.08, 0.025, 0.25)  # of the picture's longer side, over which blobs are told from their ground
_LEVELS = (1.0, 0.5, 0.25)
_LEAST_SIDE = 120  # px of a reduced picture
_LEAST_CORE = 2.5  # px: a disc in a mark's middle of which spots can be looked for
_LEAST_CORRELATION = 0.5
_LEAST_LIKENESS = 0.35
_SAME = 0.5  # of the size: candidates nearer than that are one


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Places q (N, 2) px and shapes (N, 2, 2) px by mm."""

    q: Array
    shapes: Array

    def __len__(self) -> int:
        return len(self.q)

    def subset(self, which: Ids) -> Candidates:
        """Return those that `which` selects, in its order."""
        return Candidates(self.q[which], self.shapes[which])


def candidates(gray: Picture, mark: Mark, method: str, radii: tuple[float, float] | None) -> Candidates:
    """Return where a search sees the mark, likely ones first within a size; radii: least and largest, px."""
    if method == "blobs":
        return _joined(list(_blobs(gray, mark, radii)))
    if radii is None:
        raise BadValue(
            "radius_px", None, f"the radius of {mark} in the picture, or (least, largest), for method {method!r}"
        )
    if method == "saddles":
        return _saddles(gray, mark, float(np.sqrt(radii[0] * radii[1])))
    count = 1 + int(np.ceil(np.log(radii[1] / radii[0]) / np.log(_STEP) - 1e-9))
    sizes = np.geomspace(*radii, count) if count > 1 else np.array([np.sqrt(radii[0] * radii[1])])
    look = _spots if method == "spots" else _correlation
    parts = []
    for size in sizes.tolist():
        q = look(gray, mark, size)
        parts.append(Candidates(q, np.tile(size / mark.radius * np.eye(2), (len(q), 1, 1))))
    return _joined(parts)


def screened(gray: Picture, mark: Mark, seen: Candidates, *, most: int, margin: float) -> Candidates:
    """Return at most `most` candidates that look like the mark as they are, best first, one at each place."""
    if not len(seen):
        return seen
    alike = likeness(gray, mark, seen.q, seen.shapes, margin=margin)
    order = np.argsort(-alike, kind="stable")
    order = order[alike[order] > _LEAST_LIKENESS]
    size = mark.radius * np.sqrt(np.abs(np.linalg.det(seen.shapes)))
    return seen.subset(_apart(seen.q, size, order, most))


def _apart(q: Array, size: Array, order: Ids, most: int) -> Ids:
    """Return of `order` those with no earlier one nearer than half their size."""
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
    return np.asarray(order[kept])


def _spots(gray: Picture, mark: Mark, radius: float) -> Array:
    core = mark.core
    scale = radius / mark.radius
    if core is not None and core[0] * scale >= _LEAST_CORE:
        return spots(gray, core[0] * scale, dark=core[1] != mark.light)[0]
    return spots(gray, radius, dark=not mark.light)[0]


def _correlation(gray: Picture, mark: Mark, radius: float) -> Array:
    if not mark.concentric:
        raise BadValue("method", "correlation", f"'spots' or 'blobs' for {mark}, which does not look the same at any turn")
    return cross(gray, template(mark, radius), least=_LEAST_CORRELATION)[0]


def _blobs(gray: Picture, mark: Mark, radii: tuple[float, float] | None) -> Iterator[Candidates]:
    """Yield the elliptic blobs that may be the disc in the mark's middle, at several sizes of picture and window."""
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
            size = mark.radius * np.linalg.svd(shapes, compute_uv=False)[:, 0]
            fits = np.ones(len(size), bool) if radii is None else (size > radii[0] / 1.5) & (size < radii[1] * 1.5)
            yield Candidates(full(blobs.q[fits]), shapes[fits])


def _saddles(gray: Picture, mark: Mark, radius: float) -> Candidates:
    """Return the crossings of two edges, x along the one from which growing angles are dark."""
    corners = corner_candidates(gray, float(np.clip(radius / 6, 1.0, 3.0)))
    first, second = corners.directions.T
    swap = (corners.kind > 0) == mark.light
    x, y = np.where(swap, second, first), np.where(swap, first + np.pi, second)
    y = np.where(np.mod(y - x, 2 * np.pi) > np.pi, y + np.pi, y)
    shapes = np.stack([np.cos(x), np.cos(y), np.sin(x), np.sin(y)], axis=-1).reshape(-1, 2, 2)
    return Candidates(corners.q, shapes * (radius / mark.radius))


def _joined(parts: list[Candidates]) -> Candidates:
    if not parts:
        return Candidates(np.zeros((0, 2)), np.zeros((0, 2, 2)))
    return Candidates(np.concatenate([p.q for p in parts]), np.concatenate([p.shapes for p in parts]))
