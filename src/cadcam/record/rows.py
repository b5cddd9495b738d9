"""Records as rows of the tables, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC
from typing import Any

import numpy as np

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.files.jsontext import or_null
from cadcam.geometry.rigid import Rigid
from cadcam.record.record import LIMITS, PLACE, ROTATION, UNITS, Deviation, Finding, Record, Source

Row = dict[str, Any]
_PLAIN = ("id", "part", "serial", "station", "verdict", "reason", "quality", "software")
SUMMARY = ("id", "time_utc", "part", "serial", "station", "verdict", "reason")


def measurement_row(record: Record) -> Row:
    """Return the row of table measurement."""
    row: Row = {name: getattr(record, name) for name in _PLAIN}
    row["time_utc"] = record.time.replace(tzinfo=None)
    pose = record.pose
    if pose is None:
        return row | dict.fromkeys((*PLACE, *ROTATION, "uncertainty_mm_rad"))
    T = pose.world_from_part
    row |= dict(zip((*PLACE, *ROTATION), [*T.translation.tolist(), *T.rotation.ravel().tolist()], strict=True))
    row["uncertainty_mm_rad"] = {
        "from_noise": pose.from_noise.tolist(),
        "from_calibration": pose.from_calibration.tolist(),
        "freedom": pose.freedom.tolist(),
        "degrees_of_freedom": or_null(pose.dof),
        "undetermined": pose.undetermined.tolist(),
    }
    return row


def deviation_rows(record: Record) -> list[Row]:
    """Return the rows of table deviation."""
    return [
        {"measurement_id": record.id, "place": place, "feature": d.feature, "kind": d.kind, "verdict": d.verdict}
        | {"k": d.k}
        | {f"{name}_{unit}": getattr(d, name) if unit == d.unit else None for unit in UNITS for name in LIMITS}
        for place, d in enumerate(record.deviations)
    ]


def finding_rows(record: Record) -> list[Row]:
    """Return the rows of table finding."""
    return [
        {"measurement_id": record.id, "place": place, "feature": f.feature, "kind": f.kind, "verdict": f.verdict}
        | {"reason": f.reason}
        for place, f in enumerate(record.findings)
    ]


def source_rows(record: Record) -> list[Row]:
    """Return the rows of table source."""
    return [
        {"measurement_id": record.id, "place": place, "role": s.role, "path": s.path, "sha256": s.sha256}
        for place, s in enumerate(record.sources)
    ]


def record_of(
    row: Mapping[str, Any],
    deviations: Iterable[Mapping[str, Any]],
    findings: Iterable[Mapping[str, Any]],
    sources: Iterable[Mapping[str, Any]],
) -> Record:
    """Return the record of a row of table measurement and the rows that belong to it, in order."""
    return Record(
        **{name: row[name] for name in _PLAIN},
        time=row["time_utc"].replace(tzinfo=UTC),
        pose=_pose(row),
        deviations=tuple(_deviation(d) for d in deviations),
        findings=tuple(_finding(f) for f in findings),
        sources=tuple(Source(s["role"], s["path"], s["sha256"]) for s in sources),
    )


def summary_of(
    row: Mapping[str, Any], deviations: Iterable[Mapping[str, Any]], findings: Iterable[Mapping[str, Any]]
) -> Record:
    """Return the record of the columns `SUMMARY` of a row, with these deviations and findings, without its pose."""
    return Record(
        **{name: row[name] for name in SUMMARY if name != "time_utc"},
        time=row["time_utc"].replace(tzinfo=UTC),
        deviations=tuple(_deviation(d) for d in deviations),
        findings=tuple(_finding(f) for f in findings),
        software="",
    )


def _pose(row: Mapping[str, Any]) -> PoseEstimate | None:
    if row["x_mm"] is None:
        return None
    sure = row["uncertainty_mm_rad"]
    dof = sure["degrees_of_freedom"]
    return PoseEstimate(
        Rigid(np.array([row[name] for name in ROTATION]).reshape(3, 3), np.array([row[name] for name in PLACE])),
        np.array(sure["from_noise"]),
        np.array(sure["from_calibration"]),
        np.array(sure["freedom"]).reshape(6, -1),
        np.inf if dof is None else dof,
        np.array(sure.get("undetermined", [[]] * 6)).reshape(6, -1),  # older records have none
    )


def _deviation(row: Mapping[str, Any]) -> Deviation:
    unit = next((unit for unit in UNITS if row[f"deviation_{unit}"] is not None), UNITS[0])  # of a damaged row neither
    values = {name: row[f"{name}_{unit}"] for name in LIMITS}
    return Deviation(row["feature"], kind=row["kind"], unit=unit, k=row["k"], verdict=row["verdict"], **values)


def _finding(row: Mapping[str, Any]) -> Finding:
    return Finding(row["feature"], row["kind"], row["verdict"], row["reason"])
