"""The image of a mark as a function of its pose: the model that is fitted to grey values, with its derivatives.

A pixel's place on the mark is p = N_xy / N_z, N = H (m, 1), for the plane's homography H (mark from image, about the
mark) and the pixel's coordinates m there. The mark is blurred by a Gaussian of s px; the resulting share of ink of a
pixel is computed in the core (mark.h), exactly for discs, straight borders and their corners. Then

    I = (m + c (share(q) + b share(q) (1 - share(q)))) (1 + g . (u, v)),

light that varies over the mark acting on ink and paper alike, and b the nonlinearity of the camera's response: a gamma
makes a half-inked pixel lighter or darker than the mean of ink and paper (chapter 5 of the dissertation). The share is
the mean over the mark's motion d = (dx, dy) px during the exposure; d and -d are the same. The first nine parameters
are x y * * c s m gx gy, in the places that `photometric.fitted` expects; the rest of the geometry follows, then b dx
dy. The blur includes the mean over a pixel's square, whose variance is 1/12 px^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.geometry import rotation as so3
from cadcam.native.marks import LOOSE, Borders, picture, picture_with_slopes
from cadcam.target.boards.photometric import BLUR, CONTRAST, Model
from cadcam.target.marks.mark import Mark

Matrix: TypeAlias = Callable[[Array, Array], Array]  # geometry (..., k), constants (..., h) -> H (..., 3, 3)

_LEVELS = (CONTRAST, BLUR, 6, 7, 8)  # c s m gx gy, before the response's b
_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class Geometry:
    """The parametrisation of a mark's pose: `count` parameters, the first two x, y in px; matrix: their H."""

    count: int
    matrix: Matrix

    @property
    def places(self) -> Ids:
        """Return the indices of the geometry's parameters among all."""
        return np.array([0, 1, 2, 3, *range(9, 5 + self.count)], dtype=np.int32)

    @property
    def free(self) -> int:
        """Return the number of parameters that are always fitted; b dx dy come after them, then the constants."""
        return self.count + len(_LEVELS)

    @property
    def levels(self) -> Ids:
        """Return the indices of c s m gx gy b dx dy."""
        return np.array([*_LEVELS, *range(self.free, self.free + LOOSE)], dtype=np.int32)

    @property
    def motion(self) -> Ids:
        """Return the indices of dx dy."""
        return self.levels[-2:]

    def homography(self, parameters: Array) -> Array:
        """Return H (B, 3, 3) of parameters (B, n)."""
        return self.matrix(parameters[:, self.places], self.held(parameters))

    def held(self, parameters: Array) -> Array:
        """Return the constants (B, h) of parameters (B, n)."""
        return parameters[:, self.free + LOOSE :]


def affine(*, turned: bool, perspective: bool) -> Geometry:
    """Return the plane without a camera: x y A11 A12 A22 [A21] [h1 h2], p = A (q - c) / (1 + h . (q - c)).

    turned: whether the mark has a direction; else A is symmetric. perspective: whether h is free.
    """
    linear = 6 if turned else 5

    def matrix(g: Array, held: Array) -> Array:
        H = np.zeros((*g.shape[:-1], 3, 3))
        x, y = g[..., 0], g[..., 1]
        H[..., 0, 0], H[..., 0, 1], H[..., 1, 1] = g[..., 2], g[..., 3], g[..., 4]
        H[..., 1, 0] = g[..., 5 if turned else 3]
        H[..., :2, 2] = -(H[..., :2, 0] * x[..., None] + H[..., :2, 1] * y[..., None])
        H[..., 2, 2] = 1.0
        if perspective:
            H[..., 2, :2] = g[..., linear:]
            H[..., 2, 2] -= g[..., linear] * x + g[..., linear + 1] * y
        return H

    return Geometry(linear + 2 * perspective, matrix)


def posed(*, turned: bool) -> Geometry:
    """Return the plane seen by a camera: x y, log of the depth, rotations about the mark's x and y [and z] axes, rad.

    Constants (9): Q = L^-1 R over the depth, L (rays from the image's coordinates), R (camera from mark) at the start.
    H is the inverse of [Q exp(w) e1, Q exp(w) e2, exp(k) (x, y, 1)].
    """

    def matrix(g: Array, held: Array) -> Array:
        Q = held.reshape(*held.shape[:-1], 3, 3)
        w = np.zeros((*g.shape[:-1], 3))
        w[..., : 3 if turned else 2] = g[..., 3:]
        M = Q @ so3.exp(w)
        xy1 = np.concatenate([g[..., :2], np.ones_like(g[..., :1])], axis=-1)
        M[..., 2] = xy1 * np.exp(g[..., 2:3])
        return np.asarray(np.linalg.inv(M))

    return Geometry(6 if turned else 5, matrix)


@lru_cache(maxsize=256)
def borders_of(mark: Mark) -> Borders:
    """Return a mark's borders in the core's format: a fit asks for them ten times."""
    return Borders.of(mark.sectors, mark.full)


def mark_model(mark: Mark, geometry: Geometry, *, loose: int) -> Model:
    """Return the model of a mark's image; loose: how many of b dx dy are free too, the others are held fixed.

    Its pixels (B, P, 2), or through a lens (B, P, 8): u, v, then the coordinates m in which H acts and dm/dq (2, 2).
    Motions longer than the window is wide have no value (NaN): no fit ends there, and the mean over a motion takes as
    long as it is.
    """
    borders = borders_of(mark)

    def model(parameters: Array, pixels: Array, weight: Array | None = None) -> tuple[Array, Array]:
        H, dH = with_slopes(geometry, parameters[:, geometry.places], geometry.held(parameters))
        levels = parameters[:, geometry.levels]
        absurd = _leaving(levels[:, -2:], pixels) if loose == LOOSE else np.zeros(len(levels), bool)
        levels[absurd, -2:] = 0.0
        value, slopes = picture_with_slopes(borders, pixels, H, dH, levels, loose=loose, weight=weight)
        value[absurd] = np.nan
        return value, slopes

    return model


def _leaving(motion: Array, pixels: Array) -> Mask:
    """Return which motions (B, 2) are longer than the windows of pixels (B, P, 2 or 8) are wide."""
    furthest = np.abs(pixels[..., :2]).max(axis=(1, 2), initial=0.0)
    return np.asarray(np.hypot(motion[:, 0], motion[:, 1]) > 2 * furthest)


def predicted(mark: Mark, geometry: Geometry, parameters: Array, pixels: Array) -> Array:
    """Return the grey values (B, P) of `mark_model`, without their derivatives."""
    return picture(borders_of(mark), pixels, geometry.homography(parameters), parameters[:, geometry.levels])


def share_of_ink(mark: Mark, H: Array, pixels: Array, s: Array) -> Array:
    """Return the share of ink (B, P) at pixels (B, P, 2 or 8) for H (B, 3, 3) and blurs s (B,) px."""
    levels = np.zeros((len(H), len(_LEVELS) + LOOSE))
    levels[:, 0], levels[:, 1] = 1.0, s
    return picture(borders_of(mark), pixels, H, levels)


def with_slopes(geometry: Geometry, g: Array, held: Array) -> tuple[Array, Array]:
    """Return H (B, 3, 3) and its derivatives (B, k, 3, 3), by central differences: here exact to 1e-10."""
    k = geometry.count
    places = g[:, None] + _STEP * np.concatenate([np.zeros((1, k)), np.eye(k), -np.eye(k)])
    H = geometry.matrix(places, np.broadcast_to(held[:, None], (len(g), 1 + 2 * k, held.shape[1])))
    return H[:, 0], (H[:, 1 : k + 1] - H[:, k + 1 :]) / (2 * _STEP)
