"""A rig as tables: the relative poses of its cameras, each camera's parameters, every frame; mm and degrees."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.boards.pictures import BoardCalibration
from cadcam.camera.rig_estimate import RelativePose, RigEstimate
from cadcam.camera.sensitivity import twist_by_local
from cadcam.geometry import rotation as so3
from cadcam.report.camera import MEANING, shown_scale
from cadcam.report.table import Table, with_sigma

_ROUGHLY = 1.5  # ratio of the frames' scatter to the classical sigma above which it is mentioned
_ROWS = (
    ("X", "mm", "focal centre of {1} in the axes of {0}"),
    ("Y", "mm", ""),
    ("Z", "mm", ""),
    ("rx", "deg", "rotation vector that turns directions in {0}'s axes into {1}'s"),
    ("ry", "deg", ""),
    ("rz", "deg", ""),
)


def rig_tables(estimate: RigEstimate, alone: Mapping[str, BoardCalibration] | None = None) -> list[Table]:
    """Return mounts, cameras and frames, and, from pictures of a board, the pictures that were left out."""
    tables = [mount_table(estimate), cameras_table(estimate), frames_table(estimate)]
    return tables if alone is None else [*tables, *_left_out(alone)]


def mount_table(estimate: RigEstimate) -> Table:
    """Return each camera's pose in the first one's frame: baseline, position, rotation, with both kinds of sigma."""
    first, *others = estimate.names
    rows = []
    for name in others:
        pose = estimate.relative(first, name)
        baseline = (pose.baseline, pose.baseline_sigma(), pose.baseline_sigma(by_frame=True))
        rows.append(
            (name, "baseline", *_cells(*baseline), "mm", f"distance of the focal centres of {first} and {name}")
        )
        values, classical, by_frame = _place_and_turn(pose)
        for i, (what, unit, meaning) in enumerate(_ROWS):
            rows.append((name, what, *_cells(values[i], classical[i], by_frame[i]), unit, meaning.format(first, name)))
    return Table(
        f"Rig of {len(estimate.names)} cameras, {len(estimate.frames)} frames; axes are those of {first}",
        ("camera", "", "value", "sigma", "by frames", "unit", "meaning"),
        tuple(rows),
        ("camera", "", "sigma", "unit", "meaning"),
        _notes(estimate),
    )


def cameras_table(estimate: RigEstimate) -> Table:
    """Return internals and lens of each camera with their sigmas, angles in degrees."""
    rows = []
    for parameter in dict.fromkeys(p for name in estimate.names for p in estimate.values(name)):
        if not any(_worth(estimate, c, parameter) for c in range(len(estimate.names))):
            continue
        unit, meaning = MEANING.get(parameter, ("", "lens"))
        cells = [_parameter(estimate, c, parameter) for c in range(len(estimate.names))]
        rows.append((parameter, *cells, unit, meaning))
    return Table(
        "Cameras", ("parameter", *estimate.names, "unit", "meaning"), tuple(rows), ("parameter", "unit", "meaning")
    )


def frames_table(estimate: RigEstimate) -> Table:
    """Return residual and number of points of each camera in each frame; outliers marked."""
    bad, each = estimate.outlier_frames(), estimate.view_residuals
    rows = []
    for j, name in enumerate(estimate.frames):
        seen = [view[j] for view in estimate.views]
        cells = ["-" if v is None else f"{each[c, j]:.3f} ({len(v)})" for c, v in enumerate(seen)]
        rows.append((name, *cells, "outlier" if j in bad else ""))
    last = ("all", *(f"{r:.3f}" for r in estimate.camera_residuals), "")
    columns = ("frame", *(f"{name} px" for name in estimate.names), "")
    return Table("Frames: residual a point (and points)", columns, (*rows, last), ("frame", ""))


def _place_and_turn(pose: RelativePose) -> tuple[Array, Array, Array]:
    """Return X Y Z (mm) and the rotation vector (deg), and their standard deviations, classical and by frames."""
    F, w = pose.b_from_a.origin, so3.log(pose.b_from_a.rotation)
    J = twist_by_local(F)
    J[3:, 3:] = so3.inverse_left_jacobian(w).T  # of R exp(r): the right Jacobian is the left one's transpose
    unit = np.array([1.0, 1.0, 1.0, *np.degrees(np.ones(3))])

    def sigmas(C: Array | None) -> Array:
        return np.full(6, np.nan) if C is None else unit * np.sqrt(np.diag(J @ C @ J.T))

    return unit * np.concatenate([F, w]), sigmas(pose.covariance), sigmas(pose.by_frame)


def _cells(value: float, sigma: float, by_frame: float) -> tuple[str, str, str]:
    shown, sigma_text = with_sigma(float(value), float(sigma))
    return (
        shown,
        f"+- {sigma_text}" if sigma_text else "exact",
        with_sigma(float(value), float(by_frame))[1] if np.isfinite(by_frame) else "",
    )


def _worth(estimate: RigEstimate, c: int, parameter: str) -> bool:
    return bool(estimate.values(estimate.names[c]).get(parameter)) or parameter in estimate.free[c]


def _parameter(estimate: RigEstimate, c: int, parameter: str) -> str:
    name = estimate.names[c]
    if not _worth(estimate, c, parameter):
        return "0" if parameter in estimate.values(name) else "-"
    scale = shown_scale(parameter)
    value, sigma = with_sigma(scale * estimate.values(name)[parameter], scale * estimate.sigma(name, parameter))
    return f"{value} +- {sigma}" if parameter in estimate.free[c] else f"{value} fixed"


def _notes(estimate: RigEstimate) -> tuple[str, ...]:
    noise = ", ".join(f"{s:.3g} px ({name})" for name, s in zip(estimate.names, estimate.noise_px, strict=True))
    notes = [
        f"residual {estimate.residual:.3g} px a point (RMS {estimate.rms_px:.3g} px a coordinate), {estimate.dof} "
        f"degrees of freedom; sigmas for a noise of {noise} a coordinate",
        f"method: {estimate.method}",
    ]
    if estimate.by_frame is None:
        notes.append("no sigmas by frames: there are too few of them")
    else:
        with np.errstate(invalid="ignore"):
            ratio = float(np.nanmedian(np.sqrt(np.diag(estimate.by_frame) / np.diag(estimate.covariance))))
        if ratio > _ROUGHLY:
            notes.append(
                f"the frames scatter {ratio:.2g} times as much as their pixels' noise explains: the errors within a "
                "frame are alike (lens model, board, detector, moments that differ); believe the sigmas by frames"
            )
    names = ", ".join(estimate.frames[j] for j in estimate.outlier_frames())
    if names:
        notes.append(f"warning: much worse than the other frames: {names}; look at them, or leave them out")
    return tuple(notes)


def _left_out(alone: Mapping[str, BoardCalibration]) -> list[Table]:
    rows = [
        (name, Path(found.pictures[i].name).name, why)
        for name, found in alone.items()
        for i, why in sorted(found.left_out.items())
    ]
    columns = ("camera", "picture", "why")
    return [Table("Pictures left out", columns, tuple(rows), columns)] if rows else []
