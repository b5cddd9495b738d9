"""A station as tables: calibrated positions, the mechanics' deviations, measurements, and the drawing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.camera.measurement import Measurement
from cadcam.files.text import spreadsheet_rows
from cadcam.report.table import Table, counted, with_sigma
from cadcam.station.astray import Astray, marks_astray
from cadcam.station.budget import budget_of
from cadcam.station.cross_prediction import DeviationMap, Split
from cadcam.station.drawing import DifferenceTrend, DistanceCheck
from cadcam.station.gantry import GantryCalibration, Sighting
from cadcam.station.measure import PointEstimate

_MOST = 20  # distances shown on a terminal
_DISTANCE = ("marks", "measured mm", "+-", "drawn mm", "drawn - measured mm", "angle deg")


def calibration_tables(station: GantryCalibration, *, named: bool = True) -> list[Table]:
    """Return one row for each calibrated position: fit, survey, and the size of a pixel there.

    named: the title names the camera.
    """
    columns = (
        "position",
        "x mm",
        "y mm",
        "marks",
        "residual px",
        "survey rms mm",
        "mm/px x",
        "mm/px y",
        "aspect",
        "skew deg",
    )
    rows = []
    for one in station.positions:
        scale, fit = one.scale, one.estimate
        sigma = np.sqrt(np.diag(scale.covariance))
        cells = [with_sigma(v, s)[0] for v, s in zip((scale.scale_x, scale.scale_y, scale.aspect), sigma, strict=False)]
        skew = with_sigma(float(np.degrees(scale.skew)), float(np.degrees(sigma[3])))[0]
        head = (one.name, f"{one.position[0]:.1f}", f"{one.position[1]:.1f}", str(len(fit.observations)))
        rows.append((*head, f"{fit.thesis_residual:.3f}", f"{one.placement.rms:.3f}", *cells, skew))
    again = station.repeatability.sigma
    notes = [f"noise of one pixel coordinate {station.sigma_px:.3f} px; scales by the Jacobian at the plate"]
    if station.repeatability.covariance.any():
        notes.append(f"repeatability of a visit {again[0]:.3f}, {again[1]:.3f} mm (x, y)")
    else:
        notes.append("repeatability is not stated: what is measured looks surer than it is")
    if station.recalibration is not None:
        notes.append(f"re-calibrated by mark {station.recalibration.sighting.name!r}")
    notes += _astray(marks_astray(station.positions), len(rows))
    title = f"Camera {station.camera}: " * named + counted(len(rows), "calibrated position")
    return [Table(title, columns, tuple(rows), columns[:1], tuple(notes))]


def _astray(found: Sequence[Astray], positions: int) -> list[str]:
    """Return what is said of marks that are not where the others have them; of many, what they may have in common."""
    if len(found) > max(1, positions / 2):
        worst = max(found, key=lambda one: one.off_px)
        return [
            f"marks are off in {len(found)} of {positions} positions, by up to {worst.off_px:.2f} px where "
            f"{worst.expected_px:.2g} px are expected, and no sigma contains it: distortion (--camera), the plate's "
            "sigma_mm, or the noise (--sigma)"
        ]
    return [
        f"{one.position}: mark {' or '.join(map(repr, (one.mark, *one.rivals)))} is {one.off_px:.2f} px from where the "
        f"others have it, where {one.expected_px:.2g} px are expected, and no sigma contains it: is it that mark, "
        "found well? Else leave it out"
        for one in found
    ]


def map_tables(names: Sequence[str], deviations: DeviationMap) -> list[Table]:
    """Return the mechanics' deviations at each position, and the shares of mechanics and vision in what is observed."""
    columns = ("position", "x mm", "y mm", "deviation x mm", "sigma mm", "deviation y mm", "sigma mm ")
    rows = tuple(
        (name, f"{p[0]:.1f}", f"{p[1]:.1f}", f"{m[0]:+.3f}", f"{s[0]:.3f}", f"{m[1]:+.3f}", f"{s[1]:.3f}")
        for name, p, m, s in zip(names, deviations.positions, deviations.deviation, deviations.sigma, strict=True)
    )
    about = "the mean of all" if deviations.reference is None else f"position {names[deviations.reference]}"
    note = f"where the view really is, less where the controller says, relative to {about}; sigma: survey and vision"
    return [Table("Deviation of the mechanics", columns, rows, columns[:1], (note,)), split_table(deviations)]


def split_table(deviations: DeviationMap) -> Table:
    """Return the shares of mechanics and vision in the cross-predictions (Table 6.10)."""
    split = deviations.split
    m, seen, predicted = split.mechanics, deviations.vision, deviations.predicted
    rows = (
        ("mechanics, standard deviation over the positions, mm", f"{m[:, 0].std():.2f}", f"{m[:, 1].std():.2f}"),
        ("mechanics, largest difference in the axis, mm", f"{np.ptp(m[:, 0]):.2f}", f"{np.ptp(m[:, 1]):.2f}"),
        ("vision, rms error of a single mark, mm", f"{seen[0]:.3f}", f"{seen[1]:.3f}"),
        ("   foretold by pixels, survey and plate, mm", f"{predicted[0]:.3f}", f"{predicted[1]:.3f}"),
        ("vision, by d_ij + d_ji of the plate's mean, mm", f"{split.vision[0]:.3f}", f"{split.vision[1]:.3f}"),
        ("left over by m_i - m_j, rms, mm", f"{split.closure[0]:.3f}", f"{split.closure[1]:.3f}"),
    )
    worst = f"the worst two positions differ by {split.worst:.2f} mm; {split.pairs} pairs of positions"
    return Table("Mechanics and vision, told apart", ("", "x", "y"), rows, ("",), (worst,))


def pairs_table(names: Sequence[str], split: Split) -> Table:
    """Return all cross-predictions as in Table 6.11: the row's calibration, applied at the column's position."""
    rows = tuple(
        (name, *("" if i == j else f"{x:+.1f},{y:+.1f}" for j, (x, y) in enumerate(split.deviations[i].tolist())))
        for i, name in enumerate(names)
    )
    return Table("Every calibration at every position, x,y mm", ("", *names), rows, ("",))


def sighting_tables(measured: Measurement, sightings: Sequence[Sighting]) -> list[Table]:
    """Return the positions of the marks, and the contributions to their uncertainty."""
    half = measured.half_width()
    columns = ("mark", "camera", "x mm", "+-", "y mm", "+- ")
    rows = tuple(
        (s.name, s.camera, f"{p[0]:.2f}", f"{h[0]:.2f}", f"{p[1]:.2f}", f"{h[1]:.2f}")
        for s, p, h in zip(sightings, measured.points, half, strict=True)
    )
    points = Table("Measured marks", columns, rows, columns[:2], (f"+-: half of the 95 % interval; {measured.method}",))
    budgets = {s.name: budget_of(measured, s.name) for s in sightings}
    causes = list(dict.fromkeys(cause for b in budgets.values() for cause in b.contributions))
    shares = tuple(
        (name, *(f"{b.contributions.get(cause, 0.0):.3f}" for cause in causes), f"{b.total:.3f}")
        for name, b in budgets.items()
    )
    note = "standard deviations in mm in each point's worst direction on the floor"
    return [points, Table("What the uncertainty comes from", ("mark", *causes, "total"), shares, ("mark",), (note,))]


def estimates_table(name: str, found: Sequence[PointEstimate]) -> Table:
    """Return each calibration's result for one mark and its weight, in the form of program bilinear (Prog 6)."""
    rows = tuple(
        (
            e.name,
            f"({e.position[0]:.1f}, {e.position[1]:.1f})",
            f"({e.point[0]:.1f}, {e.point[1]:.1f})",
            *(f"{w:+.3f}" for w in e.weight),
        )
        for e in found
    )
    return Table(
        f"Mark {name}: estimates of the calibrations",
        ("calibration", "position mm", "estimate mm", "weight x", "weight y"),
        rows,
        ("calibration",),
    )


def distance_tables(checks: Sequence[DistanceCheck], seen: DifferenceTrend | None) -> list[Table]:
    """Return distances and angles against the drawing (Table 6.12), and the statistics of their differences.

    Of many distances only those are shown that differ most relative to their uncertainty.
    """
    shown = checks
    notes = ["+-: half of the 95 % interval"]
    if len(checks) > _MOST:
        shown = sorted(checks, key=lambda c: -abs(c.difference) / max(c.half_width, 1e-9))[:_MOST]
        notes.append(
            f"shown: the {_MOST} of {len(checks)} that differ most for their uncertainty; all of them: --csv FILE"
        )
    rows = tuple(
        (
            f"{c.one} - {c.other}",
            f"{c.measured:.2f}",
            f"{c.half_width:.2f}",
            f"{c.drawn:.2f}",
            f"{c.difference:+.2f}",
            f"{np.degrees(c.angle):+.3f}",
        )
        for c in shown
    )
    out = [Table("Distances against the drawing", _DISTANCE, rows, _DISTANCE[:1], tuple(notes))]
    return out if seen is None else [*out, trend_table(seen)]


def distances_csv(checks: Sequence[DistanceCheck]) -> str:
    """Return all distances against the drawing as a table for spreadsheets, units in its header."""
    columns = ("mark", "other", "measured_mm", "half_width_95_mm", "drawn_mm", "drawn_less_measured_mm", "angle_deg")
    rows: list[Sequence[object]] = [columns]
    for c in checks:
        numbers = (c.measured, c.half_width, c.drawn, c.difference, float(np.degrees(c.angle)))
        rows.append((c.one, c.other, *(f"{x:.6f}" for x in numbers)))
    return spreadsheet_rows(rows)


def trend_table(seen: DifferenceTrend) -> Table:
    """Return the statistics of differences."""
    rows = (
        ("mean", f"{seen.mean:+.2f} +- {seen.standard_error:.2f} mm (t = {seen.t:.2f}, p = {seen.p_mean:.2g})"),
        ("standard deviation", f"{seen.sd:.2f} mm"),
        ("mean amount", f"{seen.mean_abs:.2f} mm"),
        ("by length", f"{seen.slope:+.3f} +- {seen.slope_sigma:.3f} mm/m (r = {seen.correlation:+.3f})"),
    )
    return Table(
        f"{seen.n} differences together, of distances that share no mark",
        ("", ""),
        rows,
        ("",),
        (seen.verdict, "+-: one standard deviation"),
    )


def map_as_json(camera: str, names: Sequence[str], deviations: DeviationMap) -> dict[str, Any]:
    """Return a deviation map as JSON."""
    s = deviations.split
    return {
        "camera": camera,
        "reference": None if deviations.reference is None else names[deviations.reference],
        "positions": [
            {"name": n, "position_mm": p.tolist(), "deviation_mm": m.tolist(), "sigma_mm": e.tolist()}
            for n, p, m, e in zip(names, deviations.positions, deviations.deviation, deviations.sigma, strict=True)
        ],
        "vision_mm": deviations.vision.tolist(),
        "vision_predicted_mm": deviations.predicted.tolist(),
        "vision_by_pairs_mm": s.vision.tolist(),
        "worst_difference_mm": s.worst,
        "cross_predictions_mm": s.deviations.tolist(),
    }
