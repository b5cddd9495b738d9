"""Stored records as tables: many in a list, one in full, a feature over the parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from cadcam.arrays import significant
from cadcam.record.record import Deviation, Finding, Record
from cadcam.record.trend import Trend, outcome
from cadcam.report.table import Table, counted, with_sigma


def list_table(records: Sequence[Record], *, of: int) -> Table:
    """Return one line for each record; `of` is the total number."""
    rows = tuple(
        (_time(r), r.id[:8], r.part, r.serial, r.station, r.verdict or _unjudged(r), _worst(r)) for r in records
    )
    notes = (_counts(Counter(r.verdict for r in records)),) if records else ()
    title = counted(len(records), "record") + (f", the latest of {of}" if of > len(records) else "")
    columns = ("time (UTC)", "id", "part", "serial", "station", "verdict", "missing, or largest share of a tolerance")
    return Table(title, columns, rows, columns[:-1], notes)


def record_tables(record: Record) -> list[Table]:
    """Return all contents of a record: what and when, the pose, the deviations, the sources."""
    said = [
        ("part", record.part),
        ("serial", record.serial),
        ("station", record.station),
        ("time", f"{_time(record)} UTC"),
        ("verdict", record.verdict or _unjudged(record)),
        ("reason", record.reason),
        ("quality", "" if record.quality is None else f"{record.quality:.3f}"),
        ("software", record.software),
    ]
    rows = tuple(pair for pair in said if pair[1])
    tables = [Table(f"Record {record.id}", ("", ""), rows, ("",))]
    if record.pose is not None:
        tables.append(pose_table(record))
    if record.deviations:
        columns = ("feature", "kind", "deviation", "tolerance", "verdict")
        rows5 = tuple((d.feature, d.kind, deviation_text(d), _tolerance(d), d.verdict) for d in record.deviations)
        tables.append(Table("Deviations +- expanded uncertainty", columns, rows5, columns))
    if record.findings:
        columns4 = ("feature", "kind", "verdict", "reason")
        rows4 = tuple((f.feature, f.kind, f.verdict, f.reason) for f in record.findings)
        tables.append(Table("Found without a number", columns4, rows4, columns4))
    if record.sources:
        columns3 = ("what", "file", "sha256")
        tables.append(Table("Came from", columns3, tuple((s.role, s.path, s.sha256) for s in record.sources), columns3))
    return tables


def pose_table(record: Record) -> Table:
    """Return the pose of the part, with its sigmas in the part's own axes."""
    assert record.pose is not None
    T, sigma = record.pose.world_from_part, np.sqrt(np.diag(record.pose.determined.covariance))
    place = ", ".join(f"{v:.3f}" for v in T.translation)
    words = record.pose.undetermined_words
    rows = (
        ("origin in the world, mm", place),
        ("sigma of shifts along the part's x, y, z, mm", ", ".join(map(significant, sigma[:3]))),
        ("sigma of turns about them, deg", ", ".join(map(significant, np.degrees(sigma[3:])))),
        *([("not determined", words)] if words else []),
    )
    return Table("Pose", ("", ""), rows, ("",))


def trend_tables(trend: Trend, *, newest: int | None = None) -> list[Table]:
    """Return one line for each part, or the newest of them, and mean and scatter over all of them."""
    shown = trend.judged if newest is None else trend.judged[-newest:]
    rows = tuple((_time(r), r.part, r.serial, _judged_text(one), one.verdict) for r, one in shown)
    columns = ("time (UTC)", "part", "serial", "deviation" if trend.unit else "finding", "verdict")
    left = columns if len(trend.points) < len(trend) else tuple(column for column in columns if column != "deviation")
    of = f", the latest of {len(trend)}" if len(shown) < len(trend) else ""
    lines = Table(f"{trend.feature}, {counted(len(shown), 'record')}{of}", columns, rows, left)
    said = _scatter_rows(trend) if trend.unit else []
    said.append(("verdicts", _counts(trend.verdicts)))
    unchanged = trend.unchanged
    if (last := outcome(trend.judged[-1][1])) and len(trend) > 1:
        first = unchanged[0]
        since = " ".join(filter(None, (_time(first), first.serial)))
        said.append(("at the end", f"{last} since {since}, {counted(len(unchanged), 'record')}"))
    if trend.without:
        number, every = len(trend.without), len(trend.without) + len({r.id for r, _ in trend.judged})
        of_parts = _counts(Counter(r.verdict for r in trend.without))
        said.append(("without a value", f"{number} of {counted(every, 'record')}; as a whole {of_parts}"))
    return [lines, Table("Over all parts", ("", ""), tuple(said), ("",))]


def _scatter_rows(trend: Trend) -> list[tuple[str, str]]:
    """Return mean and scatter of the deviations, and what the scatter is due to."""
    points = len(trend.points)
    own, several = trend.measured_sigma, points > 1
    mean, spread = with_sigma(trend.mean, trend.sigma if several and trend.sigma > 0 else own)
    spread = spread if trend.sigma > 0 else "0"
    said = [
        (f"mean, {trend.unit}", mean),
        (f"sigma from part to part, {trend.unit}", spread if several else "unknown: one part"),
        (f"of that the measurement's own, {trend.unit}", f"{own:.2g}"),
    ]
    if several and trend.sigma > own:
        said.append((f"of that the parts', {trend.unit}", f"{np.sqrt(trend.sigma**2 - own**2):.2g}"))
    if points < len(trend):
        said.append(("could not be measured", f"{len(trend) - points} of {counted(len(trend), 'record')}"))
    return said


def _judged_text(one: Deviation | Finding) -> str:
    return deviation_text(one) if isinstance(one, Deviation) else one.reason


def _counts(verdicts: Mapping[str, int]) -> str:
    """Return how often each verdict was given, in words."""
    return ", ".join(f"{count} {verdict or 'not judged'}" for verdict, count in verdicts.items())


def deviation_text(deviation: Deviation) -> str:
    """Return a deviation with its expanded uncertainty and unit."""
    value, U = with_sigma(deviation.deviation, deviation.expanded_uncertainty)
    return f"{value} +- {U or 'exact'} {deviation.unit}"


def _tolerance(d: Deviation) -> str:
    if d.lower is None and d.upper is None:
        return "none"
    low = "" if d.lower is None else f"{d.lower:g}"
    high = "" if d.upper is None else f"{d.upper:g}"
    return f"{low} ... {high} {d.unit}"


def _worst(record: Record) -> str:
    """Return which feature is missing, or whose deviation takes up most of its tolerance, and how much, in percent."""
    missing = [f.feature for f in record.findings if f.verdict == "FAIL"]
    if missing:
        return f"{missing[0]} missing" + (f", and {len(missing) - 1} more" if len(missing) > 1 else "")
    shares = [(share, d.feature) for d in record.deviations if (share := _share(d)) is not None]
    if not shares:
        return ""
    share, feature = max(shares)
    return f"{feature} {100 * share:.0f} %" if np.isfinite(share) else f"{feature} beyond its limit"


def _share(d: Deviation) -> float | None:
    """Return how much of its tolerance a deviation takes up: 1 is at a limit, 0 in the middle of two, or at 0 of one.

    One limit that leaves no room about 0 has no such measure: infinity beyond it, else None.
    """
    if d.lower is None and d.upper is None:
        return None
    if d.lower is not None and d.upper is not None:
        off, room = abs(d.deviation - (d.lower + d.upper) / 2), (d.upper - d.lower) / 2
    else:
        off, room = (d.deviation, d.upper) if d.upper is not None else (-d.deviation, -(d.lower or 0.0))
        if room <= 0 and off <= room:
            return None
    return float(max(off, 0.0) / room) if room > 0 else float("inf") if off > room else 0.0


def _unjudged(record: Record) -> str:
    return "located" if record.pose is not None else "not found"


def _time(record: Record) -> str:
    return record.time.replace(tzinfo=None).isoformat(" ", "seconds")
