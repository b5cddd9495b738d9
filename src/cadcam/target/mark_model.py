"""The picture of a mark as a function of where it lies: the model that is fitted to grey values, with its slopes.

A pixel's place on the mark is p = N_xy / N_z, N = H (m, 1), for the plane's homography H (mark from image, about the
mark) and the pixel's coordinates m there. A border is blurred by a Gaussian of s px: with e(p) = 0 on it and a pixel's
distance d = e / |grad_q e| to first order, the ink's share is Phi(-d / s). Sectors of a ring are products of two such
borders along the radius and two across it; that is exact for right angles. Then

    I = (m + c share(q)) (1 + g . (u, v)),

light that varies over the mark acting on ink and paper alike. The first nine parameters are x y * * c s m gx gy, the
places of which `photometric.fitted` knows; the rest of the geometry follows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, reduce
from typing import TypeAlias

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.geometry import rotation as so3
from cadcam.target.mark import FULL, Mark
from cadcam.target.photometric import BLUR, CONTRAST, Model

Pair: TypeAlias = tuple[Array, Array] | tuple[float, float]
Step: TypeAlias = tuple[Array, Array, Array]  # a share of ink, its slopes by the geometry, and by s
Matrix: TypeAlias = Callable[[Array, Array], Array]  # geometry (..., k), what is held (..., h) -> H (..., 3, 3)

_LEVELS = 5  # c s m gx gy
_STEP = 1e-5
_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Geometry:
    """How a mark may lie: `count` parameters, the first two x, y in px; matrix: gives H of them."""

    count: int
    matrix: Matrix

    @property
    def places(self) -> Ids:
        """Return where the geometry's parameters stand among all."""
        return np.array([0, 1, 2, 3, *range(9, 5 + self.count)], dtype=np.int32)

    @property
    def free(self) -> int:
        """Return the number of parameters that are fitted; what is held comes after them."""
        return self.count + _LEVELS


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
    """Return the plane as a camera sees it: x y, log of the depth, turns about the mark's x and y [and z] axes, rad.

    Held (9): Q = L^-1 R by the depth, L (rays from the image's coordinates), R (camera from mark) at the start. H is
    the inverse of [Q exp(w) e1, Q exp(w) e2, exp(k) (x, y, 1)].
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


def mark_model(mark: Mark, geometry: Geometry, *, lens: bool = False) -> Model:
    """Return the model of a mark's picture.

    Its pixels (B, P, 2), or with a lens (B, P, 8): u, v, then the coordinates m in which H acts and dm/dq (2, 2).
    """
    places = geometry.places

    def model(parameters: Array, pixels: Array) -> tuple[Array, Array]:
        H, dH = _with_slopes(geometry, parameters[:, places], parameters[:, geometry.free :])
        u, v = pixels[..., 0], pixels[..., 1]
        place = _Place(H, dH, pixels[..., 2:4] if lens else pixels[..., :2], pixels[..., 4:8] if lens else None)
        share, by_geometry, by_s = _share(mark, place, parameters[:, BLUR, None])
        c, m, gx, gy = (parameters[:, k, None] for k in (CONTRAST, 6, 7, 8))
        light, value = 1 + gx * u + gy * v, m + c * share
        J = np.zeros((len(u), geometry.free, u.shape[1]))
        J[:, places] = by_geometry * (c * light)[:, None]
        J[:, CONTRAST], J[:, BLUR], J[:, 6] = share * light, c * by_s * light, light
        J[:, 7], J[:, 8] = value * u, value * v
        return value * light, np.swapaxes(J, 1, 2)

    return model


def predicted(mark: Mark, geometry: Geometry, parameters: Array, pixels: Array) -> Array:
    """Return the grey values (B, P) that `mark_model` gives, without their slopes."""
    H = geometry.matrix(parameters[:, geometry.places], parameters[:, geometry.free :])
    share = share_of_ink(mark, H, pixels, parameters[:, BLUR])
    light = 1 + parameters[:, 7, None] * pixels[..., 0] + parameters[:, 8, None] * pixels[..., 1]
    return np.asarray((parameters[:, 6, None] + parameters[:, CONTRAST, None] * share) * light)


def share_of_ink(mark: Mark, H: Array, pixels: Array, s: Array) -> Array:
    """Return the share of ink (B, P) at pixels (B, P, 2 or 8) for H (B, 3, 3) and blurs s (B,) px."""
    lens = pixels.shape[2] > 2
    m, dm = (pixels[..., 2:4], pixels[..., 4:8]) if lens else (pixels, None)
    return _share(mark, _Place(H, np.zeros((len(H), 0, 3, 3)), m, dm), s[:, None])[0]


def _with_slopes(geometry: Geometry, g: Array, held: Array) -> tuple[Array, Array]:
    """Return H (B, 3, 3) and its slopes (B, k, 3, 3), by central differences: exact to 1e-10 for these functions."""
    k = geometry.count
    shifted = g[:, None] + _STEP * np.concatenate([np.eye(k), -np.eye(k)])
    H = geometry.matrix(shifted, np.broadcast_to(held[:, None], (len(g), 2 * k, held.shape[1])))
    return geometry.matrix(g, held), (H[:, :k] - H[:, k:]) / (2 * _STEP)


class _Place:
    """Where pixels lie on the mark: p_i (B, P), G_ij = dp_i/dq_j (B, P), and their slopes (B, k, P).

    Component by component, so that all arithmetic runs along the pixels.
    """

    def __init__(self, H: Array, dH: Array, m: Array, lens: Array | None) -> None:
        m1 = np.stack([m[..., 0], m[..., 1], np.ones(m.shape[:2])], axis=1)
        N = H @ m1
        iw = 1 / N[:, 2]
        dN = [dH[:, :, i] @ m1 for i in range(3)]
        p = [N[:, i] * iw for i in (0, 1)]
        dp = [(dN[i] - p[i][:, None] * dN[2]) * iw[:, None] for i in (0, 1)]
        G = [[(H[:, i, j, None] - p[i] * H[:, 2, j, None]) * iw for j in (0, 1)] for i in (0, 1)]
        dG = [[self._bent(H, dH, p[i], dp[i], G[i][j], dN[2], iw, i, j) for j in (0, 1)] for i in (0, 1)]
        if lens is not None:
            L = [[lens[..., 2 * i + j] for j in (0, 1)] for i in (0, 1)]
            dG = [[row[0] * L[0][j][:, None] + row[1] * L[1][j][:, None] for j in (0, 1)] for row in dG]
            G = [[row[0] * L[0][j] + row[1] * L[1][j] for j in (0, 1)] for row in G]
        self.p, self.dp, self.G, self.dG = p, dp, G, dG

    @staticmethod
    def _bent(H: Array, dH: Array, p: Array, dp: Array, G: Array, dw: Array, iw: Array, i: int, j: int) -> Array:
        """Return the slopes of G_ij."""
        d = dH[:, :, i, j, None] - dp * H[:, 2, j, None, None]
        return np.asarray((d - p[:, None] * dH[:, :, 2, j, None] - G[:, None] * dw) * iw[:, None])

    def border(self, e: Array, de: Array, a: Pair, da: Pair | None) -> tuple[Array, Array]:
        """Return the distance (B, P) px from a border, to first order, and its slopes (B, k, P).

        e (B, P): the function that is 0 on it, de (B, k, P); a: its gradient on the mark, da its slopes if it has any.
        """
        G, dG = self.G, self.dG
        g = [G[0][j] * a[0] + G[1][j] * a[1] for j in (0, 1)]
        dg = [dG[0][j] * _over(a[0]) + dG[1][j] * _over(a[1]) for j in (0, 1)]
        if da is not None:
            dg = [dg[j] + G[0][j][:, None] * da[0] + G[1][j][:, None] * da[1] for j in (0, 1)]
        short = 1 / np.sqrt(g[0] ** 2 + g[1] ** 2 + _TINY)
        d = e * short
        longer = (dg[0] * g[0][:, None] + dg[1] * g[1][:, None]) * short[:, None]
        return d, (de - d[:, None] * longer) * short[:, None]


def _over(a: Array | float) -> Array | float:
    return a[:, None] if isinstance(a, np.ndarray) else a


def _share(mark: Mark, place: _Place, s: Array) -> Step:
    """Return the share of ink (B, P), its slopes by the geometry (B, k, P) and by s (B, P)."""
    (x, y), (dx, dy) = place.p, place.dp
    radius = np.sqrt(x * x + y * y + _TINY)
    a, b = x / radius, y / radius
    dradius = a[:, None] * dx + b[:, None] * dy
    da, db = ((d - c[:, None] * dradius) / radius[:, None] for d, c in ((dx, a), (dy, b)))
    distance, slope = place.border(radius, dradius, (a, b), (da, db))  # of radius 0; a border at r is nearer by
    short = distance / radius  # r / |gradient|
    dshort = (slope - short[:, None] * dradius) / radius[:, None]
    within = cache(lambda r: _step((r - radius) * short, (r - radius)[:, None] * dshort - dradius * short[:, None], s))
    parts = []
    for inner, outer, start, stop in mark.sectors.tolist():
        part = within(outer) if inner == 0 else _minus(within(outer), within(inner))
        parts.append(part if stop - start > FULL - 1e-9 else _times(part, _between(place, start, stop, s)))
    return reduce(_plus, parts)


def _step(d: Array, dd: Array, s: Array) -> Step:
    """Return the share on the positive side of a blurred border."""
    from scipy.special import ndtr

    t = d / s
    density = np.exp(-0.5 * t * t) / (np.sqrt(2 * np.pi) * s)
    return ndtr(t), density[:, None] * dd, -density * t


def _plus(a: Step, b: Step) -> Step:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Step, b: Step) -> Step:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _times(a: Step, b: Step) -> Step:
    return (a[0] * b[0], a[1] * b[0][:, None] + a[0][:, None] * b[1], a[2] * b[0] + a[0] * b[2])


def _rest(a: Step) -> Step:
    return 1 - a[0], -a[1], -a[2]


def _between(place: _Place, start: float, stop: float, s: Array) -> Step:
    """Return the share between two rays from the centre."""
    span = stop - start
    after, before = _half(place, start, s, +1), _half(place, stop, s, -1)
    if abs(span - np.pi) < 1e-9:
        return after
    return _times(after, before) if span < np.pi else _rest(_times(_rest(after), _rest(before)))


def _half(place: _Place, angle: float, s: Array, side: int) -> Step:
    """Return the share on the side of growing angles (+1) of the line through the centre, or on the other (-1)."""
    a, b = -side * float(np.sin(angle)), side * float(np.cos(angle))
    e, de = a * place.p[0] + b * place.p[1], a * place.dp[0] + b * place.dp[1]
    return _step(*place.border(e, de, (a, b), None), s)
