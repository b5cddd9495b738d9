"""`cadcam calibrate --board` and `cadcam board` as a stranger runs them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.files.camera import read_camera
from cadcam.files.poses import read_poses
from cadcam.image.picture import read_picture, write_picture

from ..calibrate.test_boards import CHESS, VIEWS
from ..target.shots import shot
from .job import Ran

Cadcam = Callable[..., Ran]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("boards")
    for k, (t, d, a) in enumerate(VIEWS[:4]):
        write_picture(out / f"view{k}.png", shot(CHESS, turn=t, distance=d, aside=a, seed=k)[0])
    return out


def test_pictures_become_a_camera_file_poses_and_pictures_of_what_was_found(
    cadcam: Cadcam, folder: Path, tmp_path: Path
) -> None:
    ran = cadcam(
        "calibrate", folder, "--board", CHESS, "-o", tmp_path / "camera.json", "--poses-out", tmp_path / "poses.csv",
        "--pictures", tmp_path / "found",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    assert "in 4 of 4 pictures of chessboard:8x5:25mm" in ran.out
    assert "Take next" in ran.out
    camera = read_camera(tmp_path / "camera.json")
    assert abs(camera.camera.fy - 424) < 2
    assert camera.estimate is not None
    assert set(read_poses(tmp_path / "poses.csv")) == {f"view{k}.png" for k in range(4)}
    names = sorted(p.name for p in (tmp_path / "found").iterdir())
    assert names == [*(f"{k:03d}_view{k}_found.png" for k in range(4)), "coverage.png"]
    assert read_picture(tmp_path / "found" / names[0]).shape == (360, 480, 3)


@pytest.mark.usefixtures("unread")
def test_the_camera_is_kept_even_if_nobody_reads_the_tables(cadcam: Cadcam, folder: Path, tmp_path: Path) -> None:
    assert cadcam("calibrate", folder, "--board", CHESS, "--no-advice", "-o", tmp_path / "camera.json").code != 0
    assert read_camera(tmp_path / "camera.json").estimate is not None


def test_pictures_of_one_name_in_two_folders_keep_a_pose_each(cadcam: Cadcam, folder: Path, tmp_path: Path) -> None:
    places = [tmp_path / where / name for where in ("one", "two") for name in ("a.png", "b.png")]
    for place, picture in zip(places, sorted(folder.glob("*.png")), strict=True):
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(picture.read_bytes())
    ran = cadcam("calibrate", *places, "--board", CHESS, "--no-advice", "--poses-out", tmp_path / "poses.csv")
    assert ran.code == 0, ran.err
    assert list(read_poses(tmp_path / "poses.csv")) == [str(place) for place in places]


def test_json_says_the_same(cadcam: Cadcam, folder: Path) -> None:
    files = sorted(folder.glob("*.png"))[:3]
    ran = cadcam("calibrate", *files, "--board", CHESS, "--lens", "brown-conrady:k1", "--no-advice", "--json")
    said = json.loads(ran.out)
    assert said["free"] == ["aspect", "focal", "U0", "V0", "k1"]
    assert np.shape(said["covariance"]) == (5, 5)
    assert [p["used"] for p in said["pictures"]] == [True] * 3
    assert said["take_next"][0]["worst_sigma_px"][1] < said["take_next"][0]["worst_sigma_px"][0]


def test_pictures_of_twelve_bits_in_sixteen_give_what_files_that_say_it_give(cadcam: Cadcam, tmp_path: Path) -> None:
    for k, (t, d, a) in enumerate(VIEWS[:3]):
        picture = shot(CHESS, turn=t, distance=d, aside=a, seed=k)[0] * (0.24 if k else 1.0)  # alone, of 10 bits
        raw = np.round(np.clip(picture, 0, 1) * 4095).astype(">u2")
        for name, white in (("raw", 65535), ("said", 4095)):
            (tmp_path / name).mkdir(exist_ok=True)
            head = b"P5 %d %d %d\n" % (raw.shape[1], raw.shape[0], white)
            (tmp_path / name / f"{k}.pgm").write_bytes(head + raw.tobytes())
    options = ("--board", CHESS, "--lens", "brown-conrady:k1", "--no-advice", "--json")
    ran, said = (cadcam("calibrate", tmp_path / name, *options) for name in ("raw", "said"))
    assert "0.pgm and 2 more: read as 12 bits in 16" in ran.err
    assert "bits in 16" not in said.err
    assert ran.json["covariance"] == said.json["covariance"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("{folder}/view0.png", "--board", "chessboard:9x6"), "chessboard:9x6:25mm"),
        (("{folder}/nothing*.png", "--board", CHESS), "no file has such a name"),
        (("{empty}", "--board", CHESS), "folder without pictures"),
        (("{folder}", "--board", "chessboard:7x5:25mm"), "give 8x5"),
        (("{folder}/view0.png", "{small}", "--board", CHESS), "not of one size"),
        (("{folder}", "--board", CHESS, "--size", "480x360"), "given beside --board"),
        (("{folder}/view0.png", "{folder}/view1.png", "--size", "480x360"), "--board BOARD for pictures"),
        (("points.csv",), "--size WxH"),
        (("{folder}", "--board", CHESS, "--lens", "fisheye:k9"), "k9"),
        (("{folder}/view*.png", "--board", CHESS, "--pictures", "{folder}"), "holds the pictures that are read"),
    ],
)
def test_bad_input_is_one_message(
    cadcam: Cadcam, folder: Path, tmp_path: Path, words: tuple[str, ...], says: str
) -> None:
    small = tmp_path / "small.png"
    write_picture(small, np.full((30, 40), 0.5, np.float32))
    (tmp_path / "empty").mkdir()
    places = {"folder": folder, "empty": tmp_path / "empty", "small": small}
    ran = cadcam("calibrate", *(w.format(**places) for w in words))
    assert ran.code == 2
    assert says in ran.err
    assert "Traceback" not in ran.err


def test_a_board_is_written_to_be_printed(cadcam: Cadcam, tmp_path: Path) -> None:
    ran = cadcam("board", CHESS, "-o", tmp_path / "board.pdf", "--page", "a3")
    assert ran.code == 0
    assert "225.00 x 150.00 mm" in ran.out
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    ran = cadcam("board", "chessboard:90x60:25mm", "-o", tmp_path / "large.pdf", "--page", "a3")
    assert ran.code == 2
    assert "fits on a3" in ran.err
