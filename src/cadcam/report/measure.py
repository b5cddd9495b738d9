"""Measured points as tables: where, how well, by what, and whether their rays agree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.camera.measurement import Measurement
from cadcam.camera.viewpoint import Viewpoint
from cadcam.report.table import Table, with_sigma

SUSPECT = 1e-3  # a misfit less probable than this is marked


def measurement_tables(
    measured: Measurement, viewpoints: Sequence[Viewpoint], distances: Sequence[tuple[str, str]] = ()
) -> list[Table]:
    """Return points, distances, what the uncertainty consists of, and what was refused."""
    tables = [points_table(measured), budget_table(measured, viewpoints)]
    if distances:
        tables.insert(1, distance_table(measured, distances))
    if measured.refused:
        rows = tuple(measured.refused.items())
        tables.append(Table("Not measured", ("point", "why"), rows, ("point", "why")))
    return tables


def points_table(measured: Measurement) -> Table:
    """Return X, Y, Z with sigmas, the rays' gap in sigmas, their angle and who saw the point; misfits marked."""
    p_value = measured.p_value
    rows = []
    for i, name in enumerate(measured.names):
        cells = [c for p, s in zip(measured.points[i], measured.sigma[i], strict=True) for c in with_sigma(p, s)]
        cells[1::2] = [f"+- {c}" if c else "exact" for c in cells[1::2]]
        gap, sigma, angle = measured.gap[i], measured.gap_sigma[i], measured.angle[i]
        seen = [f"{gap:.2g}", f"{gap / sigma:.1f}", f"{np.degrees(angle):.1f}"] if np.isfinite(gap) else ["", "", ""]
        chance = f"{p_value[i]:.2g}" if measured.dof[i] > 0 else ""
        mark = "does not fit" if p_value[i] < SUSPECT else ""
        rows.append((name, *cells, *seen, chance, " ".join(measured.seen_by[i]), mark))
    heads = ("point", "X", "sigma X", "Y", "sigma Y", "Z", "sigma Z", "gap", "gap/sigma", "angle", "p", "views", "")
    return Table(
        f"{len(measured)} points, mm ({measured.method})",
        heads,
        tuple(rows),
        ("point", "sigma X", "sigma Y", "sigma Z", "views", ""),
        _notes(measured),
    )


def _notes(measured: Measurement) -> tuple[str, ...]:
    notes = []
    if np.isfinite(measured.gap).any():
        notes.append("gap: the largest shortest distance between two rays; angle: the largest between two rays, deg")
        notes.append("p: how likely chance alone makes a point fit as badly as this")
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
    """Return distances with sigmas that know what both points have in common, beside those of independent points."""
    rows = []
    for one, other in pairs:
        length = measured.distance(one, other)
        along = (measured.point(other) - measured.point(one)) / length.value
        apart = [measured.covariance[measured.names.index(n)] for n in (one, other)]
        alone = float(np.sqrt(along @ (apart[0] + apart[1]) @ along))
        shown, sigma = with_sigma(length.value, length.sigma)
        rows.append((one, other, shown, f"+- {sigma}", f"+- {length.half_width:.2g}", f"{alone:.2g}"))
    note = "sigma knows what the errors of both points have in common; the last column does not"
    heads = ("from", "to", "distance", "sigma", "95 %", "if independent")
    return Table("Distances, mm", heads, tuple(rows), ("from", "to", "sigma", "95 %"), (note,))


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
