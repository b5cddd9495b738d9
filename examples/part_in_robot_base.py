"""Where is the part, in the robot's base? A camera on the flange: hand-eye calibration, two photos, one pose to go to.

    python examples/part_in_robot_base.py

The cell is simulated: a robot that is 0.05 mm and 0.005 deg off, a board for the hand-eye calibration, a bracket on the
table. What the calibration and the robot leave uncertain is in the covariance of the part's pose.
"""

from __future__ import annotations

import numpy as np

import cadcam
from cadcam.cad.parts import machined_bracket

CAMERA = cadcam.Camera.from_focal((960, 720), 1100.0)
FLANGE_FROM_CAMERA = cadcam.Rigid.from_rotation_vector([0.05, -0.1, 1.5], [60, -20, 90])
BASE_FROM_PART = cadcam.Rigid.from_rotation_vector([0, 0, 0.6], [700, 150, 20])
ROBOT_MM, ROBOT_RAD, PIXEL = 0.05, np.radians(0.005), 0.05


def main() -> None:
    """Calibrate, photograph the part from two places, locate it in the base, print it as a KUKA shows it."""
    rng = np.random.default_rng(11)
    hand_eye = calibrated(rng)
    print(hand_eye)

    part = cadcam.Part.of(machined_bracket())
    renderer = cadcam.open_renderer(part.scene)
    photos = []
    for k, eye in enumerate(([400, -200, 420], [950, 60, 450])):
        base_from_camera = cadcam.Rigid.look_at(eye, BASE_FROM_PART @ np.array([55.0, 40, 20])).inv
        view = renderer.render(CAMERA, base_from_camera.inv @ BASE_FROM_PART, look=cadcam.Look(supersampling=4))
        reported = base_from_camera @ FLANGE_FROM_CAMERA.inv @ error(rng)
        picture = view.gray + rng.normal(scale=0.01, size=view.gray.shape)
        photos.append(cadcam.Photo(np.asarray(picture, np.float32), hand_eye.viewpoint(f"place {k}", CAMERA, reported)))

    rough = cadcam.Rigid(BASE_FROM_PART.rotation, BASE_FROM_PART.translation + np.array([5, -4, 6]))
    found = cadcam.locate_part(part, photos, rough)
    print(found)
    x, y, z, a, b, c = cadcam.robot_numbers(found.pose.world_from_part, convention="kuka")
    print(f"go to X {x:.2f}, Y {y:.2f}, Z {z:.2f}, A {a:.3f}, B {b:.3f}, C {c:.3f}")
    off = (found.pose.world_from_part.inv @ BASE_FROM_PART).log()
    sigmas = np.sqrt(off @ np.linalg.solve(found.pose.covariance, off) / 6)
    print(f"off the truth by {np.linalg.norm(off[:3]):.2f} mm, {sigmas:.1f} standard deviations a coordinate")


def calibrated(rng: np.random.Generator) -> cadcam.HandEyeEstimate:
    """Return the hand-eye calibration from fifteen pictures of a board on the table."""
    board = cadcam.parse_pattern("chessboard:9x6:25mm").points
    base_from_board = cadcam.Rigid.from_rotation_vector([np.pi, 0, 0.2], [600, 0, 0])
    poses, views = [], []
    for _ in range(15):
        tilt, place = rng.uniform(-0.4, 0.4, 3), np.array([-100, -60, 550]) + rng.uniform(-40, 40, 3)
        camera_from_board = cadcam.Rigid.from_rotation_vector(tilt, place)
        base_from_flange = base_from_board @ (FLANGE_FROM_CAMERA @ camera_from_board).inv
        poses.append(base_from_flange @ error(rng))
        q = CAMERA.project(camera_from_board @ board)
        views.append(cadcam.Observations(board, q + rng.normal(scale=PIXEL, size=q.shape)))
    return cadcam.calibrate_hand_eye(cadcam.Rigid.stack(poses), views, CAMERA, mounting="eye-in-hand")


def error(rng: np.random.Generator) -> cadcam.Rigid:
    """Return by how much the robot is beside the pose that it reports."""
    return cadcam.Rigid.exp(rng.normal(size=6) * np.repeat([ROBOT_MM, ROBOT_RAD], 3))


if __name__ == "__main__":
    main()
