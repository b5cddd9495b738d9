"""Photos of parts as a camera would take them: rendered, blurred, noisy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import PLAIN, Channel

LOOK = replace(PLAIN, background=(0.55, 0.5, 0.52), supersampling=6)
CAMERA = Camera.from_focal((640, 480), 900.0)


def view(part: Part, direction: tuple[float, float, float], *, away: float = 4.2, aim: float = 0.0) -> Rigid:
    """Return camera_from_part from a direction, `away` radii off; aim: how far beside the middle it looks, radii."""
    v = part.scene.mesh.vertices
    centre = (v.min(axis=0) + v.max(axis=0)) / 2
    radius = float(np.linalg.norm(v - centre, axis=1).max())
    d = np.asarray(direction) / np.linalg.norm(direction)
    return Rigid.look_at(centre + away * radius * d, centre + aim * radius)


def shot(part: Part, camera_from_part: Rigid, camera: Camera = CAMERA) -> np.ndarray:
    """Return the clean picture (H, W), blurred by 0.6 px beyond its pixels."""
    shaded = open_renderer(part.scene).render(camera, camera_from_part, look=LOOK, channels=Channel.IMAGE)
    return np.asarray(gaussian_filter(shaded.gray, 0.6))


def noisy(clean: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Return the picture with noise, in steps of 1/255."""
    return (np.round(np.clip(clean + sigma * rng.normal(size=clean.shape), 0, 1) * 255) / 255).astype(np.float32)


def photo(part: Part, camera_from_part: Rigid, rng: np.random.Generator, *, camera: Camera = CAMERA) -> Photo:
    """Return a photo with noise 0.01 by an exactly known camera whose frame is the world."""
    return Photo.of(noisy(shot(part, camera_from_part, camera), 0.01, rng), camera)


def error_px(part: Part, camera: Camera, one: Rigid, other: Rigid) -> float:
    """Return how far apart (px) two poses put the part's vertices at most."""
    v = part.scene.mesh.vertices
    return float(np.linalg.norm(camera.project(one @ v) - camera.project(other @ v), axis=1).max())
