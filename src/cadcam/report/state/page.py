"""Many parts as one HTML page: verdicts on top, what fails, each feature over the parts, every part; it loads nothing.

Made from records alone, whatever measured them: of a store, or of `cadcam inspect` while it goes on.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape

from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_each, expect_path
from cadcam.record.record import Deviation, Finding, Record
from cadcam.record.trend import Trend, standing, trends
from cadcam.report.chart import PLAIN, VERDICT_COLORS
from cadcam.report.page import cards, named, page, row, section
from cadcam.report.state.chart import trend_chart
from cadcam.report.state.tables import (
    FEATURE_HEADS,
    SIGMA_NOTE,
    by_trouble,
    deviation_text,
    drift_words,
    feature_cells,
    unjudged,
    when,
    worst,
)
from cadcam.report.table import counted
from cadcam.whole import utf8, write_whole

_CHARTS, _ROWS = 24, 1000  # at most, of each kind of part: a page of more is neither read nor drawn quickly
_FAILED = 50  # parts that could not be judged, at most
_HELD = "\u00a0"  # a space at which no line is broken
_ORDER = ("FAIL", "UNDECIDED", "PASS", "")
_STYLE = """
svg.plot{max-width:540px}td:last-child{overflow-wrap:anywhere;min-width:9em}
header b{font-size:2.3rem;line-height:1.1}header .soft{color:#fff}header .counts{display:flex;flex-wrap:wrap;gap:0 28px}
.legend i{width:11px;height:11px;border-radius:50%}
"""


def write_state_page(
    path: str | os.PathLike[str],
    records: Sequence[Record],
    *,
    links: Mapping[str, str] | None = None,
    failed: Mapping[str, str] | None = None,
) -> None:
    """Write the page of records, oldest first, whole or not at all.

    links: addresses of reports by id of record; failed: why parts could not be judged, by serial number.
    """
    expect_path(path)
    write_whole(path, utf8(state_page(records, links=links, failed=failed)))


def state_page(
    records: Sequence[Record], *, links: Mapping[str, str] | None = None, failed: Mapping[str, str] | None = None
) -> str:
    """Return the page as one HTML document; see `write_state_page`. Raises `BadValue` without records.

    Each part counts once: earlier records of the same parts are left out (`cadcam.record.trend.standing`).
    """
    records = expect_each(records, "records", Record)
    links, failed = links or {}, failed or {}
    expect(links, "links", Mapping)
    expect(failed, "failed", Mapping)
    if not records:
        raise BadValue("records of a page", "none", "one or more")
    replaced, records = len(records), standing(records)
    replaced -= len(records)
    kinds = dict.fromkeys(record.part for record in records)
    parts = [_head(records, list(kinds), len(failed), replaced), _failed(failed)]
    for kind in kinds:
        of = [record for record in records if record.part == kind]
        title = f" of {kind}" if len(kinds) > 1 else ""
        each = sorted(trends(of), key=by_trouble)
        parts += [
            _to_do(each, of, title),
            _charts(each, links, title),
            _features(each, title),
            _parts(of, links, title),
        ]
    return page(f"{counted(len(records), 'record')}: {', '.join(kinds)}", _STYLE, parts)


def _head(records: Sequence[Record], kinds: Sequence[str], failed: int, replaced: int) -> str:
    verdicts = Counter(record.verdict for record in records)
    most = next(verdict for verdict in _ORDER if verdicts[verdict] or (failed and verdict == "UNDECIDED"))
    counts = "".join(
        f"<span><b>{verdicts[verdict]}</b> {verdict or 'not judged'}</span>" for verdict in _ORDER if verdicts[verdict]
    )
    counts += f"<span><b>{failed}</b> could not be judged</span>" if failed else ""
    stations = ", ".join(dict.fromkeys(r.station for r in records if r.station))
    first, last = when(records[0]), when(records[-1])
    between = f"{first} to {last} UTC" if first != last else f"{first} UTC"
    earlier = f"{counted(replaced, 'earlier record')} of the same parts left out" if replaced else ""
    said = " · ".join(filter(None, (stations, between, earlier)))
    return (
        f'<header style="background:{VERDICT_COLORS.get(most, PLAIN)}"><h1>{escape(", ".join(kinds))}</h1>'
        f'<div class="counts">{counts}</div><p>{escape(said)}</p></header>'
    )


def _failed(failed: Mapping[str, str]) -> str:
    """Return which parts could not be judged, and why: they have no record."""
    items = [f"<li><b>{named(serial)}</b>: {escape(why)}</li>" for serial, why in list(failed.items())[-_FAILED:]]
    if not items:
        return ""
    rest = f'<p class="soft">The latest of {len(failed)}.</p>' if len(failed) > len(items) else ""
    return section("Could not be judged", f"<ul>{''.join(items)}</ul>{rest}")


def _to_do(each: Sequence[Trend], of: Sequence[Record], title: str) -> str:
    """Return what fails, how often and since when, and what could not be judged."""
    lines = []
    for verdict, word in (("FAIL", "fails"), ("UNDECIDED", "is undecided")):
        for trend in each:
            if not (count := trend.verdicts.get(verdict, 0)):
                continue
            record, last = next((r, one) for r, one in reversed(trend.judged) if one.verdict == verdict)
            serial = named(record.serial or when(record))
            what = f"{word} in {count} of {counted(len(trend), 'part')}, the latest {serial}: {_found(last)}"
            lines.append(f"<b>{named(trend.feature)}</b>, {escape(trend.kind)}, {what}")
            unchanged = trend.unchanged
            if trend.judged[-1][1].verdict == verdict and len(unchanged) > 1:
                lines[-1] += f", in each of the last {len(unchanged)}"
    lines += [
        f"<b>{named(trend.feature)}</b>, {escape(trend.kind)}, drifts by {_signed(drift)}"
        for trend in each
        if (drift := drift_words(trend))
    ]
    lost = [r for r in of if r.pose is None and not r.deviations]
    if lost:
        names = ", ".join(r.serial or r.id[:8] for r in lost[-5:])
        lines.append(f"not found in {counted(len(lost), 'picture')}, the latest: {named(names)}")
    items = "".join(f"<li>{line}</li>" for line in lines)
    return section(f"What to look at{title}", f"<ul>{items}</ul>") if lines else ""


def _found(one: Deviation | Finding) -> str:
    return _signed(deviation_text(one) if isinstance(one, Deviation) else one.reason)


def _signed(text: str) -> str:
    return escape(text.replace("+-", "±"))


def _charts(each: Sequence[Trend], links: Mapping[str, str], title: str) -> str:
    shown = each[:_CHARTS]
    if not shown:
        return ""
    drawn = "".join(
        f"<div><h3>{named(trend.feature)}, {escape(trend.kind)}</h3>{trend_chart(trend, links)}</div>"
        for trend in shown
    )
    keys = "".join(
        f'<span><i style="background:{color}"></i>{word}</span>'
        for word, color in (*VERDICT_COLORS.items(), ("not judged", PLAIN))
    )
    rest = f" {counted(len(each) - _CHARTS, 'more feature')} in the table below." if len(each) > _CHARTS else ""
    note = f"Bars: U. Green area: the tolerance. Crosses at the bottom: missing, or not measured.{rest}"
    legend = f'<div class="legend">{keys}</div><p class="soft">{note}</p>'
    return section(f"Over the parts{title}", f'<div class="two">{drawn}</div>{legend}')


def _features(each: Sequence[Trend], title: str) -> str:
    rows = "".join(row(FEATURE_HEADS, _feature_cells(trend)) for trend in each[:_ROWS])
    note = f'<p class="soft">{SIGMA_NOTE}</p>'
    return section(f"Features{title}", cards(FEATURE_HEADS, rows) + note) if rows else ""


def _feature_cells(trend: Trend) -> list[str]:
    name, *rest = feature_cells(trend)
    return [f"<b>{named(name)}</b>", *map(_signed, rest)]


def _parts(of: Sequence[Record], links: Mapping[str, str], title: str) -> str:
    heads = ("serial", "time (UTC)", "verdict", "missing, or largest share of a tolerance", "quality", "why")
    rows = "".join(row(heads, _part_cells(record, links.get(record.id, ""))) for record in of[: -_ROWS - 1 : -1])
    rest = f'<p class="soft">The latest {_ROWS} of {len(of)}.</p>' if len(of) > _ROWS else ""
    return section(f"Parts{title}", cards(heads, rows) + rest)


def _part_cells(record: Record, address: str) -> list[str]:
    name = named(record.serial or record.id[:8])
    color = VERDICT_COLORS.get(record.verdict, PLAIN)
    return [
        f'<a href="{escape(address)}">{name}</a>' if address else name,
        when(record).replace(" ", _HELD),
        f'<span class="tag" style="color:{color}">{record.verdict or unjudged(record)}</span>',
        named(worst(record)),
        "" if record.quality is None else f"{record.quality:.2f}",
        _signed(record.reason),
    ]
