"""A box with print on its faces that its model lacks, photographed at known poses."""

from __future__ import annotations

from functools import cache

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel

CAMERA = Camera.from_focal((240, 180), 300.0)
NOISE = 0.01
FIRST = Rigid.look_at([150.0, -260.0, 190.0], [30.0, 20.0, 10.0])
STEP = Rigid.exp([3.0, -1.0, 2.0, 0.02, -0.015, 0.03])


@cache
def part() -> Part:
    """Return a box of 120 x 80 x 60 mm about the origin."""
    made: Mesh = box((-60, -40, -30), (60, 40, 30), name="box")
    return Part.of(made)


def truth(n: int) -> list[Rigid]:
    """Return camera_from_part in n frames of an even motion, some px a frame."""
    poses = [FIRST]
    for _ in range(n - 1):
        poses.append(poses[-1] @ STEP)
    return poses


def photo(
    pose: Rigid,
    rng: np.random.Generator,
    *,
    of: Part | None = None,
    slid: tuple[float, float, float] = (0, 0, 0),
    light: tuple[float, float] = (1, 0),
) -> Photo:
    """Return the noisy photo at camera_from_part; of: another part than the box, with the same print in space.

    slid (mm): the print has slid over the part. light: gain, offset.
    """
    view = open_renderer((of or part()).scene, threads=1).render(CAMERA, pose, channels=Channel.DEPTH | Channel.NORMAL)
    rays = CAMERA.unproject(CAMERA.pixel_grid())
    depth = np.where(np.isfinite(view.depth), view.depth, 0.0).astype(np.float64)
    p = pose.inv @ (rays * (depth / rays[..., 2])[..., None])
    shade = 0.35 + 0.25 * np.abs(view.normal @ np.array([0.2, 0.5, 0.8], np.float32))
    gray = np.where(depth > 0, shade + 0.12 * _print(p - np.array(slid)), 0.9)
    gray = light[0] * (gray + rng.normal(scale=NOISE, size=gray.shape)) + light[1]
    picture: Picture = np.clip(gray, 0, 1).astype(np.float32)
    return Photo.of(picture, CAMERA)


def miss_mm(pose: Rigid, known: Rigid) -> float:
    """Return the largest distance of a corner of the box between two poses, mm."""
    p = part().scene.mesh.vertices
    return float(np.linalg.norm(pose @ p - known @ p, axis=1).max())


def _print(p: Array) -> Array:
    """Return a pattern (H, W) in -1 to 1 of waves in all directions, 16 to 30 mm long: 12 px and more."""
    rng = np.random.default_rng(8)
    total = np.zeros(p.shape[:2])
    for _ in range(12):
        way = rng.normal(size=3)
        k = 2 * np.pi / rng.uniform(16, 30) * way / np.linalg.norm(way)
        total += np.sin(p @ k + rng.uniform(0, 2 * np.pi))
    return np.asarray(np.tanh(total / 2))
