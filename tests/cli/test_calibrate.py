"""`cadcam calibrate`: the library's answer, in tables or JSON, written whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.calibrate.points import calibrate, locate_camera
from cadcam.camera.lens import BrownConrady
from cadcam.files.camera import read_camera
from cadcam.files.points import read_points

from .job import CAMERA, POSE, SIZE, Ran

Cadcam = Callable[..., Ran]


def test_the_camera_file_holds_the_librarys_answer(cadcam: Cadcam, job: Path) -> None:
    ran = cadcam("calibrate", job / "points.csv", "--size", "320x240", "-o", job / "out.json")
    assert ran.code == 0
    expected = calibrate(read_points(job / "points.csv"), SIZE)
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
    expected = calibrate(read_points(job / "points.csv"), SIZE, fixed=fixed, lens=BrownConrady(), free_lens=("k1",))
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


def test_the_units_and_columns_of_the_points_file_can_be_said(cadcam: Cadcam, job: Path) -> None:
    points = read_points(job / "points.csv")
    rows = "\n".join(
        " ".join(repr(float(v)) for v in (*p / 1000, *q[::-1])) for p, q in zip(points.p_world, points.q, strict=True)
    )
    (job / "bare.txt").write_text(rows)
    options = ("--header", "X,Y,Z,U,V", "--points-unit", "m", "--sigma", "0.1", "--json")
    ran = cadcam("calibrate", job / "bare.txt", "--size", "320x240", *options)
    expected = calibrate(points, SIZE)
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


def test_points_in_a_plane_are_refused_and_the_old_file_stays(cadcam: Cadcam, job: Path) -> None:
    lines = (job / "points.csv").read_text().splitlines()
    flat = [line for line in lines if not line.split(",")[3].startswith("20")]
    (job / "flat.csv").write_text("\n".join(flat))
    before = (job / "camera.json").read_bytes()
    ran = cadcam("calibrate", job / "flat.csv", "--size", "320x240", "-o", job / "camera.json")
    assert ran.code == 2
    assert (job / "camera.json").read_bytes() == before
