"""Reduced pictures for detection, and the map back to full coordinates."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cadcam.arrays import Array, Picture

_LONGEST, _LEAST = 900, 450  # px: longer side of the picture searched first, and of the smallest worth searching


def reduced(gray: Picture, scale: float) -> tuple[Picture, Callable[[Array], Array]]:
    """Return the picture reduced by `scale` (at most 1) and the map of its pixels q (N, 2) to those of the full one."""
    if scale >= 1.0:
        return gray, lambda q: q
    from scipy.ndimage import gaussian_filter, zoom

    small = zoom(gaussian_filter(gray, 0.4 / scale), scale, order=1, grid_mode=True, mode="nearest")
    ratio = np.array(gray.shape[::-1]) / np.array(small.shape[::-1])
    return small, lambda q: (q + 0.5) * ratio - 0.5  # the picture's border maps to the border


def scales(size: tuple[int, ...]) -> list[float]:
    """Return the scales to search a picture at: first the one whose longer side is about 900 px, then others."""
    side = max(size)
    if side <= 1.3 * _LONGEST:
        return [1.0] if side < 2 * _LEAST else [1.0, 0.5]
    first = _LONGEST / side
    larger = [min(1.0, first * 2**k) for k in range(1, 6) if first * 2 ** (k - 1) < 1.0]
    return [first, *larger, first / 2]
