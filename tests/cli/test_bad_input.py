"""Bad input is one clear error that names file, value and remedy; exit 2, no traceback, nothing left behind."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from cadcam.files.camera import write_camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture

from .job import CAMERA, POSE, Ran, replaced

Cadcam = Callable[..., Ran]
OVERLAY = ("overlay", "photo.png", "block.obj", "--camera", "camera.json", "-o", "out.png")
RENDER = ("render", "block.obj", "--camera", "camera.json", "-o", "out.png")
MEASURE = ("measure", "points.csv", "-o", "camera.json")
LOCATE = ("locate", "photo.png", "block.obj", "--camera", "camera.json")
RIG = ("rig", "--camera", "a=points.csv", "--size", "320x240")
CALIBRATE = ("calibrate", "points.csv", "--size", "320x240", "-o", "out.json")


def spoil(path: Path, data: bytes | str) -> None:
    path.write_bytes(data.encode() if isinstance(data, str) else data)


def huge_png() -> bytes:
    """Return a PNG that claims 100000 x 100000 px and holds next to nothing."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    head = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 0, 0, 0, 0)
    data = zlib.compress(bytes(10))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def posed(path: Path, pose: Rigid) -> None:
    write_camera(path, CAMERA, camera_from_world=pose)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def first_number(job: Path) -> str:
    return (job / "points.csv").read_text().splitlines()[1].split(",")[4]


@dataclass(frozen=True)
class Case:
    """A command, how its input is spoilt first, and what the error must say."""

    name: str
    command: tuple[str, ...]
    spoil: Callable[[Path], object]
    says: tuple[str, ...]


LOST = ("cannot be written: is an input of this command, which would be lost; give another name",)
CASES = [
    Case("output over the camera", ("compare", "a.json", "camera.json", "-o", "camera.json"), lambda j: None, LOST),
    Case("output over a camera's file", (*MEASURE, "--camera", "left=camera.json"), lambda j: None, LOST),
    Case("output over a camera that moved", (*MEASURE, "--placed", "left=x:camera.json"), lambda j: None, LOST),
    Case(
        "output over the internals",
        (*CALIBRATE[:2], "--internals", "camera.json", "-o", "camera.json"),
        lambda j: None,
        LOST,
    ),
    Case("a pose over the camera", (*LOCATE, "--pose-out", "camera.json"), lambda j: None, LOST),
    Case(
        "poses over points",
        ("calibrate", "points.csv", *CALIBRATE[1:4], "--poses-out", "points.csv"),
        lambda j: None,
        LOST,
    ),
    Case(
        "a rig's poses over points",
        (*RIG, "--camera", "b=points.csv", "--poses-out", "points.csv"),
        lambda j: None,
        LOST,
    ),
    Case(
        "camera for points",
        ("measure", "camera.json", "--camera", "camera.json"),
        lambda j: None,
        ("camera.json: is JSON, no table",),
    ),
    Case(
        "photo missing", OVERLAY, lambda j: (j / "photo.png").unlink(), ("photo.png", "no such file", "check the path")
    ),
    Case(
        "photo and model swapped",
        ("overlay", "block.obj", "photo.png", *OVERLAY[3:]),
        lambda j: None,
        ("photo is 'block.obj'; expected a picture; photos come first, the model last (now 'photo.png')",),
    ),
    Case("photo empty", OVERLAY, lambda j: spoil(j / "photo.png", b""), ("photo.png", "is empty")),
    Case("photo truncated", OVERLAY, lambda j: cut(j / "photo.png"), ("photo.png", "cut off")),
    Case(
        "photo is text", OVERLAY, lambda j: spoil(j / "photo.png", "hello"), ("photo.png", "not a picture", "use PNG")
    ),
    Case(
        "photo huge",
        OVERLAY,
        lambda j: spoil(j / "photo.png", huge_png()),
        ("photo.png", "100000 x 100000 px", "limit", "crop or bin it", "`cadcam convert --crop`"),
    ),
    Case(
        "photo of another size",
        OVERLAY,
        lambda j: write_picture(j / "photo.png", np.zeros((100, 200))),
        ("photo.png is 200 x 100 px but the camera is 320 x 240 px", "--crop X,Y,200x100 if it was cut out"),
    ),
    Case(
        "photo turned",
        OVERLAY,
        lambda j: write_picture(j / "photo.png", np.zeros((320, 240))),
        ("photo.png is 240 x 320 px", "turned by 90 degrees"),
    ),
    Case(
        "model missing",
        OVERLAY,
        lambda j: (j / "block.obj").rename(j / "blok.obj"),
        ("block.obj", "did you mean 'blok.obj'"),
    ),
    Case("model empty", RENDER, lambda j: spoil(j / "block.obj", ""), ("block.obj", "is empty")),
    Case("model is noise", RENDER, lambda j: spoil(j / "block.obj", "v 0 0 zero\n"), ("block.obj", "zero")),
    Case(
        "model without faces",
        RENDER,
        lambda j: spoil(j / "block.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("block.obj", "face"),
    ),
    Case(
        "model without area",
        RENDER,
        lambda j: spoil(j / "block.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
        ("block.obj", "area"),
    ),
    Case(
        "model cut off",
        ("render", "cut.stl", "-o", "out.png"),
        lambda j: spoil(j / "cut.stl", bytes(80) + struct.pack("<I", 100) + bytes(50 * 60)),
        ("cut.stl", "100", "60"),
    ),
    Case(
        "model that claims to be huge",
        ("render", "huge.stl", "-o", "out.png"),
        lambda j: spoil(j / "huge.stl", bytes(80) + struct.pack("<I", 4_000_000_000) + bytes(50)),
        ("huge.stl", "4000000000"),
    ),
    Case(
        "model of an unknown suffix",
        ("render", "block.xyz", "-o", "out.png"),
        lambda j: spoil(j / "block.xyz", "x"),
        ("block.xyz", "'.xyz'", ".step"),
    ),
    Case("model of an unknown unit", (*RENDER, "--unit", "parsec"), lambda j: None, ("unknown unit 'parsec'", "mm")),
    Case(
        "model behind the camera",
        RENDER,
        lambda j: posed(j / "camera.json", Rigid(np.diag([1.0, -1, -1]), [0, 0, -500])),
        ("block.obj", "behind the camera", "inverted"),
    ),
    Case(
        "model beside the picture",
        OVERLAY,
        lambda j: posed(j / "camera.json", Rigid(POSE.rotation, POSE.translation + np.array([2000, 0, 0]))),
        ("block.obj", "nothing of the model is in the 320 x 240 px picture", "check the pose"),
    ),
    Case(
        "points with text",
        CALIBRATE,
        lambda j: replaced(j / "points.csv", first_number(j), "abc"),
        ("points.csv: line 2, column x_px is 'abc'", "give a number"),
    ),
    Case(
        "points with NaN",
        CALIBRATE,
        lambda j: replaced(j / "points.csv", first_number(j), "NaN"),
        ("points.csv: line 2, column x_px is 'NaN'", "finite"),
    ),
    Case(
        "points of an unknown unit",
        CALIBRATE,
        lambda j: replaced(j / "points.csv", "X_mm", "X_pc"),
        ("points.csv", "unknown unit 'pc'"),
    ),
    Case("points empty", CALIBRATE, lambda j: spoil(j / "points.csv", ""), ("points.csv", "is empty")),
    Case(
        "too few points",
        CALIBRATE,
        lambda j: spoil(j / "points.csv", "\n".join((j / "points.csv").read_text().splitlines()[:5])),
        ("4 given",),
    ),
    Case(
        "camera file of another kind",
        RENDER,
        lambda j: spoil(j / "camera.json", "%YAML:1.2\nintrinsics:\n  f_u: 698.1\n"),
        ("camera.json: is no camera file known by its content", "opencv"),
    ),
    Case("camera file cut", RENDER, lambda j: cut(j / "camera.json"), ("camera.json", "not JSON", "line")),
    Case(
        "camera file with a typo",
        RENDER,
        lambda j: replaced(j / "camera.json", "size_px", "size"),
        ("camera.json", "'size'", "did you mean 'size_px'"),
    ),
    Case("no output folder", (*RENDER[:-1], "no/out.png"), lambda j: None, ("no/out.png", "mkdir -p no")),
    Case("output in a file", (*RENDER[:-1], "photo.png/out.png"), lambda j: None, ("photo.png/out.png", "is a file")),
    Case(
        "output is a folder", (*RENDER[:-1], "out.png"), lambda j: (j / "out.png").mkdir(), ("out.png", "is a folder")
    ),
    Case("output name too long", (*RENDER[:-1], 300 * "x" + ".png"), lambda j: None, ("xxx.png", "too long")),
    Case("model name too long", ("render", 300 * "x" + ".stl", *RENDER[2:]), lambda j: None, ("xxx.stl", "too long")),
]


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_one_error_names_file_value_and_remedy_and_nothing_is_left_behind(
    cadcam: Cadcam, job: Path, case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    case.spoil(job)
    before = sorted(job.rglob("*"))
    ran = cadcam(*case.command)
    assert ran.code == 2
    assert ran.out == ""
    said = [line for line in ran.err.splitlines() if line.startswith("cadcam ")]
    assert len(said) == 1
    for text in case.says:
        assert text in said[0]
    assert "Traceback" not in ran.err
    assert sorted(job.rglob("*")) == before


@pytest.mark.parametrize("command", [OVERLAY, RENDER, CALIBRATE], ids=lambda c: c[0])
def test_a_read_only_folder_is_an_error_before_the_work(
    cadcam: Cadcam, job: Path, command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    monkeypatch.setattr("os.access", lambda *_: False)  # whoever runs the tests may write everywhere
    monkeypatch.setattr("cadcam.cli.models.load_as_asked", None)
    ran = cadcam(*command)
    assert ran.code == 2
    assert "read-only" in ran.err


@pytest.mark.parametrize("command", [OVERLAY, RENDER, CALIBRATE], ids=lambda c: c[0])
def test_a_disk_that_fills_up_leaves_the_old_file(
    cadcam: Cadcam, job: Path, command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    (job / command[-1]).write_text("old")
    before = sorted(job.rglob("*"))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    ran = cadcam(*command)
    assert ran.code == 2
    assert "No space left on device" in ran.err
    assert (job / command[-1]).read_text() == "old"
    assert sorted(job.rglob("*")) == before


@pytest.mark.parametrize(
    "words",
    [
        OVERLAY,
        LOCATE,
        ("match", "photo.png", "block.obj", "--camera", "camera.json"),
        ("verify", "photo.png", "block.obj", "--camera", "camera.json", "--tolerances", "t.yaml", "-o", "r.html"),
        ("track", "photo.png", "block.obj", "--camera", "camera.json", "-o", "log.jsonl"),
        ("targets", "find", "photo.png", "--mark", "dot:10mm", "--camera", "camera.json"),
    ],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize(
    ("size", "remedies"),
    [
        ((160, 120), ("--binning 2 if", "--resize 160x120 if", "--crop X,Y,160x120 if")),  # of 320 x 240
        ((80, 60), ("--binning 4 if", "--resize 80x60 if", "--crop X,Y,80x60 if")),
        ((160, 240), ("--binning 2x1 if", "--crop X,Y,160x240 if")),
        ((240, 180), ("--resize 240x180 if", "--crop X,Y,240x180 if")),
        ((300, 200), ("--crop X,Y,300x200 if",)),
        ((640, 480), ("--resize 640x480 if",)),
        ((500, 500), ()),
        ((240, 320), ("turned by 90 degrees",)),
    ],
    ids=str,
)
def test_every_verb_says_the_same_of_a_photo_of_another_size(
    cadcam: Cadcam,
    job: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    size: tuple[int, int],
    remedies: tuple[str, ...],
) -> None:
    """Only what makes a camera of that size is offered: `cadcam convert` takes each option that is named."""
    monkeypatch.chdir(job)
    write_picture(job / "photo.png", np.full(size[::-1], 0.5, np.float32))
    (job / "t.yaml").write_text("features:\n  - part: block\n    position_mm: 3\n")
    ran = cadcam(*words)
    assert ran.code == 2
    said = f"photo.png is {size[0]} x {size[1]} px but the camera is 320 x 240 px; "
    assert said in ran.err
    assert all(remedy in ran.err for remedy in remedies)
    offered = re.findall(r"(--(?:binning|resize|crop)) (\S+) if", ran.err)
    assert len(offered) == sum(remedy.startswith("--") for remedy in remedies)
    for option, value in offered:
        made = cadcam("convert", job / "camera.json", job / "new.json", option, value.replace("X,Y", "0,0"))
        assert made.code == 0
        assert f"for pictures of {size[0]} x {size[1]} px" in made.err
        (job / "new.json").unlink()


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ((*LOCATE, "--distance", "30,10"), "--distance is 30,10; expected (least, greatest), both positive"),
        ((*LOCATE, "--roll", "400"), "--roll is 400; expected 0 to 180 degrees"),
        (("verify", *LOCATE[1:], "--reach", "1"), "--reach is 1; expected 2 to 60 px"),
        ((*CALIBRATE, "--sigma", "0"), "--sigma is 0; expected a positive number of pixels, one for all points"),
        (("match", "photo.png", "photo.png", "--least-score", "3"), "--least-score is 3; expected a number above 0"),
        (("match", "photo.png", "photo.png", "--scales", "3,1"), "--scales is 3,1; expected (least, largest)"),
        (("match", *LOCATE[1:], "--turn", "500"), "--turn is 500; expected 0 to 180 degrees"),
        ((*RENDER, "--channel", "wireframe", "--crease-angle", "190"), "--crease-angle is 190; expected degrees"),
        ((*RENDER, "--light", "sun", "--renderings", "0"), "--renderings is 0; expected a whole number from 1 to 4096"),
        (("variability", *CALIBRATE[1:4], "--points-sigma", "-1"), "--points-sigma is -1; expected 0 mm or more"),
        (("dataset", "block.obj", "-o", "set", "--count", "1", "--fill", "2,3"), "to 2; closer by --distance"),
        (("convert", "camera.json", "foo.yaml"), "nerfstudio, bop, gltf, usd, colmap, colmap-bin\n"),
    ],
)
def test_a_value_is_named_by_its_option(
    cadcam: Cadcam, job: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], says: str
) -> None:
    """The library calls some of them otherwise: reach_px, distance_mm of the views, turn in radians."""
    monkeypatch.chdir(job)
    ran = cadcam(*command)
    assert ran.code == 2
    assert says in ran.err


def test_what_is_no_option_keeps_its_name(cadcam: Cadcam, job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan file holds a value that could be an option's."""
    monkeypatch.chdir(job)
    Path("plan.yaml").write_text("off_center: 4\n")
    ran = cadcam("dataset", "block.obj", "-o", "set", "--count", "1", "--plan", "plan.yaml")
    assert ran.code == 2
    assert "--off-center" not in ran.err
    assert "off_center is 4" in ran.err
