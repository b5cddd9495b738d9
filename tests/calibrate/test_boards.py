"""A camera from pictures of a board: rendered, found, calibrated, and the truth found within its covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.calibrate.boards.coverage import (
    BoardCoverage,
    cell_centres,
    coverage,
    coverage_picture,
    direction_sigma,
    internal_sensitivity,
    sigma_of,
)
from cadcam.calibrate.boards.next_view import next_views
from cadcam.calibrate.boards.pictures import (
    BoardCalibration,
    BoardPicture,
    BoardsDisagree,
    board_views,
    calibrate_boards,
    find_board,
    found_in,
)
from cadcam.calibrate.joint.adjustment import calibrate_jointly
from cadcam.camera.camera import Camera
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.camera.lens import BrownConrady, Fisheye
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, NoBoard, SizeMismatch, TooFewPoints
from cadcam.geometry.rotation import exp
from cadcam.report.boards import boards_as_json, coverage_table
from cadcam.target.boards.detect import detect
from cadcam.target.boards.pattern import parse_pattern

from ..target.shots import CAMERA, pose, shot

CHESS, DISCS = "chessboard:8x5:25mm", "circles:7x5:25mm:13mm"
VIEWS = (
    ((22.0, -17.0, 8.0), 290.0, (4.0, 3.0)),
    ((-28.0, 6.0, -4.0), 300.0, (-22.0, 12.0)),
    ((5.0, 32.0, 12.0), 310.0, (30.0, -8.0)),
    ((-12.0, -34.0, -9.0), 320.0, (-26.0, -20.0)),
    ((30.0, 14.0, 3.0), 270.0, (8.0, -6.0)),
    ((-20.0, 22.0, 15.0), 300.0, (18.0, 20.0)),
)
TRUTH = {"aspect": 420 / 424, "focal": 424.0, "U0": 176.0, "V0": 244.0, "k1": -0.22, "k2": 0.07, "p1": 0.0, "p2": 0.0}


def pictures(text: str) -> list[BoardPicture]:
    views = enumerate(VIEWS)
    shots = [shot(text, turn=t, distance=d, aside=a, seed=k)[0] for k, (t, d, a) in views]
    return [found_in(p, parse_pattern(text), name=f"view{k}.png", sha256=f"{k}") for k, p in enumerate(shots)]


@pytest.fixture(scope="module")
def chess() -> list[BoardPicture]:
    return pictures(CHESS)


@pytest.fixture(scope="module")
def discs() -> list[BoardPicture]:
    return pictures(DISCS)


@pytest.fixture(scope="module")
def calibration(chess: list[BoardPicture]) -> BoardCalibration:
    return calibrate_boards(chess)


def mahalanobis(found: BoardCalibration) -> float:
    e = np.array([found.estimate.value(name) - TRUTH[name] for name in found.estimate.free])
    return float(e @ np.linalg.solve(found.estimate.covariance, e))


@pytest.mark.parametrize("text", [CHESS, DISCS])
def test_the_camera_is_recovered_within_its_covariance(
    text: str, chess: list[BoardPicture], discs: list[BoardPicture]
) -> None:
    """Squared Mahalanobis distance over 8 parameters: chi-square, one in ten thousand above 31."""
    found = calibrate_boards(chess if text == CHESS else discs)
    assert len(found.used) == len(VIEWS)
    assert found.estimate.free == tuple(TRUTH)
    assert found.estimate.rms_px < 0.02
    assert mahalanobis(found) < 31


def pose_errors(estimate: JointEstimate, text: str) -> Array:
    """Errors of where the board stands across the view, by their standard deviations (k, 2)."""
    pattern = parse_pattern(text)
    true = [pose(pattern, turn=t, distance=d, aside=a) for t, d, a in VIEWS]
    off = np.array([estimate.pose(j).origin - at.origin for j, at in enumerate(true)])
    return np.asarray(off[:, :2] / np.sqrt(np.einsum("kii->ki", estimate.pose_covariance)[:, :2]))


def test_discs_without_their_shift_give_other_poses(discs: list[BoardPicture]) -> None:
    """The negative control: the same pictures, the discs' middles taken for their centres.

    The shift is nearly what a small motion of the board does: neither residual nor internals show it, the poses do.
    """
    views = [Observations(p.detection.p_board, p.detection.q) for p in discs if p.detection is not None]
    plain = calibrate_jointly(
        views, CAMERA.size, fixed={"skew": 0.0}, lens=BrownConrady(), free_lens=("k1", "k2", "p1", "p2")
    )
    right = calibrate_boards(discs).estimate
    assert plain.rms_px < 1.1 * right.rms_px
    assert np.abs(pose_errors(right, DISCS)).max() < 4
    assert np.abs(pose_errors(plain, DISCS)).max() > 6


def test_an_unknown_diameter_is_measured(discs: list[BoardPicture]) -> None:
    pattern = parse_pattern("circles:7x5:25mm")
    unsaid = [replace(p, detection=replace(p.detection, pattern=pattern)) for p in discs if p.detection is not None]
    found = calibrate_boards(unsaid)
    assert found.radius_mm == pytest.approx(6.5, rel=0.01)
    assert mahalanobis(found) < 31


def moved(picture: BoardPicture, by: Array) -> BoardPicture:
    assert picture.detection is not None
    return replace(picture, detection=replace(picture.detection, q=picture.detection.q + by))


def test_a_picture_that_does_not_fit_is_left_out_and_named(chess: list[BoardPicture], rng: np.random.Generator) -> None:
    bad = [*chess[:2], moved(chess[2], rng.normal(0, 0.5, (40, 2))), *chess[3:]]
    found = calibrate_boards(bad)
    assert list(found.left_out) == [2]
    assert "outlier" in found.left_out[2]
    assert mahalanobis(found) < 31
    kept = calibrate_boards(bad, keep_all=True)
    assert kept.used == tuple(range(6))


def test_a_stray_point_is_left_out_and_counted(chess: list[BoardPicture]) -> None:
    off = np.zeros((40, 2))
    off[17] = [3.0, -2.0]
    found = calibrate_boards([moved(chess[0], off), *chess[1:]])
    assert found.dropped == (1, 0, 0, 0, 0, 0)
    assert "1,2" not in found.estimate.views[0].names
    assert mahalanobis(found) < 31


def test_pictures_of_several_sizes_are_refused(chess: list[BoardPicture]) -> None:
    with pytest.raises(BoardsDisagree, match=r"most are 480 x 360 px, but not view5.png \(640 x 480\)"):
        calibrate_boards([*chess[:5], replace(chess[5], size=(640, 480))])


def test_another_board_in_most_pictures_is_named() -> None:
    asked = parse_pattern("chessboard:9x6:25mm")
    wrong = [found_in(shot(CHESS, turn=t, distance=d, aside=a, seed=k)[0], asked, name=f"{k}.png")
             for k, (t, d, a) in enumerate(VIEWS[:2])]  # fmt: skip
    with pytest.raises(BoardsDisagree, match="grid of 8 x 5, 0 the one asked for; give 8x5"):
        calibrate_boards(wrong)


def test_a_copy_of_a_picture_counts_once(chess: list[BoardPicture]) -> None:
    found = calibrate_boards([*chess, replace(chess[0], name="copy.png")])
    assert found.left_out == {6: "is a copy of view0.png"}


def test_two_views_are_too_few_and_the_lost_ones_are_named(chess: list[BoardPicture]) -> None:
    blank = found_in(np.full((360, 480), 0.5), parse_pattern(CHESS), name="blank.png", sha256="b")
    with pytest.raises(TooFewPoints, match=r"3 views; 2 given: .*blank.png: nothing in the picture looks like"):
        calibrate_boards([*chess[:2], blank])


def test_a_known_camera_sees_the_boards_points_where_they_are(discs: list[BoardPicture]) -> None:
    """The pictures of discs lie beside their centres by up to 0.3 px here; taken off, 0.02 px of bias would show."""
    views = board_views([discs[0], replace(discs[1], detection=None), *discs[2:]], CAMERA)
    assert [v is None for v in views] == [False, True, False, False, False, False]
    shift, left = [], []
    for (turn, distance, aside), view, picture in zip(VIEWS, views, discs, strict=True):
        if view is None or picture.detection is None:
            continue
        at = pose(parse_pattern(DISCS), turn=turn, distance=distance, aside=aside)
        centres = CAMERA.project(at @ view.p_world)
        shift.append(picture.detection.q - centres)
        left.append(view.q - centres)
    size, off = (float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for x in (shift, left))
    assert off < 0.5 * size
    assert np.abs([r.mean(axis=0) for r in left]).max() < 0.02


def test_a_camera_of_another_picture_size_did_not_take_the_pictures(chess: list[BoardPicture]) -> None:
    with pytest.raises(SizeMismatch, match=r"480 x 360 px but the camera is 640 x 480 px.* --resize 480x360 if"):
        board_views(chess, Camera.from_focal((640, 480), 500.0))
    with pytest.raises(TooFewPoints, match="not found in 6 of 6"):
        board_views([replace(p, detection=None, problem="too dark") for p in chess], CAMERA)


def test_coverage_counts_every_point_and_measures_the_tilts(calibration: BoardCalibration) -> None:
    seen = coverage(calibration)
    assert seen.counts.sum() == 6 * 40
    turned = np.array([(-turn[1], turn[0]) for turn, _, _ in VIEWS])  # turns about x, y, z together nearly add
    assert np.abs(seen.tilt_deg - turned).max() < 7
    assert seen.distance_mm == pytest.approx([np.hypot(d, np.hypot(*a)) for _, d, a in VIEWS], rel=2e-3)
    picture = coverage_picture(calibration)
    assert picture.shape == (360, 480, 3)
    assert picture[0] == pytest.approx(picture[0, ::-1], abs=1e-6)  # its thirds: no point is in the top row
    assert picture[:, 0] == pytest.approx(picture[::-1, 0], abs=1e-6)


def test_what_the_views_lack_is_said() -> None:
    counts = np.ones((6, 8))
    counts[4:, :3] = 0
    seen = BoardCoverage(counts, np.array([[-5.0, -20.0], [10.0, 25.0]]), np.ones(2), np.ones((6, 8)))
    assert seen.doubts() == [
        "no point was seen in the lower left corner",
        "the board was tilted sideways (about the board's vertical axis) over 15 deg only",
    ]
    assert seen.seen_share == pytest.approx(1 - 6 / 48)


def test_where_the_lens_images_nothing_there_is_no_sigma(calibration: BoardCalibration) -> None:
    """A fisheye whose image circle leaves the corners black: no direction is known there, least of all exactly."""
    fisheye = Camera.from_focal(CAMERA.size, 130.0, cx=239.5, cy=179.5, lens=Fisheye(k1=-0.05))
    blind = np.isnan(fisheye.unproject(cell_centres(fisheye))).any(axis=1)
    assert 0 < blind.sum() < 24
    sigma = sigma_of(fisheye, ["focal", "U0", "V0"], np.diag([0.3, 0.5, 0.5]) ** 2)
    assert np.array_equal(np.isnan(sigma), blind)
    assert (sigma[~blind] > 0).all()
    seen = replace(coverage(calibration), sigma_px=sigma.reshape(6, 8))
    table = coverage_table(replace(seen, counts=np.where(blind.reshape(6, 8), 0, 7)))
    assert {cell for row in table.rows for cell in row if "(" not in cell} == {"-"}
    assert "without a sigma: the lens images nothing there" in table.notes
    assert "without a sigma" not in " ".join(coverage_table(coverage(calibration)).notes)
    assert boards_as_json(calibration, seen, [])["coverage"]["direction_sigma_px"][0][0] is None


def test_the_sensitivity_of_directions_is_what_is_left_after_the_best_turn() -> None:
    """Against the real thing: a changed camera, turned until its pixels agree best, to second order in the change."""
    free = ["aspect", "focal", "U0", "V0", "k1"]
    step = np.array([1e-5, 5e-3, 4e-3, -3e-3, 1e-5])
    q = cell_centres(CAMERA)
    ray = CAMERA.unproject(q)
    changed = Camera.from_focal(
        CAMERA.size, (424 + step[1]) * (420 / 424 + step[0]), fy=424 + step[1], cx=244 + step[3], cy=176 + step[2],
        lens=BrownConrady(k1=-0.22 + step[4], k2=0.07),
    )  # fmt: skip
    w = np.zeros(3)
    for _ in range(4):
        r = (changed.project(ray @ exp(w).T) - q).ravel()
        J = np.column_stack([(changed.project(ray @ exp(w + 1e-6 * e).T) - q).ravel() - r for e in np.eye(3)]) / 1e-6
        w = w - np.linalg.lstsq(J, r, rcond=None)[0]
    left = changed.project(ray @ exp(w).T) - q
    predicted = internal_sensitivity(CAMERA, free) @ step
    assert np.abs(predicted).max() > 1e-3
    assert np.allclose(left, predicted, atol=2e-5)


def test_the_advice_keeps_its_promise(calibration: BoardCalibration, chess: list[BoardPicture]) -> None:
    """The view advised is taken by the estimated camera with the estimated noise: the worst sigma falls as promised."""
    advice = next_views(calibration, count=2)
    first = advice[0]
    estimate = calibration.estimate
    assert first.before_px == pytest.approx(direction_sigma(estimate).max())
    assert first.after_px < 0.9 * first.before_px
    assert advice[1].after_px < first.after_px
    assert first.words().startswith("hold the board")
    rng = np.random.default_rng(5)
    p = calibration.pattern.points
    q = estimate.camera.project(first.camera_from_board @ p) + rng.normal(0, estimate.noise_px, (40, 2))
    more = calibrate_jointly(
        [*estimate.views, Observations(p, q)], CAMERA.size, fixed={"skew": 0.0}, lens=BrownConrady(),
        free_lens=("k1", "k2", "p1", "p2"),
    )  # fmt: skip
    actual = sigma_of(more.camera, list(more.free), more.covariance).max()
    assert actual == pytest.approx(first.after_px, rel=0.15)  # the noise is estimated anew, from 432 degrees of freedom


def test_advice_is_in_the_words_of_the_pose(calibration: BoardCalibration) -> None:
    from cadcam.calibrate.boards.coverage import tilts_deg

    for one in next_views(calibration, count=3):
        right, lower = tilts_deg(one.camera_from_board.rotation[None])[0]
        assert np.sign(round(right)) == np.sign(one.right_deg)
        assert np.sign(round(lower)) == np.sign(one.lower_deg)
        assert ("left side away" in one.words()) == (one.right_deg < 0)
        middle = calibration.estimate.camera.project(one.camera_from_board @ calibration.pattern.points.mean(axis=0))
        side = np.sign(np.array(one.place) - 1)
        centre = (np.array(CAMERA.size) - 1) / 2
        assert (np.sign(np.round((middle - centre) / 8)) == side).all()


@pytest.mark.parametrize(("side", "rms"), [("left", 0.14), ("right", 0.14)])
def test_the_well_known_stereo_pictures_calibrate_better_than_their_shipped_values(
    side: str, rms: float, shared: Callable[[str], object]
) -> None:
    """Three of thirteen pictures found whole; OpenCV's own corners leave 0.14 px a coordinate on this set."""
    folder = shared("data/opencv_stereo_chess")
    found = [find_board(f"{folder}/{side}{n:02d}.jpg", parse_pattern("chessboard:9x6:25mm")) for n in (2, 5, 12, 13)]
    assert all(p.detection is not None and len(p.detection) == 54 for p in found)
    assert calibrate_boards(found).estimate.rms_px < rms


def test_a_photo_of_something_else_is_no_board(shared: Callable[[str], object]) -> None:
    from cadcam.image.picture import read_picture

    photo = read_picture(f"{shared('data/apriltag_test')}/34085369442_304b6bafd9_c.jpg")
    with pytest.raises(NoBoard):
        detect(photo[:400, :500], parse_pattern(CHESS))


def test_pictures_in_memory_calibrate_as_those_in_files_do(chess: list[BoardPicture]) -> None:
    """As a camera's own interface gives them: bytes; two equal ones are copies, as two equal files are."""
    shots = [shot(CHESS, turn=t, distance=d, aside=a, seed=k)[0] for k, (t, d, a) in enumerate(VIEWS)]
    found = [find_board(picture, parse_pattern(CHESS), name=f"view{k}") for k, picture in enumerate(shots)]
    assert [one.name for one in found[:2]] == ["view0", "view1"]
    for one, other in zip(found, chess, strict=True):
        assert np.array_equal(one.observations.q, other.observations.q)
    again = calibrate_boards([*found, find_board(shots[0], parse_pattern(CHESS))])
    assert again.left_out == {6: "is a copy of view0"}
    unnamed = [find_board(picture, parse_pattern(CHESS)) for picture in (*shots, shots[0])]
    assert calibrate_boards(unnamed).left_out == {6: "is a copy of picture"}
    bytes_ = (255 * np.clip(shots[0], 0, 1) + 0.5).astype(np.uint8)
    near = find_board(bytes_, parse_pattern(CHESS)).observations.q - found[0].observations.q
    assert np.abs(near).max() < 0.05  # px: the steps of bytes are 0.1 of the pictures' noise
    with pytest.raises(BadValue, match="full_scale is 4095"):
        find_board(bytes_, parse_pattern(CHESS), full_scale=4095)


def test_a_picture_without_the_board_has_no_observations_but_the_reason() -> None:
    lost = find_board(np.random.default_rng(1).random((120, 160)), parse_pattern(CHESS), name="wall")
    assert repr(lost).startswith("BoardPicture('wall', 160 x 120 px, ")
    with pytest.raises(NoBoard, match="no board in wall found"):
        _ = lost.observations
