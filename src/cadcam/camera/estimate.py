"""The result of a calibration or pose estimate: a camera with covariance, residuals and observations."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cadcam.arrays import Array, Floats, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.extended_pinhole import EXTERNALS, MATRIX_ENTRIES, NAMES, ExtendedPinhole, matrix_entry
from cadcam.camera.fitted import Fitted, doubted, freedom_words, noise_may_be_times, scaled
from cadcam.camera.observations import Observations
from cadcam.camera.sensitivity import project_with_sensitivity, rotation_by_angles, twist_by_local
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect_known

WEAK = 2.0  # factor by which the noise may exceed its estimate: 5 degrees of freedom and fewer
SMALL_MM = 1.0  # points with a smaller extent are hardly in mm
_ANGLES, _INTERNALS = slice(3, 6), slice(6, 11)


@dataclass(frozen=True, slots=True, eq=False)
class CameraEstimate(Fitted):
    """A camera and its pose, estimated from points; a pose estimate is the same with fixed internals.

    free: the names of the estimated parameters, a subset of `parameters` (the thesis' eleven, then the lens' own).
    cofactor: covariance (n, n) of the local coordinates of `cadcam.camera.sensitivity` for pixel noise of 1 px, zero
    where nothing was free. It has no gimbal lock; `covariance` is the same in the thesis' parameters. method: how it
    was computed, one line. alternative: the other pose that a flat target allows (or another minimum nearly as good),
    with its residuals; else None. errors: where the error is shared with other estimates (those of one joint
    calibration), what it comes from, each source with the matrix (n, k) to the local coordinates; empty where it is its
    own.
    """

    camera: Camera
    camera_from_world: Rigid
    observations: Observations
    free: tuple[str, ...]
    cofactor: Array
    method: str = ""
    alternative: CameraEstimate | None = field(default=None, repr=False)
    errors: tuple[tuple[ErrorSource, Array], ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        n = len(self.parameters)
        object.__setattr__(self, "cofactor", frozen(self.cofactor, "cofactor", (n, n)))
        errors = tuple((s, frozen(D, f"effect of {s.name}", (n, len(s.covariance)))) for s, D in self.errors)
        object.__setattr__(self, "errors", errors)
        for name in self.free:
            expect_known(name, "parameter", self.parameters)
        if len(set(self.free)) != len(self.free):
            raise BadValue("free parameters", self.free, "each name once")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return all names: X Y Z (mm), a b c (rad), aspect, focal (px), skew (rad), U0 V0 (px), lens coefficients."""
        return (*NAMES, *self.camera.lens.parameters)

    @property
    def extended_pinhole(self) -> ExtendedPinhole:
        """Return the eleven parameters; the lens is not among them."""
        return ExtendedPinhole.from_camera(self.camera, self.camera_from_world)

    @property
    def values(self) -> Array:
        """Return the values (n,) of `parameters`, angles in rad."""
        return np.concatenate([self.extended_pinhole.vector, list(self.camera.lens.parameters.values())])

    def value(self, name: str) -> float:
        """Return one parameter (mm, rad, px), or fx, fy, cx, cy of the camera matrix (px)."""
        entry = matrix_entry(self.camera, name)
        return float(self.values[self._index(name)]) if entry is None else entry[0]

    @property
    def residuals(self) -> Array:
        """Return measured minus projected pixels (column, row), (N, 2)."""
        return self.observations.q - self.camera.project(self.camera_from_world @ self.observations.p_world)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Return what speaks against the estimate, one sentence each.

        Too few equations to know the noise, points too small for millimetres, points outside the picture.
        """
        said, seen = [], self.observations
        times = noise_may_be_times(self.dof)
        if seen.sigma_px is None and self.dof > 0 and times > WEAK:
            said.append(
                f"warning: with {freedom_words(self.dof)} the noise, and every sigma with it, may be {times:.2g} times "
                "what the residuals say (95 %); add points, or state the noise (sigma_px)"
            )
        extent = float(np.ptp(seen.p_world, axis=0).max())
        if extent < SMALL_MM:
            said.append(
                f"warning: the points span {extent:.3g} mm: is their unit right? X_m, Y_m, Z_m in the header if not"
            )
        outside = int((~self.camera.sees(seen.q)).sum())
        if outside:
            width, height = self.camera.size
            count = f"{outside} of {len(seen)} pixels lie"
            said.append(f"warning: {count} outside the picture of {width} x {height} px: is it the right one?")
        return tuple(said)

    @property
    def unknowns(self) -> int:
        """Return the number of free parameters."""
        return len(self.free)

    @property
    def pose_alone(self) -> bool:
        """Return whether the camera's own numbers were kept, so that the covariance takes them as exact."""
        return set(self.free) <= set(EXTERNALS)

    @property
    def rms_px(self) -> float:
        """Return the root mean square of one pixel coordinate, sqrt(sum(dU^2 + dV^2)/(2N)): thesis_residual/sqrt(2)."""
        return float(np.sqrt(self.sum_of_squares / (2 * len(self.observations))))

    def worst(self) -> tuple[str, float]:
        """Return the name of the point with the largest residual and that distance in px."""
        distance = np.linalg.norm(self.residuals, axis=1)
        i = int(np.argmax(distance))
        return self.observations.names[i], float(distance[i])

    @property
    def covariance(self) -> Array:
        """Return the covariance (n, n) of `parameters` in mm, rad, px; rows and columns of fixed ones are zero.

        The angles' part is undefined at b = +-90 deg (gimbal lock): use `pose_covariance` there. With `noise_px` inf
        the diagonal of the free parameters is inf and the rest zero.
        """
        free = np.isin(self.parameters, self.free)
        return scaled(self._cofactor * np.outer(free, free), self.noise_px)

    def sigma(self, name: str) -> float:
        """Return the standard deviation of one parameter (mm, rad, px), or of fx, fy, cx, cy; 0 for a fixed one."""
        entry = matrix_entry(self.camera, name)
        if entry is not None:
            by = np.zeros(len(self.parameters))
            by[_INTERNALS] = entry[1]
            return float(np.sqrt(scaled(np.atleast_2d(by @ self._cofactor @ by), self.noise_px)[0, 0]))
        i = self._index(name)
        return float(np.sqrt(self.covariance[i, i]))

    @property
    def correlation(self) -> Array:
        """Return the correlation matrix of the free parameters, in the order of `free`; independent of the noise."""
        index = [self._index(name) for name in self.free]
        C = self._cofactor[np.ix_(index, index)]
        sd = np.sqrt(np.diag(C))
        return np.asarray(C / np.outer(sd, sd))

    @property
    def pose_covariance(self) -> Array:
        """Return the covariance (6, 6) of xi in `camera_from_world @ Rigid.exp(xi)`: (mm, rad) in the world frame."""
        B = twist_by_local(self.camera_from_world.origin)
        return scaled(B @ self.cofactor[:6, :6] @ B.T, self.noise_px)

    def projection_covariance(self, p_world: Floats) -> Array:
        """Return the covariance (..., 2, 2) px^2 of the images of world points (..., 3), due to the camera's error."""
        points = frozen(p_world, "world points", (3,), batched=True, finite=False)
        _, J = project_with_sensitivity(self.camera, self.camera_from_world, points.reshape(-1, 3))
        cofactor = J @ self.cofactor @ np.swapaxes(J, -1, -2)
        return scaled(cofactor, self.noise_px).reshape(*points.shape[:-1], 2, 2)

    @property
    def _cofactor(self) -> Array:
        """Return the cofactor matrix (n, n) of `parameters`: with the thesis' angles for the local rotation."""
        T = np.eye(len(self.parameters))
        T[_ANGLES, _ANGLES] = np.linalg.pinv(rotation_by_angles(self.camera_from_world.rotation))
        return np.asarray(T @ self.cofactor @ T.T)

    def _index(self, name: str) -> int:
        if name not in self.parameters:
            raise UnknownName("parameter", name, (*self.parameters, *MATRIX_ENTRIES))
        return self.parameters.index(name)

    def __repr__(self) -> str:
        return (
            f"CameraEstimate({len(self.observations)} points, {len(self.free)} free, "
            f"residual {self.thesis_residual:.4g} px, {self.camera}{doubted(self.doubts)})"
        )
