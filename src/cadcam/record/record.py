"""The record of a measured part: its identity, pose, deviations, their uncertainty, and the sources used."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from decimal import Decimal
from uuid import uuid4

import numpy as np

from cadcam import __version__
from cadcam.arrays import Brief
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue, UnknownName
from cadcam.kinds import expect, expect_each, expect_known, expect_number
from cadcam.whole import plain

VERDICTS = ("PASS", "FAIL", "UNDECIDED")
UNITS = ("mm", "deg")
LIMITS = ("deviation", "expanded_uncertainty", "lower", "upper")  # what is in the unit of a deviation
PLACE = ("x_mm", "y_mm", "z_mm")  # of the part in the world, as columns name it
ROTATION = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class Deviation:
    """A feature's deviation from its CAD, in `unit` (mm or deg), +- expanded uncertainty (k sigma).

    kind: of deviation, such as "position" or "angle". lower, upper: the tolerance, None where there is none on that
    side, as below a length. verdict: PASS, FAIL, UNDECIDED, or empty where it was not judged.
    """

    feature: str
    deviation: float
    expanded_uncertainty: float
    kind: str = "position"
    unit: str = "mm"
    k: float = 2.0
    lower: float | None = None
    upper: float | None = None
    verdict: str = ""

    def __post_init__(self) -> None:
        _spell_out(self, "feature", "kind")
        expect_known(self.unit, f"unit of deviation {self.feature!r}", UNITS)
        _check_verdict(self.verdict, self.feature)
        for name in ("deviation", "expanded_uncertainty", "k", "lower", "upper"):
            if getattr(self, name) is not None or name not in ("lower", "upper"):
                _as_number(self, name, f"{name} of {self.feature!r}")
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise BadValue(f"{name} of {self.feature!r}", value, "a finite number")
            if name == "expanded_uncertainty" and value < 0:
                raise BadValue(f"{name} of {self.feature!r}", value, "zero or more")
        if not self.k > 0:
            raise BadValue(f"k of {self.feature!r}", self.k, "a positive number: U = k sigma")
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            limits = f"{self.lower:g} to {self.upper:g}"
            raise BadValue(f"tolerance of {self.feature!r}", limits, "lower at most upper")


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found of a feature without a number: that it is there, or a deviation that could not be measured.

    kind: "presence", or of the deviation. verdict: PASS, FAIL, UNDECIDED, or empty where it was not judged. reason: one
    line for people.
    """

    feature: str
    kind: str = "presence"
    verdict: str = ""
    reason: str = ""

    def __post_init__(self) -> None:
        _spell_out(self, "feature", "kind", "reason")
        _check_verdict(self.verdict, self.feature)


@dataclass(frozen=True, slots=True)
class Source:
    """A source of the result: its role ("photo", "cad", "camera", "tolerances" ...), its path, its hash."""

    role: str
    path: str
    sha256: str

    def __post_init__(self) -> None:
        _spell_out(self, "role", "path")
        expect(self.sha256, f"sha256 of {self.path}", str)
        if not _SHA256.fullmatch(self.sha256):
            raise BadValue(f"sha256 of {self.path}", repr(self.sha256), "64 hexadecimal digits")


@dataclass(frozen=True, slots=True, repr=False)
class Record(Brief):
    """One measurement of one part.

    part: the kind of part; serial: the individual; station: where it was measured; time: when, with its zone. pose:
    None where it was not found. quality: of the pose, in [0, 1]. verdict: over all deviations, empty where nothing was
    judged; reason: one line for people. findings: what is known without a number. software: what measured. id: assigned
    by the record.
    """

    part: str
    serial: str = ""
    station: str = ""
    time: datetime = field(default_factory=lambda: datetime.now(UTC))
    pose: PoseEstimate | None = None
    quality: float | None = None
    verdict: str = ""
    reason: str = ""
    deviations: tuple[Deviation, ...] = ()
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()
    software: str = f"cadcam {__version__}"
    id: str = field(default_factory=lambda: uuid4().hex)

    def __post_init__(self) -> None:
        expect(self.part, "part of a record", str)
        expect(self.time, "time of a record", datetime)
        expect(self.pose, "pose of a record", PoseEstimate, optional=True)
        if not self.part:
            raise BadValue("part of a record", "empty", "the name of the kind of part")
        if self.quality is not None:
            _as_number(self, "quality", "quality of a record")
        if self.quality is not None and not 0 <= self.quality <= 1:
            raise BadValue("quality of a record", self.quality, "a number from 0 to 1")
        _check_verdict(self.verdict, self.part)
        _spell_out(self, "part", "serial", "station", "reason", "software", "id")
        object.__setattr__(self, "time", in_utc("time of a record", self.time))
        object.__setattr__(self, "deviations", expect_each(self.deviations, "deviations", Deviation))
        object.__setattr__(self, "findings", expect_each(self.findings, "findings", Finding))
        object.__setattr__(self, "sources", expect_each(self.sources, "sources", Source))


def in_utc(what: str, time: datetime) -> datetime:
    """Return a time in UTC; `BadValue` naming `what` where it has no zone, or UTC's calendar does not hold it."""
    if time.tzinfo is None:
        raise BadValue(what, time.isoformat(), "a time with its zone, such as datetime.now(UTC)")
    try:
        return time.astimezone(UTC)
    except OverflowError:  # in the first or the last hours of the calendar
        raise BadValue(what, time.isoformat(), "a time of the years 1 to 9999 in UTC, too") from None


def _as_number(of: Record | Deviation, name: str, what: str) -> None:
    """Make a float of a number, such as one of a picture or of a database: JSON knows no float32, and no Decimal."""
    value = getattr(of, name)
    value = float(value) if isinstance(value, Decimal) and not value.is_nan() else value
    expect_number(value, what)
    object.__setattr__(of, name, float(value))


def _spell_out(of: Source | Record | Deviation | Finding, *names: str) -> None:
    """Spell out what is no text in texts that may hold the name of a file: no database would take it."""
    for name in names:
        value = getattr(of, name)
        expect(value, f"{name} of a {type(of).__name__.lower()}", str)
        object.__setattr__(of, name, as_kept(value))


def as_kept(text: str) -> str:
    """Return a text as a store keeps it: what is no text in it spelled out, and NUL, which PostgreSQL lacks."""
    return plain(text).replace("\0", r"\x00")


def _check_verdict(verdict: str, of: str) -> None:
    if verdict and verdict not in VERDICTS:
        raise UnknownName(f"verdict of {of!r}", verdict, VERDICTS)
