"""Correlation with the ideal picture of a mark, searched as by the dissertation's program `cross` (App. A).

First only a few pixels of two perpendicular slices of the template are compared, in steps of several pixels; then the
whole slices, at every pixel near promising ones; then the whole template there. The score is the zero-mean normalised
correlation. EQ 7.1 as printed subtracts no means: bright, plain ground then correlates to 0.9 with everything, peaks
are broad and biased towards brightness; it is available to show this (`zero_mean=False`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Index, Mask, Picture
from cadcam.errors import BadValue
from cadcam.target.marks.mark import Mark
from cadcam.target.marks.model import share_of_ink
from cadcam.target.marks.spots import peaks

_GROUND = 1.25  # half-width of a template over the mark's radius
_SHARP = 0.6  # px: blur of a template, most of it from the pixel area
_LEAST_HALF = 3
_STEP_BY_RADIUS = 0.12
_ROUGH, _SLICES = 0.6, 0.8  # share of the required score that the first two sweeps must reach
_FEW = 9  # pixels of each slice in the first sweep
_TOGETHER = 4_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Taps:
    """A template's pixels: dx, dy (T,) from its centre and their grey values (T,)."""

    dx: npt.NDArray[np.int64]
    dy: npt.NDArray[np.int64]
    value: Array

    def subset(self, which: Mask) -> Taps:
        """Return the pixels that `which` (T,) selects."""
        return Taps(self.dx[which], self.dy[which], self.value[which])


def template(mark: Mark, radius_px: float, *, blur: float = _SHARP) -> Picture:
    """Return the ideal picture (n, n) of an upright mark, its centre in the middle of the middle pixel, paper 1, ink 0.

    It holds the mark and a quarter of its radius of ground. blur: Gaussian, including the pixel's own.
    """
    if not radius_px > 0.5:
        raise BadValue("radius", f"{radius_px:g} px", "more than half a pixel")
    half = max(_LEAST_HALF, round(_GROUND * radius_px))
    x, y = np.meshgrid(np.arange(-half, half + 1.0), np.arange(-half, half + 1.0))
    scale = mark.radius / radius_px
    H = np.diag([scale, scale, 1.0])[None]
    pixels = np.stack([x.ravel(), y.ravel()], axis=-1)[None]
    share = share_of_ink(mark, H, pixels, np.array([blur]))[0].reshape(x.shape)
    return np.asarray(share if mark.light else 1 - share, np.float32)


def taps(picture: Picture, *, circular: bool = True) -> Taps:
    """Return a template's pixels; those in the inscribed circle, or all of the square."""
    half = picture.shape[0] // 2
    dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
    inside = (dx * dx + dy * dy <= (half + 0.5) ** 2) if circular else np.ones(dx.shape, bool)
    return Taps(dx[inside], dy[inside], picture[inside].astype(np.float64))


def correlation_at(gray: Picture, x: Index, y: Index, of: Taps, *, zero_mean: bool = True) -> Array:
    """Return the normalised correlation (N,) of a template centred on whole pixels (x, y), -1 to 1.

    Without `zero_mean` it is EQ 7.1 as printed. Outside the picture its border pixels are repeated.
    """
    height, width = gray.shape
    x, y = np.asarray(x, np.int64), np.asarray(y, np.int64)
    t = of.value - of.value.mean() if zero_mean else of.value
    t = t / np.sqrt((t * t).sum())
    out = np.zeros(len(x))
    step = max(1, _TOGETHER // len(t))
    for first in range(0, len(x), step):
        part = slice(first, first + step)
        rows, columns = (y[part, None] + of.dy).clip(0, height - 1), (x[part, None] + of.dx).clip(0, width - 1)
        g = gray[rows, columns].astype(np.float64)
        if zero_mean:
            g -= g.mean(axis=1, keepdims=True)
        length = np.sqrt((g * g).sum(axis=1))
        out[part] = (g @ t) / np.maximum(length, 1e-3 * np.sqrt(len(t)))  # a contrast of 0.001 at least
    return out


def cross(
    gray: Picture, picture: Picture, *, least: float = 0.6, most: int = 200, zero_mean: bool = True
) -> tuple[Array, Array]:
    """Return sub-pixel places (N, 2) and correlations (N,) of a template, best first: program `cross`.

    The template must lie wholly in the picture; a template larger than the picture has no place.
    """
    whole = taps(picture)
    half = picture.shape[0] // 2
    if 2 * half >= min(gray.shape):
        return np.zeros((0, 2)), np.zeros(0)
    slices = whole.subset((whole.dx == 0) | (whole.dy == 0))
    every = max(1, 2 * half // _FEW)
    few = slices.subset((slices.dx + slices.dy) % every == 0)
    step = max(1, round(_STEP_BY_RADIUS * half))
    height, width = gray.shape
    y, x = (a.ravel() for a in np.mgrid[half : height - half : step, half : width - half : step])
    rough = correlation_at(gray, x, y, few, zero_mean=zero_mean) > _ROUGH * least
    x, y = _grown(x[rough], y[rough], step, gray.shape)
    near = correlation_at(gray, x, y, slices, zero_mean=zero_mean) > _SLICES * least
    x, y = x[near], y[near]
    response = np.full(gray.shape, -1.0, np.float32)
    response[y, x] = correlation_at(gray, x, y, whole, zero_mean=zero_mean)
    return peaks(response, least, apart=0.7 * half, most=most)


def _grown(x: Index, y: Index, by: int, shape: tuple[int, ...]) -> tuple[Index, Index]:
    """Return every pixel within `by` of those given, once."""
    region = np.zeros(shape, bool)
    for dx in range(-by + 1, by):
        for dy in range(-by + 1, by):
            region[(y + dy).clip(0, shape[0] - 1), (x + dx).clip(0, shape[1] - 1)] = True
    ys, xs = np.nonzero(region)
    return xs, ys


def surface(gray: Picture, q: Array, of: Taps, half: int, *, zero_mean: bool = True) -> tuple[Array, Array]:
    """Return correlations (N, n, n), n = 2 half + 1, around the highest pixel near each q (N, 2), and that pixel."""
    top = np.rint(np.asarray(q, np.float64)).astype(int).reshape(-1, 2)
    near, wide = _square(1), _square(half)
    for _ in range(3):
        x, y = top[:, :1] + near[0], top[:, 1:] + near[1]
        value = correlation_at(gray, x.ravel(), y.ravel(), of, zero_mean=zero_mean).reshape(x.shape)
        best = value.argmax(axis=1)
        if (best == near[0].size // 2).all():
            break
        top = np.column_stack([np.take_along_axis(a, best[:, None], axis=1)[:, 0] for a in (x, y)])
    x, y = top[:, :1] + wide[0], top[:, 1:] + wide[1]
    value = correlation_at(gray, x.ravel(), y.ravel(), of, zero_mean=zero_mean)
    return value.reshape(len(top), 2 * half + 1, 2 * half + 1), top.astype(np.float64)


def _square(half: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
    return dx.ravel(), dy.ravel()
