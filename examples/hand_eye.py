"""Where a camera sits on a robot's flange: twelve poses of a simulated cell, a robot that is 0.1 mm and 0.02 deg off.

    python examples/hand_eye.py

The cell is made up here; with a real one, base_from_flange comes from `cadcam.read_robot_poses` and each picture's
points from `cadcam.read_points`.
"""

from __future__ import annotations

import sys

import numpy as np

import cadcam
from cadcam.report.handeye import hand_eye_tables
from cadcam.report.table import show


def main() -> None:
    rng = np.random.default_rng(3)
    camera = cadcam.Camera.from_focal((1280, 960), 1200.0)
    x, y = np.meshgrid(25.0 * np.arange(9) - 100, 25.0 * np.arange(6) - 62.5)
    board = np.column_stack([x.ravel(), y.ravel(), np.zeros(54)])

    flange_from_camera = cadcam.Rigid.from_rotation_vector([0.1, -0.2, 1.5], [40, -25, 80])
    base_from_board = cadcam.Rigid.from_rotation_vector([np.pi, 0, 0.3], [600, 100, 20])
    tilts = rng.uniform(-0.4, 0.4, (12, 3))
    places = rng.uniform(-60, 60, (12, 3)) + np.array([0, 0, 650])
    camera_from_board = cadcam.Rigid.from_rotation_vector(tilts, places)

    true = base_from_board @ (flange_from_camera @ camera_from_board).inv
    noise = cadcam.Rigid.from_rotation_vector(0.00035 * rng.normal(size=(12, 3)), 0.1 * rng.normal(size=(12, 3)))
    pictures = [
        cadcam.Observations(board, camera.project(board @ R.T + t) + 0.1 * rng.normal(size=(54, 2)))
        for R, t in zip(camera_from_board.rotation, camera_from_board.translation, strict=True)
    ]
    found = cadcam.calibrate_hand_eye(true @ noise, pictures, camera, mounting="eye-in-hand")
    show(hand_eye_tables(found), sys.stdout)
    off = (found.flange_from_camera.inv @ flange_from_camera).log()
    print(f"off the truth by {np.linalg.norm(off[:3]):.2f} mm and {np.degrees(np.linalg.norm(off[3:])):.3f} deg")


if __name__ == "__main__":
    main()
