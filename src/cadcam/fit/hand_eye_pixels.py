"""The hand-eye adjustment on pixels: every robot pose may be slightly off, and the pictures show by how much.

Unknown are flange_from_held, base_from_fixed, for each pose the flange's offset (names of `cadcam.fit.hand_eye_poses`),
and, with a prior, the camera's internals. The offsets have the robot's noise as prior and are eliminated block by
block. Without them the robot's errors would be attributed to the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.camera.lens import Lens
from cadcam.camera.sensitivity import project_local
from cadcam.fit.many_poses import PaddedViews
from cadcam.fit.schur import Blocks, Step
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_EXTERNALS, _INTERNALS = 6, 5  # local coordinates of cadcam.camera.sensitivity: pose, internals, then the lens


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeState:
    """The state of the adjustment; offset (n) are motions of the flange, internals (5 + lens coefficients) as named."""

    flange_from_held: Rigid
    base_from_fixed: Rigid
    offset: Rigid
    internals: Array


@dataclass(frozen=True, slots=True, eq=False)
class InternalsPrior:
    """Which internals are free, their prior mean, and the square root of the prior's information.

    columns (f,): indices into (aspect, focal, skew, U0, V0, lens ...); mean (f,); root (f, f): root^T root = inverse
    covariance. No columns: the internals are fixed.
    """

    columns: Longs
    mean: Array
    root: Array

    @classmethod
    def fixed(cls) -> InternalsPrior:
        """Return the prior that keeps all internals fixed."""
        return cls(np.zeros(0, dtype=int), np.zeros(0), np.zeros((0, 0)))

    @classmethod
    def of(cls, internals: Array, covariance: Array) -> InternalsPrior:
        """Return the prior of internals (5 + lens) known with this covariance; those of zero variance stay fixed."""
        columns = np.flatnonzero(np.diag(covariance) > 0)
        root = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(columns, columns)]))
        return cls(columns, internals[columns], root)


@dataclass(frozen=True, slots=True, eq=False)
class HandEyePixels:
    """Block problem: views (n), the robot's poses (n), noise of a pixel coordinate and of the robot (mm, rad).

    camera_held: the flange holds the camera (eye-in-hand), else the target.
    """

    views: PaddedViews
    base_from_flange: Rigid
    camera_held: bool
    lens: Lens
    prior: InternalsPrior
    noise_px: float
    robot_noise: Array

    def camera_from_target(self, state: HandEyeState) -> Rigid:
        """Return the pose of the target in the camera frame for every view."""
        fixed_from_held = state.base_from_fixed.inv @ self.base_from_flange @ state.offset @ state.flange_from_held
        return fixed_from_held.inv if self.camera_held else fixed_from_held

    def residuals(self, state: HandEyeState) -> Array:
        """Return projected minus measured pixels (n, N, 2), 0 where nothing was measured."""
        C = self.camera_from_target(state)
        q, _ = self._projected(state, C)
        return np.where(self.views.seen[..., None] > 0, q - self.views.q, 0.0)

    def blocks(self, state: HandEyeState) -> Blocks:
        """Return pixel rows and six rows for the offset of every pose; shared: held, fixed, free internals."""
        C = self.camera_from_target(state)
        q, J = self._projected(state, C)
        n, N = self.views.seen.shape
        seen = self.views.seen[..., None]
        r = np.where(seen > 0, q - self.views.q, 0.0).reshape(n, 2 * N) / self.noise_px
        J = (np.nan_to_num(J) * seen[..., None]).reshape(n, 2 * N, -1) / self.noise_px
        held, fixed, offset = self._twists(state, C)
        pose, inner = J[..., :6], J[..., 6 + self.prior.columns]
        offset_r, offset_J = self._offset_rows(state)
        by_shared = np.concatenate([pose @ held, pose @ fixed, inner], axis=-1)
        alone = np.zeros((len(self.prior.columns), by_shared.shape[2]))
        alone[:, 12:] = self.prior.root
        return Blocks.of(
            np.concatenate([r, offset_r], axis=1),
            np.concatenate([by_shared, np.zeros((n, 6, by_shared.shape[2]))], axis=1),
            np.concatenate([pose @ offset, offset_J], axis=1),
            np.concatenate([np.repeat(self.views.seen > 0, 2, axis=1), np.ones((n, 6), dtype=bool)], axis=1),
            alone_r=self.prior.root @ (state.internals[self.prior.columns] - self.prior.mean),
            alone_by_shared=alone,
        )

    def retract(self, state: HandEyeState, step: Step) -> HandEyeState:
        """Return the state moved by twists on the right, and by increments of the free internals."""
        internals = state.internals.copy()
        internals[self.prior.columns] += step.shared[12:]
        moved = state.offset @ Rigid.exp(step.own)
        return HandEyeState(
            state.flange_from_held @ Rigid.exp(step.shared[:6]),
            state.base_from_fixed @ Rigid.exp(step.shared[6:12]),
            Rigid(so3.nearest(moved.rotation), moved.translation),
            internals,
        )

    def internals_by_poses(self, state: HandEyeState) -> tuple[Array, Array]:
        """Return how each view's own pose depends on the free internals, and the views' information on these.

        (n, 6, f): derivative of the twist of camera_from_target, at the best pose in each picture, by the free
        internals; (f, f): the information on them in prior and pictures when each picture has a pose of its own.
        """
        _, J = self._projected(state, self.camera_from_target(state))
        n, N = self.views.seen.shape
        J = (np.nan_to_num(J) * self.views.seen[..., None, None]).reshape(n, 2 * N, -1) / self.noise_px
        pose, inner = J[..., :6], J[..., 6 + self.prior.columns]
        follows = -np.linalg.solve(np.swapaxes(pose, 1, 2) @ pose, np.swapaxes(pose, 1, 2) @ inner)
        left = inner + pose @ follows
        return np.asarray(follows), self.prior.root.T @ self.prior.root + np.einsum("nmi,nmj->ij", left, left)

    def _projected(self, state: HandEyeState, C: Rigid) -> tuple[Array, Array]:
        """Pixels (n, N, 2) and their Jacobian (n, N, 2, 6 + 5 + lens) by the pose's twist and the internals."""
        lens = self.lens if not self.prior.columns.size else self._lens(state.internals)
        q, J = project_local(C.origin, C.rotation, state.internals[:_INTERNALS], lens, self.views.p)
        by_point = -J[..., :3]
        turned = np.cross(self.views.p[..., None, :], by_point)
        return q, np.concatenate([by_point, turned, J[..., _EXTERNALS:]], axis=-1)

    def _lens(self, internals: Array) -> Lens:
        return type(self.lens)(*(float(c) for c in internals[_INTERNALS:]))

    def _twists(self, state: HandEyeState, C: Rigid) -> tuple[Array, Array, Array]:
        """Matrices (n, 6, 6): the twist of camera_from_target by those of held, fixed and offset."""
        X, one = state.flange_from_held, np.broadcast_to(np.eye(6), (len(self.views), 6, 6))
        if self.camera_held:
            return -C.inv.adjoint(), one, -(C.inv @ X.inv).adjoint()
        return one, -C.inv.adjoint(), np.broadcast_to(X.inv.adjoint(), one.shape)

    def _offset_rows(self, state: HandEyeState) -> tuple[Array, Array]:
        """Offsets (n, 6) by their noise and their Jacobian (n, 6, 6) by a twist on the right."""
        R, w = state.offset.rotation, so3.log(state.offset.rotation)
        J = np.zeros((len(R), 6, 6))
        J[:, :3, :3] = R / self.robot_noise[0]
        J[:, 3:, 3:] = so3.inverse_left_jacobian(-w) / self.robot_noise[1]
        return np.concatenate([state.offset.translation / self.robot_noise[0], w / self.robot_noise[1]], axis=1), J
