"""`cadcam layout` plans the samples, says no with a reason, and refuses what cannot be, in one message."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.parts.shape import box
from cadcam.cad.write import write_model
from cadcam.files.camera import read_camera
from cadcam.report.layout.words import tur_words

from ..report.browser import beyond
from .job import Ran

Cadcam = Callable[..., Ran]
ROOT = Path(__file__).resolve().parents[2]
SCENE = """\
part: box.obj
cameras:
  cam: {sensor: IMX264, focal_mm: 16, f_number: 8, image_circle_mm: 11.1}
mounts:
  ring: {arc: {center_mm: [50, 40, 500], radius_mm: 500}, count: 8, aim_mm: [50, 40, 20]}
features:
  mark: {circle_mm: [30, 40, 20], normal: [0, 0, 1], diameter_mm: 10, position_mm: 0.1}
  edge: {edge_mm: [[0, 0, 20], [100, 0, 20]], position_mm: 0.1}
noise: {sigma_px: 0.05}
choose: 3
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Return the scene of a box of 100 x 80 x 20 mm."""
    write_model(tmp_path / "box.obj", box((0, 0, 0), (100, 80, 20), name="box", color=(0.5, 0.5, 0.5)))
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    return path


def test_a_layout_that_suffices_exits_with_0_and_says_where_to_mount(cadcam: Cadcam, small: Path) -> None:
    ran = cadcam("layout", small)
    assert ran.code == 0, ran.err
    assert "SUITABLE: 3 cameras measure all 2 limits" in ran.out
    assert "all 56 sets were tried" in ran.out
    assert "pan deg" in ran.out
    assert "without ring" in ran.out


def test_each_feature_is_listed_from_each_camera(cadcam: Cadcam, small: Path) -> None:
    small.write_text(SCENE.replace("choose: 3", "choose: 8\nseen: {incidence_deg: 46}"))
    out = cadcam("layout", small, "--each", "--no-what-if").out
    table = out[out.index("Each feature from each camera") :]
    assert len(re.findall(r"^ +(?:mark|edge) +ring \d", table, re.M)) == 2 * 8
    assert 0 < table.count("seen too obliquely") < 8
    assert "What if" not in out


def test_a_limit_that_is_too_tight_is_answered_with_3(cadcam: Cadcam, small: Path) -> None:
    small.write_text(SCENE.replace("diameter_mm: 10, position_mm: 0.1", "diameter_mm: 10, position_mm: 0.001"))
    ran = cadcam("layout", small, "--json")
    assert ran.code == 3
    document = json.loads(ran.out)
    assert document["outcome"] == "UNSUITABLE"
    assert "worst: mark" in document["reason"]


def test_json_mounts_every_camera_and_accounts_for_every_limit(cadcam: Cadcam, small: Path) -> None:
    document = json.loads(cadcam("layout", small, "--json", "--next").out)
    assert len(document["cameras"]) == 3
    for camera in document["cameras"]:
        pose = camera["camera_from_world"]
        R, t = np.array(pose["rotation"]), np.array(pose["translation_mm"])
        np.testing.assert_allclose(-R.T @ t, camera["position_mm"], atol=1e-6)
        towards = np.subtract(camera["aim_mm"], camera["position_mm"])
        np.testing.assert_allclose(R[2], towards / np.linalg.norm(towards), atol=1e-9)
        pan, tilt = np.radians([camera["pan_deg"], camera["tilt_deg"]])
        np.testing.assert_allclose(
            R[2], [np.cos(tilt) * np.cos(pan), np.cos(tilt) * np.sin(pan), np.sin(tilt)], atol=1e-9
        )
    for limit in document["limits"]:
        (pose,) = limit["poses"].values()
        assert limit["limit_mm"] / pose["U_mm"] == pytest.approx(pose["tur"])
        assert sum(pose["variance_by_cause"].values()) == pytest.approx(1.0)
    assert len(document["next"]) == 5
    assert document["sources"][0]["role"] == "scene"


def test_mounts_that_aim_nowhere_are_refused(cadcam: Cadcam, small: Path) -> None:
    small.write_text(SCENE.replace("aim_mm: [50, 40, 20]", "aim_mm: [[]]"))
    ran = cadcam("layout", small)
    assert ran.code == 2
    assert "scene.yaml: mounts.ring.aim_mm names no place; write [x, y, z]" in ran.err


def test_numbers_far_beyond_their_use_print_no_warnings_of_numpy(small: Path) -> None:
    """Nor are they silenced where a developer asks for them."""
    small.write_text(SCENE.replace("20]], position_mm: 0.1", "20]], position_mm: 1000000"))
    words = ("-m", "cadcam", "layout", str(small), "--no-what-if")
    ran, warned = (
        subprocess.run([sys.executable, *asked, *words], capture_output=True, text=True, check=False)
        for asked in ((), ("-W", "default"))
    )
    assert "Warning" not in ran.stderr
    assert "RuntimeWarning: overflow" in warned.stderr
    assert ran.stdout == warned.stdout


def test_the_next_camera_beside_those_that_are_there(cadcam: Cadcam, small: Path) -> None:
    document = json.loads(cadcam("layout", small, "--keep", "ring 1", "--next", "--json").out)
    assert document["have"] == ["ring 1"]
    assert document["now"]["not_measured"] == 2
    assert len(document["next"]) == 7
    assert document["next"][0]["not_measured"] == 0
    fixed = SCENE.replace("count: 8,", "count: 8, fixed: true,")
    small.write_text(fixed + "# all are there\n")
    assert cadcam("layout", small, "-k", 0).code == 0


def test_what_the_next_camera_adds_is_told_by_the_uncertainty_it_takes_off(cadcam: Cadcam, small: Path) -> None:
    """The share is that of the U of both sets, planned one by one; of what was not measured before there is none."""
    two = ("--keep", "ring 1", "--keep", "ring 4")
    out = cadcam("layout", small, *two, "--next").out
    row = next(line for line in out.splitlines() if re.match(r" +ring 7 ", line))
    (said,) = re.findall(r"(\d+) % smaller$", row)

    def turs(*keep: str) -> np.ndarray:
        document = json.loads(cadcam("layout", small, *keep, "-k", 0, "--no-what-if", "--json").out)
        return np.array([pose["tur"] for limit in document["limits"] for pose in limit["poses"].values()])

    less = 1 - np.exp(np.mean(np.log(turs(*two) / turs(*two, "--keep", "ring 7"))))
    assert float(said) == pytest.approx(100 * less, abs=0.51)
    assert "smaller" not in cadcam("layout", small, "--keep", "ring 1", "--next").out


def test_the_chosen_cameras_are_written_where_they_are_mounted(cadcam: Cadcam, small: Path, tmp_path: Path) -> None:
    """They are rendered with, and the set is the same another day if its names are kept."""
    ran = cadcam("layout", small, "--cameras", tmp_path / "mounted", "--json")
    document = json.loads(ran.out)
    files = sorted((tmp_path / "mounted").iterdir())
    assert [f.name for f in files] == [
        f"{i}_{camera['name'].replace(' ', '_')}.json" for i, camera in enumerate(document["cameras"], 1)
    ]
    for file, camera in zip(files, document["cameras"], strict=True):
        pose = read_camera(file).camera_from_world
        assert pose is not None
        np.testing.assert_allclose(pose.origin, camera["position_mm"], atol=1e-9)
        np.testing.assert_array_equal(pose.rotation, camera["camera_from_world"]["rotation"])
    assert cadcam("render", tmp_path / "box.obj", "--camera", files[0], "-o", tmp_path / "seen.png").code == 0
    keep = [word for camera in document["cameras"] for word in ("--keep", camera["name"])]
    again = json.loads(cadcam("layout", small, "-k", 0, *keep, "--json").out)
    assert again["worst_tur"] == document["worst_tur"]


def test_a_file_is_no_folder_for_cameras(cadcam: Cadcam, small: Path) -> None:
    ran = cadcam("layout", small, "--cameras", small)
    assert ran.code == 2
    assert "is a file" in ran.err


def test_ratios_have_three_digits_and_none_is_no_ratio(cadcam: Cadcam, small: Path) -> None:
    assert [tur_words(x) for x in (0.2, 9.994, 9.998, 14.34)] == ["0.20", "9.99", "10.0", "14.3"]
    out = cadcam("layout", small, "-k", 2).out
    assert re.search(r"^ +without ring \d +none ", out, re.M)


def test_the_report_is_one_file_that_names_everything(cadcam: Cadcam, small: Path, tmp_path: Path) -> None:
    small.write_text(SCENE.replace("  mark:", "  'mark <b>&':"))
    ran = cadcam(
        "layout", small, "-o", tmp_path / "r.html", "-o", tmp_path / "r.json", "--pictures", tmp_path / "views"
    )
    assert ran.code == 0, ran.err
    page = (tmp_path / "r.html").read_text()
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:)|url\(|@import""", page)
    assert "mark &lt;b&gt;&amp;" in page
    assert "mark <b>&" not in page
    assert page.count("data:image/jpeg") == 3 + 2 * 2  # cameras; coverage by number and by uncertainty
    for words in (
        "Where to mount the cameras",
        "U = 2 sigma of a point",
        "What was assumed",
        "released by",
        "What if",
        "Coverage",
        "sha256",
        "bar: TUR from 0 to 6",
        "1: below it nothing could ever PASS",
        "3: what is wanted",
    ):
        assert words in page
    assert ": 0% of the surface" not in page
    assert json.loads((tmp_path / "r.json").read_text())["outcome"] == "SUITABLE"
    assert len(list((tmp_path / "views").glob("*.png"))) == 3 + 2 * 2
    assert [beyond(tmp_path / "r.html", width) for width in (1280, 390)] == [[0], [0]]


def test_each_camera_has_a_picture_of_its_own_where_names_of_files_would_be_alike(
    cadcam: Cadcam, small: Path, tmp_path: Path
) -> None:
    post = "{positions_mm: [[%d, 40, 520]], aim_mm: [50, 40, 20]}"
    ring = next(line for line in SCENE.splitlines() if "ring:" in line)
    small.write_text(SCENE.replace(ring, f"  post 1: {post % -150}\n  post-1: {post % 250}").replace("choose: 3", ""))
    assert cadcam("layout", small, "--pictures", tmp_path / "views", "--no-what-if").code in (0, 3)
    names = sorted(file.name for file in (tmp_path / "views").glob("camera*"))
    assert names == ["camera_1_post_1.png", "camera_2_post_1.png"]


RING = "arc: {center_mm: [50, 40, 500], radius_mm: 500}, count: 8"
UNSEEN = "no candidate sees 1 of 2 features: 'mark' (seen too obliquely or from behind 100%)"
RANGE = "poses: {a: {position_mm: [[0, 1], 0, 0], steps: 1}}\ncameras:\n"
TWO_POSES = "poses: {a: {position_mm: [[0, 1], 0, 0]}, a 1: {position_mm: [0, 0, 0]}}\ncameras:\n"
# what is written in the scene's place -> what the message says
WRONG = {
    "an unknown key": ("noise: {sigma_px", "noise: {sigma_pix", "did you mean 'sigma_px'"),
    "an unknown key on top": ("choose: 3", "chose: 3", "did you mean 'choose'"),
    "an unknown key of a feature": ("diameter_mm: 10", "diametre_mm: 10", "did you mean 'diameter_mm'"),
    "an unknown sensor": ("IMX264", "IMX26", "did you mean"),
    "an unknown camera": ("count: 8", "count: 8, cameras: [cham]", "did you mean 'cam'"),
    "a lens that does not cover the sensor": ("image_circle_mm: 11.1", "image_circle_mm: 8", "corners would be dark"),
    "a focus inside the focal length": ("f_number: 8", "f_number: 8, focus_mm: 10", "nothing nearer has a real"),
    "f/0": ("f_number: 8", "f_number: 0", "f-number is 0"),
    "a focal length in metres": ("focal_mm: 16", "focal_mm: 0.016", "expected mm: 0.016 m are 16 mm"),
    "a negative focal length": ("focal_mm: 16", "focal_mm: -16", "focal length is -16"),
    "an edge without length": ("[100, 0, 20]]", "[0, 0, 20]]", "two different points"),
    "a circle without normal": ("normal: [0, 0, 1], ", "", "without normal"),
    "an angle of a circle": ("diameter_mm: 10, ", "diameter_mm: 10, angle_deg: 1, ", "no direction"),
    "no limit": (", position_mm: 0.1}\nnoise", "}\nnoise", "has no limit; give one of position_mm, angle_deg\n"),
    "a camera inside the part": (RING, "positions_mm: [[30, 40, 10]]", "inside of the part"),
    "a camera that aims at itself": (RING, "positions_mm: [[50, 40, 20]]", "aims at itself"),
    "a feature that no candidate sees": ("normal: [0, 0, 1]", "normal: [0, 0, -1]", UNSEEN),
    "a ratio that is none": ("choose: 3", "tur: -1", "tur is -1"),
    "two kinds of places": ("count: 8", "count: 8, positions_mm: [[0, 0, 900]]", "give one of positions_mm"),
    "a range with one step": ("cameras:\n", RANGE, "at least 2"),
    "noise without numbers": ("{sigma_px: 0.05}", "{gray: 0.01}", "both, or neither"),
    "a model that is not there": ("box.obj", "bix.obj", "did you mean 'box.obj'"),
    "a model in no unit": ("part: box.obj", "part: {model: box.obj, unit: furlong}", "part is refused: unknown unit"),
    "two poses of one name": ("cameras:\n", TWO_POSES, "makes a second pose 'a 1'"),
    "a normal of an edge": ("[100, 0, 20]]", "[100, 0, 20]], normal: [0, 0, 1]", "beside point_mm and circle_mm"),
    "chains of a mark": ("diameter_mm: 10", "diameter_mm: 10, chains: [1]", "it has a meaning beside part"),
    "half a pixel": ("f_number: 8", "f_number: 8, pixels: [2448.5, 2048]", "two whole numbers"),
    "pixels of no sensor": ("sensor: IMX264", "pixels: [2448, 2048]", "pixels without a sensor"),
    "hidden features that count as seen": ("choose: 3", "seen: {share: 0}", "share of what is seen is 0"),
    "a slant from behind": ("choose: 3", "seen: {incidence_deg: 120}", "at most 90 deg"),
    "no camera of a mount": ("count: 8", "count: 8, cameras: []", "cameras of mount 'ring' is none"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_is_refused_in_one_message(cadcam: Cadcam, small: Path, case: str) -> None:
    old, new, said = WRONG[case]
    assert old in SCENE
    small.write_text(SCENE.replace(old, new))
    ran = cadcam("layout", small)
    assert ran.code == 2
    assert said in ran.err
    assert len(ran.err.strip().splitlines()) == 1
    assert "Traceback" not in ran.err


def test_arguments_that_cannot_be_are_refused(cadcam: Cadcam, small: Path, tmp_path: Path) -> None:
    assert "cadcam layout --sample" in cadcam("layout").err
    assert "at most the 8 candidates" in cadcam("layout", small, "-k", 9).err
    assert "did you mean" in cadcam("layout", small, "--keep", "ring 11").err
    assert "no such file" in cadcam("layout", tmp_path / "none.yaml").err
    (tmp_path / "taken").write_text("")
    assert "is a file; name a folder" in cadcam("layout", small, "--pictures", tmp_path / "taken").err
    assert "given beside --sample" in cadcam("layout", small, "--sample", tmp_path / "new").err
    assert not (tmp_path / "new").exists()
    for ran in (cadcam("layout", small, "-o", "r.pdf"), cadcam("layout", small, "-k", -1)):
        assert ran.code == 2


def test_the_document_s_commands_and_python_run(
    tmp_path: Path, cadcam: Cadcam, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (ROOT / "docs/layout.md").read_text()
    monkeypatch.chdir(tmp_path)
    (shell,) = re.findall(r"```sh\n(.*?)```", text, re.S)
    for line in shell.strip().splitlines():
        words = shlex.split(line, comments=True)
        may_say_no = words[-2:] == ["||", "true"]
        ran = cadcam(*words[1 : -2 if may_say_no else None])
        assert ran.code == (3 if may_say_no else 0), ran.err
    (python,) = re.findall(r"```python\n(.*?)```", text, re.S)
    done = subprocess.run([sys.executable, "-W", "error", "-c", python], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "SUITABLE" in done.stdout
