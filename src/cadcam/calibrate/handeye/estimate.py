"""The result of a hand-eye calibration: two motions with their covariance, the robot's noise, held-out errors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from cadcam.arrays import Array, Brief, Locked, Mask, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.fitted import doubted
from cadcam.camera.observations import Observations
from cadcam.camera.sensitivity import twist_by_local
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect

Mounting = Literal["eye-in-hand", "eye-to-hand"]
MOUNTINGS: tuple[Mounting, ...] = get_args(Mounting)

_SCALE_SIGMAS, _SCALE_SHARE = 4.0, 0.005  # a target's size off by more than both is reported
_FEW = 6  # poses
_SMALL_MM = 10.0  # a robot that moved by less was hardly read in mm
SUSPICIOUS = 0.01  # chance that any pose of a clean set is marked


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HeldOut(Brief):
    """Each pose (n,) predicted from all the others and the robot's stated pose.

    px: rms distance between predicted and measured pixels (nan without pixels); mm: rms distance of the target's points
    (or of its origin) between their prediction and the pose estimated from this picture alone; rotation: of the target,
    rad. chance: that a pose without a blunder is this far off, given the noise of the others (F test). Where the others
    do not determine the solution they predict nothing: nan, and chance 1.
    """

    px: Array
    mm: Array
    rotation: Array
    chance: Array

    def __post_init__(self) -> None:
        for name in ("px", "mm", "rotation", "chance"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"held-out {name}", (None,), finite=False))

    @property
    def rms(self) -> tuple[float, float, float]:
        """Return the root mean squares over the poses predicted: px (nan without pixels), mm and rad; nan for none."""
        some = np.isfinite(self.mm)
        if not some.any():
            return float("nan"), float("nan"), float("nan")
        px, mm, rotation = (float(np.sqrt(np.mean(each[some] ** 2))) for each in (self.px, self.mm, self.rotation))
        return px, mm, rotation


@dataclass(frozen=True, slots=True, eq=False)
class RobotNoise:
    """Standard deviations of one coordinate of the flange's position (mm) and orientation (rad), with their own sigmas.

    This is the disagreement of the robot's poses and the pictures: repeatability, kinematic errors, a shaking mount.
    Absent noise is estimated as practically zero, with a sigma that bounds it.
    """

    translation: float
    rotation: float
    translation_sigma: float
    rotation_sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeEstimate(Locked):
    """The pose of a camera on the flange (eye-in-hand) or in the base (eye-to-hand), from n poses.

    flange_from_held: of the camera (eye-in-hand) or the target (eye-to-hand); base_from_fixed: of the target or the
    camera. covariance (12, 12): of (xi of flange_from_held, xi of base_from_fixed) in X @ exp(xi), mm and rad.
    degrees_of_freedom (12,): of each variance, as the robot's noise is estimated from few poses; see `coverage_factor`.
    offsets (n, 6): the estimated deviation of the flange from its stated pose, position mm and rotation rad in flange
    axes. camera_from_target (n): from each picture alone. residuals_px (n,): rms of one pixel coordinate. noise_px: of
    one pixel coordinate, None where poses were given instead of pixels. scale: the robot's millimetres per millimetre
    of the target, with its sigma, tested separately. second_pose (n,): where a flat target's second pose was taken
    because the robot contradicts the first. camera: as adjusted, None where poses were given.
    """

    mounting: Mounting
    names: tuple[str, ...]
    base_from_flange: Rigid
    camera_from_target: Rigid
    flange_from_held: Rigid
    base_from_fixed: Rigid
    covariance: Array
    degrees_of_freedom: Array
    robot_noise: RobotNoise
    offsets: Array
    held_out: HeldOut
    scale: float
    scale_sigma: float
    noise_px: float | None = None
    residuals_px: Array = field(default_factory=lambda: np.zeros(0))
    second_pose: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))
    camera: Camera | None = None
    observations: tuple[Observations, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "covariance", frozen(self.covariance, "covariance", (12, 12)))
        for_all = frozen(self.degrees_of_freedom, "degrees of freedom", (12,), finite=False)
        object.__setattr__(self, "degrees_of_freedom", for_all)
        object.__setattr__(self, "offsets", frozen(self.offsets, "offsets", (n, 6)))
        object.__setattr__(self, "residuals_px", frozen(self.residuals_px, "residuals", (None,)))
        object.__setattr__(self, "second_pose", frozen(self.second_pose, "second poses", (None,), np.bool_))

    @property
    def in_hand(self) -> bool:
        """Return whether the camera is on the flange, and not in the cell."""
        return self.mounting == "eye-in-hand"

    @property
    def pose_of_camera(self) -> Rigid:
        """Return flange_from_camera, or base_from_camera."""
        return self.flange_from_held if self.in_hand else self.base_from_fixed

    @property
    def pose_of_target(self) -> Rigid:
        """Return base_from_target, or flange_from_target."""
        return self.base_from_fixed if self.in_hand else self.flange_from_held

    @property
    def flange_from_camera(self) -> Rigid:
        """Return the pose of the camera on the flange; eye-in-hand only."""
        self._only("eye-in-hand", "flange_from_camera", "base_from_camera")
        return self.flange_from_held

    @property
    def base_from_camera(self) -> Rigid:
        """Return the pose of the camera in the robot's base; eye-to-hand only."""
        self._only("eye-to-hand", "base_from_camera", "flange_from_camera")
        return self.base_from_fixed

    @property
    def base_from_target(self) -> Rigid:
        """Return the pose of the target in the robot's base; eye-in-hand only."""
        self._only("eye-in-hand", "base_from_target", "flange_from_target")
        return self.base_from_fixed

    @property
    def flange_from_target(self) -> Rigid:
        """Return the pose of the target on the flange; eye-to-hand only."""
        self._only("eye-to-hand", "flange_from_target", "base_from_target")
        return self.flange_from_held

    @property
    def covariance_of_camera(self) -> Array:
        """Return the covariance (6, 6) of xi in flange_from_camera @ exp(xi), or base_from_camera: camera axes."""
        return self.covariance[:6, :6] if self.in_hand else self.covariance[6:, 6:]

    @property
    def covariance_of_target(self) -> Array:
        """Return the covariance (6, 6) of xi in base_from_target @ exp(xi), or flange_from_target: target axes."""
        return self.covariance[6:, 6:] if self.in_hand else self.covariance[:6, :6]

    def coverage_factor(self, level: float = 0.95) -> Array:
        """Return the factors (6,) of the camera's sigmas for an interval of this level.

        Student's t with `degrees_of_freedom` (GUM, annex G): 1.96 for many, more for few poses.
        """
        from scipy.special import stdtrit

        if not 0 < level < 1:
            raise BadValue("level", level, "a share between 0 and 1, such as 0.95")
        freedom = np.minimum(self.degrees_of_freedom[:6] if self.in_hand else self.degrees_of_freedom[6:], 1e6)
        return np.asarray(stdtrit(freedom, (1 + level) / 2))

    @property
    def suspicious(self) -> Mask:
        """Return which poses (n,) are farther off than chance allows among so many."""
        return np.asarray(self.held_out.chance * len(self.names) < SUSPICIOUS)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Return what speaks against it, one sentence each: units, the target's size, single poses, too few of them."""
        off, sigma, said = self.scale - 1, self.scale_sigma, []
        span = float(np.ptp(self.base_from_flange.translation, axis=0).max())
        if span < _SMALL_MM:
            said.append(f"warning: the robot moved by {span:.3g} mm only: are its positions, and the target's, in mm?")
        if abs(off) > max(_SCALE_SIGMAS * sigma, _SCALE_SHARE):
            said.append(
                f"warning: by the robot's lengths the target is {self.scale:.3f} +- {sigma:.3f} times as large as "
                "stated: check its size (the length of a square), the robot's unit and tool, the camera's focal "
                "length; else the camera's place is wrong by as much"
            )
        names = [repr(n) for n, s in zip(self.names, self.suspicious, strict=True) if s]
        if names:
            said.append(f"warning: pose {', '.join(names)} contradicts the others; look at it, or leave it out")
        if self.second_pose.any():
            seconds = ", ".join(repr(n) for n, s in zip(self.names, self.second_pose, strict=True) if s)
            said.append(f"in {seconds} the flat target's second pose was taken: the picture allows both, the robot one")
        n = len(self.names)
        if n < _FEW:
            said.append(
                f"warning: the robot's noise comes from {n} poses, and every sigma with it; 10 or more are better"
            )
        return tuple(said)

    def base_from_camera_at(self, base_from_flange: Rigid) -> tuple[Rigid, Array]:
        """Return the pose of the camera when the robot reports base_from_flange, and its covariance (6, 6).

        Covariance of base_from_camera @ exp(xi), in camera axes. Eye-in-hand: the calibration's and the robot's noise
        together. Eye-to-hand: the camera does not move and the robot's noise does not enter.
        """
        if not self.in_hand:
            return self.base_from_fixed, self.covariance_of_camera
        Ad = self.flange_from_held.inv.adjoint()
        covariance = self.covariance_of_camera + Ad @ self._flange_covariance @ Ad.T
        return base_from_flange @ self.flange_from_held, covariance

    def viewpoint(
        self,
        name: str,
        camera: Camera | CameraEstimate,
        base_from_flange: Rigid | None = None,
        *,
        sigma_px: float | None = None,
    ) -> Viewpoint:
        """Return where the camera takes a picture, in the robot's base, for `Photo` and `measure_points`.

        base_from_flange: as the robot reports it then; eye-in-hand only. camera: with the errors of its internals, if
        it is an estimate. Viewpoints of one calibration share its error; the robot's noise is each one's own. sigma_px:
        of a pixel coordinate, by default that of the camera's estimate or of this calibration.
        """
        expect(camera, "camera", Camera, CameraEstimate)
        expect_motion(base_from_flange, "base_from_flange", optional=not self.in_hand)
        flange = Rigid() if base_from_flange is None else base_from_flange
        place = self.base_from_camera_at(flange)[0]
        if isinstance(camera, CameraEstimate):
            view = Viewpoint.placed(name, camera, place.inv, sigma_px=sigma_px)
        else:
            view = Viewpoint.exact(name, camera, place.inv, sigma_px=sigma_px or self.noise_px or np.nan)
        of_camera = np.zeros((11 + len(view.camera.lens.parameters), 6))
        of_camera[:6] = -twist_by_local(view.camera_from_world.origin) @ place.adjoint()
        errors = [(ErrorSource("hand-eye calibration", self.covariance_of_camera, self), of_camera)]
        if self.in_hand:
            noise = ErrorSource(f"robot at {name}", self._flange_covariance, object())
            errors.append((noise, of_camera @ self.flange_from_held.inv.adjoint()))
        return replace(view, errors=(*view.errors, *errors))

    @property
    def _flange_covariance(self) -> Array:
        noise = self.robot_noise
        return np.diag(np.repeat([noise.translation**2, noise.rotation**2], 3))

    def _only(self, mounting: Mounting, name: str, other: str) -> None:
        if self.mounting != mounting:
            raise BadValue(f"{name} of an {self.mounting} calibration", "not defined", f"{other}, which it has")

    def __repr__(self) -> str:
        what = "flange_from_camera" if self.in_hand else "base_from_camera"
        noise, rotation = self.robot_noise.translation, np.degrees(self.robot_noise.rotation)
        robot = f"robot's noise {noise:.2g} mm, {rotation:.2g} deg{doubted(self.doubts)}"
        return f"HandEyeEstimate({self.mounting}, {len(self.names)} poses, {what} {self.pose_of_camera}, {robot})"
