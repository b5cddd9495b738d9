"""The results of a station: a line per mark in its log, and records in the store of product state.

The log is JSON lines, which are added and never changed; once `append_log` has returned, its lines are on disk.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cadcam import __version__
from cadcam.arrays import Floats
from cadcam.camera.measurement import Measurement
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import UnreadableFile, UnwritableFile
from cadcam.files.jsontext import parsed_line, split_lines
from cadcam.files.text import read_text
from cadcam.geometry.rigid import Rigid
from cadcam.record.record import Deviation, Record
from cadcam.station.budget import budget_of
from cadcam.station.gantry import Sighting
from cadcam.whole import utf8

_K = 2.0
_LONGEST = 1 << 20  # bytes of a line, beyond any of a log


def log_entries(
    measured: Measurement, sightings: Sequence[Sighting], *, times: Sequence[datetime | None] = (), block: str = ""
) -> list[dict[str, Any]]:
    """Return a log entry for each measured mark: its place, the uncertainty and its causes, and how it was measured."""
    whole, sigma, half = measured.covariance, measured.sigma, measured.half_width()
    when = list(times) or [None] * len(sightings)
    return [
        {
            "time": (t or datetime.now(UTC)).isoformat(),
            "block": block,
            "mark": s.name,
            "camera": s.camera,
            "camera_position_mm": s.position.tolist(),
            "pixel_px": s.q.tolist(),
            "picture": s.picture,
            "point_mm": measured.points[i, :2].tolist(),
            "sigma_mm": sigma[i, :2].tolist(),
            "half_width_95_mm": half[i, :2].tolist(),
            "covariance_mm2": whole[i, :2, :2].tolist(),
            "budget_mm": dict(budget_of(measured, s.name).contributions),
            "method": measured.method,
            "software": f"cadcam {__version__}",
        }
        for i, (s, t) in enumerate(zip(sightings, when, strict=True))
    ]


def append_log(path: str | os.PathLike[str], entries: Sequence[Mapping[str, Any]]) -> None:
    """Append entries to a log, all of them or none, and flush them to disk; create the log if necessary.

    Raises `UnreadableFile`, and adds nothing, where the file is something else: a drawing, a list of pixels.
    """
    refuse_no_log(path)
    data = utf8("".join(json.dumps(entry, ensure_ascii=False) + "\n" for entry in entries))
    try:
        handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            _append(handle, data)
        finally:
            os.close(handle)
    except OSError as error:
        raise UnwritableFile(path, error.strerror or str(error), "choose a place you may write to") from error


def refuse_no_log(path: str | os.PathLike[str]) -> None:
    """Raise `UnreadableFile` where lines of a log would be added to a file that does not begin as one."""
    if not Path(path).is_file():  # none yet, or a pipe
        return
    try:
        with Path(path).open("rb") as file:
            first = file.readline(_LONGEST).strip()
    except OSError:  # what writing to it will tell
        return
    if first and not (first.startswith(b"{") and b'"mark"' in first and b'"point_mm"' in first):
        raise UnreadableFile(path, "is no log of a station, and would be spoilt", "name a new file, or the right log")


def _append(handle: int, data: bytes) -> None:
    """Write all of the data; if the disk is full, truncate what was written, so that no reader meets half a line."""
    before, left = os.fstat(handle).st_size, memoryview(data)
    try:
        while left:
            left = left[os.write(handle, left) :]
        os.fsync(handle)
    except OSError:
        if os.fstat(handle).st_size == before + len(data) - len(left):  # else another program has appended meanwhile
            with suppress(OSError):
                os.ftruncate(handle, before)
        raise


def read_log(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Return the entries of a log, oldest first. Raises `UnreadableFile` naming the line."""
    out: list[dict[str, Any]] = []
    for number, line in enumerate(split_lines(read_text(path).text), start=1):
        if not line.strip():
            continue
        place = parsed_line(path, number, line)
        entry = place.object
        if "point_mm" not in entry or "mark" not in entry:
            raise UnreadableFile(path, f"line {number} is no measurement of a station", "is it the right log?")
        place.at("mark").text()
        for key in ("point_mm", "half_width_95_mm"):
            if key in entry:
                place.at(key).array((2,))
        out.append(entry)
    return out


def records(
    measured: Measurement,
    sightings: Sequence[Sighting],
    *,
    part: str = "mark",
    serial: str = "",
    times: Sequence[datetime | None] = (),
    drawn: Mapping[str, Floats] | None = None,
) -> list[Record]:
    """Return a product-state record for each measured mark, with its deviation in x and y where it is on the drawing.

    The record's pose is the mark's place on the floor: only translations along x and y are known of it.
    """
    when = list(times) or [None] * len(sightings)
    return [
        Record(
            part=part,
            serial=serial,
            station=f"camera {s.camera}",
            time=t or datetime.now(UTC),
            pose=_pose(measured, i),
            reason=f"mark {s.name} measured by camera {s.camera}",
            deviations=_deviations(measured, i, (drawn or {}).get(s.name)),
        )
        for i, (s, t) in enumerate(zip(sightings, when, strict=True))
    ]


def _pose(measured: Measurement, i: int) -> PoseEstimate:
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = measured.covariance[i, :2, :2]
    return PoseEstimate(Rigid(np.eye(3), measured.points[i]), covariance, freedom=np.eye(6)[:, :2])


def _deviations(measured: Measurement, i: int, drawn: Floats | None) -> tuple[Deviation, ...]:
    if drawn is None:
        return ()
    off = measured.points[i, :2] - np.asarray(drawn, dtype=np.float64)[:2]
    sigma, name = measured.sigma[i], measured.names[i]
    return tuple(Deviation(name, float(off[a]), float(_K * sigma[a]), kind=f"position {'xy'[a]}", k=_K) for a in (0, 1))
