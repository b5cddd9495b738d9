"""The picture of a board is the mean of its ink over each pixel, where the camera sees it."""

from __future__ import annotations

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.target.boards.pattern import parse_pattern
from cadcam.target.marks.ideal import board_picture

CAMERA = Camera.from_focal((64, 48), 100.0, cx=20.0, cy=20.0)


def test_a_border_through_a_pixel_shows_its_share_of_ink() -> None:
    """At 1 px/mm the square from -10 to 0 mm ends at pixel 20, the pixel's middle; half of it is ink.

    A picture whose (0, 0) were the pixel's corner would show all of it or none.
    """
    at = Rigid(np.eye(3), [0.0, 0.0, 100.0])
    picture = board_picture(parse_pattern("chessboard:2x2:10mm"), CAMERA, at, paper=1.0, ink=0.0)
    assert np.allclose(picture[12, 19:22], [0.0, 0.5, 1.0], atol=1 / 377)
    assert np.allclose(picture[19:22, 12], [0.0, 0.5, 1.0], atol=1 / 377)


def test_the_share_of_ink_is_exact_to_the_sampling_anywhere() -> None:
    """Shifted by any part of a pixel: error at most one of 377 samples (evenly spaced along x)."""
    for shift in (0.1, 0.25, 0.37, 0.49):
        at = Rigid(np.eye(3), [shift, 0.0, 100.0])
        picture = board_picture(parse_pattern("chessboard:2x2:10mm"), CAMERA, at, paper=1.0, ink=0.0)
        assert abs(picture[12, 20] - (0.5 - shift)) < 1.5 / 377


def test_discs_have_their_area_at_any_tilt() -> None:
    """The missing light of a disc, in mm^2: pi r^2 after the pixel's own area on the board is divided out."""
    pattern = parse_pattern("circles:2x2:16mm:9mm")
    at = Rigid.exp([0, 0, 0, 0.5, -0.4, 0.2])
    at = Rigid(at.rotation, at.rotation @ [-8.0, -8.0, 0.0] + [10.0, 3.0, 100.0])
    picture = board_picture(pattern, CAMERA, at, paper=1.0, ink=0.0, background=1.0, margin_mm=20.0).astype(float)
    q = CAMERA.pixel_grid()
    ray = CAMERA.unproject(q) @ at.rotation
    t = -at.inv.translation[2] / ray[..., 2]
    p = (at.inv.translation + t[..., None] * ray)[..., :2]
    area = np.abs(np.linalg.det(np.stack([np.gradient(p, axis=1), np.gradient(p, axis=0)], axis=-1)))
    near = (np.abs(p - 8.0) < 20.0).all(axis=-1)
    seen = ((1 - picture) * area)[near].sum()
    assert abs(seen / (4 * np.pi * 4.5**2) - 1) < 2e-3  # 1/sqrt(377 samples x 150 border pixels) of the border's share
