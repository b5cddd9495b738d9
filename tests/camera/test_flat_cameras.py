"""Line and plane cameras: matrix and parameters say one thing, Jacobians are derivatives, fronts are known."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.line_camera import LINE_NAMES, LineCamera, LineEstimate, LineObservations
from cadcam.camera.plane_camera import PlaneCamera
from cadcam.errors import BadValue, DegenerateGeometry, UnknownName
from cadcam.geometry.rigid import Rigid

EPS = np.finfo(float).eps
LINES = [
    LineCamera(6.0, 2.0, 2.03, -89.4, 200.0),
    LineCamera(-300.0, 40.0, 0.3, 1200.0, 511.5),
    LineCamera(0.0, 900.0, -3.0, 700.0, -20.0),
    LineCamera(10.0, 5.0, np.pi / 2, -400.0, 0.0),
]
CAMERA = Camera.from_focal((768, 576), 811.0, fy=806.0, skew=1.5, cx=354.0, cy=320.0)
POSE = Rigid.look_at([200.0, -300.0, 800.0], [60.0, 40.0, 0.0])


def in_front(camera: LineCamera, rng: np.random.Generator, n: int = 6) -> np.ndarray:
    z, m = rng.uniform(100, 900, n), rng.uniform(-0.5, 0.5, n)
    return camera.center + z[:, None] * (m[:, None] * camera.rotation[0] - camera.rotation[1])


@pytest.mark.parametrize("camera", LINES)
def test_a_line_camera_comes_back_from_its_matrix_whatever_its_scale_and_sign(
    camera: LineCamera, rng: np.random.Generator
) -> None:
    p = in_front(camera, rng)
    for scale in (1.0, -7.0, 1e-6):
        again = LineCamera.from_matrix(scale * camera.unnormalized_matrix)
        assert -np.pi / 2 < again.alpha <= np.pi / 2 + 4 * EPS
        facing = again.facing(p).vector
        turn = (facing[2] - camera.alpha + np.pi) % (2 * np.pi) - np.pi
        assert turn == pytest.approx(0, abs=1e-12)
        assert np.delete(facing, 2) == pytest.approx(np.delete(camera.vector, 2), rel=1e-11, abs=1e-9)


@pytest.mark.parametrize("camera", LINES)
def test_the_ray_of_a_line_s_pixel_passes_through_what_is_seen_there(
    camera: LineCamera, rng: np.random.Generator
) -> None:
    p = in_front(camera, rng)
    U = camera.project(p)
    assert camera.ray(U).distance(p).max() < 1e3 * EPS * 1000
    assert (camera.ray(U).along(p) > 0).all()
    one = np.column_stack([p, np.ones(len(p))])
    assert np.abs(np.sum(camera.line(U) * one, axis=1)).max() < 1e3 * EPS * 1000
    u = one @ camera.unnormalized_matrix.T
    assert u[:, 0] / u[:, 1] == pytest.approx(U, abs=1e-9)


@pytest.mark.parametrize("camera", LINES)
def test_a_line_camera_s_jacobians_are_its_derivatives(camera: LineCamera, rng: np.random.Generator) -> None:
    """Central differences with steps h: h^2/6 of the third derivative and eps U/h, below 1e-6 of the largest here."""
    p = in_front(camera, rng)
    _, by_p, by_five = camera.project_with_jacobians(p)
    for i in range(2):
        h = 1e-3 * np.eye(2)[i]
        assert (camera.project(p + h) - camera.project(p - h)) / 2e-3 == pytest.approx(by_p[:, i], abs=1e-5)
    for i, step in enumerate((1e-3, 1e-3, 1e-6, 1e-3, 1e-3)):
        h = step * np.eye(5)[i]
        plus, minus = (LineCamera.from_vector(camera.vector + s * h).project(p) for s in (1, -1))
        scale = np.abs(by_five[:, i]).max()
        assert (plus - minus) / (2 * step) == pytest.approx(by_five[:, i], abs=1e-6 * scale + 1e-7)


def test_nothing_behind_a_line_camera_is_seen(rng: np.random.Generator) -> None:
    camera = LINES[0]
    behind = 2 * camera.center - in_front(camera, rng)
    assert np.isnan(camera.project(behind)).all()
    with pytest.raises(DegenerateGeometry, match="on the other"):
        camera.facing(np.concatenate([behind, in_front(camera, rng)]))


def test_what_is_no_line_camera_is_refused() -> None:
    with pytest.raises(DegenerateGeometry, match="at infinity"):
        LineCamera.from_matrix([[1.0, 2, 3], [2, 4, 5]])
    with pytest.raises(BadValue, match="focal"):
        LineCamera(0, 0, 0, 0, 0)
    with pytest.raises(DegenerateGeometry, match="C12"):
        _ = LineCamera(0.0, 0.0, 0.3, 100.0, 5.0).matrix
    with pytest.raises(BadValue, match="one for all"):
        LineObservations([[0.0, 0]], [1.0, 2.0])
    assert LINE_NAMES == ("x", "y", "alpha", "focal", "U0")


@pytest.fixture
def plane_camera() -> PlaneCamera:
    return PlaneCamera.of(CAMERA, POSE)


def test_a_plane_s_matrix_is_the_camera_in_space_without_its_third_column(
    plane_camera: PlaneCamera, rng: np.random.Generator
) -> None:
    p = rng.uniform(-200, 200, (9, 2))
    in_space = CAMERA.project(POSE @ np.column_stack([p, np.zeros(9)]))
    assert plane_camera.project(p) == pytest.approx(in_space, abs=1e3 * EPS * 1000)
    assert plane_camera.unproject(in_space) == pytest.approx(p, abs=1e4 * EPS * 1000)


@pytest.mark.parametrize("scale", [1.0, 1e-5, 300.0])
def test_the_pose_comes_back_from_a_plane_s_matrix_of_any_scale(plane_camera: PlaneCamera, scale: float) -> None:
    again = PlaneCamera(scale * plane_camera.matrix).pose(CAMERA)
    assert again.matrix == pytest.approx(POSE.matrix, abs=1e-9)


def test_a_plane_camera_s_jacobians_are_its_derivatives(plane_camera: PlaneCamera, rng: np.random.Generator) -> None:
    p = rng.uniform(-200, 200, (5, 2))
    _, by_p, by_entry = plane_camera.project_with_jacobians(p)
    for i in range(2):
        h = 1e-3 * np.eye(2)[i]
        difference = (plane_camera.project(p + h) - plane_camera.project(p - h)) / 2e-3
        assert difference == pytest.approx(by_p[..., i], abs=1e-7)
    for i in range(9):
        h = 1e-5 * abs(plane_camera.matrix.ravel()[i]) * np.eye(9)[i].reshape(3, 3)
        plus, minus = (PlaneCamera(plane_camera.matrix + s * h).project(p) for s in (1, -1))
        assert (plus - minus) / (2 * h.sum()) == pytest.approx(by_entry[..., i], rel=1e-6, abs=1e-6)


def test_the_thesis_matrix_has_rows_u_v(plane_camera: PlaneCamera) -> None:
    C = plane_camera.uv_matrix
    u = C @ [30.0, -20.0, 1.0]
    assert u[1::-1] / u[2] == pytest.approx(plane_camera.project([30.0, -20.0]), abs=1e-9)
    assert C[2, 2] == 1
    assert PlaneCamera.from_uv_matrix(C).project([30.0, -20.0]) == pytest.approx(u[1::-1] / u[2], abs=1e-9)


def test_beyond_the_vanishing_line_there_is_nothing(plane_camera: PlaneCamera) -> None:
    horizon = np.cross(plane_camera.matrix[:, 0], plane_camera.matrix[:, 1])
    foot = -horizon[2] * horizon[:2] / (horizon[:2] @ horizon[:2])
    seen = plane_camera.project([0.0, 0.0])
    beyond = foot + (foot - seen)
    assert np.isnan(plane_camera.unproject(beyond)).all()
    assert np.isfinite(plane_camera.unproject(foot + 0.01 * (seen - foot))).all()


def test_what_is_no_plane_camera_is_refused() -> None:
    bent = Camera(CAMERA.size, CAMERA.K, BrownConrady(k1=-0.1))
    with pytest.raises(BadValue, match="distortion"):
        PlaneCamera.of(bent, POSE)
    with pytest.raises(DegenerateGeometry, match="from its edge"):
        PlaneCamera(np.ones((3, 3)))
    p = in_front(LINES[1], np.random.default_rng(1), 8)
    estimate = LineEstimate(LINES[1], LineObservations(p, LINES[1].project(p)), np.eye(5))
    with pytest.raises(UnknownName):
        estimate.sigma("beta")


def test_points_and_pixels_of_another_shape_are_refused() -> None:
    plane = PlaneCamera.of(CAMERA, POSE)
    for call in (plane.project, plane.facing, LINES[0].depth, LINES[0].project):
        with pytest.raises(BadValue, match=r"points of the plane is .*\(\.\.\., 2\)"):
            call([1.0, 2.0, 3.0])
    with pytest.raises(BadValue, match="pixels is"):
        plane.unproject("here")  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="camera_from_plane"):
        PlaneCamera.of(CAMERA, np.eye(4))  # type: ignore[arg-type]
