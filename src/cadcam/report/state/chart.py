"""A feature over the parts as a chart: each deviation with its U in the colour of its verdict, between its limits."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from cadcam.kinds import expect, expect_path
from cadcam.record.record import Deviation, Finding, Record
from cadcam.record.trend import Trend
from cadcam.report.chart import INK, LINE, PLAIN, VERDICT_COLORS, Frame, round_ticks, stroke, svg
from cadcam.report.state.tables import deviation_text, when
from cadcam.report.table import spelled
from cadcam.whole import utf8, write_whole

_MOST = 300  # parts in a chart, the latest: more would be less than a pixel each
_FAR = 4.0  # limits beyond so many times what was measured are told in words: the deviations would be one flat line
_LIMIT = "#dcefe6"
_ON_TOP = ("", "PASS", "UNDECIDED", "FAIL")  # what is drawn later hides what is drawn before, where parts are many


def trend_chart(trend: Trend, links: Mapping[str, str]) -> str:
    """Return the chart of a feature, the oldest part on the left; links: addresses of reports, by id of record.

    What could not be measured, and what is there or not, has marks at the bottom.
    """
    shown = trend.judged[-_MOST:]
    values = [(i, one) for i, (_, one) in enumerate(shown) if isinstance(one, Deviation)]
    low, high = _range([d for _, d in values])
    frame = Frame(190.0 if values else 64.0, round_ticks(low, high) if values else (0.0, 1.0))
    body, told = [], ""
    if values:
        areas, lines = _limits(frame, values, len(shown))
        body += [*areas, *frame.level_lines(trend.unit), *lines]
        beyond = _beyond(frame, [d for _, d in values])
        told = f"limit{'s' * (len(beyond) > 1)} {' and '.join(beyond)} {trend.unit}, not shown" if beyond else ""
    for i, (record, one) in sorted(enumerate(shown), key=lambda place: _ON_TOP.index(place[1][1].verdict)):
        mark = _value(frame, _x(frame, i, len(shown)), one) if isinstance(one, Deviation) else ""
        mark = mark or _cross(_x(frame, i, len(shown)), frame.height - 30, _color(one))
        body.append(_linked(mark, _said(record, one), links.get(record.id, "")))
    of = f"the latest {len(shown)} of {len(trend)}" if len(shown) < len(trend) else f"{len(shown)}"
    body += [frame.caption(f"{of} parts, in order of time"), frame.caption(told, line=1)]
    return svg(frame.height + (LINE if told else 0), body, f"{trend.kind} of {spelled(trend.feature)} over the parts")


def write_trend_svg(path: str | os.PathLike[str], trend: Trend) -> None:
    """Write the chart as a picture of its own on white paper, whole or not at all."""
    expect_path(path)
    expect(trend, "trend", Trend)
    drawn = trend_chart(trend, {})
    head, _, body = drawn.partition(">")
    head = head.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" ', 1)
    write_whole(path, utf8(f'{head}><rect width="100%" height="100%" fill="#ffffff"/>{body}\n'))


def _range(values: Sequence[Deviation]) -> tuple[float, float]:
    """Return the range of deviations with their U, 0, and limits that are not far beyond."""
    low = min([0.0, *(d.deviation - (d.expanded_uncertainty if d.deviation < 0 else 0.0) for d in values)])
    high = max([0.0, *(d.deviation + d.expanded_uncertainty for d in values)])
    uppers = [d.upper for d in values if d.upper is not None and d.upper <= _FAR * high]
    lowers = [d.lower for d in values if d.lower is not None and low < 0 and d.lower >= _FAR * low]
    return min([low, *lowers]), max([high, *uppers])


def _x(frame: Frame, i: int, count: int) -> float:
    return frame.left + (frame.right - frame.left) * (i + 0.5) / count


def _limits(frame: Frame, values: Sequence[tuple[int, Deviation]], count: int) -> tuple[list[str], list[str]]:
    """Return the tolerance of each part as an area, and its limits as lines; they may change from one to the next.

    Of parts without a number they are those of the part before.
    """
    half = 0.5 * (frame.right - frame.left) / count
    areas: list[str] = []
    lines: list[str] = []
    edges: dict[tuple[float | None, float | None], list[int]] = {}
    known, last = dict(values), values[0][1]
    for i in range(count):
        last = known.get(i, last)
        edges.setdefault((last.lower, last.upper), []).append(i)
    for (lower, upper), places in edges.items():
        if lower is None and upper is None:
            continue
        low = max(frame.ticks[0] if lower is None else lower, frame.ticks[0])
        high = min(frame.ticks[-1] if upper is None else upper, frame.ticks[-1])
        for run in np.split(np.array(places), np.flatnonzero(np.diff(places) > 1) + 1):
            x0, x1 = _x(frame, int(run[0]), count) - half, _x(frame, int(run[-1]), count) + half
            top, bottom = frame.y(high), frame.y(low)
            place = f'x="{x0:.1f}" y="{top:.1f}" width="{x1 - x0:.1f}" height="{max(bottom - top, 0):.1f}"'
            areas.append(f'<rect {place} fill="{_LIMIT}"/>')
            drawn = [v for v in (lower, upper) if v is not None and frame.ticks[0] < v <= frame.ticks[-1]]
            lines += [stroke(x0, frame.y(v), x1, frame.y(v), INK, 1.5) for v in drawn]
    return areas, lines


def _beyond(frame: Frame, values: Sequence[Deviation]) -> list[str]:
    """Return the outermost limits that lie beyond the chart, the lower one first."""
    lower = [d.lower for d in values if d.lower is not None and d.lower < frame.ticks[0]]
    upper = [d.upper for d in values if d.upper is not None and d.upper > frame.ticks[-1]]
    return [f"{limit:g}" for limit in (*sorted(lower)[:1], *sorted(upper)[-1:])]


def _value(frame: Frame, x: float, d: Deviation) -> str:
    color, U = _color(d), d.expanded_uncertainty
    low, high = np.clip([d.deviation - U, d.deviation + U], frame.ticks[0], frame.ticks[-1])
    bar = stroke(x, frame.y(float(low)), x, frame.y(float(high)), color, 1.5)
    return f'<g opacity="0.4">{bar}</g><circle cx="{x:.1f}" cy="{frame.y(d.deviation):.1f}" r="2.6" fill="{color}"/>'


def _cross(x: float, y: float, color: str) -> str:
    """Return a mark for what has no number: a disc where it is as it should be, else a cross."""
    if color == VERDICT_COLORS["PASS"]:
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.6" fill="{color}"/>'
    return stroke(x - 3, y - 3, x + 3, y + 3, color, 2) + stroke(x - 3, y + 3, x + 3, y - 3, color, 2)


def _color(one: Deviation | Finding) -> str:
    return VERDICT_COLORS.get(one.verdict, PLAIN)


def _said(record: Record, one: Deviation | Finding) -> str:
    what = deviation_text(one).replace("+-", "±") if isinstance(one, Deviation) else one.reason
    return ", ".join(t for t in (spelled(record.serial), f"{when(record)} UTC", what, one.verdict) if t)


def _linked(mark: str, said: str, address: str) -> str:
    group = f"<g>{mark}<title>{escape(said)}</title></g>"
    return f'<a href="{escape(address)}">{group}</a>' if address else group
