"""A noisy photo of a small block of plates whose pose is known, lit otherwise than its drawings."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from cadcam.arrays import Picture
from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look

CAMERA = Camera.from_focal((640, 480), 900.0)
NOISE = 3 / 255
DIM = Look(head=0.25, fill=0.7, back=0.1, fill_from=(0.7, -0.6, 0.1), background=(0.35, 0.35, 0.35), supersampling=4)


@cache
def block() -> Part:
    """Return a floor with two walls, stiffeners of different heights, and a bracket: 600 x 400 x 250 mm."""
    boxes = [
        ((0, 0, 0), (600, 400, 8)),
        ((0, 0, 8), (8, 400, 250)),
        ((8, 392, 8), (600, 400, 220)),
        ((150, 8, 8), (156, 392, 90)),
        ((290, 60, 8), (296, 392, 70)),
        ((430, 8, 8), (436, 300, 90)),
        ((8, 180, 8), (110, 186, 120)),
        ((480, 120, 8), (560, 200, 48)),
    ]
    return Part.of(merge([box(low, high, name=f"plate {i}") for i, (low, high) in enumerate(boxes)]))


def pose_of(rng: np.random.Generator) -> Rigid:
    """Return camera_from_part from somewhere above the open side of the block, all of it in view."""
    low, high = block().scene.mesh.bounds
    centre, size = (low + high) / 2, float(np.linalg.norm(high - low))
    azimuth, height = rng.uniform(-0.3, 0.6), rng.uniform(0.7, 1.0)
    away = np.array([math.cos(height) * math.sin(azimuth), -math.cos(height) * math.cos(azimuth), math.sin(height)])
    return Rigid.look_at(centre + 1.6 * size * away, centre)


def photo_of(pose: Rigid, rng: np.random.Generator) -> Photo:
    """Return the noisy photo of the block at camera_from_part `pose`; its world is the camera."""
    view = open_renderer(block().scene, threads=1).render(CAMERA, pose, channels=Channel.IMAGE, look=DIM)
    gray: Picture = view.gray + rng.normal(scale=NOISE, size=view.gray.shape).astype(np.float32)
    return Photo.of(np.clip(gray, 0, 1), CAMERA)


def off(pose: Rigid, rng: np.random.Generator, *, degrees: float, px: float) -> Rigid:
    """Return a pose turned about the part's middle by an angle and shifted by pixels, each in a random direction."""
    centre = np.asarray(block().scene.mesh.bounds).mean(axis=0)
    at = Rigid(translation=centre)
    axis, way = rng.normal(size=3), rng.normal(size=2)
    turn = Rigid.exp([0, 0, 0, *(math.radians(degrees) * axis / np.linalg.norm(axis))])
    z = float((pose @ centre)[2])
    shift = Rigid(translation=[*(px * way / np.linalg.norm(way) * z / CAMERA.fx), 0])
    return shift @ pose @ at @ turn @ at.inv


def largest_miss(pose: Rigid, truth: Rigid) -> float:
    """Return the largest distance in px between a vertex at two poses."""
    p = block().scene.mesh.vertices
    return float(np.linalg.norm(CAMERA.project(pose @ p) - CAMERA.project(truth @ p), axis=1).max())
