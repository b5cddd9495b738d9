"""A hand-eye calibration as it comes out: two motions with their covariance, the robot's noise, what was held out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from cadcam.arrays import Array, Mask, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid

Mounting = Literal["eye-in-hand", "eye-to-hand"]
MOUNTINGS: tuple[Mounting, ...] = get_args(Mounting)

SUSPICIOUS = 0.01  # chance that any pose of a clean set looks as strange as one that is marked


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Each pose (n,) predicted from all the others and the robot's word for where it stood.

    px: rms distance between predicted and measured pixels (nan where no pixels were given); mm: rms distance of the
    target's points (or of its origin) between where they should be and where this picture alone puts them; rotation:
    of the target, rad. chance: that a pose without a mistake is this far off by the noise of the others (F test).
    """

    px: Array
    mm: Array
    rotation: Array
    chance: Array

    def __post_init__(self) -> None:
        for name in ("px", "mm", "rotation", "chance"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"held-out {name}", (None,), finite=False))


@dataclass(frozen=True, slots=True, eq=False)
class RobotNoise:
    """Standard deviations of one coordinate of the flange's position (mm) and orientation (rad), with their own sigmas.

    This is what the robot's poses and the pictures disagree by: repeatability, kinematic errors, a shaking mount. A
    noise that is not there comes out as practically zero, with a sigma that bounds it.
    """

    translation: float
    rotation: float
    translation_sigma: float
    rotation_sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeEstimate:
    """Where a camera sits on the flange (eye-in-hand) or in the base (eye-to-hand), from n poses.

    flange_from_held: of the camera (eye-in-hand) or the target (eye-to-hand); base_from_fixed: of the target or the
    camera. covariance (12, 12): of (xi of flange_from_held, xi of base_from_fixed) in X @ exp(xi), mm and rad.
    degrees_of_freedom (12,): behind each variance, as the robot's noise is known from few poses; see `coverage_factor`.
    offsets (n, 6): by how much the flange seems to have stood off its stated pose, position mm and rotation rad in
    flange axes. camera_from_target (n): as each picture alone shows it. residuals_px (n,): rms of one pixel coordinate.
    noise_px: of one pixel coordinate, None where poses were given in place of pixels. scale: the robot's millimetres
    in one of the target's, with its sigma, tested apart. second_pose (n,): where a flat target's second pose was taken
    because the robot says so. camera: as adjusted, None where poses were given.
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
    def flange_from_camera(self) -> Rigid:
        """Return where the camera sits on the flange; eye-in-hand only."""
        self._only("eye-in-hand", "flange_from_camera", "base_from_camera")
        return self.flange_from_held

    @property
    def base_from_camera(self) -> Rigid:
        """Return where the camera stands in the robot's base; eye-to-hand only."""
        self._only("eye-to-hand", "base_from_camera", "flange_from_camera")
        return self.base_from_fixed

    @property
    def base_from_target(self) -> Rigid:
        """Return where the target stands in the robot's base; eye-in-hand only."""
        self._only("eye-in-hand", "base_from_target", "flange_from_target")
        return self.base_from_fixed

    @property
    def flange_from_target(self) -> Rigid:
        """Return where the target sits on the flange; eye-to-hand only."""
        self._only("eye-to-hand", "flange_from_target", "base_from_target")
        return self.flange_from_held

    @property
    def covariance_of_camera(self) -> Array:
        """Return the covariance (6, 6) of xi in flange_from_camera @ exp(xi), or base_from_camera: camera axes."""
        return self._block(camera=True)

    @property
    def covariance_of_target(self) -> Array:
        """Return the covariance (6, 6) of xi in base_from_target @ exp(xi), or flange_from_target: target axes."""
        return self._block(camera=False)

    def coverage_factor(self, level: float = 0.95) -> Array:
        """Return by what each sigma of the camera's six coordinates is multiplied for an interval of this level, (6,).

        Student's t with `degrees_of_freedom` (GUM, annex G): 1.96 where much is known, more for few poses.
        """
        from scipy.special import stdtrit

        if not 0 < level < 1:
            raise BadValue("level", level, "a share between 0 and 1, such as 0.95")
        held = self.mounting == "eye-in-hand"
        freedom = np.minimum(self.degrees_of_freedom[:6] if held else self.degrees_of_freedom[6:], 1e6)
        return np.asarray(stdtrit(freedom, (1 + level) / 2))

    @property
    def suspicious(self) -> Mask:
        """Return which poses (n,) are farther off than chance allows in so many."""
        return np.asarray(self.held_out.chance * len(self.names) < SUSPICIOUS)

    def base_from_camera_at(self, base_from_flange: Rigid) -> tuple[Rigid, Array]:
        """Return where the camera is when the robot says base_from_flange, and the covariance (6, 6) of that.

        Covariance of base_from_camera @ exp(xi), in camera axes. Eye-in-hand: the calibration's and the robot's noise
        together. Eye-to-hand: the camera does not move and the robot's noise does not enter.
        """
        if self.mounting == "eye-to-hand":
            return self.base_from_fixed, self.covariance_of_camera
        noise = np.repeat([self.robot_noise.translation**2, self.robot_noise.rotation**2], 3)
        Ad = self.flange_from_held.inv.adjoint()
        return base_from_flange @ self.flange_from_held, self.covariance_of_camera + Ad @ np.diag(noise) @ Ad.T

    def _block(self, *, camera: bool) -> Array:
        held = camera == (self.mounting == "eye-in-hand")
        return self.covariance[:6, :6] if held else self.covariance[6:, 6:]

    def _only(self, mounting: Mounting, name: str, other: str) -> None:
        if self.mounting != mounting:
            raise BadValue(f"{name} of an {self.mounting} calibration", "not defined", f"{other}, which it has")

    def __repr__(self) -> str:
        what = "flange_from_camera" if self.mounting == "eye-in-hand" else "base_from_camera"
        pose = self.flange_from_held if self.mounting == "eye-in-hand" else self.base_from_fixed
        return f"HandEyeEstimate({self.mounting}, {len(self.names)} poses, {what} {pose})"
