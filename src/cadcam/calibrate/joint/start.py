"""The start of a joint calibration, without a guess: internals from the views, then refined in growing models.

Flat fields give homographies, deep ones calibrations of their own. Several internals are tried on some of the views;
each stage starts from the solution of the simpler one, so that a richer model is never worse than one it contains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import INTERNALS, camera_of, internals_by_name, internals_of
from cadcam.camera.lens import Lens
from cadcam.camera.observations import Observations
from cadcam.errors import CadcamError, DegenerateGeometry, MirroredPoints, NotConverged
from cadcam.fit import joint_start as seeds
from cadcam.fit.block_least_squares import BlockSolution, minimise_blocks
from cadcam.fit.joint_model import BEND, JointModel, JointState
from cadcam.fit.levenberg_marquardt import Options

_FLAT = 0.05  # thickness over length below which a field is taken as flat for a start
_FOCALS = (0.4, 0.8, 1.6, 4.0)  # over the longer side of the picture, where the views do not determine it
_SOME = 8  # views that the stages use
_DEEP = 3  # deep views calibrated separately
_ROUGH = Options(max_iterations=30, settled=1e-2, enough=1.0)
_NEAR = 0.003  # of the longer side of the picture: a start with such residuals is near the optimum
_ASTRAY = 4.0  # times the median view's residual: possibly the other pose of a flat field


def start(
    model: JointModel, views: Sequence[Observations], size: tuple[int, int], fixed: Mapping[str, float]
) -> JointState:
    """Return a state near the optimum of the model with all of its free parameters.

    Raises the errors of a single view's calibration if no view gives a start, and `MirroredPoints`.
    """
    some = np.unique(np.linspace(0, len(views) - 1, min(_SOME, len(views))).round().astype(int))
    few, flat = model.with_views(some), _flattened(model)
    told, guesses = _internals(model, flat, views, size, fixed)
    posed = [_posed(few, flat.at(some), i) for i in (*told, *guesses)]
    if not any(np.isfinite(_cost(few, c)) for c in posed):
        posed = [_in_sight(few, c) for c in posed]
    state = _staged(few, posed, _NEAR * max(size), guessed=not told)
    everywhere = _posed(model, flat, state.internals)
    whole = replace(state, R=everywhere.R, t=everywhere.t)
    whole.R[some], whole.t[some] = state.R, state.t
    return _in_sight(model, whole)


def guessed(model: JointModel, camera: Camera, fixed: Mapping[str, float]) -> JointState:
    """Return the state of a guessed camera with fixed values set, and its lens if it is of the model's kind."""
    values = internals_by_name(camera) | dict(fixed)
    state = _posed(model, _flattened(model), _row(values))
    if type(camera.lens) is type(model.lens):
        free = {n: v for n, v in camera.lens.parameters.items() if n in model.free}
        state = replace(state, lens=np.array(list({**model.lens.parameters, **free}.values())))
    return _in_sight(model, state)


def set_right(model: JointModel, solution: BlockSolution[JointState], camera: Camera) -> JointState | None:
    """Return the state with the poses of badly fitting views searched globally, or None where none improves."""
    state, squares = solution.state, solution.blocks.squared_distances().sum(axis=1)
    distance = model.noise * np.sqrt(squares / model.measured.sum(axis=1))  # the thesis' residual of each view, px
    suspects = np.flatnonzero(distance > _ASTRAY * np.median(distance))
    sought = _sought(model, state, camera, suspects)
    better = [j for j in sought if sought[j].thesis_residual < 0.9 * distance[j]]
    return _moved(state, {j: sought[j] for j in better}) if better else None


def _in_sight(model: JointModel, state: JointState) -> JointState:
    """Return the state with the poses of views that do not image all of their points searched globally."""
    r = np.where(model.measured[..., None], model.residuals(state), 0.0)
    blind = np.flatnonzero(~np.isfinite(r).all(axis=(1, 2)))
    if not blind.size:
        return state
    return _moved(state, _sought(model, state, camera_of(state.internals, (1, 1), model.lens_of(state)), blind))


def _sought(model: JointModel, state: JointState, camera: Camera, index: Longs) -> dict[int, CameraEstimate]:
    """Poses of views by a global search with a known camera; views without a result are left out."""
    points, found = model.points(state), {}
    for j in index.tolist():
        seen = model.measured[j]
        try:
            found[j] = locate_camera(Observations(points[j][seen], model.q[j][seen]), camera)
        except CadcamError:
            continue
    return found


def _moved(state: JointState, found: Mapping[int, CameraEstimate]) -> JointState:
    R, t = state.R.copy(), state.t.copy()
    for j, estimate in found.items():
        R[j], t[j] = estimate.camera_from_world.rotation, estimate.camera_from_world.translation
    return replace(state, R=R, t=t)


@dataclass(frozen=True, slots=True, eq=False)
class _Flattened:
    """Each view's field as a plane: homographies (k, 3, 3), the plane's origin and axes, thickness over length (k,)."""

    H: Array
    origin: Array
    axes: Array
    thick: Array

    def at(self, index: Longs) -> _Flattened:
        return _Flattened(self.H[index], self.origin[index], self.axes[index], self.thick[index])


def _flattened(model: JointModel) -> _Flattened:
    origin, axes, extents = seeds.plane_frames(model.p, model.measured)
    flat = ((model.p - origin[:, None]) @ axes)[..., :2]
    H = seeds.homographies(flat, model.q, model.measured)
    return _Flattened(H, origin, axes, extents[:, 2] / np.maximum(extents[:, 0], 1e-300))


def _internals(
    model: JointModel,
    flat: _Flattened,
    views: Sequence[Observations],
    size: tuple[int, int],
    fixed: Mapping[str, float],
) -> tuple[list[Array], list[Array]]:
    """Return rows of internals to try, fixed ones as given: those that views tell, and those with a guessed focal."""
    usual = {"aspect": 1.0, "skew": 0.0, "U0": (size[1] - 1) / 2, "V0": (size[0] - 1) / 2, **fixed}
    if "focal" in fixed:
        return [_row(usual)], []
    H, deep = flat.H[flat.thick < _FLAT], np.flatnonzero(flat.thick >= _FLAT)
    told, focal = _of_flat(model, H, size, usual) if len(H) else ([], None)
    if deep.size:
        told += _of_deep([views[int(j)] for j in deep], size, fixed, model.lens, alone=not len(H))
    unsure = len(H) > 0 and focal is None
    guesses = [_row({**usual, "focal": k * max(size)}) for k in _FOCALS] if unsure or not told else []
    return told, guesses


def _of_flat(
    model: JointModel, H: Array, size: tuple[int, int], usual: Mapping[str, float]
) -> tuple[list[Array], float | None]:
    """Return internals from homographies (k, 3, 3), and the focal length that they tell beside usual values, if any."""
    rows, held = [], {n: usual[n] for n in usual if n not in model.free}
    for skew in (True, False) if "skew" in model.free else (False,):
        K = seeds.internals_of_homographies(H, size, skew=skew) if len(H) >= (3 if skew else 2) else None
        if K is not None:
            rows.append(_row({**dict(zip(INTERNALS, internals_of(K), strict=True)), **held}))
    focal = seeds.focal_of_homographies(H, size, usual["aspect"], np.array([usual["V0"], usual["U0"]]))
    return rows + ([] if focal is None else [_row({**usual, "focal": focal})]), focal


def _row(values: Mapping[str, float]) -> Array:
    return np.array([values[n] for n in INTERNALS])


def _of_deep(
    views: Sequence[Observations], size: tuple[int, int], fixed: Mapping[str, float], lens: Lens, *, alone: bool
) -> list[Array]:
    """Internals from calibrations of single views, and their median; raises the last error if none works, `alone`."""
    rows: list[Array] = []
    failure: CadcamError | None = None
    for view in sorted(views, key=len, reverse=True)[:_DEEP]:
        try:
            rows.append(internals_of(calibrate_camera(view, size, fixed=fixed, lens=lens).camera.K))
        except MirroredPoints:
            raise
        except CadcamError as error:
            failure = error
    if not rows and alone and failure is not None and not isinstance(failure, DegenerateGeometry | NotConverged):
        raise failure
    return [*rows, np.median(rows, axis=0)] if len(rows) > 1 else rows


def _posed(model: JointModel, flat: _Flattened, internals: Array) -> JointState:
    """Return the state of these internals with every view's pose from a linear transform."""
    K = camera_of(internals, (1, 1)).K
    R, t = seeds.poses_of_homographies(flat.H, K)
    R = R @ np.swapaxes(flat.axes, -1, -2)
    t = t - (R @ flat.origin[..., None])[..., 0]
    deep = np.flatnonzero((flat.thick >= _FLAT) & (model.measured.sum(axis=1) >= 6))
    if deep.size:
        few = model.with_views(deep)
        R[deep], t[deep] = seeds.poses_of_matrices(seeds.camera_matrices(few.p, few.q, few.measured), K)
    P = 0 if model.control is None else len(model.control.whitener)
    lens = np.array(list(model.lens.parameters.values()))
    return JointState(internals.copy(), lens, np.zeros(2), np.zeros((P, 3)), R, t)


def _staged(model: JointModel, candidates: list[JointState], near: float, *, guessed: bool) -> JointState:
    """Return the best state of the model's views, the free parameters released one group after the other.

    A candidate whose residual is below `near` (px) is accepted without trying the others. guessed: whether nothing is
    known of the candidates' focal lengths; then these are released first.
    """
    first, *rest = _stages(model)
    costs = [_cost(model, c) for c in candidates]
    best = int(np.argmin(costs))
    if costs[best] < near**2 * model.measured.sum():
        candidates = [candidates[best]]
    elif guessed:
        held = [_descend(model.with_free([n for n in first if n == "focal"]), c) for c in candidates]
        candidates = [s for s in held if s is not None]
    finer = [s for s in (_descend(model.with_free(first), c) for c in candidates) if s is not None]
    if not finer:
        raise NotConverged(
            "no pose found from which every point of every view is imaged; do points and pixels belong together?"
        )
    state = min(finer, key=lambda s: _cost(model, s))
    for free in rest:
        state = _descend(model.with_free(free), state) or state
    return state


def _stages(model: JointModel) -> list[tuple[str, ...]]:
    """Growing tuples of free parameters: the usual internals; skew; the first coefficient; five; all; bend."""
    lens = [n for n in model.free if n not in INTERNALS and n not in BEND]
    groups = [["focal", "aspect", "U0", "V0"], ["skew"], lens[:1], lens[1:5], lens[5:], list(BEND)]
    stages: list[tuple[str, ...]] = []
    wanted: set[str] = set()
    for group in groups:
        wanted |= set(group) & set(model.free)
        stage = tuple(n for n in model.free if n in wanted)
        if not stages or stage != stages[-1]:
            stages.append(stage)
    return stages


def _descend(model: JointModel, state: JointState) -> JointState | None:
    try:
        found = minimise_blocks(replace(model, control=None, priors=()), _without_points(state), options=_ROUGH).state
    except NotConverged:
        return None
    return replace(found, shift=state.shift)


def _without_points(state: JointState) -> JointState:
    return replace(state, shift=np.zeros((0, 3)))


def _cost(model: JointModel, state: JointState) -> float:
    r = model.residuals(state)[model.measured]
    return float(np.sum(r * r)) if np.isfinite(r).all() else np.inf
