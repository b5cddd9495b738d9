"""One camera from several positions: shared internals with their covariance, and every view's pose and residuals."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Locked, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import EXTERNALS, INTERNALS, MATRIX_ENTRIES, NAMES, internals_by_name, matrix_entry
from cadcam.camera.fitted import stand_out, standing_out
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid


@dataclass(frozen=True, slots=True, eq=False)
class JointEstimate(Locked):
    """A camera shared by several views, and its pose in each.

    views: the observations. points: each view's points, mm; they differ from the observations only where a board was
    bent or control points were free. poses: camera_from_world of all views, a batch. free: the estimated shared
    parameters, of aspect, focal (px), skew (rad), U0, V0 (px), lens coefficients, bend_x, bend_y (mm); bend (2,): the
    values of the latter two.

    common (m, m): the covariance of what the views share, `free` and then the free control points, classical, with each
    pixel an independent measurement. by_view (n, n): that of `free` from the scatter between views
    (`cadcam.fit.square_root.Cofactors.jackknifed`), which holds even if the errors within a view are alike; None for
    too few views. lever (k, 6, m): how each pose's local coordinates (`cadcam.camera.sensitivity`) follow the shared
    parameters; pose_alone (k, 6, 6): their covariance if these were known. noise_px: the standard deviation of a pixel
    coordinate behind them. dof: degrees of freedom. weights: the robust loss' weight of each point, 1 without one.
    """

    camera: Camera
    poses: Rigid
    views: tuple[Observations, ...]
    points: tuple[Array, ...]
    free: tuple[str, ...]
    bend: Array
    common: Array
    by_view: Array | None
    lever: Array
    pose_alone: Array
    noise_px: float
    dof: int
    weights: tuple[Array, ...]
    method: str = ""
    _sources: tuple[ErrorSource, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        k, m = len(self.views), max(len(self.common), len(self.free))
        object.__setattr__(self, "bend", frozen(self.bend, "bend", (2,)))
        object.__setattr__(self, "common", frozen(self.common, "covariance", (m, m)))
        object.__setattr__(self, "lever", frozen(self.lever, "lever", (k, 6, m)))
        object.__setattr__(self, "pose_alone", frozen(self.pose_alone, "pose covariance", (k, 6, 6)))
        object.__setattr__(self, "points", tuple(frozen(p, "points", (None, 3)) for p in self.points))
        numbers = (k, len(self.poses.translation), len(self.points), len(self.weights))
        if len(set(numbers)) > 1:
            raise BadValue("numbers of views, poses, points, weights", numbers, "one number for all")
        each = (ErrorSource("calibration", C, object()) for C in (self.common, *self.pose_alone))
        object.__setattr__(self, "_sources", tuple(each))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the views: their sources, numbered where several are equal."""
        sources = [v.source for v in self.views]
        if len(set(sources)) == len(sources):
            return tuple(sources)
        return tuple(f"view {j + 1}" for j in range(len(sources)))

    @property
    def covariance(self) -> Array:
        """Return the covariance (n, n) of `free`, classical."""
        n = len(self.free)
        return self.common[:n, :n]

    @property
    def pose_covariance(self) -> Array:
        """Return the covariances (k, 6, 6) of the poses' local coordinates (`cadcam.camera.sensitivity`), classical."""
        return np.asarray(self.pose_alone + self.lever @ self.common @ np.swapaxes(self.lever, -1, -2))

    @property
    def cross(self) -> Array:
        """Return the covariances (k, n, 6) between `free` and each pose's local coordinates, classical."""
        return np.asarray(self.common[: len(self.free)] @ np.swapaxes(self.lever, -1, -2))

    @property
    def parameters(self) -> dict[str, float]:
        """Return all shared values by name: internals (px, rad), lens coefficients, bend (mm)."""
        internals = internals_by_name(self.camera)
        bend = dict(zip(("bend_x", "bend_y"), self.bend.tolist(), strict=True))
        return internals | self.camera.lens.parameters | bend

    def pose(self, j: int) -> Rigid:
        """Return camera_from_world of one view."""
        return self.poses[j]

    def value(self, name: str) -> float:
        """Return one shared parameter, or fx, fy, cx, cy of the camera matrix (px)."""
        entry = matrix_entry(self.camera, name)
        if entry is not None:
            return entry[0]
        values = self.parameters
        if name not in values:
            raise UnknownName("shared parameter", name, (*values, *MATRIX_ENTRIES))
        return values[name]

    def sigma(self, name: str, *, by_view: bool = False) -> float:
        """Return the standard deviation of a shared parameter, or of fx, fy, cx, cy, px.

        0 if it was not free; by_view: nan for too few.
        """
        self.value(name)
        entry = matrix_entry(self.camera, name)
        weight = {name: 1.0} if entry is None else dict(zip(INTERNALS, entry[1].tolist(), strict=True))
        by = np.array([weight.get(free, 0.0) for free in self.free])
        if not by.any():
            return 0.0
        if by_view and self.by_view is None:
            return float("nan")
        C = self.by_view if by_view and self.by_view is not None else self.covariance
        return float(np.sqrt(by @ C @ by))

    @property
    def correlation(self) -> Array:
        """Return the correlation matrix of `free`, classical."""
        sd = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(sd, sd))

    @property
    def residuals(self) -> tuple[Array, ...]:
        """Return measured minus projected pixels (N, 2) of each view."""
        counts = [len(v) for v in self.views]
        R, t = (np.repeat(x, counts, axis=0) for x in (self.poses.rotation, self.poses.translation))
        p = np.concatenate(self.points)
        r = np.concatenate([v.q for v in self.views]) - self.camera.project(np.einsum("nij,nj->ni", R, p) + t)
        return tuple(np.split(r, np.cumsum(counts)[:-1]))

    @property
    def view_residuals(self) -> Array:
        """Return the thesis' residual sqrt(sum(dU^2 + dV^2)/N) of each view (k,), px."""
        return np.array([np.sqrt(np.mean(np.sum(r**2, axis=1))) for r in self.residuals])

    @property
    def sum_of_squares(self) -> float:
        """Return the sum of dU^2 + dV^2 over all points of all views, px^2."""
        return float(sum(np.sum(r**2) for r in self.residuals))

    @property
    def residual(self) -> float:
        """Return the thesis' residual over all points, px."""
        return float(np.sqrt(self.sum_of_squares / sum(len(v) for v in self.views)))

    @property
    def rms_px(self) -> float:
        """Return the root mean square of one pixel coordinate, residual/sqrt(2)."""
        return self.residual / float(np.sqrt(2))

    def outlier_views(self) -> tuple[int, ...]:
        """Return the views that fit much worse than the others, the worst first.

        Their residual is at least twice the median view's, and chance gives such a view in one calibration of a
        thousand.
        """
        return stand_out(self.view_residuals, [len(v) for v in self.views])

    def view(self, j: int) -> CameraEstimate:
        """Return the camera and one view's pose as an estimate of its own, with the joint covariance.

        Its observations are those of the view, with the points as estimated and `noise_px` as their sigma. The views'
        estimates share the error of the camera and what their poses have of it (`CameraEstimate.errors`).
        """
        camera = self.camera
        names = (*NAMES, *camera.lens.parameters)
        shared = [n for n in self.free if n in names]
        pick = [self.free.index(n) for n in shared]
        place = [names.index(n) for n in shared]
        by_common = np.zeros((len(names), len(self.common)))
        by_common[:6], by_common[place, pick] = self.lever[j], 1.0
        own = np.eye(len(names), 6)
        C = by_common @ self.common @ by_common.T + own @ self.pose_alone[j] @ own.T
        return CameraEstimate(
            camera=camera,
            camera_from_world=self.pose(j),
            observations=replace(self.views[j], p_world=self.points[j], sigma_px=self.noise_px),
            free=(*EXTERNALS, *(n for n in names if n in shared)),
            cofactor=C / self.noise_px**2,
            method=self.method,
            errors=((self._sources[0], by_common), (self._sources[1 + j], own)),
        )

    def __repr__(self) -> str:
        points = sum(len(v) for v in self.views)
        return (
            f"JointEstimate({len(self.views)} views, {points} points, {len(self.free)} shared parameters, "
            f"residual {self.residual:.4g} px, {self.camera}{standing_out(len(self.outlier_views()), 'view')})"
        )
