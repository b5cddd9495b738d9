"""One feature over many parts: mean, scatter, and the measurement's own share of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.errors import BadValue, UnknownName
from cadcam.kinds import expect_each
from cadcam.record.record import Deviation, Record


@dataclass(frozen=True, slots=True, repr=False)
class Trend(Brief):
    """The deviations of one feature, oldest first, each with its record; all in `unit`.

    without: the records of the same kinds of part that have no such deviation: the feature was missing there, or could
    not be measured, or was not asked for.
    """

    feature: str
    unit: str
    points: tuple[tuple[Record, Deviation], ...]
    without: tuple[Record, ...] = ()

    def __len__(self) -> int:
        return len(self.points)

    @property
    def mean(self) -> float:
        """Return the mean deviation."""
        first = self.points[0][1].deviation
        return first + float(np.mean(self._from_first))

    @property
    def sigma(self) -> float:
        """Return the standard deviation from part to part (n - 1 in the denominator); nan for a single part."""
        return float(np.std(self._from_first, ddof=1)) if len(self) > 1 else float("nan")

    @property
    def measured_sigma(self) -> float:
        """Return the standard uncertainty of one deviation, root mean square over all: it is part of `sigma`."""
        return float(np.sqrt(np.mean([(d.expanded_uncertainty / d.k) ** 2 if d.k else 0.0 for _, d in self.points])))

    @property
    def verdicts(self) -> dict[str, int]:
        """Return how often each verdict was given on these deviations; "" counts those that were not judged."""
        return dict(Counter(d.verdict for _, d in self.points))

    @property
    def _from_first(self) -> Array:
        """Return the deviations (n,) less the first one: of equal ones exactly 0, as is then their scatter."""
        return np.array([d.deviation for _, d in self.points]) - self.points[0][1].deviation


def trend(records: Sequence[Record], feature: str, *, kind: str | None = None) -> Trend:
    """Return the deviations of a feature in records, in their order; kind: of deviation, where it has several.

    Raises `UnknownName` where no record has the feature or kind, `BadValue` where the feature has several kinds and
    none was named, or where lengths and angles would be mixed.
    """
    records = expect_each(records, "records", Record)
    named = [(r, d) for r in records for d in r.deviations if d.feature == feature]
    if not named:
        raise UnknownName("feature", feature, {d.feature for r in records for d in r.deviations})
    kinds = {d.kind for _, d in named}
    if kind is None and len(kinds) > 1:
        raise BadValue(f"kinds of {feature!r}", ", ".join(sorted(kinds)), "one of them: name it")
    if kind is not None and kind not in kinds:
        raise UnknownName(f"kind of {feature!r}", kind, kinds)
    points = tuple((r, d) for r, d in named if kind in (None, d.kind))
    units = {d.unit for _, d in points}
    if len(units) > 1:
        raise BadValue(f"units of {feature!r}", ", ".join(sorted(units)), "one: ask for fewer records")
    parts, having = {r.part for r, _ in points}, {r.id for r, _ in points}
    without = tuple(r for r in records if r.part in parts and r.id not in having)
    return Trend(feature, units.pop(), points, without)
