"""Cameras rigidly mounted together: internals, mounts and the rig's pose in every frame, in one adjustment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Brief, Longs
from cadcam.calibrate.joint.adjustment import JointFit, covariance_by_view, fit_jointly
from cadcam.calibrate.rig import start as rig_start
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import camera_of, internals_by_name
from cadcam.camera.lens import Lens
from cadcam.camera.observations import Observations
from cadcam.camera.rig_estimate import RigEstimate
from cadcam.errors import BadValue, DegenerateGeometry, NotConverged, TooFewPoints
from cadcam.fit.block_least_squares import BlockSolution, minimise_blocks
from cadcam.fit.joint_model import OWN, JointModel, JointState
from cadcam.fit.levenberg_marquardt import Options
from cadcam.fit.rig_model import RigModel, RigState
from cadcam.fit.robust import Loss
from cadcam.fit.square_root import Cofactors, factorise
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_by_name, expect_each, expect_names

_FINE = Options(damping=0.0, settled=1e-12, enough=1e-16)
_LEAST_NOISE = 1e-6  # px, of a camera by itself: pixels that fit exactly do not get infinite weight


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RigCamera(Brief):
    """The data of one camera of a rig: its observations frame by frame, None where there are none.

    size: its picture's (width, height), px. fixed, lens, free_lens: as in `calibrate_jointly`. known: a calibrated
    camera whose internals and lens are kept; it brings its own size.
    """

    views: Sequence[Observations | None]
    size: tuple[int, int] | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    lens: Lens | None = None
    free_lens: Iterable[str] = ()
    known: Camera | None = None

    def __post_init__(self) -> None:
        expect(self.known, "known", Camera, optional=True)
        expect(self.fixed, "fixed", Mapping)
        expect(self.lens, "lens", Lens, optional=True)
        if self.known is None and self.size is None:
            raise BadValue("the picture size of a camera", None, "(width, height) in px, or a known camera")
        if self.known is not None and (self.fixed or self.lens is not None or self.size not in (None, self.known.size)):
            raise BadValue("size, fixed or lens", "given beside a known camera", "none: all of it is kept")
        object.__setattr__(self, "views", expect_each(self.views, "views", Observations, type(None)))
        object.__setattr__(self, "free_lens", expect_names(self.free_lens, "free_lens"))

    def calibrated(self, loss: Loss | None) -> JointFit:
        """Return the camera's calibration by itself."""
        seen = [v for v in self.views if v is not None]
        if self.known is None:
            assert self.size is not None  # one of the two was given
            return fit_jointly(seen, self.size, fixed=self.fixed, lens=self.lens, free_lens=self.free_lens, loss=loss)
        held = internals_by_name(self.known)
        return fit_jointly(seen, self.known.size, fixed=held, lens=self.known.lens, loss=loss)


def calibrate_rig(
    cameras: Mapping[str, RigCamera], *, frames: Sequence[str] = (), loss: Loss | None = None
) -> RigEstimate:
    """Return the cameras, their mounts on the rig, and the rig's pose in every frame; no guess is needed.

    The n-th view of every camera belongs to the n-th frame: they were taken at the same moment, and show points of the
    same world (a board's). Cameras need not see the same points, nor each frame, but each must be linked to the others
    by shared frames, and be fit for a calibration by itself. The rig's frame is that of the first camera. frames: their
    names, default "1", "2", ... Minimises the sum of squared pixel residuals over each camera's noise: the stated
    sigma_px, or else the residual of its own calibration. loss: as in `calibrate_jointly`.

    Raises `BadValue`, `InconsistentViews` naming frames that were not taken together, `DegenerateGeometry` naming a
    camera without a link or what the frames do not determine, and what `calibrate_jointly` raises for one camera.
    """
    expect_by_name(cameras, "cameras", RigCamera)
    expect(loss, "loss", Loss, optional=True)
    frames = expect_names(frames, "frames")
    _refuse_unlike(cameras, frames)
    _refuse_the_same_twice(cameras)
    count = len(next(iter(cameras.values())).views)
    seen = [j for j in range(count) if any(c.views[j] is not None for c in cameras.values())]
    fits = [_alone(name, camera, loss) for name, camera in cameras.items()]
    index = [np.array([i for i, j in enumerate(seen) if c.views[j] is not None]) for c in cameras.values()]
    origin = np.mean([fit.origin for fit in fits], axis=0)
    labels = [frames[j] if frames else _label(j, cameras) for j in seen]
    model, start = _posed(tuple(cameras), fits, index, labels, origin)
    solution = minimise_blocks(model, start, loss=loss, options=_FINE)
    known = factorise(solution.weighted, model.shared, OWN, labels, kind="frame")
    views = tuple(tuple(c.views[j] for j in seen) for c in cameras.values())
    named = tuple(frames[j] if frames else str(j + 1) for j in seen)
    return _estimate(model, solution, known, views, named, [f.size for f in fits], origin)


def _posed(
    names: tuple[str, ...], fits: Sequence[JointFit], index: Sequence[Longs], labels: Sequence[str], origin: Array
) -> tuple[RigModel, RigState]:
    """Return the rig's model, points relative to `origin`, and the state from the cameras' own calibrations."""
    moved = _weighed([_about(fit, origin) for fit in fits], fits)
    alone = [
        rig_start.Alone(
            name, model, state, frames, Rigid(so3.nearest(state.R), state.t), _pose_covariance(fit), max(fit.size)
        )
        for name, (model, state), frames, fit in zip(names, moved, index, fits, strict=True)
    ]
    mounts = rig_start.mounts(alone, labels)
    poses = rig_start.rig_poses(alone, mounts, len(labels))
    internals, lens = tuple(s.internals for _, s in moved), tuple(s.lens for _, s in moved)
    state = RigState(internals, lens, mounts.rotation, mounts.translation, poses.rotation, poses.translation)
    return RigModel(names, tuple(m for m, _ in moved), tuple(index), len(labels)), state


def _estimate(
    model: RigModel,
    solution: BlockSolution[RigState],
    known: Cofactors,
    views: tuple[tuple[Observations | None, ...], ...],
    frames: tuple[str, ...],
    sizes: Sequence[tuple[int, int]],
    origin: Array,
) -> RigEstimate:
    state, stated = solution.state, _stated(views)
    variance = 1.0 if stated else solution.variance
    mounts = Rigid(so3.nearest(state.mount_rotation), state.mount_translation)
    R = so3.nearest(state.R)
    poses = Rigid(R, state.t - R @ origin)
    local = _local_from_steps(model, mounts)
    Ad = poses.inv.adjoint()
    by_frame = covariance_by_view(known)
    return RigEstimate(
        names=model.names,
        cameras=tuple(_camera(model, state, c, size) for c, size in enumerate(sizes)),
        camera_from_rig=mounts,
        frames=frames,
        rig_from_world=poses,
        views=views,
        free=tuple(m.free for m in model.cameras),
        covariance=variance * local @ known.shared @ local.T,
        by_frame=None if by_frame is None else local @ by_frame @ local.T,
        pose_covariance=variance * Ad @ known.own @ np.swapaxes(Ad, -1, -2),
        noise_px=np.array([np.median(m.noise) for m in model.cameras]) * np.sqrt(variance),
        dof=solution.blocks.dof,
        method=f"least squares of reprojection, {len(frames)} frames of {len(model.names)} cameras on a rig",
    )


def _camera(model: RigModel, state: RigState, c: int, size: tuple[int, int]) -> Camera:
    return camera_of(state.internals[c], size, model.cameras[c].lens_of(model.of_camera(state, c)))


def _local_from_steps(model: RigModel, mounts: Rigid) -> Array:
    """Return (n, n): a step exp(d) camera_from_rig is camera_from_rig exp(xi) with xi = Ad(rig_from_camera) d."""
    out, Ad = np.eye(len(model.shared)), mounts.inv.adjoint()
    for c in range(1, len(model.cameras)):
        out[model.mount_columns(c), model.mount_columns(c)] = Ad[c]
    return out


def _alone(name: str, camera: RigCamera, loss: Loss | None) -> JointFit:
    """Return a camera's own calibration; errors name it."""
    try:
        return camera.calibrated(loss)
    except TooFewPoints as error:
        task = f"camera {name!r} by itself: {error.task}"
        raise TooFewPoints(task, error.have, error.need, of=error.of, why=error.why) from error
    except (DegenerateGeometry, NotConverged) as error:
        raise type(error)(f"camera {name!r} by itself: {error}") from error


def _about(fit: JointFit, origin: Array) -> tuple[JointModel, JointState]:
    """Return model and state of a camera with the points relative to another origin."""
    state, shift = fit.solution.state, fit.origin - origin
    return replace(fit.model, p=fit.model.p + shift), replace(state, t=state.t - state.R @ shift)


def _weighed(
    moved: Sequence[tuple[JointModel, JointState]], fits: Sequence[JointFit]
) -> list[tuple[JointModel, JointState]]:
    """Return the models with the noise by which cameras are weighted: as stated, else the residual of each alone."""
    if all(_stated((fit.views,)) for fit in fits):
        return list(moved)
    own = [float(np.median(fit.model.noise) * np.sqrt(fit.solution.variance)) for fit in fits]
    if not np.isfinite(own).all():
        own = [1.0] * len(own)
    return [
        (replace(model, noise=np.full(len(model.noise), max(noise, _LEAST_NOISE))), state)
        for (model, state), noise in zip(moved, own, strict=True)
    ]


def _pose_covariance(fit: JointFit) -> Array:
    """Return the covariances by the views' own noise: errors of the internals move all of them nearly alike."""
    return fit.known.own_alone * (fit.variance if np.isfinite(fit.variance) else 1.0)


def _stated(views: Iterable[Iterable[Observations | None]]) -> bool:
    return all(v.sigma_px is not None for row in views for v in row if v is not None)


def by_camera(counts: Mapping[str, int]) -> str:
    """Return the counts by camera as text, for messages."""
    return ", ".join(f"{n} of camera {name!r}" for name, n in counts.items())


def _refuse_unlike(cameras: Mapping[str, RigCamera], frames: Sequence[str]) -> None:
    """Raise `BadValue` or `TooFewPoints` unless every camera has a view or None for each frame."""
    counts = {name: len(camera.views) for name, camera in cameras.items()}
    if len(cameras) < 2:
        raise BadValue("the number of cameras on the rig", len(cameras), "2 or more")
    if len(set(counts.values())) > 1 or (frames and len(frames) != next(iter(counts.values()))):
        named = f", {len(frames)} names" if frames else ""
        raise BadValue(
            "the number of frames",
            by_camera(counts) + named,
            "one number for all: put None where a camera saw nothing in a frame",
        )
    for name, camera in cameras.items():
        if not any(v is not None for v in camera.views):
            raise TooFewPoints(f"camera {name!r} by itself", 0, 1, of="views")


def _label(number: int, cameras: Mapping[str, RigCamera]) -> str:
    """Return the name of a frame without one, for messages: its number, and each camera's picture."""
    sources = [v.source for c in cameras.values() if (v := c.views[number]) is not None and v.source != "memory"]
    return f"{number + 1} ({' | '.join(sources)})" if sources else str(number + 1)


def _refuse_the_same_twice(cameras: Mapping[str, RigCamera]) -> None:
    """Raise `BadValue` where the observations of two cameras are identical."""
    first: dict[str, tuple[str, str]] = {}
    for name, camera in cameras.items():
        for view in camera.views:
            if view is not None and (other := first.setdefault(view.sha256, (name, view.source)))[0] != name:
                raise BadValue(
                    f"what camera {name!r} saw in {view.source}",
                    f"to the last bit what camera {other[0]!r} saw in {other[1]}",
                    "pictures or points of its own for each camera",
                )
