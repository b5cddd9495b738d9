"""The fast spot finder: places from which brightness steps the same way in eight directions, at a known radius.

The dissertation's App. A: for each pixel the gradient at a distance equal to the radius is taken in eight directions;
only around a spot's centre it is the same in all. Here the step is taken by its ratio, (outside - inside) / (outside +
inside), so that a gradient of the light does not matter, and the second weakest of the eight counts, so that something
may cover an eighth of the border. The picture is first reduced until the radius is a few pixels.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.native.correlate import shrunken

_RADIUS = 4.5  # px of the reduced picture: what the search is done at
_ACROSS = 1.6  # px there, to both sides of the border
_DIRECTIONS = 8
_LEVEL = 0.02  # of grey values: below it a ratio says nothing


def spot_response(gray: Picture, radius: float, *, dark: bool) -> Picture:
    """Return for each pixel (H, W) the second weakest step in eight directions, at `radius` px, -1 to 1.

    dark: whether the spot is darker than what surrounds it. Within radius + 2 px of the outline it is -1.
    """
    turn = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    inner = np.rint(max(radius - _ACROSS, 0.0) * direction).astype(int)
    outer = np.rint((radius + _ACROSS) * direction).astype(int)
    reach = int(np.abs(outer).max(initial=0))
    height, width = gray.shape
    response = np.full(gray.shape, -1.0, np.float32)
    if min(height, width) <= 2 * reach:
        return response

    def shifted(step: np.ndarray) -> Picture:
        x, y = (int(k) + reach for k in step)
        return gray[y : y + height - 2 * reach, x : x + width - 2 * reach]

    least = second = np.full((height - 2 * reach, width - 2 * reach), 2.0, np.float32)
    for a, b in zip(outer, inner, strict=True):
        out, in_ = shifted(a), shifted(b)
        step = (out - in_ if dark else in_ - out) / (np.abs(out + in_) + np.float32(_LEVEL))
        second = np.minimum(second, np.maximum(least, step))
        least = np.minimum(least, step)
    response[reach : height - reach, reach : width - reach] = second
    return response


def spots(gray: Picture, radius: float, *, dark: bool, least: float = 0.04, most: int = 200) -> tuple[Array, Array]:
    """Return places (N, 2) px of spots of `radius` px, strongest first, to about a fifth of it, and their strength.

    least: of the response, 0.04 is 8 % more light outside than inside.
    """
    factor = max(1, int(radius / _RADIUS))
    small = shrunken(gray, factor) if factor > 1 else np.asarray(gray, np.float32)
    response = spot_response(small, radius / factor, dark=dark)
    q, strength = peaks(response, least, apart=0.7 * radius / factor, most=most)
    return (q + 0.5) * factor - 0.5, strength


def peaks(response: Picture, least: float, *, apart: float, most: int) -> tuple[Array, Array]:
    """Return the highest places (N, 2) of a response, each the highest within `apart` px, to parts of a pixel."""
    from scipy.ndimage import maximum_filter

    high = response > least
    if not high.any():
        return np.zeros((0, 2)), np.zeros(0)
    top = (maximum_filter(response, size=3) == response) & high
    y, x = np.nonzero(top)
    order = np.argsort(-response[y, x], kind="stable")[: 20 * most]
    q, value = np.column_stack([x, y])[order].astype(np.float64), response[y, x][order].astype(np.float64)
    kept: list[int] = []
    for i in range(len(q)):
        if len(kept) == most:
            break
        if not kept or np.min(np.sum((q[kept] - q[i]) ** 2, axis=1)) > apart**2:
            kept.append(i)
    return q[kept], value[kept]
