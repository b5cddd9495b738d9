"""`cadcam rig` as a stranger runs it, and `cadcam measure` with the rig file that it writes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.files.camera import write_camera
from cadcam.files.points import write_points
from cadcam.files.poses import read_poses
from cadcam.files.rig import read_rig
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from cadcam.target.boards.pattern import parse_pattern
from cadcam.target.marks.ideal import board_picture

from ..calibrate.rigs import TO_RIGHT, rig
from ..calibrate.scenes import SIZE
from ..calibrate.test_boards import CHESS, VIEWS
from ..target.shots import BLUR, CAMERA, NOISE, pose, shot
from .job import Ran

Cadcam = Callable[..., Ran]
BASE = Rigid.exp([0, 0, 0, 0.02, -0.1, 0.03]) @ Rigid(translation=np.array([35.0, -4.0, 2.0]))
POINTS = ("--size", f"{SIZE[0]}x{SIZE[1]}", "--lens", "brown-conrady:k1,k2", "--fix", "skew=0")


@pytest.fixture(scope="module")
def points(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders left and right of points files; right lacks the third frame; one point to measure; a camera file."""
    folder = tmp_path_factory.mktemp("rig")
    rng = np.random.default_rng(4)
    world = rig(rng, 2, 6)
    for name, camera in world.seen(rng, 0.2).items():
        (folder / name).mkdir()
        for j, view in enumerate(camera.views):
            if view is not None and (name, j) != ("right", 2):
                write_points(folder / name / f"{j + 1:02}.csv", view)
    rows = ["name,view,x_px,y_px"]
    for point, p in (("A", [10.0, 5, 450]), ("B", [60.0, 5, 450])):
        for name, camera in world.cameras.items():
            x, y = camera.project(world.mounts[name] @ np.array(p)).tolist()
            rows.append(f"{point},{name},{x!r},{y!r}")
    (folder / "pixels.csv").write_text("\n".join(rows) + "\n")
    write_camera(folder / "right.json", world.cameras["right"])
    return folder


def words(folder: Path) -> tuple[str, ...]:
    return ("rig", "--camera", f"left={folder}/left", "--camera", f"right={folder}/right")


def test_points_files_become_a_rig_file_that_measures(cadcam: Cadcam, points: Path, tmp_path: Path) -> None:
    ran = cadcam(*words(points), *POINTS, "-o", tmp_path / "rig.json", "--poses-out", tmp_path / "poses.csv")
    assert ran.code == 0, ran.err
    assert "Rig of 2 cameras, 6 frames; axes are those of left" in ran.out
    assert "distance of the focal centres of left and right" in ran.out
    found = read_rig(tmp_path / "rig.json")
    assert found.views[1][2] is None
    base = found.relative("left", "right")
    assert abs(base.baseline - np.linalg.norm(TO_RIGHT.translation)) < 4 * base.baseline_sigma()
    assert set(read_poses(tmp_path / "poses.csv")) == {f"{j + 1:02}" for j in range(6)}
    ran = cadcam("measure", points / "pixels.csv", "--rig", tmp_path / "rig.json", "--between", "A,B", "--json")
    assert ran.code == 0, ran.err
    (distance,) = json.loads(ran.out)["distances_mm"]
    assert abs(distance["value"] - 50) < 4 * distance["sigma"]


def test_json_says_the_same(cadcam: Cadcam, points: Path) -> None:
    said = json.loads(cadcam(*words(points), *POINTS, "--internals", f"right={points}/right.json", "--json").out)
    assert said["format"] == "cadcam rig"
    assert said["cameras"][1]["free"] == []
    assert said["cameras"][1]["baseline_mm"]["sigma"] > 0
    assert said["covariance_of"][-6:] == [
        f"right.{p}" for p in ("tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad")
    ]


def test_pictures_of_a_board_become_a_rig(cadcam: Cadcam, tmp_path: Path) -> None:
    """left0.png, right0.png ...: the n-th of each; one right picture does not show the board."""
    board = parse_pattern(CHESS)
    for k, (t, d, a) in enumerate(VIEWS[:4]):
        write_picture(tmp_path / f"left{k}.png", shot(CHESS, turn=t, distance=d, aside=a, seed=k)[0])
        at = BASE @ pose(board, turn=t, distance=d, aside=a)
        picture = np.full((360, 480), 0.5, np.float32)
        if k != 1:
            picture = board_picture(board, CAMERA, at, blur_px=BLUR, noise=NOISE, rng=np.random.default_rng(k))
        write_picture(tmp_path / f"right{k}.png", picture.clip(0, 1))
    ran = cadcam(
        "rig", "--camera", f"left={tmp_path}/left*.png", "--camera", f"right={tmp_path}/right*.png", "--board", CHESS,
        "--lens", "brown-conrady:k1", "-o", tmp_path / "rig.json",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    assert "right1.png" in ran.out[ran.out.index("Pictures left out") :]
    found = read_rig(tmp_path / "rig.json")
    assert found.frames[1] == "left1 right1"
    base = found.relative("left", "right")
    xi = (base.b_from_a.inv @ BASE).log()
    assert (np.abs(xi) < 6 * np.sqrt(np.diag(base.covariance))).all()


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ((), "--size WxH"),
        (("--size", "640x480", "--board", "chessboard:9x6:25mm"), "folder without pictures"),
        (("--camera", "third={folder}/thrid"), "thrid: no such file or folder"),
        (("--internals", "top={folder}/right.json"), "top"),
        (("--internals", "right"), "NAME=PATH"),
        (("--camera", "left={folder}/left"), "twice"),
        (("--size", "640x480", "-o", "rig.yml"), ".json"),
        (("--size", "1280x960", "--fix", "X=3"), "X"),
    ],
)
def test_bad_input_is_one_message(cadcam: Cadcam, points: Path, more: tuple[str, ...], says: str) -> None:
    ran = cadcam(*words(points), *(w.format(folder=points) for w in more))
    assert ran.code == 2
    assert says in ran.err
    assert "Traceback" not in ran.err


def test_cameras_without_a_pair_of_files_are_refused(cadcam: Cadcam, points: Path, tmp_path: Path) -> None:
    assert "two cameras or more" in cadcam("rig", "--camera", f"left={points}/left", *POINTS).err
    (tmp_path / "other").mkdir()
    for j in (1, 2):
        text = (points / "right" / f"0{j}.csv").read_text()
        (tmp_path / "other" / f"shot{j}.csv").write_text(text)
    ran = cadcam("rig", "--camera", f"left={points}/left", "--camera", f"right={tmp_path}/other", *POINTS)
    assert ran.code == 2
    assert "6 of camera 'left', 2 of camera 'right'" in ran.err
    ran = cadcam("rig", "--camera", f"left={points}/nowhere", "--camera", f"right={points}/right", *POINTS)
    assert ran.code == 2
    assert "a folder of points files" in ran.err


def test_two_files_of_one_name_are_refused_where_names_make_the_frames(
    cadcam: Cadcam, points: Path, tmp_path: Path
) -> None:
    """One of them would be dropped without a word."""
    shutil.copytree(points / "left", tmp_path / "left")
    shutil.copy(tmp_path / "left" / "01.csv", tmp_path / "left" / "01.txt")
    ran = cadcam("rig", "--camera", f"left={tmp_path}/left", "--camera", f"right={points}/right", *POINTS)
    assert ran.code == 2
    assert "01.txt" in ran.err
    assert "has the name of" in ran.err


def test_measuring_with_a_rig_needs_its_own_names(cadcam: Cadcam, points: Path, tmp_path: Path) -> None:
    cadcam(*words(points), *POINTS, "-o", tmp_path / "rig.json")
    (tmp_path / "pixels.csv").write_text((points / "pixels.csv").read_text().replace("right", "rigth"))
    ran = cadcam("measure", tmp_path / "pixels.csv", "--rig", tmp_path / "rig.json")
    assert ran.code == 2
    assert "did you mean 'right'" in ran.err
    ran = cadcam("measure", points / "pixels.csv", "--rig", tmp_path / "rig.json", "--camera", points / "right.json")
    assert ran.code == 2
    assert "given beside --rig" in ran.err
    assert cadcam("measure", points / "pixels.csv").code == 2
