"""Boards imaged by a distorting camera, with the true points."""

from __future__ import annotations

from functools import cache

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.geometry.rigid import Rigid
from cadcam.target.boards.board import Pattern
from cadcam.target.boards.pattern import parse_pattern
from cadcam.target.marks.ideal import board_picture

CAMERA = Camera.from_focal((480, 360), 420.0, fy=424.0, cx=244.0, cy=176.0, lens=BrownConrady(k1=-0.22, k2=0.07))
TEXTS = (
    "chessboard:8x5:25mm",
    "circles:7x5:25mm:13mm",
    "staggered-circles:4x7:18mm:12mm",
    "charuco:7x5:30mm:22mm:5X5_100",
)
BLUR, NOISE = 0.7, 0.01


def pose(pattern: Pattern, *, turn: tuple[float, float, float], distance: float, aside: tuple[float, float]) -> Rigid:
    """Return camera_from_board with the board's middle at `distance` mm, turned by degrees about x, y, z."""
    middle = Rigid(np.eye(3), -np.append(np.mean([pattern.outline[:2], pattern.outline[2:]], axis=0), 0.0))
    xyz = np.radians(turn)
    turned = Rigid.exp([0, 0, 0, *xyz])
    return Rigid(np.eye(3), [*aside, distance]) @ turned @ middle


@cache
def shot(
    text: str,
    turn: tuple[float, float, float] = (22.0, -17.0, 8.0),
    distance: float = 290.0,
    aside: tuple[float, float] = (4.0, 3.0),
    noise: float = NOISE,
    blur: float = BLUR,
    seed: int = 1,
) -> tuple[Picture, Array]:
    """Return a picture of the board, read-only, and where the camera sees its points (N, 2)."""
    pattern = parse_pattern(text)
    at = pose(pattern, turn=turn, distance=distance, aside=aside)
    picture = board_picture(pattern, CAMERA, at, blur_px=blur, noise=noise, rng=np.random.default_rng(seed))
    picture.setflags(write=False)
    return picture, CAMERA.project(at @ pattern.points)
