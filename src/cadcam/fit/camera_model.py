"""The reprojection problem: a camera that sees known points, with any of its parameters free.

A state is one flat array: F (3), R (9, rows of our camera axes), aspect focal skew U0 V0 (5), lens coefficients (n).
Leading axes are a batch, so that a hundred starts are minimised at the cost of a few.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import NAMES, OURS_FROM_THESIS, angles_of, camera_of, internals_of
from cadcam.camera.lens import Lens
from cadcam.camera.sensitivity import project_batch, project_local, rotation_by_angles
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_F, _R, _INTERNALS, _LENS = slice(0, 3), slice(3, 12), slice(12, 17), slice(17, None)
_ANGLES = ("a", "b", "c")


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """Points p_world (N, 3) mm seen at q (N, 2) px; `free` names the free parameters; the lens' class and fixed terms.

    With all angles free a step rotates the camera by a rotation vector; with some fixed it changes the others
    themselves. columns (n,): indices of the free ones among all parameters. p_world (B, N, 3) and q (B, N, 2) give each
    of B states observations of its own.
    """

    p_world: Array
    q: Array
    free: tuple[str, ...]
    lens: Lens
    columns: Longs = field(init=False)
    _angles: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        names = (*NAMES, *self.lens.parameters)
        object.__setattr__(self, "columns", np.array([names.index(n) for n in self.free], dtype=int))
        angles = tuple(i for i, n in enumerate(_ANGLES) if n in self.free)
        object.__setattr__(self, "_angles", angles if 0 < len(angles) < 3 else ())

    @property
    def steps_angles(self) -> bool:
        """Return whether a step changes single angles a, b, c instead of rotating by a rotation vector."""
        return bool(self._angles)

    def residuals_and_jacobian(self, state: Array) -> tuple[Array, Array]:
        """Return projected minus measured (..., 2N) px and its Jacobian by `free` (..., 2N, n)."""
        q, J = self._projected(state)
        if self._angles:
            J = J.copy()
            J[..., 3:6] = J[..., 3:6] @ self._rotation_by_angles(state)[..., None, :, :]
        J = J[..., self.columns]
        shape = (*state.shape[:-1], 2 * self.q.shape[-2])
        return (q - self.q).reshape(shape), J.reshape(*shape, len(self.free))

    def jacobian_by_parameters(self, state: Array) -> Array:
        """Return dq/dparameters (2N, n) of one state in the order of `free`, rotations by the thesis' a b c."""
        _, J = self.residuals_and_jacobian(state)
        turn = [i for i, name in enumerate(self.free) if name in _ANGLES]
        if len(turn) == 3:
            J[:, turn] = J[:, turn] @ self._rotation_by_angles(state)
        return J

    def retract(self, state: Array, step: Array) -> Array:
        """Return the state moved by `step` (..., n) in the order of `free`."""
        full = np.zeros((*state.shape[:-1], state.shape[-1] - 6))
        full[..., self.columns] = step
        out = np.concatenate(
            [state[..., :3] + full[..., :3], state[..., 3:12], state[..., 12:] + full[..., 6:]], axis=-1
        )
        R = state[..., _R].reshape(*state.shape[:-1], 3, 3)
        out[..., _R] = self._turned(R, full[..., 3:6]).reshape(*state.shape[:-1], 9)
        return _possible(out)

    def state_of(self, camera: Camera, camera_from_world: Rigid) -> Array:
        """Return the state of one camera; its lens must be of this model's class."""
        R = camera_from_world.rotation.ravel()
        lens = list(camera.lens.parameters.values())
        return np.concatenate([camera_from_world.origin, R, internals_of(camera.K), lens])

    def states(self, F: Array, R: Array, internals: Array) -> Array:
        """Return the states (..., k) of focal centres (..., 3), rotations (..., 3, 3), internals (..., 5), own lens."""
        lens = np.array(list(self.lens.parameters.values()))
        shape = R.shape[:-2]
        parts = [F, R.reshape(*shape, 9), np.broadcast_to(internals, (*shape, 5))]
        return np.concatenate([*parts, np.broadcast_to(lens, (*shape, lens.size))], axis=-1)

    def pose(self, state: Array) -> Rigid:
        """Return camera_from_world of one state."""
        R = so3.nearest(state[_R].reshape(3, 3))
        return Rigid(R, -R @ state[_F])

    def camera(self, state: Array, size: tuple[int, int]) -> Camera:
        """Return the camera of one state."""
        return camera_of(state[_INTERNALS], size, self._lens(state))

    def pixels(self, states: Array) -> Array:
        """Return the images (..., N, 2) px of the points in each state; NaN for points not imaged."""
        if states.ndim > 1 and self._free_lens:  # each state has a lens of its own
            return np.stack([self.of_states(np.array(i)).pixels(s) for i, s in enumerate(states)])
        if states.ndim == 1 and not np.isfinite(states).all():
            return np.full(self.q.shape, np.nan)
        R = states[..., _R].reshape(*states.shape[:-1], 3, 3)
        return project_batch(states[..., _F], R, states[..., _INTERNALS], self._lens(states), self.p_world)

    def costs(self, states: Array) -> Array:
        """Return the sums of squares (...,) px^2; inf where a point is not imaged."""
        total = np.sum((self.pixels(states) - self.q) ** 2, axis=(-2, -1))
        return np.where(np.isfinite(total), total, np.inf)

    def with_points(self, index: Longs) -> CameraModel:
        """Return the same model of some of the points."""
        return replace(self, p_world=self.p_world[index], q=self.q[index])

    def of_states(self, index: Longs) -> CameraModel:
        """Return the model of some of the states: itself, unless each has observations of its own."""
        if self.q.ndim == 2:
            return self
        return replace(self, p_world=self.p_world[index], q=self.q[index])

    def parameters(self, states: Array) -> Array:
        """Return X Y Z a b c aspect focal skew U0 V0 and the lens coefficients (..., n) of states, mm, rad, px."""
        R = states[..., _R].reshape(*states.shape[:-1], 3, 3)
        return np.concatenate([states[..., _F], angles(R), states[..., 12:]], axis=-1)

    def from_parameters(self, values: Array) -> Array:
        """Return the states of parameters (..., n), the reverse of `parameters`; NaN where there is no such camera."""
        R = rotations_of(values[..., 3:6]).reshape(*values.shape[:-1], 9)
        return _possible(np.concatenate([values[..., :3], R, values[..., 6:]], axis=-1))

    def _lens(self, state: Array) -> Lens:
        return type(self.lens)(*(float(x) for x in state[_LENS])) if self._free_lens else self.lens

    @property
    def _free_lens(self) -> bool:
        return bool(self.columns.size and self.columns.max() >= len(NAMES))

    def _projected(self, state: Array) -> tuple[Array, Array]:
        if state.ndim > 1 and self._free_lens:  # each state has a lens of its own
            each = [self.of_states(np.array(i))._projected(s) for i, s in enumerate(state)]
            return np.stack([q for q, _ in each]), np.stack([J for _, J in each])
        R = state[..., _R].reshape(*state.shape[:-1], 3, 3)
        if state.ndim == 1 and not np.isfinite(state).all():
            n = len(NAMES) + len(self.lens.parameters)
            return np.full(self.q.shape, np.nan), np.full((*self.q.shape, n), np.nan)
        return project_local(state[..., _F], R, state[..., _INTERNALS], self._lens(state), self.p_world)

    def _turned(self, R: Array, turn: Array) -> Array:
        if not self._angles:
            return np.asarray(R @ so3.exp(turn))
        return rotations_of(angles(R) + turn)

    def _rotation_by_angles(self, state: Array) -> Array:
        return rotation_by_angles(state[..., _R].reshape(*state.shape[:-1], 3, 3))


def _possible(states: Array) -> Array:
    """Put NaN where there is no such camera: the residuals then forbid the state."""
    bad = (states[..., 12] <= 0) | (states[..., 13] <= 0) | (np.abs(states[..., 14]) >= np.pi / 2)
    states[bad] = np.nan
    return states


def angles(R: Array) -> Array:
    """Return the thesis' (a, b, c) (..., 3) rad of our rotations (..., 3, 3), b in [-pi/2, pi/2]."""
    return angles_of(OURS_FROM_THESIS.T @ R)


def rotations_of(abc: Array) -> Array:
    """Return our rotations (..., 3, 3) of the thesis' angles (..., 3): exp(-c e_z) exp(-b e_y) exp(-a e_x)."""
    e = -np.eye(3)
    x, y, z = (so3.exp(abc[..., i : i + 1] * e[i]) for i in range(3))
    return np.asarray(OURS_FROM_THESIS @ z @ y @ x)
