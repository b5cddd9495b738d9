"""The fast spot detector: places from which brightness steps the same way in eight directions, for a known radius.

The dissertation's App. A: for each pixel the gradient at a distance equal to the radius is taken in eight directions;
only around a spot's centre is it the same in all. Here the step is relative, (outside - inside) / (outside + inside),
so that a gradient of the light does not matter, and the second weakest of the eight counts, so that an eighth of the
border may be covered. The picture is first reduced until the radius is a few pixels.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids, Picture
from cadcam.native.correlate import shrunken, spot_steps

_RADIUS, _WIDTH = 5.0, 2.0  # px: least radius of a spot, and least width of a ring, in the reduced picture
_ACROSS = 0.35  # of the radius, to both sides of the border; at most half of the width inside it
_LEAST = 0.04  # of the response: 8 % more light outside than inside
_MOST = 200
_DIRECTIONS = 8  # fixed in the core
_LEVEL = 0.02  # of grey values: a ratio of less is meaningless


def spot_response(gray: Picture, radius: float, across: float, *, dark: bool) -> Picture:
    """Return for each pixel (H, W) the second weakest step in eight directions, -1 to 1.

    The step is from radius - across to radius + across px. dark: whether the spot is darker than its surroundings. -1
    where that leaves the picture.
    """
    turn = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    inner = np.rint(max(radius - across, 0.0) * direction).astype(np.int32)
    outer = np.rint((radius + across) * direction).astype(np.int32)
    return spot_steps(gray, inner, outer, dark=dark, level=_LEVEL)


def reduction(radius: float, width: float) -> int:
    """Return the factor to reduce a picture by for spots with a border of `width` px of one colour on the inside."""
    return max(1, int(min(width / _WIDTH, radius / _RADIUS)))


def spots(gray: Picture, radius: float, width: float, *, dark: bool) -> tuple[Array, Array]:
    """Return places (N, 2) px of spots of `radius` px, good to a fifth of it, strongest first, and their strength.

    width: px of one colour inside the border, for a disc its radius.
    """
    factor = reduction(radius, width)
    small = shrunken(gray, factor) if factor > 1 else np.asarray(gray, np.float32)
    across = max(1.0, min(_ACROSS * radius, width / 2) / factor)
    response = spot_response(small, radius / factor, across, dark=dark)
    q, strength = peaks(response, _LEAST, apart=0.7 * radius / factor, most=_MOST)
    return (q + 0.5) * factor - 0.5, strength


def peaks(response: Picture, least: float, *, apart: float, most: int) -> tuple[Array, Array]:
    """Return the highest places (N, 2) of a response, each the highest within `apart` px, to sub-pixel precision."""
    y, x = np.nonzero(response[1:-1, 1:-1] > least)
    y, x = y + 1, x + 1
    top = np.ones(len(x), bool)
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)):
        top &= response[y, x] >= response[y + dy, x + dx]
    y, x = y[top], x[top]
    order = np.argsort(-response[y, x], kind="stable")[: 20 * most]
    q, value = np.column_stack([x, y])[order].astype(np.float64), response[y, x][order].astype(np.float64)
    kept: list[int] = []
    for i in range(len(q)):
        if len(kept) == most:
            break
        if not kept or np.min(np.sum((q[kept] - q[i]) ** 2, axis=1)) > apart**2:
            kept.append(i)
    return _middle(response, q[kept].astype(int)), value[kept]


def _middle(response: Picture, q: Ids) -> Array:
    """Return the centroid (N, 2) of the response within a pixel of each peak."""
    dy, dx = (d.ravel() for d in np.mgrid[-1:2, -1:2])
    near = response[q[:, 1:] + dy, q[:, :1] + dx].astype(np.float64)
    weight = (near - 0.5 * near.max(axis=1, keepdims=True, initial=0.0)).clip(1e-9)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray(q + np.column_stack([weight @ dx, weight @ dy]))
