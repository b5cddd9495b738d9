"""A camera from world points and their pixels, without a guess: full calibration, part of it, or the pose alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.points.free import estimated_names
from cadcam.calibrate.points.linear import dlt_estimate, dlt_states, seen_from_the_front
from cadcam.calibrate.points.refusals import (
    mirrored_internals,
    refuse_as_good_as_flat,
    refuse_mirrored,
    refuse_one_pixel,
)
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import EXTERNALS, INTERNALS, NAMES, internals_by_name, internals_of
from cadcam.camera.lens import Ideal, Lens
from cadcam.camera.observations import Observations, picture_size
from cadcam.camera.sensitivity import rotation_by_angles
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.extents import distinct, flatness, refuse_flat
from cadcam.fit.global_search import Effort, minima, polished
from cadcam.fit.least_squares import Solution, Stalled, cofactor
from cadcam.kinds import expect, expect_known, expect_names

Method = Literal["reprojection", "dlt", "dlt-c23"]
METHODS: tuple[Method, ...] = get_args(Method)

_FOCALS = (0.3, 0.6, 1.2, 2.5, 6.0)  # over the longer side of the picture: 118 to 10 deg of view
_FLAT = 0.01  # thickness over length below which the second pose is always reported
_NEARLY_AS_GOOD = 3.0  # above it, if its residual is less than this many times the best
_SWEEP = Effort(triples=10, keep=3, spread=6, iterations=40)


def calibrate_camera(
    observations: Observations,
    size: tuple[int, int],
    *,
    fixed: Mapping[str, float] | None = None,
    lens: Lens | None = None,
    free_lens: Iterable[str] = (),
    method: Method = "reprojection",
) -> CameraEstimate:
    """Return the camera of `size` (width, height) px that images the points at their pixels, and its pose.

    Minimises the sum of squared pixel residuals over every parameter that is not fixed, globally and without a guess.
    fixed: values for any of X Y Z (mm) a b c (rad) aspect focal (px) skew (rad) U0 V0 (px). lens: its model and
    coefficients, default ideal; free_lens names the coefficients to estimate, from the given ones as a start.
    method "dlt" and "dlt-c23" give the direct linear transform alone, in its normalised or the thesis' form (EQ
    2.62-2.65), with its own covariance: biased, and kept for comparison.

    Raises `TooFewPoints`; `DegenerateGeometry` for points on a line or all at one pixel, points on a plane with more
    than 8 unknowns, or parameters that the points do not determine (named); `MirroredPoints`; `BadValue` and
    `UnknownName` for bad arguments.
    """
    expect(fixed, "fixed", Mapping, optional=True)
    expect(observations, "observations", Observations)
    expect(lens, "lens", Lens, optional=True)
    size = picture_size(size, [observations])
    lens, fixed = lens or Ideal(), dict(fixed or {})
    free = estimated_names(fixed, lens, expect_names(free_lens, "free_lens"), of=NAMES, what="parameter")
    _refuse_few(observations, free)
    refuse_flat(observations.p_world, unknowns=len(free))
    refuse_one_pixel(observations)
    expect_known(method, "calibration method", METHODS)
    if method != "reprojection":
        if free != NAMES or lens != Ideal():
            raise BadValue("method", repr(method), "'reprojection' where anything is fixed or a lens is asked for")
        return dlt_estimate(observations, size, "normalised" if method == "dlt" else "c23")
    model = CameraModel(observations.p_world, observations.q, free, lens)
    try:
        found = _search(model, size, fixed)
    except Stalled as error:
        _refuse_mirrored(model, size, fixed, observations, error.sum_of_squares)
        raise DegenerateGeometry(_no_best_camera(observations, free, error)) from error
    _refuse_mirrored(model, size, fixed, observations, found[0].sum_of_squares)
    estimate = _estimate(model, found, observations, size, "reprojection least squares, global search")
    refuse_as_good_as_flat(estimate)
    return estimate


def locate_camera(observations: Observations, camera: Camera) -> CameraEstimate:
    """Return the pose of a known camera (resection, "PnP"), from at least four points.

    Its internals and lens are kept, and taken as exact: `Viewpoint.located` adds their errors. The global minimum of
    the reprojection error, without a guess, for any lens. A flat target's second pose is reported as `alternative`,
    with its residuals, if it is a minimum too; so is any other pose that fits nearly as well. Raises `TooFewPoints`,
    `DegenerateGeometry` for points on a line or all at one pixel, `MirroredPoints`, and `BadValue` naming a point that
    lies where the lens images nothing.
    """
    expect(observations, "observations", Observations)
    expect(camera, "camera", Camera)
    _refuse_few(observations, EXTERNALS)
    refuse_flat(observations.p_world, unknowns=len(EXTERNALS))
    refuse_one_pixel(observations)
    _refuse_blind_pixels(observations, camera)
    model = CameraModel(observations.p_world, observations.q, EXTERNALS, camera.lens)
    found = minima(model, internals_of(camera.K)[None])
    method = "pose by reprojection least squares, global search"
    estimate = _estimate(model, found, observations, camera.size, method, camera)
    _refuse_mirrored(model, camera.size, internals_by_name(camera), observations, estimate.sum_of_squares)
    return estimate


def _refuse_mirrored(
    model: CameraModel, size: tuple[int, int], fixed: Mapping[str, float], observations: Observations, best: float
) -> None:
    if any(name in fixed for name in EXTERNALS):
        return

    def lowest(q: Array) -> float:
        if seen_from_the_front(observations):
            return np.inf
        values = mirrored_internals(fixed, size[0])
        return _search(replace(model, q=q), size, values)[0].sum_of_squares

    refuse_mirrored(observations, size[0], model.free, best, lowest)


def _search(model: CameraModel, size: tuple[int, int], fixed: Mapping[str, float]) -> list[Solution[Array]]:
    """Find the pinhole's minima first, and release lens coefficients there."""
    pinhole = tuple(n for n in model.free if n in NAMES)
    if not pinhole:
        raise BadValue("free parameters", model.free, "at least one of the pinhole's eleven")
    rigid = CameraModel(model.p_world, model.q, pinhole, model.lens)
    externals_free = not any(n in fixed for n in EXTERNALS)
    extra = dlt_states(rigid, fixed) if externals_free else None
    effort = Effort() if "focal" in fixed else _SWEEP
    found = minima(rigid, _internals(fixed, size), fixed=fixed, extra=extra, effort=effort)
    return found if pinhole == model.free else polished(model, np.stack([s.state for s in found]))


def _internals(fixed: Mapping[str, float], size: tuple[int, int]) -> Array:
    """Rows (M, 5) of internals to start from: fixed ones as given, the others typical of pictures."""
    focals = [fixed["focal"]] if "focal" in fixed else [k * max(size) for k in _FOCALS]
    usual = {"aspect": 1.0, "skew": 0.0, "U0": (size[1] - 1) / 2, "V0": (size[0] - 1) / 2}
    return np.array([[{**usual, "focal": f, **fixed}[name] for name in INTERNALS] for f in focals])


def _estimate(
    model: CameraModel,
    found: list[Solution[Array]],
    observations: Observations,
    size: tuple[int, int],
    method: str,
    camera: Camera | None = None,
) -> CameraEstimate:
    """Return the first minimum as an estimate, the second as its alternative where it matters."""
    best, *others = found
    other = others[0] if others and _worth_telling(model, best, others[0]) else None
    return CameraEstimate(
        camera=model.camera(best.state, size) if camera is None else camera,
        camera_from_world=model.pose(best.state),
        observations=observations,
        free=model.free,
        cofactor=_local_cofactor(model, best),
        method=method,
        alternative=None if other is None else _estimate(model, [other], observations, size, method, camera),
    )


def _worth_telling(model: CameraModel, best: Solution[Array], other: Solution[Array]) -> bool:
    flat = flatness(model.p_world) < _FLAT
    return flat or other.sum_of_squares < _NEARLY_AS_GOOD**2 * best.sum_of_squares


def _local_cofactor(model: CameraModel, solution: Solution[Array]) -> Array:
    """Return (J^T J)^-1 of the free parameters, placed among all the local coordinates."""
    names = (*NAMES, *model.lens.parameters)
    place = np.zeros((len(names), len(model.free)))
    place[[names.index(n) for n in model.free], np.arange(len(model.free))] = 1.0
    if model.steps_angles:
        place[3:6] = rotation_by_angles(solution.state[3:12].reshape(3, 3)) @ place[3:6]
    return np.asarray(place @ cofactor(solution.jacobian, model.free) @ place.T)


def _no_best_camera(observations: Observations, free: tuple[str, ...], error: Stalled) -> str:
    return (
        "no camera fits best: the residual keeps falling towards a limit that is no camera (infinitely far away, or "
        f"with parallel image axes). {len(observations)} points, {flatness(observations.p_world):.2g} as thick as "
        f"long, do not determine {len(free)} parameters; fix some (skew is 0 and aspect known for most cameras), or "
        f"add points at other depths ({error})"
    )


def _refuse_few(observations: Observations, free: tuple[str, ...]) -> None:
    need = max(4, -(-len(free) // 2))
    have = distinct(observations.p_world)
    if have < need:
        n = len(observations)
        why = f"{n} points, {have} of them different" if have < n else ""
        raise TooFewPoints(f"an estimate of {len(free)} parameters", have, need, why=why)


def _refuse_blind_pixels(observations: Observations, camera: Camera) -> None:
    blind = np.flatnonzero(~np.isfinite(camera.unproject(observations.q)).all(axis=1))
    if blind.size:
        i = int(blind[0])
        raise BadValue(
            f"pixel (column, row) of point {observations.names[i]!r}",
            observations.q[i].tolist(),
            f"one that the lens can have imaged ({camera.lens}, {blind.size} such points)",
        )
