"""Stations as one HTML file: map of the mechanics, calibrations, measurements; the page loads nothing else."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from typing import Any

import numpy as np

from cadcam import __version__
from cadcam.arrays import Array
from cadcam.report.page import page, section
from cadcam.report.station.tables import calibration_tables, map_tables, trend_table
from cadcam.report.table import Table
from cadcam.station.cross_prediction import DeviationMap
from cadcam.station.drawing import DifferenceTrend
from cadcam.station.gantry import GantryCalibration
from cadcam.whole import utf8, write_whole

_STYLE = """
h1{font-size:1.5rem}.wide{overflow-x:auto}
table{width:auto}th,td{text-align:right;padding:4px 12px 4px 0}.left{text-align:left}
.wide .left:first-child{position:sticky;left:0;background:#fff}
"""
_ARROW_HEAD = (
    '<defs><marker id="tip" viewBox="0 0 6 6" refX="5" refY="3" markerWidth="6" markerHeight="6" orient="auto">'
    '<path d="M0 0L6 3L0 6z" fill="#0072b2"/></marker></defs>'
)
_WIDTH, _HEIGHT, _MARGIN = 900.0, 620.0, 60.0  # px; upper limits
_LATEST = 500  # entries of a log that a page shows
_SIGMAS = 10.0  # magnification of the ellipses of uncertainty relative to the arrows


@dataclass(frozen=True, slots=True, eq=False)
class StationReport:
    """The page's contents: calibrations by camera, entries of a log, and the trend of distances, where available."""

    stations: Mapping[str, GantryCalibration]
    log: Sequence[Mapping[str, Any]] = ()
    trend: DifferenceTrend | None = None


def write_station_page(path: str | os.PathLike[str], report: StationReport) -> None:
    """Write the report, whole or not at all."""
    write_whole(path, utf8(station_page(report)))


def station_page(report: StationReport) -> str:
    """Return the report as one HTML document."""
    maps = {name: s.map() for name, s in report.stations.items() if len(s.positions) > 1}
    cameras = f"camera{'s' * (len(report.stations) != 1)} {', '.join(report.stations)}"
    body = [f"<h1>Stations of {escape(cameras)}</h1>"]
    if maps:
        body.append(section("How the mechanics deviate over the work area", arrows(maps) + _caption(maps)))
    for name, station in report.stations.items():
        tables = calibration_tables(station, named=False)
        if name in maps:
            tables += map_tables([one.name for one in station.positions], maps[name])
        body.append(section(f"Camera {name}", "".join(_table(t) for t in tables)))
    if report.trend is not None:
        body.append(section("Against the drawing", _table(trend_table(report.trend))))
    if report.log:
        body.append(section("Log", _table(_log_table(report.log))))
    body.append(f'<p class="soft">cadcam {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC</p>')
    return page("Stations", _STYLE, body)


def arrows(maps: Mapping[str, DeviationMap]) -> str:
    """Return the deviations of all cameras as arrows on one floor plan, SVG, with ellipses of their uncertainty."""
    places = np.concatenate([m.positions for m in maps.values()])
    low, high = places.min(axis=0), places.max(axis=0)
    extent = np.maximum(high - low, 1.0)
    px = float(min((_WIDTH - 2 * _MARGIN) / extent[0], _HEIGHT / extent[1]))  # px per mm of the floor
    width, height = (px * float(side) + 2 * _MARGIN for side in extent)
    most = max(float(np.linalg.norm(m.deviation, axis=1).max()) for m in maps.values()) or 1.0
    gain = min(0.6 * px * min(_spacing(m.positions) for m in maps.values()), _MARGIN) / most  # px per mm of deviation
    areas, drawn, names = [], [], []
    for name, seen in maps.items():
        q = np.column_stack([(seen.positions[:, 0] - low[0]) * px, (high[1] - seen.positions[:, 1]) * px]) + _MARGIN
        areas.append(_area(q))
        names.append(_name(q, gain * seen.deviation * (1, -1), name))
        drawn += [_arrow(*row, gain) for row in zip(q, seen.deviation, seen.sigma, seen.positions, strict=True)]
    body = "".join([_ARROW_HEAD, *areas, *drawn, *names])  # arrows may leave their area; names are above all of them
    label = "deviations of the mechanics as arrows on the floor plan"
    shape = f'viewBox="0 0 {width:.0f} {height:.0f}" style="max-width:{width:.0f}px"'
    return f'<svg {shape} role="img" aria-label="{label}">{body}</svg>'


def _spacing(positions: Array) -> float:
    """Return the least distance of two positions, mm."""
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    return float(apart[~np.eye(len(positions), dtype=bool)].min())


def _area(q: Array) -> str:
    """Return a camera's area as a rectangle."""
    (x0, y0), (x1, y1) = q.min(axis=0), q.max(axis=0)
    return (
        f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}" fill="#f2f5f8" stroke="#ccd"/>'
    )


def _name(q: Array, arrow: Array, name: str) -> str:
    """Return the name of a camera's area, placed away from the arrows; arrow: from each place q (n, 2)."""
    along = np.linspace(0, 1, 5)[:, None, None]
    taken = (q + along * arrow).reshape(-1, 2)
    x, y = (np.linspace(low, high, 33)[3:-3] for low, high in zip(q.min(axis=0), q.max(axis=0), strict=True))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    room = np.linalg.norm((places[:, None] - taken) / (2.0, 1.0), axis=2).min(axis=1)  # words are wider than high
    x0, y0 = places[int(np.argmax(room))].tolist()
    return _text(x0, y0, f"camera {name}", "middle")


def _caption(maps: Mapping[str, DeviationMap]) -> str:
    """Return the legend of the arrows, their scale, and the location of the areas."""
    most = max(float(np.linalg.norm(m.deviation, axis=1).max()) for m in maps.values())
    areas = []
    for name, seen in maps.items():
        low, high = seen.positions.min(axis=0) / 1000, seen.positions.max(axis=0) / 1000
        areas.append(f"camera {name}: x {low[0]:.1f} to {high[0]:.1f} m, y {low[1]:.1f} to {high[1]:.1f} m")
    said = (
        "Seen from above, x to the right, y up. An arrow leads from where the controller says that the view is to "
        f"where it really is; the longest is {most:.1f} mm. Ellipses at the tips: one sigma, {_SIGMAS:.0f} times as "
        "large. Grey: the calibrated areas."
    )
    return f'<p class="soft">{said}</p><p class="soft">{escape("; ".join(areas))}.</p>'


def _arrow(q: Any, m: Any, sigma: Any, position: Any, gain: float) -> str:
    x, y = float(q[0]), float(q[1])
    tip_x, tip_y = x + gain * float(m[0]), y - gain * float(m[1])
    rx, ry = (max(0.5, _SIGMAS * gain * float(s)) for s in sigma)
    said = f"({position[0]:.0f}, {position[1]:.0f}): {m[0]:+.2f}, {m[1]:+.2f} mm, sigma {sigma[0]:.2f}, {sigma[1]:.2f}"
    return (
        f'<g><title>{said}</title><circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="#222"/>'
        f'<ellipse cx="{tip_x:.1f}" cy="{tip_y:.1f}" rx="{rx:.1f}" ry="{ry:.1f}" fill="#d55e00" fill-opacity="0.25"/>'
        f'<path d="M{x:.1f} {y:.1f}L{tip_x:.1f} {tip_y:.1f}" stroke="#0072b2" stroke-width="2" '
        'marker-end="url(#tip)"/></g>'
    )


def _log_table(log: Sequence[Mapping[str, Any]]) -> Table:
    rows = tuple(
        (
            str(e.get("time", ""))[:19],
            str(e["mark"]),
            str(e.get("camera", "")),
            *(cell for pair in zip(_xy(e["point_mm"]), _xy(e.get("half_width_95_mm")), strict=True) for cell in pair),
        )
        for e in log[-_LATEST:]
    )
    columns = ("time (UTC)", "mark", "camera", "x mm", "+-", "y mm", "+- ")
    latest = f"; the latest {len(rows)}" if len(rows) < len(log) else ""
    note = "+-: half of the 95 % interval"
    return Table(f"{len(log)} measurements{latest}", columns, rows, columns[:3], (note,))


def _xy(value: Any) -> tuple[str, str]:
    return ("", "") if value is None else (f"{value[0]:.2f}", f"{value[1]:.2f}")


def _table(table: Table) -> str:
    """Return a table that scrolls separately on a narrow screen, so that its notes stay in place."""
    kinds = ['class="left"' if column in table.left else "" for column in table.columns]
    head = "".join(f"<th {k}>{_said(c.strip())}</th>" for k, c in zip(kinds, table.columns, strict=True))
    head = f"<thead><tr>{head}</tr></thead>" if table.headed else ""
    rows = "".join(
        "<tr>" + "".join(f"<td {k}>{_said(cell)}</td>" for k, cell in zip(kinds, row, strict=True)) + "</tr>"
        for row in table.rows
    )
    notes = "".join(f'<p class="soft">{_said(note)}</p>' for note in table.notes)
    return f'<h3>{_said(table.title)}</h3><div class="wide"><table>{head}<tbody>{rows}</tbody></table></div>{notes}'


def _said(text: str) -> str:
    """Return the contents of a terminal table as part of a page."""
    return escape(text).replace("+-", "±")


def _text(x: float, y: float, text: str, anchor: str) -> str:
    ink = 'fill="#222" stroke="#fff" stroke-width="4" paint-order="stroke"'  # legible over what it crosses
    return f'<text x="{x:.0f}" y="{y:.0f}" font-size="13" text-anchor="{anchor}" {ink}>{escape(text)}</text>'
