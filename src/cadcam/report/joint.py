"""A joint calibration as tables: shared parameters with both kinds of sigma, the views, and what to do next."""

from __future__ import annotations

import numpy as np

from cadcam.calibrate.joint.nested import Advice
from cadcam.camera.extended_pinhole import INTERNALS
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.report.camera import MEANING, camera_table, shown_scale
from cadcam.report.table import Table, with_sigma

_BEND = {"bend_x": ("mm", "bow of the board along x"), "bend_y": ("mm", "along y")}
_ROUGHLY = 1.5  # ratio of the views' scatter to the classical sigma above which it is mentioned
_NOT_FEW = 8  # views


def joint_tables(estimate: JointEstimate, advice: Advice | None = None) -> list[Table]:
    """Return parameters, K, views and, if requested, the advice of nested models."""
    tables = [parameter_table(estimate), camera_table(estimate.camera), view_table(estimate)]
    return tables if advice is None else [*tables, advice_table(advice)]


def parameter_table(estimate: JointEstimate) -> Table:
    """Return the shared parameters with their sigmas, angles in degrees."""
    rows = []
    for name, value in estimate.parameters.items():
        if name not in INTERNALS and name not in estimate.free and not value:
            continue
        unit, meaning = MEANING.get(name, _BEND.get(name, ("", "lens")))
        scale = shown_scale(name)
        shown, sigma = with_sigma(scale * value, scale * estimate.sigma(name))
        by_view = estimate.sigma(name, by_view=True)
        other = with_sigma(scale * value, scale * by_view)[1] if name in estimate.free and np.isfinite(by_view) else ""
        rows.append((name, shown, f"+- {sigma}" if name in estimate.free else "fixed", other, unit, meaning))
    points = sum(len(v) for v in estimate.views)
    return Table(
        f"Camera of {len(estimate.views)} views, {points} points",
        ("parameter", "value", "sigma", "by views", "unit", "meaning"),
        tuple(rows),
        ("parameter", "unit", "meaning", "sigma"),
        _notes(estimate),
    )


def view_table(estimate: JointEstimate) -> Table:
    """Return every view: points, residual, the camera's position; outliers marked."""
    bad = estimate.outlier_views()
    rows = []
    for j, (name, view) in enumerate(zip(estimate.names, estimate.views, strict=True)):
        F, sd = estimate.pose(j).origin, np.sqrt(np.diag(estimate.pose_covariance[j]))[:3]
        place = [" +- ".join(with_sigma(float(f), float(s))) for f, s in zip(F, sd, strict=True)]
        mark = "outlier" if j in bad else ""
        rows.append((name, str(len(view)), f"{estimate.view_residuals[j]:.3f}", *place, mark))
    columns = ("view", "points", "residual px", "X mm", "Y mm", "Z mm", "")
    return Table("Views: residual a point, and where the focal centre was", columns, tuple(rows), ("view", ""))


def advice_table(advice: Advice) -> Table:
    """Return the results of nested models for each parameter, and the recommendation."""
    rows = []
    for q in advice.questions:
        held = [f"{e:.4g}" if np.isfinite(e) else "" for e in (q.held_out_without, q.held_out_with)]
        by_view = "" if np.isnan(q.chance_by_view) else _chance(q.chance_by_view)
        verdict = {(1, 1): "keep", (1, 0): "hold", (0, 1): "free", (0, 0): "leave"}[q.included, q.needed]
        name = " ".join(q.names)
        rows.append((name, "free" if q.included else "held", _chance(q.chance), by_view, *held, verdict))
    columns = ("parameter", "now", "chance", "by views", "left out: without", "with", "advice")
    notes = (
        "chance: of so much improvement if the parameter were not needed, by the F-test, which takes every pixel for",
        "an independent measurement, and by the scatter between views, which does not; left out: error (px) on views",
        "that the internals were estimated without",
        f"recommended: {advice.recommendation}",
    )
    return Table("Which parameters the views show", columns, tuple(rows), ("parameter", "now", "advice"), notes)


def _notes(estimate: JointEstimate) -> tuple[str, ...]:
    notes = [
        f"residual {estimate.residual:.3g} px a point (RMS {estimate.rms_px:.3g} px a coordinate), "
        f"{estimate.dof} degrees of freedom; sigmas for a noise of {estimate.noise_px:.3g} px a coordinate",
        f"method: {estimate.method}",
    ]
    ratio = _scatter(estimate)
    if estimate.by_view is None:
        notes.append("no sigmas by views: there are too few of them")
    elif len(estimate.views) < _NOT_FEW:
        notes.append(f"with {len(estimate.views)} views the sigmas by views are themselves rough")
    elif ratio > _ROUGHLY:
        notes.append(
            f"the views scatter {ratio:.2g} times as much as their pixels' noise explains: the errors within a view "
            "are alike (model, board or detector); believe the sigmas by views"
        )
    names = ", ".join(estimate.names[j] for j in estimate.outlier_views())
    if names:
        notes.append(f"warning: much worse than the other views: {names}; look at them, or leave them out")
    return tuple(notes)


def _chance(p: float) -> str:
    return f"{p:.2g}" if p >= 1e-12 else "< 1e-12"


def _scatter(estimate: JointEstimate) -> float:
    """Return the median ratio of the sigmas by views to the classical ones."""
    if estimate.by_view is None:
        return float("nan")
    return float(np.median(np.sqrt(np.diag(estimate.by_view) / np.diag(estimate.covariance))))
