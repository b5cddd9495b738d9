"""The jobs of `cadcam station` on real input, but for measuring."""

from __future__ import annotations

import argparse
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING

from cadcam.cli.arguments import numbers
from cadcam.cli.cameras import read_any_camera
from cadcam.cli.output import check_target, print_json, print_tables, progress, say_written
from cadcam.cli.station.inputs import PictureSource, gray_picture, look_of, sightings, source
from cadcam.errors import BadValue, CadcamError, UnknownName, UnreadableFile

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cadcam.arrays import Array
    from cadcam.camera.camera import Camera
    from cadcam.files.pixels import ListedPixels
    from cadcam.files.shot import ShotPosition
    from cadcam.station.gantry import Repeatability
    from cadcam.station.plane import PlaneCalibration
    from cadcam.station.plate import Plate


def calibrate(arguments: argparse.Namespace) -> None:
    """Calibrate all positions of a camera; print, write."""
    from cadcam.report.station.tables import calibration_tables, map_tables
    from cadcam.station.document import read_plate, station_as_json, write_station
    from cadcam.station.gantry import calibrate_gantry
    from cadcam.station.survey import read_survey

    check_target(arguments.output, (".json",))
    plate = read_plate(arguments.plate)
    survey, given = read_survey(arguments.survey, plate), source(arguments)
    shots = {picture: given.shot(picture) for picture in given.pictures}
    camera = _one_camera(arguments.camera_name or "", shots)
    lens = read_any_camera(arguments.camera).camera if arguments.camera else None
    positions = []
    find = _Finder(arguments, given, plate, lens)
    with progress("finding the plate", len(shots)) as step:
        for picture, shot in shots.items():
            positions.append(_position(arguments, find, survey, picture, shot))
            step()
    station = calibrate_gantry(camera, positions, repeatability=_repeatability(arguments.repeatability))
    if arguments.output:
        write_station(arguments.output, station)
    if arguments.json:
        print_json(station_as_json(station))
    else:
        tables = calibration_tables(station)
        print_tables(tables + (map_tables([p.name for p in positions], station.map()) if len(positions) > 1 else []))
    say_written(arguments.output)


def map_deviations(arguments: argparse.Namespace) -> None:
    """Print, and draw, the mechanics' deviations."""
    from cadcam.report.station.tables import map_as_json, map_tables, pairs_table
    from cadcam.station.document import read_stations

    check_target(arguments.plot, (".svg", ".png", ".pdf"))
    stations = read_stations(arguments.stations)
    if arguments.reference and len(stations) > 1:
        raise BadValue("--reference", f"given with {len(stations)} stations", "one: a position is of one station")
    names = {camera: [position.name for position in station.positions] for camera, station in stations.items()}
    reference = None
    if arguments.reference:
        (positions,) = names.values()
        if arguments.reference not in positions:
            raise UnknownName("position", arguments.reference, positions)
        reference = positions.index(arguments.reference)
    maps = {camera: station.map(reference=reference) for camera, station in stations.items()}
    if arguments.plot:
        from cadcam.report.figures import write_figure
        from cadcam.report.station.plots import deviation_figure

        write_figure(arguments.plot, deviation_figure(stations, reference=reference))
    if arguments.json:
        print_json({"maps": [map_as_json(camera, names[camera], seen) for camera, seen in maps.items()]})
    else:
        for camera, seen in maps.items():
            if len(maps) > 1:
                print(f"camera {camera}\n")
            pairs = [pairs_table(names[camera], seen.split)] if arguments.pairs else []
            print_tables(map_tables(names[camera], seen) + pairs)
    say_written(arguments.plot)


def recalibrate(arguments: argparse.Namespace) -> None:
    """Subtract the error of one known mark from all positions."""
    from cadcam.report.station.tables import sighting_tables
    from cadcam.station.document import read_station, write_station
    from cadcam.station.interpolation import NEAR_MM
    from cadcam.station.measure import measure_marks

    check_target(arguments.output, (".json",))
    station = read_station(arguments.station_file)
    seen, _ = sightings(arguments, {station.camera: station})
    known = numbers("--known", arguments.known, 2, form="X,Y in mm")
    if len(seen) != 1:
        raise BadValue("marks for the re-calibration", len(seen), "one mark of known place")
    before = measure_marks(station, seen)
    off = [float(before.points[0, i] - known[i]) for i in (0, 1)]
    if hypot(*off) > NEAR_MM:  # beyond the reach of the calibrations: not a camera that was knocked
        stated = f"{arguments.known!r}, {hypot(*off):.0f} mm from where the mark is measured"
        raise BadValue("--known", stated, "X,Y of this mark, in mm and in the axes of the survey")
    after = station.recalibrated(seen[0], known, sigma_mm=arguments.known_sigma)
    if arguments.output:
        write_station(arguments.output, after)
    if arguments.json:
        print_json(
            {"camera": station.camera, "mark": seen[0].name, "off_mm": off, "sigma_mm": before.sigma[0, :2].tolist()}
        )
    else:
        print_tables(sighting_tables(before, seen)[:1])
        done = "taken off everywhere" if arguments.output else "give -o FILE to take it off everywhere"
        print(f"off by {off[0]:+.2f}, {off[1]:+.2f} mm (x, y): {done}")
    say_written(arguments.output)


def report(arguments: argparse.Namespace) -> None:
    """Write the HTML report."""
    from cadcam.report.station.page import StationReport, write_station_page
    from cadcam.station.document import read_stations
    from cadcam.station.drawing import trend_of_log
    from cadcam.station.log import read_log
    from cadcam.station.survey import read_drawing

    check_target(arguments.output, (".html",))
    stations = read_stations(arguments.stations)
    log = read_log(arguments.log) if arguments.log else []
    if arguments.drawing and not log:
        raise BadValue("--drawing", "given without a log", "--log too: its marks are compared with the drawing")
    together = trend_of_log(log, read_drawing(arguments.drawing)) if arguments.drawing else None
    write_station_page(arguments.output, StationReport(stations, log, together))
    if arguments.json:
        print_json({"output": arguments.output, "cameras": list(stations), "measurements": len(log)})
    say_written(arguments.output)


def _one_camera(given: str, shots: Mapping[str, ShotPosition]) -> str:
    said = {shot.camera: picture for picture, shot in shots.items() if shot.camera}
    if len(said) > 1:
        (one, a), (other, b) = list(said.items())[:2]
        raise BadValue("camera", f"{one!r} in {a} and {other!r} in {b}", "pictures of one camera")
    camera = next(iter(said), "")
    if given and camera and given != camera:
        raise BadValue("--camera-name", repr(given), f"{camera!r}, which took {said[camera]}")
    if not (given or camera):
        raise BadValue("--camera-name", "not given, and the pictures do not say it", "the camera's name")
    return given or camera


class _Finder:
    """Finds the plate in one picture after the other; the first one gives the size of its marks for the others."""

    def __init__(self, arguments: argparse.Namespace, given: PictureSource, plate: Plate, lens: Camera | None) -> None:
        self.plate, self.lens, self._given, self._arguments = plate, lens, given, arguments
        self._radius: float | None = None

    def __call__(self, picture: str) -> tuple[Array, float | None, str]:
        """Return the plate's pixels in its order, their noise, and the hash of the file they came from."""
        if self._given.pixels is not None:
            return *self._listed(self._given.pixels, picture), self._given.pixels.sha256
        from cadcam.station.marks import find_plate

        gray, sha256 = gray_picture(picture, self._given.white)
        found = find_plate(gray, self.plate, look_of(self._arguments, self.plate, self._radius), lens=self.lens)
        self._radius = found.radius_px
        stated = self._arguments.sigma
        return found.q, found.sigma_px if stated is None else stated, sha256

    def _listed(self, pixels: ListedPixels, picture: str) -> tuple[Array, float | None]:
        import numpy as np

        names = self.plate.mark_names
        q = np.full((len(names), 2), np.nan)
        for mark, pixel in zip(pixels.names, pixels.q[pixels.views.index(picture)], strict=True):
            if np.isfinite(pixel).all():
                if mark not in names:
                    raise UnknownName("mark of the plate", mark, names)
                q[names.index(mark)] = pixel
        return q, self._arguments.sigma


def _position(
    arguments: argparse.Namespace, find: _Finder, survey: Mapping[str, Array], picture: str, shot: ShotPosition
) -> PlaneCalibration:
    """Return the calibration of one position; errors in its picture name the picture."""
    from cadcam.station.plane import calibrate_position, refuse_misfit
    from cadcam.station.plate import place_plate

    name = Path(picture).name
    if name not in survey:
        raise UnreadableFile(arguments.survey, f"has no reflectors for {name}", "survey the plate at every position")
    try:
        q, sigma, sha256 = find(picture)
        placement = place_plate(find.plate, survey[name], sigma_mm=arguments.survey_sigma)
        at = (shot.x, shot.y)
        one = calibrate_position(name, at, q, placement, sigma_px=sigma, lens=find.lens, source=picture, sha256=sha256)
        refuse_misfit(one, limit_px=arguments.limit)
    except UnreadableFile:
        raise
    except CadcamError as error:
        raise UnreadableFile(picture, str(error)) from error
    return one


def _repeatability(text: str | None) -> Repeatability | None:
    from cadcam.station.gantry import Repeatability

    if text is None:
        return None
    values = numbers("--repeatability", text)
    if len(values) > 2:
        raise BadValue("--repeatability", repr(text), "one number in mm, or two for x and y")
    return Repeatability.stated(values[0], values[-1])
