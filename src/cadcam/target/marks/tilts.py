"""The two poses that the shape of a mark's image allows."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid


def tilts(camera: Camera, q: Array, image_from_mark: Array) -> tuple[Rigid, Rigid]:
    """Return the two poses (camera_from_mark) whose image at q (2,) has, to first order, this shape (2, 2) px per mm.

    In the frame of the line of sight the mark's axes are foreshortened: its shape there is R_2x2 / depth, with singular
    values 1/depth and cos(tilt)/depth; the sign of the tilt is undetermined (two-fold ambiguity of weak perspective,
    after Bouguet and others).
    """
    ray = camera.unproject(q)
    sight = toward(ray)
    _, J = camera.project_with_jacobian(ray)
    S = np.linalg.solve(J @ sight[:, :2], image_from_mark)  # mark plane -> across the line of sight, over depth
    U, sizes, Vt = np.linalg.svd(S)
    depth, cosine = 1 / sizes[0], min(sizes[1] / sizes[0], 1.0)
    poses = []
    for sine in (np.sqrt(1 - cosine**2), -np.sqrt(1 - cosine**2)):
        first = np.append(U[:, 0], 0.0)
        second = np.append(cosine * U[:, 1], sine)
        axes = np.column_stack([first, second]) @ Vt
        R = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
        poses.append(Rigid(sight @ R, depth * ray))
    return poses[0], poses[1]


def toward(ray: Array) -> Array:
    """Return a rotation whose third column is the unit vector `ray`."""
    x = np.cross([0.0, 1.0, 0.0] if abs(ray[1]) < 0.9 else [1.0, 0.0, 0.0], ray)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(ray, x), ray])
