"""A camera at the pose where it took a picture, with all its uncertainty.

A viewpoint is fixed (where the camera was calibrated), moved from there by a known motion, placed at a known pose, or
located from points of its own. Its uncertainty consists of `ErrorSource`s: the parameters of one calibration or motion.
Viewpoints share a source when they come from the same calibration or motion, and so do the errors of all that is
measured with them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.sensitivity import project_with_sensitivity, twist_by_local
from cadcam.errors import BadValue
from cadcam.geometry.ray import Ray
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.geometry.rotation import hat
from cadcam.kinds import expect, expect_positive, expect_several, said

_POSE, _EXTERNAL = slice(0, 6), 6


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class KnownMotion(Brief):
    """The motion of a camera: new_from_old takes whatever is fixed to the camera from its old place to its new one.

    Both in world coordinates, mm: p_new = new_from_old @ p_old. A robot's flange at base_from_flange gives it as
    base_from_flange(new) @ base_from_flange(old).inv, where the world is the robot's base. covariance (6, 6): of xi in
    new_from_old @ Rigid.exp(xi), in mm and rad; default exact.
    """

    new_from_old: Rigid
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def __post_init__(self) -> None:
        expect_motion(self.new_from_old, "new_from_old")
        object.__setattr__(self, "covariance", frozen(self.covariance, "covariance of the motion", (6, 6)))

    @classmethod
    def of_center(cls, center: Floats, rotation: Floats, translation: Floats) -> KnownMotion:
        """Return the motion that turns a camera about its focal centre (3,) and shifts it: x = R V t + (F + T).

        That is EQ 2.169, with T = F2 - F1 (printed with the other sign in EQ 2.171).
        """
        F, R = frozen(center, "focal centre", (3,)), frozen(rotation, "rotation", (3, 3))
        return cls(Rigid(R, F + frozen(translation, "translation", (3,)) - R @ F))

    def known_to(self, sigma_mm: float, sigma_rad: float, *, about: Floats) -> KnownMotion:
        """Return the motion with independent errors of position and rotation in each axis, about a point of the camera.

        about (3,) is given in its old place, usually the focal centre: there sigma_mm is the error of its own position.
        """
        for name, value in (("sigma_mm", sigma_mm), ("sigma_rad", sigma_rad)):
            expect_positive(value, f"{name} of the motion", "a number from 0 on", zero=True)
        to_point = Rigid(translation=-frozen(about, "about", (3,)))
        Ad = to_point.inv.adjoint()
        local = np.diag([sigma_mm**2] * 3 + [sigma_rad**2] * 3)
        return KnownMotion(self.new_from_old, Ad @ local @ Ad.T)

    def effects(self, center: Floats, n: int) -> tuple[Array, Array]:
        """Return the maps from errors of a camera before a motion (n, n), and of the motion (n, 6), to errors after it.

        The camera's in the n local coordinates of `cadcam.camera.sensitivity`; center (3,): its focal centre before.
        """
        R = self.new_from_old.rotation
        of_home, of_motion = np.eye(n), np.zeros((n, 6))
        of_home[:3, :3] = of_home[3:6, 3:6] = R
        of_motion[:3, :3], of_motion[:3, 3:], of_motion[3:6, 3:] = R, -R @ hat(center), -R
        return of_home, of_motion


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Viewpoint(Brief):
    """A camera at a place: camera_from_world in mm, the noise of its pixels, and what is uncertain about it.

    sigma_px: noise of one pixel coordinate of what is measured here. errors: for each source the matrix (n, k) from its
    parameters to the local coordinates of `cadcam.camera.sensitivity` of this viewpoint. motion: how the camera was
    moved here, if it was. noise_from, noise_dof: the calibration whose residuals gave sigma_px, and its degrees of
    freedom; None and inf where sigma_px was stated.
    """

    name: str
    camera: Camera
    camera_from_world: Rigid
    sigma_px: float
    errors: tuple[tuple[ErrorSource, Array], ...] = ()
    motion: Rigid | None = None
    noise_from: object = field(default=None, repr=False)
    noise_dof: float = np.inf

    def __post_init__(self) -> None:
        expect(self.camera, "camera", Camera)
        expect_motion(self.camera_from_world, "camera_from_world")
        expect_positive(
            self.sigma_px,
            f"pixel noise of viewpoint {self.name!r}",
            "a positive number of px: state sigma_px, for the calibration does not tell it",
        )
        expect_several(self.errors, "errors", ErrorSource)
        pairs = tuple(self.errors)
        for i, pair in enumerate(pairs):
            if not (isinstance(pair, (tuple, list)) and len(pair) == 2 and isinstance(pair[0], ErrorSource)):
                raise BadValue(f"errors[{i}]", said(pair), "an ErrorSource with its effect, a matrix")
        n = 11 + len(self.camera.lens.parameters)
        errors = tuple(
            (s, frozen(D, f"effect of {s.name}", (n, len(s.covariance)))) for s, D in pairs if s.covariance.any()
        )
        object.__setattr__(self, "errors", errors)

    @classmethod
    def exact(cls, name: str, camera: Camera, camera_from_world: Rigid, *, sigma_px: float) -> Viewpoint:
        """Return a viewpoint of a camera without known uncertainty: only the pixels' noise counts."""
        return cls(name, camera, camera_from_world, sigma_px)

    @classmethod
    def fixed(cls, name: str, estimate: CameraEstimate, *, sigma_px: float | None = None) -> Viewpoint:
        """Return the viewpoint of a camera where it was calibrated (section 2.3.1).

        sigma_px defaults to the noise behind the calibration's covariance.
        """
        expect(estimate, "estimate", CameraEstimate)
        pose, as_it_is = estimate.camera_from_world, np.eye(len(estimate.cofactor))
        return _of(name, estimate, pose, sigma_px, _calibration(name, estimate, as_it_is))

    @classmethod
    def moved(
        cls, name: str, estimate: CameraEstimate, motion: KnownMotion, *, sigma_px: float | None = None
    ) -> Viewpoint:
        """Return the viewpoint of a calibrated camera moved away from its calibration (section 2.3.2, EQ 2.170)."""
        expect(estimate, "estimate", CameraEstimate)
        expect(motion, "motion", KnownMotion)
        of_home, of_motion = motion.effects(estimate.camera_from_world.origin, len(estimate.cofactor))
        moving = (ErrorSource(f"motion to {name}", motion.covariance, motion), of_motion)
        pose = estimate.camera_from_world @ motion.new_from_old.inv
        view = _of(name, estimate, pose, sigma_px, (*_calibration(name, estimate, of_home), moving))
        return replace(view, motion=motion.new_from_old)

    @classmethod
    def placed(
        cls,
        name: str,
        estimate: CameraEstimate,
        camera_from_world: Rigid,
        *,
        pose_covariance: Floats | None = None,
        pose_owner: object = None,
        sigma_px: float | None = None,
    ) -> Viewpoint:
        """Return the viewpoint of a calibrated camera at a pose known from elsewhere; its calibrated pose is not used.

        pose_covariance (6, 6): of xi in camera_from_world @ Rigid.exp(xi), mm and rad; default exact. The error is this
        viewpoint's own, as that of a robot that comes back to a place; viewpoints with the same object as pose_owner
        share theirs, and so must have the same covariance.
        """
        expect(estimate, "estimate", CameraEstimate)
        expect_motion(camera_from_world, "camera_from_world")
        internals = np.eye(len(estimate.cofactor))
        internals[_POSE] = 0.0
        covariance = frozen(np.zeros((6, 6)) if pose_covariance is None else pose_covariance, "pose covariance", (6, 6))
        by_pose = np.zeros((len(internals), 6))
        by_pose[_POSE] = twist_by_local(camera_from_world.origin)  # an involution
        pose = (ErrorSource(f"pose of {name}", covariance, object() if pose_owner is None else pose_owner), by_pose)
        errors = (*_calibration(name, estimate, internals), pose)
        return _of(name, estimate, camera_from_world, sigma_px, errors)

    @classmethod
    def located(
        cls, name: str, estimate: CameraEstimate, pose: CameraEstimate, *, sigma_px: float | None = None
    ) -> Viewpoint:
        """Return the viewpoint of a calibrated camera at a pose found from points with its internals kept.

        The internals' errors enter twice, in the rays and in the pose estimated with them; they partly cancel.
        """
        expect(estimate, "estimate", CameraEstimate)
        expect(pose, "pose", CameraEstimate)
        if pose.camera is not estimate.camera and not _same(pose.camera, estimate.camera):
            raise BadValue("the located camera", repr(pose.camera), f"the calibrated one, {estimate.camera!r}")
        _, J = project_with_sensitivity(pose.camera, pose.camera_from_world, pose.observations.p_world)
        J = J.reshape(-1, J.shape[-1])
        with_internals = np.eye(J.shape[1])
        with_internals[_POSE] = 0.0
        with_internals[_POSE, _EXTERNAL:] = -np.linalg.lstsq(J[:, _POSE], J[:, _EXTERNAL:], rcond=None)[0]
        alone = np.eye(J.shape[1])
        found = (ErrorSource(f"points that located {name}", _covariance_of(name, pose), pose, pose.noise_dof), alone)
        errors = (*_calibration(name, estimate, with_internals), found)
        return _of(name, estimate, pose.camera_from_world, sigma_px, errors)

    def less_sure(self, sigma_mm: float, sigma_rad: float, *, why: str) -> Viewpoint:
        """Return the viewpoint with one more, independent error: of its focal centre and direction, along each axis."""
        for name, value in (("sigma_mm", sigma_mm), ("sigma_rad", sigma_rad)):
            expect_positive(value, f"{name} of viewpoint {self.name!r}", "a number from 0 on", zero=True)
        covariance = np.diag([sigma_mm**2] * 3 + [sigma_rad**2] * 3)
        effect = np.eye(11 + len(self.camera.lens.parameters), 6)
        return replace(self, errors=(*self.errors, (ErrorSource(why, covariance, object()), effect)))

    def rays(self, q: Floats) -> Ray:
        """Return the rays (..., 3) in the world of pixels q (..., 2); `BadValue` if there is none."""
        q = frozen(q, "pixels", (2,), batched=True, finite=False)
        direction = self.camera.unproject(q)
        blind = ~np.isfinite(direction).all(axis=-1)
        if np.any(blind):
            raise BadValue(
                f"pixel (column, row) seen by {self.name!r}",
                q[blind][0].tolist(),
                f"finite numbers that the lens can have imaged ({self.camera.lens})",
            )
        return Ray(self.camera_from_world.origin, direction @ self.camera_from_world.rotation)

    def project(self, p_world: Array) -> tuple[Array, Array, tuple[Array, ...]]:
        """Return q (N, 2) px, dq/dp (N, 2, 3) px/mm and dq/d(each error source) (N, 2, k) of world points (N, 3)."""
        q, J = project_with_sensitivity(self.camera, self.camera_from_world, p_world)
        return q, -J[..., :3], tuple(J @ D for _, D in self.errors)

    def ray_covariance(self, q: Floats) -> Array:
        """Return the covariance (N, 6, 6) of origin (mm) and unit direction (rad) of the rays of pixels q (N, 2).

        Pixels' noise and every error source count; the covariance of the point at distance t is that of origin + t
        direction. The direction errs only perpendicular to the ray.
        """
        q = np.atleast_2d(frozen(q, "pixels", (2,), batched=True))
        rays = self.rays(q)
        _, J = project_with_sensitivity(self.camera, self.camera_from_world, rays.at(np.ones(len(q))))
        back = np.linalg.pinv(-J[..., :3])  # from pixels to the rotation of the direction, perpendicular to the ray
        by_local = np.zeros((len(q), 6, J.shape[-1]))
        by_local[:, :3, :3] = np.eye(3)
        by_local[:, 3:, 3:] = -back @ J[..., 3:]
        total = np.zeros((len(q), 6, 6))
        total[:, 3:, 3:] = self.sigma_px**2 * back @ np.swapaxes(back, -1, -2)
        for source, D in self.errors:
            E = by_local @ D
            total += E @ source.covariance @ np.swapaxes(E, -1, -2)
        return total


def _of(
    name: str,
    estimate: CameraEstimate,
    pose: Rigid,
    sigma_px: float | None,
    errors: tuple[tuple[ErrorSource, Array], ...],
) -> Viewpoint:
    """Return a viewpoint of a calibrated camera, with the stated pixel noise or that of the calibration."""
    if sigma_px is not None:
        return Viewpoint(name, estimate.camera, pose, sigma_px, errors)
    return Viewpoint(
        name, estimate.camera, pose, estimate.noise_px, errors, noise_from=estimate, noise_dof=estimate.noise_dof
    )


def _calibration(name: str, estimate: CameraEstimate, effect: Array) -> tuple[tuple[ErrorSource, Array], ...]:
    """Return what `effect` makes of the errors of an estimate: of its own, or shared with others."""
    covariance = _covariance_of(name, estimate)
    if estimate.errors:
        return tuple((source, effect @ D) for source, D in estimate.errors)
    return ((ErrorSource("calibration", covariance, estimate, estimate.noise_dof), effect),)


def _covariance_of(name: str, estimate: CameraEstimate) -> Array:
    if not np.isfinite(estimate.noise_px):
        raise BadValue(
            f"calibration noise of viewpoint {name!r}",
            "unknown (as many equations as unknowns, no sigma_px stated)",
            "a calibration with its noise: more points, or sigma_px with them",
        )
    return np.asarray(estimate.noise_px**2 * estimate.cofactor)


def _same(one: Camera, other: Camera) -> bool:
    return one.size == other.size and one.lens == other.lens and bool(np.allclose(one.K, other.K, rtol=1e-9, atol=1e-9))
