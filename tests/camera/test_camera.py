"""The camera's pixel convention, crop and resize; what is not a camera is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.errors import BadValue

from .cameras import CAMERAS

every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


def test_a_centred_principal_point_lies_between_the_middle_pixels() -> None:
    camera = Camera.from_focal((640, 480), 600.0)
    assert tuple(camera.principal_point) == (319.5, 239.5)
    assert tuple(camera.project(np.array([0.0, 0.0, 5.0]))) == (319.5, 239.5)
    assert camera.pixel_grid().shape == (480, 640, 2)
    assert tuple(camera.pixel_grid()[7, 11]) == (11.0, 7.0)


def test_the_picture_spans_half_a_pixel_beyond_the_centres() -> None:
    camera = Camera.from_focal((640, 480), 600.0)
    corners = np.array([[-0.5, -0.5], [639.5, 479.5], [-0.51, 0], [0, 479.51], [np.nan, 0]])
    assert list(camera.sees(corners)) == [True, True, False, False, False]


@every_camera
def test_crop_shifts_pixels_and_nothing_else(camera: Camera) -> None:
    p = np.array([[10.0, -20.0, 400.0], [-31.0, 5.0, 300.0]])
    assert np.allclose(camera.crop(17, 23, (100, 90)).project(p), camera.project(p) - [17, 23], rtol=0, atol=1e-10)


@every_camera
def test_resize_keeps_the_pictures_corners(camera: Camera) -> None:
    """q' + 1/2 = s (q + 1/2): halving a picture maps its outline on the outline, not centre on centre."""
    small = camera.resize((camera.width // 2, camera.height // 4))
    p = np.array([[10.0, -20.0, 400.0], [-31.0, 5.0, 300.0]])
    expected = (camera.project(p) + 0.5) * [0.5, 0.25] - 0.5
    assert np.allclose(small.project(p), expected, rtol=0, atol=1e-9)


@every_camera
def test_undistorted_pixels_are_those_of_the_camera_without_its_lens(camera: Camera) -> None:
    """Points near the axis, which every lens sees; 1e-9 px: the lens' inverse is iterated."""
    p = np.array([[10.0, -20.0, 400.0], [-31.0, 5.0, 300.0]])
    q = camera.project(p)
    assert np.allclose(camera.undistorted(q), replace(camera, lens=Ideal()).project(p), rtol=0, atol=1e-9)
    assert np.allclose(camera.distorted(camera.undistorted(q)), q, rtol=0, atol=1e-9)
    straight, by_pixel = camera.undistorted_with_jacobian(q)
    assert np.array_equal(straight, camera.undistorted(q))
    for axis, e in enumerate(1e-3 * np.eye(2)):
        difference = (camera.undistorted(q + e) - camera.undistorted(q - e)) / 2e-3
        assert np.allclose(by_pixel[..., axis], difference, rtol=0, atol=1e-6)  # the inverse's 1e-9 px over 2e-3


def test_what_is_not_a_camera_is_refused() -> None:
    K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    for size in ((0, 480), (640.5, 480), (640,), "640x480", (np.inf, 3)):
        with pytest.raises(BadValue, match="picture size"):
            Camera(size, K)
    with pytest.raises(BadValue, match="focal"):
        Camera((640, 480), K * [[-1], [1], [1]])
    with pytest.raises(BadValue, match="upper triangle"):
        Camera((640, 480), K.T)
    with pytest.raises(BadValue, match=r"K\[0, 2\]"):
        Camera((640, 480), K * [[1, 1, np.nan], [1, 1, 1], [1, 1, 1]])
