"""The estimated pose of a part, always with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Floats, frozen
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.geometry.rotation import hat


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoseEstimate:
    """The pose world_from_part (mm) of a part; with one camera and no other frame the world is that camera's.

    from_noise, from_calibration (6, 6): covariance of xi in `world_from_part @ Rigid.exp(xi)`, (translation mm,
    rotation rad) in the part's own axes, due to the photos' noise and to the errors of the cameras' parameters and
    poses. freedom (6, k): the motions xi that were free, orthonormal columns; the covariances are zero across them.
    dof: degrees of freedom behind from_noise; inf where the noise is known.
    """

    world_from_part: Rigid
    from_noise: Array
    from_calibration: Array = field(default_factory=lambda: np.zeros((6, 6)))
    freedom: Array = field(default_factory=lambda: np.eye(6))
    dof: float = np.inf

    def __post_init__(self) -> None:
        for name in ("from_noise", "from_calibration"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"pose covariance {name}", (6, 6)))
        object.__setattr__(self, "freedom", frozen(self.freedom, "freedom", (6, None)))

    @property
    def covariance(self) -> Array:
        """Return the covariance (6, 6) of xi due to all causes, mm and rad in part axes."""
        return np.asarray(self.from_noise + self.from_calibration)

    def point_covariance(self, p_part: Floats) -> Array:
        """Return the covariance (N, 3, 3) mm^2, in part axes, of the positions of the part's points (N, 3) mm."""
        p = frozen(p_part, "p_part", (None, 3))
        J = np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), -hat(p)], axis=-1)
        return np.asarray(J @ self.covariance @ np.swapaxes(J, -1, -2))

    @property
    def sigma_mm(self) -> Array:
        """Return the standard deviations (3,) of the part's origin along the part's axes, mm.

        Of other points see `point_covariance`: far from where the part was measured they are larger.
        """
        return np.asarray(np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def sigma_deg(self) -> Array:
        """Return the standard deviations (3,) of the rotation about the part's axes, degrees."""
        return np.asarray(np.degrees(np.sqrt(np.diag(self.covariance)[3:])))

    def in_frame(self, frame_from_world: Rigid, covariance: Floats | None = None) -> PoseEstimate:
        """Return the pose in another frame, such as a robot's base: frame_from_world @ world_from_part.

        covariance (6, 6): of xi in frame_from_world @ Rigid.exp(xi); it counts as the calibration's. Where the world is
        a camera on a robot, `HandEyeEstimate.base_from_camera_at` gives both. Default: the frame is exactly known.
        """
        expect_motion(frame_from_world, "frame_from_world")
        known = frozen(np.zeros((6, 6)) if covariance is None else covariance, "covariance of the frame", (6, 6))
        Ad = self.world_from_part.inv.adjoint()
        pose, of_frame = frame_from_world @ self.world_from_part, Ad @ known @ Ad.T
        return replace(self, world_from_part=pose, from_calibration=self.from_calibration + of_frame)

    def __repr__(self) -> str:
        mm, deg = (np.array2string(s, precision=4) for s in (self.sigma_mm, self.sigma_deg))
        return f"PoseEstimate({self.world_from_part}, sigma {mm} mm, {deg} deg)"
