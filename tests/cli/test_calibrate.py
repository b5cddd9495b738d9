"""`cadcam calibrate`: the library's answer, in tables or JSON, written whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.calibrate.joint.adjustment import calibrate_jointly
from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.files.camera import read_camera
from cadcam.files.points import read_points, write_points
from cadcam.files.poses import read_poses
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

from .job import CAMERA, POSE, SIZE, Ran

Cadcam = Callable[..., Ran]


def test_the_camera_file_holds_the_librarys_answer(cadcam: Cadcam, job: Path) -> None:
    ran = cadcam("calibrate", job / "points.csv", "--size", "320x240", "-o", job / "out.json")
    assert ran.code == 0
    expected = calibrate_camera(read_points(job / "points.csv"), SIZE)
    written = read_camera(job / "out.json").estimate
    assert written is not None
    np.testing.assert_array_equal(written.values, expected.values)
    np.testing.assert_array_equal(written.covariance, expected.covariance)
    assert "focal" in ran.out
    assert "wrote" in ran.err


def test_fixed_parameters_are_in_degrees_and_lens_terms_are_named(cadcam: Cadcam, job: Path) -> None:
    fixed = {"skew": np.arctan2(0.8, 400), "aspect": np.hypot(400, 0.8) / 396, "U0": 118.0, "V0": 165.0}
    shown = {name: float(np.degrees(value)) if name == "skew" else value for name, value in fixed.items()}
    words = [f"{name}={float(value)!r}" for name, value in shown.items()]
    options = [word for text in words for word in ("--fix", text)]
    ran = cadcam("calibrate", job / "points.csv", "--size", "320x240", *options, "--lens", "brown-conrady:k1", "--json")
    assert ran.code == 0, ran.err
    expected = calibrate_camera(
        read_points(job / "points.csv"), SIZE, fixed=fixed, lens=BrownConrady(), free_lens=("k1",)
    )
    stated = ran.json["estimate"]["parameters"]
    assert stated["k1"]["value"] == pytest.approx(expected.value("k1"), rel=1e-9)
    assert stated["skew_rad"] == {"value": pytest.approx(fixed["skew"], rel=1e-12), "sigma": 0.0, "free": False}


def test_the_size_may_come_from_the_photo(cadcam: Cadcam, job: Path) -> None:
    ran = cadcam("calibrate", job / "points.csv", "--photo", job / "photo.png", "--json")
    assert ran.json["size_px"] == [320, 240]


def test_known_internals_give_the_pose_alone(cadcam: Cadcam, job: Path) -> None:
    ran = cadcam(
        "calibrate", job / "points.csv", "--internals", job / "camera.json", "--json", "-o", job / "posed.json"
    )
    expected = locate_camera(read_points(job / "points.csv"), CAMERA)
    posed = read_camera(job / "posed.json")
    assert posed.camera_from_world is not None
    np.testing.assert_array_equal(posed.camera_from_world.matrix, expected.camera_from_world.matrix)
    np.testing.assert_allclose(posed.camera_from_world.origin, POSE.origin, atol=5 * expected.sigma("Z"))
    assert ran.json["estimate"]["free"] == ["X", "Y", "Z", "a", "b", "c"]
    told = cadcam("calibrate", job / "points.csv", "--internals", job / "camera.json").out
    assert "as if the camera's own numbers were exact" in told
    assert "exact" not in cadcam("calibrate", job / "points.csv", "--size", "320x240").out


def test_internals_may_come_from_another_programs_file(cadcam: Cadcam, job: Path) -> None:
    cadcam("convert", job / "camera.json", job / "camera.yml", "--to", "opencv", "--allow-loss", "skew")
    own = cadcam("calibrate", job / "points.csv", "--internals", job / "camera.json", "--json")
    foreign = cadcam("calibrate", job / "points.csv", "--internals", job / "camera.yml", "--json")
    assert foreign.code == 0, foreign.err
    for name, stated in own.json["estimate"]["parameters"].items():
        assert foreign.json["estimate"]["parameters"][name]["value"] == pytest.approx(stated["value"], rel=1e-9)


def test_the_units_and_columns_of_the_points_file_can_be_said(cadcam: Cadcam, job: Path) -> None:
    points = read_points(job / "points.csv")
    rows = "\n".join(
        " ".join(repr(float(v)) for v in (*p / 1000, *q[::-1])) for p, q in zip(points.p_world, points.q, strict=True)
    )
    (job / "bare.txt").write_text(rows)
    options = ("--header", "X,Y,Z,U,V", "--points-unit", "m", "--sigma", "0.1", "--json")
    ran = cadcam("calibrate", job / "bare.txt", "--size", "320x240", *options)
    expected = calibrate_camera(points, SIZE)
    assert ran.json["estimate"]["parameters"]["X_mm"]["value"] == pytest.approx(expected.value("X"), rel=1e-6)
    assert ran.json["estimate"]["noise_px"] == 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--size", "320x240", "--fix", "skw=0"), "'skw'; did you mean 'skew'"),
        (("--size", "320x240", "--fix", "skew"), "NAME=VALUE"),
        (("--size", "320x240", "--fix", "skew=zero"), "--fix skew is 'zero'; expected a number"),
        (("--size", "320x240", "--lens", "brown"), "unknown lens model 'brown'"),
        (("--size", "320x240", "--lens", "division:k1"), "coefficient of the division lens 'k1'"),
        (("--size", "320x240", "--lens", "division"), "such as division:k"),
        (("--size", "320x240", "-o", "camera.yaml"), "unknown suffix"),
        (("--size", "320x240", "-o", "nowhere/camera.json"), "there is no folder 'nowhere'"),
        (("--internals", "none.json"), "none.json: no such file"),
        (("--photo", "none.png"), "none.png"),
        (("--size", "320x240", "--points-unit", "parsec"), "unknown unit 'parsec'"),
        (("--size", "150x240"), "are width and height, or the columns x and y, swapped?"),
        (("--size", "40x30"), "expected points in the picture of 40 x 30 px"),
        (("points.csv", "--size", "320x240"), "view 2 (points.csv) is the same as view 1 (points.csv)"),
    ],
)
def test_a_wrong_option_is_one_message_and_exit_2(
    cadcam: Cadcam, job: Path, options: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    before = sorted(job.rglob("*"))
    ran = cadcam("calibrate", "points.csv", *options)
    assert ran.code == 2
    assert message in ran.err
    assert ran.err.startswith("cadcam calibrate: ")
    assert ran.out == ""
    assert "Traceback" not in ran.err
    assert sorted(job.rglob("*")) == before


def test_a_held_value_that_the_points_contradict_is_named(cadcam: Cadcam, job: Path) -> None:
    """An aspect of 1.2 where it is 1.01: the fit is poor, and its table alone does not say why."""
    ran = cadcam("calibrate", job / "points.csv", "--size", "320x240", "--fix", "aspect=1.2", "--fix", "skew=0")
    assert ran.code == 0
    assert "points.csv: warning: the points contradict what is held: left free, aspect would be 1." in ran.err
    assert ", not 1.2; skew would be " in ran.err
    assert "warning" not in cadcam("calibrate", job / "points.csv", "--size", "320x240", "--fix", "skew=0").err


def test_points_in_a_plane_are_refused_and_the_old_file_stays(cadcam: Cadcam, job: Path) -> None:
    lines = (job / "points.csv").read_text().splitlines()
    flat = [line for line in lines if not line.split(",")[3].startswith("20")]
    (job / "flat.csv").write_text("\n".join(flat))
    before = (job / "camera.json").read_bytes()
    ran = cadcam("calibrate", job / "flat.csv", "--size", "320x240", "-o", job / "camera.json")
    assert ran.code == 2
    assert (job / "camera.json").read_bytes() == before


@pytest.fixture
def positions(tmp_path: Path) -> list[Path]:
    """Points files of four views of a flat board."""
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.arange(6) * 12.0, np.arange(5) * 12.0)
    board = np.column_stack([x.ravel() - 30, y.ravel() - 24, np.zeros(30)])
    files = []
    for j, turn in enumerate(([0.5, 0, 0], [0, 0.5, 0.2], [-0.4, 0.3, 0], [0.2, -0.5, 0.4])):
        q = CAMERA.project(Rigid(so3.exp(turn), [0, 0, 130]) @ board) + 0.05 * rng.normal(size=(30, 2))
        files.append(tmp_path / f"view{j}.csv")
        write_points(files[-1], Observations(board, q))
    return files


def test_several_files_are_one_camera(cadcam: Cadcam, positions: list[Path], tmp_path: Path) -> None:
    """The library's joint answer, in tables, as JSON, as a camera file and a poses file."""
    words = ("calibrate", *positions, "--size", "320x240", "--lens", "brown-conrady:k1")
    views = [read_points(path) for path in positions]
    expected = calibrate_jointly(views, SIZE, lens=BrownConrady(), free_lens=("k1",))
    ran = cadcam(*words, "-o", tmp_path / "out.json", "--poses-out", tmp_path / "poses.csv", "--json")
    assert ran.code == 0, ran.err
    focal = ran.json["parameters"]["focal_px"]
    assert focal["value"] == pytest.approx(expected.value("focal"), rel=1e-9)
    assert focal["sigma"] == pytest.approx(expected.sigma("focal"), rel=1e-6)
    assert focal["sigma_by_view"] == pytest.approx(expected.sigma("focal", by_view=True), rel=1e-6)
    assert any(text.startswith(("keep k1", "hold k1")) for text in ran.json["advice"])
    written = read_camera(tmp_path / "out.json").estimate
    assert written is not None
    assert written.sigma("focal") == pytest.approx(expected.sigma("focal"), rel=1e-9)
    poses = read_poses(tmp_path / "poses.csv")
    assert list(poses) == [str(path) for path in positions]
    assert poses[str(positions[2])].origin == pytest.approx(expected.pose(2).origin, abs=1e-9)
    ran = cadcam(*words)
    assert ran.code == 0
    for text in ("Camera of 4 views, 120 points", "by views", "Which parameters the views show", "recommended:"):
        assert text in ran.out


def test_what_goes_with_one_file_only_or_with_several_only_is_said(
    cadcam: Cadcam, job: Path, positions: list[Path]
) -> None:
    ran = cadcam("calibrate", *positions, "--internals", job / "camera.json")
    assert (ran.code, "one points file at a time" in ran.err) == (2, True)
    ran = cadcam("calibrate", job / "points.csv", "--size", "320x240", "--bend")
    assert (ran.code, "several positions" in ran.err) == (2, True)
    ran = cadcam("calibrate", *positions[:2], "--size", "320x240", "--fix", "X=3")
    assert (ran.code, "unknown shared parameter to fix 'X'" in ran.err) == (2, True)
