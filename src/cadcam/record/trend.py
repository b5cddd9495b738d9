"""One feature over many parts: mean, scatter, the measurement's own share; since when it is as it is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.errors import BadValue, UnknownName
from cadcam.kinds import expect, expect_each
from cadcam.record.record import Deviation, Finding, Record


@dataclass(frozen=True, slots=True, repr=False)
class Trend(Brief):
    """What was judged of one feature, oldest first, each with its record; lengths or angles in `unit`.

    judged: deviations, and findings: that it was there or not, that its deviation could not be measured. unit: "" where
    there are findings alone. without: the records of the same kind of part that hold neither. replaced: how many
    records do not count, for later ones of the same parts do (`standing`).
    """

    feature: str
    unit: str
    judged: tuple[tuple[Record, Deviation | Finding], ...]
    without: tuple[Record, ...] = ()
    replaced: int = 0

    def __len__(self) -> int:
        return len(self.judged)

    @property
    def kind(self) -> str:
        """Return the kind of judgement: "position", "angle", "presence" ..."""
        return self.judged[-1][1].kind

    @property
    def points(self) -> tuple[tuple[Record, Deviation], ...]:
        """Return the deviations, each with its record."""
        return tuple((r, d) for r, d in self.judged if isinstance(d, Deviation))

    @property
    def unchanged(self) -> tuple[Record, ...]:
        """Return the latest records that all say the same of the feature (`outcome`), oldest first."""
        last = outcome(self.judged[-1][1])
        return tuple(r for r, _ in takewhile(lambda one: outcome(one[1]) == last, reversed(self.judged)))[::-1]

    @property
    def mean(self) -> float:
        """Return the mean deviation; nan of findings alone."""
        x = self._deviations
        return float(x[0] + np.mean(x - x[0])) if len(x) else float("nan")

    @property
    def sigma(self) -> float:
        """Return the standard deviation from part to part (n - 1 in the denominator); nan for a single part.

        Of equal deviations it is exactly 0.
        """
        x = self._deviations
        return float(np.std(x - x[0], ddof=1)) if len(x) > 1 else float("nan")

    @property
    def measured_sigma(self) -> float:
        """Return the standard uncertainty of one deviation, root mean square over all: it is part of `sigma`."""
        own = [d.expanded_uncertainty / d.k for _, d in self.points]
        return float(np.sqrt(np.mean(np.square(own)))) if own else float("nan")

    @property
    def drift(self) -> tuple[float, float]:
        """Return by how much the deviation grows from part to part, by least squares, and the sigma of that; in `unit`.

        nan for fewer than three. A step, as by another batch, is a drift, too.
        """
        x = self._deviations
        if len(x) < 3:
            return float("nan"), float("nan")
        i = np.arange(len(x)) - 0.5 * (len(x) - 1)
        slope = float(i @ (x - x[0]) / (i @ i))
        left = x - np.mean(x) - slope * i
        return slope, float(np.sqrt(left @ left / (len(x) - 2) / (i @ i)))

    @property
    def verdicts(self) -> dict[str, int]:
        """Return how often each verdict was given on the feature; "" counts what was not judged."""
        return dict(Counter(d.verdict for _, d in self.judged))

    @property
    def _deviations(self) -> Array:
        """Return the deviations (n,)."""
        return np.array([d.deviation for _, d in self.points])


def outcome(one: Deviation | Finding) -> str:
    """Return the verdict; of a finding that was not judged what was found, such as "missing"; else ""."""
    return one.verdict or (one.reason if isinstance(one, Finding) else "")


def standing(records: Sequence[Record]) -> list[Record]:
    """Return records, oldest first, without those that a later one replaces.

    It does where it is of the same part (kind, serial number, station) and gives a verdict on all that the earlier one
    did, or measures all that this did where that has no verdicts: the part was judged by other limits, or photographed
    anew. Parts without a serial number are told apart.
    """
    parts = [(record.part, record.serial, record.station) for record in records]
    said = [{(one.feature, one.kind, one.verdict) for one in _judged(record)} for record in records]
    return [record for record, stands in zip(records, which_stand(parts, said), strict=True) if stands]


def which_stand(parts: Sequence[tuple[str, str, str]], said: Sequence[set[tuple[str, str, str]]]) -> list[bool]:
    """Return which records, oldest first, are not replaced; see `standing`.

    parts: kind, serial number and station of each; said: on what it says anything: feature, kind, and the verdict or
    "".
    """
    later: dict[tuple[str, str, str], tuple[set[tuple[str, str]], set[tuple[str, str]]]] = {}
    there: set[tuple[str, str, str]] = set()
    out = []
    for part, each in zip(reversed(parts), reversed(said), strict=True):
        every, judged = {one[:2] for one in each}, {one[:2] for one in each if one[2]}
        all_later, judged_later = later.setdefault(part, (set(), set()))
        replaced = judged <= judged_later if judged else every <= all_later
        out.append(not part[1] or part not in there or not replaced)
        there.add(part)
        all_later |= every
        judged_later |= judged
    return out[::-1]


def trend(records: Sequence[Record], feature: str, *, kind: str | None = None, replaced: int | None = None) -> Trend:
    """Return what records of one kind of part, oldest first, judge of a feature; kind: of judgement, if several.

    Each part counts once (`standing`); replaced: how many records were left out for that already, if so. Without a
    kind, the one of which there are deviations is meant, or else the only one. Raises `UnknownName` where no record has
    the feature or kind, `BadValue` where several kinds of part have it, where it has several kinds and none was named,
    or where lengths and angles would be mixed.
    """
    every = expect_each(records, "records", Record)
    expect(feature, "feature", str)
    records = standing(every) if replaced is None else every
    replaced = len(every) - len(records) if replaced is None else replaced
    all_judged = [(r, one) for r in records for one in _judged(r)]
    named = [(r, one) for r, one in all_judged if one.feature == feature]
    if not named:
        raise UnknownName("feature", feature, {one.feature for _, one in all_judged})
    parts = {r.part for r, _ in named}
    if len(parts) > 1:
        raise BadValue(f"part of {feature!r}", "not named", f"records of one of {', '.join(sorted(parts))}")
    kinds, measured = {one.kind for _, one in named}, {one.kind for _, one in named if isinstance(one, Deviation)}
    if kind is None and len(measured or kinds) > 1:
        raise BadValue(f"kind of {feature!r}", "not named", f"one of {', '.join(sorted(kinds))}")
    if kind is not None and kind not in kinds:
        raise UnknownName(f"kind of {feature!r}", kind, kinds)
    (meant,) = {kind} if kind is not None else measured or kinds
    return _trend(feature, [(r, one) for r, one in named if one.kind == meant], records, replaced)


def trends(records: Sequence[Record]) -> list[Trend]:
    """Return the trend of each kind of judgement on each feature of each kind of part, as records first have them.

    Each part counts once (`standing`). Raises `BadValue` where lengths and angles would be mixed.
    """
    every = expect_each(records, "records", Record)
    records = standing(every)
    each: dict[tuple[str, str, str], list[tuple[Record, Deviation | Finding]]] = {}
    for record in records:
        for one in _judged(record):
            each.setdefault((record.part, one.feature, one.kind), []).append((record, one))
    return [_trend(feature, judged, records, len(every) - len(records)) for (_, feature, _), judged in each.items()]


def _trend(
    feature: str, judged: Sequence[tuple[Record, Deviation | Finding]], records: Sequence[Record], replaced: int
) -> Trend:
    units = {one.unit for _, one in judged if isinstance(one, Deviation)}
    if len(units) > 1:
        raise BadValue(f"unit of {feature!r}", " and ".join(sorted(units)), "one of them: ask for fewer records")
    parts, having = {r.part for r, _ in judged}, {r.id for r, _ in judged}
    without = tuple(r for r in records if r.part in parts and r.id not in having)
    return Trend(feature, next(iter(units), ""), tuple(judged), without, replaced)


def _judged(record: Record) -> Iterator[Deviation | Finding]:
    yield from record.deviations
    yield from record.findings
