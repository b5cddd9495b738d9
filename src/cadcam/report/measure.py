"""Measured points as tables: positions, uncertainty by cause, and the agreement of their rays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.camera.measurement import Measurement
from cadcam.camera.viewpoint import Viewpoint
from cadcam.report.table import Table, counted, with_sigma

SUSPECT = 1e-3  # a misfit less probable than this is marked


def measurement_tables(
    measured: Measurement, viewpoints: Sequence[Viewpoint], distances: Sequence[tuple[str, str]] = ()
) -> list[Table]:
    """Return points, distances, the contributions to the uncertainty, and what was refused."""
    tables = [points_table(measured), budget_table(measured, viewpoints)]
    if np.isfinite(measured.gap).any() or len(viewpoints) > 1:
        tables.insert(1, rays_table(measured))
    if distances:
        tables.insert(1, distance_table(measured, distances))
    if measured.refused:
        rows = tuple(measured.refused.items())
        tables.append(Table("Not measured", ("point", "why"), rows, ("point", "why")))
    return tables


def points_table(measured: Measurement) -> Table:
    """Return X, Y, Z with their sigmas; points whose rays disagree are marked."""
    bad = set(measured.inconsistent(p_below=SUSPECT))
    rows = tuple(
        (
            name,
            *(_plus_minus(v, s) for v, s in zip(measured.points[i], measured.sigma[i], strict=True)),
            "does not fit" if name in bad else "",
        )
        for i, name in enumerate(measured.names)
    )
    title = f"{counted(len(measured), 'point')}, mm +- sigma ({measured.method})"
    return Table(title, ("point", "X", "Y", "Z", ""), rows, ("point", ""), _notes(measured))


def rays_table(measured: Measurement) -> Table:
    """Return the agreement of each point's rays: gap in mm and in sigmas, largest angle, misfit's chance, views."""
    p_value, rows = measured.p_value, []
    for i, name in enumerate(measured.names):
        gap, sigma, angle = measured.gap[i], measured.gap_sigma[i], measured.angle[i]
        seen = (
            [f"{gap:.2g}" if gap < 100 else f"{gap:.0f}", f"{gap / sigma:.1f}", f"{np.degrees(angle):.1f}"]
            if np.isfinite(gap)
            else ["", "", ""]
        )
        chance = f"{p_value[i]:.2g}" if measured.dof[i] > 0 else ""
        rows.append((name, *seen, chance, " ".join(measured.seen_by[i])))
    notes = (
        "gap: the largest shortest distance between two rays; angle: the largest between two rays",
        "p: how likely chance alone makes a point fit as badly as this",
    )
    return Table(
        "Rays", ("point", "gap, mm", "gap/sigma", "angle, deg", "p", "views"), tuple(rows), ("point", "views"), notes
    )


def _plus_minus(value: float, sigma: float) -> str:
    shown, spread = with_sigma(value, sigma)
    return f"{shown} +- {spread}" if spread else f"{round(value, 9) + 0.0:.10g} exact"


def _notes(measured: Measurement) -> tuple[str, ...]:
    notes = []
    if total := int(measured.dof.sum()):
        notes.append(f"misfit of all points: chi-square {measured.chi2.sum():.3g} with {total} degrees of freedom")
    if bad := measured.inconsistent(p_below=SUSPECT):
        some = ", ".join(bad[:5]) + (" ..." if len(bad) > 5 else "")
        notes.append(
            f"warning: {len(bad)} of {len(measured)} points do not fit ({some}): a wrong pixel or name, a camera that "
            "moved, a point off its plane, or more noise than stated"
        )
    return tuple(notes)


def distance_table(measured: Measurement, pairs: Sequence[tuple[str, str]]) -> Table:
    """Return distances with sigmas that account for correlation, beside those of independent points."""
    rows, covariance = [], measured.covariance
    for (one, other), length in zip(pairs, measured.distances(pairs), strict=True):
        along = (measured.point(other) - measured.point(one)) / length.value
        apart = [covariance[measured.names.index(n)] for n in (one, other)]
        alone = float(np.sqrt(along @ (apart[0] + apart[1]) @ along))
        shown = _plus_minus(length.value, length.sigma)
        rows.append((one, other, shown, f"+- {length.half_width:.2g}", f"+- {alone:.2g}"))
    note = "sigma knows what the errors of both points have in common; the last column does not"
    heads = ("from", "to", "distance +- sigma", "95 %", "if independent")
    return Table("Distances, mm", heads, tuple(rows), ("from", "to"), (note,))


def budget_table(measured: Measurement, viewpoints: Sequence[Viewpoint]) -> Table:
    """Return the root mean square over all points of the sigmas by cause, and what was taken as exact."""
    rows = []
    for cause, sigma in [*measured.budget().items(), ("all together", measured.sigma)]:
        rms = np.sqrt(np.mean(sigma**2, axis=0)) if len(measured) else np.zeros(3)
        rows.append((cause, *(f"{v:.2g}" for v in rms)))
    exact = [v.name for v in viewpoints if not v.errors]
    notes = [f"pixel noise: {', '.join(f'{v.name} {v.sigma_px:.2g} px' for v in viewpoints)}"]
    if exact:
        notes.append(f"warning: taken as exact, for their files hold no uncertainty: {', '.join(exact)}")
    return Table(
        "What sigma consists of, mm (RMS of all points)",
        ("cause", "X", "Y", "Z"),
        tuple(rows),
        ("cause",),
        tuple(notes),
    )
