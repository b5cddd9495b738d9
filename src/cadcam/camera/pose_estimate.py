"""The estimated pose of a part, always with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Floats, Locked, frozen
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.geometry.rotation import hat

_FREE = 1e-6  # of its length: what remains of a motion without the undetermined ones, if any of it is left
_ZERO = 5e-4  # mm, or of a unit vector: less is written as 0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoseEstimate(Locked):
    """The pose world_from_part (mm) of a part; with one camera and no other frame the world is that camera's.

    from_noise, from_calibration (6, 6): covariance of xi in `world_from_part @ Rigid.exp(xi)`, (translation mm,
    rotation rad) in the part's own axes, due to the photos' noise and to the errors of the cameras' parameters and
    poses. freedom (6, k): the motions xi that were free, orthonormal columns; the covariances are zero across them.
    dof: degrees of freedom behind from_noise; inf where the noise is known. undetermined (6, j): those of the free
    motions, turns each, that no photo can show: the part looks the same after any of them, as a body of revolution
    turned about its axis. from_noise has them as unknown as an angle can be.
    """

    world_from_part: Rigid
    from_noise: Array
    from_calibration: Array = field(default_factory=lambda: np.zeros((6, 6)))
    freedom: Array = field(default_factory=lambda: np.eye(6))
    dof: float = np.inf
    undetermined: Array = field(default_factory=lambda: np.zeros((6, 0)))

    def __post_init__(self) -> None:
        for name in ("from_noise", "from_calibration"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"pose covariance {name}", (6, 6)))
        for name in ("freedom", "undetermined"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, (6, None)))

    def __eq__(self, other: object) -> bool:
        """Return whether two estimates have the same numbers, as one that was written and read back has."""
        return isinstance(other, PoseEstimate) and self._numbers() == other._numbers()

    def __hash__(self) -> int:
        return hash(self._numbers())

    def _numbers(self) -> tuple[object, ...]:
        pose = self.world_from_part
        arrays = (pose.rotation, pose.translation, self.from_noise, self.from_calibration)
        told = [tuple(a.ravel().tolist()) for a in (*arrays, self.freedom, self.undetermined)]
        return self.freedom.shape, self.undetermined.shape, self.dof, *told

    @property
    def covariance(self) -> Array:
        """Return the covariance (6, 6) of xi due to all causes, mm and rad in part axes."""
        return np.asarray(self.from_noise + self.from_calibration)

    @property
    def determined(self) -> PoseEstimate:
        """Return the estimate of what the photos do determine: no covariance along what they cannot, which is not free.

        An undetermined turn about an axis beside the part's origin would make the origin as unknown as itself.
        """
        if not self.undetermined.shape[1]:
            return self
        U = np.linalg.qr(self.undetermined)[0]
        P = np.eye(6) - U @ U.T
        axes, length, _ = np.linalg.svd(P @ self.freedom, full_matrices=False)
        left = axes[:, length > _FREE]
        return replace(
            self,
            from_noise=_across(P, self.from_noise),
            from_calibration=_across(P, self.from_calibration),
            freedom=left,
            undetermined=np.zeros((6, 0)),
        )

    @property
    def undetermined_words(self) -> str:
        """Return in words what no photo can determine; empty where there is nothing of the kind."""
        turns = self.undetermined.shape[1]
        if not turns:
            return ""
        slides, w = self.undetermined[:3].T, self.undetermined[3:].T  # of a turn about p: slide = p x w
        p = np.asarray(
            np.linalg.lstsq(-np.concatenate(hat(w)), slides.ravel(), rcond=None)[0], np.float64
        )  # the nearest to the origin
        through = f"through ({_listed(p)}) mm of the part"
        if turns == 3:
            return f"the turn about any axis {through}"
        lead = np.take_along_axis(w, np.argmax(np.abs(w), axis=1)[:, None], axis=1)  # made positive
        axes = " and ".join(f"({_listed(one)})" for one in np.sign(lead) * w / np.linalg.norm(w, axis=1, keepdims=True))
        return f"the turn about {'the axis' if turns == 1 else 'the axes'} {axes} {through}"

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


def _across(P: Array, S: Array) -> Array:
    """Return P S P of a covariance S, no variance of it negative however large what P takes away."""
    variances, axes = np.linalg.eigh(S)
    root = P @ (axes * np.sqrt(np.maximum(variances, 0.0)))
    return np.asarray(root @ root.T)


def _listed(v: Array) -> str:
    return ", ".join(f"{x:.3f}".rstrip("0").rstrip(".") for x in np.where(np.abs(v) < _ZERO, 0.0, v))
