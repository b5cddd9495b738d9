"""Views of point fields by one camera: shared internals, and a pose for every view.

The state holds the poses in the camera frame, p_camera = R p + t, and a step rotates and moves a view there:
t <- exp(w) t + v, R <- exp(w) R. Points are fixed, or bent with a board, or free within a covariance of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Longs, Mask, component_major
from cadcam.camera.extended_pinhole import INTERNALS
from cadcam.camera.lens import Lens
from cadcam.camera.sensitivity import project_in_camera
from cadcam.fit.schur import Blocks, Step
from cadcam.geometry import rotation as so3

BEND = ("bend_x", "bend_y")
OWN = ("tx", "ty", "tz", "rx", "ry", "rz")  # of a view's pose, in the camera frame
_EVERY = slice(None)
_AT_ONCE = 8192  # points: intermediate results stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """internals (5,) aspect focal skew U0 V0; lens (n,); bend (2,), shift (P, 3) of free points mm; R (k, 3, 3), t."""

    internals: Array
    lens: Array
    bend: Array
    shift: Array
    R: Array
    t: Array


@dataclass(frozen=True, slots=True, eq=False)
class Control:
    """Free points: index (k, N) of each observed one, P for a fixed point; whitener (P, 3), 1/sigma in 1/mm."""

    index: Longs
    whitener: Array


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointModel(Brief):
    """k views of up to N points p (k, N, 3) mm seen at q (k, N, 2) px, where `measured` (k, N).

    free: the shared parameters that may move, of aspect focal skew U0 V0, the lens' coefficients, bend_x, bend_y. The
    state has the values of all. noise (k,): of one pixel coordinate by view, px. bump (k, N, 2): how far a point leaves
    the board's plane, along its z, by bend_x and bend_y of 1 mm. priors: (name, value, sigma) on shared parameters.
    """

    p: Array
    q: Array
    measured: Mask
    free: tuple[str, ...]
    lens: Lens
    noise: Array
    bump: Array | None = None
    control: Control | None = None
    priors: tuple[tuple[str, float, float], ...] = ()
    _columns: Longs = field(init=False)
    _all: bool = field(init=False)
    _plain: bool = field(init=False)

    def __post_init__(self) -> None:
        names = (*INTERNALS, *self.lens.parameters)
        columns = [names.index(n) for n in self.free if n not in BEND]
        object.__setattr__(self, "_columns", np.array(columns, dtype=int))
        object.__setattr__(self, "_all", bool(self.measured.all()))
        object.__setattr__(self, "_plain", self._all and bool((self.noise == 1).all()))

    @property
    def shared(self) -> tuple[str, ...]:
        """Return the names of the shared parameters in the order of the columns, free points last."""
        if self.control is None:
            return self.free
        return (*self.free, *(f"{c} of point {i + 1}" for i in range(len(self.control.whitener)) for c in "XYZ"))

    def blocks(self, state: JointState) -> Blocks:
        """Return residuals, projected less measured, and Jacobians by unit of noise; rows: all x, then all y."""
        k, N = self.measured.shape
        if not self._possible(state):
            return Blocks.forbidden(k, 2 * N)
        stacked = np.zeros((k, len(OWN) + len(self.shared) + 1, 2, N))
        step = max(1, _AT_ONCE // N)
        for first in range(0, k, step):
            self._fill(stacked[first : first + step], state, slice(first, first + step))
        measured = None if self._all else np.concatenate([self.measured, self.measured], axis=1)
        pairs = np.arange(2 * N).reshape(2, N).T
        return Blocks(stacked.reshape(k, -1, 2 * N), len(OWN), measured, *self._alone(state), pairs)

    def retract(self, state: JointState, step: Step) -> JointState:
        """Return the state moved by `step`."""
        moved = np.concatenate([state.internals, state.lens])
        moved[self._columns] += step.shared[: len(self._columns)]
        bend = state.bend.copy()
        bend[[BEND.index(n) for n in self.free if n in BEND]] += step.shared[len(self._columns) : len(self.free)]
        turn = so3.exp(step.own[:, 3:])
        return JointState(
            internals=moved[: len(INTERNALS)],
            lens=moved[len(INTERNALS) :],
            bend=bend,
            shift=state.shift + step.shared[len(self.free) :].reshape(state.shift.shape),
            R=turn @ state.R,
            t=(turn @ state.t[..., None])[..., 0] + step.own[:, :3],
        )

    def points(self, state: JointState, views: slice = _EVERY) -> Array:
        """Return the points (k, N, 3), bent or moved by the state, of all views or of some."""
        p = self.p[views]
        if self.bump is not None:
            p = p + (self.bump[views] @ state.bend)[..., None] * np.array([0.0, 0.0, 1.0])
        if self.control is None:
            return p
        return p + np.append(state.shift, np.zeros((1, 3)), axis=0)[self.control.index[views]]

    def lens_of(self, state: JointState) -> Lens:
        """Return the lens of a state."""
        return type(self.lens)(*(float(c) for c in state.lens))

    def residuals(self, state: JointState) -> Array:
        """Return projected less measured pixels (k, N, 2); nan where nothing was measured."""
        aspect, focal, skew, U0, V0 = state.internals
        m = self.lens_of(state).project(self._in_camera(state))
        x = focal * aspect * (np.cos(skew) * m[..., 0] + np.sin(skew) * m[..., 1]) + V0
        q = np.stack([x, focal * m[..., 1] + U0], axis=-1)
        return np.where(self.measured[..., None], q - self.q, np.nan)

    def with_views(self, index: npt.ArrayLike) -> JointModel:
        """Return the model of some of the views, in that order; a view may come twice."""
        i = np.asarray(index)
        control = None if self.control is None else replace(self.control, index=self.control.index[i])
        bump = None if self.bump is None else self.bump[i]
        return replace(
            self, p=self.p[i], q=self.q[i], measured=self.measured[i], noise=self.noise[i], bump=bump, control=control
        )

    def with_free(self, free: Sequence[str]) -> JointModel:
        """Return the model with other free parameters."""
        return replace(self, free=tuple(free))

    def _possible(self, state: JointState) -> bool:
        aspect, focal, skew = state.internals[:3]
        finite = np.isfinite(state.internals).all() and np.isfinite(state.lens).all()
        return bool(finite and aspect > 0 and focal > 0 and abs(skew) < np.pi / 2)

    def _in_camera(self, state: JointState, views: slice = _EVERY) -> Array:
        p = self.points(state, views)
        out = component_major(p.shape[:-1], 3)
        np.matmul(state.R[views], np.swapaxes(p, 1, 2), out=np.swapaxes(out, 1, 2))
        out += state.t[views, None]
        return out

    def _fill(self, stacked: Array, state: JointState, views: slice) -> None:
        """Put some views' derivatives and residuals (v, 6 + n + 1, 2, N) into their place, by unit of noise."""
        own, shared = stacked[:, : len(OWN)], stacked[:, len(OWN) : -1]
        p = self._in_camera(state, views)
        columns = self._columns.tolist()
        of_camera = shared[:, : len(columns)].transpose(0, 3, 2, 1)
        q, dq_dp, _ = project_in_camera(state.internals, self.lens_of(state), p, columns, out=of_camera)
        by_point = dq_dp.transpose(0, 2, 3, 1)
        _put_own(own, by_point, np.swapaxes(p, 1, 2))
        for name in (n for n in self.free if n in BEND):
            assert self.bump is not None
            along_z = np.einsum("krcn,kc->krn", by_point, state.R[views, :, 2])
            shared[:, self.free.index(name)] = along_z * self.bump[views, None, :, BEND.index(name)]
        if self.control is not None:
            self._put_points(shared, dq_dp @ state.R[views, None], self.control.index[views])
        stacked[:, -1] = np.swapaxes(q - self.q[views], 1, 2)
        if not self._plain:
            stacked *= (self.measured[views] / self.noise[views, None])[:, None, None]

    def _put_points(self, shared: Array, by_point: Array, index: Longs) -> None:
        assert self.control is not None
        view, point = np.nonzero(index < len(self.control.whitener))
        column = len(self.free) + 3 * index[view, point]
        for c in range(3):
            shared[view, column + c, :, point] = by_point[view, point, :, c]

    def _alone(self, state: JointState) -> tuple[Array, Array]:
        """Rows of priors and of the free points' own covariances."""
        n, values = len(self.shared), self.values(state)
        A = np.zeros((len(self.priors), n))
        r = np.zeros(len(self.priors))
        for row, (name, value, sigma) in enumerate(self.priors):
            r[row] = (values[name] - value) / sigma
            if name in self.free:  # a nested model may hold it: its prior still counts, as an observation
                A[row, self.free.index(name)] = 1 / sigma
        if self.control is None:
            return r, A
        W = self.control.whitener.ravel()
        points = np.concatenate([np.zeros((W.size, len(self.free))), np.diag(W)], axis=1)
        return np.concatenate([r, W * state.shift.ravel()]), np.concatenate([A, points])

    def values(self, state: JointState) -> dict[str, float]:
        """Return all shared values by name: internals, lens coefficients, bend."""
        names = (*INTERNALS, *self.lens.parameters, *BEND)
        values = np.concatenate([state.internals, state.lens, state.bend])
        return dict(zip(names, values.tolist(), strict=True))


def _put_own(own: Array, by_point: Array, p: Array) -> None:
    """Put the derivatives (k, 6, 2, N) by a step of the poses: by_point (k, 2, 3, N), points p (k, 3, N)."""
    own[:, :3] = np.swapaxes(by_point, 1, 2)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(by_point[:, :, k], p[:, None, j], out=own[:, 3 + i])
        own[:, 3 + i] -= by_point[:, :, j] * p[:, None, k]
