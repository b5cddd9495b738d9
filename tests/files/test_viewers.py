"""Cameras as the parameters of viewers: the formula of each, and the packages themselves where they are installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.errors import UnknownName
from cadcam.files.foreign.losses import RefusedLoss
from cadcam.files.foreign.viewers import VIEWERS, viewer_parameters
from cadcam.geometry.rigid import Rigid

CAMERA = Camera.from_focal((64, 48), 80.0, fy=75.0, cx=30.2, cy=25.1)
SQUARE = Camera.from_focal((64, 48), 80.0, cx=30.2, cy=25.1)
CENTRED = Camera.from_focal((64, 48), 80.0, fy=75.0)
POSE = Rigid.look_at([300, -200, 250], [1, 2, 3])
POINTS = np.random.default_rng(0).uniform(-30, 30, (20, 3))  # mm


def pixels(clip_from_world: Array, size: tuple[int, int]) -> Array:
    """Pixels of the points (in m) by a clip matrix: OpenGL's window, row 0 on top, pixel centres at integers."""
    clip = np.concatenate([POINTS / 1000, np.ones((len(POINTS), 1))], axis=1) @ clip_from_world.T
    ndc = clip[:, :2] / clip[:, 3:]
    return np.stack([(ndc[:, 0] + 1) * size[0] / 2 - 0.5, (1 - ndc[:, 1]) * size[1] / 2 - 0.5], axis=-1)


def look_at(v: dict[str, Any]) -> Array:
    """VTK's view matrix of position, focal point and up."""
    eye, target, up = (np.asarray(v[k]) for k in ("position", "focal_point", "up"))
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
    out = np.eye(4)
    out[:3, :3] = np.stack([right, np.cross(back, right), back])
    out[:3, 3] = -out[:3, :3] @ eye
    return out


def test_pyvistas_angle_and_window_centre_make_the_view_of_square_pixels() -> None:
    """vtkCamera::ComputeProjectionTransform: the window at near is ([-1, 1] + centre) tan(angle/2), aspect W/H."""
    v = viewer_parameters("pyvista", SQUARE, POSE, unit="m")
    height, (wx, wy) = np.tan(np.radians(v["view_angle"]) / 2), v["window_center"]
    width = height * 64 / 48
    P = np.array([[1 / width, 0, wx, 0], [0, 1 / height, wy, 0], [0, 0, -1, 0], [0, 0, -1, 0]])
    assert np.abs(pixels(P @ look_at(v), SQUARE.size) - SQUARE.project(POSE @ POINTS)).max() < 1e-10


def test_pyvistas_explicit_projection_carries_skew_and_aspect() -> None:
    skewed = Camera.from_focal((64, 48), 80.0, fy=70.0, cx=30.2, cy=25.1, skew=6.0)
    v = viewer_parameters("pyvista", skewed, POSE, unit="m")
    assert np.abs(pixels(v["projection"] @ look_at(v), skewed.size) - skewed.project(POSE @ POINTS)).max() < 1e-10


@pytest.mark.parametrize("explicit", [False, True])
def test_vtks_own_camera_agrees(explicit: bool) -> None:
    pv: Any = pytest.importorskip("pyvista", reason="pyvista is a peer here, not a dependency")
    camera = Camera.from_focal((64, 48), 80.0, fy=70.0, cx=30.2, cy=25.1, skew=6.0) if explicit else SQUARE
    v = viewer_parameters("pyvista", camera, POSE, unit="m")
    theirs = pv.Camera()
    theirs.position, theirs.focal_point, theirs.up = v["position"], v["focal_point"], v["up"]
    theirs.view_angle, theirs.clipping_range = v["view_angle"], v["clipping_range"]
    theirs.SetWindowCenter(*v["window_center"])
    if explicit:
        theirs.SetUseExplicitProjectionTransformMatrix(True)
        theirs.SetExplicitProjectionTransformMatrix(pv.vtkmatrix_from_array(v["projection"]))
    M = pv.array_from_vtkmatrix(theirs.GetCompositeProjectionTransformMatrix(64 / 48, -1, 1))
    assert np.abs(pixels(M, camera.size) - camera.project(POSE @ POINTS)).max() < 1e-10


def test_pyrenders_formula() -> None:
    """pyrender IntrinsicsCamera.get_projection_matrix: P02 = 1 - 2 cx/W, P12 = 2 cy/H - 1."""
    v = viewer_parameters("pyrender", CAMERA, POSE, unit="m")
    i = v["intrinsics"]
    P = np.zeros((4, 4))
    P[0, 0], P[1, 1], P[0, 2], P[1, 2] = 2 * i["fx"] / 64, 2 * i["fy"] / 48, 1 - 2 * i["cx"] / 64, 2 * i["cy"] / 48 - 1
    P[3, 2] = -1
    assert np.abs(pixels(P @ np.linalg.inv(v["pose"]), CAMERA.size) - CAMERA.project(POSE @ POINTS)).max() < 1e-10


def test_pyrenders_own_camera_agrees() -> None:
    pyrender: Any = pytest.importorskip("pyrender", reason="pyrender is a peer here, not a dependency")
    v = viewer_parameters("pyrender", CAMERA, POSE, unit="m")
    P = pyrender.IntrinsicsCamera(**v["intrinsics"]).get_projection_matrix(*v["viewport"])
    assert np.abs(pixels(P @ np.linalg.inv(v["pose"]), CAMERA.size) - CAMERA.project(POSE @ POINTS)).max() < 1e-10


def test_open3ds_matrices_project_from_the_corner_and_from_the_centre() -> None:
    v = viewer_parameters("open3d", CAMERA, POSE, unit="m")
    p = POINTS / 1000 @ v["extrinsic_matrix"][:3, :3].T + v["extrinsic_matrix"][:3, 3]
    for key, origin in (("intrinsic_matrix", 0.5), ("depth_intrinsic_matrix", 0.0)):
        q = (p / p[:, 2:]) @ v[key].T
        assert np.abs(q[:, :2] - origin - CAMERA.project(POSE @ POINTS)).max() < 1e-10


def test_open3ds_own_rays_agree() -> None:
    o3d: Any = pytest.importorskip("open3d", reason="Open3D is a peer here, not a dependency")
    v = viewer_parameters("open3d", CAMERA, POSE, unit="m")
    K, T = (o3d.core.Tensor(v[key]) for key in ("intrinsic_matrix", "extrinsic_matrix"))
    rays = o3d.t.geometry.RaycastingScene.create_rays_pinhole(K, T, *v["size"]).numpy()
    ours = CAMERA.unproject(CAMERA.pixel_grid()) @ POSE.rotation
    theirs = rays[..., 3:] / np.linalg.norm(rays[..., 3:], axis=-1, keepdims=True)
    assert np.abs(np.cross(ours, theirs)).max() < 1e-6  # float32; half a pixel would be 6e-3
    assert np.abs(rays[0, 0, :3] * 1000 - POSE.origin).max() < 1e-3


def test_trimeshs_own_rays_agree() -> None:
    """trimesh counts its pixel rows from the bottom."""
    trimesh: Any = pytest.importorskip("trimesh", reason="trimesh is a peer here, not a dependency")
    v = viewer_parameters("trimesh", CENTRED, POSE, unit="m")
    scene = trimesh.Scene([trimesh.creation.box((1, 2, 3))])
    scene.camera = trimesh.scene.Camera(**v["camera"])
    scene.camera_transform = v["camera_transform"]
    origins, directions, at = scene.camera_rays()
    q = np.stack([at[:, 0], 47 - at[:, 1]], axis=-1).astype(float)
    theirs = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.abs(np.cross(CENTRED.unproject(q) @ POSE.rotation, theirs)).max() < 1e-12
    assert np.abs(origins[0] * 1000 - POSE.origin).max() < 1e-9


@pytest.mark.parametrize("package", VIEWERS)
def test_what_a_viewer_cannot_show_is_refused(package: str) -> None:
    distorted = Camera.from_focal((64, 48), 80.0, lens=BrownConrady(-0.2))
    with pytest.raises(RefusedLoss, match="lens: brown-conrady"):
        viewer_parameters(package, distorted, POSE)
    assert viewer_parameters(package, distorted, POSE, allow_loss=("lens",))
    skewed = Camera.from_focal((64, 48), 80.0, skew=1.0)
    if VIEWERS[package].holds.skew == "no":
        with pytest.raises(RefusedLoss, match="skew"):
            viewer_parameters(package, skewed, POSE)
    if package == "trimesh":
        with pytest.raises(RefusedLoss, match="principal-point"):
            viewer_parameters(package, CAMERA, POSE)


def test_an_unknown_viewer_names_the_known_ones() -> None:
    with pytest.raises(UnknownName, match="did you mean 'pyvista'"):
        viewer_parameters("pivista", CAMERA, POSE)
