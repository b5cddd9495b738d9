"""`cadcam verify` as a user runs it: exit codes, what is printed, what is refused."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.edges import feature_edges
from cadcam.cad.mesh import Mesh
from cadcam.cad.write import write_model
from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.observations import Observations
from cadcam.cli.main import main
from cadcam.files.camera import write_camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from cadcam.locate.freedom import Freedom
from cadcam.locate.in_photos import locate_part
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.views.view_range import ViewRange

from ..verify.scene import CAMERA, POSE, photographed, plate
from .cell import TOLERANCES, make_cell, with_rib_off
from .job import Ran
from .locating import MODELS, make_photo_job


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """Return a folder with the model, its camera, where it stands, tolerances, a good and a bad part's photo."""
    make_cell(tmp_path)
    rng = np.random.default_rng(5)
    write_picture(tmp_path / "good.png", photographed(plate(), rng))
    write_picture(tmp_path / "bad.png", photographed(with_rib_off(), rng))
    return tmp_path


def verified(cadcam: Callable[..., Ran], cell: Path, photo: str, *more: str | Path, photos: Sequence[str] = ()) -> Ran:
    files = ("--camera", cell / "camera.json", "--pose", cell / "pose.txt", "--tolerances", cell / "tolerances.yaml")
    return cadcam("verify", *(cell / name for name in (photo, *photos)), cell / "plate.glb", *files, *more)


def test_a_good_part_passes_with_0_and_a_bad_one_fails_with_1(cadcam: Callable[..., Ran], cell: Path) -> None:
    good = verified(cadcam, cell, "good.png", "-o", cell / "good.html", "--json")
    assert good.code == 0
    assert json.loads(good.out)["verdict"] == "PASS"
    assert "PASS" in (cell / "good.html").read_text()
    bad = verified(cadcam, cell, "bad.png")
    assert bad.code == 1
    assert re.match(r"FAIL: rib is \d\.\d\d \+- 0\.\d\d mm off its place, limit 0.5 mm\n", bad.out)


def test_a_part_without_a_start_is_searched_for_in_the_range_of_views_that_was_declared(
    cadcam: Callable[..., Ran], cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CADCAM_CACHE", "off")
    asked: list[ViewRange] = []

    def search(part: Part, photos: Sequence[Photo], *, views: ViewRange, freedom: Freedom) -> Location:
        asked.append(views)
        return locate_part(part, photos, POSE)

    monkeypatch.setattr("cadcam.locate.in_photos.locate_part", search)
    words = ("verify", cell / "good.png", cell / "plate.glb", "--camera", cell / "camera.json")
    near = ("--seen-from", "0.5,-0.7,0.7:8", "--roll", "10", "--distance", "950,1050")
    assert cadcam(*words, *near).code == 0
    (views,) = asked
    assert (views.half_angle_deg, views.roll_deg, views.distance_mm) == (8.0, 10.0, (950.0, 1050.0))
    refused = cadcam(*words, "--pose", cell / "pose.txt", *near)
    assert refused.code == 2
    assert "--seen-from is given beside a start" in refused.err


def test_cameras_that_disagree_leave_it_undecided_with_3(cadcam: Callable[..., Ran], cell: Path) -> None:
    """The second camera stands 2 mm beside where its file says."""
    side = Rigid.look_at((-620.0, -520.0, 500.0), (10.0, 0.0, 10.0))
    write_picture(cell / "side.png", photographed(plate(), np.random.default_rng(6), side))
    write_camera(cell / "camera.json", CAMERA, camera_from_world=POSE)

    def ran(off_mm: float) -> Ran:
        told = side @ Rigid(translation=(0.0, off_mm, 0.0))
        write_camera(cell / "side.json", CAMERA, camera_from_world=told)
        return verified(cadcam, cell, "good.png", "--camera", cell / "side.json", "--json", photos=("side.png",))

    right, wrong = ran(0.0), ran(2.0)
    assert right.code == 0
    assert json.loads(right.out)["disagreements"] == []
    assert wrong.code == 3
    assert "the photos disagree" in json.loads(wrong.out)["reason"]
    assert "side.png" in {one["name"] for one in json.loads(wrong.out)["disagreements"]}


def test_a_limit_finer_than_the_uncertainty_is_undecided_with_3(cadcam: Callable[..., Ran], cell: Path) -> None:
    (cell / "tolerances.yaml").write_text(TOLERANCES.replace("0.5", "0.02"))
    ran = verified(cadcam, cell, "good.png")
    assert ran.code == 3
    assert "UNDECIDED" in ran.out


def test_the_calibration_s_uncertainty_is_part_of_each_deviation_s(cadcam: Callable[..., Ran], cell: Path) -> None:
    p = POSE @ np.random.default_rng(4).uniform([-150, -150, -60], [150, 150, 100], size=(40, 3))
    seen = CAMERA.project(p) + np.random.default_rng(5).normal(scale=0.3, size=(40, 2))
    observations = Observations(p, seen, tuple(map(str, range(40))))
    calibrated = calibrate_camera(observations, CAMERA.size, lens=CAMERA.lens)
    shares = []
    for camera in (calibrated, calibrated.camera):
        write_camera(cell / "camera.json", camera)
        said = json.loads(verified(cadcam, cell, "good.png", "--json").out)
        shares.append([np.max(f["covariance_by_cause_mm2"]["calibration"]) for f in said["features"]])
    assert np.sqrt(max(shares[0])) > 1e-3
    assert not any(shares[1])


def test_a_part_that_stays_on_its_plane_is_found_from_the_pose_of_before(
    cadcam: Callable[..., Ran], cell: Path
) -> None:
    """--pose is the start that --freedom needs: the motions are counted from it."""
    ran = verified(cadcam, cell, "good.png", "--freedom", "plane:0,0,1@part", "--json")
    assert ran.code == 0, ran.err
    pose = json.loads(ran.out)["pose"]
    change = POSE.inv.rotation @ np.array(pose["world_from_part"]["rotation"])
    np.testing.assert_allclose(change[2], [0, 0, 1], atol=1e-9)
    assert pose["sigma_mm"][2] == 0.0 < min(pose["sigma_mm"][:2])


def test_a_tolerance_that_names_nothing_is_an_error_that_lists_what_there_is(
    cadcam: Callable[..., Ran], cell: Path
) -> None:
    (cell / "tolerances.yaml").write_text(TOLERANCES.replace("rib 1", "rip 1"))
    ran = verified(cadcam, cell, "good.png")
    assert ran.code == 2
    assert re.search(r"tolerances.yaml: feature 'rib': unknown part 'rip 1'; did you mean 'rib 1'\?", ran.err)


@pytest.mark.parametrize("words", [("--tolerances",), ("--list", "rip 1")])
def test_a_name_that_is_none_is_told_before_edges_are_found(
    cadcam: Callable[..., Ran], cell: Path, words: Sequence[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Finding them takes long in large models, and no name depends on them."""
    (cell / "tolerances.yaml").write_text(TOLERANCES.replace("rib 1", "rip 1"))
    found: list[object] = []
    monkeypatch.setattr("cadcam.locate.part.Scene.of", found.append)
    files = ("--camera", cell / "camera.json", "--pose", cell / "pose.txt")
    ran = (
        cadcam("verify", cell / "plate.glb", *words)
        if "--list" in words
        else cadcam("verify", cell / "good.png", cell / "plate.glb", *files, *words, cell / "tolerances.yaml")
    )
    assert ran.code == 2
    assert "did you mean 'rib 1'?" in ran.err
    assert not found


def test_names_and_a_template_are_printed_without_a_photo(cadcam: Callable[..., Ran], cell: Path) -> None:
    listed = cadcam("verify", cell / "plate.glb", "--list", "-o", cell / "names.png")
    assert listed.code == 0
    assert "rib 2" in listed.out
    assert (cell / "names.png").exists()
    template = cadcam("verify", cell / "plate.glb", "--template")
    assert "  - part: rib 2" in template.out


def test_a_template_spells_out_names_that_are_no_text(cadcam: Callable[..., Ran], tmp_path: Path) -> None:
    odd = r"\ud800t"  # JSON's spelling of half a pair, as long as the name that it replaces
    write_model(tmp_path / "odd.glb", plate())
    data = (tmp_path / "odd.glb").read_bytes()
    assert b'"bracket"' in data
    (tmp_path / "odd.glb").write_bytes(data.replace(b'"bracket"', f'"{odd}"'.encode()))
    ran = cadcam("verify", tmp_path / "odd.glb", "--template", "-o", tmp_path / "t.yaml")
    assert (ran.code, ran.err.count("Traceback")) == (0, 0)
    assert odd in (tmp_path / "t.yaml").read_text()


def test_a_template_of_what_a_photo_shows_can_be_verified(cadcam: Callable[..., Ran], cell: Path) -> None:
    files = ("--camera", cell / "camera.json", "--pose", cell / "pose.txt", "-o", cell / "seen.yaml")
    assert cadcam("verify", cell / "good.png", cell / "plate.glb", "--template", *files).code == 0
    assert "  - part: rib 1\n" in (cell / "seen.yaml").read_text()
    judged = cadcam("verify", cell / "good.png", cell / "plate.glb", "--tolerances", cell / "seen.yaml", *files[:4])
    assert judged.code == 0
    assert "rename me" in judged.out
    named = cadcam("verify", cell / "good.png", cell / "plate.glb", "--list", *files[:4], "-o", cell / "names.png")
    assert named.code == 0
    assert (cell / "names.png").exists()


def test_a_template_of_a_single_part_can_be_verified(cadcam: Callable[..., Ran], tmp_path: Path) -> None:
    """The part itself has to be the datum: an edge of it is judged."""
    make_photo_job(tmp_path)
    files = ("--camera", tmp_path / "camera.json", "--start", tmp_path / "start.txt")
    words = ("verify", tmp_path / "photo.png", MODELS / "bracket.stl", *files)
    written = cadcam(*words, "--template", "-o", tmp_path / "edge.yaml")
    assert written.code == 0, written.err
    judged = cadcam(*words, "--tolerances", tmp_path / "edge.yaml")
    assert judged.code == 0, judged.out + judged.err
    assert judged.out.startswith("PASS: the limit is kept, uncertainty included\n")
    assert re.search(r"rename me +profile +[+-]0\.\d+ mm", judged.out)
    alone = (
        "unclear, bracket: the model has no other part to compare it with: name some of its edges in a tolerance file"
    )
    assert alone in cadcam(*words).out
    blind = cadcam("verify", MODELS / "bracket.stl", "--template", "-o", tmp_path / "any.yaml")
    assert blind.code == 0, blind.err
    assert cadcam(*words, "--tolerances", tmp_path / "any.yaml").code in (0, 3)


def test_the_template_of_a_round_part_names_an_edge_that_the_model_has(
    cadcam: Callable[..., Ran], tmp_path: Path
) -> None:
    """Of a slender pin the photo shows most of its contours, whose numbers are those of one view alone."""
    turn = 2 * np.pi * np.arange(48) / 48
    ring = 10.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ends = [np.column_stack([ring, np.full(48, z)]) for z in (0.0, 150.0)]
    i, j = np.arange(48), np.roll(np.arange(48), -1)
    sides = [np.stack([i, j, j + 48], axis=1), np.stack([i, j + 48, i + 48], axis=1)]
    lids = [np.stack([j, i, np.full(48, 96)], axis=1), np.stack([i + 48, j + 48, np.full(48, 97)], axis=1)]
    middles = np.array([[0, 0, 0], [0, 0, 150.0]])
    pin = Mesh.single(np.concatenate([*ends, middles]), np.concatenate([*sides, *lids]), name="pin", color=(0.6,) * 3)
    write_model(tmp_path / "pin.glb", pin)
    write_camera(tmp_path / "camera.json", CAMERA)
    pose = Rigid.look_at((300.0, -420.0, 420.0), (0.0, 0.0, 70.0))
    rows = "\n".join(" ".join(repr(float(v)) for v in row) for row in pose.matrix)
    (tmp_path / "pose.txt").write_text(f"# camera_from_part, mm\n{rows}\n")
    write_picture(tmp_path / "photo.png", photographed(pin, np.random.default_rng(3), pose))
    words = ("verify", tmp_path / "photo.png", tmp_path / "pin.glb", "--camera", tmp_path / "camera.json")
    more = ("--pose", tmp_path / "pose.txt", "--template", "-o", tmp_path / "t.yaml")
    written = cadcam(*words, *more)
    assert written.code == 0, written.err
    (chain,) = re.findall(r"chains: \[(\d+)\]", (tmp_path / "t.yaml").read_text())
    assert int(chain) < len(np.unique(feature_edges(pin).chain))


def test_names_that_are_no_text_are_spelled_out(cadcam: Callable[..., Ran], cell: Path) -> None:
    """As from a disk in Latin-1: the byte 0xfc is no UTF-8."""
    odd = os.fsdecode(b"Pr\xfcfling.png")
    try:
        (cell / "good.png").rename(cell / odd)
    except OSError:
        pytest.skip("this disk takes no such names")
    outputs = ("-o", cell / "r.html", "-o", cell / "r.json")
    ran = verified(cadcam, cell, odd, *outputs, "--serial", os.fsdecode(b"\xb5 7"))
    assert ran.code == 0, ran.err
    said = json.loads((cell / "r.json").read_text())
    assert (Path(said["photos"][0]["path"]).name, said["serial"]) == (r"Pr\udcfcfling.png", r"\udcb5 7")
    assert r"Pr\udcfcfling.png" in (cell / "r.html").read_text()
    for job in ("add", cell / "r.json"), ("show", said["id"]), ("export", "-o", cell / "all.jsonl"):
        kept = cadcam("state", *job, "--store", cell / "parts.sqlite")
        assert kept.code == 0, kept.err
    assert cadcam("state", "add", cell / "all.jsonl", "--store", cell / "again.sqlite").code == 0


def test_wrong_words_are_told_before_the_model_is_read(cadcam: Callable[..., Ran], cell: Path) -> None:
    """A large STEP file takes half a minute to load."""
    (cell / "tolerances.yaml").write_text(TOLERANCES.replace("0.5", "a lot"))
    (cell / "plate.glb").write_bytes(b"not a model")
    ran = verified(cadcam, cell, "good.png")
    assert ran.code == 2
    assert "features.rib.position_mm" in ran.err


def test_an_example_in_the_guide_is_a_valid_file(tmp_path: Path) -> None:
    import re

    from cadcam.verify.tolerances.file import read_tolerances

    guide = Path(__file__).resolve().parents[2] / "docs" / "verify.md"
    (example,) = re.findall(r"```yaml\n(.*?)```", guide.read_text(), flags=re.DOTALL)
    (tmp_path / "tolerances.yaml").write_text(example)
    found = read_tolerances(tmp_path / "tolerances.yaml")
    assert [f.name for f in found.features] == ["stiffener", "bracket, across", "hole", "nose of the bracket", "side"]
    assert [(d.name, d.between) for d in found.distances] == [("hole to side", ("hole", "side"))]


def test_a_verification_that_is_cut_off_leaves_the_last_report_whole(
    cadcam: Callable[..., Ran], cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed while it writes: the report of the part before is still there, to the last byte, and no half file."""
    report = cell / "report.json"
    assert verified(cadcam, cell, "good.png", "-o", report).code == 0
    before, files = report.read_bytes(), sorted(p.name for p in cell.iterdir())

    def killed(half: str, target: str) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("os.replace", killed)
        with contextlib.suppress(KeyboardInterrupt):
            verified(cadcam, cell, "bad.png", "-o", report)
    assert report.read_bytes() == before
    assert sorted(p.name for p in cell.iterdir()) == files


def test_a_part_that_is_not_there_ends_with_3_and_says_so_in_the_report(cadcam: Callable[..., Ran], cell: Path) -> None:
    write_picture(cell / "empty.png", np.full((360, 480), 0.6, np.float32))
    ran = verified(cadcam, cell, "empty.png", "-o", cell / "empty.html")
    assert ran.code == 3
    assert ran.out.startswith("NOT FOUND")
    page = (cell / "empty.html").read_text()
    assert "NOT FOUND" in page
    assert "PASS:" not in page


class _Terminal(io.StringIO):
    """A text file that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


def test_on_a_terminal_it_is_shown_how_far_it_has_come(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stages with a count each: all five bodies of the plate in the end, on every terminal wide enough for them."""
    shown = _Terminal()
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("sys.stderr", shown)
    words = ("--camera", cell / "camera.json", "--pose", cell / "pose.txt", "--tolerances", cell / "tolerances.yaml")
    assert main(["verify", *map(str, (cell / "good.png", cell / "plate.glb", *words))]) == 0
    lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.getvalue())
    for stage in ("looking for bodies", "measuring bodies", "doubting edges"):
        assert re.search(rf"{stage}[^\n]* 5/5", lines), stage
    assert re.search(r"measuring edges[^\n]* (\d+)/\1\b", lines)
