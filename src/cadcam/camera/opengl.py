"""OpenGL's values for a camera: glFrustum, gluLookAt, glViewport (thesis section 3.2) and the exact 4x4 matrix.

The only file with OpenGL's eye frame (x right, y up, z back) and its normalised device coordinates:
x_ndc = 2 (x + 1/2)/W - 1, y_ndc = 1 - 2 (y + 1/2)/H for our pixel (x, y), window row 0 on top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid

EYE_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])  # OpenGL's eye axes of our camera axes


@dataclass(frozen=True, slots=True)
class Frustum:
    """The six arguments of glFrustum, in the unit of near (mm)."""

    left: float
    right: float
    bottom: float
    top: float
    near: float
    far: float

    @property
    def matrix(self) -> Array:
        """Return the 4x4 matrix that glFrustum multiplies with (thesis Table 3.1, signs corrected)."""
        w, h, d = self.right - self.left, self.top - self.bottom, self.far - self.near
        return np.array(
            [
                [2 * self.near / w, 0, (self.right + self.left) / w, 0],
                [0, 2 * self.near / h, (self.top + self.bottom) / h, 0],
                [0, 0, -(self.far + self.near) / d, -2 * self.far * self.near / d],
                [0, 0, -1, 0],
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class LookAt:
    """The three arguments of gluLookAt in world coordinates: eye and centre in mm, up as a unit vector."""

    eye: Array
    center: Array
    up: Array

    @property
    def matrix(self) -> Array:
        """Return the 4x4 matrix eye_from_world that gluLookAt multiplies with."""
        forward = self.center - self.eye
        forward = forward / np.linalg.norm(forward)
        side = np.cross(forward, self.up / np.linalg.norm(self.up))
        side = side / np.linalg.norm(side)
        out = np.eye(4)
        out[:3, :3] = np.stack([side, np.cross(side, forward), -forward])
        out[:3, 3] = -out[:3, :3] @ self.eye
        return out


def frustum(camera: Camera, *, near: float, far: float, pixel_corners: bool = True) -> Frustum:
    """Return glFrustum's arguments (thesis Table 3.2 with bottom and top corrected), scaled to `near` in mm.

    With `pixel_corners` the sides lie half a pixel outside the first and last pixel centres, as OpenGL samples;
    without, the values are the thesis' own (left = -V0, right = W - V0, bottom = U0 - H, top = U0), half a pixel off.
    glFrustum knows neither skew nor distortion: `projection_matrix` carries the skew exactly.
    """
    _check_range(near, far)
    half = 0.5 if pixel_corners else 0.0
    cx, cy = camera.principal_point
    x, y = near / camera.fx, near / camera.fy
    return Frustum(
        left=float(-(cx + half) * x),
        right=float((camera.width - half - cx) * x),
        bottom=float((cy + half - camera.height) * y),
        top=float((cy + half) * y),
        near=near,
        far=far,
    )


def look_at(camera: Camera, camera_from_world: Rigid) -> LookAt:
    """Return gluLookAt's arguments (thesis Table 3.4, corrected): eye F, centre F + view axis, up along the columns.

    up is minus the direction of a pixel column, sign(det M) times the first column of M^-1. With skew that is not
    exactly the camera's -y: gluLookAt and glFrustum cannot tilt one image axis alone, and this choice keeps the columns
    upright. The exact pair is `model_view_matrix` and `projection_matrix`.
    """
    eye = camera_from_world.origin
    column = np.array([-camera.skew / camera.fx, 1.0, 0.0]) @ camera_from_world.rotation
    return LookAt(eye, eye + camera_from_world.rotation[2], -column / np.linalg.norm(column))


def viewport(camera: Camera) -> tuple[int, int, int, int]:
    """Return glViewport's (x, y, width, height) in px (thesis Table 3.6)."""
    return 0, 0, camera.width, camera.height


def projection_matrix(camera: Camera, *, near: float, far: float) -> Array:
    """Return the 4x4 clip_from_eye with fx, fy, skew and principal point exactly; the lens is not included."""
    _check_range(near, far)
    K, (W, H) = camera.K, camera.size
    return np.array(
        [
            [2 * K[0, 0] / W, -2 * K[0, 1] / W, 1 - 2 * (K[0, 2] + 0.5) / W, 0],
            [0, 2 * K[1, 1] / H, 2 * (K[1, 2] + 0.5) / H - 1, 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )


def model_view_matrix(camera_from_world: Rigid) -> Array:
    """Return the 4x4 eye_from_world in OpenGL's eye axes; equal to `look_at(...).matrix` where there is no skew."""
    out = camera_from_world.matrix
    out[..., :3, :] = EYE_FROM_CAMERA @ out[..., :3, :]
    return out


def _check_range(near: float, far: float) -> None:
    if not (0 < near < far and np.isfinite(far)):
        raise BadValue("(near, far)", (near, far), "0 < near < far, in mm")
