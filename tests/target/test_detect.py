"""Boards are found whole, to the predicted hundredths of a pixel, and nothing else is mistaken for one."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Picture
from cadcam.camera.camera import Camera
from cadcam.errors import MissingExtra, NoBoard
from cadcam.geometry.rigid import Rigid
from cadcam.target.boards import opencv
from cadcam.target.boards.circles import disc_shift
from cadcam.target.boards.detect import Detection, detect
from cadcam.target.boards.pattern import CircleGrid, parse_pattern
from cadcam.target.marks.ideal import board_picture

from .shots import CAMERA, TEXTS, pose, shot

TURN = (22.0, -17.0, 8.0)


def need(text: str) -> None:
    if text.startswith("charuco"):
        pytest.importorskip("cv2", reason="markers are read by OpenCV", exc_type=ImportError)


def errors(text: str, found: Detection, q: np.ndarray) -> np.ndarray:
    """Measured minus true (N, 2); of discs, from where the middle of their picture is."""
    pattern = parse_pattern(text)
    truth = q[found.points]
    if isinstance(pattern, CircleGrid):
        at = pose(pattern, turn=TURN, distance=290.0, aside=(4.0, 3.0))
        truth = truth + disc_shift(CAMERA, at, found.p_board, pattern.printed_diameter_mm / 2)
    return np.asarray(found.q - truth)


@pytest.mark.parametrize("text", TEXTS)
def test_every_point_is_found_within_its_predicted_covariance(text: str) -> None:
    """2N normalised errors: their rms scatters by 1/sqrt(4N), 0.09 for 28 discs; 1.35 and 0.7 are four of that."""
    need(text)
    picture, q = shot(text)
    found = detect(picture, parse_pattern(text))
    assert len(found) == len(q)
    sigma = np.sqrt(np.einsum("nii->ni", found.covariance))
    normalised = errors(text, found, q) / sigma
    assert 0.7 < np.sqrt(np.mean(normalised**2)) < 1.35
    assert np.abs(normalised).max() < 5


@pytest.mark.parametrize("text", TEXTS)
def test_no_detector_is_off_by_a_part_of_a_pixel(text: str) -> None:
    """Without noise: the mean error is 0.004 px at most, where a half pixel's mistake in an origin would be 0.5."""
    need(text)
    picture, q = shot(text, noise=0.0)
    e = errors(text, detect(picture, parse_pattern(text)), q)
    assert np.abs(e.mean(axis=0)).max() < 0.004
    assert np.abs(e).max() < 0.03


def test_the_centre_of_a_disc_s_picture_is_not_the_picture_of_its_centre() -> None:
    """The negative control of the shift: without it the same detection is off by ten times its error."""
    text = TEXTS[1]
    picture, q = shot(text, noise=0.0)
    found = detect(picture, parse_pattern(text))
    off = np.abs(found.q - q[found.points]).max()
    assert off > 0.03
    assert np.abs(errors(text, found, q)).max() < off / 5


def test_the_shift_is_the_conic_s_for_a_pinhole() -> None:
    """Independent of the quadrature: centre of the ellipse H diag H^T by projective geometry, ideal lens."""
    camera = Camera.from_focal((640, 480), 500.0)
    at = Rigid.exp([30.0, -20.0, 300.0, 0.7, 0.4, 0.1])
    r = 12.0
    H = camera.K @ np.column_stack([at.rotation[:, :2], at.translation])
    dual = H @ np.diag([r * r, r * r, -1.0]) @ H.T
    centre = dual[:2, 2] / dual[2, 2]
    expected = centre - camera.project(at @ np.zeros((1, 3)))[0]
    assert np.abs(expected).max() > 0.1
    assert np.allclose(disc_shift(camera, at, np.zeros((1, 3)), r)[0], expected, atol=1e-6)


@pytest.mark.parametrize(("blur", "noise"), [(0.4, 0.0), (1.5, 0.02), (2.5, 0.03)])
def test_blur_and_noise_cost_accuracy_not_points(blur: float, noise: float) -> None:
    text = TEXTS[0]
    picture, q = shot(text, blur=blur, noise=noise)
    found = detect(picture, parse_pattern(text))
    assert len(found) == len(q)
    assert np.abs(found.q - q[found.points]).max() < 0.03 + 4 * found.sigma_px


@pytest.mark.parametrize("angle", [170.0, *(pytest.param(angle, marks=pytest.mark.slow) for angle in (75.0, -100.0))])
@pytest.mark.parametrize("text", [TEXTS[0], TEXTS[1]])
def test_a_board_is_found_whichever_way_up(text: str, angle: float) -> None:
    picture, q = shot(text, turn=(10.0, -12.0, angle), distance=330.0, noise=0.0)
    found = detect(picture, parse_pattern(text))
    assert len(found) == len(q)
    if parse_pattern(text).turns == 1:
        assert np.abs(found.q - q[found.points]).max() < 0.03


def test_a_board_that_looks_the_same_turned_is_taken_upright() -> None:
    text = TEXTS[1]
    for angle in (0.0, 180.0):
        picture, _ = shot(text, turn=(10.0, -12.0, angle), distance=330.0, noise=0.0)
        found = detect(picture, parse_pattern(text))
        assert found.q[1, 0] > found.q[0, 0]
    assert parse_pattern(text).turns == 2


def covered(picture: Picture, x: slice, y: slice) -> Picture:
    out = picture.copy()
    out[y, x] = 0.35
    return out


@pytest.mark.parametrize("text", TEXTS)
def test_a_finger_over_the_board_costs_the_points_under_it(text: str) -> None:
    """What is left is as good as before: an edge of the finger is no corner and moves none."""
    need(text)
    picture, q = shot(text, noise=0.0)
    x, y = np.median(q, axis=0).astype(int)
    hidden = covered(picture, slice(x - 26, x + 26), slice(y - 26, y + 26))
    found = detect(hidden, parse_pattern(text))
    under = (np.abs(q - [x, y]) < 26).all(axis=1)
    assert under.any()
    assert not under[found.points].any()
    assert len(found) >= 0.6 * len(q)
    assert np.abs(errors(text, found, q)).max() < 0.06


def test_half_a_chessboard_is_refused_where_it_may_be_several_halves() -> None:
    text = "chessboard:8x5:25mm"
    picture, q = shot(text, noise=0.0)
    cut = covered(picture, slice(0, int(np.sort(q[:, 0])[12])), slice(0, 400))
    with pytest.raises(NoBoard, match="several parts"):
        detect(cut, parse_pattern(text))


def test_half_a_charuco_board_is_taken() -> None:
    pytest.importorskip("cv2", reason="markers are read by OpenCV", exc_type=ImportError)
    text = TEXTS[3]
    picture, q = shot(text, noise=0.0)
    cut = covered(picture, slice(0, int(np.median(q[:, 0]))), slice(0, 400))
    found = detect(cut, parse_pattern(text))
    assert 6 <= len(found) < 16
    assert np.abs(found.q - q[found.points]).max() < 0.05


@pytest.mark.parametrize(
    ("shown", "asked", "seen"),
    [
        ("chessboard:8x5:25mm", "chessboard:7x5:25mm", (8, 5)),
        ("chessboard:8x5:25mm", "chessboard:9x6:25mm", (8, 5)),
        ("circles:7x5:25mm:13mm", "circles:7x4:25mm", (7, 5)),
        ("staggered-circles:4x7:18mm:12mm", "staggered-circles:4x9:18mm", (4, 7)),
    ],
)
def test_another_board_than_asked_for_is_named(shown: str, asked: str, seen: tuple[int, int]) -> None:
    picture, _ = shot(shown)
    with pytest.raises(NoBoard) as error:
        detect(picture, parse_pattern(asked))
    assert error.value.seen == seen


def test_a_charuco_board_s_wrong_width_or_dictionary_is_named() -> None:
    pytest.importorskip("cv2", reason="markers are read by OpenCV", exc_type=ImportError)
    picture, _ = shot(TEXTS[3])
    with pytest.raises(NoBoard, match="on one of 7 columns"):
        detect(picture, parse_pattern("charuco:5x7:30mm:22mm:5X5_100"))
    with pytest.raises(NoBoard, match="of 5X5_1000"):
        detect(picture, parse_pattern("charuco:7x5:30mm:22mm:6X6_100"))


def test_a_legacy_charuco_board_is_recognised() -> None:
    pytest.importorskip("cv2", reason="markers are read by OpenCV", exc_type=ImportError)
    picture, q = shot("charuco:7x6:28mm:20mm:4X4_50:legacy", noise=0.0)
    found = detect(picture, parse_pattern("charuco:7x6:28mm:20mm:4X4_50"))
    assert len(found) == len(q)
    assert np.abs(found.q - q[found.points]).max() < 0.03
    assert any("legacy" in line for line in found.tried)


def test_no_board_is_seen_in_a_picture_without_one(rng: np.random.Generator) -> None:
    """Noise, and a shaded scene of boxes: edges, corners, even crossings of edges."""
    from scipy.ndimage import gaussian_filter

    scene = gaussian_filter(rng.normal(0.5, 0.6, (240, 320)), 3).astype(np.float32)
    for _ in range(30):
        x, y = rng.integers(0, 300), rng.integers(0, 220)
        scene[y : y + rng.integers(8, 60), x : x + rng.integers(8, 60)] = rng.uniform(0, 1)
    for picture in (scene, rng.uniform(0, 1, (240, 320)), np.full((240, 320), 0.5)):
        for text in TEXTS[:2]:
            with pytest.raises(NoBoard):
                detect(picture, parse_pattern(text))


def test_light_discs_on_dark_are_found_too() -> None:
    text = TEXTS[1]
    picture, q = shot(text, noise=0.0)
    found = detect(1 - picture, parse_pattern(text))
    assert len(found) == len(q)
    assert "light" in found.detector


def test_the_discs_radius_is_measured() -> None:
    found = detect(shot(TEXTS[1], noise=0.0)[0], parse_pattern("circles:7x5:25mm"))
    assert found.radius_mm == pytest.approx(6.5, rel=0.01)


def test_a_large_picture_is_searched_small_and_measured_in_full() -> None:
    """The way back from the reduced picture keeps the half pixel, as far as the fit starts beside its corner."""
    pattern = parse_pattern("chessboard:8x5:25mm")
    camera = Camera.from_focal((1240, 900), 1150.0)
    at = pose(pattern, turn=TURN, distance=320.0, aside=(4.0, 3.0))
    picture = board_picture(pattern, camera, at, blur_px=1.0)
    found = detect(picture, pattern)
    assert "scale 0.73" in found.detector
    assert len(found) == 40
    assert np.abs(found.q - camera.project(at @ found.p_board)).max() < 0.03


def test_without_opencv_a_charuco_board_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "cv2", None)
    assert not opencv.has_opencv()
    with pytest.raises(MissingExtra, match=r'pip install "cadcam\[boards\]"'):
        detect(np.zeros((50, 50)), parse_pattern(TEXTS[3]))
    assert len(detect(shot(TEXTS[0])[0], parse_pattern(TEXTS[0]))) == 40


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("shape", [(1, 1), (3, 40), (7, 9), (15, 200), (16, 17)])
def test_a_picture_too_small_for_a_board_shows_none(
    text: str, shape: tuple[int, int], rng: np.random.Generator
) -> None:
    need(text)
    for picture in (rng.random(shape), np.zeros(shape)):
        with pytest.raises(NoBoard):
            detect(picture, parse_pattern(text))
