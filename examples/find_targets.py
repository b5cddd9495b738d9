"""Marks on a plate: draw them as a camera sees them, find them, and see how far off their pictures' centres are.

    python examples/find_targets.py

Prints the error of the ellipses' centres, and of the centres that fits through the camera give.
"""

from __future__ import annotations

import numpy as np

import cadcam
from cadcam.target.marks.ideal import board_picture
from cadcam.target.marks.mark import MarkSheet, dot_and_ring


def main() -> None:
    mark = dot_and_ring(10.0, 20.0, 30.0)
    plate = MarkSheet.grid((mark,), 3, 2, 60.0)
    camera = cadcam.Camera.from_focal((480, 360), 700.0)
    tilted = cadcam.Rigid.exp([0, 0, 0, np.radians(40), 0, 0])
    away, centre = (cadcam.Rigid.exp([*t, 0, 0, 0]) for t in ((0, 0, 600), (-60, -30, 0)))
    camera_from_plate = away @ tilted @ centre
    rng = np.random.default_rng(1)
    picture = board_picture(plate, camera, camera_from_plate, blur_px=0.8, noise=0.01, rng=rng)
    truth = camera.project(camera_from_plate @ plate.points)
    for name, known in (("without a camera", None), ("through the camera", camera)):
        found = cadcam.find_marks(picture, mark, camera=known)
        q = np.array([one.pixel for one in found])
        error = q - truth[np.linalg.norm(q[:, None] - truth, axis=2).argmin(axis=1)]
        sigma = np.mean([one.sigma for one in found])
        print(f"{name}: {len(found)} marks, rms error {np.sqrt(np.mean(error**2)):.4f} px, told {sigma:.4f} px")


if __name__ == "__main__":
    main()
