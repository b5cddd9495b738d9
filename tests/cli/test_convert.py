"""`cadcam convert` and `cadcam compare` as a user runs them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.calibrate.rig.adjustment import calibrate_rig
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.files.camera import read_camera, write_camera
from cadcam.files.foreign.registry import NAMES
from cadcam.files.rig import read_rig, write_rig
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture

from ..calibrate.rigs import rig
from .job import POSE, Ran

Run = Callable[..., Ran]
PLAIN = Camera.from_focal((640, 480), 700.0, cx=330, cy=231, lens=BrownConrady(-0.1, 0.02, 1e-3, -5e-4))


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    write_camera(tmp_path / "plain.json", PLAIN, camera_from_world=POSE)
    return tmp_path / "plain.json"


def test_a_camera_goes_to_opencv_and_comes_back(cadcam: Run, tmp_path: Path, plain: Path) -> None:
    there = cadcam("convert", plain, tmp_path / "c.yml", "--to", "opencv", "--unit", "m")
    assert there.code == 0
    assert there.out == ""
    assert "read back, no pixel is off by more than" in there.err
    back = cadcam("convert", tmp_path / "c.yml", tmp_path / "back.json", "--unit", "m")
    assert back.code == 0
    found = read_camera(tmp_path / "back.json")
    assert found.camera.lens == PLAIN.lens
    assert found.camera_from_world is not None
    assert np.abs(found.camera_from_world.matrix - POSE.matrix).max() < 1e-9


def test_a_loss_ends_with_2_and_writes_nothing_until_it_is_allowed(cadcam: Run, job: Path) -> None:
    """The job's camera has skew and k1: HALCON has neither."""
    target = job / "cam.dat"
    refused = cadcam("convert", job / "camera.json", target)
    assert refused.code == 2
    assert "lens: brown-conrady (k1 -0.05)" in refused.err
    assert "skew: K01 = 0.8 px" in refused.err
    assert "--allow-loss lens,skew" in refused.err
    assert not target.exists()
    half = cadcam("convert", job / "camera.json", target, "--allow-loss", "skew")
    assert half.code == 2
    assert "lens" in half.err
    fitted = cadcam("convert", job / "camera.json", target, "--allow-loss", "skew", "--fit", "--pixel-pitch", "4.8")
    assert fitted.code == 0
    assert "lost: fitted lens: brown-conrady (k1 -0.05) becomes" in fitted.err
    assert "lost: skew" in fitted.err
    assert (job / "cam.pose.dat").exists()
    assert "4.8" in cadcam("convert", target, "-").err


def test_what_a_file_holds_is_told_without_writing(cadcam: Run, tmp_path: Path, plain: Path) -> None:
    before = sorted(tmp_path.iterdir())
    ran = cadcam("convert", plain, "-")
    assert ran.code == 0
    assert "cadcam camera file: 1 camera" in ran.out
    assert "640 x 480" in ran.out
    assert "brown-conrady k1 -0.1" in ran.out
    assert sorted(tmp_path.iterdir()) == before


def test_json_says_what_was_read_written_and_lost(cadcam: Run, tmp_path: Path, plain: Path) -> None:
    ran = cadcam("convert", plain, tmp_path / "c.yaml", "--to", "ros", "--json")
    document = ran.json
    assert document["format"] == "cadcam"
    assert document["written"]["format"] == "ros"
    assert [loss["what"] for loss in document["written"]["losses"]] == ["pose"]
    assert document["written"]["read_back_px"] < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_every_format_is_written_by_name(cadcam: Run, tmp_path: Path, plain: Path, name: str) -> None:
    ran = cadcam("convert", plain, tmp_path / "out", "--to", name, "--allow-loss", "all")
    assert ran.code == 0, ran.err
    told = cadcam("convert", tmp_path / "out", "-", "--json")
    assert told.json["format"] == name


def test_one_camera_of_many_is_chosen_by_name_or_number(cadcam: Run, tmp_path: Path, plain: Path) -> None:
    chain = tmp_path / "transforms.json"
    cadcam("convert", plain, chain, "--to", "nerfstudio")
    document = json.loads(chain.read_text())
    frame = document["frames"][0]
    document["frames"] = [{**frame, "file_path": "a.png"}, {**frame, "file_path": "b.png"}]
    chain.write_text(json.dumps(document))
    said = cadcam("convert", chain, tmp_path / "o.json").err
    assert "number of cameras is 2, and one is what a file of this format (cadcam camera file) holds" in said
    assert (
        "choose it with --camera-name NAME (a.png, b.png); all have the same K and lens, and differ in their poses"
        in said
    )
    assert cadcam("convert", chain, tmp_path / "o.json", "--camera-name", "b.png").code == 0
    assert cadcam("convert", chain, tmp_path / "o.json", "--camera-name", "0").code == 0
    assert "did you mean 'b.png'" in cadcam("convert", chain, tmp_path / "o.json", "--camera-name", "b.pn").err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.json", "o.json"], "no such file"),
        (["plain.json", "o.yaml"], "format of"),
        (
            ["plain.json", "o.json", "--camera-name", "a", "--camera-name", "b"],
            "--camera-name is given 2 times; expected once",
        ),
        (["plain.json", "o.yaml", "--to", "opencw"], "did you mean 'opencv'"),
        (["plain.json", "o.dat", "--allow-loss", "lenz"], "unknown loss 'lenz'; did you mean 'lens'"),
        (["plain.json", "o.dat", "--from", "ros"], "is not YAML|has no|is refused"),
        (["plain.json", "o.json", "--size", "10x10"], "size is"),
        (
            ["plain.json", "o.dat", "--fit", "--pixel-pitch", "0.005"],
            r"--pixel-pitch is 0.005; expected .* um, such as 3.45",
        ),
        (["plain.json", "plain.json"], "plain.json: cannot be written: is an input of this command"),
        (
            ["plain.json", "o.json", "--resize", "320x200"],
            "another ratio .*320 x 240 or 267 x 200; --crop",
        ),
        (["plain.json", "o.json", "--crop", "1,2,640x480"], r"cut is 640 x 480 px from \(1, 2\) on"),
        (
            ["plain.json", "o.json", "--crop", "1,2,9x9", "--binning", "2"],
            "--crop is given beside --binning",
        ),
    ],
)
def test_mistakes_end_with_2_and_the_remedy(
    cadcam: Run, plain: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    import re

    monkeypatch.chdir(plain.parent)
    ran = cadcam("convert", *words)
    assert ran.code == 2
    assert re.search(message, ran.err), ran.err
    assert ran.err.count("\n") == 1


@pytest.mark.parametrize(
    ("option", "text", "message"),
    [
        ("--binning", "0", "--binning: '0' is not N or NxM px"),
        ("--binning", "2x", "--binning: '2x' is not N or NxM px"),
        ("--crop", "1,2", "--crop: '1,2' is not X,Y,WxH"),
        ("--crop", "1,-2,3x4", "--crop: '1,-2,3x4' is not X,Y,WxH"),
        ("--crop", "1,2,3", "--crop: '3' is not a picture size"),
    ],
)
def test_what_is_no_such_picture_is_refused_before_anything_is_read(
    cadcam: Run, capsys: pytest.CaptureFixture[str], option: str, text: str, message: str
) -> None:
    with pytest.raises(SystemExit, match="2"):
        cadcam("convert", "none.json", "o.json", option, text)
    assert message in capsys.readouterr().err


def test_a_camera_is_made_one_of_other_pictures_with_its_covariance(cadcam: Run, tmp_path: Path) -> None:
    p = np.random.default_rng(4).uniform([-300, -200, 700], [300, 200, 1100], size=(30, 3))
    seen = PLAIN.project(p) + np.random.default_rng(5).normal(scale=0.2, size=(30, 2))
    estimate = calibrate_camera(Observations(p, seen), PLAIN.size, lens=PLAIN.lens)
    write_camera(tmp_path / "full.json", estimate)
    ran = cadcam("convert", tmp_path / "full.json", tmp_path / "half.json", "--resize", "320x240")
    assert ran.code == 0, ran.err
    assert "camera: for pictures of 320 x 240 px instead of 640 x 480 px" in ran.err
    half = read_camera(tmp_path / "half.json")
    assert half.camera.size == (320, 240)
    assert half.estimate is not None
    for name, scale in (("focal", 0.5), ("U0", 0.5), ("V0", 0.5), ("aspect", 1.0), ("X", 1.0)):
        assert half.estimate.sigma(name) == pytest.approx(scale * estimate.sigma(name), rel=1e-9)
    np.testing.assert_allclose(half.camera.project(p), (estimate.camera.project(p) + 0.5) / 2 - 0.5, atol=1e-9)
    told = cadcam("convert", tmp_path / "full.json", "-", "--binning", "2x1", "--json").json["cameras"][0]
    assert told["size_px"] == [320, 480]
    cut = cadcam("convert", tmp_path / "full.json", "-", "--crop", "100,50,200x300", "--json").json["cameras"][0]
    assert cut["K_px"][0][2] == pytest.approx(estimate.camera.K[0, 2] - 100)
    assert cut["K_px"][1][2] == pytest.approx(estimate.camera.K[1, 2] - 50)
    stretched = cadcam("convert", tmp_path / "full.json", "-", "--resize", "320x480", "--stretched", "--json")
    assert stretched.json["cameras"][0]["size_px"] == [320, 480]


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig of two cameras of 1280 x 960 px, left and right, and one of 1024 x 1024, top."""
    rng = np.random.default_rng(3)
    path = tmp_path_factory.mktemp("rig") / "rig.json"
    write_rig(path, calibrate_rig(rig(rng, 3, 4).seen(rng, 0.1)))
    return path


def test_a_rig_is_made_one_of_other_pictures_of_all_cameras_or_of_those_named(
    cadcam: Run, tmp_path: Path, rig_file: Path
) -> None:
    full, small = read_rig(rig_file), tmp_path / "small.json"
    ran = cadcam("convert", rig_file, small, "--binning", "2")
    assert ran.code == 0, ran.err
    assert "top: for pictures of 512 x 512 px instead of 1024 x 1024 px" in ran.err
    half = read_rig(small)
    for name in full.names:
        for parameter, scale in (("focal", 0.5), ("V0", 0.5), ("aspect", 1.0), ("tx", 1.0)):
            assert half.sigma(name, parameter) == scale * full.sigma(name, parameter)
    np.testing.assert_array_equal(half.camera_from_rig.matrix, full.camera_from_rig.matrix)
    two = ("--camera-name", "left", "--camera-name", "right")
    assert cadcam("convert", rig_file, small, "--resize", "640x480", *two).code == 0
    assert [camera.size for camera in read_rig(small).cameras] == [(640, 480), (640, 480), (1024, 1024)]
    told = cadcam("convert", rig_file, "-", "--crop", "10,20,600x500", "--camera-name", "top", "--json").json
    assert [camera["size_px"] for camera in told["cameras"]] == [[1280, 960], [1280, 960], [600, 500]]
    listed = cadcam("convert", rig_file, "-")
    assert "rig: 3 cameras" in listed.out
    assert "1024 x 1024" in listed.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("o.json", "--resize", "640x480"), r"cameras of several sizes .left 1280 x 960, .* --camera-name NAME"),
        (("o.json", "--crop", "0,0,640x480"), r"--crop is given for cameras of several sizes"),
        (("o.json", "--resize", "640x400", "--camera-name", "left"), "in another ratio"),
        (("o.json", "--binning", "2", "--camera-name", "lef"), "did you mean 'left'"),
        (("o.json",), "rig.json is a rig file; expected --resize, --binning, --crop, or - in place of o.json"),
        (("-", "--camera-name", "left"), "--camera-name is given for a rig whose pictures stay"),
        (("o.yml", "--binning", "2"), r"'.yml' .known: .json"),
        (("o.json", "--binning", "2", "--to", "opencv"), "--to is given for a rig file"),
        (("o.json", "--binning", "2", "--fit"), "--fit is given for a rig file"),
    ],
)
def test_what_does_not_suit_a_rig_is_refused(
    cadcam: Run, rig_file: Path, words: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(rig_file.parent)
    ran = cadcam("convert", "rig.json", *words)
    assert ran.code == 2
    assert re.search(message, ran.err), ran.err
    assert not Path("o.json").exists()


def test_compare_prints_draws_and_agrees_with_its_json(cadcam: Run, tmp_path: Path, plain: Path) -> None:
    other = Camera.from_focal((640, 480), 702.0, cx=331, cy=231, lens=PLAIN.lens)
    write_camera(tmp_path / "other.json", other, camera_from_world=Rigid())
    ran = cadcam("compare", plain, tmp_path / "other.json", "-o", tmp_path / "field.png")
    assert ran.code == 0
    assert "largest" in ran.out
    assert "as they are, no rotation taken off" in ran.out
    assert (tmp_path / "field.png").read_bytes()[:4] == b"\x89PNG"
    plainly = cadcam("compare", plain, tmp_path / "other.json", "--json").json
    turned = cadcam("compare", plain, tmp_path / "other.json", "--rotate", "--json").json
    # 702 m + 331 against 700 m + 330, largest in the upper right corner
    assert plainly["max_px"] == pytest.approx(np.hypot(1 + 2 / 700 * 309.5, 2 / 700 * 248.5), rel=1e-3)
    assert turned["rms_px"] < plainly["rms_px"]
    assert turned["rotation_deg"] == pytest.approx(np.degrees(1 / 700), rel=0.1)
    assert np.asarray(plainly["delta_px"]).shape == np.asarray(plainly["q_px"]).shape
    svg = cadcam("compare", plain, tmp_path / "other.json", "--rotate", "-o", tmp_path / "field.svg")
    assert svg.code == 0
    assert "<path" in (tmp_path / "field.svg").read_text()


def test_compare_refuses_what_cannot_be_compared(cadcam: Run, tmp_path: Path, plain: Path) -> None:
    write_camera(tmp_path / "small.json", PLAIN.resize((320, 240)))
    ran = cadcam("compare", plain, tmp_path / "small.json")
    assert ran.code == 2
    assert "resize or crop one of the cameras first" in ran.err
    assert cadcam("compare", plain, plain, "-o", tmp_path / "field.bmp").code == 2


def test_pixels_that_only_one_camera_sees_are_drawn_grey_and_counted(cadcam: Run, tmp_path: Path) -> None:
    write_camera(tmp_path / "wide.json", Camera.from_focal((640, 480), 300.0))
    write_camera(tmp_path / "folds.json", Camera.from_focal((640, 480), 300.0, lens=BrownConrady(-0.35, 0.05)))
    ran = cadcam("compare", tmp_path / "wide.json", tmp_path / "folds.json", "-o", tmp_path / "f.png")
    assert ran.code == 0
    assert "pixels are not seen by both" in ran.out
    assert "not seen" in ran.out


def test_the_verbs_take_other_programs_camera_files_as_they_are(cadcam: Run, job: Path) -> None:
    """The job's camera as OpenCV has it renders the same picture as ours; two different cameras are refused."""
    cadcam("convert", job / "camera.json", job / "c.yml", "--to", "opencv", "--allow-loss", "skew")
    ours = cadcam("render", job / "block.obj", "--camera", job / "camera.json", "-o", job / "ours.png")
    theirs = cadcam("render", job / "block.obj", "--camera", job / "c.yml", "-o", job / "theirs.png")
    assert ours.code == theirs.code == 0, theirs.err
    assert "lengths are taken as mm" in theirs.err
    pictures = [read_picture(job / name) for name in ("ours.png", "theirs.png")]
    assert np.abs(pictures[0] - pictures[1]).mean() < 1e-4  # the pose is turned by rounding: a pixel may flip
    scene = {"fl_x": 300, "w": 64, "h": 48, "frames": []}
    for fx in (300, 310):
        matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        scene["frames"].append({"fl_x": fx, "transform_matrix": matrix})  # type: ignore[attr-defined]  # of mixed values
    (job / "two.json").write_text(json.dumps(scene))
    two = cadcam("render", job / "block.obj", "--camera", job / "two.json", "-o", job / "x.png")
    assert two.code == 2
    assert "cadcam convert --camera-name NAME" in two.err


def test_a_place_that_was_in_metres_is_told_with_its_digits(cadcam: Run, tmp_path: Path) -> None:
    """Lengths of a file without a unit, taken as mm: 0.0 would tell nobody that metres were meant."""
    write_camera(tmp_path / "small.json", PLAIN, camera_from_world=Rigid(np.eye(3), [0.02, -0.3456, 0.0]))
    assert "-0.0200, 0.3456, 0.0000" in cadcam("convert", tmp_path / "small.json", "-").out
