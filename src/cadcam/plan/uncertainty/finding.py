"""How well a feature will be found in a picture: the covariance of its pixels by noise, blur and how it is seen.

Of an edge between two brightnesses, C apart, blurred by a Gaussian of s px, in a picture whose pixels have the noise
sigma_n, each px of its length tells the place across it with the Fisher information

    C^2 / (2 sqrt(pi) s sigma_n^2)   1/px^2

(the integral of the squared slope by the noise; no unbiased finder does better). A straight edge of L px has L times
that. Of a disc or a hole, imaged as an ellipse, every px of the outline tells of the centre along its own normal n; the
sum of n n^T over the ellipse with half axes a >= b is, along the long and the short axis,

    4 (b^2/a) (K(m) - E(m))/m      4 a (E(m) - (1 - m) K(m))/m      m = 1 - b^2/a^2

with the complete elliptic integrals K, E; pi a for both of a circle. So a mark seen at a slant is found less well along
its long axis. Where not the noise is stated but sigma_px of a feature that faces the camera in focus, the same law
carries it over to others: sigma^2 grows with s, and with how the outline is foreshortened.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Floats
from cadcam.camera.optics import PIXEL_PX2, Optics
from cadcam.errors import BadValue

_THIN = 1e-3  # b/a below which a disc is seen edge-on


@dataclass(frozen=True, slots=True)
class Finder:
    """How well features are found: stated as sigma_px, or by the noise of grey levels and the contrast (0 to 1 each).

    sigma_px: standard deviation of one pixel coordinate of a feature that faces the camera, in focus; of an edge as a
    whole, across it. grey, contrast: sigma of a pixel's grey level and the step of brightness at an outline, white = 1;
    they count, where given, for features of known size. floor_px: what remains whatever the noise, added in squares.
    """

    sigma_px: float | None = None
    grey: float | None = None
    contrast: float | None = None
    floor_px: float = 0.0

    def __post_init__(self) -> None:
        if (self.grey is None) != (self.contrast is None):
            raise BadValue("noise of grey levels and contrast", "one of them given", "both, or neither")
        if self.sigma_px is None and self.grey is None:
            raise BadValue("noise", "not stated", "sigma_px, or grey and contrast")
        for name in ("sigma_px", "grey", "contrast"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise BadValue(name, value, "a positive number")
        if not (np.isfinite(self.floor_px) and self.floor_px >= 0):
            raise BadValue("floor_px", self.floor_px, "a number of px from 0 on")

    @property
    def by_grey(self) -> bool:
        """Return whether the noise of grey levels is known."""
        return self.grey is not None

    def per_px(self, blur_px: Floats) -> Array:
        """Return the information (...), 1/px^2 by px of outline, of edges blurred by a Gaussian of blur_px."""
        if self.grey is None or self.contrast is None:
            raise BadValue("noise of grey levels", "not stated", "grey and contrast")
        s = np.asarray(blur_px, dtype=np.float64)
        return np.asarray(self.contrast**2 / (2 * np.sqrt(np.pi) * s * self.grey**2))


def blur_sigmas(optics: Optics | None, z_mm: Floats) -> Array:
    """Return the sigma (...) in px of the Gaussian with all blur at distances z (...): `optics.blur_sigma_px` of many.

    Without an f-number, or without optics, the pixel's own area is all that is known.
    """
    z = np.asarray(z_mm, dtype=np.float64)
    if optics is None or optics.f_number is None:
        return np.full(z.shape, np.sqrt(PIXEL_PX2))
    return np.asarray(np.sqrt(defocus(optics, z) ** 2 / 16 + optics.airy_sigma_px() ** 2 + PIXEL_PX2))


def defocus(optics: Optics | None, z_mm: Floats) -> Array:
    """Return the diameter (...) in px of the disc that a point at distance z becomes; 0 where no f-number is known."""
    z = np.asarray(z_mm, dtype=np.float64)
    if optics is None or optics.f_number is None:
        return np.zeros(z.shape)
    times = optics.aperture_mm * optics.camera_constant_mm / optics.sensor.pitch_mm[0]
    with np.errstate(divide="ignore"):
        return np.asarray(times * np.abs(1 / optics.distance_mm - 1 / z))


def outline(A: Array) -> tuple[Array, Array]:
    """Return the sum of n n^T (..., 2, 2) px over an ellipse's outline, and its long half axis (...) px.

    A (..., 2, 2): takes the unit circle to the ellipse, px.
    """
    from scipy.special import ellipe, ellipkm1

    S = A @ np.swapaxes(A, -1, -2)
    mean = (S[..., 0, 0] + S[..., 1, 1]) / 2
    half = np.hypot((S[..., 0, 0] - S[..., 1, 1]) / 2, S[..., 0, 1])
    a = np.sqrt(mean + half)
    det = np.abs(A[..., 0, 0] * A[..., 1, 1] - A[..., 0, 1] * A[..., 1, 0])
    ratio = np.clip(det / np.maximum(a**2, 1e-300), _THIN, 1.0)  # b/a
    q = ratio**2
    m = 1 - q
    K, E = ellipkm1(q), ellipe(m)
    flat = m < 1e-4  # series: the difference K - E loses its digits
    safe = np.where(flat, 1.0, m)
    long = np.where(flat, np.pi * a * (1 - 5 * m / 8), 4 * a * q * (K - E) / safe)
    short = np.where(flat, np.pi * a * (1 - m / 8), 4 * a * (E - q * K) / safe)
    angle = np.arctan2(S[..., 0, 1], (S[..., 0, 0] - S[..., 1, 1]) / 2) / 2
    u = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    uu = u[..., :, None] * u[..., None, :]
    return np.asarray(short[..., None, None] * np.eye(2) + (long - short)[..., None, None] * uu), a


def circle_covariance(finder: Finder, A: Array, blur_px: Floats, *, sharp_px: Floats, sized: bool = True) -> Array:
    """Return the covariance (..., 2, 2) px^2 of the centre of a disc, hole or mark that is imaged by A (..., 2, 2).

    A takes the unit circle to the ellipse in the picture, px. blur_px (...): sigma of the blur there; sharp_px: that in
    focus, to which a stated sigma_px belongs. sized: the size is known, so that grey and contrast decide, where stated.
    """
    sums, a = outline(A)
    blur = np.asarray(blur_px, dtype=np.float64)
    if sized and finder.by_grey:
        information = finder.per_px(blur)[..., None, None] * sums
    else:
        information = sums / (np.pi * a * _stated(finder) ** 2 * blur / np.asarray(sharp_px))[..., None, None]
    return np.asarray(np.linalg.inv(information) + finder.floor_px**2 * np.eye(2))


def point_covariance(finder: Finder, blur_px: Floats, *, sharp_px: Floats) -> Array:
    """Return the covariance (..., 2, 2) px^2 of a point of unknown shape."""
    variance = _stated(finder) ** 2 * np.asarray(blur_px) / np.asarray(sharp_px) + finder.floor_px**2
    return np.asarray(variance[..., None, None] * np.eye(2))


def edge_variance(finder: Finder, length_px: Floats, blur_px: Floats, *, sharp_px: Floats) -> Array:
    """Return the variance (...) px^2 of a straight edge as a whole, across it, of which length_px is seen."""
    if finder.by_grey:
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (finder.per_px(blur_px) * np.asarray(length_px)) + finder.floor_px**2)
    return np.asarray(_stated(finder) ** 2 * np.asarray(blur_px) / np.asarray(sharp_px) + finder.floor_px**2)


def _stated(finder: Finder) -> float:
    if finder.sigma_px is None:
        raise BadValue("sigma_px", "not stated", "one, for features whose size is not known")
    return finder.sigma_px
