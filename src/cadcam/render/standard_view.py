"""A camera that views the whole model from a standard side, for use without a real camera."""

from __future__ import annotations

import numpy as np

from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera, checked_size
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_known

# from the model's middle towards the camera, and the up direction of the picture
DIRECTIONS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "iso": ((1.0, -1.3, 0.9), (0, 0, 1)),
    "front": ((0, -1, 0), (0, 0, 1)),
    "back": ((0, 1, 0), (0, 0, 1)),
    "left": ((-1, 0, 0), (0, 0, 1)),
    "right": ((1, 0, 0), (0, 0, 1)),
    "top": ((0, 0, 1), (0, 1, 0)),
    "bottom": ((0, 0, -1), (0, 1, 0)),
}
_FIELD_DEG = 30.0  # over the shorter side: perspective is visible, but not exaggerated
_MARGIN = 1.08


def standard_view(mesh: Mesh, name: str = "iso", *, size: tuple[int, int] = (1280, 960)) -> tuple[Camera, Rigid]:
    """Return a camera of `size` px and its camera_from_world, so that the model fills the picture.

    name: iso, front, back, left, right, top or bottom; front looks along +Y, Z is up. Raises `UnknownName`.
    """
    expect(mesh, "mesh", Mesh)
    size = checked_size(size)
    expect_known(name, "view", DIRECTIONS)
    towards, up = DIRECTIONS[name]
    low, high = mesh.bounds
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    half = np.radians(_FIELD_DEG) / 2
    distance = _MARGIN * max(radius, 1e-6) / np.sin(half)
    away = np.array(towards) / np.linalg.norm(towards)
    camera = Camera.from_focal(size, min(size) / 2 / np.tan(half))
    return _filled(camera, Rigid.look_at(middle + distance * away, middle, up=up), mesh)


def _filled(camera: Camera, camera_from_world: Rigid, mesh: Mesh) -> tuple[Camera, Rigid]:
    """Return the camera zoomed and shifted so that the model's vertices fill the picture up to a margin."""
    m = camera.lens.project(camera_from_world @ mesh.vertices[np.unique(mesh.faces)])
    low, high = m.min(axis=0), m.max(axis=0)
    size = np.array(camera.size)
    focal = float(np.min(size / (_MARGIN * np.maximum(high - low, 1e-9))))
    cx, cy = (size - 1) / 2 - focal * (low + high) / 2
    return Camera.from_focal(camera.size, focal, cx=float(cx), cy=float(cy)), camera_from_world
