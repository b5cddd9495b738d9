"""Whose pixel (0, 0) is where: OpenCV's finders count from the centre of a pixel as we do, AprilTag does not."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.image.picture import read_picture, to_gray
from cadcam.target.boards import opencv
from cadcam.target.boards.detect import detect
from cadcam.target.boards.pattern import Charuco, parse_pattern

from .shots import CAMERA, pose, shot

cv2 = pytest.importorskip("cv2", reason="the finders are OpenCV's", exc_type=ImportError)
MARKERS = "charuco:7x5:30mm:22mm:5X5_100"


def test_opencv_s_chessboard_finders_count_pixels_as_we_do() -> None:
    """Mean error over 40 corners: below a tenth of the half pixel that another origin would make."""
    picture, q = shot("chessboard:8x5:25mm", noise=0.0)
    answers = dict(opencv.chessboard_candidates(picture, 8, 5))
    assert "cv2.findChessboardCorners" in answers
    assert "cv2.findChessboardCornersSB" in answers
    for corners in answers.values():
        either = min((corners, corners[::-1]), key=lambda c: float(np.abs(c - q).mean()))
        assert np.abs((either - q).mean(axis=0)).max() < 0.05


def test_our_corners_are_nearer_the_truth_than_opencv_s() -> None:
    """Why the corners are fitted anew: rms error against the truth, noise 0.01 of white, blur 0.7 px."""
    text = "chessboard:8x5:25mm"
    picture, q = shot(text)
    ours = np.sqrt(np.mean((detect(picture, parse_pattern(text)).q - q) ** 2))
    for corners in dict(opencv.chessboard_candidates(picture, 8, 5)).values():
        theirs = min(np.sqrt(np.mean((c - q) ** 2)) for c in (corners, corners[::-1]))
        assert ours < 0.75 * theirs


@pytest.mark.parametrize(
    ("text", "staggered"), [("circles:7x5:25mm:13mm", False), ("staggered-circles:4x7:18mm:12mm", True)]
)
def test_opencv_s_circle_finder_counts_pixels_as_we_do(text: str, staggered: bool) -> None:
    picture, _ = shot(text, noise=0.0)
    pattern = parse_pattern(text)
    ours = detect(picture, pattern).q
    answers = list(opencv.circle_candidates(picture, pattern.columns, pattern.rows, staggered=staggered))
    assert answers
    for _, light, centres in answers:
        assert not light
        nearest = np.linalg.norm(ours[:, None] - centres, axis=2).argmin(axis=1)
        assert np.abs((centres[nearest] - ours).mean(axis=0)).max() < 0.1


def marker_truth(text: str, number: np.ndarray) -> np.ndarray:
    """Where the camera sees the corners of markers (M, 4, 2)."""
    pattern = parse_pattern(text)
    assert isinstance(pattern, Charuco)
    at = pose(pattern, turn=(22.0, -17.0, 8.0), distance=290.0, aside=(4.0, 3.0))
    low, high = (pattern.square_mm - pattern.marker_mm) / 2, (pattern.square_mm + pattern.marker_mm) / 2
    corners = np.array([[low, low], [high, low], [high, high], [low, high]])
    p = (pattern.marker_squares[number] - 1)[:, None] * pattern.square_mm + corners
    return CAMERA.project(at @ np.concatenate([p, np.zeros((*p.shape[:2], 1))], axis=-1))


def test_opencv_s_marker_corners_count_pixels_as_we_do() -> None:
    """They are whole-pixel contours: good to half a pixel each, to a tenth in the mean of 68."""
    picture, _ = shot(MARKERS, noise=0.0)
    number, corners = opencv.find_markers(picture, "5X5_100")
    assert len(number) == 17
    assert np.abs((corners - marker_truth(MARKERS, number)).mean(axis=(0, 1))).max() < 0.12


def test_opencv_s_apriltag_refinement_counts_from_the_pixel_s_corner() -> None:
    """The one exception among OpenCV's own: half a pixel right and down. Nothing here uses it."""
    picture, _ = shot(MARKERS, noise=0.0)
    aruco = cv2.aruco
    parameters = aruco.DetectorParameters()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_APRILTAG
    corners, number, _ = aruco.ArucoDetector(opencv.dictionary("5X5_100"), parameters).detectMarkers(
        opencv.as_bytes(picture)
    )
    q = np.array([opencv.pixels(c) for c in corners])
    offset = (q - marker_truth(MARKERS, np.asarray(number).ravel())).mean(axis=(0, 1))
    assert np.allclose(offset, 0.5, atol=0.1)


def test_apriltag_s_published_corners_are_those_of_that_refinement(shared: Callable[[str], Path]) -> None:
    """So the AprilTag library too counts from the pixel's corner: its coordinates are ours plus (1/2, 1/2)."""
    folder = shared("data/apriltag_test")
    aruco = cv2.aruco
    parameters = aruco.DetectorParameters()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_APRILTAG
    offsets = []
    for file in sorted(folder.glob("*.txt")):
        known = np.array([[float(n) for n in re.findall(r"\d+\.\d+", line)] for line in file.read_text().splitlines()])
        known = known.reshape(-1, 4, 2)
        picture = opencv.as_bytes(to_gray(read_picture(file.with_suffix(".jpg"))))
        corners, _, _ = aruco.ArucoDetector(opencv.dictionary("APRILTAG_36h11"), parameters).detectMarkers(picture)
        for q in (opencv.pixels(c).mean(axis=0) for c in corners):
            away = known.mean(axis=1) - q
            offsets.append(away[np.hypot(*away.T).argmin()])
    assert len(offsets) >= 10
    assert np.abs(np.median(offsets, axis=0)).max() < 0.01
