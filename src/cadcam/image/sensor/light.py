"""Effects on the light: the lens' vignetting and blur, motion, fields taken one after the other, oblong pixels.

They act on radiance, before the sensor's chain bends it. All kernels are symmetric about the pixel: no effect here
moves a picture but those that say so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.errors import BadValue
from cadcam.image.picture import checked
from cadcam.image.sensor.effect import check, check_pair, in_rows

_FINE = 16  # samples of a kernel along a pixel
_LARGEST = 200.0  # px of blur


@dataclass(frozen=True, slots=True)
class Vignetting:
    """Darker corners: I' = I V(q), with V = cos^4(theta) (1 + a2 r^2 + a4 r^4 + a6 r^6).

    theta: angle to the axis, tan(theta) = |q - c|/focal_px, the natural vignetting of a thin lens; focal_px 0 leaves it
    out. r = |q - c| over half of the diagonal: what a lens' mount adds, fitted by `fit_vignetting`. c is the picture's
    middle, moved by offset_px.
    """

    focal_px: float = 0.0
    a2: float = 0.0
    a4: float = 0.0
    a6: float = 0.0
    offset_px: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check("focal_px of the vignetting", self.focal_px, 0.0)
        for name in ("a2", "a4", "a6"):
            check(f"{name} of the vignetting", getattr(self, name))
        check_pair("offset_px of the vignetting", self.offset_px)

    def share(self, shape: tuple[int, ...], rows: slice = slice(None)) -> Array:
        """Return V (R, W) over the rows of a picture of this shape, or over all."""
        height, width = shape[:2]
        away, half = _from_middle(height, width, self.offset_px, rows)
        natural = (1 + away / self.focal_px**2) ** -2 if self.focal_px else np.ones_like(away)
        r2 = away / half**2
        return np.maximum(natural * (1 + r2 * (self.a2 + r2 * (self.a4 + r2 * self.a6))), 0.0)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the darkened picture."""
        out = np.zeros(picture.shape, np.float32)
        for rows in in_rows(picture):
            share = self.share(picture.shape, rows)
            out[rows] = picture[rows] * (share if picture.ndim == 2 else share[..., None])
        return out


def fit_vignetting(flat: Picture) -> Vignetting:
    """Return the vignetting of a picture (H, W), linear in radiance, of an evenly lit surface: a2, a4, a6.

    By least squares, with the level at the middle. Raises `BadValue` for a picture that is dark there.
    """
    values = checked(flat).astype(np.float64)
    if values.ndim == 3:
        values = values.mean(axis=2)
    away, half = _from_middle(values.shape[0], values.shape[1], (0.0, 0.0))
    r2 = (away / half**2).ravel()
    level, *rest = np.linalg.lstsq(np.stack([r2**k for k in range(4)], axis=1), values.ravel(), rcond=None)[0]
    if level <= 0:
        raise BadValue("the level at the middle of the flat picture", f"{level:.3g}", "above 0: an evenly lit surface")
    a2, a4, a6 = (float(a / level) for a in rest)
    return Vignetting(a2=a2, a4=a4, a6=a6)


@dataclass(frozen=True, slots=True)
class Blur:
    """I' = disc * Gauss * I: out of focus by a disc of radius defocus_px, and sigma_px of everything else.

    The disc is the aperture's picture of a point out of focus (geometrical optics): its radius is half of the diameter
    that `Optics.defocus_px` and `Aperture.defocus_px` give. The Gaussian stands for diffraction, the lens' errors and
    the pixel's area together.
    """

    sigma_px: float = 0.0
    defocus_px: float = 0.0

    def __post_init__(self) -> None:
        check("sigma_px of the blur", self.sigma_px, 0.0, _LARGEST)
        check("defocus_px of the blur", self.defocus_px, 0.0, _LARGEST)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the blurred picture; at its border the outermost values go on."""
        from scipy.ndimage import gaussian_filter1d

        out = convolved(picture, _disc(self.defocus_px)) if self.defocus_px else picture
        if self.sigma_px:
            for axis in (0, 1):
                out = gaussian_filter1d(out, self.sigma_px, axis=axis, mode="nearest", truncate=6.0)
        return np.asarray(out, dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Motion:
    """I'(q) = mean of I(q - t d) over t in [-1/2, 1/2]: the picture moves by d = shift_px while the shutter is open.

    What is seen belongs to the middle of the exposure.
    """

    shift_px: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_pair("shift_px of the motion", self.shift_px)
        check("length of the motion's shift_px", float(np.hypot(*self.shift_px)), 0.0, _LARGEST)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the smeared picture."""
        steps = np.array(self.shift_px)
        if not steps.any():
            return picture
        count = int(np.ceil(_FINE * np.abs(steps).max()))
        places = ((np.arange(count) + 0.5) / count - 0.5)[:, None] * steps
        return convolved(picture, _splatted(places))


@dataclass(frozen=True, slots=True)
class Interlace:
    """Odd lines show the picture one field later: I'(x, y odd) = I(q - d), d = shift_px, its motion meanwhile.

    lag: the share of the field before that remains in each (image lag): I' = (1 - lag) I_now + lag I_before, the lines
    of which lie between those of now. Measuring on single fields avoids both; a moving edge shows the comb of d.
    """

    shift_px: tuple[float, float] = (0.0, 0.0)
    lag: float = 0.0

    def __post_init__(self) -> None:
        check_pair("shift_px of the interlace", self.shift_px)
        check("lag of the interlace", self.lag, 0.0, 1.0)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture of two fields, woven."""
        later = shifted(picture, self.shift_px)
        out = picture.copy()
        out[1::2] = later[1::2]
        if self.lag:
            before = shifted(picture, (-self.shift_px[0], -self.shift_px[1]))
            out[0::2] += np.float32(self.lag) * (before - picture)[0::2]
            out[1::2] += np.float32(self.lag) * (picture - later)[1::2]
        return out


@dataclass(frozen=True, slots=True)
class PixelAspect:
    """Pixels `ratio` times as wide as high: each takes the mean of the light on it, x' = (x + 1/2)/ratio - 1/2.

    The picture becomes narrower by the ratio (wider if it is below 1); what is left of a pixel at its right is cut off.
    A camera that rendered it then has fx/ratio and (cx + 1/2)/ratio - 1/2.
    """

    ratio: float = 1.0

    def __post_init__(self) -> None:
        check("ratio of the pixel aspect", self.ratio, 0.1, 10.0)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture in such pixels; `BadValue` for one narrower than a pixel."""
        width = int(picture.shape[1] / self.ratio + 1e-9)
        if width < 1:
            raise BadValue("picture", f"{picture.shape[1]} px wide", f"{self.ratio:g} px or more, that of a pixel")
        edges = np.minimum(np.arange(width + 1) * self.ratio, picture.shape[1])
        total = np.concatenate([np.zeros_like(picture[:, :1]), picture], axis=1, dtype=np.float64).cumsum(axis=1)
        left = np.minimum(edges.astype(np.int64), picture.shape[1] - 1)
        part = (edges - left).reshape(-1, *([1] * (picture.ndim - 2)))
        upto = total[:, left] + part * picture[:, left]
        return np.asarray(np.diff(upto, axis=1) / self.ratio, dtype=np.float32)


def convolved(picture: Picture, kernel: Array) -> Picture:
    """Return the picture convolved with a kernel (k, k), k odd; beyond its border the outermost values go on."""
    from scipy.signal import oaconvolve

    pad = [(k // 2, k // 2) for k in kernel.shape] + [(0, 0)] * (picture.ndim - 2)
    kernel = kernel.reshape(*kernel.shape, *([1] * (picture.ndim - 2)))
    out = oaconvolve(np.pad(picture, pad, mode="edge").astype(np.float64), kernel, mode="valid", axes=(0, 1))
    return np.asarray(out, dtype=np.float32)


def shifted(picture: Picture, shift_px: tuple[float, float]) -> Picture:
    """Return I(q - shift) by cubic splines; beyond the border the outermost values go on."""
    from scipy.ndimage import shift

    if not any(shift_px):
        return picture
    by = (shift_px[1], shift_px[0], *([0.0] * (picture.ndim - 2)))
    return np.asarray(shift(picture.astype(np.float64), by, order=3, mode="nearest"), dtype=np.float32)


def _from_middle(
    height: int, width: int, offset: tuple[float, float], rows: slice = slice(None)
) -> tuple[Array, float]:
    """Return squared distances (R, W) of rows from the picture's middle, px^2, and half of its diagonal, px."""
    x = np.arange(width) - (width - 1) / 2 - offset[0]
    y = (np.arange(height) - (height - 1) / 2 - offset[1])[rows]
    return x**2 + (y**2)[:, None], float(np.hypot(width, height)) / 2


def _disc(radius: float) -> Array:
    """Return the share of each pixel that a disc covers, normalised."""
    reach = int(np.ceil(radius - 0.5)) if radius > 0.5 else 1
    fine = (np.arange((2 * reach + 1) * _FINE) + 0.5) / _FINE - reach - 0.5
    inside = (fine**2 + fine[:, None] ** 2) <= radius**2
    kernel = inside.reshape(2 * reach + 1, _FINE, 2 * reach + 1, _FINE).sum(axis=(1, 3)).astype(np.float64)
    total = kernel.sum()
    return kernel / total if total else np.pad([[1.0]], 1)


def _splatted(places: Array) -> Array:
    """Return a kernel of points (N, 2), each shared by the four pixels around it."""
    reach = int(np.ceil(np.abs(places).max())) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    base = np.floor(places).astype(np.int64)
    fx, fy = (places - base).T
    for dx, dy, w in ((0, 0, (1 - fx) * (1 - fy)), (1, 0, fx * (1 - fy)), (0, 1, (1 - fx) * fy), (1, 1, fx * fy)):
        np.add.at(kernel, (base[:, 1] + dy + reach, base[:, 0] + dx + reach), w)
    return np.asarray(kernel / kernel.sum())
