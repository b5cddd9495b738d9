"""Photos of parts as a camera would take them: rendered, blurred, noisy."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.render import open_renderer
from cadcam.render.view import PLAIN, Channel
from cadcam.locate.photo import Photo
from dataclasses import replace

LOOK = replace(PLAIN, background=(0.55, 0.5, 0.52), supersampling=4)


def shot(part: Part, camera: Camera, camera_from_part: Rigid) -> np.ndarray:
    """Return the clean picture (H, W), blurred by 0.6 px beyond its pixels."""
    view = open_renderer(part.scene).render(camera, camera_from_part, look=LOOK, channels=Channel.IMAGE)
    return gaussian_filter(view.gray, 0.6)


def noisy(clean: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Return the picture with noise, in steps of 1/255."""
    return (np.round(np.clip(clean + sigma * rng.normal(size=clean.shape), 0, 1) * 255) / 255).astype(np.float32)


def photo(part: Part, camera: Camera, camera_from_part: Rigid, rng: np.random.Generator, *, sigma: float = 0.01):
    return Photo.of(noisy(shot(part, camera, camera_from_part), sigma, rng), camera)
