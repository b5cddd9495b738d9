"""What tests of hand-written camera files share: points, a pose, a file's only camera, its agreement with a formula."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.files.foreign.model import NamedCamera
from cadcam.files.foreign.registry import read_cameras
from cadcam.geometry import rotation as so3

R = so3.exp([0.3, -0.2, 0.5])
T = np.array([0.12, -0.34, 2.5])  # metres
GL = np.diag([1.0, -1.0, -1.0])  # our axes of OpenGL's eye


def points(rng: np.random.Generator, n: int = 50) -> Array:
    """Points (n, 3) in metres, in the camera frame and in view."""
    z = rng.uniform(0.5, 3, n)
    return np.stack([rng.uniform(-0.35, 0.35, n) * z, rng.uniform(-0.25, 0.25, n) * z, z], axis=1)


def brown(p: Array, k1: float, k2: float, p1: float, p2: float, k3: float = 0.0) -> tuple[Array, Array]:
    """OpenCV's documented distortion, terms in its order."""
    x, y = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    r2 = x * x + y * y
    g = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def only(path: Path, text: str | bytes, **options: Any) -> NamedCamera:
    """The one camera of a file with this content."""
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    cameras = read_cameras(path, **options).cameras
    assert len(cameras) == 1
    return cameras[0]


def agree(named: NamedCamera, p: Array, u: Array, v: Array, *, posed: bool = True) -> None:
    """The camera images points p (m) of its own frame at (u, v) px, and its pose is (R, T)."""
    assert np.abs(named.camera.project(p) - np.stack([u, v], axis=-1)).max() < 1e-9
    if posed:
        assert named.camera_from_world is not None
        assert np.abs(named.camera_from_world.rotation - R).max() < 1e-9
        assert np.abs(named.camera_from_world.translation / 1000 - T).max() < 1e-9


def text_of(values: Array) -> str:
    return ", ".join(repr(float(v)) for v in np.ravel(values))
