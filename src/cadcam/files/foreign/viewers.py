"""Cameras as the parameters of viewers and renderers: pyvista, pyrender, Open3D, trimesh, Blender.

Plain numbers for the packages' own calls; none of them is imported. All but Open3D's pictures from depth count pixels
from the corner of the picture, half a pixel from ours, and all but Open3D look along -z with y up. None has distortion:
a lens is refused unless its loss is allowed (render the ideal camera, then distort the picture).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cadcam.cad.units import MM, unit_name
from cadcam.camera.camera import Camera
from cadcam.camera.opengl import projection_matrix
from cadcam.files.foreign.blender import blender_values
from cadcam.files.foreign.losses import prepared, refuse
from cadcam.files.foreign.model import ConversionLoss, Holds, NamedCamera
from cadcam.files.foreign.pose import numbers, world_from_eye
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect, expect_known, expect_number

CORNER = 0.5  # from our pixel centres to pixels counted from the picture's corner


def viewer_parameters(
    package: str,
    camera: Camera,
    camera_from_world: Rigid,
    *,
    unit: str = "mm",
    near_mm: float = 10.0,
    far_mm: float = 100_000.0,
    allow_loss: Collection[str] = (),
) -> dict[str, Any]:
    """Return the parameters of a camera for `package` ("pyvista", "pyrender", "open3d", "trimesh", "blender"), by name.

    Lengths in `unit`, that of the viewer's scene. What the keys are for, each as the package takes it:
    pyvista: position, focal_point, up, view_angle (vertical, deg), clipping_range, window_size; window_center for
    SetWindowCenter; projection for SetExplicitProjectionTransformMatrix, which alone carries skew and fx other than fy.
    pyrender: intrinsics for IntrinsicsCamera(**...), pose for scene.add, viewport for OffscreenRenderer(*...).
    open3d: intrinsic_matrix and extrinsic_matrix for create_rays_pinhole and setup_camera, size as (width, height);
    depth_intrinsic_matrix for PinholeCameraIntrinsic with depth pictures, whose pixels count from the centre.
    trimesh: resolution and focal for scene.Camera(**camera), camera_transform for the scene.
    blender: as `cadcam convert --to blender` writes them; always in m.
    Raises `UnknownName`, and `RefusedLoss` for what the package cannot show, unless named in allow_loss.
    """
    expect(package, "package", str)
    expect(camera, "camera", Camera)
    expect_motion(camera_from_world, "camera_from_world")
    expect_number(near_mm, "near_mm")
    expect_number(far_mm, "far_mm")
    expect_known(package, "viewer", VIEWERS)
    viewer = VIEWERS[package]
    ready, losses = prepared(NamedCamera("camera", camera, camera_from_world), viewer, fit=False)
    refuse(losses, allow_loss, viewer.title, can_fit=False)
    mm = MM[unit_name(unit)]
    return viewer.values(ready.camera, camera_from_world, mm, (near_mm, far_mm))


@dataclass(frozen=True, slots=True)
class Viewer:
    """A package that shows a camera's view: what it can show, and its parameters."""

    title: str
    holds: Holds
    values: Callable[[Camera, Rigid, float, tuple[float, float]], dict[str, Any]]

    def extra_losses(self, named: NamedCamera, /) -> Sequence[ConversionLoss]:
        """Return nothing."""
        return ()


def _pyvista(camera: Camera, pose: Rigid, mm: float, clip: tuple[float, float]) -> dict[str, Any]:
    (W, H), (cx, cy) = camera.size, camera.principal_point + CORNER
    eye = pose.origin / mm
    near, far = clip
    return {
        "position": tuple(numbers(eye)),
        "focal_point": tuple(numbers(eye + pose.rotation[2])),
        "up": tuple(numbers(-pose.rotation[1])),
        "view_angle": float(np.degrees(2 * np.arctan2(H / 2, camera.fy))),
        "clipping_range": (near / mm, far / mm),
        "window_size": (W, H),
        "window_center": (float(1 - 2 * cx / W), float(2 * cy / H - 1)),
        "projection": projection_matrix(camera, near=near / mm, far=far / mm),
    }


def _pyrender(camera: Camera, pose: Rigid, mm: float, clip: tuple[float, float]) -> dict[str, Any]:
    cx, cy = (camera.principal_point + CORNER).tolist()
    near, far = clip
    intrinsics = {"fx": camera.fx, "fy": camera.fy, "cx": cx, "cy": cy, "znear": near / mm, "zfar": far / mm}
    return {"intrinsics": intrinsics, "pose": world_from_eye(pose, mm), "viewport": camera.size}


def _open3d(camera: Camera, pose: Rigid, mm: float, clip: tuple[float, float]) -> dict[str, Any]:
    corner, extrinsic = camera.K.copy(), pose.matrix
    corner[:2, 2] += CORNER
    extrinsic[:3, 3] /= mm
    return {
        "size": camera.size,
        "intrinsic_matrix": corner,
        "depth_intrinsic_matrix": camera.K.copy(),
        "extrinsic_matrix": extrinsic,
    }


def _trimesh(camera: Camera, pose: Rigid, mm: float, clip: tuple[float, float]) -> dict[str, Any]:
    near, far = clip
    values = {"resolution": camera.size, "focal": (camera.fx, camera.fy), "z_near": near / mm, "z_far": far / mm}
    return {"camera": values, "camera_transform": world_from_eye(pose, mm)}


def _blender(camera: Camera, pose: Rigid, mm: float, clip: tuple[float, float]) -> dict[str, Any]:
    return blender_values(camera, pose)


_IDEAL: dict[str, tuple[str, ...]] = {"ideal": ()}
VIEWERS = {
    "pyvista": Viewer("pyvista", Holds(_IDEAL, skew="yes", pose="yes"), _pyvista),
    "pyrender": Viewer("pyrender", Holds(_IDEAL, pose="yes"), _pyrender),
    "open3d": Viewer("Open3D", Holds(_IDEAL, pose="yes"), _open3d),
    "trimesh": Viewer("trimesh", Holds(_IDEAL, principal_point=False, pose="yes"), _trimesh),
    "blender": Viewer("Blender", Holds(_IDEAL, pose="yes"), _blender),
}
