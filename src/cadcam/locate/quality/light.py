"""The light in a photo of a part: how bright its surfaces are, depending on their orientation and colour.

The brightness of a matt surface depends on its orientation: under any number of distant lights it is, to 1 %, a
quadratic form of the normal (R. Ramamoorthi and P. Hanrahan, J. Opt. Soc. Am. A 18, 2001). Its nine coefficients, and a
gain for each colour of the model, are fitted robustly to the photo itself; shadows, and surfaces that are not where the
model has them, are outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Picture, quantile
from cadcam.locate.part import Part

EVERY = 5  # px between the pixels used for the fit
_ROUNDS = 8
_PRIOR = 0.3  # prior sigma of the light's coefficients
_LEAST_SCALE = 0.005  # least uncertainty of a surface's brightness
_LEAST_SPREAD = 0.02  # least sd of the brightness of surfaces
_NORMALS = 10.0  # quantisation of unit normals within which surfaces are one, steps per unit
_HIGHER_TERMS = 0.06  # of one light's brightness missed by a quadratic form: 0.03 rms, at most 0.09
_FULL = 20  # sampled pixels from which a surface has full weight


@dataclass(frozen=True, slots=True, eq=False)
class FittedLight:
    """A fitted light: form (9,) with its covariance, a gain per colour, and the brightness of what is no surface.

    scale: robust standard deviation of surfaces from the fit; mean, spread: of the surfaces' brightness.
    """

    form: Array
    covariance: Array
    gain: dict[int, float]
    nothing: float
    scale: float
    mean: float
    spread: float

    def brightness(self, normal: Array, color: Ids) -> Array:
        """Return the brightness (N,) of surfaces of normals (N, 3) and colours (N,).

        For surfaces unlike any other in the photo, only the distribution of all surfaces' brightness is known.
        """
        return self._told(normal, color)[0]

    def brightness_and_covariance(self, normal: Array, color: Ids) -> tuple[Array, Array]:
        """Return the brightness (N,), and its covariance (N, N)."""
        tone, own, shared = self._told(normal, color)
        return tone, own * np.eye(len(tone)) + shared @ shared.T

    def _told(self, normal: Array, color: Ids) -> tuple[Array, float, Array]:
        """Return the brightness (N,), the variance of its error in each surface, and effects (N, 9) of shared ones."""
        by = np.array([self.gain.get(int(c), 1.0) for c in color])[:, None] * _basis(normal)
        brightest = _HIGHER_TERMS * (self.mean + 2 * self.spread)
        # Surfaces, thousands in a large model, share only the nine numbers of the light: no matrix (N, N) is inverted.
        power, axes = np.linalg.eigh(self.covariance)
        U, size, _ = np.linalg.svd(by @ (axes * np.sqrt(np.maximum(power, 0.0))), full_matrices=False)
        any_tone, own = self.spread**2, self.scale**2 + brightest**2
        shared = own + size**2
        told, told_shared = any_tone / (any_tone + own), any_tone / (any_tone + shared)
        beyond = by @ self.form - self.mean
        tone = self.mean + told * beyond + (U * (told_shared - told)) @ (U.T @ beyond)
        more = told_shared * shared - told * own  # never below zero: what is shared is an error beside their own
        return np.asarray(tone), told * own, np.asarray(U * np.sqrt(np.maximum(more, 0.0)))

    def contrast(self, normal: Array, color: Ids) -> tuple[Array, Array]:
        """Return the change of brightness (N,) between surfaces, normals (N, 2, 3), colours (N, 2), and its sigma."""
        colors, at = np.unique(color, return_inverse=True)
        gain = np.array([self.gain.get(int(c), 0.0) for c in colors])[at.reshape(-1)].reshape(-1, 2)
        by = gain[..., None] * np.stack([_basis(normal[:, 0]), _basis(normal[:, 1])], axis=1)
        empty = np.where(color < 0, self.nothing, 0.0)
        change = by[:, 1] - by[:, 0]
        value = change @ self.form + empty[:, 1] - empty[:, 0]
        return np.asarray(value), np.sqrt(np.einsum("ni,ij,nj->n", change, self.covariance, change))


def fitted_light(gray: Picture, normal: Array | Picture, color: Ids) -> FittedLight:
    """Return the light that explains the photo (H, W) with these normals (H, W, 3) and colours (H, W).

    Each surface has the same weight whatever its size, as its pixels share their error.
    """
    few = slice(None, None, EVERY)
    g, n = (a.astype(np.float64) for a in (gray[few, few].ravel(), normal[few, few].reshape(-1, 3)))
    return light_of(g, n, color[few, few].ravel())


def light_of(g: Array, n: Array, c: Ids) -> FittedLight:
    """Return the light that explains brightness g (N,) of pixels with normals n (N, 3) and colours c (N,)."""
    nothing = float(np.median(g[c < 0])) if (c < 0).any() else 0.5
    g, n, c, weight = _by_surface(g[c >= 0], n[c >= 0], c[c >= 0])
    gain = {int(k): 1.0 for k in np.unique(c)}
    A, form, covariance, robust = _basis(n), np.zeros(9), np.eye(9), np.ones(len(g))
    scale = _LEAST_SCALE
    for _ in range(_ROUNDS if len(g) else 0):
        own_gain = np.array([gain[int(k)] for k in c])
        residual = np.abs(g - own_gain * (A @ form))
        scale = max(1.4826 * float(np.median(residual)), _LEAST_SCALE)
        if form.any():
            robust = np.minimum(1.0, 2.0 * scale / np.maximum(residual, 1e-12))  # Huber's weights
        W = weight * robust
        form, covariance = _ridge(A * own_gain[:, None], g, W, scale)
        unit = A @ form
        gain = {k: _gain(unit[c == k], g[c == k], W[c == k]) for k in gain}
    mean = float(np.average(g, weights=weight)) if len(g) else 0.5
    spread = float(np.sqrt(np.average((g - mean) ** 2, weights=weight))) if len(g) else 0.3
    return FittedLight(form, covariance, gain, nothing, scale, mean, max(spread, _LEAST_SPREAD))


def _ridge(B: Array, g: Array, W: Array, scale: float) -> tuple[Array, Array]:
    """Return the form (9,) that fits B @ form = g by weights W, sigma `scale` and the prior, and its covariance."""
    covariance = np.asarray(np.linalg.inv(B.T @ (B * W[:, None]) / scale**2 + np.eye(9) / _PRIOR**2), np.float64)
    return covariance @ (B.T @ (W * g)) / scale**2, covariance


def _gain(unit: Array, g: Array, W: Array) -> float:
    """Return the factor by which brightness g (n,) of one colour exceeds that for a gain of 1; 1 where unknown."""
    power = float((W * unit**2).sum())
    return float((W * unit * g).sum()) / power if power > 0 else 1.0


def _by_surface(g: Array, n: Array, c: Ids) -> tuple[Array, Array, Ids, Array]:
    """Return brightness, normal, colour and weight of surfaces: groups of pixels of one colour and similar normal."""
    _, first, at, count = np.unique(surfaces(n, c), return_index=True, return_inverse=True, return_counts=True)
    order = np.argsort(at, kind="stable")
    middle = np.array([quantile(part, 0.5) for part in np.split(g[order], np.cumsum(count)[:-1])]) if len(g) else g
    return middle, n[first], c[first], np.minimum(count / _FULL, 1.0)


def surfaces(normal: Array, color: Ids, *, steps: float = _NORMALS) -> Longs:
    """Return the number (N,) of each pixel's surface: pixels of one colour (N,) and similar normal (N, 3).

    steps: quantisation of a unit normal's components, steps per unit.
    """
    x, y, z = (np.rint(normal * steps).astype(np.int64) + int(steps)).T
    base = 2 * int(steps) + 1
    return np.asarray(((color.astype(np.int64) * base + x) * base + y) * base + z)


def _basis(normal: Array) -> Array:
    """Return (N, 9) the terms of a quadratic form of unit normals (N, 3) on the sphere."""
    x, y, z = normal.T
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1], axis=1)


def colors_of(part: Part, face: Ids) -> Ids:
    """Return the number (H, W) of each pixel's colour, equal for equal colours; -1 where there is no face."""
    return np.where(face >= 0, part.paints[np.maximum(face, 0)], -1).astype(np.int32)
