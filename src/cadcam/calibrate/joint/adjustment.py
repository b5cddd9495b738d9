"""One camera from several positions, internals shared: the joint optimum of section 2.4.3, for any lens and field.

The point fields may be deep or flat (a board in many poses), the same or different; each view has its own pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict, Unpack

import numpy as np

from cadcam.arrays import Array, Brief, Longs
from cadcam.calibrate.joint import start as joint_start
from cadcam.calibrate.points.free import estimated_names
from cadcam.calibrate.points.refusals import refuse_one_pixel
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import INTERNALS, camera_of
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.camera.lens import Ideal, Lens
from cadcam.camera.observations import Observations, picture_size
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints, UnknownName
from cadcam.fit.block_least_squares import BlockSolution, minimise_blocks
from cadcam.fit.extents import COLLINEAR, distinct
from cadcam.fit.joint_model import BEND, OWN, Control, JointModel, JointState
from cadcam.fit.joint_start import plane_frames
from cadcam.fit.levenberg_marquardt import Options
from cadcam.fit.robust import Loss
from cadcam.fit.square_root import Cofactors, factorise
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_each, expect_flag, expect_names, expect_positive

_FINE = Options(damping=0.0, settled=1e-12, enough=1e-14)  # of the cost: the remaining error is about 1e-5 sigma
_VIEWS = 4  # with fewer, their scatter is not meaningful
_USELESS = 1 / 3  # relative sigma of the focal length


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointFit(Brief):
    """A joint calibration in the raw form for further analysis: the model, its minimum, and the origin.

    origin (3,) mm: subtracted from all points. known: the cofactors there.
    """

    model: JointModel
    solution: BlockSolution[JointState]
    known: Cofactors
    views: tuple[Observations, ...]
    size: tuple[int, int]
    origin: Array

    @property
    def variance(self) -> float:
        """Return the factor from cofactors to covariances: 1 where the noise was stated, else from the residuals."""
        return 1.0 if _stated(self.views) else self.solution.variance


class JointOptions(TypedDict, total=False):
    """The optional arguments of a joint calibration.

    fixed: values of any of aspect, focal (px), skew (rad), U0, V0 (px). lens, free_lens: as in `calibrate_camera`.
    bend: the field is a flat board in z = const, bowed by bend_x (1 - x'^2) + bend_y (1 - y'^2) mm along z, x' and y'
    from -1 to 1 over the board; both are estimated. priors: {name: (value, sigma)} of free shared parameters.
    control_sigma: the standard deviation of the points' coordinates, mm, which are then estimated too: one number for
    all, or by name (others stay fixed); points of equal names are the same. priors and control_sigma require sigma_px.
    guess: a camera to start from, which saves the search. loss: a robust one, its scale in units of sigma_px where that
    is stated.
    """

    fixed: Mapping[str, float] | None
    lens: Lens | None
    free_lens: Iterable[str]
    bend: bool
    priors: Mapping[str, tuple[float, float]] | None
    control_sigma: float | Mapping[str, float] | None
    guess: Camera | None
    loss: Loss | None


def calibrate_jointly(
    views: Sequence[Observations], size: tuple[int, int], **options: Unpack[JointOptions]
) -> JointEstimate:
    """Return the camera of `size` (width, height) px from the points of all views, and its pose in each.

    Minimises the sum of squared pixel residuals (over their sigma_px, stated for all views or for none) over shared
    internals and all poses, without a guess. options: fixed, lens, free_lens, bend, priors, control_sigma, guess, loss;
    see `JointOptions`.

    Raises `TooFewPoints`, `DegenerateGeometry` naming what the views do not determine together, `MirroredPoints`,
    `NotConverged`, `BadValue` and `UnknownName`.
    """
    return estimate_of(fit_jointly(views, size, **options))


def fit_jointly(
    views: Sequence[Observations],
    size: tuple[int, int],
    *,
    fixed: Mapping[str, float] | None = None,
    lens: Lens | None = None,
    free_lens: Iterable[str] = (),
    bend: bool = False,
    priors: Mapping[str, tuple[float, float]] | None = None,
    control_sigma: float | Mapping[str, float] | None = None,
    guess: Camera | None = None,
    loss: Loss | None = None,
) -> JointFit:
    """Return the joint calibration of `calibrate_jointly` in its raw form."""
    expect(fixed, "fixed", Mapping, optional=True)
    views = expect_each(views, "views", Observations)
    expect(lens, "lens", Lens, optional=True)
    expect(guess, "guess", Camera, optional=True)
    expect(loss, "loss", Loss, optional=True)
    size = picture_size(size, views)
    lens, fixed = lens or Ideal(), dict(fixed or {})
    names = expect_names(free_lens, "free_lens")
    expect_flag(bend, "bend")
    free = estimated_names(fixed, lens, names, of=INTERNALS, what="shared parameter") + (BEND if bend else ())
    _refuse_few(views, free)
    for j, view in enumerate(views):
        refuse_one_pixel(view, where=f" of view {_label(view, j)}")
    _refuse_copies(views)
    _refuse_half_stated(views)
    model, origin = _model(views, free, lens, bend=bend)
    _refuse_lines(model, views)
    model = _with_knowledge(model, views, priors or {}, control_sigma)
    state = joint_start.start(model, views, size, fixed) if guess is None else joint_start.guessed(model, guess, fixed)
    solution = minimise_blocks(model, state, loss=loss, options=_FINE)
    camera = _camera(model, solution.state, size)
    mended = joint_start.set_right(model, solution, camera)
    if mended is not None:
        solution = minimise_blocks(model, mended, loss=loss, options=_FINE)
    return fit_of(model, solution, tuple(views), size, origin)


def fit_of(
    model: JointModel,
    solution: BlockSolution[JointState],
    views: tuple[Observations, ...],
    size: tuple[int, int],
    origin: Array,
) -> JointFit:
    """Return a minimum with its cofactors; `DegenerateGeometry` names what the views do not determine."""
    known = factorise(solution.weighted, model.shared, OWN, [_label(v, j) for j, v in enumerate(views)], kind="view")
    fit = JointFit(model, solution, known, views, size, origin)
    _refuse_useless(fit)
    return fit


def estimate_of(fit: JointFit) -> JointEstimate:
    """Return the estimate of a raw fit; `TooFewPoints` where nothing tells the noise, and so no covariance."""
    _refuse_unknown_noise(fit)
    state, model, known, variance = fit.solution.state, fit.model, fit.known, fit.variance
    n, by_view = len(model.free), covariance_by_view(known)
    R = so3.nearest(state.R)
    T = _local_from_own(R)
    counts = model.measured.sum(axis=1)
    noise = float(np.sqrt(variance)) if not _stated(fit.views) else float(np.median(model.noise))
    points = model.points(state) + fit.origin
    return JointEstimate(
        camera=_camera(model, state, fit.size),
        poses=Rigid(R, state.t - R @ fit.origin),
        views=fit.views,
        points=tuple(p[:c] for p, c in zip(points, counts, strict=True)),
        free=model.free,
        bend=state.bend,
        common=variance * known.shared,
        by_view=None if by_view is None else by_view[:n, :n],
        lever=-T @ known.lever,
        pose_alone=T @ (variance * known.own_alone) @ np.swapaxes(T, -1, -2),
        noise_px=noise,
        dof=fit.solution.blocks.dof,
        weights=tuple(w[:c] for w, c in zip(fit.solution.weights, counts, strict=True)),
        method=f"joint reprojection least squares of {len(fit.views)} views",
    )


def _model(views: Sequence[Observations], free: tuple[str, ...], lens: Lens, *, bend: bool) -> tuple[JointModel, Array]:
    """Arrays of all views, padded with each view's first point; the points' mean is subtracted."""
    k, N = len(views), max(len(v) for v in views)
    p, q, measured = np.zeros((k, N, 3)), np.zeros((k, N, 2)), np.zeros((k, N), dtype=bool)
    for j, view in enumerate(views):
        c = len(view)
        p[j], q[j] = view.p_world[0], view.q[0]
        p[j, :c], q[j, :c], measured[j, :c] = view.p_world, view.q, True
    origin = p[measured].mean(axis=0)
    noise = np.array([v.sigma_px or 1.0 for v in views]) if _stated(views) else np.ones(k)
    bump = _bump(p, measured) if bend else None
    return JointModel(p - origin, q, measured, free, lens, noise, bump), origin


def _bump(p: Array, measured: Array) -> Array:
    seen = p[measured]
    if np.ptp(seen[:, 2]) > 1e-6 * np.ptp(seen):
        raise BadValue(
            "the board to bend", f"{np.ptp(seen[:, 2]):.3g} mm thick in z", "a flat board with all points in z = const"
        )
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    return np.asarray(1 - ((p[..., :2] - (low + high) / 2) / np.maximum((high - low) / 2, 1e-300)) ** 2)


def _with_knowledge(
    model: JointModel,
    views: Sequence[Observations],
    priors: Mapping[str, tuple[float, float]],
    control_sigma: float | Mapping[str, float] | None,
) -> JointModel:
    if (priors or control_sigma is not None) and not _stated(views):
        raise BadValue("sigma_px", None, "a number for every view: priors and free control points are weighed by it")
    for name, (value, spread) in priors.items():
        if name not in model.free:
            raise UnknownName("free parameter to have a prior", name, model.free)
        if not (np.isfinite(value) and np.isfinite(spread) and spread > 0):
            raise BadValue(f"prior of {name}", (value, spread), "(value, sigma) with sigma above 0")
    model = replace(model, priors=tuple((n, float(v), float(s)) for n, (v, s) in priors.items()))
    if control_sigma is None:
        return model
    return replace(model, control=_control(model, views, control_sigma))


def _control(model: JointModel, views: Sequence[Observations], sigma: float | Mapping[str, float]) -> Control:
    """Free points by name, in the order in which they first occur."""
    seen = dict.fromkeys(n for v in views for n in v.names)
    by_name = dict(sigma) if isinstance(sigma, Mapping) else dict.fromkeys(seen, float(sigma))
    for name, value in by_name.items():
        if name not in seen:
            raise UnknownName("control point", name, seen)
        expect_positive(value, f"control_sigma of point {name!r}", "a positive number, mm")
    place = {name: i for i, name in enumerate(n for n in seen if n in by_name)}
    index = np.full(model.measured.shape, len(place))
    for j, view in enumerate(views):
        index[j, : len(view)] = [place.get(n, len(place)) for n in view.names]
    _refuse_two_places(model, views, place, index)
    over = 1 / np.array([by_name[n] for n in place])
    return Control(index, np.repeat(over[:, None], 3, axis=1))


def _refuse_two_places(
    model: JointModel, views: Sequence[Observations], place: Mapping[str, int], index: Longs
) -> None:
    where = np.zeros((len(place) + 1, 3))
    where[index] = model.p
    for j, i in np.argwhere(np.abs(where[index] - model.p).max(axis=-1) * (index < len(place)) > 0)[:1]:
        raise BadValue(
            f"control point {views[j].names[i]!r} of view {_label(views[j], j)}",
            (model.p[j, i]).tolist(),
            "the coordinates that it has in the other views: points of one name are one point",
        )


def _camera(model: JointModel, state: JointState, size: tuple[int, int]) -> Camera:
    return camera_of(state.internals, size, model.lens_of(state))


def _local_from_own(R: Array) -> Array:
    """(k, 6, 6): the focal centre moves by -R^T v and the camera rotates by R^T w in world axes."""
    T = np.zeros((len(R), 6, 6))
    T[:, :3, :3] = -np.swapaxes(R, -1, -2)
    T[:, 3:, 3:] = np.swapaxes(R, -1, -2)
    return T


def covariance_by_view(known: Cofactors) -> Array | None:
    """Return the covariance of the shared parameters from the scatter between views, None where they are too few."""
    if len(known.scores) < _VIEWS:
        return None
    try:
        return known.jackknifed()
    except (TooFewPoints, DegenerateGeometry):
        return None


def _stated(views: Sequence[Observations]) -> bool:
    return all(v.sigma_px is not None for v in views)


def _refuse_half_stated(views: Sequence[Observations]) -> None:
    """Raise `BadValue` where the noise of some views is stated: nothing tells their weight beside the others."""
    without = [j for j, v in enumerate(views) if v.sigma_px is None]
    if 0 < len(without) < len(views):
        j = without[0]
        raise BadValue(
            f"sigma_px of view {_label(views[j], j)}",
            None,
            f"a number, as {len(views) - len(without)} of {len(views)} views state theirs; or None for all",
        )


def _label(view: Observations, j: int) -> str:
    return f"{j + 1} ({view.source})"


def _refuse_few(views: Sequence[Observations], free: tuple[str, ...]) -> None:
    if not views:
        raise TooFewPoints("a joint calibration", 0, 1, of="views")
    for j, view in enumerate(views):
        if len({tuple(p) for p in view.p_world[:16].tolist()}) < 4 and distinct(view.p_world) < 4:
            raise TooFewPoints(f"the pose of view {_label(view, j)}", distinct(view.p_world), 4, of="different points")
    rows, need = 2 * sum(len(v) for v in views), len(free) + 6 * len(views)
    if rows < need:
        raise TooFewPoints(f"{len(free)} shared parameters and {len(views)} poses", rows // 2, -(-need // 2))


def _refuse_unknown_noise(fit: JointFit) -> None:
    """Raise `TooFewPoints` for as many equations as unknowns, none of whose residuals tell an unstated noise."""
    if np.isfinite(fit.variance):
        return
    rows, dof = fit.solution.blocks.rows, fit.solution.blocks.dof
    task = f"the noise of {len(fit.model.shared)} shared parameters and {len(fit.views)} poses"
    state = "with as many equations as unknowns no residual tells it; add points, or state sigma_px"
    raise TooFewPoints(task, rows // 2, -(-(rows - dof + 1) // 2), why=state)


def _refuse_copies(views: Sequence[Observations]) -> None:
    """Raise `BadValue` where two views are identical: counted twice, they would make the result look too certain."""
    first: dict[str, int] = {}
    for j, view in enumerate(views):
        if (i := first.setdefault(view.sha256, j)) != j:
            raise BadValue(f"view {_label(view, j)}", f"the same as view {_label(views[i], i)}", "each view once")


def _refuse_lines(model: JointModel, views: Sequence[Observations]) -> None:
    extents = plane_frames(model.p, model.measured)[2]
    for j in np.flatnonzero(extents[:, 1] <= COLLINEAR * extents[:, 0])[:1]:
        raise DegenerateGeometry(
            f"the points of view {_label(views[j], j)} lie on a line: the camera may turn about it; add points beside "
            "it or leave the view out"
        )


def _refuse_useless(fit: JointFit) -> None:
    """Raise `DegenerateGeometry` where noise hides the focal length: boards all parallel to the picture."""
    if "focal" not in fit.model.free or not np.isfinite(fit.variance):
        return
    i = fit.model.free.index("focal")
    focal, sigma = fit.solution.state.internals[1], float(np.sqrt(fit.variance * fit.known.shared[i, i]))
    if sigma > _USELESS * focal:
        raise DegenerateGeometry(
            f"the views do not determine the focal length: {focal:.4g} +- {sigma:.2g} px; flat fields must be seen "
            "tilted, in different directions: add such views, add points at other heights, or fix focal"
        )
