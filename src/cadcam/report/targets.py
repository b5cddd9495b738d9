"""Found marks as tables, CSV and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cadcam.files.text import spreadsheet_rows
from cadcam.report.table import Table
from cadcam.target.marks.find import FoundMark

_COLUMNS = (
    *("picture", "id", "x_px", "y_px", "sigma_x_px", "sigma_y_px", "covariance_xy_px2", "radius_px"),
    *("angle_deg", "number", "score", "contrast", "blur_px", "flags", "method"),
)


def marks_table(title: str, marks: Sequence[FoundMark]) -> Table:
    """Return one picture's marks as a table."""
    rows = []
    for i, one in enumerate(marks):
        angle = "" if one.angle is None else f"{math.degrees(one.angle):.2f}"
        sigma = [f"{s:.4f}" if np.isfinite(s) else "-" for s in one.sigma]
        number = "" if one.number is None else str(one.number)
        x, y = (f"{v:.3f}" for v in one.pixel)
        tail = (f"{one.size:.2f}", angle, number, f"{one.score:.4f}", " ".join(one.flags))
        rows.append((str(i + 1), x, y, *sigma, *tail))
    columns = ("mark", "x px", "y px", "sigma x px", "sigma y px", "radius px", "angle deg", "number", "score", "flags")
    return Table(title, columns, tuple(rows), left=("flags",))


def marks_csv(found: Mapping[str, Sequence[FoundMark]]) -> str:
    """Return all marks of all pictures, one line each."""
    lines: list[Sequence[object]] = [_COLUMNS]
    for file, marks in found.items():
        for i, one in enumerate(marks):
            place = [f"{v:.5f}" for v in one.pixel]
            spread = [f"{v:.6g}" for v in (*one.sigma.tolist(), float(one.covariance[0, 1]), one.size)]
            angle = "" if one.angle is None else f"{math.degrees(one.angle):.5f}"
            number = "" if one.number is None else str(one.number)
            quality = [f"{one.score:.5f}", f"{one.contrast:.5f}", f"{one.blur:.4f}"]
            flags = " ".join(flag.replace(" ", "-") for flag in one.flags)
            lines.append([file, i + 1, *place, *spread, angle, number, *quality, flags, one.method])
    return spreadsheet_rows(lines)


def marks_as_json(mark: str, found: Mapping[str, Sequence[FoundMark]]) -> dict[str, Any]:
    """Return all marks of all pictures as one document."""
    return {
        "mark": mark,
        "pictures": [{"picture": file, "marks": [_as_json(one) for one in marks]} for file, marks in found.items()],
    }


def _as_json(one: FoundMark) -> dict[str, Any]:
    finite = bool(np.isfinite(one.covariance).all())
    return {
        "q": one.pixel.tolist(),
        "covariance": one.covariance.tolist() if finite else None,
        "size_px": one.size,
        "image_from_mark": one.image_from_mark.tolist(),
        "angle_deg": None if one.angle is None else math.degrees(one.angle),
        "number": one.number,
        "score": one.score,
        "contrast": one.contrast,
        "blur_px": one.blur,
        "flags": list(one.flags),
        "method": one.method,
        "camera_from_mark": None if one.pose is None else one.pose.matrix.tolist(),
    }
