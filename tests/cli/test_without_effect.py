"""An option that would change nothing is refused, by its name and with the way out: nobody gives one for nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from cadcam.files.camera import write_camera

from .job import CAMERA as CAMERA_ALONE
from .job import Ran

CAMERA = ("--camera", "camera.json")
ON_PHOTO = ("photo.png", "block.obj", *CAMERA)
POINTS = ("points.csv", "--size", "320x240")
CASES = [
    (("render", "block.obj", "-o", "a.png", "--channel", "wireframe", "--renderer", "raster"), "--renderer"),
    (("render", "block.obj", "-o", "a.png", "--channel", "wireframe", "--threads", "1"), "--threads"),
    (("render", "block.obj", "-o", "a.png", "--renderer", "ray", "--threads", "1"), "--threads"),
    (("match", "photo.png", "photo.png", "--unit", "m"), "--unit"),
    (("match", "photo.png", "photo.png", "--measure"), "--measure"),
    (("match", "photo.png", "photo.png", *CAMERA), "--camera"),
    (("match", *ON_PHOTO, "--angles", "-10,10"), "--angles"),
    (("match", *ON_PHOTO, "--least-score", "0.8"), "--least-score"),
    (("overlay", *ON_PHOTO, "-o", "a.png", "--points-unit", "m"), "--points-unit"),
    (("overlay", *ON_PHOTO, "-o", "a.png", "--mode", "sum", "--shaded", "0.5"), "--shaded"),
    (("locate", *ON_PHOTO, "--columns", "U1,V1"), "--columns"),
    (("locate", *ON_PHOTO, "--hidden"), "--hidden"),
    (("track", *ON_PHOTO, "-o", "a.jsonl", "--width", "3"), "--width"),
    (("track", *ON_PHOTO, "-o", "a.jsonl", "--smooth"), "--smooth"),
    (("verify", "block.obj", "--list", "--tolerances", "t.yaml"), "--tolerances"),
    (("verify", "block.obj", "--template", "--alarms", "0.1"), "--alarms"),
    (("verify", "block.obj", "--template", "--json"), "--json"),
    (("verify", "block.obj", "--list", "--template"), "--template"),
    (("verify", *ON_PHOTO, "--pose", "pose.txt", "--sigma", "1"), "--sigma"),
    (("verify", *ON_PHOTO, "--rig", "rig.json"), "--camera"),
    (("calibrate", *POINTS, "--free-skew"), "--free-skew"),
    (("calibrate", *POINTS, "--no-advice"), "--no-advice"),
    (("calibrate", "photo.png", "--board", "chessboard:9x6:25mm", "--sigma", "0.1"), "--sigma"),
    (("calibrate", "points.csv", "--internals", "camera.json", "--fix", "skew=0"), "--fix"),
    (("variability", *POINTS, "--format", "svg"), "--format"),
    (("measure", "pixels.csv", *CAMERA, "--plane-sigma", "1"), "--plane-sigma"),
    (("measure", "pixels.csv", *CAMERA, "--motion-sigma", "1,1"), "--motion-sigma"),
    (("measure", "pixels.csv", *CAMERA, "--joint"), "--joint"),
    (("decompose", "camera.json", "--rows", "uv"), "--rows"),
    (("decompose", "P.txt", "--rows", "xy", "--near", "200"), "--near"),
    (("decompose", "internals.json", "--far", "9000"), "--far"),
    (("convert", "camera.json", "-", "--fit"), "--fit"),
    (("convert", "camera.json", "-", "--pixel-pitch", "5"), "--pixel-pitch"),
    (("convert", "camera.json", "-", "--unit", "m"), "--unit"),
    (("convert", "camera.json", "-", "--stretched"), "--stretched"),
    (("convert", "camera.json", "a.py", "--unit", "m"), "--unit"),
    (("calibrate", *POINTS, "--full-scale", "4095"), "--full-scale"),
    (("overlay", *ON_PHOTO, "-o", "a.png", "--full-scale", "4095"), "--full-scale"),
    (("locate", *ON_PHOTO, "--full-scale", "4095"), "--full-scale"),
    (("match", "photo.png", "photo.png", "--full-scale", "4095"), "--full-scale"),
    (("targets", "find", "photo.png", "--mark", "dot:30mm", "--full-scale", "4095"), "--full-scale"),
    (("track", *ON_PHOTO, "-o", "a.jsonl", "--full-scale", "4095"), "--full-scale"),
    (("targets", "find", "photo.png", "--mark", "ring:20mm:30mm", *CAMERA, "--perspective"), "--perspective"),
    (("targets", "print", "coded:5:20mm:30mm:40mm", "-o", "a.svg", "--numbers", "1"), "--numbers"),
]


@pytest.mark.parametrize(("command", "option"), CASES, ids=[" ".join((c[0][0], c[1])) for c in CASES])
def test_an_option_that_would_change_nothing_is_refused(
    cadcam: Callable[..., Ran], job: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], option: str
) -> None:
    monkeypatch.chdir(job)
    Path("P.txt").write_text("400 0 160 0\n0 400 120 0\n0 0 1 500\n")
    write_camera("internals.json", CAMERA_ALONE)
    before = sorted(job.iterdir())
    ran = cadcam(*command)
    assert (ran.code, ran.out) == (2, "")
    asked = " ".join(command[: 2 if command[0] == "targets" else 1])
    assert f"cadcam {asked}: {option} is given " in ran.err
    assert "expected" in ran.err
    assert sorted(job.iterdir()) == before


def test_threads_of_a_set_of_lines_are_taken_because_files_are_written_by_several(
    cadcam: Callable[..., Ran], job: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    Path("poses.csv").write_text(
        "# camera_from_world, mm\nname,r11,r12,r13,r21,r22,r23,r31,r32,r33,tx,ty,tz\na,1,0,0,0,1,0,0,0,1,-20,0,500\n"
    )
    line = ("render", "block.obj", *CAMERA, "--poses", "poses.csv", "-o", "{name}.png", "--channel", "wireframe")
    assert cadcam(*line, "--threads", "2").code == 0
    assert "--threads is 0; expected a whole number" in cadcam(*line, "--threads", "0").err


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("overlay", *ON_PHOTO, "-o", "a.png", "--pose", ""), "argument --pose"),
        (("overlay", "", "block.obj", *CAMERA, "-o", "a.png"), "argument PHOTO"),
        (("state", "list", "--part", " "), "argument --part"),
        (("calibrate", "points.csv", "--size", "320x240", "--board="), "argument --board"),
    ],
)
def test_an_empty_text_as_of_a_scripts_unset_variable_is_no_option_left_out(
    cadcam: Callable[..., Ran],
    job: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: tuple[str, ...],
    name: str,
) -> None:
    monkeypatch.chdir(job)
    with pytest.raises(SystemExit) as ended:
        cadcam(*command)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert f"{name}: '" in said
    assert "is empty; give a value, or leave it out" in said
    assert not (job / "a.png").exists()
