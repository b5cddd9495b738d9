"""What we write, read and projected by the programs themselves, where they are installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye, InverseBrownConrady, TiltedBrownConrady
from cadcam.camera.opengl import model_view_matrix, projection_matrix
from cadcam.files.foreign.registry import format_named, read_cameras, write_cameras

from .foreign_cameras import lenses_held, random_camera, random_pose


def points_in_view(camera: Camera, rng: np.random.Generator, n: int = 60) -> Array:
    """Points (n, 3) in the camera frame, mm, seen all over the picture."""
    q = rng.uniform([0, 0], [camera.width - 1, camera.height - 1], (n, 2))
    return camera.unproject(q) * rng.uniform(300, 3000, (n, 1))


def test_opencv_reads_and_projects_what_we_write(tmp_path: Path, rng: np.random.Generator) -> None:
    cv2: Any = pytest.importorskip("cv2", reason="OpenCV is a peer here, not a dependency")
    for lens in lenses_held(rng, format_named("opencv").holds):
        camera, pose = random_camera(rng, lens, holds=format_named("opencv").holds), random_pose(rng)
        for name in ("c.yml", "c.xml"):
            path = tmp_path / name
            write_cameras(path, camera, format_name="opencv", camera_from_world=pose)
            file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
            K, D = file.getNode("camera_matrix").mat(), file.getNode("distortion_coefficients").mat()
            view = file.getNode("extrinsic_parameters").mat().ravel()
            file.release()
            world = pose.inv @ points_in_view(camera, rng)
            project = cv2.fisheye.projectPoints if isinstance(lens, Fisheye) else cv2.projectPoints
            theirs = project(world[:, None], view[:3, None], view[3:, None], K, D)[0].reshape(-1, 2)
            assert np.abs(theirs - camera.project(pose @ world)).max() < 1e-8


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_a_calibration_that_opencv_writes_is_read_whatever_is_beside_it(tmp_path: Path, suffix: str) -> None:
    """OpenCV 5 writes an array of one dimension without rows and columns; a view that failed has NaN as its error."""
    cv2: Any = pytest.importorskip("cv2", reason="OpenCV is a peer here, not a dependency")
    file = cv2.FileStorage(str(tmp_path / f"c{suffix}"), cv2.FILE_STORAGE_WRITE)
    K, terms = np.array([[500.0, 0, 320], [0, 505, 240], [0, 0, 1]]), np.array([-0.2, 0.05, 1e-5, -2e-3, 0.01])
    values: dict[str, Any] = {"calibration_time": "Fri 27", "image_width": 640, "image_height": 480}
    values |= {"camera_matrix": K, "distortion_coefficients": terms, "per_view": np.array([np.nan, 0.1])}
    for name, value in values.items():
        file.write(name, value)
    file.release()
    (found,) = read_cameras(tmp_path / f"c{suffix}").cameras
    assert (found.camera.K == K).all()
    assert list(found.camera.lens.parameters.values())[:5] == terms.tolist()


def test_tilted_lenses_are_opencvs(rng: np.random.Generator) -> None:
    cv2: Any = pytest.importorskip("cv2", reason="OpenCV is a peer here, not a dependency")
    for tau in ((0.1, -0.16), (0.3, 0.0), (0.0, -0.3)):
        lens = TiltedBrownConrady(-0.2, 0.05, 5e-4, -3e-4, 0.0, 0.0, 0.0, 0.0, 2e-4, 0.0, -1e-4, 0.0, *tau)
        camera = Camera.from_focal((1280, 960), 1900.0, lens=lens)
        p = points_in_view(camera, rng)
        c = np.array(list(lens.parameters.values()))
        theirs = cv2.projectPoints(p[:, None], np.zeros(3), np.zeros(3), camera.K.copy(), c)[0].reshape(-1, 2)
        assert np.abs(theirs - camera.project(p)).max() < 1e-9


def test_opencv_ignores_the_skew_that_its_files_hold() -> None:
    cv2: Any = pytest.importorskip("cv2", reason="OpenCV is a peer here, not a dependency")
    K = np.array([[500.0, 20, 320], [0, 500, 240], [0, 0, 1]])
    p = np.array([[[0.1, 0.2, 1.0]]])
    q = cv2.projectPoints(p, np.zeros(3), np.zeros(3), K, np.zeros(5))[0].ravel()
    assert np.allclose(q, [370, 340])  # with skew it would be 374


@pytest.mark.parametrize("name", ["kalibr", "ros"])
def test_pyyaml_by_which_kalibr_and_ros_read_finds_numbers(tmp_path: Path, name: str) -> None:
    """YAML 1.1 takes 1e-05 for a text: a number has a point."""
    c = [1e-05, -2e-07, 3e-300, 1e-16]
    camera = Camera.from_focal((640, 480), 500.0, lens=BrownConrady(*c))
    write_cameras(tmp_path / "c.yaml", camera, format_name=name)
    found = yaml.safe_load((tmp_path / "c.yaml").read_text())
    terms = found["cam0"]["distortion_coeffs"] if name == "kalibr" else found["distortion_coefficients"]["data"]
    assert terms == (c if name == "kalibr" else [*c, 0.0])


@pytest.mark.parametrize("name", ["colmap", "colmap-bin"])
def test_colmap_reads_and_projects_what_we_write(tmp_path: Path, rng: np.random.Generator, name: str) -> None:
    pycolmap: Any = pytest.importorskip("pycolmap", reason="COLMAP is a peer here, not a dependency")
    for lens in lenses_held(rng, format_named(name).holds):
        camera, pose = random_camera(rng, lens, holds=format_named(name).holds), random_pose(rng)
        write_cameras(tmp_path / name, camera, format_name=name, camera_from_world=pose)
        model = pycolmap.Reconstruction(str(tmp_path / name))
        image = next(iter(model.images.values()))
        world = pose.inv @ points_in_view(camera, rng)
        in_camera = image.cam_from_world() * world
        theirs = np.asarray(image.camera.img_from_cam(in_camera))
        assert np.abs(theirs - 0.5 - camera.project(pose @ world)).max() < 1e-8
        model.write_binary(str(tmp_path))
        back = read_cameras(tmp_path, format_name="colmap-bin").cameras[0]
        assert np.abs(back.camera.project(pose @ world) - camera.project(pose @ world)).max() < 1e-8


def test_usds_own_frustum_agrees(tmp_path: Path, rng: np.random.Generator) -> None:
    pxr: Any = pytest.importorskip("pxr.UsdGeom", reason="OpenUSD is a peer here, not a dependency")
    from pxr import Usd

    camera, pose = Camera.from_focal((640, 480), 500.0, fy=505.0, cx=330.3, cy=222.2), random_pose(rng)
    write_cameras(tmp_path / "c.usda", camera, camera_from_world=pose)
    stage = Usd.Stage.Open(str(tmp_path / "c.usda"))
    frustum = pxr.Camera(stage.GetPrimAtPath("/camera")).GetCamera(0).frustum
    ours = projection_matrix(camera, near=10.0, far=1e6)
    theirs = np.array(frustum.ComputeProjectionMatrix()).T
    assert np.abs(ours[:2] - theirs[:2]).max() < 1e-6  # their floats
    view = np.array(frustum.ComputeViewMatrix()).T
    view[:3, 3] *= 10  # the stage is in cm
    assert np.abs(view - model_view_matrix(pose)).max() < 1e-3


def test_the_inverse_polynomial_undoes_opencvs_undistortion_direction(rng: np.random.Generator) -> None:
    """Not the same model: HALCON's terms of one sign correspond to OpenCV's of the other, to first order only."""
    forward = Camera.from_focal((640, 480), 900.0, lens=BrownConrady(-0.01))
    backward = Camera.from_focal((640, 480), 900.0, lens=InverseBrownConrady(0.01))
    p = points_in_view(forward, rng)
    difference = np.abs(forward.project(p) - backward.project(p)).max()
    assert 0 < difference < 0.02
