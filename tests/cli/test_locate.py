"""`cadcam locate` finds the part and says how surely, or says that it is not there: exit 0, 3, or 2 for wrong input."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from cadcam.cad.read import read_model
from cadcam.cad.write import write_model
from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.error_source import distinct_sources
from cadcam.camera.observations import Observations
from cadcam.cli.photos import file_of, viewpoints_of
from cadcam.cli.verbs.locate import MOST_INSTANCES
from cadcam.files.camera import write_camera
from cadcam.files.jsontext import parsed
from cadcam.files.points import write_points
from cadcam.files.pose_estimate import pose_estimate_at, read_part_pose
from cadcam.files.text import read_text
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, write_picture
from cadcam.locate.instances import MOST
from cadcam.locate.views.drawing import Drawer

from ..cad.solids import prism
from .job import Ran
from .locating import CAMERA, MIDDLE, MODELS, POSE, off_mm, photo, seen, write_start

Cadcam = Callable[..., Ran]
LOCATE = ("locate", "photo.png", str(MODELS / "bracket.stl"), "--camera", "camera.json")
RANGE = ("--seen-from", "0.45,-0.73,0.51:15", "--roll", "20", "--distance", "270,330")  # a small one: quick to search


def test_a_rough_start_is_enough(cadcam: Cadcam, here: Path) -> None:
    ran = cadcam(*LOCATE, "--start", "start.txt", "-o", "overlay.png", "--pose-out", "pose.json")
    assert ran.code == 0, ran.err
    assert "quality" in ran.out
    estimate = pose_estimate_at(parsed(read_text("pose.json")))
    off = estimate.world_from_part.inv @ POSE
    # chi-square with 6 degrees of freedom passes 22.5 once in 1000; twice its size for the model of the noise
    assert off.log() @ np.linalg.solve(estimate.covariance, off.log()) < 45
    assert off_mm(estimate.world_from_part) < 0.3
    assert read_picture("overlay.png").shape == (360, 480, 3)


@pytest.mark.slow  # what the part looks like from all sides is made first: 10 s
def test_without_a_start_the_part_is_searched_for(cadcam: Cadcam, here: Path) -> None:
    said = cadcam(*LOCATE, "--json").json
    assert said["found"]
    (here / "found.json").write_text(cadcam(*LOCATE, "--json").out)
    assert off_mm(read_part_pose("found.json")) < 0.3


def test_a_declared_range_of_views_is_searched_and_what_that_took_is_kept(
    cadcam: Cadcam, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CADCAM_CACHE", str(here / "kept"))
    search = (*LOCATE, *RANGE, "--json")
    (here / "found.json").write_text(cadcam(*search).out)
    assert off_mm(read_part_pose("found.json")) < 0.3
    (kept,) = (here / "kept").glob("*.npz")
    monkeypatch.setattr(Drawer, "draw", lambda *_: pytest.fail("made again"))
    assert cadcam(*search).json["pose"] == json.loads(Path("found.json").read_text())["pose"]
    assert kept.exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--seen-from", "below"), "any, above"),
        (("--seen-from", "1,0"), "X,Y,Z:DEG"),
        (("--seen-from", "above:200"), "0 to 180"),
        (("--distance", "300"), "nearest,farthest"),
        (("--distance", "300,200"), "least, greatest"),
        (("--roll", "15", "--start", "start.txt"), "a start is not searched for"),
        (("--on", "0,0,1,0", "--start", "start.txt"), "a start is not searched for"),
        (("--on", "0,0,1,0"), "the pose in camera.json is missing"),
        (("--on", "0,0,1"), "the normal X,Y,Z and the offset D"),
        (("--on", "0,0,nan,0"), "--on"),
        (("--on", "0,0,0,5"), "plane normal"),
        (("--on", "0,0,1,0", "--roll", "30"), "--roll is given beside --on"),
        (("--lying", "0,0,-1"), "--lying is given without --on"),
    ],
)
def test_a_range_of_views_that_means_nothing_is_refused(
    cadcam: Cadcam, here: Path, words: tuple[str, ...], said: str
) -> None:
    ran = cadcam(*LOCATE, *words)
    assert ran.code == 2
    assert said in ran.err


def on_a_table() -> None:
    """Put the world elsewhere: the part lies on a table."""
    world_from_part = Rigid.from_rotation_vector([0, 0, 0.7], [300.0, -200, 50])  # on a table 50 mm above the world's
    write_camera("camera.json", CAMERA, camera_from_world=POSE @ world_from_part.inv)


def test_a_part_on_a_plane_of_the_world_is_found_and_beside_it_refused(cadcam: Cadcam, here: Path) -> None:
    on_a_table()
    (here / "found.json").write_text(cadcam(*LOCATE, "--on", "0,0,1,50", "--lying", "0,0,-1", "--json").out)
    assert off_mm(read_part_pose("found.json")) < 0.3
    ran = cadcam(*LOCATE, "--on", "0,0,1,42", "--pose-out", "pose.json")
    assert ran.code == 3
    assert "does not lie on the plane" in ran.out + ran.err
    assert "is --on in the world of the camera's pose" in ran.err
    assert not Path("pose.json").exists()
    for words, said in (
        (("--on", "0,0,1,5000"), "--on 0,0,1,5000, where no photo shows it"),
        (("--on", "0,0,1,50", "--lying", "1,1,-1"), "no face within 5 deg"),
        (("--on", "0,0,1,50:-1"), "within_mm"),
        (("--on", "0,0,1,50:"), "expected a number"),
    ):
        ran = cadcam(*LOCATE, *words)
        assert ran.code == 2
        assert said in ran.err


@pytest.mark.slow
def test_beside_a_plane_a_part_is_not_verified_and_found_where_the_plane_is_known_roughly(
    cadcam: Cadcam, here: Path
) -> None:
    on_a_table()
    ran = cadcam("verify", *LOCATE[1:], "--on", "0,0,1,42")
    assert ran.code == 3
    assert "is that plane in the world of the camera's pose" in ran.out + ran.err
    assert cadcam(*LOCATE, "--on", "0,0,1,42:8", "--json").json["found"]


def test_points_picked_in_the_photo_are_a_start(cadcam: Cadcam, here: Path) -> None:
    """Picked by hand: 2 px off."""
    corners = np.array([[120.0, 0, 8], [120, 80, 8], [0, 0, 60], [0, 80, 60], [120, 0, 0], [0, 40, 60]])
    q = CAMERA.project(POSE @ corners) + np.random.default_rng(2).normal(scale=2, size=(6, 2))
    write_points("picked.csv", Observations(corners, q, tuple("ABCDEF")))
    said = cadcam(*LOCATE, "--points", "picked.csv", "--json", "--pose-out", "pose.json")
    assert said.code == 0, said.err
    assert off_mm(read_part_pose("pose.json")) < 0.3


def test_a_camera_file_with_the_pose_is_a_start(cadcam: Cadcam, here: Path) -> None:
    write_camera("camera.json", CAMERA, camera_from_world=POSE @ Rigid.exp([2, 1, -3, 0.02, 0.01, -0.02]))
    assert cadcam(*LOCATE, "--pose-out", "pose.json").code == 0
    assert off_mm(read_part_pose("pose.json")) < 0.3


def test_what_was_located_is_drawn_there_whatever_pose_the_camera_file_has(cadcam: Cadcam, here: Path) -> None:
    """A calibrated camera's file has the pose of its calibration, in another world than that of the part found."""
    write_camera("camera.json", CAMERA, camera_from_world=Rigid.exp([30, -20, 900, 0.4, 0.2, 1.0]))
    located = cadcam(*LOCATE, "--start", "start.txt", "--pose-out", "pose.json", "--json")
    assert located.code == 0, located.err
    (here / "located.json").write_text(located.out)
    for pose in ("pose.json", "located.json"):
        drawn = cadcam("overlay", *LOCATE[1:], "--pose", pose, "-o", "drawn.png", "--json")
        assert drawn.code == 0, drawn.err
        again = cadcam("locate", *LOCATE[1:], "--start", pose, "--pose-out", pose)  # over what it started from
        assert again.code == 0, again.err
        matched = cadcam("match", *LOCATE[1:], "--pose", pose)
        assert matched.code == 0, matched.err


def test_a_part_is_not_drawn_in_another_unit_than_it_was_located_in(cadcam: Cadcam, here: Path) -> None:
    """An OBJ file has no unit: with --unit left out it would be 1000 times as small, in the right place."""
    mesh = read_model(LOCATE[2])
    write_model("m.obj", replace(mesh, vertices=mesh.vertices / 1000))
    words = ("photo.png", "m.obj", *LOCATE[3:])
    located = cadcam("locate", *words, "--unit", "m", "--start", "start.txt", "--pose-out", "p.json")
    assert located.code == 0, located.err
    for verb in (
        ("overlay", "-o", "o.png", "--pose"),
        ("match", "--pose"),
        ("verify", "--pose"),
        ("locate", "--start"),
    ):
        ran = cadcam(verb[0], *words, *verb[1:], "p.json")
        assert ran.code == 2, verb
        assert "unit of m.obj is mm; expected that in which p.json has it: --unit m" in ran.err
        assert cadcam(verb[0], *words, *verb[1:], "p.json", "--unit", "m").code == 0


def test_two_cameras_know_the_place_better_than_one(cadcam: Cadcam, here: Path) -> None:
    other = Rigid.look_at(MIDDLE + np.array([-200, -200, 150]), MIDDLE)
    write_picture("other.png", seen(CAMERA, other), bits=16)
    write_camera("camera.json", CAMERA, camera_from_world=POSE)
    write_camera("other.json", CAMERA, camera_from_world=other)
    (here / "start.txt").write_text("# world_from_part, mm\n1 0 0 3\n0 1 0 -2\n0 0 1 2\n")
    two = ("locate", "photo.png", "other.png", LOCATE[2], "--camera", "camera.json", "--camera", "other.json")
    said = cadcam(*two, "--start", "start.txt", "--json", "-o", "both.png").json
    one = cadcam(*LOCATE, "--json").json
    assert said["found"]
    worst = [max(np.linalg.eigvalsh(np.array(s["pose"]["from_noise"])[:3, :3])) for s in (said, one)]
    assert worst[0] < worst[1] / 2
    assert np.linalg.norm(np.array(said["pose"]["world_from_part"]["translation_mm"])) < 0.3
    assert read_picture("both.png").shape[1] > 2 * 480


def test_photos_of_one_name_are_told_apart_by_their_folders(cadcam: Cadcam, here: Path) -> None:
    """As cameras store them: left/0008.png, right/0008.png. What is said of a photo has to say of which."""
    write_camera("camera.json", CAMERA, camera_from_world=POSE)
    for folder in ("left", "right"):
        (here / "shots" / folder).mkdir(parents=True)
        write_picture(here / "shots" / folder / "0008.png", read_picture(here / "photo.png") + len(folder) / 255)
    photos = ["left/0008.png", "right/0008.png"]
    two = (*(f"shots/{p}" for p in photos), LOCATE[2], *(2 * ("--camera", "camera.json")))
    ran = cadcam("locate", *two, *RANGE, "--pose-out", "pose.json")
    assert ran.code == 0, ran.err
    assert [c["name"] for c in json.loads(Path("pose.json").read_text())["cameras"]] == photos
    Path("shots/right/0008.png").unlink()
    write_picture("shots/right/0008.png", np.full((CAMERA.size[1], CAMERA.size[0]), 0.3))
    assert "photo 'right/0008.png' is empty" in cadcam("locate", *two, *RANGE).err


def test_photos_of_one_camera_share_its_errors(here: Path, rng: np.random.Generator) -> None:
    """Under whatever name its file is given; of two each its own: as two, one calibration would be averaged away."""
    p = POSE.inv @ rng.uniform([-100, -80, 300], [100, 80, 600], (30, 3))
    for name in ("one.json", "other.json"):
        q = CAMERA.project(POSE @ p) + rng.normal(scale=0.1, size=(len(p), 2))
        write_camera(name, calibrate_camera(Observations(p, q, sigma_px=0.1), CAMERA.size))
    Path("copy.json").write_bytes(Path("one.json").read_bytes())
    Path("link.json").symlink_to("one.json")
    owners = []
    for again in ("one.json", "./one.json", str(here / "one.json"), "link.json", "copy.json", "other.json"):
        views, _ = viewpoints_of(["a.png", "b.png"], ("one.json", again), None)
        owners.append(len(distinct_sources([source for view in views for source, _ in view.errors])))
    assert owners == [1, 1, 1, 1, 1, 2]


def test_a_pose_alone_says_that_its_camera_counts_as_exact(
    cadcam: Cadcam, here: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    """What it says to do instead adds the calibration's errors."""
    p = POSE.inv @ rng.uniform([-100, -80, 300], [100, 80, 600], (30, 3))
    seen = Observations(p, CAMERA.project(POSE @ p) + rng.normal(scale=0.1, size=(len(p), 2)), sigma_px=0.1)
    known = calibrate_camera(seen, CAMERA.size)
    write_camera("calibration.json", known)
    write_camera("camera.json", locate_camera(seen, known.camera))
    exact = cadcam(*LOCATE, "--json")
    assert exact.code == 0, exact.err
    assert exact.err.count("as if the camera's own numbers were exact") == 1
    assert not np.any(exact.json["pose"]["from_calibration"])
    way = exact.err.partition("found with: ")[2].split("\n")[0].replace("CALIBRATION", "calibration.json").split()
    told = cadcam(*LOCATE[:3], *way, "--json")
    assert (told.code, "exact" in told.err) == (0, False), told.err
    assert np.any(told.json["pose"]["from_calibration"])
    viewpoints_of(["a.png", "b.png"], ("camera.json", "calibration.json"), None)
    assert "camera.json: a pose alone" in (said := capsys.readouterr().err)
    assert "Viewpoint.located" in said


def test_a_restricted_motion_keeps_the_rest_as_in_the_start(cadcam: Cadcam, here: Path) -> None:
    write_start(here / "start.txt", POSE @ Rigid.exp([4, -3, 0, 0, 0, 0.07]))
    ran = cadcam(*LOCATE, "--start", "start.txt", "--freedom", "plane:0,0,1@part", "--pose-out", "pose.json")
    assert ran.code == 0, ran.err
    change = read_part_pose("start.txt").inv @ read_part_pose("pose.json")
    # the start file has six decimals: 1e-6 rad at 400 mm
    assert abs(change.translation[2]) < 1e-3
    np.testing.assert_allclose(change.rotation[2], [0, 0, 1], atol=1e-5)
    assert off_mm(read_part_pose("pose.json")) < 0.3


def test_what_was_located_can_be_kept(cadcam: Cadcam, here: Path) -> None:
    (here / "located.json").write_text(cadcam(*LOCATE, "--start", "start.txt", "--part", "bracket", "--json").out)
    assert cadcam("state", "add", "located.json", "--serial", "7").code == 0
    (kept,) = cadcam("state", "list", "--json").json["records"]
    assert (kept["part"], kept["serial"], kept["verdict"]) == ("bracket", "7", "")
    assert {source["role"] for source in kept["sources"]} == {"photo", "camera", "cad"}


@dataclass(frozen=True)
class Case:
    """How the input is spoilt, further words of the command, the exit code, and what is said."""

    spoil: Callable[[Path], object]
    words: tuple[str, ...]
    code: int
    says: str


def picture(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], object]:
    return lambda folder: write_picture(folder / "photo.png", np.clip(change(photo()), 0, 1), bits=16)


def background(_: np.ndarray) -> np.ndarray:
    """Return the place without the part: another part lies there."""
    return seen(CAMERA, Rigid.look_at([4500, -7000, 6000], [3000, 2000, 800]), model="shipblock_10k.obj")


START = ("--start", "start.txt")
CASES = {
    "part not in the picture, start": Case(picture(background), START, 3, "was not found"),
    "upside down, start": Case(picture(lambda g: g[::-1]), START, 3, "was not found"),
    "empty": Case(picture(lambda g: 0 * g + 0.3), START, 2, "empty"),
    "noise": Case(picture(lambda g: np.random.default_rng(3).normal(0.5, 0.1, g.shape)), START, 3, "was not found"),
    "overexposed": Case(picture(lambda g: 40 * g), START, 2, "empty"),
    "black": Case(picture(lambda g: g - 0.9), START, 2, "empty"),
    "blurred": Case(picture(lambda g: ndimage.gaussian_filter(g, 15)), START, 3, "photo.png: it is out of focus"),
    "wrong camera": Case(
        lambda j: write_camera(j / "camera.json", CAMERA.resize((480, 360)).__class__.from_focal((480, 360), 1500)),
        START,
        3,
        "this camera",
    ),
    "camera of another size": Case(
        lambda j: write_camera(j / "camera.json", CAMERA.resize((960, 720))), START, 2, "photo.png is 480 x 360 px"
    ),
    "start beside the picture": Case(
        lambda j: write_start(j / "start.txt", Rigid(np.eye(3), np.array([3000.0, 0, 500]))), START, 2, "outside"
    ),
    "freedom without a start": Case(lambda _: None, ("--freedom", "plane:0,0,1"), 2, "--start or --points"),
    "freedom of two numbers": Case(lambda _: None, (*START, "--freedom", "plane:0,1"), 2, "3 numbers after plane:"),
    "unknown freedom": Case(lambda _: None, (*START, "--freedom", "plain:0,0,1"), 2, "did you mean 'plane'"),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * name.startswith("upside down")) for name in CASES]
)
def test_what_is_not_there_is_not_found(cadcam: Cadcam, here: Path, name: str) -> None:
    case = CASES[name]
    case.spoil(here)
    ran = cadcam(*LOCATE, *case.words, "--pose-out", "pose.json", "-o", "overlay.png")
    assert ran.code == case.code, ran.out + ran.err
    assert case.says in ran.err
    assert "Traceback" not in ran.err
    assert not (here / "pose.json").exists()


@pytest.mark.slow
def test_a_place_without_the_part_is_said_to_be_that(cadcam: Cadcam, here: Path) -> None:
    picture(background)(here)
    ran = cadcam(*LOCATE, "-o", "overlay.png")
    assert ran.code == 3, ran.out
    assert "was not found in photo.png" in ran.err


def test_another_part_is_not_found(cadcam: Cadcam, here: Path) -> None:
    """A ship's block, 30 times as large: seen from inside, or far away."""
    words = ("locate", "photo.png", MODELS / "shipblock_10k.obj", "--camera", "camera.json", "--start", "start.txt")
    within = cadcam(*words)
    assert within.code == 3
    assert "from camera 'photo.png': are both in one unit, mm?" in within.out
    metres = cadcam(*LOCATE, *START, "--unit", "m")
    assert metres.code == 3
    assert "from camera 'photo.png': are both in one unit, mm?" in metres.out
    write_start(here / "start.txt", Rigid.look_at(np.array([5600.0, -7100, 4900]), [2100, 1500, 1100]))
    ran = cadcam(*words)
    assert ran.code == 3, ran.out + ran.err
    assert "was not found in photo.png" in ran.err


def test_a_mirrored_photo_shows_no_part(cadcam: Cadcam, here: Path) -> None:
    """A ship's block has no mirror plane; the start is where its mirror image is."""
    pose = Rigid.look_at(np.array([5600.0, -7100, 4900]), [2100, 1500, 1100])
    block = seen(CAMERA, pose, model="shipblock_10k.obj")
    write_start(here / "start.txt", pose @ Rigid.exp([30, 40, -50, 0.02, 0.03, -0.04]))
    words = ("locate", "photo.png", MODELS / "shipblock_10k.obj", "--camera", "camera.json", "--start", "start.txt")
    write_picture("photo.png", block, bits=16)
    assert cadcam(*words).code == 0
    write_picture("photo.png", block[:, ::-1], bits=16)
    ran = cadcam(*words)
    assert ran.code == 3, ran.out
    assert "not mirrored" in ran.err


def test_a_photo_with_an_equals_sign_in_its_own_name_is_a_file_and_no_camera(here: Path) -> None:
    (here / "run=3").mkdir()
    (here / "run=3/left.png").write_bytes((here / "photo.png").read_bytes())
    assert file_of("run=3/left.png") == "run=3/left.png"
    assert file_of("left=run=3/left.png") == "run=3/left.png"
    assert file_of("left=photo.png") == "photo.png"
    assert file_of("photo.png") == "photo.png"


def test_of_a_round_bar_free_to_turn_about_its_axis_nothing_is_said_to_be_known(cadcam: Cadcam, here: Path) -> None:
    """It was said to be "within 0 mm in any direction", and turned to within half a degree."""
    write_model("bar.stl", prism(64, radius=10.0, height=40.0))
    camera_from_bar = Rigid.look_at([60, -70, 90], [0, 0, 20])
    write_picture("photo.png", seen(CAMERA, camera_from_bar, model=str(here / "bar.stl")), bits=16)
    write_start(here / "start.txt", camera_from_bar)
    line = ("locate", "photo.png", "bar.stl", "--camera", "camera.json", "--start", "start.txt")
    line += ("--freedom", "axis:0,0,0,0,0,1@part", "--pose-out", "pose.json")
    turn = "the turn about the axis (0, 0, 1) through (0, 0, 0) mm of the part"
    ran = cadcam(*line)
    assert ran.code == 0, ran.err
    assert f"not determined: {turn}" in ran.out
    assert "in any direction" not in ran.out
    said = cadcam(*line, "--json").json
    assert said["pose"]["undetermined"]["in_words"] == turn
    assert pose_estimate_at(parsed(read_text("pose.json"))).undetermined_words == turn


def test_instances_are_numbered_in_table_picture_and_files(cadcam: Cadcam, here: Path) -> None:
    ran = cadcam(*LOCATE, *RANGE, "--instances", "-o", "overlay.png", "--pose-out", "pose.json")
    assert ran.code == 0, ran.err
    assert "Instances" in ran.out
    assert off_mm(read_part_pose("pose-1.json", camera_from_world=Rigid())) < 0.3
    assert not Path("pose.json").exists()
    lines = read_picture("overlay.png") - np.repeat(read_picture("photo.png")[..., None], 3, axis=2)
    assert (lines[..., 1] - lines[..., 0] > 0.3).sum() > 200  # green
    Path("pose-2.json").write_text("{}")
    again = cadcam(*LOCATE, *RANGE, "--instances", "1", "--pose-out", "pose.json", "--json")
    assert "pose-2.json and what follows it are of an earlier run" in again.err
    said = json.loads(again.out)
    assert said["format"] == "cadcam instances"
    assert said["found"]
    assert [one["found"] for one in said["instances"]] == [True]


def test_without_any_instance_what_was_tried_is_told(cadcam: Cadcam, here: Path) -> None:
    write_picture("photo.png", np.random.default_rng(2).uniform(0.2, 0.8, (360, 480)))
    ran = cadcam(*LOCATE, *RANGE, "--instances", "--json", "--pose-out", "pose.json")
    assert ran.code == 3
    said = json.loads(ran.out)
    assert (said["found"], said["instances"], said["pose"]) == (False, [], None)
    assert said["reason"].startswith("not found")
    assert not list(Path().glob("pose*.json"))


@pytest.mark.parametrize("option", [("--start", "start.txt"), ("--freedom", "plane:0,0,1")])
def test_instances_are_not_looked_for_from_a_start(cadcam: Cadcam, here: Path, option: tuple[str, str]) -> None:
    ran = cadcam(*LOCATE, "--instances", *option)
    assert ran.code == 2
    assert f"{option[0]} is given beside --instances" in ran.err


@pytest.mark.parametrize("count", ["0", "-3"])
def test_no_fewer_than_one_instance_is_looked_for(cadcam: Cadcam, here: Path, count: str) -> None:
    ran = cadcam(*LOCATE, "--instances", count)
    assert ran.code == 2
    assert f"--instances is {count}; expected a whole number of at least 1" in ran.err
    assert MOST_INSTANCES == MOST  # which --help tells without loading what searches need
