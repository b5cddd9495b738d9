"""`cadcam overlay`: the library's picture in every mode; the photo is the camera's or it is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.read import read_model
from cadcam.calibrate.points.camera import locate_camera
from cadcam.files.camera import write_camera
from cadcam.files.points import read_points
from cadcam.image.picture import read_picture, write_picture
from cadcam.render import open_renderer
from cadcam.render.lines.visible import visible_wireframe
from cadcam.render.overlay import overlay
from cadcam.render.view import Channel, Look, Scene

from .job import CAMERA, POSE, SIZE, Ran

Cadcam = Callable[..., Ran]


def words(job: Path, *more: str | Path) -> list[str | Path]:
    return ["overlay", job / "photo.png", job / "block.obj", "--camera", job / "camera.json", *more]


def test_the_picture_is_the_librarys(cadcam: Cadcam, job: Path) -> None:
    ran = cadcam(*words(job, "-o", job / "o.png"))
    assert ran.code == 0, ran.err
    wires = visible_wireframe(Scene.of(read_model(job / "block.obj")), CAMERA, POSE)
    expected = overlay(read_picture(job / "photo.png"), wires)
    # written with 8 bits: half a step
    np.testing.assert_allclose(read_picture(job / "o.png"), expected, rtol=0, atol=0.5 / 255 + 1e-6)
    assert "9 visible lines" in ran.out


@pytest.mark.parametrize(
    ("options", "size"),
    [
        (("--shaded", "0.5", "--hidden", "--color-by", "part"), SIZE),
        (("--mode", "side-by-side"), (2 * SIZE[0] + 8, SIZE[1])),
        (("--mode", "sum"), SIZE),
        (("--mode", "canny"), SIZE),
    ],
)
def test_every_mode_draws(cadcam: Cadcam, job: Path, options: tuple[str, ...], size: tuple[int, int]) -> None:
    ran = cadcam(*words(job, *options, "-o", job / "o.png"))
    assert ran.code == 0, ran.err
    assert read_picture(job / "o.png").shape[1::-1] == size


def test_an_svg_embeds_the_photo_and_dashes_what_is_hidden(cadcam: Cadcam, job: Path) -> None:
    assert cadcam(*words(job, "--hidden", "--shaded", "0.3", "-o", job / "o.svg")).code == 0
    text = (job / "o.svg").read_text()
    assert "data:image/jpeg;base64" in text
    assert "stroke-dasharray" in text


def test_the_pose_may_be_found_from_points(cadcam: Cadcam, job: Path) -> None:
    write_camera(job / "alone.json", CAMERA)
    ran = cadcam(
        *("overlay", job / "photo.png", job / "block.obj", "--camera", job / "alone.json"),
        *("--points", job / "points.csv", "-o", job / "o.png", "--json"),
    )
    expected = locate_camera(read_points(job / "points.csv"), CAMERA)
    assert ran.json["camera"]["camera_from_world"]["rotation"] == expected.camera_from_world.rotation.tolist()
    assert ran.json["pose_estimate"]["residual_px"] == expected.thesis_residual


def test_the_distance_to_the_photos_edges_is_measured(cadcam: Cadcam, job: Path) -> None:
    scene = Scene.of(read_model(job / "block.obj"))
    look = Look(supersampling=4, background=(0.1, 0.1, 0.1))
    write_picture(job / "photo.png", open_renderer(scene).render(CAMERA, POSE, channels=Channel.IMAGE, look=look).image)
    ran = cadcam(*words(job, "--measure", "-o", job / "o.png", "--json"))
    distance = ran.json["edge_distance_px"]
    assert distance["median"] < 0.3  # px; a shaded edge between alike faces is less sharp than the outline
    assert distance["samples"] > 200
    text = cadcam(*words(job, "--measure", "-o", job / "o.png")).out
    assert f"{distance['median']:.2f} px" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--points", "points.csv", "--pose", "camera.json", "-o", "o.png"), "one of them"),
        (("--mode", "sum", "-o", "o.svg"), "overlay for an .svg file"),
        (("--mode", "sum", "--shaded", "0.5", "-o", "o.png"), "overlay or side-by-side"),
        (("-o", "o.bmp"), "unknown suffix"),
        (("--camera", "alone.json", "-o", "o.png"), "with camera_from_world, or --pose FILE or --points FILE"),
    ],
)
def test_a_wrong_option_is_one_message_and_exit_2(
    cadcam: Cadcam, job: Path, options: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    write_camera("alone.json", CAMERA)
    before = sorted(job.rglob("*"))
    ran = cadcam("overlay", "photo.png", "block.obj", "--camera", "camera.json", *options)
    assert (ran.code, ran.out) == (2, "")
    assert message in ran.err
    assert sorted(job.rglob("*")) == before
