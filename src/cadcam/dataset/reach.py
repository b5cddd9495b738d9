"""Where a part may be imaged, beyond the picture's border too: the pixels to draw for its whole silhouette."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.render.lens_tables import KEPT_BYTES, TABLE_BYTES

Area = tuple[int, int, int, int]  # left, top, right, bottom; the last two exclusive
_PER_SIDE = 256  # points on each side of the outline of what a lens images


def reach(camera: Camera, p: Array, *, samples: int) -> Area:
    """Return the pixels, to a picture's size outside, that a part with points p (N, 3), camera frame, may cover.

    samples: along a pixel of the picture. Through a lens a table of these pixels takes longer to make than they take to
    draw. In small pictures they are the same for all parts and poses, so that the table is kept beside the picture's.
    """
    width, height = camera.size
    plain = isinstance(camera.lens, Ideal)
    kept = (9 + 1 + samples**2) * width * height * TABLE_BYTES <= KEPT_BYTES
    bounds = _of_points(camera, p) if plain else None if kept else _through_lens(camera, p)
    low, high = np.array([-width, -height]), np.array([2 * width, 2 * height])
    if bounds is not None:
        low, high = np.maximum(low, np.floor(bounds[0])), np.minimum(high, np.ceil(bounds[1]) + 1)
    left, top, right, bottom = (int(v) for v in (*low, *high))
    return left, top, right, bottom


def beyond(area: Area, size: tuple[int, int]) -> list[Area]:
    """Return what of an area lies outside a picture of a size: above, below, left and right of it."""
    (left, top, right, bottom), (width, height) = area, size
    above, below = min(max(top, 0), bottom), max(min(bottom, height), top)
    parts = [
        (left, top, right, above),
        (left, below, right, bottom),
        (left, above, min(right, 0), below),
        (max(left, width), above, right, below),
    ]
    return [(x0, y0, x1, y1) for x0, y0, x1, y1 in parts if x0 < x1 and y0 < y1]


def _of_points(camera: Camera, p: Array) -> tuple[Array, Array] | None:
    """Return the bounds (2,) each of the points' images, with a pixel around; None where one lies behind."""
    q = camera.project(p)
    return (q.min(axis=0) - 1, q.max(axis=0) + 1) if np.isfinite(q).all() else None


def _through_lens(camera: Camera, p: Array) -> tuple[Array, Array] | None:
    """Return the bounds of what a lens images of the points' convex hull; None where one lies behind.

    Edges bow out from between their ends. But a lens images a region without folds: what bounds the image is the image
    of what bounds the region, here the rectangle around the points at depth 1, and the circle that the lens images.
    """
    if p[:, 2].min() <= 0:
        return None
    u = p[:, :2] / p[:, 2:]
    low, high = u.min(axis=0), u.max(axis=0)
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]], low])
    t = np.arange(_PER_SIDE)[:, None] / _PER_SIDE
    outline = [np.concatenate([a + t * (b - a) for a, b in pairwise(corners)])]
    radius = camera.lens.valid_radius * (1 - 1e-9)
    if np.isfinite(radius):
        angle = 2 * np.pi * np.arange(4 * _PER_SIDE) / (4 * _PER_SIDE)
        outline.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    ends, steps = [], [1.0]
    for around in outline:
        q = camera.project(np.column_stack([around, np.ones(len(around))]))
        step = np.linalg.norm(q - np.roll(q, 1, axis=0), axis=1)
        steps.append(float(np.nanmax(step, initial=0.0)))  # NaN: beyond what the lens images
        within = ((around >= low) & (around <= high)).all(axis=1) & np.isfinite(q).all(axis=1)
        ends.append(q[within])
    seen = np.concatenate(ends)
    margin = 2 * max(steps)  # more than the outline bows between two points of it
    return (seen.min(axis=0) - margin, seen.max(axis=0) + margin) if len(seen) else None
