"""Rigs with known answers: cameras on a mount, boards in front of them, and what would be seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.rig.adjustment import RigCamera
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

from .scenes import SIZE, board

LEFT = Camera.from_focal(SIZE, 1100, fy=1090, cx=650, cy=470, lens=BrownConrady(-0.15, 0.05))
RIGHT = Camera.from_focal(SIZE, 1150, fy=1145, cx=630, cy=490, lens=BrownConrady(-0.12, 0.03))
TOP = Camera.from_focal((1024, 1024), 900, cx=500, cy=520, lens=BrownConrady(-0.1))
TO_RIGHT = Rigid.exp([0, 0, 0, 0.01, 0.12, -0.02]) @ Rigid(translation=np.array([-120.0, 3.0, 5.0]))
TO_TOP = Rigid.exp([0, 0, 0, -0.15, 0.05, 0.4]) @ Rigid(translation=np.array([-60.0, 110.0, -8.0]))


@dataclass(frozen=True)
class Rig:
    cameras: dict[str, Camera]
    mounts: dict[str, Rigid]
    poses: list[Rigid]
    points: Array

    def seen(
        self, rng: np.random.Generator, noise: float | dict[str, float], *, stated: bool = False
    ) -> dict[str, RigCamera]:
        """Return what the cameras see with noise (px), lens k1 k2 free, no skew."""
        out = {}
        for name, camera in self.cameras.items():
            sigma = noise[name] if isinstance(noise, dict) else noise
            views = []
            for j, pose in enumerate(self.poses):
                q = camera.project(self.mounts[name] @ pose @ self.points)
                q = q + sigma * rng.normal(size=q.shape)
                views.append(
                    Observations(self.points, q, sigma_px=sigma if stated else None, source=f"{name}{j + 1:02}")
                )
            out[name] = RigCamera(views, camera.size, {"skew": 0.0}, BrownConrady(), ("k1", "k2"))
        return out


def rig(rng: np.random.Generator, cameras: int = 2, frames: int = 8) -> Rig:
    """A board in front of the rig, turned at random."""
    names = ("left", "right", "top")[:cameras]
    poses = []
    for _ in range(frames):
        t = np.array([50.0, 0.0, 0.0]) + np.append(rng.uniform(-25, 25, 2), rng.uniform(380, 480))
        poses.append(Rigid(so3.exp(rng.normal(size=3) * [0.35, 0.35, 0.5]), t))
    return Rig(
        dict(zip(names, (LEFT, RIGHT, TOP), strict=False)),
        dict(zip(names, (Rigid(), TO_RIGHT, TO_TOP), strict=False)),
        poses,
        board(8, 6, 20.0),
    )


def without(camera: RigCamera, *frames: int) -> RigCamera:
    """Return the camera without having seen anything in some frames."""
    views = [None if j in frames else v for j, v in enumerate(camera.views)]
    return RigCamera(views, camera.size, camera.fixed, camera.lens, camera.free_lens, camera.known)


def reordered(camera: RigCamera, order: list[int]) -> RigCamera:
    """Return the camera with its views in another order."""
    views = [camera.views[j] for j in order]
    return RigCamera(views, camera.size, camera.fixed, camera.lens, camera.free_lens, camera.known)
