"""A calibration from pictures of a board as tables: the camera, the outcome for each picture, coverage, next views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.calibrate.boards.coverage import BoardCoverage
from cadcam.calibrate.boards.next_view import NextView
from cadcam.calibrate.boards.pictures import BoardCalibration
from cadcam.calibrate.joint.nested import Advice
from cadcam.files.joint import joint_as_json
from cadcam.files.jsontext import or_nulls
from cadcam.files.matrix import pose_as_json
from cadcam.report.camera import camera_table
from cadcam.report.joint import advice_table, parameter_table
from cadcam.report.table import Table

_MODEL = 3.0  # ratio of residuals to predicted noise above which they are mentioned
_GOOD_GAIN = 0.9  # of the worst sigma: a view that leaves more is not worth taking


def board_tables(
    calibration: BoardCalibration, seen: BoardCoverage, views: Sequence[NextView], nested: Advice | None = None
) -> list[Table]:
    """Return all tables of a calibration from pictures of a board; `nested`: which parameters the views need."""
    tables = [
        camera_of_board_table(calibration),
        camera_table(calibration.estimate.camera),
        pictures_table(calibration),
        coverage_table(seen),
    ]
    tables += [] if nested is None else [advice_table(nested)]
    return [*tables, next_view_table(seen, views)]


def camera_of_board_table(calibration: BoardCalibration) -> Table:
    """Return the shared parameters with their standard deviations, and notes on the board."""
    table = parameter_table(calibration.estimate)
    used, all_pictures = len(calibration.used), len(calibration.pictures)
    title = f"{table.title} in {used} of {all_pictures} pictures of {calibration.pattern}"
    return replace(table, title=title, notes=(*table.notes, *_board_notes(calibration)))


def _board_notes(calibration: BoardCalibration) -> list[str]:
    notes = []
    estimate = calibration.estimate
    predicted = float(np.median([calibration.detection(j).sigma_px for j in range(len(estimate.views))]))
    if predicted > 0 and estimate.rms_px > _MODEL * predicted:
        notes.append(
            f"the residuals are {estimate.rms_px / predicted:.1f} times what the grey values about each point predict: "
            "it is not noise but the model that is short. The board may not be flat or true (--bend, or a stiffer one) "
            "or the lens may need more terms (--lens brown-conrady:k1,k2,p1,p2,k3)"
        )
    turns = calibration.pattern.turns
    if turns > 1:
        notes.append(
            f"{turns} turns of this board look the same: its x axis is taken as the one that points most to the right. "
            "The camera does not care; poses of the board may (hand-eye, several cameras): there use a chessboard with "
            "one side even and one odd, or a ChArUco board"
        )
    if calibration.radius_mm is not None:
        notes.append(
            f"discs of {2 * calibration.radius_mm:.4g} mm: the centre of a disc's picture is not the picture of its "
            "centre; the difference was computed and taken off"
        )
    return notes


def pictures_table(calibration: BoardCalibration) -> Table:
    """Return the outcome for each picture."""
    view = {i: j for j, i in enumerate(calibration.used)}
    rows = []
    for i, picture in enumerate(calibration.pictures):
        name = Path(picture.name).name
        if i in view:
            rows.append((name, *_used_cells(calibration, view[i])))
        else:
            rows.append((name, "", "", "", "", "", f"LEFT OUT: {calibration.left_out.get(i, picture.problem)}"))
    return Table(
        "Pictures",
        ("picture", "points", "residual px", "fit says px", "distance mm", "tilt deg", "found by"),
        tuple(rows),
        ("picture", "found by"),
        (
            "residual: root mean square distance of a point from where the calibrated camera sees it; fit says: the "
            "same as predicted by the grey values about each point alone",
            "left out by rule: points beyond six robust sigmas and 0.3 px; pictures whose residual is twice the median "
            "and more than chance allows (1 in 1000); --keep-all keeps them",
        ),
    )


def _used_cells(calibration: BoardCalibration, view: int) -> tuple[str, ...]:
    """Return the cells of a picture that the calibration uses, after its name; view: its number among these."""
    estimate, found, strays = calibration.estimate, calibration.detection(view), calibration.dropped[view]
    return (
        f"{len(estimate.views[view])}/{len(calibration.pattern.cells)}",
        f"{estimate.view_residuals[view]:.3f}",
        f"{found.sigma_px * np.sqrt(2):.3f}",
        f"{calibration.distance_mm[view]:.4g}",
        f"{calibration.tilt_deg[view]:.0f}",
        found.detector + (f", {strays} strays left out" if strays else ""),
    )


def coverage_table(seen: BoardCoverage) -> Table:
    """Return the number of points in each part of the picture, and its uncertainty."""
    columns = tuple(f"{k + 1}" for k in range(seen.counts.shape[1]))
    rows = [
        tuple(_cell(int(n), s) for n, s in zip(counts, sigmas, strict=True))
        for counts, sigmas in zip(seen.counts.tolist(), seen.sigma_px.tolist(), strict=True)
    ]
    tilt = ", ".join(
        f"{low:.0f} to {high:.0f} deg {word}"
        for low, high, word in zip(seen.tilt_deg.min(0), seen.tilt_deg.max(0), ("sideways", "up and down"), strict=True)
    )
    distance = f"{seen.distance_mm.min():.4g} to {seen.distance_mm.max():.4g} mm"
    blind = ("without a sigma: the lens images nothing there",) if np.isnan(seen.sigma_px).any() else ()
    return Table(
        "Coverage: points in each part of the picture (and sigma of a direction there, px)",
        columns,
        tuple(rows),
        (),
        (f"tilts {tilt}; distances {distance}", *blind, *(f"missing: {doubt}" for doubt in seen.doubts())),
    )


def _cell(points: int, sigma_px: float) -> str:
    """Return a cell of the coverage; without a sigma where the lens images nothing."""
    return (f"{points}" if points else "-") + (f" ({sigma_px:.2f})" if np.isfinite(sigma_px) else "")


def next_view_table(seen: BoardCoverage, views: Sequence[NextView]) -> Table:
    """Return the pictures to take next, in words."""
    useful = [a for a in views if a.after_px < _GOOD_GAIN * a.before_px]
    rows = tuple((str(k + 1), a.words(), f"{a.before_px:.3f} -> {a.after_px:.3f}") for k, a in enumerate(useful))
    note = (
        "worst sigma: of a direction, anywhere in the picture, as the noise found would have it; poses were tried and "
        "the one that lowers it most is named"
    )
    if not rows:
        rows = (("", "no single further picture lowers the worst sigma by a tenth", f"{np.nanmax(seen.sigma_px):.3f}"),)
    return Table("Take next", ("", "picture", "worst sigma px"), rows, ("picture",), (note,))


def boards_as_json(calibration: BoardCalibration, seen: BoardCoverage, views: Sequence[NextView]) -> dict[str, Any]:
    """Return the same as one JSON document."""
    return joint_as_json(calibration.estimate) | {
        "board": str(calibration.pattern),
        "pictures": [_picture_json(calibration, i) for i in range(len(calibration.pictures))],
        "coverage": {
            "points": seen.counts.astype(int).tolist(),
            "direction_sigma_px": [or_nulls(row) for row in seen.sigma_px],
            "missing": seen.doubts(),
        },
        "take_next": [
            {
                "words": a.words(),
                "worst_sigma_px": [a.before_px, a.after_px],
                "camera_from_board": pose_as_json(a.camera_from_board),
            }
            for a in views
        ],
    }


def _picture_json(calibration: BoardCalibration, i: int) -> dict[str, Any]:
    picture = calibration.pictures[i]
    out: dict[str, Any] = {"file": picture.name, "sha256": picture.sha256, "used": i in calibration.used}
    if i not in calibration.used:
        return out | {"why_not": calibration.left_out.get(i, picture.problem)}
    j = calibration.used.index(i)
    found, estimate = calibration.detection(j), calibration.estimate
    return out | {
        "points": len(estimate.views[j]),
        "left_out_points": calibration.dropped[j],
        "residual_px": float(estimate.view_residuals[j]),
        "fit_sigma_px": found.sigma_px,
        "detector": found.detector,
        "tried": list(found.tried),
        "camera_from_board": pose_as_json(estimate.pose(j)),
    }
