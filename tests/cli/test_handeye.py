"""`cadcam handeye`: the library's answer in tables or JSON; conventions tested, poses paired by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.files.camera import read_camera, write_camera
from cadcam.files.points import read_points, write_points
from cadcam.files.poses import write_poses
from cadcam.files.robot_poses import read_robot_poses
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from cadcam.target.boards.pattern import parse_pattern

from ..calibrate.test_boards import CHESS, VIEWS
from ..target.shots import CAMERA as SHOT_CAMERA
from ..target.shots import pose as shot_pose
from ..target.shots import shot
from .job import Ran

Cadcam = Callable[..., Ran]
CAMERA = Camera.from_focal((1280, 960), 1200.0)
HELD = Rigid(so3.exp([0.2, -1.0, 0.4]), [20.0, -40, 90])
FIXED = Rigid(so3.exp([2.0, 0.1, -0.3]), [600.0, -100, 50])
N = 8


def kuka(R):
    return np.degrees([np.arctan2(R[1, 0], R[0, 0]), np.arcsin(-R[2, 0]), np.arctan2(R[2, 1], R[2, 2])])


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """Return a folder with camera.json, robot.csv (KUKA, names p1 ...), seen/p1.csv ... and target.csv."""
    rng = np.random.default_rng(7)
    x, y = np.meshgrid(np.arange(6) * 30.0 - 75, np.arange(5) * 30.0 - 60)
    board = np.column_stack([x.ravel(), y.ravel(), np.zeros(30)])
    C = Rigid(so3.exp(rng.uniform(-0.4, 0.4, (N, 3))), rng.uniform(-60, 60, (N, 3)) + np.array([0, 0, 600]))
    off = Rigid(so3.exp(2e-4 * rng.normal(size=(N, 3))), 0.05 * rng.normal(size=(N, 3)))
    B = FIXED @ (HELD @ C).inv @ off
    rows = ["name,X,Y,Z,A,B,C"]
    for i in range(N):
        R, t = B.rotation[i], B.translation[i]
        rows.append(f"p{i + 1}," + ",".join(f"{v:.5f}" for v in (*t, *kuka(R))))
        q = CAMERA.project(board @ C.rotation[i].T + C.translation[i]) + 0.1 * rng.normal(size=(30, 2))
        write_points(tmp_path / "seen" / f"p{i + 1}.csv", Observations(board, q))
    (tmp_path / "robot.csv").write_text("\n".join(rows) + "\n")
    write_camera(tmp_path / "camera.json", CAMERA)
    poses = {f"p{i + 1}": Rigid(C.rotation[i], C.translation[i]) for i in range(N)}
    write_poses(tmp_path / "target.csv", poses)
    return tmp_path


def words(cell: Path, *more: str | Path, robot: str = "robot.csv") -> tuple[str | Path, ...]:
    fixed = ("--mounting", "eye-in-hand", "--camera", cell / "camera.json", "--views", cell / "seen")
    return ("handeye", cell / robot, *fixed, *more)


def test_the_result_is_the_librarys(cadcam: Cadcam, cell: Path) -> None:
    ran = cadcam(*words(cell, "--convention", "kuka", "--json", "-o", cell / "out.json"))
    assert ran.code == 0, ran.err
    robot = read_robot_poses(cell / "robot.csv", convention="kuka")
    views = [read_points(cell / "seen" / f"{name}.csv") for name in robot]
    B = Rigid(np.stack([p.rotation for p in robot.values()]), np.stack([p.translation for p in robot.values()]))
    expected = calibrate_hand_eye(B, views, CAMERA, mounting="eye-in-hand", names=list(robot))
    place = ran.json["flange_from_camera"]
    np.testing.assert_array_equal(place["translation_mm"], expected.flange_from_camera.translation)
    np.testing.assert_array_equal(ran.json["covariance_mm_rad"], expected.covariance)
    np.testing.assert_allclose(place["translation_mm"], HELD.translation, atol=0.5)
    assert (cell / "out.json").read_text() == ran.out
    assert [p["name"] for p in ran.json["poses"]] == list(robot)
    assert ran.json["poses"][0]["sha256"] == views[0].sha256


def test_the_tables_say_where_how_well_and_which_pose_is_strange(cadcam: Cadcam, cell: Path) -> None:
    lines = (cell / "robot.csv").read_text().splitlines()
    name, x, *rest = lines[3].split(",")
    lines[3] = ",".join([name, f"{float(x) + 1.5:.4f}", *rest])
    (cell / "robot.csv").write_text("\n".join(lines))
    ran = cadcam(*words(cell, "--convention", "kuka"))
    assert ran.code == 0, ran.err
    for text in ("flange_from_camera", "base_from_target", "robot's noise: position", "held out", "held-out px"):
        assert text in ran.out
    marked = [line.split()[0] for line in ran.out.splitlines() if line.endswith("suspicious")]
    assert marked == ["p3"]
    assert "warning: pose 'p3' contradicts the others" in ran.out
    again = cadcam(*words(cell, "--convention", "kuka", "--leave-out", "p3"))
    assert again.code == 0
    assert "suspicious" not in again.out
    assert "p3" not in again.out


def test_without_a_convention_it_says_which_fit_and_stops(cadcam: Cadcam, cell: Path) -> None:
    bare = "\n".join(line.partition(",")[2] for line in (cell / "robot.csv").read_text().splitlines()[1:])
    (cell / "bare.csv").write_text(bare)
    ran = cadcam(*words(cell, robot="bare.csv"))
    assert ran.code == 2
    assert "--convention is not given; expected one that the camera's motion allows: kuka\n" in ran.err
    fits = [line.split()[0] for line in ran.out.splitlines() if line.endswith("fits")]
    assert fits == ["kuka"]
    assert "fanuc" in ran.out


def test_a_reading_whose_convention_says_no_unit_is_tried_in_that_of_the_camera_s_lengths(
    cadcam: Cadcam, cell: Path
) -> None:
    """Rotation vectors in m: what is left over stands in mm, and what to say for --robot-unit beside it."""
    robot = read_robot_poses(cell / "robot.csv", convention="kuka")
    rows = [" ".join(map(str, (*p.translation / 1000, *so3.log(p.rotation)))) for p in robot.values()]
    (cell / "bare.txt").write_text("\n".join(rows) + "\n")
    ran = cadcam(*words(cell, robot="bare.txt"))
    assert ran.code == 2
    assert "allows: ur, rotation-vector --robot-unit m\n" in ran.err
    fits = [line.split() for line in ran.out.splitlines() if line.endswith("fits")]
    assert [cells[:3] for cells in fits] == [[name, "m", "base_from_flange"] for name in ("ur", "rotation-vector")]
    for *_, off, scale, _ in fits:
        assert float(scale) == pytest.approx(1, abs=0.01)
        assert 0.02 < float(off) < 2  # mm: pixels at 600 mm and the robot's 0.05 mm; read as mm a thousandth of it
    assert "mm?" not in ran.out


def test_camera_poses_do_in_place_of_pixels(cadcam: Cadcam, cell: Path) -> None:
    ran = cadcam(
        "handeye", cell / "robot.csv", "--convention", "kuka", "--mounting", "eye-in-hand",
        "--camera-poses", cell / "target.csv", "--json",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    np.testing.assert_allclose(ran.json["flange_from_camera"]["translation_mm"], HELD.translation, atol=0.5)
    assert ran.json["noise_px"] is None
    assert "held_out_px" not in ran.json["poses"][0]


def test_poses_in_the_other_direction_are_said_and_read(cadcam: Cadcam, cell: Path) -> None:
    robot = read_robot_poses(cell / "robot.csv", convention="kuka")
    rows = [f"{n} " + " ".join(map(str, (*p.inv.translation, *kuka(p.inv.rotation)))) for n, p in robot.items()]
    (cell / "inverse.txt").write_text("\n".join(rows))
    refused = cadcam(*words(cell, "--convention", "kuka", robot="inverse.txt"))
    assert refused.code == 2
    assert "invert them" in refused.err
    ran = cadcam(*words(cell, "--convention", "kuka", "--inverted", "--json", robot="inverse.txt"))
    np.testing.assert_allclose(ran.json["flange_from_camera"]["translation_mm"], HELD.translation, atol=0.5)


def test_the_other_mounting_is_told_apart(cadcam: Cadcam, cell: Path) -> None:
    ran = cadcam(*(w if w != "eye-in-hand" else "eye-to-hand" for w in words(cell, "--convention", "kuka")))
    assert ran.code == 2
    assert "the mounting is eye-in-hand" in ran.err
    assert ran.out == ""


def test_names_that_share_only_their_numbers_are_paired_by_them(cadcam: Cadcam, cell: Path) -> None:
    text = (cell / "robot.csv").read_text().replace("\np", "\nrobot_")
    lines = text.splitlines()
    (cell / "robot.csv").write_text("\n".join([lines[0], *lines[:0:-1]]))  # and in another order
    ran = cadcam(*words(cell, "--convention", "kuka", "--json"))
    assert ran.code == 0, ran.err
    assert "paired by the numbers" in ran.err
    np.testing.assert_allclose(ran.json["flange_from_camera"]["translation_mm"], HELD.translation, atol=0.5)


def test_a_file_a_pose_is_read_and_paired_by_its_number(cadcam: Cadcam, cell: Path) -> None:
    for name, pose in read_robot_poses(cell / "robot.csv", convention="kuka").items():
        numbers = [*(pose.translation / 1000), *so3.log(pose.rotation)]
        rows = "".join(f"  - [{v!r}]\n" for v in map(float, numbers))
        (cell / f"robot_{name[1:]}.yaml").write_text(f"rows: 6\ncols: 1\ndata: \n{rows}")
    files = sorted(cell.glob("robot_*.yaml"))
    options = words(cell, "--convention", "ur", "--json")[2:]
    ran = cadcam("handeye", *files, *options)
    assert ran.code == 0, ran.err
    assert [p["name"] for p in ran.json["poses"]] == [f"p{i + 1}" for i in range(N)]
    np.testing.assert_allclose(ran.json["flange_from_camera"]["translation_mm"], HELD.translation, atol=0.5)


def test_internals_are_adjusted_only_within_a_known_covariance(cadcam: Cadcam, cell: Path) -> None:
    ran = cadcam(*words(cell, "--convention", "kuka", "--adjust-internals"))
    assert ran.code == 2
    assert "has no estimate" in ran.err
    rng = np.random.default_rng(1)
    points = rng.uniform(-100, 100, (30, 3))
    q = CAMERA.project(points + np.array([0, 0, 600])) + 0.1 * rng.normal(size=(30, 2))
    write_points(cell / "points.csv", Observations(points, q))
    assert cadcam("calibrate", cell / "points.csv", "--size", "1280x960", "-o", cell / "camera.json").code == 0
    assert read_camera(cell / "camera.json").estimate is not None
    ran = cadcam(*words(cell, "--convention", "kuka", "--adjust-internals", "--json"))
    assert ran.code == 0, ran.err
    np.testing.assert_allclose(ran.json["flange_from_camera"]["translation_mm"], HELD.translation, atol=1.0)
    posed = ("calibrate", cell / "points.csv", "--internals", cell / "camera.json", "-o", cell / "posed.json")
    assert cadcam(*posed).code == 0
    ran = cadcam(*words(cell, "--convention", "kuka", "--adjust-internals", "--camera", cell / "posed.json"))
    assert ran.code == 2
    assert "only the pose was estimated" in ran.err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--convention", "kuca"), "did you mean 'kuka'"),
        (("--convention", "fanuc"), "columns x, y, z, a, b, c; fanuc is x y z w p r"),
        (("--convention", "kuka", "--leave-out", "p33"), "unknown pose to leave out 'p33'"),
        (("--convention", "kuka", "-o", "out.txt"), "unknown suffix"),
        (("--convention", "kuka", "--camera", "none.json"), "none.json: no such file"),
        (("--convention", "kuka", "--robot-unit", "m"), "m against mm"),
        (("--convention", "kuka", "--leave-out", "p1,p2,p3,p4,p5,p6"), "at least 3"),
    ],
)
def test_a_wrong_option_is_one_message_and_exit_2(
    cadcam: Cadcam, cell: Path, more: tuple[str, ...], message: str
) -> None:
    before = sorted(cell.rglob("*"))
    ran = cadcam(*words(cell, *more))
    assert ran.code == 2
    assert message in ran.err
    assert ran.err.startswith("cadcam handeye: ")
    assert "Traceback" not in ran.err
    assert ran.out == ""
    assert sorted(cell.rglob("*")) == before


def test_missing_views_are_named(cadcam: Cadcam, cell: Path) -> None:
    (cell / "seen" / "p9.csv").write_bytes((cell / "seen" / "p1.csv").read_bytes())
    ran = cadcam(*words(cell, "--convention", "kuka"))
    assert ran.code == 2
    assert "has no pose 'p9'" in ran.err
    (cell / "seen" / "p9.csv").unlink()
    (cell / "seen" / "p4.csv").unlink()
    ran = cadcam(*words(cell, "--convention", "kuka", "--json"))
    assert ran.code == 0
    assert "1 of 8 robot poses have no picture" in ran.err


@pytest.fixture(scope="module")
def photographed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with camera.json, robot.csv (KUKA) and shots/p1.png ... of a chessboard; p3.png is empty."""
    folder = tmp_path_factory.mktemp("cell")
    write_camera(folder / "camera.json", SHOT_CAMERA)
    rows = ["name,X,Y,Z,A,B,C"]
    for i, (turn, distance, aside) in enumerate(VIEWS):
        C = shot_pose(parse_pattern(CHESS), turn=turn, distance=distance, aside=aside)
        B = FIXED @ (HELD @ C).inv
        rows.append(f"p{i + 1}," + ",".join(f"{v:.6f}" for v in (*B.translation, *kuka(B.rotation))))
        picture = shot(CHESS, turn=turn, distance=distance, aside=aside, seed=i)[0]
        write_picture(folder / "shots" / f"p{i + 1}.png", np.full_like(picture, 0.5) if i == 2 else picture)
    (folder / "robot.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_pictures_of_a_board_do_as_well_as_points(cadcam: Cadcam, photographed: Path) -> None:
    """An exact robot, and corners found to some 0.02 px, which is 0.015 mm at the board: four times that."""
    ran = cadcam(
        "handeye", photographed / "robot.csv", "--convention", "kuka", "--mounting", "eye-in-hand", "--camera",
        photographed / "camera.json", "--views", photographed / "shots", "--board", CHESS, "--json",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    assert [p["name"] for p in ran.json["poses"]] == ["p1", "p2", "p4", "p5", "p6"]
    assert "p3.png: " in ran.err
    assert "its pose is not used" in ran.err
    np.testing.assert_allclose(ran.json["flange_from_camera"]["translation_mm"], HELD.translation, atol=0.06)


def test_pictures_without_the_board_named_are_refused(cadcam: Cadcam, photographed: Path) -> None:
    ran = cadcam(
        "handeye", photographed / "robot.csv", "--convention", "kuka", "--mounting", "eye-in-hand", "--camera",
        photographed / "camera.json", "--views", photographed / "shots" / "p1.png",
    )  # fmt: skip
    assert ran.code == 2
    assert "or --board BOARD for pictures of one" in ran.err


def test_two_robot_poses_of_one_name_are_refused_and_not_one_of_them_taken(cadcam: Cadcam, cell: Path) -> None:
    text = (cell / "robot.csv").read_text()
    again = text.splitlines()[2].replace("p2,", "p1,")
    (cell / "twice.csv").write_text(f"{text}{again}\n")
    ran = cadcam(*words(cell, "--convention", "kuka", robot="twice.csv"))
    assert ran.code == 2
    assert "twice.csv: names two poses 'p1'; give each a name of its own" in ran.err
