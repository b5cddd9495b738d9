"""A bracket before a camera with a distorting lens: its photo, camera file, a rough start, and ways to spoil them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from scipy import ndimage

from cadcam.arrays import Picture
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.files.camera import write_camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look, Scene

MODELS = Path(__file__).resolve().parents[2] / "models"
CAMERA = Camera.from_focal((480, 360), 600, fy=597, cx=245, cy=176, lens=BrownConrady(k1=-0.08))
MIDDLE = np.array([55.0, 40, 30])
POSE = Rigid.look_at(MIDDLE + np.array([142, -231, 160]), MIDDLE)  # camera_from_part
ROUGH = POSE @ Rigid.exp([4.0, -3, 5, 0.06, -0.05, 0.07])


def make_photo_job(folder: Path) -> None:
    """Write photo.png, camera.json without a pose, start.txt some degrees and millimetres off."""
    write_picture(folder / "photo.png", photo(), bits=16)
    write_camera(folder / "camera.json", CAMERA)
    write_start(folder / "start.txt", ROUGH)


@cache
def photo() -> Picture:
    """Return the bracket as the camera sees it, blurred by 0.6 px, with noise of 1 % of white."""
    return seen(CAMERA, POSE)


def seen(camera: Camera, camera_from_part: Rigid, *, model: str = "bracket.stl") -> Picture:
    """Return a model's photo."""
    view = open_renderer(Scene.of(read_model(MODELS / model))).render(
        camera,
        camera_from_part,
        channels=Channel.IMAGE,
        look=Look(supersampling=3, background=(0.3, 0.32, 0.35)),
    )
    gray = ndimage.gaussian_filter(view.image.mean(axis=-1), 0.6)
    return np.asarray(gray + np.random.default_rng(1).normal(scale=0.01, size=gray.shape), np.float32)


def write_start(path: Path, camera_from_part: Rigid) -> None:
    """Write a pose as a person would."""
    rows = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in camera_from_part.matrix)
    path.write_text(f"# camera_from_part, mm\n{rows}\n")


def off_mm(pose: Rigid) -> float:
    """Return how far a pose puts the part's middle from the truth, mm."""
    return float(np.linalg.norm(pose @ MIDDLE - POSE @ MIDDLE))
