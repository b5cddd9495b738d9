"""What a format can hold comes back from it: to 1e-9 px over the picture, poses to rounding."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.difference import difference_field, largest_difference, picture_grid
from cadcam.camera.lens import BrownConrady, Ideal
from cadcam.errors import BadValue, UnreadableFile
from cadcam.files.foreign.losses import prepared
from cadcam.files.foreign.model import Foreign, NamedCamera
from cadcam.files.foreign.registry import NAMES, format_for, format_named, format_of, read_cameras, write_cameras
from cadcam.files.foreign.source import ForeignFile
from cadcam.geometry.rigid import Rigid

from .foreign_cameras import lenses_held, random_camera, random_lenses, random_pose

every_format = pytest.mark.parametrize("name", NAMES)
UNIT = {"opencv": "in", "colmap": "m", "colmap-bin": "cm", "mrcal": "m", "nerfstudio": "m", "metashape": "ft"}


def target(folder: Path, name: str) -> Path:
    suffixes = format_named(name).suffixes
    return folder / f"{name}{suffixes[0] if suffixes else ''}"


@every_format
def test_a_camera_comes_back_to_a_billionth_of_a_pixel(tmp_path: Path, rng: np.random.Generator, name: str) -> None:
    """Numbers are written with all their digits: what is left is rounding of sums such as cx + 1/2 (1e-12 px)."""
    form = format_named(name)
    for _ in range(3):
        for lens in lenses_held(rng, form.holds):
            camera, pose = random_camera(rng, lens, holds=form.holds), random_pose(rng)
            path, unit = target(tmp_path, name), UNIT.get(name)
            written = write_cameras(path, camera, format_name=name, camera_from_world=pose, unit=unit)
            assert written.read_back_px < 1e-9
            found = read_cameras(path, unit=unit)
            assert found.format == name
            back = found.cameras[0]
            assert back.camera.size == camera.size
            q = picture_grid(camera.size, 9, 9)
            difference = difference_field(camera, back.camera, q)
            assert not np.isnan(difference).any()
            assert np.abs(difference).max() < 1e-9
            if form.holds.pose == "yes":
                assert back.camera_from_world is not None
                assert np.abs(back.camera_from_world.matrix - pose.matrix).max() < 1e-12 * 3000 * 10
            else:
                assert back.camera_from_world is None


@pytest.mark.parametrize("name", [n for n in NAMES if format_named(n).holds.several])
def test_several_cameras_keep_their_order_and_places(tmp_path: Path, rng: np.random.Generator, name: str) -> None:
    form = format_named(name)
    first = random_camera(rng, Ideal(), holds=form.holds)
    cameras = tuple(
        NamedCamera(f"view_{i}", replace(first, K=first.K @ np.diag([1 + i / 10, 1, 1])), random_pose(rng))
        for i in range(4)
    )
    path = target(tmp_path, name)
    write_cameras(path, Foreign("memory", cameras), format_name=name)
    back = read_cameras(path).cameras
    assert len(back) == 4
    for meant, found in zip(cameras, back, strict=True):
        assert largest_difference(meant.camera, found.camera) < 1e-9
    if form.holds.pose == "no":
        return
    poses = [found.camera_from_world for found in back]
    for i in range(1, 4):
        a, b, c, d = poses[i], poses[0], cameras[i].camera_from_world, cameras[0].camera_from_world
        if a is None or b is None or c is None or d is None:
            pytest.fail("a pose is missing")
        assert np.abs((a @ b.inv).matrix - (c @ d.inv).matrix).max() < 1e-8
        if form.holds.pose == "yes":
            assert np.abs(a.matrix - c.matrix).max() < 1e-8


@every_format
def test_what_is_written_is_recognised_by_its_content_alone(
    tmp_path: Path, rng: np.random.Generator, name: str
) -> None:
    form = format_named(name)
    for lens in lenses_held(rng, form.holds):
        camera = random_camera(rng, lens, holds=form.holds)
        path = target(tmp_path, name)
        write_cameras(path, camera, format_name=name, camera_from_world=random_pose(rng))
        if not form.folder:
            path = path.rename(tmp_path / "no_suffix_at_all")
        assert format_of(ForeignFile(str(path))).name == name


@every_format
def test_lenses_that_are_the_same_in_other_words_are_held_too(
    tmp_path: Path, rng: np.random.Generator, name: str
) -> None:
    form = format_named(name)
    for lens in random_lenses(rng):
        camera = random_camera(rng, lens, holds=form.holds)
        ready, losses = prepared(NamedCamera("camera", camera), form, fit=False)
        if any(loss.moves_pixels for loss in losses):
            continue
        assert largest_difference(camera, ready.camera) < 1e-9
        write_cameras(target(tmp_path, name), camera, format_name=name)
        assert largest_difference(camera, read_cameras(target(tmp_path, name)).cameras[0].camera) < 1e-9


def test_every_format_of_a_plane_holds_the_thesis_polynomial_up_to_its_terms(tmp_path: Path) -> None:
    from cadcam.camera.lens import OddRadial

    camera = Camera.from_focal((768, 576), 806.0, lens=OddRadial(0.01, -0.12, 0.05))
    for name in ("opencv", "ros", "colmap", "mrcal", "kalibr", "metashape", "nerfstudio"):
        write_cameras(target(tmp_path, name), camera, format_name=name)
        back = read_cameras(target(tmp_path, name)).cameras[0].camera
        assert isinstance(back.lens, BrownConrady)
        assert largest_difference(camera, back) < 1e-9


def test_opencv_xml_holds_what_its_yaml_holds(tmp_path: Path, rng: np.random.Generator) -> None:
    for lens in lenses_held(rng, format_named("opencv").holds):
        camera, pose = random_camera(rng, lens, holds=format_named("opencv").holds), random_pose(rng)
        write_cameras(tmp_path / "c.xml", camera, format_name="opencv", camera_from_world=pose)
        assert (tmp_path / "c.xml").read_bytes().startswith(b"<?xml")
        back = read_cameras(tmp_path / "c.xml").cameras[0]
        assert largest_difference(camera, back.camera) < 1e-9
        assert back.camera_from_world is not None
        assert np.abs(back.camera_from_world.matrix - pose.matrix).max() < 1e-9


@every_format
def test_a_pitch_of_numpy_is_a_number_too(tmp_path: Path, name: str) -> None:
    """NumPy 2 prints its own as "np.float64(0.003)": neither Blender nor USD reads that."""
    camera = Camera.from_focal((640, 480), 500.0)
    write_cameras(target(tmp_path, name), camera, format_name=name, pixel_mm=np.float64(0.003))
    assert largest_difference(camera, read_cameras(target(tmp_path, name)).cameras[0].camera) < 1e-9


def test_poses_at_half_a_turn_and_in_gimbal_lock_come_back(tmp_path: Path) -> None:
    camera = Camera.from_focal((640, 480), 500.0)
    for w in ([np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi], [0, np.pi / 2, 0], [0, -np.pi / 2, 0], [0, 0, 0]):
        pose = Rigid.exp([1.0, 2, 3, *w])
        for name in NAMES:
            if format_named(name).holds.pose == "yes":
                write_cameras(target(tmp_path, name), camera, format_name=name, camera_from_world=pose)
                back = read_cameras(target(tmp_path, name)).cameras[0].camera_from_world
                assert back is not None
                assert np.abs(back.matrix - pose.matrix).max() < 1e-9, (name, w)


def test_a_suffix_that_several_formats_share_decides_nothing(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match="--to cadcam, metashape"):
        format_for(tmp_path / "camera.yaml")
    assert format_for("camera.json").name == "cadcam"


def test_a_unit_is_refused_where_the_format_has_its_own(tmp_path: Path) -> None:
    camera = Camera.from_focal((640, 480), 500.0)
    with pytest.raises(BadValue, match="Kalibr camchain is in m by its rules"):
        write_cameras(tmp_path / "c.yaml", camera, format_name="kalibr", unit="mm")
    write_cameras(tmp_path / "c.yaml", camera, format_name="kalibr")
    with pytest.raises(BadValue, match="is in m by its rules"):
        read_cameras(tmp_path / "c.yaml", unit="mm")


def test_lengths_without_a_unit_are_said_to_be_taken_as_millimetres(tmp_path: Path) -> None:
    pose = Rigid(np.eye(3), np.array([0.0, 0, 2.5]))
    write_cameras(tmp_path / "c.yml", Camera.from_focal((64, 48), 50), format_name="opencv", camera_from_world=pose)
    found = read_cameras(tmp_path / "c.yml")
    assert "lengths are taken as mm" in found.notes[-1]
    in_metres = read_cameras(tmp_path / "c.yml", unit="m")
    assert not in_metres.notes
    assert in_metres.cameras[0].camera_from_world is not None
    assert in_metres.cameras[0].camera_from_world.translation[2] == 2500


def test_a_size_that_the_file_does_not_know_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "K.yml").write_text(
        "%YAML:1.0\nK: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 500., 0., 320., 0., 501., 240., 0., 0., 1. ]\n"
        "D: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0., 0., 0., 0., 0. ]\n"
    )
    with pytest.raises(UnreadableFile, match="no picture size; say it: --size"):
        read_cameras(tmp_path / "K.yml")
    camera = read_cameras(tmp_path / "K.yml", size=(640, 480)).cameras[0].camera
    assert camera.size == (640, 480)
    assert camera.fy == 501
