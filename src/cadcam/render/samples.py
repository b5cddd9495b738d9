"""Points of the pixel, the opening and the lamps from which the renderings of one photograph are taken.

Sobol's sequence, so that few are even; and every point with its mirror image, so that the mean of any number of them is
the middle: blur then moves nothing.

Half a shadow on an edge would still move it: if of n points of a lamp only some are in sight, the n points of the pixel
that go with these have another mean. So neighbouring pixels pair the two otherwise (`pairing`), as images of few
samples do that are interleaved (A. Keller, W. Heidrich, Eurographics Workshop on Rendering, 2001).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, frozen
from cadcam.errors import BadValue
from cadcam.kinds import expect_count

MOST = 4096
MOST_BLUR = 50.0  # px


@dataclass(frozen=True, slots=True, eq=False)
class SamplePoints:
    """For each of n renderings points (n, 2): `pixel` px about the centre, `opening` and `lamp` in the unit disc."""

    pixel: Array
    opening: Array
    lamp: Array

    def __post_init__(self) -> None:
        for name in ("pixel", "opening", "lamp"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, (None, 2)))

    def __len__(self) -> int:
        return len(self.pixel)


def renderings(n: int) -> int:
    """Return how many points `sample_points` gives where n are asked for: n rounded up to a power of two."""
    expect_count(n, "samples", most=MOST)
    return 1 << int(np.ceil(np.log2(n)))


def sample_points(n: int, blur_px: float = 0.0) -> SamplePoints:
    """Return n points of each kind: the middle of everything for 1, else n rounded up to a power of two.

    blur_px: sigma of the Gaussian that spreads a pixel beyond its own square. Raises `BadValue`.
    """
    if not 0 <= blur_px <= MOST_BLUR:
        raise BadValue("blur_px", blur_px, f"a number from 0 to {MOST_BLUR:g}")
    if renderings(n) == 1:
        middle = np.zeros((1, 2))
        return SamplePoints(middle, middle, middle)
    from scipy.stats.qmc import Sobol

    half = renderings(n) >> 1
    x = Sobol(6, scramble=False).random(half)
    x += 1 / (4 * half)  # with their mirror images, numbers then lie in the middle of equal shares
    x = np.concatenate([x, 1 - x])
    return SamplePoints(in_pixel(x[:, :2], blur_px), on_disc(x[:, 2:4]), on_disc(x[:, 4:6]))


def pairing(n: int) -> Longs:
    """Return a tile (h, w) of the whole numbers below n, a power of two, each once: h w = n.

    A pixel that takes point k ^ tile[y % h, x % w] of a lamp with its own k-th takes every point once; all pixels of a
    tile together take every pair once, and neighbours in a row opposite points. Ordered dither (B. E. Bayer, IEEE ICC,
    1973).
    """
    bits = n.bit_length() - 1
    y, x = np.indices((1 << bits // 2, 1 << (bits + 1) // 2), np.int64)
    out = np.zeros(x.shape, np.int64)
    for i in range(bits):
        bit = (x ^ y) >> i // 2 if i % 2 == 0 else y >> i // 2
        out |= (bit & 1) << (bits - 1 - i)
    return out


def in_pixel(x: Array, blur_px: float) -> Array:
    """Return points (n, 2) of the unit square as places, px about a pixel's centre, that light counts by.

    As often as a square pixel behind a Gaussian of sigma blur_px counts it: the inverse of that distribution, by axis.
    """
    if not blur_px:
        return x - 0.5
    from scipy.special import ndtr

    d = np.linspace(-0.5 - 8 * blur_px, 0.5 + 8 * blur_px, 4001)
    # the integral of Phi(d/s) is d Phi + s phi; its difference over a pixel is the share to the left of d
    left, right = ((d + h) * ndtr((d + h) / blur_px) + _bell(d + h, blur_px) for h in (-0.5, 0.5))
    return np.asarray(np.interp(x, right - left, d))


def _bell(d: Array, s: float) -> Array:
    return np.asarray(s * np.exp(-0.5 * (d / s) ** 2) / np.sqrt(2 * np.pi))


def on_disc(x: Array) -> Array:
    """Return points (n, 2) of the unit square on the unit disc, shares of area kept, opposite points opposite.

    Squares round the middle become circles (Shirley and Chiu, "A low distortion map between disk and square", 1997).
    Few points miss the rim: all are moved outwards until their mean square is the disc's, 1/2, and blur as wide as it.
    """
    a, b = (2 * x - 1).T
    wide = np.abs(a) >= np.abs(b)
    r = np.where(wide, a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        phi = np.where(wide, np.pi / 4 * np.nan_to_num(b / a), np.pi / 2 - np.pi / 4 * np.nan_to_num(a / b))
    return np.asarray(np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1) / np.sqrt(2 * np.mean(r**2)))
