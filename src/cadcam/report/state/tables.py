"""Stored records as tables: many in a list, one in full, a feature over the parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from cadcam.arrays import significant
from cadcam.record.record import Deviation, Finding, Record
from cadcam.record.trend import Trend, outcome, standing, trends
from cadcam.report.table import Table, counted, with_sigma

_FEW, _BY_CHANCE = 10, 1e-4  # parts from which a drift is told, and how probable it may be without any
_TINY = 1e-300
FEATURE_HEADS = ("feature", "what", "FAIL", "UNDECIDED", "PASS", "mean", "sigma", "measuring", "largest", "tolerance")
SIGMA_NOTE = "sigma: from part to part; measuring: of that the measurements' own"
_SOON = 10.0  # times as many parts as there are: what is farther away is not foretold


def list_table(records: Sequence[Record], *, of: int) -> Table:
    """Return one line for each record; `of` is the total number."""
    rows = tuple((when(r), r.id[:8], r.part, r.serial, r.station, r.verdict or unjudged(r), worst(r)) for r in records)
    notes = (in_counts(Counter(r.verdict for r in records)),) if records else ()
    title = counted(len(records), "record") + (f", the latest of {of}" if of > len(records) else "")
    columns = ("time (UTC)", "id", "part", "serial", "station", "verdict", "missing, or largest share of a tolerance")
    return Table(title, columns, rows, columns[:-1], notes)


def record_tables(record: Record) -> list[Table]:
    """Return all contents of a record: what and when, the pose, the deviations, the sources."""
    said = [
        ("part", record.part),
        ("serial", record.serial),
        ("station", record.station),
        ("time", f"{when(record)} UTC"),
        ("verdict", record.verdict or unjudged(record)),
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


def features_table(records: Sequence[Record]) -> Table:
    """Return a line for each feature: what was judged of it over the parts, what is wrong first."""
    each = sorted(trends(records), key=by_trouble)
    drifts = (f"{t.feature}, {t.kind}, drifts by {drift}" for t in each if (drift := drift_words(t)))
    title, rows = f"Features, {counted(len(standing(records)), 'part')}", tuple(feature_cells(trend) for trend in each)
    return Table(title, FEATURE_HEADS, rows, ("feature", "what"), (SIGMA_NOTE, *drifts) if rows else ())


def feature_cells(trend: Trend) -> tuple[str, ...]:
    """Return what is told of a feature under `FEATURE_HEADS`."""
    counts = (str(trend.verdicts.get(verdict, 0) or "") for verdict in ("FAIL", "UNDECIDED", "PASS"))
    head = (trend.feature, trend.kind, *counts)
    if not trend.points:
        return (*head, "", "", "", "", "")
    own, spread = trend.measured_sigma, trend.sigma
    mean, _ = with_sigma(trend.mean, spread if spread > 0 else own)
    largest = max((d for _, d in trend.points), key=lambda d: abs(d.deviation))
    last = trend.points[-1][1]
    limit = "" if last.lower is last.upper is None else _tolerance(last)
    scatter = f"{spread:.2g}" if np.isfinite(spread) else ""
    return (*head, f"{mean} {trend.unit}", scatter, f"{own:.2g}", deviation_text(largest), limit)


def by_trouble(trend: Trend) -> tuple[float, ...]:
    """Return a sort key: what fails most comes first, then what is undecided, then what is nearest to its limits."""
    verdicts = trend.verdicts
    shares = [share for _, d in trend.points if (share := _share(d)) is not None]
    return (-verdicts.get("FAIL", 0), -verdicts.get("UNDECIDED", 0), -max(shares, default=-1.0))


def trend_tables(trend: Trend, *, newest: int | None = None) -> list[Table]:
    """Return one line for each part, or the newest of them, and mean and scatter over all of them."""
    shown = trend.judged if newest is None else trend.judged[-newest:]
    rows = tuple((when(r), r.part, r.serial, _judged_text(one), one.verdict) for r, one in shown)
    columns = ("time (UTC)", "part", "serial", "deviation" if trend.unit else "finding", "verdict")
    left = columns if len(trend.points) < len(trend) else tuple(column for column in columns if column != "deviation")
    of = f", the latest of {len(trend)}" if len(shown) < len(trend) else ""
    lines = Table(f"{trend.feature}, {counted(len(shown), 'record')}{of}", columns, rows, left)
    said = _scatter_rows(trend) if trend.unit else []
    said.append(("verdicts", in_counts(trend.verdicts)))
    unchanged = trend.unchanged
    if (last := outcome(trend.judged[-1][1])) and len(trend) > 1:
        first = unchanged[0]
        since = " ".join(filter(None, (when(first), first.serial)))
        said.append(("at the end", f"{last} since {since}, {counted(len(unchanged), 'record')}"))
    if trend.replaced:
        said.append(("left out", f"{counted(trend.replaced, 'record')}: later ones of the same parts count"))
    if trend.without:
        number, every = len(trend.without), len(trend.without) + len({r.id for r, _ in trend.judged})
        of_parts = in_counts(Counter(r.verdict for r in trend.without))
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
    if drift := drift_words(trend):
        said.append(("drift", drift))
    if points < len(trend):
        said.append(("could not be measured", f"{len(trend) - points} of {counted(len(trend), 'record')}"))
    return said


def drift_words(trend: Trend) -> str:
    """Return by how much a deviation drifts, and how soon it reaches its limit so; "" where chance might do it."""
    if not _drifts(trend):
        return ""
    slope, sigma = trend.drift
    value, U = with_sigma(slope, 2 * sigma)
    said, left = f"{value} +- {U or 'exact'} {trend.unit} a part", parts_left(trend)
    if left is None:
        return said
    return f"{said}, now beyond its limit" if left <= 0 else f"{said}; at this rate at its limit in {left:.0f} parts"


def parts_left(trend: Trend) -> float | None:
    """Return in how many parts a drifting deviation reaches its limit; 0: it is beyond it.

    None where chance might make the drift, there is no such limit, or it is far away.
    """
    if not _drifts(trend):
        return None
    slope, points = trend.drift[0], trend.points
    last = points[-1][1]
    limit = last.upper if slope > 0 else last.lower
    now = trend.mean + 0.5 * slope * (len(points) - 1)
    if limit is None or (limit < 0 <= min(d.deviation for _, d in points)):  # a distance does not fall below 0
        return None
    left = max((limit - now) / slope, 0.0)
    return left if left < _SOON * len(points) else None


def _drifts(trend: Trend) -> bool:
    """Return whether chance alone hardly makes deviations grow so from part to part."""
    from scipy.special import stdtr

    n, (slope, sigma) = len(trend.points), trend.drift
    return n >= _FEW and bool(2 * stdtr(n - 2, -abs(slope) / max(sigma, _TINY)) < _BY_CHANCE)


def _judged_text(one: Deviation | Finding) -> str:
    return deviation_text(one) if isinstance(one, Deviation) else one.reason


def in_counts(verdicts: Mapping[str, int]) -> str:
    """Return how often each verdict was given, in words."""
    return ", ".join(f"{count} {verdict or 'not judged'}" for verdict, count in verdicts.items())


def deviation_text(deviation: Deviation) -> str:
    """Return a deviation with its expanded uncertainty and unit."""
    value, U = with_sigma(deviation.deviation, deviation.expanded_uncertainty)
    return f"{value} +- {U or 'exact'} {deviation.unit}"


def _tolerance(d: Deviation) -> str:
    """Return the limits of a deviation: one where both are alike, or where it is a length, which is never negative."""
    if d.lower is None and d.upper is None:
        return "none"
    if d.upper is None:
        return f"from {d.lower:g} {d.unit}"
    if d.lower == -d.upper or (d.lower is None and d.kind == "position"):  # as `cadcam verify` writes it
        return f"{d.upper:g} {d.unit}"
    return f"{'up' if d.lower is None else f'{d.lower:g}'} to {d.upper:g} {d.unit}"


def worst(record: Record) -> str:
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


def unjudged(record: Record) -> str:
    """Return what stands in place of the verdict of a part that was not judged."""
    return "located" if record.pose is not None else "not found"


def when(record: Record) -> str:
    """Return when a part was measured, UTC, to the second."""
    return record.time.replace(tzinfo=None).isoformat(" ", "seconds")
