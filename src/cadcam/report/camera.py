"""Cameras and estimates as tables: mm, px and degrees, sigmas beside the values, doubts in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from cadcam.calibrate.points.held import Held
from cadcam.camera import opengl
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES, ExtendedPinhole
from cadcam.camera.fitted import freedom_words
from cadcam.geometry.rigid import Rigid
from cadcam.report.table import Table, matrix_rows, plain, with_sigma

ANGLES = ("a", "b", "c", "skew")
STRONG = 0.9  # correlations above it are named

MEANING = {
    "X": ("mm", "focal centre in the world"),
    "Y": ("mm", ""),
    "Z": ("mm", ""),
    "a": ("deg", "rotation about X, then b about Y, then c about Z"),
    "b": ("deg", ""),
    "c": ("deg", ""),
    "aspect": ("", "column pixels per row pixel, fx/fy without skew"),
    "focal": ("px", "focal length in rows, fy"),
    "skew": ("deg", "image axes off the right angle"),
    "U0": ("px", "principal point, row (cy)"),
    "V0": ("px", "principal point, column (cx)"),
}


def estimate_tables(estimate: CameraEstimate) -> list[Table]:
    """Return all results of a calibration: parameters with sigmas, K, residuals by point, strong correlations."""
    tables = [parameter_table(estimate), camera_table(estimate.camera), residual_table(estimate)]
    correlated = strong_correlations(estimate)
    if correlated:
        rows = tuple((one, other, f"{value:+.3f}") for one, other, value in correlated)
        note = "neither of such a pair is well known by itself; what they do together is"
        title = f"Correlations beyond {STRONG}"
        tables.append(
            Table(title, ("parameter", "parameter ", "correlation"), rows, ("parameter", "parameter "), (note,))
        )
    if estimate.alternative is not None:
        tables.append(alternative_table(estimate, estimate.alternative))
    return tables


def parameter_table(estimate: CameraEstimate) -> Table:
    """Return the parameters with sigma and unit, angles in degrees."""
    rows = []
    for name, value in zip(estimate.parameters, estimate.values.tolist(), strict=True):
        unit, meaning = MEANING.get(name, ("", "lens"))
        scale = shown_scale(name)
        free = name in estimate.free
        if name not in NAMES and not free and not value:
            continue  # an unused lens term
        shown, sigma = with_sigma(scale * value, scale * estimate.sigma(name) if free else 0.0)
        rows.append((name, shown, f"+- {sigma}" if free else "fixed", unit, meaning))
    return Table(
        f"Camera of {len(estimate.observations)} points from {estimate.observations.source}",
        ("parameter", "value", "sigma", "unit", "meaning"),
        tuple(rows),
        ("parameter", "unit", "meaning", "sigma"),
        quality_notes(estimate),
    )


def held_words(estimate: CameraEstimate, held: Held) -> str:
    """Return what points say against values that were held, with the values that they would give."""
    said = []
    for name in held.names:
        scale, unit = shown_scale(name), MEANING[name][0]
        value, sigma = with_sigma(scale * held.free.value(name), scale * held.free.sigma(name))
        said.append(f"{name} would be {f'{value} +- {sigma} {unit}'.rstrip()}, not {scale * estimate.value(name):.6g}")
    residuals = f"{held.free.thesis_residual:.3g} px a point in place of {estimate.thesis_residual:.3g}"
    return f"the points contradict what is held: left free, {'; '.join(said)}; residual {residuals}"


def pinhole_table(pinhole: ExtendedPinhole) -> Table:
    """Return the eleven parameters where no covariance is known."""
    rows = []
    for name, value in zip(NAMES, pinhole.vector.tolist(), strict=True):
        unit, meaning = MEANING[name]
        rows.append((name, plain(shown_scale(name) * value), unit, meaning))
    return Table(
        "Eleven parameters", ("parameter", "value", "unit", "meaning"), tuple(rows), ("parameter", "unit", "meaning")
    )


def quality_notes(estimate: CameraEstimate) -> tuple[str, ...]:
    """Return residual, freedom, worst point, noise, size of the points, method and doubts, one sentence each."""
    worst, distance = estimate.worst()
    size = " x ".join(f"{v:.4g}" for v in np.ptp(estimate.observations.p_world, axis=0))
    return (
        f"residual {estimate.thesis_residual:.3g} px a point (RMS {estimate.rms_px:.3g} px a coordinate), "
        f"{freedom_words(estimate.dof)}; worst point {worst}: {distance:.3g} px",
        _noise_note(estimate),
        *_held_note(estimate),
        f"the points span {size} mm in X, Y, Z",
        *((f"method: {estimate.method}",) if estimate.method else ()),
        *estimate.doubts,
    )


def _noise_note(estimate: CameraEstimate) -> str:
    stated = estimate.observations.sigma_px
    if stated is not None:
        said = f"sigmas for the stated noise of {stated:g} px a coordinate"
        return said if estimate.sigma0 is None else f"{said}; the residuals say {estimate.sigma0:.3g} px"
    if estimate.sigma0 is None:
        return "sigmas unknown: as many equations as unknowns, and no sigma_px stated"
    return f"sigmas for a noise of {estimate.sigma0:.3g} px a coordinate, as the residuals say"


def _held_note(estimate: CameraEstimate) -> tuple[str, ...]:
    """Return what the sigmas of a pose leave out: the errors of the camera that was taken as it is."""
    if not estimate.pose_alone:
        return ()
    return (
        "sigmas of points and pixels alone, as if the camera's own numbers were exact: `cadcam measure --placed` "
        "(Viewpoint.located) adds their errors",
    )


def camera_words(camera: Camera) -> str:
    """Return size, internals (px) and lens of a camera, one line."""
    (cx, cy), skew = camera.principal_point, f", skew {plain(camera.skew, 4)}" if camera.skew else ""
    internals = f"fx {plain(camera.fx)}, fy {plain(camera.fy)}, cx {plain(cx)}, cy {plain(cy)}{skew} px"
    return f"{camera.width} x {camera.height} px, {internals}, {_lens_words(camera)}"


def _lens_words(camera: Camera) -> str:
    coefficients = ", ".join(f"{k} {plain(v)}" for k, v in camera.lens.parameters.items() if v)
    return f"lens {camera.lens.name}" + (f": {coefficients}" if coefficients else "")


def camera_table(camera: Camera, *, sized: bool = True) -> Table:
    """Return K, and lens and size as notes; without `sized` the picture's size is not known."""
    picture = f"picture {camera.width} x {camera.height} px" if sized else "picture size not known"
    notes = [f"{picture}; pixel (0, 0) is the centre of the top-left one"]
    notes.append(_lens_words(camera))
    return Table("Camera matrix K, px", ("", "", ""), matrix_rows(camera.K), (), tuple(notes))


def pose_table(camera_from_world: Rigid) -> Table:
    """Return the 3x4 matrix camera_from_world."""
    return Table(
        "camera_from_world (x right, y down, z forward; last column mm)",
        ("",) * 4,
        matrix_rows(camera_from_world.matrix[:3]),
    )


def residual_table(estimate: CameraEstimate) -> Table:
    """Return measured and residual pixels point by point, the worst marked."""
    distance = np.linalg.norm(estimate.residuals, axis=1)
    worst = int(np.argmax(distance))
    rows = []
    observed = estimate.observations
    for i, name in enumerate(observed.names):
        mark = "worst" if i == worst else ""
        x, y = observed.q[i]
        dx, dy = estimate.residuals[i]
        rows.append((name, f"{x:.2f}", f"{y:.2f}", f"{dx:+.2f}", f"{dy:+.2f}", f"{distance[i]:.2f}", mark))
    return Table(
        "Residuals, measured - projected, px (x = column, y = row)",
        ("point", "x", "y", "dx", "dy", "distance", ""),
        tuple(rows),
        ("point", ""),
    )


def strong_correlations(estimate: CameraEstimate, *, beyond: float = STRONG) -> list[tuple[str, str, float]]:
    """Return the pairs of free parameters correlated beyond +-`beyond`, the strongest first."""
    C = estimate.correlation
    i, j = np.triu_indices(len(C), 1)
    order = [k for k in np.argsort(-np.abs(C[i, j])) if abs(C[i[k], j[k]]) > beyond]
    return [(estimate.free[i[k]], estimate.free[j[k]], float(C[i[k], j[k]])) for k in order]


def alternative_table(estimate: CameraEstimate, other: CameraEstimate) -> Table:
    """Return both poses that a flat target allows, side by side."""
    rows = []
    for name, one, two in zip(NAMES[:6], estimate.values.tolist(), other.values.tolist(), strict=False):
        scale = shown_scale(name)
        rows.append((name, plain(scale * one), plain(scale * two), MEANING[name][0]))
    rows.append(("residual", f"{estimate.thesis_residual:.3g}", f"{other.thesis_residual:.3g}", "px"))
    return Table(
        "Two poses explain these points",
        ("parameter", "this one", "the other", "unit"),
        tuple(rows),
        ("parameter", "unit"),
        ("where the residuals are alike, only knowledge from outside can tell which is true",),
    )


def opengl_tables(camera: Camera, camera_from_world: Rigid, *, near: float, far: float) -> list[Table]:
    """Return glFrustum's, gluLookAt's and glViewport's arguments and the exact 4x4 matrices; near and far in mm."""
    frustum = opengl.frustum(camera, near=near, far=far)
    names = ("left", "right", "bottom", "top", "near", "far")
    look = opengl.look_at(camera, camera_from_world)
    skewed = ("it cannot carry the skew: use the 4x4 below",) if camera.skew else ()
    lens = () if camera.lens.name == "ideal" else ("the lens is in none of these: distort the picture, or the lines",)
    return [
        Table("glFrustum, mm", names, (tuple(plain(getattr(frustum, n)) for n in names),), notes=(*skewed, *lens)),
        Table(
            "gluLookAt, mm",
            ("", "x", "y", "z"),
            tuple((n, *(plain(float(v)) for v in getattr(look, n))) for n in ("eye", "center", "up")),
            ("",),
        ),
        Table("glViewport, px", ("x", "y", "width", "height"), (tuple(str(v) for v in opengl.viewport(camera)),)),
        Table(
            "Projection matrix 4x4 with skew and aspect (clip_from_eye)",
            ("",) * 4,
            matrix_rows(opengl.projection_matrix(camera, near=near, far=far)),
        ),
        Table(
            "Model-view matrix 4x4 (eye_from_world; x right, y up, z back)",
            ("",) * 4,
            matrix_rows(opengl.model_view_matrix(camera_from_world)),
        ),
    ]


def opengl_as_json(camera: Camera, camera_from_world: Rigid, *, near: float, far: float) -> dict[str, Any]:
    """Return the same values as a JSON object; near and far in mm."""
    look = opengl.look_at(camera, camera_from_world)
    return {
        "glFrustum_mm": asdict(opengl.frustum(camera, near=near, far=far)),
        "gluLookAt": {"eye_mm": look.eye.tolist(), "center_mm": look.center.tolist(), "up": look.up.tolist()},
        "glViewport_px": list(opengl.viewport(camera)),
        "clip_from_eye": opengl.projection_matrix(camera, near=near, far=far).tolist(),
        "eye_from_world": opengl.model_view_matrix(camera_from_world).tolist(),
    }


def compared(
    title: str,
    estimate: CameraEstimate,
    others: Mapping[str, CameraEstimate | Mapping[str, str]],
    *,
    notes: tuple[str, ...] = (),
) -> Table:
    """Return an estimate's parameters with sigmas beside other estimates and printed values, one column each."""
    rows = []
    for name, value in zip(estimate.parameters[: len(NAMES)], estimate.values.tolist(), strict=False):
        scale = shown_scale(name)
        shown, sigma = with_sigma(scale * value, scale * estimate.sigma(name))
        decimals = len(shown.partition(".")[2])
        cells = [
            f"{scale * other.value(name):.{decimals}f}" if isinstance(other, CameraEstimate) else other.get(name, "")
            for other in others.values()
        ]
        rows.append((name, shown, f"+- {sigma}", *cells, MEANING[name][0]))
    residuals = [
        f"{other.thesis_residual:.3f}" if isinstance(other, CameraEstimate) else other.get("residual", "")
        for other in others.values()
    ]
    rows.append(("residual", f"{estimate.thesis_residual:.3f}", "", *residuals, "px"))
    columns = ("parameter", "least squares", "sigma", *others, "unit")
    return Table(title, columns, tuple(rows), ("parameter", "sigma", "unit"), notes)


def against_truth(
    title: str, estimate: CameraEstimate, truth: Mapping[str, float], *, notes: tuple[str, ...] = ()
) -> Table:
    """Return the free parameters with sigmas beside the true ones, and the errors in sigmas."""
    rows = []
    for name in estimate.free:
        scale, value, sigma = shown_scale(name), estimate.value(name), estimate.sigma(name)
        shown, spread = with_sigma(scale * value, scale * sigma)
        decimals = len(shown.partition(".")[2])
        error = f"{(value - truth[name]) / sigma:+.1f}"
        true = f"{scale * truth[name]:.{decimals}f}"
        rows.append((name, shown, f"+- {spread}", true, error, MEANING.get(name, ("",))[0]))
    notes = (f"residual {estimate.thesis_residual:.3g} px a point, {freedom_words(estimate.dof)}", *notes)
    columns = ("parameter", "estimate", "sigma", "truth", "error/sigma", "unit")
    return Table(title, columns, tuple(rows), ("parameter", "sigma", "unit"), notes)


def shown_scale(name: str) -> float:
    """Return the factor from a parameter to the unit it is shown in: degrees for angles, else mm and px unchanged."""
    return float(np.degrees(1.0)) if name in ANGLES else 1.0
