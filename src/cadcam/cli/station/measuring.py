"""`cadcam station measure`: marks measured, compared with the drawing, logged and stored."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import refuse
from cadcam.cli.output import check_target, print_json, print_tables, say, say_written
from cadcam.cli.station.inputs import sightings
from cadcam.errors import BadValue
from cadcam.whole import write_whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from datetime import datetime

    from cadcam.arrays import Array
    from cadcam.camera.measurement import Measurement
    from cadcam.station.drawing import DifferenceTrend, DistanceCheck
    from cadcam.station.gantry import GantryCalibration, Sighting


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Measured marks, their sightings and times, the stations, and where the drawing has marks; block: its name."""

    marks: Measurement
    seen: Sequence[Sighting]
    times: Sequence[datetime | None]
    stations: Mapping[str, GantryCalibration]
    drawn: Mapping[str, Array]
    block: str


def measure_marks(arguments: argparse.Namespace) -> None:
    """Measure marks; print, compare with the drawing, log."""
    from cadcam.station.log import log_entries

    _refuse_unused(arguments)
    measured = _measured(arguments)
    checks, together = _against_drawing(measured, arguments.between)
    entries = log_entries(measured.marks, measured.seen, times=measured.times, block=measured.block)
    _write(arguments, measured, entries, checks)  # before printing: the reader of the tables may close the pipe
    if arguments.json:
        print_json({"measured": entries, "distances": [_check_as_json(c) for c in checks]})
    else:
        _print(arguments, measured, checks, together)


def _refuse_unused(arguments: argparse.Namespace) -> None:
    from cadcam.station.log import refuse_no_log

    check_target(arguments.csv, (".csv",))
    if arguments.log:
        refuse_no_log(arguments.log)
    if not arguments.drawing:
        refuse(
            arguments, "--between", "--csv", why="without --drawing", expected="--drawing FILE with the marks' places"
        )
    if not (arguments.log or arguments.store):
        refuse(arguments, "--block", why="where nothing is kept", expected="--log FILE or --store FILE beside it")


def _measured(arguments: argparse.Namespace) -> _Measured:
    from cadcam.station import measure
    from cadcam.station.document import read_stations
    from cadcam.station.survey import read_drawing

    stations = read_stations(arguments.station_file)
    seen, shots = sightings(arguments, stations)
    _refuse_twice(seen)
    marks = measure.measure_marks(stations, seen, rule=arguments.rule, extrapolate=arguments.extrapolate)
    drawn = read_drawing(arguments.drawing) if arguments.drawing else {}
    return _Measured(marks, seen, [shot.time for shot in shots], stations, drawn, arguments.block or "")


def _refuse_twice(seen: Sequence[Sighting]) -> None:
    names = [s.name for s in seen]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise BadValue("mark", f"{twice[0]!r} seen twice", "each mark in one picture of its name")


def _against_drawing(
    measured: _Measured, of: Sequence[tuple[str, str]]
) -> tuple[tuple[DistanceCheck, ...], DifferenceTrend | None]:
    """Return the distances between pairs of marks, of all by default, and the trend of those without a common mark."""
    from cadcam.station.drawing import check_distances, independent, trend

    if not measured.drawn:
        return (), None
    checks = check_distances(measured.marks, measured.drawn, of or None)
    apart = independent(checks)
    return checks, trend([c.difference for c in apart], [c.drawn for c in apart]) if len(apart) >= 3 else None


def _write(
    arguments: argparse.Namespace,
    measured: _Measured,
    entries: Sequence[Mapping[str, Any]],
    checks: Sequence[DistanceCheck],
) -> None:
    """Write log, store and distances, where asked for."""
    from cadcam.report.station.tables import distances_csv
    from cadcam.station.log import append_log

    if arguments.log:
        append_log(arguments.log, entries)
        say(f"added {len(entries)} lines to {arguments.log}")
    if arguments.store:
        _keep(arguments.store, measured)
    if arguments.csv:
        write_whole(arguments.csv, distances_csv(checks).encode())
        say_written(arguments.csv)


def _keep(file: str, measured: _Measured) -> None:
    from cadcam.record.store import open_store
    from cadcam.station.log import records

    with open_store(file) as store:
        kept = records(
            measured.marks,
            measured.seen,
            part="coupling mark",
            serial=measured.block,
            times=measured.times,
            drawn=measured.drawn,
        )
        store.add(*kept)
        say(f"added {len(kept)} records to {store.name}")


def _print(
    arguments: argparse.Namespace,
    measured: _Measured,
    checks: Sequence[DistanceCheck],
    together: DifferenceTrend | None,
) -> None:
    from cadcam.report.station.tables import distance_tables, estimates_table, sighting_tables
    from cadcam.station.measure import estimates

    print_tables(sighting_tables(measured.marks, measured.seen))
    if arguments.explain:
        how = {"rule": arguments.rule, "extrapolate": arguments.extrapolate}
        each = [(s.name, estimates(measured.stations[s.camera], s, **how)) for s in measured.seen]
        print_tables([estimates_table(name, found) for name, found in each])
    if checks:
        print_tables(distance_tables(checks, together))


def _check_as_json(check: DistanceCheck) -> dict[str, Any]:
    import numpy as np

    return {
        "of": [check.one, check.other],
        "measured_mm": check.measured,
        "half_width_95_mm": check.half_width,
        "drawn_mm": check.drawn,
        "difference_mm": check.difference,
        "angle_deg": float(np.degrees(check.angle)),
    }
