"""A start of `cadcam locate` and `verify` from another run's cameras; and one near which the part is not found."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cadcam.cad.parts.shape import box
from cadcam.cad.write import write_model
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.camera.viewpoint import Viewpoint
from cadcam.files.camera import write_camera
from cadcam.files.pose_estimate import read_part_pose, write_part_pose
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look, Scene

from .job import Ran
from .locating import CAMERA, MIDDLE, MODELS, POSE, off_mm

Cadcam = Callable[..., Ran]
LOCATE = ("locate", "photo.png", str(MODELS / "bracket.stl"), "--camera", "camera.json")
START = (*LOCATE, "--start", "start.txt")


def test_a_pose_by_two_cameras_is_a_start_for_one_whose_place_is_known(cadcam: Cadcam, here: Path) -> None:
    """Alone its own frame is the world, not that in which the two were placed."""
    world_from_part = Rigid.from_rotation_vector([0, 0, 0.7], [300.0, -200, 50])
    places = [
        Rigid.look_at(MIDDLE + np.array([-200, -200, 150]), MIDDLE) @ world_from_part.inv,
        POSE @ world_from_part.inv,
    ]
    views = [Viewpoint.exact(name, CAMERA, place, sigma_px=0.1) for name, place in zip("ab", places, strict=True)]
    write_part_pose("both.json", PoseEstimate(world_from_part, np.eye(6)), viewpoints=views)
    for verb, option in (("locate", "--start"), ("verify", "--pose")):
        ran = cadcam(verb, *LOCATE[1:], option, "both.json")
        assert ran.code == 2
        assert "in the world in which a, b were placed, where the camera of photo.png has no known place" in ran.err
    write_camera("camera.json", CAMERA, camera_from_world=places[1])
    for verb, option in (("locate", "--start"), ("verify", "--pose")):
        assert cadcam(verb, *LOCATE[1:], option, "both.json").code == 0
    Path("b.png").symlink_to("photo.png")
    write_camera("camera.json", CAMERA)
    assert cadcam("locate", "b.png", *LOCATE[2:], "--start", "both.json", "--pose-out", "pose.json").code == 0
    assert off_mm(read_part_pose("pose.json")) < 0.3


def test_a_part_that_is_not_found_asks_for_the_start_and_the_restriction_too(cadcam: Cadcam, here: Path) -> None:
    write_picture("photo.png", np.random.default_rng(3).normal(0.5, 0.1, (360, 480)).clip(0, 1), bits=16)
    line = "plane:0,0,1@part"
    asked = "is it this part, this camera, not mirrored, all in view, near enough to the start"
    assert f"{asked}?" in cadcam("verify", *START[1:]).out
    assert f"{asked}, moved from there only as stated?" in cadcam(*START, "--freedom", line).err
    ran = cadcam("verify", *LOCATE[1:], "--pose", "start.txt", "--freedom", line)
    assert f"{asked}, moved from there only as stated?" in ran.out


def test_a_start_that_makes_the_part_a_few_px_large_is_said_to(cadcam: Cadcam, here: Path) -> None:
    """Millimetres written as metres: the part would be 430 km away."""
    (here / "start.txt").write_text((here / "start.txt").read_text().replace(", mm", ", m"))
    ran = cadcam(*START)
    assert ran.code == 3
    said = r"the start makes the part 0\.\d+ px large, [\de+.]+ mm from camera 'photo.png', as if in another unit"
    assert re.search(said, ran.out)
    assert "px large" in cadcam("verify", *START[1:]).out


def test_a_focal_length_in_mm_is_asked_about(cadcam: Cadcam, here: Path) -> None:
    focal = "the focal length of camera 'photo.png' is 8 px: is it in mm instead?"
    width, height = CAMERA.size
    camera = {"size_px": [width, height], "fx_px": 8, "fy_px": 8, "cx_px": width / 2, "cy_px": height / 2}
    (here / "camera.json").write_text(json.dumps(camera))
    for command in (START, LOCATE):
        ran = cadcam(*command)
        assert ran.code == 3
        assert focal in ran.out


def test_views_that_are_declared_count_whatever_pose_the_camera_s_file_has(cadcam: Cadcam, here: Path) -> None:
    write_camera("camera.json", CAMERA, camera_from_world=POSE)
    assert cadcam(*LOCATE).code == 0
    assert cadcam(*LOCATE, "--distance", "3000,4000").code == 3


def test_nobody_has_said_which_of_equal_poses_is_meant_where_the_camera_s_file_alone_has_one(
    cadcam: Cadcam, here: Path
) -> None:
    """Of a box half a turn looks the same: a start says which, the world of the camera's file does not."""
    solid = box((-60, -40, -20), (60, 40, 20), name="box")
    write_model("box.stl", solid)
    place = Rigid.look_at((300.0, -420.0, 380.0), (0.0, 0.0, 0.0))
    look = Look(supersampling=4, background=(0.9, 0.9, 0.9), back=0.35)
    view = open_renderer(Scene.of(solid)).render(CAMERA, place, channels=Channel.IMAGE, look=look)
    write_picture("box.png", view.gray)
    write_camera("camera.json", CAMERA, camera_from_world=place)
    ran = cadcam("locate", "box.png", "box.stl", "--camera", "camera.json", "--json")
    assert ran.code == 0
    assert len(ran.json["alternatives"]) == 3
    assert "3 other poses look the same" in ran.json["reason"]
