"""Brown-Conrady lenses with OpenCV's coefficients, without and with a tilted sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from cadcam.arrays import Array, Floats, Mask, component_major
from cadcam.camera import radial
from cadcam.camera.lens.base import Lens, PlanarLens
from cadcam.camera.lens.ideal import Ideal
from cadcam.errors import BadValue
from cadcam.kinds import said


class _Place(NamedTuple):
    """Points u of the plane, the monomials of the polynomials, the radial gain g, dg/dr2, 1 over its denominator."""

    u: Array
    x: Array
    y: Array
    xx: Array
    xy: Array
    yy: Array
    r2: Array
    g: Array
    dg: Array
    over: Array


@dataclass(frozen=True, repr=False)
class BrownConrady(PlanarLens):
    """Radial, tangential, rational and thin-prism distortion in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4.

    With r2 = ux^2 + uy^2 and g = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3):
    mx = ux g + 2 p1 ux uy + p2 (r2 + 2 ux^2) + s1 r2 + s2 r2^2,
    my = uy g + p1 (r2 + 2 uy^2) + 2 p2 ux uy + s3 r2 + s4 r2^2.
    Sources: Brown, "Close-range camera calibration" (1971); the coefficient order is that of OpenCV's calib3d.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0

    name: ClassVar[str] = "brown-conrady"

    @classmethod
    def from_opencv(cls, coefficients: Floats) -> BrownConrady:
        """Return the lens of OpenCV's distortion vector of 4, 5, 8 or 12 numbers, or 14 when its tilt is zero."""
        c = np.asarray(coefficients, dtype=np.float64).ravel()
        if c.size == 14 and not c[12:].any():
            c = c[:12]
        if c.size not in (0, 4, 5, 8, 12):
            raise BadValue("number of distortion coefficients", c.size, "0, 4, 5, 8 or 12 (14 with zero tilt)")
        return cls(*(float(x) for x in c))

    @cached_property
    def _radial_limit(self) -> float:
        return radial.rational_limit((self.k1, self.k2, self.k3), (self.k4, self.k5, self.k6))

    @cached_property
    def valid_radius(self) -> float:
        """Return the radius at which the mapping first folds: the Jacobian's determinant vanishes in some direction."""
        return radial.fold_limit(self._plane_jacobian, self._radial_limit) if self._decentred else self._radial_limit

    @cached_property
    def _farthest(self) -> float:
        """Return a |m| that nothing within the valid radius is imaged beyond; 0 where that has no limit.

        The image of the disc is bounded by that of its circle, here taken a hundredth wider than at its samples.
        """
        if not np.isfinite(self.valid_radius):
            return 0.0
        phi = np.linspace(0, 2 * np.pi, 360, endpoint=False)
        edge = self._distort(self.valid_radius * np.stack([np.cos(phi), np.sin(phi)], axis=-1))
        return 1.01 * float(np.hypot(edge[:, 0], edge[:, 1]).max())

    @property
    def _prisms(self) -> bool:
        return any((self.s1, self.s2, self.s3, self.s4))

    def _inside(self, u: Array) -> Mask:
        r2 = u[..., 0] ** 2 + u[..., 1] ** 2
        if self._upright_to(float(np.sqrt(np.fmax.reduce(r2, axis=None, initial=0.0)))):
            return ~np.isnan(r2)
        return np.asarray(r2 < self.valid_radius**2)

    def _upright_to(self, radius: float) -> bool:
        """Return whether the mapping certainly does not fold up to a radius: a quick sufficient bound.

        dm/du is symmetric, with eigenvalues g and g + 2 r^2 g', plus the terms of decentring and prisms: in norm at
        most 6 r |(p1, p2)| + 2 r |(s1 + 2 s2 r^2, s3 + 2 s4 r^2)|. While the former dominate, it stays positive
        definite.
        """
        if self._rational or not radius < np.inf:
            return False
        r2 = radius * radius
        least = 1 + r2 * (3 * min(self.k1, 0) + r2 * (5 * min(self.k2, 0) + r2 * 7 * min(self.k3, 0)))
        prism = np.hypot(abs(self.s1) + 2 * abs(self.s2) * r2, abs(self.s3) + 2 * abs(self.s4) * r2)
        return bool(least > radius * (6 * np.hypot(self.p1, self.p2) + 2 * prism))

    @property
    def _decentred(self) -> bool:
        return any((self.p1, self.p2, self.s1, self.s2, self.s3, self.s4))

    @property
    def _rational(self) -> bool:
        return any((self.k4, self.k5, self.k6))

    def _gain(self, r2: Array) -> tuple[Array, Array, Array]:
        """g, dg/dr2, and 1 over the denominator of g."""
        n = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        dn = self.k1 + r2 * (2 * self.k2 + r2 * (3 * self.k3))
        if not self._rational:
            return n, dn, np.ones(())
        d = 1 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6))
        dd = self.k4 + r2 * (2 * self.k5 + r2 * (3 * self.k6))
        return n / d, (dn * d - n * dd) / (d * d), 1 / d

    def _at(self, u: Array) -> _Place:
        x, y = u[..., 0], u[..., 1]
        xx, yy = x * x, y * y
        r2 = xx + yy
        return _Place(u, x, y, xx, x * y, yy, r2, *self._gain(r2))

    def _distort(self, u: Array) -> Array:
        return self._moved(self._at(u))

    def _plane_jacobian(self, u: Array) -> Array:
        return self._by_plane(self._at(u))

    def _linearised(self, u: Array, terms: Sequence[int]) -> tuple[Array, Array, Array]:
        at = self._at(u)
        return self._moved(at), self._by_plane(at), self._by_terms(at, terms)

    def _moved(self, at: _Place) -> Array:
        m = component_major(at.r2.shape, 2)
        m[..., 0] = at.x * at.g + (2 * self.p1) * at.xy + self.p2 * (at.r2 + 2 * at.xx)
        m[..., 1] = at.y * at.g + self.p1 * (at.r2 + 2 * at.yy) + (2 * self.p2) * at.xy
        if self._prisms:
            m[..., 0] += at.r2 * (self.s1 + self.s2 * at.r2)
            m[..., 1] += at.r2 * (self.s3 + self.s4 * at.r2)
        return m

    def _by_plane(self, at: _Place) -> Array:
        J = component_major(at.r2.shape, 2, 2)
        bend = 2 * at.dg
        J[..., 0, 0] = at.g + at.xx * bend + (2 * self.p1) * at.y + (6 * self.p2) * at.x
        J[..., 0, 1] = J[..., 1, 0] = at.xy * bend + (2 * self.p1) * at.x + (2 * self.p2) * at.y
        J[..., 1, 1] = at.g + at.yy * bend + (6 * self.p1) * at.y + (2 * self.p2) * at.x
        if self._prisms:
            J[..., 0, :] += 2 * at.u * (self.s1 + 2 * self.s2 * at.r2)[..., None]
            J[..., 1, :] += 2 * at.u * (self.s3 + 2 * self.s4 * at.r2)[..., None]
        return J

    def _by_terms(self, at: _Place, terms: Sequence[int]) -> Array:
        out = np.swapaxes(component_major(at.r2.shape, len(terms), 2), -1, -2)
        powers = (at.r2, at.r2 * at.r2, at.r2 * at.r2 * at.r2)
        names = list(self.parameters)
        for i, term in enumerate(terms):
            column, kind, k = out[..., i], names[term][0], int(names[term][1])
            if kind == "k":
                gain = powers[(k - 1) % 3] * at.over
                np.multiply(at.u, (gain if k <= 3 else -gain * at.g)[..., None], out=column)
            elif kind == "p":
                along, square = (1, at.yy) if k == 1 else (0, at.xx)
                column[..., 1 - along], column[..., along] = 2 * at.xy, at.r2 + 2 * square
            else:
                column[..., (k - 1) // 2] = powers[(k - 1) % 2]
        return out

    def _undistort(self, m: Array) -> Array:
        """Return u by the inverse radial curve; with other terms, that is the start of Newton's method."""
        rho = np.hypot(m[..., 0], m[..., 1])

        def curve(r: Array) -> tuple[Array, Array]:
            g, dg, _ = self._gain(r * r)
            return r * g, g + 2 * r * r * dg

        r = radial.inverse(curve, rho, self._radial_limit, rough=self._decentred)
        u = m * np.where(rho > 0, r / np.where(rho > 0, rho, 1.0), 1.0)[..., None]
        if not self._decentred:
            return u
        found = radial.newton_plane(self._distort, self._linearised, m, u)
        astray = ~self._inside(found)
        if not astray.any():
            return found
        astray &= rho < self._farthest
        if astray.any():  # Newton's first steps led beyond the fold, or no direction has this image
            found[astray] = radial.newton_plane(
                self._distort, self._linearised, m[astray], u[astray], within=self.valid_radius
            )
        return found


@dataclass(frozen=True, repr=False)
class TiltedBrownConrady(BrownConrady):
    """Brown-Conrady behind a tilted sensor (Scheimpflug): OpenCV's 14 coefficients, tau_x and tau_y in rad at the end.

    The point m of `BrownConrady` moves to the sensor turned by R = Ry(tau_y)^T Rx(tau_x)^T along its ray, m' ~ H (m, 1)
    with H = [[R22, 0, -R02], [0, R22, -R12], [0, 0, 1]] R. Source: Louhichi et al., "Self-calibration of Scheimpflug
    cameras" (2007), in the signs of OpenCV's calib3d.
    """

    tau_x: float = 0.0
    tau_y: float = 0.0

    name: ClassVar[str] = "tilted-brown-conrady"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not max(abs(self.tau_x), abs(self.tau_y)) < np.pi / 2:
            raise BadValue("tilt (tau_x, tau_y)", (self.tau_x, self.tau_y), "less than pi/2 each, rad")

    @classmethod
    def from_opencv(cls, coefficients: Floats) -> TiltedBrownConrady:
        """Return the lens of OpenCV's distortion vector of 14 numbers."""
        c = np.asarray(coefficients, dtype=np.float64).ravel()
        if c.size != 14:
            raise BadValue("number of distortion coefficients", c.size, "14: a tilted lens")
        return cls(*(float(x) for x in c))

    @cached_property
    def valid_radius(self) -> float:
        """Return the radius at which the mapping first folds, or a ray is parallel to the sensor."""
        return radial.fold_limit(self._plane_jacobian, self._radial_limit)

    def _upright_to(self, radius: float) -> bool:
        """Return False: the bound of the untilted lens does not hold here."""
        return False

    @cached_property
    def _untilted(self) -> BrownConrady:
        return BrownConrady(*list(self.parameters.values())[:12])

    @cached_property
    def _tilt(self) -> tuple[Array, Array, Array]:
        """Return H and its derivatives by tau_x and tau_y."""
        (sx, sy), (cx, cy) = np.sin([self.tau_x, self.tau_y]), np.cos([self.tau_x, self.tau_y])
        Rx, dRx = _about_x(1.0, cx, sx), _about_x(0.0, -sx, cx)
        Ry, dRy = _about_y(1.0, cy, sy), _about_y(0.0, -sy, cy)
        R = Ry @ Rx
        by_x, by_y = (_along_ray(dR, 0.0) @ R + _along_ray(R, 1.0) @ dR for dR in (Ry @ dRx, dRy @ Rx))
        return _along_ray(R, 1.0) @ R, by_x, by_y

    def _distort(self, u: Array) -> Array:
        return _moved(self._tilt[0], self._untilted._distort(u))[0]

    def _plane_jacobian(self, u: Array) -> Array:
        _, T = _moved(self._tilt[0], self._untilted._distort(u))
        return T @ self._untilted._plane_jacobian(u)

    def _linearised(self, u: Array, terms: Sequence[int]) -> tuple[Array, Array, Array]:
        H, *dH = self._tilt
        m, by_plane, by_terms = self._untilted._linearised(u, range(12))
        moved, T = _moved(H, m)
        w = _homogeneous(H, m)[..., 2:]
        changes = (_homogeneous(d, m) for d in dH)
        by_tilt = [(change[..., :2] - moved * change[..., 2:]) / w for change in changes]
        every = np.concatenate([T @ by_terms, np.stack(by_tilt, axis=-1)], axis=-1)
        return moved, T @ by_plane, every[..., list(terms)]

    def _undistort(self, m: Array) -> Array:
        straight = _homogeneous(np.asarray(np.linalg.inv(self._tilt[0])), m)
        w = straight[..., 2:]
        return self._untilted._undistort(straight[..., :2] / np.where(w > 0, w, np.nan))


def lens_from_opencv(coefficients: Floats) -> Lens:
    """Return the lens of OpenCV's distortion vector of 0, 4, 5, 8, 12 or 14 numbers, of the simplest class."""
    try:
        c = np.asarray(coefficients, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise BadValue("distortion coefficients", said(coefficients), "0, 4, 5, 8, 12 or 14 numbers") from None
    if c.size == 14 and c[12:].any():
        return TiltedBrownConrady.from_opencv(c)
    lens = BrownConrady.from_opencv(c)
    return lens if any(lens.parameters.values()) else Ideal()


def _about_x(one: float, c: float, s: float) -> Array:
    return np.array([[one, 0, 0], [0, c, s], [0, -s, c]])


def _about_y(one: float, c: float, s: float) -> Array:
    return np.array([[c, 0, -s], [0, one, 0], [s, 0, c]])


def _along_ray(R: Array, one: float) -> Array:
    """Return the homography along its rays from a point rotated by R to the tilted plane (linear in R and `one`)."""
    return np.array([[R[2, 2], 0, -R[0, 2]], [0, R[2, 2], -R[1, 2]], [0, 0, one]])


def _homogeneous(H: Array, m: Array) -> Array:
    """Return H (m, 1) (..., 3)."""
    return np.asarray(m @ H[:, :2].T + H[:, 2])


def _moved(H: Array, m: Array) -> tuple[Array, Array]:
    """Return the image (..., 2) of m under the homography H, and its Jacobian (..., 2, 2)."""
    x = _homogeneous(H, m)
    moved = x[..., :2] / x[..., 2:]
    J = (H[:2, :2] - moved[..., :, None] * H[2, :2]) / x[..., 2:, None]
    return moved, np.asarray(J)
