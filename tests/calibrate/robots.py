"""Simulated robot cells with exact truth: a camera on the flange or in the cell, a board, pictures, noise of both."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

CAMERA = Camera.from_focal((1280, 960), 1200.0)


def board(columns=9, rows=6, square=25.0):
    """Return the corners (N, 3) of a flat board, mm, its middle at the origin."""
    x, y = np.meshgrid(np.arange(columns) * square, np.arange(rows) * square)
    p = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return p - p.mean(axis=0)


@dataclass
class Cell:
    """What is true in a cell, and what robot and camera say of it."""

    mounting: str
    camera: Camera
    flange_from_held: Rigid
    base_from_fixed: Rigid
    base_from_flange: Rigid  # as the robot says
    camera_from_target: Rigid  # as it is
    observations: list = field(default_factory=list)
    points: np.ndarray = field(default_factory=board)

    @property
    def camera_pose(self):
        """Return the true flange_from_camera or base_from_camera."""
        return self.flange_from_held if self.mounting == "eye-in-hand" else self.base_from_fixed

    @property
    def target_pose(self):
        return self.base_from_fixed if self.mounting == "eye-in-hand" else self.flange_from_held


def random_rigid(rng, reach):
    return Rigid(so3.exp(rng.normal(size=3)), rng.uniform(-reach, reach, 3))


def target_poses(rng, n, *, tilt=0.45, distance=700.0, points=None, camera=CAMERA):
    """Return camera_from_target (n) of a board tilted by up to about `tilt` rad, all points in the picture."""
    points = board() if points is None else points
    found = []
    while len(found) < n:
        axis = rng.normal(size=2)
        turn = so3.exp(np.array([0, 0, rng.uniform(-1.5, 1.5)]))
        R = so3.exp(np.append(axis / np.linalg.norm(axis), 0) * tilt * np.sqrt(rng.uniform())) @ turn
        t = np.append(rng.uniform(-90, 90, 2), distance + rng.uniform(-100, 100))
        if camera.sees(camera.project(points @ R.T + t)).all():
            found.append(Rigid(R, t).matrix)
    return Rigid.from_matrix(np.stack(found))


def cell(
    rng,
    n=15,
    *,
    mounting="eye-in-hand",
    noise_px=0.1,
    robot=(0.0, 0.0),
    camera_from_target=None,
    points=None,
    camera=CAMERA,
):
    """Return a cell with n pictures; robot: sigmas of the flange's position (mm) and orientation (rad) per axis."""
    points = board() if points is None else points
    C = target_poses(rng, n, points=points, camera=camera) if camera_from_target is None else camera_from_target
    n = len(C.rotation)
    held, fixed = random_rigid(rng, 80), random_rigid(rng, 600)
    S = C if mounting == "eye-in-hand" else C.inv
    true = fixed @ (held @ S).inv
    off = Rigid(so3.exp(robot[1] * rng.normal(size=(n, 3))), robot[0] * rng.normal(size=(n, 3)))
    seen = [
        Observations(points, camera.project(points @ R.T + t) + noise_px * rng.normal(size=(len(points), 2)))
        for R, t in zip(C.rotation, C.translation, strict=True)
    ]
    return Cell(mounting, camera, held, fixed, true @ off.inv, C, seen, points)
