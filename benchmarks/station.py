"""A station in a simulated hall: separation of mechanics and vision, errors of distances against their sigmas, speed.

    python benchmarks/station.py [--halls 14] [--marks 60] [--only split|distances|speed]

Halls: four robots of 8.5 x 9.5 m, 15 positions each, 20 mm of deflection that is about as rough as Table 6.11's.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from cadcam.arrays import Array
from cadcam.station.gantry import GantryCalibration, Sighting
from cadcam.station.hall import Hall, Visit, make_hall
from cadcam.station.hall_picture import hall_picture
from cadcam.station.interpolation import RULES
from cadcam.station.marks import MarkLook, find_mark, find_plate
from cadcam.station.measure import measure_marks
from cadcam.station.plane import calibrate_position
from cadcam.station.plate import place_plate
from cadcam.station.simulate import calibrate_robot, day, distances
from cadcam.target.marks.mark import parse_mark

_LONGEST = 30_000.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--halls", type=int, default=14)
    parser.add_argument("--marks", type=int, default=60, help="of a day's work in each hall")
    parser.add_argument("--only", choices=("split", "distances", "speed"))
    arguments = parser.parse_args()
    if arguments.only in (None, "split"):
        split_table(arguments.halls)
    if arguments.only in (None, "distances"):
        distance_table(arguments.halls, arguments.marks)
    if arguments.only in (None, "speed"):
        speed_table()


def split_table(halls: int) -> None:
    """Print how well the map of the mechanics is found, by the surveyor's noise."""
    print(
        "\n| survey mm | deflection found mm | map error rms mm | worst hall | error / sigma | vision mm | expected |"
    )
    print("|---|---|---|---|---|---|---|")
    for survey in (0.05, 0.1, 0.2):
        rms, z, worst, vision, expected = [], [], [], [], []
        for seed in range(halls):
            rng = np.random.default_rng(seed)
            hall = make_hall(rng, robots=("6",), survey_mm=survey)
            one = calibrate_robot(hall, "6", rng)
            seen = one.station.map()
            rms.append(float(np.sqrt(np.mean(one.map_error**2))))
            z.append(one.map_error / seen.sigma)
            worst.append(seen.split.worst)
            vision.append(seen.vision)
            expected.append(seen.predicted)
        ratio = np.sqrt(np.mean(np.square(z)))
        said, told = (np.sqrt(np.mean(np.square(v))) for v in (vision, expected))
        print(
            f"| {survey} | {np.mean(worst):.1f} | {np.sqrt(np.mean(np.square(rms))):.3f} | {max(rms):.3f} | "
            f"{ratio:.2f} | {said:.3f} | {told:.3f} |"
        )


def distance_table(halls: int, marks: int) -> None:
    """Print how many distances lie within what is stated, by the rule of interpolation."""
    covers: dict[str, list[tuple[Array, Array]]] = {rule: [] for rule in RULES}
    for seed in range(halls):
        rng = np.random.default_rng(9000 + seed)
        hall = make_hall(rng)
        stations = {name: calibrate_robot(hall, name, rng).station for name in hall.gantries}
        work = day(hall, rng, marks=marks)
        for rule in RULES:
            cover = distances(stations, work, rule=rule, longest_mm=_LONGEST)
            covers[rule].append((cover.error, cover.half_width))
    print(
        "\n| rule | distances | error rms mm | stated half width (95 %), median mm | within | by hall, least to most |"
    )
    print("|---|---|---|---|---|---|")
    for name, parts in covers.items():
        error, half = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
        within = np.abs(error) <= half
        each = [float(np.mean(np.abs(e) <= h)) for e, h in parts]
        print(
            f"| {name} | {len(error)} | {np.sqrt(np.mean(error**2)):.2f} | {np.median(half):.2f} | "
            f"{100 * np.mean(within):.1f} % | {100 * min(each):.0f} to {100 * max(each):.0f} % |"
        )


def speed_table() -> None:
    """Print what the daily job and a robot's calibration cost, CPU time in this process."""
    rng = np.random.default_rng(3)
    hall = make_hall(rng, robots=("6",))
    station = calibrate_robot(hall, "6", rng).station
    look = MarkLook(parse_mark(hall.plate.mark), station.radius_px(60.0))
    at = np.array([7400.0, 16100.0])
    p = hall.view_centre("6", at)[None] + 40.0
    one = hall_picture(hall, "6", at, p, Visit(), rng)

    def daily() -> None:
        q, covariance = find_mark(one, look)
        measure_marks(station, [Sighting("A", "6", at, q, covariance)])

    def finding() -> None:
        find_mark(one, look)

    pictures = _plates(hall, station, rng)
    known = MarkLook(look.mark)

    def calibrating() -> None:
        radius = known
        positions = []
        for k, (place, picture, reflectors) in enumerate(pictures):
            found = find_plate(picture, hall.plate, radius)
            radius = MarkLook(look.mark, found.radius_px)
            placement = place_plate(hall.plate, reflectors, sigma_mm=hall.survey_mm)
            positions.append(calibrate_position(str(k), place, found.q, placement, sigma_px=found.sigma_px))

    print("\n| job, 768 x 576 | CPU, best |")
    print("|---|---|")
    print(f"| find one mark | {1000 * _best(finding, 20):.1f} ms |")
    print(f"| daily job: find and measure one mark | {1000 * _best(daily, 20):.1f} ms |")
    print(f"| calibrate a robot from {len(pictures)} pictures | {_best(calibrating, 2):.2f} s |")


def _plates(
    hall: Hall, station: GantryCalibration, rng: np.random.Generator
) -> list[tuple[Array, np.typing.NDArray[np.float32], Array]]:
    """Return position, picture and survey of the plate at all positions."""
    out = []
    for at in station.grid:
        marks, reflectors = hall.survey(*hall.lay_plate("6", at, rng), rng)
        out.append((at, hall_picture(hall, "6", at, marks, hall.visit(rng), rng), reflectors))
    return out


def _best(job: Callable[[], None], times: int) -> float:
    best = np.inf
    for _ in range(times):
        start = time.process_time()
        job()
        best = min(best, time.process_time() - start)
    return best


if __name__ == "__main__":
    main()
