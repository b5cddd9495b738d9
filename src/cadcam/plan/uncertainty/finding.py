"""How well a feature is located in a picture: the covariance of its pixels from noise, blur and slant.

An edge with a brightness step C, blurred by a Gaussian of s px, in a picture whose pixels have noise sigma_n, gives the
Fisher information

    C^2 / (2 sqrt(pi) s sigma_n^2)   1/px^2

per px of its length on its position across itself (the integral of the squared slope over the noise; no unbiased
estimator does better). A straight edge of L px has L times that. Each px of the outline of a disc or hole, imaged as an
ellipse, gives it along its own normal n for the centre; the sum of n n^T over an ellipse with half axes a >= b is,
along the long and the short axis,

    4 (b^2/a) (K(m) - E(m))/m      4 a (E(m) - (1 - m) K(m))/m      m = 1 - b^2/a^2

with the complete elliptic integrals K, E; for a circle both are pi a. So a mark seen at a slant is located less well
along its long axis. Where sigma_px of a feature that faces the camera in focus is stated instead of the noise, the same
law converts it: sigma^2 grows with s, and with the foreshortening of the outline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Floats
from cadcam.camera.optics import PIXEL_PX2, Optics
from cadcam.errors import BadValue
from cadcam.kinds import expect_positive

_THIN = 1e-3  # b/a below which a disc is seen edge-on
USUAL_BLUR_PX = 0.6  # of sharp edges in pictures of machine vision cameras (`image.sensor.presets.GLOBAL_SHUTTER`)


@dataclass(frozen=True, slots=True)
class Finder:
    """How well features are located: stated as sigma_px, or from grey-level noise and contrast (0 to 1 each).

    sigma_px: standard deviation of one pixel coordinate of a feature that faces the camera, in focus; of an edge as a
    whole, across it. gray, contrast: noise of a pixel's grey level and brightness step at an outline, white = 1; used,
    where given, for features of known size. floor_px: what remains whatever the noise, added in quadrature. blur_px:
    sigma of the Gaussian that blurs edges in focus, by lens, sensor and the pixel's own area together.
    """

    sigma_px: float | None = None
    gray: float | None = None
    contrast: float | None = None
    floor_px: float = 0.0
    blur_px: float = USUAL_BLUR_PX

    def __post_init__(self) -> None:
        if (self.gray is None) != (self.contrast is None):
            raise BadValue("noise of grey levels and contrast", "one of them given", "both, or neither")
        if self.sigma_px is None and self.gray is None:
            raise BadValue("noise", "not stated", "sigma_px, or gray and contrast")
        for name in ("sigma_px", "gray", "contrast"):
            value = getattr(self, name)
            if value is not None:
                expect_positive(value, name)
        for name in ("floor_px", "blur_px"):
            expect_positive(getattr(self, name), name, "a number of px from 0 on", zero=True)

    @property
    def by_gray(self) -> bool:
        """Return whether the noise of grey levels is known."""
        return self.gray is not None

    def blur(self, optics: Optics | None, z_mm: Floats) -> Array:
        """Return the sigma (...) px of the Gaussian with the second moments of all blur at distances z (...).

        Defocus: a disc of diameter d, d^2/16. In focus blur_px, but no less than the pixel's own area, 1/12 px^2, and
        diffraction, the Airy disc's core, leave. Without an f-number nothing is known of defocus and diffraction.
        """
        disc, least = defocus(optics, z_mm), PIXEL_PX2
        if optics is not None and optics.f_number is not None:
            least += optics.airy_sigma_px() ** 2
        return np.asarray(np.sqrt(disc**2 / 16 + max(self.blur_px**2, least)))

    def per_px(self, blur_px: Floats) -> Array:
        """Return the information (...), 1/px^2 per px of outline, of edges blurred by a Gaussian of blur_px."""
        if self.gray is None or self.contrast is None:
            raise BadValue("noise of grey levels", "not stated", "gray and contrast")
        s = np.asarray(blur_px, dtype=np.float64)
        return np.asarray(self.contrast**2 / (2 * np.sqrt(np.pi) * s * self.gray**2))


def defocus(optics: Optics | None, z_mm: Floats) -> Array:
    """Return the diameter (...) px of the circle of confusion at distances z (...): `Optics.defocus_px` of many.

    0 where no f-number is known.
    """
    z = np.asarray(z_mm, dtype=np.float64)
    if optics is None or optics.f_number is None:
        return np.zeros(z.shape)
    times = optics.aperture_mm * optics.camera_constant_mm / optics.sensor.pitch_mm[0]
    with np.errstate(divide="ignore"):
        return np.asarray(times * np.abs(1 / optics.distance_mm - 1 / z))


def half_axes(A: Array) -> tuple[Array, Array]:
    """Return the long and the short half axis (...) px of the ellipse to which A (..., 2, 2) maps the unit circle."""
    S = A @ np.swapaxes(A, -1, -2)
    mean = (S[..., 0, 0] + S[..., 1, 1]) / 2
    long = np.sqrt(mean + np.hypot((S[..., 0, 0] - S[..., 1, 1]) / 2, S[..., 0, 1]))
    det = np.abs(A[..., 0, 0] * A[..., 1, 1] - A[..., 0, 1] * A[..., 1, 0])
    return np.asarray(long), np.asarray(det / np.maximum(long, 1e-300))


def outline(A: Array) -> tuple[Array, Array]:
    """Return the sum of n n^T (..., 2, 2) px over an ellipse's outline, and its long half axis (...) px.

    A (..., 2, 2): maps the unit circle to the ellipse, px.
    """
    from scipy.special import ellipe, ellipkm1

    S = A @ np.swapaxes(A, -1, -2)
    a, b = half_axes(A)
    ratio = np.clip(b / np.maximum(a, 1e-300), _THIN, 1.0)
    q = ratio**2
    m = 1 - q
    K, E = ellipkm1(q), ellipe(m)
    flat = m < 1e-4  # series: K - E suffers from cancellation
    safe = np.where(flat, 1.0, m)
    long = np.where(flat, np.pi * a * (1 - 5 * m / 8), 4 * a * q * (K - E) / safe)
    short = np.where(flat, np.pi * a * (1 + m / 8), 4 * a * (E - q * K) / safe)
    angle = np.arctan2(S[..., 0, 1], (S[..., 0, 0] - S[..., 1, 1]) / 2) / 2
    u = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    uu = u[..., :, None] * u[..., None, :]
    return np.asarray(short[..., None, None] * np.eye(2) + (long - short)[..., None, None] * uu), a


def circle_covariance(finder: Finder, A: Array, blur_px: Floats, *, sharp_px: Floats, sized: bool = True) -> Array:
    """Return the covariance (..., 2, 2) px^2 of the centre of a disc, hole or mark imaged by A (..., 2, 2).

    A maps the unit circle to the ellipse in the picture, px. blur_px (...): sigma of the blur there; sharp_px: that in
    focus, for which a stated sigma_px holds. sized: the size is known, so that grey and contrast are used where stated.
    """
    sums, a = outline(A)
    blur = np.asarray(blur_px, dtype=np.float64)
    if sized and finder.by_gray:
        information = finder.per_px(blur)[..., None, None] * sums
    else:
        information = sums / (np.pi * a * _stated(finder) ** 2 * blur / np.asarray(sharp_px))[..., None, None]
    return np.asarray(np.linalg.inv(information) + finder.floor_px**2 * np.eye(2))


def point_covariance(finder: Finder, blur_px: Floats, *, sharp_px: Floats) -> Array:
    """Return the covariance (..., 2, 2) px^2 of a point of unknown shape."""
    variance = _stated(finder) ** 2 * np.asarray(blur_px) / np.asarray(sharp_px) + finder.floor_px**2
    return np.asarray(variance[..., None, None] * np.eye(2))


def edge_variance(finder: Finder, length_px: Floats, blur_px: Floats, *, sharp_px: Floats) -> Array:
    """Return the variance (...) px^2, across it, of a straight edge of which length_px is visible."""
    if finder.by_gray:
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (finder.per_px(blur_px) * np.asarray(length_px)) + finder.floor_px**2)
    return np.asarray(_stated(finder) ** 2 * np.asarray(blur_px) / np.asarray(sharp_px) + finder.floor_px**2)


def _stated(finder: Finder) -> float:
    if finder.sigma_px is None:
        raise BadValue("sigma_px", "not stated", "one, for features whose size is not known")
    return finder.sigma_px
