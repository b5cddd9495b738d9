"""`cadcam decompose`: the same parameters from a matrix in either row order and from a camera file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.extended_pinhole import NAMES, ExtendedPinhole, uv_from_pixel_matrix, uv_matrix
from cadcam.files.camera import write_camera
from cadcam.files.points import read_points

from .job import CAMERA, POSE, SIZE, Ran

Cadcam = Callable[..., Ran]
EXPECTED = ExtendedPinhole.from_camera(CAMERA, POSE).vector


def parameters(document: dict[str, float]) -> np.ndarray:
    assert [key.partition("_")[0] for key in document] == list(NAMES)
    return np.array(list(document.values()))


def test_matrices_in_both_row_orders_and_the_camera_file_agree(cadcam: Cadcam, job: Path) -> None:
    C = uv_matrix(CAMERA, POSE)
    np.savetxt(job / "uv.txt", -2 * C)
    np.savetxt(job / "xy.txt", uv_from_pixel_matrix(C))
    for words in (("uv.txt", "--rows", "uv"), ("xy.txt", "--rows", "xy"), ("camera.json",)):
        ran = cadcam("decompose", job / words[0], *words[1:], "--json")
        np.testing.assert_allclose(parameters(ran.json["parameters"]), EXPECTED, rtol=1e-9, atol=1e-12)


def test_sigmas_stand_beside_the_parameters_where_they_are_known(cadcam: Cadcam, job: Path) -> None:
    estimate = calibrate_camera(read_points(job / "points.csv"), SIZE)
    write_camera(job / "calibrated.json", estimate)
    ran = cadcam("decompose", job / "calibrated.json")
    focal = next(line for line in ran.out.splitlines() if line.startswith("  focal"))
    assert "+-" in focal
    assert "glFrustum" in ran.out
    document = cadcam("decompose", job / "calibrated.json", "--json").json
    assert document["estimate"]["parameters"]["focal_px"]["sigma"] == estimate.sigma("focal")


def test_another_program_s_camera_file_is_taken_apart(cadcam: Cadcam, job: Path) -> None:
    write_camera(job / "alone.json", CAMERA)
    skewed = ("--to", "opencv", "--allow-loss", "skew")
    assert cadcam("convert", job / "alone.json", job / "alone.yaml", *skewed).code == 0
    ran = cadcam("decompose", job / "alone.yaml", "--json")
    assert ran.code == 0, ran.err
    np.testing.assert_allclose(ran.json["K_px"], CAMERA.K, rtol=1e-12)


def test_opengl_values_need_a_picture_size(cadcam: Cadcam, job: Path) -> None:
    np.savetxt(job / "uv.txt", uv_matrix(CAMERA, POSE))
    without = cadcam("decompose", job / "uv.txt", "--rows", "uv")
    assert "glFrustum" not in without.out
    assert "size not known" in without.out
    sized = cadcam("decompose", job / "uv.txt", "--rows", "uv", "--size", "320x240", "--near", "5", "--json").json
    assert sized["opengl"]["glFrustum_mm"]["near"] == 5
    assert sized["opengl"]["glViewport_px"] == [0, 0, 320, 240]


def test_a_camera_without_a_pose_still_shows_its_matrix(cadcam: Cadcam, job: Path) -> None:
    write_camera(job / "alone.json", CAMERA)
    ran = cadcam("decompose", job / "alone.json")
    assert ran.code == 0
    assert "Camera matrix K" in ran.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("m.txt",), "--rows is not given; expected uv for a matrix"),
        (("camera.json", "--rows", "uv"), "neither: the file says both"),
        (("bad.txt", "--rows", "uv"), "bad.txt: line 2, number 3 is 'x'"),
        (("short.txt", "--rows", "uv"), "give a 3x4 matrix"),
        (("flat.txt", "--rows", "uv"), "flat.txt: holds no camera: M = C[:, :3] has no inverse"),
        (("camera.json", "--near", "-1"), "0 < near < far"),
    ],
)
def test_a_wrong_matrix_is_one_message_and_exit_2(
    cadcam: Cadcam, job: Path, words: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    (job / "m.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n")
    (job / "bad.txt").write_text("1 0 0 0\n0 1 x 0\n0 0 1 0\n")
    (job / "short.txt").write_text("1 0 0 0\n0 1 0 0\n")
    (job / "flat.txt").write_text("1 0 0 0\n1 0 0 5\n0 1 0 2\n")
    ran = cadcam("decompose", *words)
    assert (ran.code, ran.out) == (2, "")
    assert message in ran.err
