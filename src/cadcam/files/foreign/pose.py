"""Poses in foreign files: rotations of few digits, OpenGL's eye axes, units of length."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.opengl import EYE_FROM_CAMERA
from cadcam.errors import BadValue, UnreadableFile
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

Fail = Callable[[str, str], UnreadableFile]


def rigid(rotation: Array, translation_mm: Array, fail: Fail) -> Rigid:
    """Return the motion; a rotation off by rounding is replaced by the nearest one, any other is refused."""
    try:
        return Rigid(so3.written(rotation, exact=1e-12), translation_mm)
    except BadValue as error:
        raise fail(f"has a rotation that is none: {error}", "check the file") from None


def rigid_of_matrix(matrix: Array, mm: float, fail: Fail) -> Rigid:
    """Return the motion of a 3x4 or 4x4 matrix whose translation is in units of `mm` millimetres."""
    if matrix.shape == (4, 4) and not np.allclose(matrix[3], [0, 0, 0, 1], rtol=0, atol=1e-9):
        raise fail("has a last row other than 0 0 0 1", "check the file; is the matrix transposed?")
    return rigid(matrix[:3, :3], matrix[:3, 3] * mm, fail)


def world_from_eye(camera_from_world: Rigid, mm: float) -> Array:
    """Return the 4x4 matrix of OpenGL's eye (x right, y up, z back) in the world, lengths in units of `mm` mm."""
    out = camera_from_world.inv.matrix
    out[:3, :3] = out[:3, :3] @ EYE_FROM_CAMERA
    out[:3, 3] /= mm
    return out


def camera_from_world_of_eye(matrix: Array, mm: float, fail: Fail) -> Rigid:
    """Return camera_from_world (mm) of a 4x4 world_from_eye whose lengths are in units of `mm` mm."""
    turned = matrix.copy()
    turned[:3, :3] = turned[:3, :3] @ EYE_FROM_CAMERA
    return rigid_of_matrix(turned, mm, fail).inv


def numbers(values: Array) -> list[float]:
    """Return the values as floats that keep every bit when written."""
    return [float(v) for v in np.asarray(values, dtype=np.float64).ravel()]
