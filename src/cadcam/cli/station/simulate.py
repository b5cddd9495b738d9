"""`cadcam station simulate`: the whole procedure on a simulated hall, its files left for the other jobs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import refuse
from cadcam.cli.output import print_json, print_tables, say, working
from cadcam.errors import BadValue, UnwritableFile

if TYPE_CHECKING:
    import numpy as np

    from cadcam.report.table import Table
    from cadcam.station.gantry import GantryCalibration
    from cadcam.station.hall import Hall
    from cadcam.station.simulate import Calibrated, DistanceErrors

_LONGEST = 30_000.0


def simulate(arguments: argparse.Namespace) -> None:
    """Make the hall, calibrate it, measure in it, report the errors; write its files."""
    import numpy as np

    from cadcam.station.simulate import calibrate_robot, day, distances, write_day

    _check_options(arguments)
    rng = np.random.default_rng(arguments.seed)
    hall = _hall(arguments, rng)
    folder = _folder(arguments.folder)
    with working("calibrating the hall"):
        found = {
            name: calibrate_robot(hall, name, rng, pictures=folder if arguments.render else None)
            for name in hall.gantries
        }
        stations = {name: one.station for name, one in found.items()}
        work = day(hall, rng, marks=arguments.marks)
        cover = distances(stations, work, rule=arguments.rule, longest_mm=_LONGEST)
    if folder is not None:
        _write(folder, hall, stations)
        write_day(folder, hall, work, rng, pictures=arguments.render)
    if arguments.json:
        print_json(_as_json(found, cover))
    else:
        print_tables([_map_table(found), _cover_table(cover)])
    if folder is not None:
        say(f"wrote plate, surveys, pixels, stations and a day's marks into {folder}")


def _check_options(arguments: argparse.Namespace) -> None:
    if not 4 <= arguments.marks <= 10_000:
        raise BadValue("--marks", arguments.marks, "4 to 10000")
    for option, value in (
        ("--deflection", arguments.deflection),
        ("--survey-sigma", arguments.survey_sigma),
        ("--sigma", arguments.sigma),
    ):
        if value < 0:
            raise BadValue(option, value, "0 or more")
    if arguments.folder is None:
        refuse(arguments, "--render", why="without a folder", expected="a folder to write them to")
    if not arguments.render:
        through = "both: only a picture goes through a sensor"
        refuse(arguments, "--sensor", why="without --render", expected=through)


def _hall(arguments: argparse.Namespace, rng: np.random.Generator) -> Hall:
    from cadcam.files.sensor import named_sensor
    from cadcam.station.hall import SENSOR, make_hall

    return make_hall(
        rng,
        robots=arguments.robots,
        deflection_mm=arguments.deflection,
        survey_mm=arguments.survey_sigma,
        noise_px=arguments.sigma,
        sensor=named_sensor(arguments.sensor) if arguments.sensor else SENSOR,
    )


def _write(folder: Path, hall: Hall, stations: dict[str, GantryCalibration]) -> None:
    from cadcam.station.document import write_plate, write_station
    from cadcam.station.simulate import write_inputs

    write_plate(folder / "plate.json", hall.plate)
    for name, station in stations.items():
        write_station(folder / f"station_{name}.json", station)
        write_inputs(folder, station)


def _folder(name: str | None) -> Path | None:
    if name is None:
        return None
    try:
        Path(name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnwritableFile(name, error.strerror or str(error), "name another folder") from error
    return Path(name)


def _map_table(found: dict[str, Calibrated]) -> Table:
    import numpy as np

    from cadcam.report.table import Table

    rows = []
    for name, one in found.items():
        seen = one.station.map()
        off, predicted = np.sqrt(np.mean(one.map_error**2)), np.sqrt(np.mean(seen.sigma**2))
        vision, expected = (", ".join(f"{v:.3f}" for v in values) for values in (seen.vision, seen.predicted))
        rows.append((name, f"{seen.split.worst:.2f}", f"{off:.3f}", f"{predicted:.3f}", vision, expected))
    columns = (
        "camera",
        "mechanics, worst mm",
        "map's error, rms mm",
        "stated sigma mm",
        "vision x, y mm",
        "expected mm",
    )
    return Table("Mechanics and vision, told apart, beside the truth", columns, tuple(rows), columns[:1])


def _cover_table(cover: DistanceErrors) -> Table:
    import numpy as np

    from cadcam.report.table import Table

    rows = (
        ("distances", f"{len(cover.error)}, of {cover.length.min() / 1000:.1f} to {cover.length.max() / 1000:.1f} m"),
        ("error, rms", f"{np.sqrt(np.mean(cover.error**2)):.2f} mm"),
        ("stated half width of 95 %, median", f"{np.median(cover.half_width):.2f} mm"),
        ("within what is stated", f"{100 * cover.within:.1f} %"),
    )
    return Table("A day's distances beside the truth", ("", ""), rows, ("",))


def _as_json(found: dict[str, Calibrated], cover: DistanceErrors) -> dict[str, Any]:
    import numpy as np

    maps = {
        name: {
            "map_error_rms_mm": float(np.sqrt(np.mean(one.map_error**2))),
            "map_sigma_rms_mm": float(np.sqrt(np.mean(one.station.map().sigma ** 2))),
            "worst_mm": one.station.map().split.worst,
            "vision_mm": one.station.map().vision.tolist(),
        }
        for name, one in found.items()
    }
    return {
        "cameras": maps,
        "distances": len(cover.error),
        "error_rms_mm": float(np.sqrt(np.mean(cover.error**2))),
        "half_width_95_median_mm": float(np.median(cover.half_width)),
        "within": cover.within,
    }
