"""Calibrate a camera from a points file: eleven parameters with sigmas, residuals, and a camera file.

Run it as `python examples/calibrate_from_points.py [POINTS [WIDTHxHEIGHT [CAMERA.JSON]]]`. Without arguments it takes
the dissertation's Table 2.3, sixteen targets of a test bench seen in a picture of 768 x 576 px.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cadcam
from cadcam.report.camera import estimate_tables
from cadcam.report.table import show

POINTS = Path(__file__).parent / "data" / "bench_points.csv"


def main(points_file: str, size: str, camera_file: str) -> None:
    """Calibrate, print the tables, write the camera."""
    width, height = (int(number) for number in size.split("x"))
    points = cadcam.read_points(points_file)
    estimate = cadcam.calibrate_camera(points, size=(width, height))
    show(estimate_tables(estimate), sys.stdout)
    cadcam.write_camera(camera_file, estimate)
    print(f"wrote {camera_file}")


if __name__ == "__main__":
    given = sys.argv[1:]
    main(*given, *(str(POINTS), "768x576", "camera.json")[len(given) :])
