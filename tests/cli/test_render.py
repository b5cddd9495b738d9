"""`cadcam render`: every channel is the renderer's own, written in the form its suffix says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.read import read_model
from cadcam.files.camera import write_camera
from cadcam.image.picture import read_picture, read_picture_with_info
from cadcam.render import open_renderer
from cadcam.render.standard_view import DIRECTIONS, standard_view
from cadcam.render.view import Scene, View

from .job import CAMERA, POSE, Ran

Cadcam = Callable[..., Ran]


def seen(job: Path) -> View:
    return open_renderer(Scene.of(read_model(job / "block.obj"))).render(CAMERA, POSE)


@pytest.mark.parametrize(("channel", "layer"), [("depth", "depth"), ("normals", "normal"), ("parts", "part")])
def test_arrays_are_the_renderers_own(cadcam: Cadcam, job: Path, channel: str, layer: str) -> None:
    ran = cadcam(
        "render", job / "block.obj", "--camera", job / "camera.json", "--channel", channel, "-o", job / "a.npy"
    )
    assert ran.code == 0, ran.err
    np.testing.assert_array_equal(np.load(job / "a.npy"), getattr(seen(job), layer))


def test_depth_as_a_picture_is_within_half_a_step(cadcam: Cadcam, job: Path) -> None:
    words = ("render", job / "block.obj", "--camera", job / "camera.json", "--channel", "depth", "-o", job / "d.png")
    step = cadcam(*words, "--json").json["depth_mm_per_step"]
    picture, info = read_picture_with_info(job / "d.png")
    view = seen(job)
    assert info.bits == 16
    np.testing.assert_array_equal(picture > 0, view.mask)
    error = np.abs(np.round(picture[view.mask].astype(float) * 65535) * step - view.depth[view.mask])
    assert error.max() <= step / 2 + 1e-4  # mm; the rest is float32's own rounding of about 3e-5 mm


def test_parts_are_named_with_their_pixels(cadcam: Cadcam, job: Path) -> None:
    words = ("render", job / "block.obj", "--camera", job / "camera.json", "--channel", "parts", "-o", job / "p.png")
    assert cadcam(*words, "--json").json["seen_parts"] == {"block": {"number": 0, "pixels": int(seen(job).mask.sum())}}


@pytest.mark.parametrize("view", sorted(DIRECTIONS))
def test_without_a_camera_the_model_fills_the_picture(job: Path, view: str) -> None:
    mesh = read_model(job / "block.obj")
    camera, pose = standard_view(mesh, view, size=(400, 300))
    q = camera.project(pose @ mesh.vertices)
    assert camera.sees(q).all()
    extent = (np.ptp(q, axis=0) / camera.size).max()
    assert 0.9 < extent < 0.95  # 1/1.08


def test_the_camera_and_pose_come_from_their_files(cadcam: Cadcam, job: Path) -> None:
    write_camera(job / "alone.json", CAMERA)
    rows = "\n".join(" ".join(repr(float(v)) for v in row) for row in POSE.inv.matrix)
    (job / "pose.txt").write_text(f"# world_from_camera, mm\n{rows}\n")
    model = job / "block.obj"
    one = cadcam("render", model, "--camera", job / "camera.json", "-o", job / "one.png")
    two = cadcam("render", model, "--camera", job / "alone.json", "--pose", job / "pose.txt", "-o", job / "two.png")
    assert (one.code, two.code) == (0, 0), one.err + two.err
    difference = np.abs(read_picture(job / "one.png") - read_picture(job / "two.png"))
    assert np.mean(difference > 0.02) < 1e-3  # the inverse of an inverse differs in its last bits


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_the_wireframe_is_drawn(cadcam: Cadcam, job: Path, suffix: str) -> None:
    out = job / f"w.{suffix}"
    ran = cadcam("render", job / "block.obj", "--channel", "wireframe", "--hidden", "-o", out, "--json")
    assert (ran.json["visible_lines"], ran.json["hidden_lines"]) == (9, 3)
    assert ran.json["model"]["size_mm"] == [60, 40, 20]
    if suffix == "png":
        assert (read_picture(out) < 0.5).any()
    else:
        assert out.read_text().count("<path") == 12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "a.gif"), "unknown suffix of output 'a.gif'"),
        (("-o", "a.jpg", "--channel", "faces"), "known: .npy, .png"),
        (("-o", "a.png", "--camera", "camera.json", "--view", "top"), "the camera decides"),
        (("-o", "a.png", "--pose", "camera.json"), "a pose does not say the focal length"),
        (("-o", "a.png", "--camera", "alone.json"), "the pose in alone.json is missing"),
        (("-o", "a.png", "--unit", "mn"), "unknown unit 'mn'"),
        (("-o", "a.png", "--channel", "wireframe", "--crease-angle", "500"), "--crease-angle is 500"),
        (("-o", "a.png", "--channel", "wireframe", "--width", "0"), "width is 0"),
    ],
)
def test_a_wrong_option_is_one_message_and_exit_2(
    cadcam: Cadcam, job: Path, options: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    write_camera(job / "alone.json", CAMERA)
    before = sorted(job.rglob("*"))
    ran = cadcam("render", "block.obj", *options)
    assert (ran.code, ran.out) == (2, "")
    assert message in ran.err
    assert sorted(job.rglob("*")) == before
