"""Pixels files: the pixels of points by viewpoint, one per line; and the output of measured points.

    # anything behind a hash is a comment
    name, view,  x_px,  y_px
    A,    left,  356.0, 367.2
    A,    right, 369.8, 360.0

Columns as in a points file: x_px y_px (column, row) or U V (row, column); name (or id, point, label) of the point, view
(or camera) that saw it; all others are ignored. A point that a viewpoint did not see has no line for it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.camera.measurement import Measurement
from cadcam.errors import UnreadableFile
from cadcam.files.jsontext import as_json, or_null
from cadcam.files.points import NAME_COLUMNS, header_line, pixel_columns
from cadcam.files.text import TextFile, check_cells, lines_of_cells, number_in, read_text, rows_of_cells
from cadcam.kinds import expect, expect_flag, expect_path
from cadcam.whole import write_whole

_VIEWS = ("view", "camera", "viewpoint")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ListedPixels(Brief):
    """Points' and viewpoints' names in the order of the file, pixels q (V, N, 2), NaN where not seen."""

    names: tuple[str, ...]
    views: tuple[str, ...]
    q: Array
    source: str
    sha256: str


def read_pixels(path: str | os.PathLike[str], *, columns: Sequence[str] | None = None) -> ListedPixels:
    """Return the contents of a pixels file (layout: see this module); columns: the two image columns among several.

    Raises `UnreadableFile` naming file, line, column, value and remedy.
    """
    file = read_text(path)
    lines = list(lines_of_cells(file))
    header = header_line(file, lines)
    x, y = pixel_columns(file, header, columns)
    name, view = _column(file, header, NAME_COLUMNS, "the point"), _column(file, header, _VIEWS, "the view that saw it")
    if len(lines) < 2:
        raise UnreadableFile(path, "has a header but no pixels", "add one line for each point that a view saw")
    seen: dict[tuple[str, str], tuple[int, list[float]]] = {}
    for line in lines[1:]:
        check_cells(file, line, header)
        key = line.cells[name], line.cells[view]
        if not all(key):
            raise UnreadableFile(path, f"line {line.number} names no point or no view", "name both on every line")
        if key in seen:
            what = f"line {line.number} gives point {key[0]!r} in view {key[1]!r} again, after line {seen[key][0]}"
            raise UnreadableFile(path, what, "remove one of them")
        seen[key] = line.number, [number_in(file, line.number, f"column {header[i]}", line.cells[i]) for i in (x, y)]
    names, views = (tuple(dict.fromkeys(key[k] for key in seen)) for k in (0, 1))
    place, row = ({name: i for i, name in enumerate(of)} for of in (names, views))
    q = np.full((len(views), len(names), 2), np.nan)
    for (n, v), (_, pixel) in seen.items():
        q[row[v], place[n]] = pixel
    return ListedPixels(names, views, q, file.path, file.sha256)


def _column(file: TextFile, header: tuple[str, ...], known: tuple[str, ...], what: str) -> int:
    lower = [h.lower() for h in header]
    found = [lower.index(n) for n in known if n in lower]
    if not found:
        raise UnreadableFile(
            file.path, f"has no column for {what} (columns: {', '.join(header)})", f"name one {' or '.join(known)}"
        )
    return found[0]


def write_measurement(
    path: str | os.PathLike[str], measured: Measurement, *, pixels: ListedPixels | None = None, joint: bool = False
) -> None:
    """Write measured points whole or not at all: .json with covariances, anything else as CSV.

    joint: adds the covariance of all points together to the JSON. The CSV has name, X_mm, Y_mm, Z_mm, their sigmas, and
    gap, angle, chi-square and views.
    """
    expect_path(path)
    expect(measured, "measured", Measurement)
    expect_flag(joint, "joint")
    if os.fspath(path).lower().endswith(".json"):
        write_whole(path, as_json(measurement_as_json(measured, pixels=pixels, joint=joint)))
        return
    header = ("name", "X_mm", "Y_mm", "Z_mm", "sigma_X_mm", "sigma_Y_mm", "sigma_Z_mm", *_QUALITY, "views")
    rows = []
    quality = np.column_stack([measured.gap, measured.gap_sigma, np.degrees(measured.angle), measured.chi2])
    values = zip(measured.names, measured.points, measured.sigma, quality, measured.dof, measured.seen_by, strict=True)
    for name, p, s, four, dof, views in values:
        numbers = ["" if np.isnan(v) else repr(float(v)) for v in (*p, *s, *four)]
        rows.append([name, *numbers, str(int(dof)), " ".join(views)])
    write_whole(path, rows_of_cells(header, rows))


_QUALITY = ("gap_mm", "gap_sigma_mm", "angle_deg", "chi2", "dof")


def measurement_as_json(
    measured: Measurement, *, pixels: ListedPixels | None = None, joint: bool = False
) -> dict[str, Any]:
    """Return the points, each with covariance, budget and misfit, and the source of their pixels.

    joint: with the covariance of all points together, 9 N^2 numbers.
    """
    covariance, p_value, budget = measured.covariance, measured.p_value, measured.budget()
    half_width = measured.half_width()
    points = [
        {
            "name": name,
            "p_world_mm": measured.points[i].tolist(),
            "sigma_mm": measured.sigma[i].tolist(),
            "half_width_95_mm": half_width[i].tolist(),
            "covariance_mm2": covariance[i].tolist(),
            "sigma_by_cause_mm": {cause: sigma[i].tolist() for cause, sigma in budget.items()},
            "views": list(measured.seen_by[i]),
            "gap_mm": or_null(measured.gap[i]),
            "gap_sigma_mm": or_null(measured.gap_sigma[i]),
            "angle_deg": or_null(np.degrees(measured.angle[i])),
            "chi2": float(measured.chi2[i]),
            "degrees_of_freedom": int(measured.dof[i]),
            "p_value": or_null(p_value[i]),
        }
        for i, name in enumerate(measured.names)
    ]
    out: dict[str, Any] = {"format": "cadcam measurement", "version": 1, "method": measured.method}
    if pixels is not None:
        out["pixels"] = {"source": pixels.source, "sha256": pixels.sha256}
    together = {"joint_covariance_mm2": measured.joint_covariance().tolist()} if joint and len(measured) else {}
    return out | {"points": points, **together, "refused": dict(measured.refused)}
