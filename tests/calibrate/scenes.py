"""Joint scenes with known answers: a camera, fields of points, poses, and what would be seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

SIZE = (1280, 960)


def board(columns: int = 9, rows: int = 7, pitch: float = 20.0) -> Array:
    x, y = np.meshgrid(np.arange(columns) * pitch, np.arange(rows) * pitch)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) - [pitch * (columns - 1) / 2, pitch * 3, 0]


def box(rng: np.random.Generator, count: int = 40) -> Array:
    return rng.uniform(-1, 1, (count, 3)) * [80, 60, 50]


@dataclass(frozen=True)
class Scene:
    camera: Camera
    poses: list[Rigid]
    fields: list[Array]

    def seen(self, rng: np.random.Generator, noise: float, *, stated: bool = False) -> list[Observations]:
        """Return what is measured, with noise (px); its sigma_px is stated if asked for."""
        out = []
        for j, (pose, p) in enumerate(zip(self.poses, self.fields, strict=True)):
            q = self.camera.project(pose @ p)
            q = q + noise * rng.normal(size=q.shape)
            out.append(Observations(p, q, sigma_px=noise if stated else None, source=f"view{j + 1:02}"))
        return out


def scene(rng: np.random.Generator, camera: Camera, fields: list[Array], *, tilt: float = 0.35) -> Scene:
    """Fields in front of the camera, turned at random."""
    poses = []
    for _ in fields:
        t = np.append(rng.uniform(-25, 25, 2), rng.uniform(330, 480))
        poses.append(Rigid(so3.exp(rng.normal(size=3) * [tilt, tilt, 0.6]), t))
    return Scene(camera, poses, fields)
