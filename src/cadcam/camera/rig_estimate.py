"""A rig: cameras rigidly mounted together, estimated from frames that they took at the same moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Locked, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.extended_pinhole import INTERNALS, MATRIX_ENTRIES, internals_by_name, matrix_entry
from cadcam.camera.fitted import stand_out, standing_out
from cadcam.camera.observations import Observations
from cadcam.camera.sensitivity import twist_by_local
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect_known

MOUNT = ("tx", "ty", "tz", "rx", "ry", "rz")  # xi of camera_from_rig @ Rigid.exp(xi)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RelativePose(Brief):
    """The motion b_from_a between two cameras of a rig; covariance (6, 6) of xi in b_from_a @ Rigid.exp(xi), mm, rad.

    by_frame: the same from the scatter between frames; None if too few.
    """

    b_from_a: Rigid
    covariance: Array
    by_frame: Array | None

    @property
    def baseline(self) -> float:
        """Return the distance of the two focal centres, mm."""
        return float(np.linalg.norm(self.b_from_a.translation))

    def baseline_sigma(self, *, by_frame: bool = False) -> float:
        """Return the standard deviation of the baseline, mm; by_frame: nan if too few."""
        F = self.b_from_a.origin
        along = (F / np.linalg.norm(F)) @ twist_by_local(F)[:3]
        C = self.by_frame if by_frame else self.covariance
        return float("nan") if C is None else float(np.sqrt(along @ C @ along))


@dataclass(frozen=True, slots=True, eq=False)
class RigEstimate(Locked):
    """Cameras of a rig, the mount of each, and the rig's pose in each frame.

    The rig's frame is that of the first camera. names, cameras, camera_from_rig (c): the cameras. frames,
    rig_from_world (k): the frames. views: for each camera its observations in each frame, None where there are none.
    free: for each camera what was estimated of aspect, focal (px), skew (rad), U0, V0 (px) and its lens coefficients.

    covariance (n, n): of `parameters`, each pixel an independent measurement; by_frame: the same from the scatter
    between frames (leave-one-out), which holds even if the errors within a frame are alike; None if too few. A mount is
    xi in camera_from_rig @ Rigid.exp(xi), mm and rad. pose_covariance (k, 6, 6): of xi in rig_from_world @
    Rigid.exp(xi). noise_px (c,): the standard deviation of a pixel coordinate of each camera behind them. dof: degrees
    of freedom.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    camera_from_rig: Rigid
    frames: tuple[str, ...]
    rig_from_world: Rigid
    views: tuple[tuple[Observations | None, ...], ...]
    free: tuple[tuple[str, ...], ...]
    covariance: Array
    by_frame: Array | None
    pose_covariance: Array
    noise_px: Array
    dof: int
    method: str = ""

    def __post_init__(self) -> None:
        c, k, n = len(self.names), len(self.frames), len(self.parameters)
        numbers = (c, len(self.cameras), len(self.views), len(self.free), len(self.camera_from_rig.translation))
        if len(set(numbers)) > 1 or c < 2 or len(set(self.names)) != c:
            raise BadValue("numbers of names, cameras, views, free, mounts", numbers, "one number for all, 2 or more")
        frames = (k, len(self.rig_from_world.translation), *(len(v) for v in self.views))
        if len(set(frames)) > 1:
            raise BadValue("numbers of frames, poses, each camera's views", frames, "one number for all")
        _refuse_without_views(self.names, self.views)
        _refuse_without_views(self.frames, tuple(zip(*self.views, strict=True)))
        for name, free in zip(self.names, self.free, strict=True):
            for parameter in free:
                expect_known(parameter, f"parameter of camera {name!r}", self.values(name))
        object.__setattr__(self, "covariance", frozen(self.covariance, "covariance", (n, n)))
        if self.by_frame is not None:
            object.__setattr__(self, "by_frame", frozen(self.by_frame, "covariance by frame", (n, n)))
        object.__setattr__(self, "pose_covariance", frozen(self.pose_covariance, "pose covariance", (k, 6, 6)))
        object.__setattr__(self, "noise_px", frozen(self.noise_px, "noise", (c,)))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the shared parameters, such as "left.focal" and "right.tx"."""
        return tuple(
            f"{name}.{p}"
            for c, (name, free) in enumerate(zip(self.names, self.free, strict=True))
            for p in (*free, *(MOUNT if c else ()))
        )

    def camera(self, name: str) -> Camera:
        """Return one camera."""
        return self.cameras[self._index(name)]

    def mount(self, name: str) -> Rigid:
        """Return camera_from_rig of one camera."""
        return self.camera_from_rig[self._index(name)]

    def frame(self, j: int) -> Rigid:
        """Return rig_from_world of one frame."""
        return self.rig_from_world[j]

    def values(self, name: str) -> dict[str, float]:
        """Return a camera's internals (px, rad) and lens coefficients by name."""
        camera = self.camera(name)
        return internals_by_name(camera) | camera.lens.parameters

    def sigma(self, name: str, parameter: str, *, by_frame: bool = False) -> float:
        """Return the standard deviation of a camera's parameter, or of its fx, fy, cx, cy (px).

        0 if it was not free; by_frame: nan if too few.
        """
        known = (*self.values(name), *MOUNT)
        entry = matrix_entry(self.camera(name), parameter)
        if parameter not in known and entry is None:
            raise UnknownName(f"parameter of camera {name!r}", parameter, (*known, *MATRIX_ENTRIES))
        weight = {parameter: 1.0} if entry is None else dict(zip(INTERNALS, entry[1].tolist(), strict=True))
        own = {f"{name}.{p}": w for p, w in weight.items()}
        by = np.array([own.get(p, 0.0) for p in self.parameters])
        C = self.by_frame if by_frame else self.covariance
        if not by.any():
            return 0.0
        return float("nan") if C is None else float(np.sqrt(by @ C @ by))

    def relative(self, a: str, b: str) -> RelativePose:
        """Return camera b from camera a with its covariance; for the first camera it is the mount itself."""
        i, j = self._index(a), self._index(b)
        if i == j:
            raise BadValue("the relative pose", f"of camera {a!r} and itself", "two cameras")
        one, other = self.camera_from_rig[i], self.camera_from_rig[j]
        n = len(self.parameters)
        J = np.zeros((6, n))  # other exp(y) exp(-x) one^-1 = other one^-1 exp(Ad(one) (y - x)) to first order
        J[:, self._mount_columns(j)] = one.adjoint()[:, : 6 if j else 0]
        J[:, self._mount_columns(i)] = -one.adjoint()[:, : 6 if i else 0]
        by_frame = None if self.by_frame is None else J @ self.by_frame @ J.T
        return RelativePose(other @ one.inv, J @ self.covariance @ J.T, by_frame)

    def viewpoints(self, *, sigma_px: float | None = None, by_frame: bool = False) -> tuple[Viewpoint, ...]:
        """Return the cameras at their mounts, for points measured in the rig's frame (`measure_points`).

        They share one error source, the rig's calibration, so that errors common to all rays are accounted for.
        sigma_px: noise of what will be measured, by default that of the calibration. by_frame: take the covariance from
        the scatter between frames. Raises `BadValue` where the requested noise or covariance is not known.
        """
        C = self.by_frame if by_frame else self.covariance
        if C is None:
            raise BadValue("the covariance by frames", "unknown: too few frames", "by_frame=False, or more frames")
        if by_frame:  # it does not depend on the size of the residuals
            source = ErrorSource("rig calibration", C, self.by_frame, float(len(self.frames) - 1))
        else:
            source = ErrorSource("rig calibration", C, self, self.noise_dof)
        return tuple(
            Viewpoint(
                name,
                self.cameras[c],
                self.camera_from_rig[c],
                float(self.noise_px[c]) if sigma_px is None else sigma_px,
                ((source, self._effect(c)),),
                noise_from=self if sigma_px is None else None,
                noise_dof=self.noise_dof if sigma_px is None else np.inf,
            )
            for c, name in enumerate(self.names)
        )

    @property
    def noise_dof(self) -> float:
        """Return the degrees of freedom behind the noise: inf where every view's was stated."""
        stated = all(v.sigma_px is not None for views in self.views for v in views if v is not None)
        return np.inf if stated else float(self.dof)

    @property
    def residuals(self) -> tuple[tuple[Array | None, ...], ...]:
        """Return measured minus projected pixels (N, 2) of each camera in each frame, None where it saw nothing."""
        return tuple(tuple(self._residual(c, j) for j in range(len(self.frames))) for c in range(len(self.names)))

    @property
    def view_residuals(self) -> Array:
        """Return the thesis' residual sqrt(sum(dU^2 + dV^2)/N) of each camera in each frame (c, k), px; nan if none."""
        return np.array([[_residual(r) for r in row] for row in self.residuals])

    @property
    def camera_residuals(self) -> Array:
        """Return the thesis' residual of each camera (c,) over all frames, px."""
        return np.array([_residual(_joined(row)) for row in self.residuals])

    @property
    def frame_residuals(self) -> Array:
        """Return the thesis' residual of each frame (k,) over all cameras, px."""
        return np.array([_residual(_joined(column)) for column in zip(*self.residuals, strict=True)])

    @property
    def residual(self) -> float:
        """Return the thesis' residual over all points, px."""
        return _residual(_joined([r for row in self.residuals for r in row]))

    @property
    def rms_px(self) -> float:
        """Return the root mean square of one pixel coordinate, residual/sqrt(2)."""
        return self.residual / float(np.sqrt(2))

    def outlier_frames(self) -> tuple[int, ...]:
        """Return the frames that fit much worse than the others, in units of each camera's noise, the worst first.

        Their residual is at least twice the median frame's, and chance gives such a frame in one calibration of a
        thousand.
        """
        weighed = [
            _joined([None if r is None else r / s for r, s in zip(column, self.noise_px, strict=True)])
            for column in zip(*self.residuals, strict=True)
        ]
        return stand_out(np.array([_residual(r) for r in weighed]), [len(r) for r in weighed])

    def _index(self, name: str) -> int:
        expect_known(name, "camera of the rig", self.names)
        return self.names.index(name)

    def _columns(self, c: int) -> slice:
        start = sum(len(f) + len(MOUNT) for f in self.free[:c]) - (len(MOUNT) if c else 0)
        return slice(start, start + len(self.free[c]))

    def _mount_columns(self, c: int) -> slice:
        stop = self._columns(c).stop
        return slice(stop, stop + (len(MOUNT) if c else 0))

    def _effect(self, c: int) -> Array:
        """Return the derivative of the local coordinates of a camera in the rig by the shared parameters."""
        names = (*INTERNALS, *self.cameras[c].lens.parameters)
        out = np.zeros((6 + len(names), len(self.parameters)))
        if c:
            out[:6, self._mount_columns(c)] = twist_by_local(self.camera_from_rig[c].origin)  # an involution
        for i, parameter in enumerate(self.free[c]):
            out[6 + names.index(parameter), self._columns(c).start + i] = 1.0
        return out

    def _residual(self, c: int, j: int) -> Array | None:
        view = self.views[c][j]
        if view is None:
            return None
        return np.asarray(view.q - self.cameras[c].project(self.camera_from_rig[c] @ self.frame(j) @ view.p_world))

    def __repr__(self) -> str:
        base = ", ".join(f"{n} {self.relative(self.names[0], n).baseline:.6g} mm" for n in self.names[1:])
        return (
            f"RigEstimate({len(self.frames)} frames of {', '.join(self.names)}; off {self.names[0]}: {base}; "
            f"residual {self.residual:.4g} px{standing_out(len(self.outlier_frames()), 'frame')})"
        )


def _residual(r: Array | None) -> float:
    return float("nan") if r is None else float(np.sqrt(np.mean(np.sum(r * r, axis=1))))


def _joined(parts: Sequence[Array | None]) -> Array:
    return np.concatenate([r for r in parts if r is not None])


def _refuse_without_views(names: Sequence[str], seen: Sequence[Sequence[Observations | None]]) -> None:
    for name, views in zip(names, seen, strict=True):
        if not any(view is not None for view in views):
            raise BadValue(f"camera or frame {name!r}", "without anything seen", "at least one view")
