"""Matt shading from normals: shared by all renderers, so that their images agree."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.render.view import Look


def shade(normals: Picture, towards_camera: Picture, colors: Picture, look: Look) -> Picture:
    """Return RGB (N, 3) float32 of surface points with unit normals that face the camera, all in the camera frame.

    `towards_camera` (N, 3) are unit vectors from the points to the camera; `colors` (N, 3) the parts' own.
    """
    head = np.einsum("ij,ij->i", normals, towards_camera)
    light = look.ambient + look.head * np.clip(head, 0, 1)
    for strength, towards in ((look.fill, look.fill_from), (look.back, look.back_from)):
        light += strength * np.clip(normals @ unit(towards).astype(np.float32), 0, 1)
    return np.asarray(np.clip(colors * light[:, None], 0, 1), np.float32)


def unit(direction: tuple[float, float, float]) -> Array:
    """Return a direction as a unit vector (3,)."""
    return np.asarray(np.array(direction) / np.linalg.norm(direction))
