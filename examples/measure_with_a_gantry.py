"""A gantry's camera calibrated at fifteen positions of a simulated hall, its mechanics mapped, a distance measured.

    python examples/measure_with_a_gantry.py

In a real hall the pixels come from `cadcam.station.marks.find_plate`, the places from a survey.
"""

from __future__ import annotations

import sys

import numpy as np

import cadcam
from cadcam.report.station.tables import map_tables, sighting_tables
from cadcam.report.table import show
from cadcam.station.hall import make_hall
from cadcam.station.simulate import calibrate_robot, sight


def main() -> None:
    rng = np.random.default_rng(7)
    hall = make_hall(rng, robots=("6",))
    calibrated = calibrate_robot(hall, "6", rng)
    station = calibrated.station
    show(map_tables([one.name for one in station.positions], station.map()), sys.stdout)
    print(f"the map is off the truth by {np.sqrt(np.mean(calibrated.map_error**2)):.3f} mm rms")

    positions = np.array([[6000.0, 14500.0], [11500.0, 20500.0]])
    true = [hall.view_centre("6", at) for at in positions]
    seen = [sight(hall, name, "6", at, p, rng) for name, at, p in zip("AB", positions, true, strict=True)]
    found = cadcam.measure_marks(station, seen)
    show(sighting_tables(found, seen), sys.stdout)
    length = found.distance("A", "B")
    print(f"A to B: {length.value:.2f} +- {length.half_width:.2f} mm; truly {np.linalg.norm(true[1] - true[0]):.2f} mm")


if __name__ == "__main__":
    main()
