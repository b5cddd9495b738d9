"""Take a 3x4 projection matrix apart: eleven parameters, K, pose, and what OpenGL needs to render the same picture.

Run it as `python examples/decompose_matrix.py [MATRIX.txt]`, a text file with rows (x, y, 1) as OpenCV writes them.
Without a file it takes a camera that looks at the origin, skewed pixels and all, and its negative: both are the same.
"""

from __future__ import annotations

import sys

import numpy as np

import cadcam
from cadcam.report.camera import camera_table, opengl_tables, pinhole_table, pose_table
from cadcam.report.table import show

SIZE = (768, 576)


def a_matrix() -> np.ndarray:
    """Return K [R | t] of a camera 900 mm from the origin."""
    camera = cadcam.Camera.from_focal(SIZE, 815, fy=806, skew=2.5, cx=354, cy=320)
    pose = cadcam.Rigid.look_at([300, -700, 480], [0, 0, 0])
    return camera.K @ pose.matrix[:3]


def main(P: np.ndarray) -> None:
    """Print the decomposition of P, and that -3 P has the same one."""
    pinhole = cadcam.ExtendedPinhole.from_matrix(cadcam.uv_from_pixel_matrix(P))
    camera, pose = pinhole.camera(SIZE), pinhole.camera_from_world
    tables = [pinhole_table(pinhole), camera_table(camera), pose_table(pose)]
    show([*tables, *opengl_tables(camera, pose, near=100, far=5000)], sys.stdout)

    scaled = cadcam.ExtendedPinhole.from_matrix(cadcam.uv_from_pixel_matrix(-3 * P))
    largest = np.abs(scaled.vector - pinhole.vector).max()
    print(f"-3 P has the same parameters: largest difference {largest:.1g}")


if __name__ == "__main__":
    main(cadcam.read_matrix(sys.argv[1], rows=3, columns=4) if len(sys.argv) > 1 else a_matrix())
