"""A part's pose goes into a file and comes back; poses in another frame or written by hand are understood."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import UnreadableFile
from cadcam.files.jsontext import parsed
from cadcam.files.matrix import pose_as_json, read_pose
from cadcam.files.pose_estimate import (
    pose_estimate_as_json,
    pose_estimate_at,
    read_part_pose,
    read_pose_by_one,
    read_pose_by_several,
    read_pose_estimate,
    read_view_pose,
    write_part_pose,
)
from cadcam.files.text import read_text
from cadcam.geometry.rigid import Rigid

POSE = Rigid.exp([10, -20, 600, 0.3, -0.2, 2.0])
CAMERA = Rigid.exp([5, 6, 70, 0.1, 0.2, 0.3])  # camera_from_world


def test_an_estimate_comes_back_to_the_last_bit(tmp_path: Path, rng: np.random.Generator) -> None:
    A = rng.normal(size=(6, 6))
    for dof, turns in ((np.inf, 0), (12.5, 1)):
        estimate = PoseEstimate(POSE, A @ A.T, np.eye(6) / 7, np.eye(6)[:, :3], dof, rng.normal(size=(6, turns)))
        write_part_pose(tmp_path / "pose.json", estimate)
        back = read_pose_estimate(tmp_path / "pose.json")
        np.testing.assert_array_equal(back.world_from_part.matrix, POSE.matrix)
        for name in ("from_noise", "from_calibration", "freedom", "dof", "undetermined"):
            np.testing.assert_array_equal(getattr(back, name), getattr(estimate, name))
        np.testing.assert_array_equal(read_part_pose(tmp_path / "pose.json").matrix, POSE.matrix)


def test_a_file_that_says_nothing_of_undetermined_turns_has_none(tmp_path: Path) -> None:
    """Files were written without it before."""
    write_part_pose(tmp_path / "pose.json", PoseEstimate(POSE, np.eye(6)))
    said = json.loads((tmp_path / "pose.json").read_text())
    assert said.pop("undetermined") is None
    (tmp_path / "pose.json").write_text(json.dumps(said))
    assert pose_estimate_at(parsed(read_text(tmp_path / "pose.json"))).undetermined.shape == (6, 0)


def test_a_covariance_that_is_none_is_refused(tmp_path: Path) -> None:
    write_part_pose(tmp_path / "pose.json", PoseEstimate(POSE, np.eye(6), np.eye(6), np.eye(6)[:, :3], 5.0))
    text = (tmp_path / "pose.json").read_text()
    given = json.loads(text)
    given["from_noise"][2][2] = -1.0
    (tmp_path / "pose.json").write_text(json.dumps(given))
    with pytest.raises(UnreadableFile, match="from_noise is no covariance"):
        pose_estimate_at(parsed(read_text(tmp_path / "pose.json")))


def rows(pose: Rigid) -> str:
    return "\n".join(" ".join(repr(float(v)) for v in row) for row in pose.matrix)


SAYINGS = {
    "as text": (f"# world_from_part, mm\n{rows(POSE)}", POSE),
    "as its inverse": (f"# part_from_world, mm\n{rows(POSE.inv)}", POSE),
    "in the camera": (f"# camera_from_part, mm\n{rows(POSE)}", CAMERA.inv @ POSE),
    "of the camera": (f"# part_from_camera, mm\n{rows(POSE.inv)}", CAMERA.inv @ POSE),
    "as for an overlay": (f"# camera_from_world, mm\n{rows(POSE)}", CAMERA.inv @ POSE),
    "as JSON": (json.dumps({"world_from_part": pose_as_json(POSE)}), POSE),
    "as a camera file": (json.dumps({"size_px": [4, 3], "camera_from_world": pose_as_json(POSE)}), CAMERA.inv @ POSE),
    "as a result": (json.dumps({"pose": pose_estimate_as_json(PoseEstimate(POSE, np.eye(6)))}), POSE),
}


@pytest.mark.parametrize("saying", SAYINGS)
def test_a_part_s_pose_is_understood_however_it_is_said(tmp_path: Path, saying: str) -> None:
    text, expected = SAYINGS[saying]
    (tmp_path / "pose").write_text(text)
    pose = read_part_pose(tmp_path / "pose", camera_from_world=CAMERA)
    np.testing.assert_allclose(pose.matrix, expected.matrix, atol=1e-12 * 600)


@pytest.mark.parametrize("saying", SAYINGS)
def test_a_view_of_the_part_is_understood_however_its_pose_is_said(tmp_path: Path, saying: str) -> None:
    """What was located can be drawn: the camera sees the part where the part's pose has it."""
    text, expected = SAYINGS[saying]
    (tmp_path / "pose").write_text(text)
    view = read_view_pose(tmp_path / "pose", camera_from_world=CAMERA)
    np.testing.assert_allclose(view.matrix, (CAMERA @ expected).matrix, atol=1e-12 * 600)
    alone = read_view_pose(tmp_path / "pose")  # the world is the camera
    np.testing.assert_allclose(alone.matrix, POSE.matrix, atol=1e-12 * 600)


def test_a_view_s_pose_that_does_not_say_which_is_refused(tmp_path: Path) -> None:
    (tmp_path / "pose").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0")
    with pytest.raises(UnreadableFile, match="such as '# camera_from_world, mm'"):
        read_view_pose(tmp_path / "pose")


@pytest.mark.parametrize("text", ["1 0 0 0\n0 1 0 0\n0 0 1 0", "{}", "# flange_from_part, mm\n1 0 0 0"])
def test_a_pose_that_does_not_say_which_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "pose").write_text(text)
    with pytest.raises(UnreadableFile, match="world_from_part"):
        read_part_pose(tmp_path / "pose")


def stated(tmp_path: Path, *places: Rigid) -> dict[str, Any]:
    """Return the document of a pose file written with cameras at these places."""
    camera = Camera.from_focal((64, 48), 60.0)
    views = [Viewpoint.exact(f"{k}.png", camera, place, sigma_px=0.1) for k, place in enumerate(places)]
    model = {"path": "part.step", "sha256": "0" * 64}
    write_part_pose(tmp_path / "pose.json", PoseEstimate(POSE, np.eye(6)), viewpoints=views, model=model)
    document: dict[str, Any] = json.loads((tmp_path / "pose.json").read_text())
    return document


def test_a_pose_file_stands_alone(tmp_path: Path) -> None:
    """Matrix, quaternion and each camera's view put a point of the part where the pose does, by the stated rules."""
    said = stated(tmp_path, Rigid(), CAMERA)
    assert (said["format"], said["version"], said["model"]["path"]) == ("cadcam pose", 1, "part.step")
    p = np.array([3.0, -4.0, 5.0])
    np.testing.assert_allclose((np.array(said["matrix"]) @ [*p, 1])[:3], POSE @ p, atol=1e-9)
    w, x, y, z = said["quaternion_wxyz"]
    turned = p + 2 * np.cross([x, y, z], np.cross([x, y, z], p) + w * p)  # v + 2 q x (q x v + w v)
    np.testing.assert_allclose(turned + POSE.translation, POSE @ p, atol=1e-9)
    for one, place in zip(said["cameras"], (Rigid(), CAMERA), strict=True):
        seen = one["camera_from_part"]
        np.testing.assert_allclose(np.array(seen["rotation"]) @ p + seen["translation_mm"], place @ (POSE @ p))
    assert "the camera that took '0.png'" in said["frames"]["world"]
    assert "not the world of its calibration" in said["frames"]["world"]
    assert "placed" in stated(tmp_path, CAMERA, CAMERA)["frames"]["world"]


@pytest.mark.parametrize("old", [False, True])
def test_the_one_camera_that_located_a_part_sees_it_there_whatever_its_own_file_says(tmp_path: Path, old: bool) -> None:
    """By one photo the world is the camera; a camera placed elsewhere, on a robot, stood where the pose file has it."""
    for place in (Rigid(), CAMERA):
        said = stated(tmp_path, place)
        if old:  # files of before do not say where cameras stood
            del said["cameras"][0]["camera_from_world"]
            (tmp_path / "pose.json").write_text(json.dumps(said))
        view = read_view_pose(tmp_path / "pose.json", camera_from_world=Rigid.exp([9, 9, 99, 1, 0, 0]))
        np.testing.assert_allclose(view.matrix, (place @ POSE).matrix, atol=1e-12 * 600)
    stated(tmp_path, Rigid(), CAMERA)  # by several: which of them is this?
    view = read_view_pose(tmp_path / "pose.json", camera_from_world=CAMERA)
    np.testing.assert_allclose(view.matrix, (CAMERA @ POSE).matrix, atol=1e-12 * 600)
    with pytest.raises(UnreadableFile, match="where this camera has no known place"):
        read_view_pose(tmp_path / "pose.json")


OTHER = Rigid.exp([9, 9, 99, 1, 0, 0])  # a place in another world


def test_a_pose_by_several_cameras_is_of_use_to_one_alone(tmp_path: Path) -> None:
    """Whose own frame is the world: by its name, before its file's pose, which may be in yet another world."""
    stated(tmp_path, CAMERA, OTHER)
    for name in ("1.png", "1"):  # of a rig's cameras the names have no suffix
        for known in (None, CAMERA):
            seen = read_pose_by_one(tmp_path / "pose.json", name, camera_from_world=known)
            np.testing.assert_allclose(seen.matrix, (OTHER @ POSE).matrix, atol=1e-12 * 600)
    seen = read_pose_by_one(tmp_path / "pose.json", "7.png", camera_from_world=CAMERA)
    np.testing.assert_allclose(seen.matrix, (CAMERA @ POSE).matrix, atol=1e-12 * 600)
    said = "in the world in which 0.png, 1.png were placed, where the camera of 7.png has no known place; give a camera"
    with pytest.raises(UnreadableFile, match=said):
        read_pose_by_one(tmp_path / "pose.json", "7.png")
    stated(tmp_path, CAMERA)  # by one, wherever it was placed
    seen = read_pose_by_one(tmp_path / "pose.json", "7.png", camera_from_world=OTHER)
    np.testing.assert_allclose(seen.matrix, (CAMERA @ POSE).matrix, atol=1e-12 * 600)


def test_a_pose_in_a_camera_of_its_own_is_of_use_to_several(tmp_path: Path) -> None:
    """If it is one of them: by its name, or as the one whose frame is theirs."""
    stated(tmp_path, Rigid())
    camera = Camera.from_focal((64, 48), 60.0)

    def world_from_part(**places: Rigid) -> Rigid:
        views = [Viewpoint.exact(f"{name}.png", camera, place, sigma_px=0.1) for name, place in places.items()]
        return read_pose_by_several(tmp_path / "pose.json", views)

    names = {"0": CAMERA, "1": Rigid()}
    np.testing.assert_allclose(world_from_part(**names).matrix, (CAMERA.inv @ POSE).matrix, atol=1e-12 * 600)
    np.testing.assert_array_equal(world_from_part(left=CAMERA, right=Rigid()).matrix, POSE.matrix)
    with pytest.raises(UnreadableFile, match=r"camera that took 0\.png, which is none of left\.png, right\.png; give"):
        world_from_part(left=CAMERA, right=OTHER)
    stated(tmp_path, CAMERA, OTHER)  # placed by their files, as these are
    np.testing.assert_array_equal(world_from_part(left=OTHER, right=CAMERA).matrix, POSE.matrix)


@pytest.mark.parametrize("count", [1, 2])
def test_a_result_says_how_its_first_camera_sees_the_part(tmp_path: Path, count: int) -> None:
    photos = [{"path": f"shots/{k}.png"} for k in range(count)]
    said = {"pose": pose_estimate_as_json(PoseEstimate(POSE, np.eye(6))), "photos": photos}
    (tmp_path / "said.json").write_text(json.dumps(said | {"camera_from_part": pose_as_json(CAMERA @ POSE)}))
    seen = read_pose_by_one(tmp_path / "said.json", "0.png")
    np.testing.assert_allclose(seen.matrix, (CAMERA @ POSE).matrix, atol=1e-12 * 600)
    if count > 1:
        with pytest.raises(UnreadableFile, match=r"where the camera of 1\.png has no known place"):
            read_pose_by_one(tmp_path / "said.json", "1.png")


@pytest.mark.parametrize("saying", SAYINGS)
def test_other_starts_are_in_the_world_of_whoever_reads_them(tmp_path: Path, saying: str) -> None:
    text, expected = SAYINGS[saying]
    (tmp_path / "pose").write_text(text)
    np.testing.assert_allclose(read_pose_by_one(tmp_path / "pose", "0.png").matrix, POSE.matrix, atol=1e-12 * 600)
    views = [Viewpoint.exact("0", Camera.from_focal((64, 48), 60.0), CAMERA, sigma_px=0.1)]
    pose = read_pose_by_several(tmp_path / "pose", views)
    np.testing.assert_allclose(pose.matrix, expected.matrix, atol=1e-12 * 600)


def test_cameras_that_see_another_pose_are_refused(tmp_path: Path) -> None:
    said = stated(tmp_path, CAMERA)
    said["cameras"][0]["camera_from_part"]["translation_mm"][0] += 0.1
    (tmp_path / "pose.json").write_text(json.dumps(said))
    with pytest.raises(UnreadableFile, match="cameras contradicts world_from_part; change both"):
        read_part_pose(tmp_path / "pose.json")


@pytest.mark.parametrize("key", ["matrix", "quaternion_wxyz"])
def test_a_pose_file_that_was_changed_in_one_place_is_refused(tmp_path: Path, key: str) -> None:
    said = stated(tmp_path, Rigid())
    if key == "matrix":
        said[key][0][3] += 0.01
    else:
        said[key] = [-q for q in said[key]]
        (tmp_path / "pose.json").write_text(json.dumps(said))
        read_part_pose(tmp_path / "pose.json")  # the same rotation
        said[key][1] += 1e-4
    (tmp_path / "pose.json").write_text(json.dumps(said))
    with pytest.raises(UnreadableFile, match=f"{key} contradicts world_from_part; change both"):
        read_part_pose(tmp_path / "pose.json")
    with pytest.raises(UnreadableFile, match=f"{key} contradicts world_from_part"):
        pose_estimate_at(parsed(read_text(tmp_path / "pose.json")))


def test_a_pose_file_of_a_newer_version_is_refused(tmp_path: Path) -> None:
    said = stated(tmp_path, Rigid())
    (tmp_path / "pose.json").write_text(json.dumps(said | {"version": 2}))
    with pytest.raises(UnreadableFile, match="has version 2"):
        read_part_pose(tmp_path / "pose.json")


def test_a_pose_file_without_these_words_is_read_as_before(tmp_path: Path) -> None:
    (tmp_path / "pose.json").write_text(json.dumps(pose_estimate_as_json(PoseEstimate(POSE, np.eye(6)))))
    np.testing.assert_array_equal(read_part_pose(tmp_path / "pose.json").matrix, POSE.matrix)
    np.testing.assert_array_equal(pose_estimate_at(parsed(read_text(tmp_path / "pose.json"))).from_noise, np.eye(6))


def test_a_part_s_pose_is_told_from_a_camera_s_and_one_without_covariance_from_an_estimate(tmp_path: Path) -> None:
    write_part_pose(tmp_path / "pose.json", PoseEstimate(POSE, np.eye(6)))
    (tmp_path / "rough.txt").write_text(f"# camera_from_part, mm\n{rows(POSE)}\n")
    (tmp_path / "rough.json").write_text(json.dumps({"world_from_part": pose_as_json(POSE)}))
    for name in ("pose.json", "rough.txt", "rough.json"):
        with pytest.raises(UnreadableFile, match=r"holds the pose of a part; cadcam\.read_part_pose reads it"):
            read_pose(tmp_path / name)
    with pytest.raises(UnreadableFile, match="does not say its format; read_part_pose reads poses without"):
        read_pose_estimate(tmp_path / "rough.json")
