"""What a format cannot hold is said, in px where it moves pixels, and refused unless it was allowed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.difference import largest_difference
from cadcam.camera.equivalent import equivalents
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES as PARAMETERS
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue
from cadcam.files.foreign.losses import RefusedLoss, fits
from cadcam.files.foreign.model import Foreign, NamedCamera
from cadcam.files.foreign.registry import NAMES, format_named, read_cameras, write_cameras
from cadcam.geometry.rigid import Rigid

from .foreign_cameras import random_camera, random_lenses

SKEWED = Camera.from_focal((640, 480), 500.0, fy=505.0, cx=330.0, cy=230.0, skew=2.0)
every_format = pytest.mark.parametrize("name", NAMES)


def target(folder: Path, name: str) -> Path:
    suffixes = format_named(name).suffixes
    return folder / f"out{suffixes[0] if suffixes else ''}"


@every_format
def test_each_loss_is_refused_by_default_and_nothing_is_written(
    tmp_path: Path, rng: np.random.Generator, name: str
) -> None:
    form = format_named(name)
    for i, lens in enumerate(random_lenses(rng)):
        camera, path = random_camera(rng, lens, holds=form.holds), target(tmp_path / str(i), name)
        if any(fits(same.lens, form.holds) for same in equivalents(camera)):
            write_cameras(path, camera, format_name=name)
            assert largest_difference(camera, read_cameras(path).cameras[0].camera) < 1e-9
            continue
        with pytest.raises(RefusedLoss, match="--allow-loss lens") as refusal:
            write_cameras(path, camera, format_name=name)
        assert [loss.what for loss in refusal.value.losses] == ["lens"]
        assert not path.exists()


@every_format
def test_a_loss_allowed_moves_pixels_by_what_was_said(tmp_path: Path, rng: np.random.Generator, name: str) -> None:
    form = format_named(name)
    path = target(tmp_path, name)
    camera = Camera.from_focal((640, 480), 700.0, cx=330, cy=230, lens=BrownConrady(-0.1, 0.02, s1=1e-3))
    allowed = ("lens", "principal-point")
    written = write_cameras(path, camera, format_name=name, allow_loss=allowed)
    back = read_cameras(path).cameras[0].camera
    off, said = largest_difference(camera, back), [loss.px for loss in written.losses if loss.moves_pixels]
    assert off <= sum(said) * (1 + 1e-6) + 1e-9
    assert bool(said) == (not fits(camera.lens, form.holds) or not form.holds.principal_point)
    if len(said) == 1:
        assert off == pytest.approx(said[0], rel=1e-6)


@every_format
def test_skew_is_held_or_said(tmp_path: Path, name: str) -> None:
    skew = format_named(name).holds.skew
    path = target(tmp_path, name)
    if skew == "yes":
        write_cameras(path, SKEWED, format_name=name)
        assert read_cameras(path).cameras[0].camera.skew == pytest.approx(2.0, abs=1e-12)
        return
    with pytest.raises(RefusedLoss, match="skew: K01 = 2 px"):
        write_cameras(path, SKEWED, format_name=name, allow_loss=("principal-point",))
    written = write_cameras(path, SKEWED, format_name=name, allow_loss=("skew", "principal-point"))
    (loss,) = (loss for loss in written.losses if loss.what == "skew")
    # K01 y/z for the largest |y/z| in the picture
    assert loss.px == pytest.approx(2.0 * max(480 - 0.5 - 230, 230.5) / 505, rel=1e-9)
    assert read_cameras(path).cameras[0].camera.skew == (2.0 if skew == "ignored" else 0.0)


def test_the_lost_principal_point_of_gltf_is_said(tmp_path: Path) -> None:
    camera = Camera.from_focal((640, 480), 500.0, cx=330.0)
    with pytest.raises(RefusedLoss, match="principal-point") as caught:
        write_cameras(tmp_path / "c.gltf", camera)
    assert caught.value.losses[0].px == pytest.approx(330 - 319.5)


@every_format
def test_poses_and_covariance_are_held_or_said(tmp_path: Path, rng: np.random.Generator, name: str) -> None:
    camera, pose = Camera.from_focal((640, 480), 500.0), Rigid.look_at([300, -200, 900], [1, 2, 3])
    p = rng.uniform(-50, 50, (8, 3))
    q = camera.project(pose @ p) + rng.normal(scale=0.2, size=(8, 2))
    A = rng.normal(size=(11, 11))
    estimate = CameraEstimate(camera, pose, Observations(p, q), PARAMETERS[:6], A @ A.T, "made up")
    named = NamedCamera("camera", camera, pose, estimate)
    written = write_cameras(target(tmp_path, name), Foreign("memory", (named,)), format_name=name)
    said = {loss.what for loss in written.losses}
    holds = format_named(name).holds
    assert ("covariance" in said) is not holds.estimate
    assert ("pose" in said) is (holds.pose != "yes")
    back = read_cameras(target(tmp_path, name)).cameras[0]
    assert (back.estimate is not None) is holds.estimate
    if back.estimate is not None:
        np.testing.assert_array_equal(back.estimate.covariance, estimate.covariance)
        assert back.estimate.observations.sha256 == estimate.observations.sha256


def test_a_fit_replaces_the_lens_and_says_its_largest_error(tmp_path: Path) -> None:
    camera = Camera.from_focal((640, 480), 600.0, cx=330, lens=BrownConrady(-0.2, 0.05, 1e-3, -5e-4))
    written = write_cameras(tmp_path / "cam.dat", camera, fit=True)
    (loss,) = (loss for loss in written.losses if loss.what == "fitted lens")
    back = read_cameras(tmp_path / "cam.dat").cameras[0].camera
    assert back.lens.name == "inverse-brown-conrady"
    assert 0 < loss.px < 0.3  # five terms of the inverse follow a mild barrel to tenths of a pixel in the corners
    assert largest_difference(camera, back) <= loss.px * 1.05  # the fit looks at a finer grid


def test_visps_own_inverse_is_said_to_be_inexact(tmp_path: Path) -> None:
    camera = Camera.from_focal((640, 480), 500.0, lens=BrownConrady(-0.2))
    written = write_cameras(tmp_path / "c.xml", camera, format_name="visp")
    (loss,) = written.losses
    assert loss.what == "inverse"
    assert not loss.moves_pixels


def test_usds_floats_are_said(tmp_path: Path) -> None:
    written = write_cameras(tmp_path / "c.usda", Camera.from_focal((4000, 3000), 3333.3, cx=2011.1))
    (loss,) = written.losses
    assert loss.what == "precision"
    assert 1e-6 < loss.px < 1e-2  # 2^-24 of a few thousand px


def test_a_format_for_one_camera_asks_which(tmp_path: Path) -> None:
    camera = Camera.from_focal((640, 480), 500.0)
    posed = tuple(NamedCamera(f"v{i}", camera, Rigid(np.eye(3), [0, 0, i])) for i in range(3))
    with pytest.raises(BadValue, match=r"choose it with --camera-name NAME \(v0, v1, v2\)"):
        write_cameras(tmp_path / "c.yml", Foreign("memory", posed), format_name="opencv")
    written = write_cameras(tmp_path / "c.yaml", Foreign("memory", posed), format_name="ros")
    assert written.notes == ("the one camera of 3 poses is written, without them",)
    assert Foreign("memory", posed).named("1").cameras[0].name == "v1"
