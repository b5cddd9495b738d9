"""`cadcam measure`: from pixels to points, distances and files; every wrong input is named with its remedy."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.files.camera import write_camera
from cadcam.geometry.rigid import Rigid

from .job import SIZE, Ran

Cadcam = Callable[..., Ran]
CAMERA = Camera.from_focal(SIZE, 400, fy=396, cx=165, cy=118, skew=0.8)
LEFT = Rigid.look_at([180, -260, 200], [30, 20, 10])
RIGHT = Rigid.look_at([-200, -180, 220], [30, 20, 10])
STEP = Rigid.exp([60.0, 40.0, -10.0, 0.05, -0.1, 0.2])
BOX = np.array([[x, y, z] for x in (0, 60) for y in (0, 40) for z in (0, 20)] + [[30, 20, 35], [10, 35, 5]], float)
POINTS = {"A": [20.0, 10, 5], "B": [40.0, 30, 15], "C": [50.0, 5, 10], "D": [5.0, 20, 0]}


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two calibrated cameras, the left one moved and located anew, and what all saw of four points."""
    folder = tmp_path_factory.mktemp("rig")
    rng = np.random.default_rng(6)
    away = LEFT @ STEP.inv
    estimates = {}
    for name, pose in (("left", LEFT), ("right", RIGHT)):
        q = CAMERA.project(pose @ BOX) + rng.normal(scale=0.05, size=(len(BOX), 2))
        estimates[name] = calibrate_camera(
            Observations(BOX, q, sigma_px=0.05), SIZE, fixed={"skew": 0.002, "aspect": 1.0101}
        )
        write_camera(folder / f"{name}.json", estimates[name])
    q = CAMERA.project(away @ BOX) + rng.normal(scale=0.05, size=(len(BOX), 2))
    write_camera(folder / "posed.json", locate_camera(Observations(BOX, q, sigma_px=0.05), estimates["left"].camera))
    write_camera(folder / "bare.json", CAMERA, camera_from_world=RIGHT)
    lines = "\n".join(" ".join(repr(float(v)) for v in row) for row in STEP.matrix)
    (folder / "motion.txt").write_text(f"# new_from_old, mm\n{lines}\n")
    lines = "\n".join(" ".join(repr(float(v)) for v in row) for row in away.matrix)
    (folder / "pose.txt").write_text(f"# camera_from_world, mm\n{lines}\n")
    rows = ["name,view,x_px,y_px"]
    for view, pose in (("left", LEFT), ("right", RIGHT), ("away", away)):
        for name, p in POINTS.items():
            x, y = CAMERA.project(pose @ np.array(p)) + rng.normal(scale=0.05, size=2)
            rows.append(f"{name},{view},{x!r},{y!r}".replace("np.float64(", "").replace(")", ""))
    (folder / "all.csv").write_text("\n".join(rows) + "\n")
    (folder / "two.csv").write_text("\n".join(r for r in rows if ",away," not in r) + "\n")
    (folder / "moved.csv").write_text("\n".join(r for r in rows if ",right," not in r) + "\n")
    (folder / "one.csv").write_text("\n".join(r for r in rows if ",right," not in r and ",away," not in r) + "\n")
    return folder


def two(rig: Path) -> list[str]:
    return ["measure", f"{rig}/two.csv", "--camera", f"left={rig}/left.json", "--camera", f"{rig}/right.json"]


def close(document: dict, sigmas: float = 4.0) -> bool:
    """Return whether every point lies within its sigmas of where it is."""
    return all(
        np.all(np.abs(np.subtract(p["p_world_mm"], POINTS[p["name"]])) < sigmas * np.array(p["sigma_mm"]))
        for p in document["points"]
    )


def test_two_cameras_measure_points_and_a_distance(cadcam: Cadcam, rig: Path) -> None:
    ran = cadcam(*two(rig), "--between", "A,B", "--json")
    assert ran.code == 0, ran.err
    assert [p["name"] for p in ran.json["points"]] == ["A", "B", "C", "D"]
    assert close(ran.json)
    length = ran.json["distances_mm"][0]
    truth = np.linalg.norm(np.subtract(POINTS["A"], POINTS["B"]))
    assert abs(length["value"] - truth) < 4 * length["sigma"] < 1.0
    assert "joint_covariance_mm2" not in ran.json
    for p in ran.json["points"]:
        parts = [np.array(s) for s in p["sigma_by_cause_mm"].values()]
        assert np.sqrt(sum(s**2 for s in parts)) == pytest.approx(p["sigma_mm"])


def test_the_tables_show_points_distances_and_causes(cadcam: Cadcam, rig: Path) -> None:
    out = cadcam(*two(rig), "--between", "A,B").out
    for words in (
        "4 points, mm +- sigma",
        "gap/sigma",
        "Distances, mm",
        "if independent",
        "calibration",
        "all together",
    ):
        assert words in out


def test_points_are_written_as_csv_and_json(cadcam: Cadcam, rig: Path, tmp_path: Path) -> None:
    ran = cadcam(*two(rig), "-o", tmp_path / "points.csv")
    assert ran.code == 0
    rows = list(csv.DictReader((tmp_path / "points.csv").read_text().splitlines()))
    assert [r["name"] for r in rows] == list(POINTS)
    assert all(float(r["sigma_X_mm"]) > 0 and r["views"] == "left right" for r in rows)
    ran = cadcam(*two(rig), "-o", tmp_path / "points.json", "--joint")
    document = json.loads((tmp_path / "points.json").read_text())
    joint = np.array(document["joint_covariance_mm2"])
    assert joint.shape == (12, 12)
    assert joint[3:6, 3:6] == pytest.approx(np.array(document["points"][1]["covariance_mm2"]))
    assert float(rows[2]["Y_mm"]) == document["points"][2]["p_world_mm"][1]
    assert len(document["pixels"]["sha256"]) == 64


def test_a_moved_camera_measures_with_its_motion(cadcam: Cadcam, rig: Path) -> None:
    words = ["measure", rig / "moved.csv", "--camera", rig / "left.json", "--moved", f"away=left:{rig}/motion.txt"]
    exact = cadcam(*words, "--json")
    rough = cadcam(*words, "--motion-sigma", "0.2,0.02", "--json")
    assert (exact.code, rough.code) == (0, 0)
    assert close(exact.json)
    assert close(rough.json)
    assert rough.json["points"][0]["sigma_mm"] > exact.json["points"][0]["sigma_mm"]
    assert "motion to away" in rough.json["points"][0]["sigma_by_cause_mm"]


@pytest.mark.parametrize(("file", "known_to"), [("posed.json", []), ("pose.txt", ["--motion-sigma", "0.1,0.01"])])
def test_a_placed_camera_measures_from_there(cadcam: Cadcam, rig: Path, file: str, known_to: list[str]) -> None:
    words = ["--camera", rig / "left.json", "--placed", f"away=left:{rig}/{file}", *known_to]
    ran = cadcam("measure", rig / "moved.csv", *words, "--json")
    assert ran.code == 0, ran.err
    assert close(ran.json)


def test_a_motion_s_sigma_is_refused_where_every_placed_file_has_its_own(cadcam: Cadcam, rig: Path) -> None:
    words = ["--camera", rig / "left.json", "--placed", f"away=left:{rig}/posed.json", "--motion-sigma", "0.1,0.01"]
    ran = cadcam("measure", rig / "moved.csv", *words)
    assert (ran.code, ran.out) == (2, "")
    assert "--motion-sigma is given where every file of --placed states how well it is known" in ran.err
    one_needs_it = ["--placed", f"again=left:{rig}/pose.txt"]
    assert cadcam("measure", rig / "moved.csv", *words, *one_needs_it).code == 0


@pytest.mark.parametrize("again", ["{rig}/./left.json", "link.json", "copy.json"])
def test_one_calibration_is_one_under_every_name_of_its_file(
    cadcam: Cadcam, rig: Path, tmp_path: Path, again: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pixels that it saw twice are averaged, its calibration is not."""
    monkeypatch.chdir(tmp_path)
    Path("copy.json").write_bytes((rig / "left.json").read_bytes())
    Path("link.json").symlink_to(rig / "left.json")
    rows = (rig / "two.csv").read_text()
    left = [row for row in rows.splitlines() if ",left," in row]
    Path("twice.csv").write_text(rows + "\n".join(left).replace(",left,", ",again,"))
    words = ["measure", "twice.csv", "--camera", rig / "left.json", "--camera", rig / "right.json", "--json"]
    same, named = (cadcam(*words, "--camera", f"again={file}") for file in (rig / "left.json", again.format(rig=rig)))
    placed = cadcam(*words, "--placed", f"again=left:{again.format(rig=rig)}")
    assert (same.code, named.code, placed.code) == (0, 0, 0), same.err + named.err + placed.err
    assert same.json["points"] == named.json["points"] == placed.json["points"]


def test_one_camera_measures_on_a_plane(cadcam: Cadcam, rig: Path) -> None:
    words = ["--camera", rig / "left.json", "--plane", "0,0,2,20", "--plane-sigma", "0.1"]
    ran = cadcam("measure", rig / "one.csv", *words, "--json")
    assert ran.code == 0, ran.err
    c = next(p for p in ran.json["points"] if p["name"] == "C")
    assert c["p_world_mm"][2] == pytest.approx(10)
    assert c["sigma_mm"][2] == pytest.approx(0.1)
    assert np.abs(np.subtract(c["p_world_mm"], POINTS["C"])).max() < 1


def test_a_file_without_calibration_needs_the_noise_and_says_so(cadcam: Cadcam, rig: Path) -> None:
    words = ["measure", rig / "two.csv", "--camera", rig / "left.json", "--camera", f"right={rig}/bare.json"]
    refused = cadcam(*words)
    assert refused.code == 2
    assert "--sigma is not given" in refused.err
    ran = cadcam(*words, "--sigma", "0.05")
    assert ran.code == 0
    assert "taken as exact, for their files hold no uncertainty: right" in ran.out


def test_points_seen_once_are_listed_and_the_others_measured(cadcam: Cadcam, rig: Path, tmp_path: Path) -> None:
    lines = (rig / "two.csv").read_text().splitlines()
    (tmp_path / "less.csv").write_text("\n".join(line for line in lines if not line.startswith("D,right")))
    words = two(rig)
    words[1] = f"{tmp_path}/less.csv"
    ran = cadcam(*words)
    assert ran.code == 0
    assert "3 points, mm" in ran.out
    assert "seen by 'left' only" in ran.out
    assert "1 of 4 points could not be measured" in ran.err


def test_a_wrong_pixel_is_marked_at_its_point(cadcam: Cadcam, rig: Path, tmp_path: Path) -> None:
    line = next(t for t in (rig / "two.csv").read_text().splitlines() if t.startswith("C,right"))
    name, view, x, y = line.split(",")
    off = f"{name},{view},{x},{float(y) + 8}"
    (tmp_path / "off.csv").write_text((rig / "two.csv").read_text().replace(line, off))
    words = two(rig)
    words[1] = f"{tmp_path}/off.csv"
    out = cadcam(*words).out
    marked = [t.split()[0] for t in out.splitlines() if t.endswith("does not fit")]
    assert marked == ["C"]
    assert "warning: 1 of 4 points do not fit (C)" in out


WRONG = {
    "no such camera": (["--moved", "away=middle:motion.txt"], "did you mean|unknown camera"),
    "view without camera": ([], None),
    "moved as a pose": (["--moved", "away=left:pose.txt"], "add a first line such as '# new_from_old, mm'"),
    "no file": (["--moved", "away=left:none.txt"], "no such file"),
    "malformed": (["--moved", "away:left"], "VIEW=CAMERA:FILE"),
    "sigma": (["--motion-sigma", "0.1", "--moved", "away=left:motion.txt"], "MM,DEG"),
    "noise": (
        ["--moved", "away=left:motion.txt", "--sigma", "-1"],
        r"--sigma is -1\.0; expected a positive number of px",
    ),
    "plane": (["--moved", "away=left:motion.txt", "--plane", "0,0,1"], "NX,NY,NZ,D"),
    "output": (["-o", "points.xyz"], ".csv"),
    "unknown point": (["--moved", "away=left:motion.txt", "--between", "A,Z"], "unknown point 'Z'"),
}


@pytest.mark.parametrize(("words", "message"), WRONG.values(), ids=WRONG.keys())
def test_wrong_words_are_one_message(
    cadcam: Cadcam, rig: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], message: str | None
) -> None:
    monkeypatch.chdir(rig)
    ran = cadcam("measure", "moved.csv", "--camera", "left.json", *words)
    assert ran.code == 2
    assert ran.err.count("\n") == 1
    assert re.search(message or "unknown view in .*'away'", ran.err), ran.err


def test_swapped_columns_are_named(cadcam: Cadcam, rig: Path, tmp_path: Path) -> None:
    (tmp_path / "swapped.csv").write_text((rig / "all.csv").read_text().replace("x_px,y_px", "U,V"))
    words = ["--camera", rig / "left.json", "--camera", rig / "right.json", "--moved", f"away=left:{rig}/motion.txt"]
    ran = cadcam("measure", tmp_path / "swapped.csv", *words)
    assert ran.code == 2
    assert "the two image columns of all views are exchanged" in ran.err
    assert cadcam("measure", rig / "all.csv", *words).code == 0


def test_a_motion_in_mm_that_is_said_to_be_in_m_is_named_as_that(cadcam: Cadcam, rig: Path, tmp_path: Path) -> None:
    (tmp_path / "m.txt").write_text((rig / "motion.txt").read_text().replace(", mm", ", m"))
    words = ("measure", rig / "moved.csv", "--camera", rig / "left.json", "--moved", f"away=left:{tmp_path / 'm.txt'}")
    ran = cadcam(*words)
    assert ran.code == 2
    assert "only if the motion to 'away' is 1000 times too long: mm said to be m: correct that input" in ran.err
