"""The camera of a plane that images onto a line (2D to 1D): five parameters <-> 2x3 matrix, and the ray of a pixel.

World points (x, y) in mm, image points U in px. With x' along the image line and y' backwards:

    (x', y') = R (p - F),  R = [[cos(alpha), sin(alpha)], [-sin(alpha), cos(alpha)]]
    U = U0 + focal x'/(-y')

focal < 0 is the mirror image: U counts the other way. Rotating alpha by 180 deg changes no image point, only which side
is in front. Source: "Industrial Vision" (1997), section 2.1, with the signs of docs/thesis/errata.md.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields, replace
from hashlib import sha256

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.camera.fitted import Fitted, scaled
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.coordinates import coordinates
from cadcam.geometry.ray import Ray
from cadcam.kinds import expect_known, expect_numbers, expect_positive


@dataclass(frozen=True, slots=True)
class LineCamera:
    """The five parameters: focal centre (x, y) mm, alpha rad, focal px (negative for a mirror image), U0 px."""

    x: float
    y: float
    alpha: float
    focal: float
    U0: float

    def __post_init__(self) -> None:
        expect_numbers(self)
        for name, value in zip(LINE_NAMES, astuple(self), strict=True):
            if not np.isfinite(value):
                raise BadValue(name, value, "a finite number")
        if self.focal == 0:
            raise BadValue("focal", self.focal, "a focal length in px, negative where U counts the other way")

    @classmethod
    def from_vector(cls, values: Floats) -> LineCamera:
        """Return the camera of an array (5,) in the order x, y, alpha (rad), focal, U0."""
        return cls(*(float(v) for v in frozen(values, "line camera parameters", (5,))))

    @classmethod
    def from_matrix(cls, C: Floats) -> LineCamera:
        """Return the camera of a 2x3 matrix with (U, 1) ~ C (x, y, 1), of any scale and sign (EQ 2.31-2.53).

        alpha is in (-90, 90] deg: a matrix does not determine its front, see `facing`. Raises `DegenerateGeometry`
        where M has no inverse: the focal centre is then at infinity.
        """
        C = frozen(C, "2x3 projection matrix", (2, 3))
        M = C[:, :2]
        rows = np.linalg.norm(M, axis=1)
        if not rows.all() or abs(np.linalg.det(M / rows[:, None])) < 1e-14:
            raise DegenerateGeometry("M = C[:, :2] has no inverse: the focal centre is at infinity")
        F = -np.linalg.solve(M, C[:, 2])
        alpha = np.arctan2(-M[1, 0], M[1, 1])
        return cls.from_vector(
            [
                *F,
                alpha - np.pi * np.sign(alpha) * (abs(alpha) > np.pi / 2),
                -np.linalg.det(M) / rows[1] ** 2,
                M[0] @ M[1] / rows[1] ** 2,
            ]
        )

    @property
    def vector(self) -> Array:
        """Return the parameters (5,) in the order x, y, alpha, focal, U0."""
        return np.array(astuple(self))

    @property
    def center(self) -> Array:
        """Return the focal centre (2,), mm."""
        return np.array([self.x, self.y])

    @property
    def rotation(self) -> Array:
        """Return R (2, 2): rows are the image line's direction and the backward axis (EQ 2.12)."""
        s, c = np.sin(self.alpha), np.cos(self.alpha)
        return np.array([[c, s], [-s, c]])

    @property
    def unnormalized_matrix(self) -> Array:
        """Return K = U P R D (2, 3) of EQ 2.15; its second row is the depth divided by the focal length."""
        RD = np.column_stack([self.rotation, -self.rotation @ self.center])
        return np.array([[1.0, -self.U0 / self.focal], [0.0, -1.0 / self.focal]]) @ RD

    @property
    def matrix(self) -> Array:
        """Return C = K/K12 (2, 3); `DegenerateGeometry` where the world's origin has depth 0."""
        K = self.unnormalized_matrix
        if abs(K[1, 2]) <= 1e-12 * np.abs(K[1]).max():
            raise DegenerateGeometry(
                "C12 = 1 is impossible: the world's origin lies beside the focal centre, at depth 0; use "
                "unnormalized_matrix, or shift the world's origin"
            )
        return np.asarray(K / K[1, 2])

    def facing(self, p: Floats) -> LineCamera:
        """Return the same camera with points p (..., 2) in front: all of them, or `DegenerateGeometry`."""
        depth = self.depth(p)
        if np.all(depth > 0):
            return self
        if np.all(depth < 0):
            return replace(self, alpha=float(np.arctan2(-np.sin(self.alpha), -np.cos(self.alpha))))
        raise DegenerateGeometry(
            f"{int(np.sum(depth <= 0))} of {np.size(depth)} points lie on one side of the focal centre and the rest on "
            "the other: points and image coordinates do not belong together"
        )

    def depth(self, p: Floats) -> Array:
        """Return the depths (...) mm of points (..., 2) in front of the focal centre."""
        return np.asarray(-(coordinates(p, "points of the plane", 2) - self.center) @ self.rotation[1])

    def project(self, p: Floats) -> Array:
        """Return U (...) px of points (..., 2) mm; NaN where they are not in front."""
        return self.project_with_jacobians(p)[0]

    def project_with_jacobians(self, p: Floats) -> tuple[Array, Array, Array]:
        """Return U (...), dU/dp (..., 2) px/mm and dU/d(x, y, alpha, focal, U0) (..., 5); NaN where not in front."""
        depth = self.depth(p)
        along = (np.asarray(p, dtype=np.float64) - self.center) @ self.rotation[0]
        with np.errstate(all="ignore"):
            z = np.where(depth > 0, depth, np.nan)
            m = along / z
            dU_dp = self.focal * (self.rotation[0] + m[..., None] * self.rotation[1]) / z[..., None]
        of_five = np.concatenate(
            [-dU_dp, np.stack([-self.focal * (1 + m**2), m, np.where(np.isfinite(m), 1.0, np.nan)], axis=-1)], axis=-1
        )
        return self.U0 + self.focal * m, dU_dp, of_five

    def ray(self, U: Floats) -> Ray:
        """Return the rays (..., 2) in the world plane along which U (...) px is seen (EQ 2.29-2.31)."""
        m = (np.asarray(U, dtype=np.float64) - self.U0) / self.focal
        return Ray(self.center, m[..., None] * self.rotation[0] - self.rotation[1])

    def line(self, U: Floats) -> Array:
        """Return the lines (..., 3) of world points imaged at U (...): l . (x, y, 1) = 0, |(l0, l1)| = 1.

        Equivalent to EQ 2.6, y = a x + b, where the line is not vertical: a = -l0/l1, b = -l2/l1.
        """
        K = self.unnormalized_matrix
        lines = K[0] - np.asarray(U, dtype=np.float64)[..., None] * K[1]
        return np.asarray(lines / np.linalg.norm(lines[..., :2], axis=-1, keepdims=True))


LINE_NAMES: tuple[str, ...] = tuple(f.name for f in fields(LineCamera))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LineObservations(Brief):
    """N points (N, 2) mm of the plane and their images in the line camera, U (N,) px; the rest as in `Observations`."""

    p_world: Array
    U: Array
    names: tuple[str, ...] = ()
    sigma_px: float | None = None
    source: str = "memory"
    sha256: str = ""

    def __post_init__(self) -> None:
        p = frozen(self.p_world, "points of the plane", (None, 2))
        U = frozen(self.U, "image coordinates U", (None,))
        names = tuple(str(n) for n in self.names) or tuple(str(i + 1) for i in range(len(p)))
        if not len(p) == len(U) == len(names):
            raise BadValue("number of points, image coordinates, names", (len(p), len(U), len(names)), "one for all")
        if self.sigma_px is not None:
            expect_positive(self.sigma_px, "sigma_px", "a positive number of pixels, or None")
        object.__setattr__(self, "p_world", p)
        object.__setattr__(self, "U", U)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "sha256", self.sha256 or sha256(p.tobytes() + U.tobytes()).hexdigest())

    def __len__(self) -> int:
        return len(self.p_world)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LineEstimate(Fitted, Brief):
    """A line camera estimated from points; cofactor (5, 5) is its covariance for noise of 1 px, in mm, rad, px."""

    camera: LineCamera
    observations: LineObservations
    cofactor: Array
    method: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cofactor", frozen(self.cofactor, "cofactor", (5, 5)))

    @property
    def residuals(self) -> Array:
        """Return measured minus projected U (N, 1), px."""
        return np.asarray(self.observations.U - self.camera.project(self.observations.p_world))[:, None]

    @property
    def unknowns(self) -> int:
        """Return 5."""
        return 5

    @property
    def covariance(self) -> Array:
        """Return the covariance (5, 5) of x, y (mm), alpha (rad), focal, U0 (px); inf where the noise is unknown."""
        return scaled(self.cofactor, self.noise_px)

    def sigma(self, name: str) -> float:
        """Return the standard deviation of one parameter: x, y, alpha, focal or U0."""
        expect_known(name, "parameter", LINE_NAMES)
        i = LINE_NAMES.index(name)
        return float(np.sqrt(self.covariance[i, i]))

    def projection_sigma(self, p: Floats) -> Array:
        """Return the standard deviation (...) px of the images of points (..., 2), due to the camera's error."""
        J = self.camera.project_with_jacobians(p)[2]
        return np.asarray(np.sqrt(np.einsum("...i,ij,...j->...", J, self.covariance, J)))
