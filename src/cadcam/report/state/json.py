"""The trend of a feature as a JSON document."""

from __future__ import annotations

from typing import Any

from cadcam.files.jsontext import or_null
from cadcam.record.export import time_as_text
from cadcam.record.record import Deviation, Finding, Record
from cadcam.record.trend import Trend, outcome
from cadcam.report.state.tables import drift_words, parts_left


def trend_as_json(trend: Trend) -> dict[str, Any]:
    """Return all that is told of a feature over the parts; lengths or angles under keys that end in their unit."""
    last = trend.judged[-1][1]
    since = {"verdict": last.verdict, "since_utc": time_as_text(trend.unchanged[0].time)}
    since |= {"reason": outcome(last)} if outcome(last) != last.verdict else {}
    return {
        "feature": trend.feature,
        "kind": trend.kind,
        **(_numbers(trend) if trend.unit else {}),
        "verdicts": trend.verdicts,
        "at_the_end": since,
        "without": [record.id for record in trend.without],
        "replaced": trend.replaced,
        "points": [_point(record, one, trend.unit) for record, one in trend.judged],
    }


def _numbers(trend: Trend) -> dict[str, Any]:
    """Return mean, scatter and drift of the deviations."""
    slope, sigma = trend.drift
    numbers = {"mean": trend.mean, "sigma": trend.sigma, "measured_sigma": trend.measured_sigma}
    numbers |= {"drift_a_part": slope, "drift_sigma": sigma}
    in_unit = {f"{name}_{trend.unit}": or_null(value) for name, value in numbers.items()}
    return in_unit | {"drift": drift_words(trend), "parts_left": parts_left(trend)}


def _point(record: Record, one: Deviation | Finding, unit: str) -> dict[str, Any]:
    """Return what was judged of the feature of one part."""
    which = {"time_utc": time_as_text(record.time), "part": record.part, "serial": record.serial, "id": record.id}
    if isinstance(one, Finding):
        return which | {"verdict": one.verdict, "reason": one.reason}
    numbers = ("deviation", "expanded_uncertainty", "lower", "upper")
    in_unit = {f"{name}_{unit}": getattr(one, name) for name in numbers}
    return which | {"verdict": one.verdict, "k": one.k} | in_unit
