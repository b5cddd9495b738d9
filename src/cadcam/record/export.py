"""Records as JSON, JSON lines and CSV, units in the names; JSON and JSON lines are read back to the last bit.

JSON: {"format": "cadcam records", "version": 1, "records": [...]}; JSON lines: one record per line. A record:
{"id", "time_utc", "part", "serial", "station", "verdict", "reason", "quality", "pose": as `write_part_pose` writes
it, or null, "deviations": [{"feature", "kind", "verdict", "k", "deviation_mm", "expanded_uncertainty_mm", "lower_mm",
"upper_mm"}, ...] (_deg for angles), "findings": [{"feature", "kind", "verdict", "reason"}, ...], "sources": [{"role",
"path", "sha256"}, ...], "software"}. CSV: a line for each deviation and each finding, that of a record without any
left empty; covariances are not in it.

Files are written and read record by record: a store may hold more than memory does.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.errors import UnknownName, UnreadableFile
from cadcam.files.jsontext import Place, as_json_pieces, json_line, parsed, parsed_line
from cadcam.files.pose_estimate import pose_estimate_as_json, pose_estimate_at
from cadcam.files.text import lines_of_text, read_text, spreadsheet_rows
from cadcam.kinds import expect_each, expect_path
from cadcam.record.record import LIMITS, PLACE, ROTATION, UNITS, Deviation, Finding, Record, Source
from cadcam.record.selection import Selection, batches
from cadcam.whole import utf8, write_whole

FORMAT, VERSION = "cadcam records", 1
SUFFIXES = (".csv", ".json", ".jsonl")
_TEXTS = ("id", "part", "serial", "station", "verdict", "reason", "software")
_FINDING = ("feature", "kind", "verdict", "reason")
_MAX_BYTES = 1_000_000_000
_POSE = (*PLACE, *ROTATION)
_SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "sigma_rx_deg", "sigma_ry_deg", "sigma_rz_deg")


def write_records(path: str | os.PathLike[str], records: Sequence[Record] | Selection) -> None:
    """Write records as .csv, .json or .jsonl, whole or not at all. Raises `UnknownName` for another suffix.

    Those of `Store.select` are read and written a few at a time.
    """
    expect_path(path)
    if not isinstance(records, Selection):
        records = expect_each(records, "records", Record)
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise UnknownName("suffix of a file of records", suffix, SUFFIXES)
    if suffix == ".json":
        head = {"format": FORMAT, "version": VERSION}
        write_whole(path, as_json_pieces(head, "records", map(record_as_json, records)))
    else:
        texts = as_csv(records) if suffix == ".csv" else as_jsonl(records)
        write_whole(path, (utf8("".join(some)) for some in batches(texts)))


def read_records(path: str | os.PathLike[str]) -> list[Record]:
    """Return the records in a .json or .jsonl file of `write_records`, or the one in the JSON of `cadcam verify`.

    Raises `UnreadableFile` naming line or key.
    """
    return list(each_record(path))


def each_record(path: str | os.PathLike[str]) -> Iterator[Record]:
    """Yield the records that `read_records` returns; of a .jsonl file only the line at hand is in memory."""
    expect_path(path)
    suffix = Path(path).suffix.lower()
    if suffix == ".jsonl":
        for number, text in lines_of_text(path):
            if text.strip():
                yield record_at(parsed_line(path, number, text))
        return
    file = read_text(path, max_bytes=_MAX_BYTES)
    if suffix == ".csv":
        raise UnreadableFile(path, "is a table for spreadsheets", "give the export as .json or .jsonl")
    place = parsed(file)
    if place.object.get("format") != FORMAT:
        if not {"part", "deviations"} & set(place.object):
            raise place.error("is neither an export nor the JSON of `cadcam verify`: it has no 'part'")
        yield record_at(place)
        return
    if place.object.get("version") != VERSION:
        raise place.error(f"has version {place.object.get('version')!r}", f"version {VERSION} is read here")
    for one in place.at("records").items():
        yield record_at(one)


def record_as_json(record: Record) -> dict[str, Any]:
    """Return the JSON object of a record."""
    head = {name: getattr(record, name) for name in ("id", "part", "serial", "station", "verdict", "reason", "quality")}
    return {
        "time_utc": time_as_text(record.time),
        **head,
        "pose": None if record.pose is None else pose_estimate_as_json(record.pose),
        "deviations": [_deviation_as_json(d) for d in record.deviations],
        "findings": [{name: getattr(f, name) for name in _FINDING} for f in record.findings],
        "sources": [{"role": s.role, "path": s.path, "sha256": s.sha256} for s in record.sources],
        "software": record.software,
    }


def time_as_text(time: datetime) -> str:
    """Return a time in UTC as files have it: 2026-03-02T12:00:00Z."""
    return time.replace(tzinfo=None).isoformat() + "Z"


def record_at(place: Place) -> Record:
    """Return the record at a place of a JSON file; other keys are ignored."""
    given: dict[str, Any] = {name: place.at(name).text() for name in _TEXTS if name in place.object}
    for name in ("part", "deviations"):
        _ = place.at(name)
    if "time_utc" in place.object:
        given["time"] = _time(place.at("time_utc"))
    if place.object.get("quality") is not None:
        given["quality"] = place.at("quality").number()
    if place.object.get("pose") is not None:
        given["pose"] = pose_estimate_at(place.at("pose"))
    given["deviations"] = tuple(_deviation_at(d) for d in place.at("deviations").items())
    if "findings" in place.object:
        given["findings"] = tuple(_finding_at(f) for f in place.at("findings").items())
    if "sources" in place.object:
        given["sources"] = tuple(_source_at(s) for s in place.at("sources").items())
    return place.build(lambda: Record(**given))


def as_jsonl(records: Iterable[Record]) -> Iterator[str]:
    """Yield a line of JSON for each record."""
    return (json_line(record_as_json(r)) + "\n" for r in records)


def as_csv(records: Sequence[Record] | Selection) -> Iterator[str]:
    """Yield the table with a line for each deviation and finding: its header, then the lines of each record."""
    roles = sorted(records.roles() if isinstance(records, Selection) else {s.role for r in records for s in r.sources})
    columns = _columns(roles)
    yield spreadsheet_rows([columns])
    for record in records:
        head = _head_row(record, roles)
        judged = [_deviation_row(d) for d in record.deviations] + [_finding_row(f) for f in record.findings]
        rows = [head | row for row in judged or ({},)]
        yield spreadsheet_rows([[row.get(name, "") for name in columns] for row in rows])


def _columns(roles: Sequence[str]) -> list[str]:
    limits = [f"{name}_{unit}" for unit in UNITS for name in LIMITS]
    deviation = ["feature", "kind", *limits, "k", "feature_verdict", "feature_reason"]
    head = ["time_utc", "part", "serial", "station", "verdict", "reason", "quality"]
    return [*head, *deviation, *_POSE, *_SIGMAS, *(f"{role}_sha256" for role in roles), "software", "id"]


def _head_row(record: Record, roles: Sequence[str]) -> dict[str, Any]:
    said = record_as_json(record)
    row = {name: said[name] for name in (*_TEXTS, "time_utc", "quality")}
    for role in roles:
        row[f"{role}_sha256"] = " ".join(s.sha256 for s in record.sources if s.role == role)
    if record.pose is not None:
        T, sigma = record.pose.world_from_part, np.sqrt(np.diag(record.pose.covariance))
        row |= dict(zip(_POSE, [*T.translation.tolist(), *T.rotation.ravel().tolist()], strict=True))
        row |= dict(zip(_SIGMAS, [*sigma[:3].tolist(), *np.degrees(sigma[3:]).tolist()], strict=True))
    return row


def _deviation_row(deviation: Deviation) -> dict[str, Any]:
    row = _deviation_as_json(deviation)
    row["feature_verdict"] = row.pop("verdict")
    return row


def _finding_row(finding: Finding) -> dict[str, Any]:
    names = {"verdict": "feature_verdict", "reason": "feature_reason"}
    return {names.get(name, name): getattr(finding, name) for name in _FINDING}


def _deviation_as_json(deviation: Deviation) -> dict[str, Any]:
    limits = {f"{name}_{deviation.unit}": getattr(deviation, name) for name in LIMITS}
    return {"feature": deviation.feature, "kind": deviation.kind, **limits, "k": deviation.k} | {
        "verdict": deviation.verdict
    }


def _deviation_at(place: Place) -> Deviation:
    unit = next((u for u in UNITS if f"deviation_{u}" in place.object), None)
    if unit is None:
        raise place.error("has no deviation", 'write "deviation_mm", or "deviation_deg" for an angle')
    given: dict[str, Any] = {name: _optional(place, f"{name}_{unit}") for name in ("lower", "upper")}
    given |= {name: place.at(name).text() for name in ("kind", "verdict") if name in place.object}
    given |= {"k": place.at("k").number()} if "k" in place.object else {}
    given |= {name: place.at(f"{name}_{unit}").number() for name in ("deviation", "expanded_uncertainty")}
    return place.build(lambda: Deviation(place.at("feature").text(), unit=unit, **given))


def _finding_at(place: Place) -> Finding:
    return place.build(lambda: Finding(**{name: place.at(name).text() for name in _FINDING}))


def _source_at(place: Place) -> Source:
    return place.build(lambda: Source(place.at("role").text(), place.at("path").text(), place.at("sha256").text()))


def _optional(place: Place, key: str) -> float | None:
    return None if place.object.get(key) is None else place.at(key).number()


def _time(place: Place) -> datetime:
    try:
        time = datetime.fromisoformat(place.text())
    except ValueError:
        raise place.error(f"is {place.value!r}", "write 2026-03-02T12:00:00Z") from None
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time  # the key states UTC
