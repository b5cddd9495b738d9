"""Frames of a point field seen by several cameras that are rigidly mounted together.

Each camera has its own `JointModel`; its derivatives by the pose of one of its views become those by the rig's pose in
that frame and by the camera's mount: with camera_from_world = camera_from_rig @ rig_from_world, a step d of the rig's
pose, exp(d) rig_from_world, is the step Ad(camera_from_rig) d of the camera's, and a step of the mount is one of the
camera's pose unchanged. The rig's frame is that of its first camera, whose mount is not a parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.fit.joint_model import OWN, JointModel, JointState
from cadcam.fit.schur import Blocks, Step
from cadcam.geometry import rotation as so3

_POSE = len(OWN)


@dataclass(frozen=True, slots=True, eq=False)
class RigState:
    """internals, lens of each camera; camera_from_rig: mount_rotation (c, 3, 3) ...; rig_from_world: R (k, 3, 3), t."""

    internals: tuple[Array, ...]
    lens: tuple[Array, ...]
    mount_rotation: Array
    mount_translation: Array
    R: Array
    t: Array


@dataclass(frozen=True, slots=True, eq=False)
class RigModel:
    """k frames seen by c cameras, each of which saw some of them.

    cameras: each one's views, without free points or a bend. frames: the frame of each of a camera's views.
    """

    names: tuple[str, ...]
    cameras: tuple[JointModel, ...]
    frames: tuple[Longs, ...]
    count: int

    @property
    def shared(self) -> tuple[str, ...]:
        """Return the names of the shared parameters: of each camera its internals and lens, then its mount."""
        return tuple(
            f"{parameter} of {name}"
            for c, (name, camera) in enumerate(zip(self.names, self.cameras, strict=True))
            for parameter in (*camera.free, *(OWN if c else ()))
        )

    def columns(self, c: int) -> slice:
        """Return the indices of a camera's internals and lens among the shared parameters."""
        start = sum(len(m.free) + _POSE for m in self.cameras[:c]) - (_POSE if c else 0)
        return slice(start, start + len(self.cameras[c].free))

    def mount_columns(self, c: int) -> slice:
        """Return the indices of a camera's mount among the shared parameters; empty for the first camera."""
        stop = self.columns(c).stop
        return slice(stop, stop + (_POSE if c else 0))

    def of_camera(self, state: RigState, c: int) -> JointState:
        """Return the state of one camera's own model."""
        R, t = state.R[self.frames[c]], state.t[self.frames[c]]
        M, m = state.mount_rotation[c], state.mount_translation[c]
        return JointState(state.internals[c], state.lens[c], np.zeros(2), np.zeros((0, 3)), M @ R, t @ M.T + m)

    def blocks(self, state: RigState) -> Blocks:
        """Return residuals and Jacobians in units of the noise, one block per frame with the rows of all cameras."""
        parts = [m.blocks(self.of_camera(state, c)) for c, m in enumerate(self.cameras)]
        rows, n = sum(part.r.shape[1] for part in parts), len(self.shared)
        if not all(np.isfinite(part.r).all() for part in parts):
            return Blocks.forbidden(self.count, rows)
        r, measured = np.zeros((self.count, rows)), np.zeros((self.count, rows), dtype=bool)
        by_shared, by_own = np.zeros((self.count, rows, n)), np.zeros((self.count, rows, _POSE))
        pairs, first = [], 0
        for c, part in enumerate(parts):
            here, these = slice(first, first + part.r.shape[1]), self.frames[c]
            r[these, here] = part.r
            measured[these, here] = True if part.measured is None else part.measured
            by_shared[these, here, self.columns(c)] = part.by_shared
            by_own[these, here] = part.by_own @ _adjoint(state.mount_rotation[c], state.mount_translation[c])
            if c:
                by_shared[these, here, self.mount_columns(c)] = part.by_own
            assert part.pairs is not None  # set by `JointModel`
            pairs.append(part.pairs + first)
            first = here.stop
        return Blocks.of(r, by_shared, by_own, measured, pairs=np.concatenate(pairs))

    def retract(self, state: RigState, step: Step) -> RigState:
        """Return the state moved by `step`: poses and mounts are rotated and moved in their target frames."""
        mounts = np.zeros((len(self.cameras), _POSE))
        moved = []
        for c, camera in enumerate(self.cameras):
            mounts[c] = step.shared[self.mount_columns(c)] if c else 0.0
            alone = Step(step.shared[self.columns(c)], np.zeros((len(self.frames[c]), _POSE)))
            moved.append(camera.retract(self.of_camera(state, c), alone))
        return RigState(
            tuple(m.internals for m in moved),
            tuple(m.lens for m in moved),
            *_moved(state.mount_rotation, state.mount_translation, mounts),
            *_moved(state.R, state.t, step.own),
        )

    def residuals(self, state: RigState) -> tuple[Array, ...]:
        """Return projected less measured pixels (views, N, 2) of each camera; nan where nothing was measured."""
        return tuple(m.residuals(self.of_camera(state, c)) for c, m in enumerate(self.cameras))


def squared_misfits(model: JointModel, state: JointState, R: Array, t: Array) -> Array:
    """Return the mean squared distance (k,), px^2, of each view's points if its pose were R, t; inf behind a camera."""
    r = model.residuals(replace(state, R=R, t=t))
    squares = np.where(model.measured, np.sum(r * r, axis=-1), 0.0).sum(axis=1) / model.measured.sum(axis=1)
    return np.where(np.isfinite(squares), squares, np.inf)


def _moved(R: Array, t: Array, twists: Array) -> tuple[Array, Array]:
    turn = so3.exp(twists[:, 3:])
    return turn @ R, (turn @ t[..., None])[..., 0] + twists[:, :3]


def _adjoint(R: Array, t: Array) -> Array:
    """Return Ad (6, 6) of the motion R, t: maps a twist before it to the equal one after it."""
    out = np.zeros((_POSE, _POSE))
    out[:3, :3] = out[3:, 3:] = R
    out[:3, 3:] = so3.hat(t) @ R
    return out
