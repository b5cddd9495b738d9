"""`cadcam track` follows a part through pictures line by line, goes on where it was stopped, and explains mistakes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.files.camera import write_camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, write_picture
from cadcam.locate.track.log import read_track_log
from cadcam.locate.views.drawing import Drawer

from .job import Ran
from .locating import CAMERA, MIDDLE, MODELS, POSE, seen, write_start

Cadcam = Callable[..., Ran]
STEP = Rigid.exp([1.5, -1.0, 2.0, 0.01, 0.015, -0.01])
MODEL = str(MODELS / "bracket.stl")
TRACK = ("track", "shots", MODEL, "--camera", "camera.json", "--start", "start.txt", "-o", "track.jsonl")
N = 5


def truth() -> list[Rigid]:
    poses = [POSE]
    for _ in range(N - 1):
        poses.append(poses[-1] @ STEP)
    return poses


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Pictures of the bracket on its way."""
    folder = tmp_path_factory.mktemp("shots")
    for i, pose in enumerate(truth()):
        write_picture(folder / f"{i}.png", seen(CAMERA, pose))
    return sorted(folder.iterdir())


@pytest.fixture
def here(tmp_path: Path, shots: list[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shots").mkdir()
    for shot in shots:
        (tmp_path / "shots" / shot.name).symlink_to(shot)
    write_camera("camera.json", CAMERA)
    write_start(tmp_path / "start.txt", POSE @ Rigid.exp([3.0, 2, -4, 0.03, 0.05, -0.04]))
    return tmp_path


def test_the_part_is_followed_and_every_frame_logged(cadcam: Cadcam, here: Path) -> None:
    ran = cadcam(*TRACK, "--csv", "track.csv", "--overlays", "seen")
    assert ran.code == 0, ran.err
    assert "predicted" in ran.out
    entries = read_track_log("track.jsonl")
    assert [e["found"] for e in entries] == [True] * N
    for entry, pose in zip(entries, truth(), strict=True):
        assert np.linalg.norm(entry["pose"].world_from_part @ MIDDLE - pose @ MIDDLE) < 0.3
    assert len((here / "track.csv").read_text().splitlines()) == 1 + N
    assert len(list((here / "seen").iterdir())) == N


def test_overlays_of_another_run_are_drawn_anew_and_those_of_this_one_kept(cadcam: Cadcam, here: Path) -> None:
    """What an earlier run had left in the folder was taken for this one's."""
    (here / "seen").mkdir()
    old = here / "seen/00000.jpg"
    old.write_bytes(b"another run's")
    cadcam(*TRACK, "--overlays", "seen")
    drawn = old.read_bytes()
    assert drawn.startswith(b"\xff\xd8")
    (here / "seen/00001.jpg").write_bytes(b"kept")
    old.unlink()
    cadcam(*TRACK, "--overlays", "seen")
    assert old.read_bytes() == drawn
    assert (here / "seen/00001.jpg").read_bytes() == b"kept"


@pytest.mark.parametrize("beside_mm", [(900.0, 0, 0), (60.0, 30.0, 0.0)])
def test_a_pose_in_the_camera_s_file_that_is_another_thing_s_is_no_start(
    cadcam: Cadcam, here: Path, beside_mm: tuple[float, ...]
) -> None:
    """As `cadcam calibrate` writes it: with that beside the picture nothing came, in view two frames were lost."""
    write_camera("camera.json", CAMERA, camera_from_world=POSE @ Rigid(translation=beside_mm))
    ran = cadcam(*(word for word in TRACK if word not in ("--start", "start.txt")))
    assert ran.code == 0, ran.err
    assert [e["found"] for e in read_track_log("track.jsonl")] == [True] * N


def test_a_finished_run_is_not_run_again_unless_asked(cadcam: Cadcam, here: Path) -> None:
    cadcam(*TRACK)
    before = (here / "track.jsonl").read_bytes()
    again = cadcam(*TRACK)
    assert "5 frames are in track.jsonl; going on" in again.err
    assert (here / "track.jsonl").read_bytes() == before
    assert "going on" not in cadcam(*TRACK, "--overwrite").err


def test_a_killed_run_goes_on(cadcam: Cadcam, here: Path) -> None:
    """Killed as soon as two frames are on the disk: the end is that of a run that was left alone."""
    whole = cadcam(*TRACK[:-1], "whole.jsonl", "--json").json
    log = here / "track.jsonl"
    with subprocess.Popen([sys.executable, "-m", "cadcam", *TRACK], stderr=subprocess.DEVNULL) as run:
        while run.poll() is None and (not log.exists() or log.read_bytes().count(b"\n") < 3):
            time.sleep(0.01)
        os.kill(run.pid, signal.SIGKILL)
    kept = len(read_track_log(log))
    assert kept >= 2
    ran = cadcam(*TRACK)
    assert f"{kept} frames are in track.jsonl" in ran.err
    assert log.read_bytes() == (here / "whole.jsonl").read_bytes()
    assert whole["found"] == N


def test_a_video_that_breaks_off_is_told(cadcam: Cadcam, here: Path) -> None:
    """The second half of its bytes is missing: what can be decoded is followed, and it is said how much that is."""
    cv2 = pytest.importorskip("cv2")
    size = CAMERA.size
    film = cv2.VideoWriter("film.avi", cv2.VideoWriter_fourcc(*"MJPG"), 25.0, size)
    for pose in (truth() * 2)[:8]:
        film.write(np.repeat((255 * seen(CAMERA, pose)).astype(np.uint8).reshape(size[1], size[0], -1)[..., :1], 3, 2))
    film.release()
    whole = Path("film.avi").read_bytes()
    Path("cut.avi").write_bytes(whole[: len(whole) // 2])
    ran = cadcam("track", "cut.avi", *TRACK[2:], "--json")
    frames = ran.json["frames"]
    assert 0 < frames < 8
    assert f"cut.avi: {frames} of the 8 frames that it says it has could be decoded; is it damaged" in ran.err
    assert "could be decoded" not in cadcam("track", "film.avi", *TRACK[2:-1], "whole.jsonl").err


def test_missing_pictures_are_told(cadcam: Cadcam, here: Path) -> None:
    (here / "shots" / "2.png").unlink()
    ran = cadcam(*TRACK, "--json")
    assert "shots: 1 missing by the numbers of the names, the first after 1.png" in ran.err
    assert ran.json["frames"] == N - 1


def test_two_cameras_are_followed_together(cadcam: Cadcam, here: Path, shots: list[Path]) -> None:
    """The second shows what the first does, with other noise, from the same place: twice the evidence, and one pose."""
    (here / "again").mkdir()
    for shot in shots:
        noise = np.random.default_rng(1).normal(scale=0.005, size=CAMERA.size[::-1])
        write_picture(here / "again" / shot.name, np.clip(read_picture(shot) + noise, 0, 1))
    write_camera("camera.json", CAMERA, camera_from_world=Rigid())
    two = ("track", "shots", "again", MODEL, "--camera", "camera.json", "--camera", "camera.json")
    ran = cadcam(*two, "--start", "start.txt", "-o", "two.jsonl", "--json")
    assert (ran.code, ran.json["found"]) == (0, N)
    assert [len(entry["files"]) for entry in read_track_log("two.jsonl")] == [2] * N


def test_a_part_that_is_in_no_frame_is_not_found(cadcam: Cadcam, here: Path) -> None:
    (here / "empty").mkdir()
    for i in range(2):
        write_picture(here / "empty" / f"{i}.png", np.full((360, 480), 0.3))
    ran = cadcam("track", "empty", *TRACK[2:])
    assert ran.code == 3
    assert "lost: 0 to 1" in ran.out
    reasons = [entry["reason"] for entry in read_track_log(TRACK[-1])]
    assert [f"photo 'empty/{i}.png' is empty" in reason for i, reason in enumerate(reasons)] == [True, True]


@pytest.mark.parametrize(
    ("change", "words", "says"),
    [
        (lambda _: None, ("track", "nothing", *TRACK[2:]), "nothing: no such file or folder"),
        (lambda j: (j / "shots/2.png").unlink(), ("track", "shots", "more", *TRACK[2:], "--camera", "camera.json"), ""),
        (lambda j: (j / "start.txt").write_text("1 2 3"), TRACK, "does not say which pose it is"),
        (lambda j: (j / "track.jsonl").write_text("{}\n"), TRACK, "not a log of tracked frames"),
        (lambda j: write_camera(j / "camera.json", CAMERA.resize((240, 180))), TRACK, "shots/0.png is 480 x 360 px"),
        (lambda _: None, (*TRACK[:-1], "track.txt"), "unknown suffix"),
        (lambda _: None, (*TRACK, "--seen-from", "below"), "any, above"),
        (
            lambda _: None,
            (*TRACK, "--freedom", "plane:0,0,1", "--distance", "300,400"),
            "--distance is given beside --freedom",
        ),
        (lambda _: None, (*TRACK, "--overwrite", "--overlays", "more/../shots"), "holds the pictures that are read"),
        (
            lambda _: None,
            ("track", MODEL, "shots", *TRACK[3:]),
            "expected a folder, pattern or video; frames come first, the model last (now 'shots')",
        ),
    ],
    ids=[
        "no frames",
        "fewer of one camera",
        "start",
        "not a log",
        "size",
        "suffix",
        "views",
        "views of a part that slides",
        "own folder",
        "swapped",
    ],
)
def test_a_mistake_is_explained(
    cadcam: Cadcam, here: Path, change: Callable[[Path], object], words: tuple[str, ...], says: str
) -> None:
    (here / "more").mkdir()
    write_picture(here / "more" / "0.png", np.zeros((360, 480)))
    change(here)
    ran = cadcam(*words)
    assert ran.code == 2, ran.out + ran.err
    assert says in ran.err


def test_another_camera_makes_another_log(cadcam: Cadcam, here: Path) -> None:
    cadcam(*TRACK)
    other = cadcam(*TRACK, "--crease-angle", "100").err
    assert re.search(r"begun with another part, unit, colours or crease angle \(\w{8}, now \w{8}\); name", other)
    assert "begun without --no-print; name" in cadcam(*TRACK, "--no-print").err
    assert (
        "begun with another --seen-from, --roll, --distance, --on or --lying; name"
        in cadcam(*TRACK, "--roll", "30").err
    )
    assert re.search(r"another start \(at [^()]* mm, now none\); name", cadcam(*TRACK[:5], *TRACK[7:]).err)
    write_camera("camera.json", CAMERA.__class__.from_focal((480, 360), 601))
    ran = cadcam(*TRACK)
    assert ran.code == 2
    assert "begun with another camera; name" in ran.err
    assert "--overwrite" in ran.err


def test_a_log_without_frames_is_begun_anew(cadcam: Cadcam, here: Path) -> None:
    """A first run that fails at its first frame has written what it was asked for, and nothing else."""
    write_camera("camera.json", CAMERA.resize((240, 180)))
    assert cadcam(*TRACK).code == 2
    assert (here / "track.jsonl").read_bytes().count(b"\n") == 1
    write_camera("camera.json", CAMERA)
    ran = cadcam(*TRACK)
    assert (ran.code, len(read_track_log("track.jsonl"))) == (0, N), ran.err
    assert cadcam(*TRACK[:-1], "whole.jsonl").code == 0
    assert (here / "track.jsonl").read_bytes() == (here / "whole.jsonl").read_bytes()


def test_a_log_with_a_damaged_first_line_is_kept_and_the_way_out_said(cadcam: Cadcam, here: Path) -> None:
    Path("track.jsonl").write_text('{"format": "cadcam tr\n')
    ran = cadcam(*TRACK, "--overwrite")
    assert ran.code == 2
    assert "line 1 is not JSON" in ran.err
    assert (
        "what is no track log is kept, --overwrite or not; if it is one whose first line is damaged, delete it"
        in ran.err
    )
    assert Path("track.jsonl").read_text() == '{"format": "cadcam tr\n'


def test_the_log_s_lines_are_json_for_other_programs(cadcam: Cadcam, here: Path) -> None:
    cadcam(*TRACK)
    lines = [json.loads(line) for line in (here / "track.jsonl").read_text().splitlines()]
    keys = {"frame", "files", "sha256", "white", "found", "quality", "how", "reason", "pose", "filtered"}
    assert set(lines[1]) == keys


def test_views_of_the_part_are_kept_between_runs(cadcam: Cadcam, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A film without a start begins where another run, or `locate`, has left off: nothing is drawn again."""
    monkeypatch.setenv("CADCAM_CACHE", str(here / "kept"))
    for shot in sorted((here / "shots").iterdir())[2:]:
        shot.unlink()
    views = ("--seen-from", "0.45,-0.73,0.51:15", "--roll", "20", "--distance", "270,330", "--json")
    search = (*TRACK[:5], *views, "-o", "track.jsonl", "--overwrite")
    assert cadcam(*search).json["found"] == 2
    first = read_track_log("track.jsonl")
    (kept,) = (here / "kept").glob("*.npz")
    monkeypatch.setattr(Drawer, "draw", lambda *_: pytest.fail("made again"))
    assert cadcam(*search).json["found"] == 2
    for one, other in zip(first, read_track_log("track.jsonl"), strict=True):
        assert np.array_equal(one["pose"].world_from_part.matrix, other["pose"].world_from_part.matrix)
    assert kept.exists()
