"""The whole procedure in a simulated hall, compared with its truth: calibrate, map, measure (6.4.3.4 to 6.4.3.6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cadcam.arrays import Array, Floats
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.errors import TooFewPoints
from cadcam.files.shot import ShotPosition, write_positions
from cadcam.files.text import rows_of_cells
from cadcam.image.picture import read_picture, to_gray
from cadcam.station.gantry import GantryCalibration, Repeatability, Sighting, calibrate_gantry
from cadcam.station.hall import Hall, Visit
from cadcam.station.hall_picture import write_hall_picture
from cadcam.station.interpolation import Rule
from cadcam.station.marks import MarkLook, find_plate
from cadcam.station.measure import measure_marks, repeatability
from cadcam.station.plane import calibrate_position
from cadcam.station.plate import place_plate
from cadcam.station.survey import write_drawing, write_survey
from cadcam.target.marks.mark import parse_mark
from cadcam.whole import write_whole

_REPEATED, _VISITS = 5, 6  # marks, and visits of each, from which the repeatability is estimated
_PIXELS = ("name", "view", "x_px", "y_px")
_WITHIN = 250.0  # mm: largest distance of the daily mark from the centre of the view


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A calibrated gantry, and where its views truly were: deviations (N, 2) mm at the visits of the calibration."""

    station: GantryCalibration
    deviations: Array

    @property
    def map_error(self) -> Array:
        """Return the error (N, 2) mm of the station's deviation map, relative to its mean."""
        true = self.deviations - self.deviations.mean(axis=0)
        return np.asarray(self.station.map().deviation - true)


@dataclass(frozen=True, slots=True, eq=False)
class Day:
    """Marks sighted in a day's work, and their true places, (n, 2) mm."""

    sightings: tuple[Sighting, ...]
    points: Array


@dataclass(frozen=True, slots=True, eq=False)
class DistanceErrors:
    """Distances measured between marks: true length, error and half the stated 95 % interval, each (n,) mm."""

    length: Array
    error: Array
    half_width: Array

    @property
    def within(self) -> float:
        """Return the share of distances whose error is within the stated interval."""
        return float(np.mean(np.abs(self.error) <= self.half_width))


def calibrate_robot(
    hall: Hall,
    name: str,
    rng: np.random.Generator,
    *,
    columns: int = 3,
    rows: int = 5,
    jitter_mm: float = 100.0,
    pictures: Path | None = None,
) -> Calibrated:
    """Return the calibration of one robot: the plate laid, surveyed and pictured at columns x rows positions.

    The repeatability is estimated as in a real hall: from marks seen on several visits. pictures: a folder to which
    each plate's picture is rendered, for its marks to be found; without it their pixels are computed, with noise.
    """
    positions, true = [], []
    for k, at in enumerate(hall.gantry(name).grid(columns, rows, jitter_mm=jitter_mm, rng=rng)):
        visit = hall.visit(rng)
        marks, reflectors = hall.survey(*hall.lay_plate(name, at, rng), rng)
        placement = place_plate(hall.plate, reflectors, sigma_mm=hall.survey_mm)
        picture = f"plate_{name}_{k + 1:02d}.pgm"
        if pictures is None:
            q, sigma = hall.seen(name, at, marks, visit, rng), hall.noise_px
        else:
            q, sigma = _pictured(pictures / picture, hall, _shot(at, name), marks, visit, rng)
        positions.append(calibrate_position(picture, at, q, placement, sigma_px=sigma, lens=_lens(hall)))
        true.append(hall.deviation(name, at, visit))
    first = calibrate_gantry(name, positions)
    again = repeat_visits(hall, first, rng)
    return Calibrated(calibrate_gantry(name, positions, repeatability=again), np.stack(true))


def repeat_visits(hall: Hall, station: GantryCalibration, rng: np.random.Generator) -> Repeatability:
    """Return the repeatability by marks each seen on several visits."""
    grid, seen = station.grid, []
    for i in range(_REPEATED):
        at = grid[(i * len(grid)) // _REPEATED]
        p = hall.view_centre(station.camera, at)[None]
        for _ in range(_VISITS):
            q = hall.seen(station.camera, at, p, hall.visit(rng), rng)[0]
            seen.append(Sighting.of(f"repeat {i}", station.camera, at, q, sigma_px=hall.noise_px))
    return repeatability(station, seen)


def sight(hall: Hall, name: str, camera: str, position: Floats, p: Floats, rng: np.random.Generator) -> Sighting:
    """Return how a camera sees a mark at the floor point p (2,) on one visit to a position."""
    q = hall.seen(camera, position, np.asarray(p, dtype=np.float64)[None], hall.visit(rng), rng)[0]
    return Sighting.of(name, camera, position, q, sigma_px=hall.noise_px)


def day(hall: Hall, rng: np.random.Generator, *, marks: int) -> Day:
    """Return marks seen anywhere in the work area, each by a random robot, not quite in the centre of its view."""
    sightings, points = [], []
    for i in range(marks):
        name = str(rng.choice(sorted(hall.gantries)))
        x0, x1, y0, y1 = hall.gantry(name).area
        at = np.round(np.array([rng.uniform(x0 + 100, x1 - 100), rng.uniform(y0 + 100, y1 - 100)]), 1)
        p = hall.view_centre(name, at) + rng.uniform(-_WITHIN, _WITHIN, 2)
        points.append(p)
        sightings.append(sight(hall, f"mark{i + 1:02d}", name, at, p, rng))
    return Day(tuple(sightings), np.stack(points))


def distances(
    stations: Mapping[str, GantryCalibration], work: Day, *, rule: Rule = "smooth", longest_mm: float = 30_000.0
) -> DistanceErrors:
    """Return the distances between the marks of a day's work, two by two in their order, with the true ones.

    Those longer than `longest_mm` are left out. Raises `TooFewPoints` where all are.
    """
    measured = measure_marks(stations, work.sightings, rule=rule)
    pairs, lengths = [], []
    for i in range(0, len(work.points) - 1, 2):  # no mark is in two distances: their errors are nearly independent
        true = float(np.linalg.norm(work.points[i + 1] - work.points[i]))
        if 0 < true <= longest_mm:
            pairs.append((work.sightings[i].name, work.sightings[i + 1].name))
            lengths.append(true)
    if not pairs:
        raise TooFewPoints("a day's work", 0, 1, of=f"distances up to {longest_mm:g} mm")
    found, true_lengths = measured.distances(pairs), np.array(lengths)
    errors = np.array([d.value for d in found]) - true_lengths
    return DistanceErrors(true_lengths, errors, np.array([d.half_width for d in found]))


def write_inputs(folder: Path, station: GantryCalibration) -> None:
    """Write what a calibration was made from as files that `cadcam station calibrate` reads, named by its camera."""
    fits = {one.name: one for one in station.positions}
    rows = [
        (name, view, repr(x), repr(y))
        for view, one in fits.items()
        for name, (x, y) in zip(one.estimate.observations.names, one.pixels.tolist(), strict=True)
    ]
    write_whole(folder / f"plate_{station.camera}_pixels.csv", rows_of_cells(_PIXELS, rows))
    plate = station.positions[0].placement.plate
    surveyed = {view: one.placement.surveyed for view, one in fits.items()}
    write_survey(folder / f"survey_{station.camera}.csv", plate, surveyed)
    shots = {view: _shot(one.position, station.camera) for view, one in fits.items()}
    write_positions(folder / f"positions_{station.camera}.csv", shots)


def write_day(folder: Path, hall: Hall, work: Day, rng: np.random.Generator, *, pictures: bool = False) -> None:
    """Write a day's marks as pixels with positions, their true places as a drawing, and pictures if asked to."""
    shots, rows = {}, []
    for s, p in zip(work.sightings, work.points, strict=True):
        file = f"{s.name}.pgm"
        shots[file] = _shot(s.position, s.camera)
        rows.append((s.name, file, *(repr(v) for v in s.q.tolist())))
        if pictures:
            write_hall_picture(folder / file, hall, shots[file], p[None], hall.visit(rng), rng)
    write_whole(folder / "day_pixels.csv", rows_of_cells(_PIXELS, rows))
    write_positions(folder / "day_positions.csv", shots)
    write_drawing(folder / "day_truth.csv", {s.name: p for s, p in zip(work.sightings, work.points, strict=True)})


def _pictured(
    path: Path, hall: Hall, shot: ShotPosition, marks: Array, visit: Visit, rng: np.random.Generator
) -> tuple[Array, float]:
    """Return the plate's pixels found in its rendered picture, and their noise."""
    write_hall_picture(path, hall, shot, marks, visit, rng)
    found = find_plate(to_gray(read_picture(path)), hall.plate, MarkLook(parse_mark(hall.plate.mark)), lens=_lens(hall))
    return found.q, found.sigma_px


def _lens(hall: Hall) -> Camera | None:
    """Return the camera whose distortion is to be removed; None if it has none."""
    return None if isinstance(hall.camera.lens, Ideal) else hall.camera


def _shot(position: Array, camera: str) -> ShotPosition:
    return ShotPosition(float(position[0]), float(position[1]), camera)
