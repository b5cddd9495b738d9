"""Measure points with one camera on a robot: calibrated once, moved by a motion that the robot knows, seen twice.

Run it as `python examples/measure_with_a_moved_camera.py [POINTS.CSV]`. The camera is that of the dissertation's Table
2.3; the robot shifts it by 200 mm and turns it by 12 deg, known to 0.1 mm and 0.01 deg. The pixels are simulated.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import cadcam
from cadcam.report.measure import measurement_tables
from cadcam.report.table import show

BENCH = Path(__file__).parent / "data" / "bench_points.csv"
CORNERS = np.array([[110.0, 300, -1250], [140, 300, -1250], [110, 340, -1230]])


def main(points_file: str) -> None:
    """Calibrate, move, measure, print what the uncertainty consists of, write the points."""
    home = cadcam.calibrate_camera(cadcam.read_points(BENCH), size=(768, 576))
    centre = home.camera_from_world.origin
    turn = cadcam.Rigid.exp([0, 0, 0, np.radians(-12), 0, 0]).rotation
    motion = cadcam.KnownMotion.of_center(centre, turn, [0.0, -200, 0])
    motion = motion.known_to(0.1, np.radians(0.01), about=centre)
    views = [cadcam.Viewpoint.fixed("home", home), cadcam.Viewpoint.moved("away", home, motion)]

    rng = np.random.default_rng(1)
    seen = np.array([view.camera.project(view.camera_from_world @ CORNERS) for view in views])
    pixels = seen + rng.normal(scale=home.noise_px, size=seen.shape)
    measured = cadcam.measure_points(views, pixels, names=["A", "B", "C"])
    show(measurement_tables(measured, views, [("A", "B"), ("A", "C")]), sys.stdout)
    cadcam.write_measurement(points_file, measured)
    print(f"wrote {points_file}")


if __name__ == "__main__":
    main(*sys.argv[1:] or ["measured.csv"])
