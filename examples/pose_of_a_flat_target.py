"""The pose of a known camera from four marks on a plane, and the second pose that a flat target always allows.

Run it as `python examples/pose_of_a_flat_target.py`. A square of 100 mm is seen from 1.9 m, picked to 0.5 px.
"""

from __future__ import annotations

import sys

import numpy as np

import cadcam
from cadcam.report.camera import alternative_table, parameter_table
from cadcam.report.table import show

CORNERS = np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]], float)


def main() -> None:
    """Make the observations, find both poses, print them side by side."""
    camera = cadcam.Camera.from_focal((1600, 1200), 2200)
    true_pose = cadcam.Rigid.look_at([900, -500, 1600], [50, 50, 0])
    noise = np.random.default_rng(7).normal(scale=0.5, size=(4, 2))
    marks = cadcam.Observations(CORNERS, camera.project(true_pose @ CORNERS) + noise, sigma_px=0.5)

    estimate = cadcam.locate_camera(marks, camera)
    show([parameter_table(estimate)], sys.stdout)
    if estimate.alternative is not None:
        show([alternative_table(estimate, estimate.alternative)], sys.stdout)
    off = np.linalg.norm(estimate.camera_from_world.origin - true_pose.origin)
    print(f"the camera stands {off:.0f} mm from where it truly was, 1.9 m from the target")


if __name__ == "__main__":
    main()
