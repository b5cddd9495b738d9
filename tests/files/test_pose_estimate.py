"""A part's pose goes into a file and comes back; poses in another frame or written by hand are understood."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import UnreadableFile
from cadcam.files.jsontext import parsed
from cadcam.files.matrix import pose_as_json
from cadcam.files.pose_estimate import (
    pose_estimate_as_json,
    pose_estimate_at,
    read_part_pose,
    read_view_pose,
    write_part_pose,
)
from cadcam.files.text import read_text
from cadcam.geometry.rigid import Rigid

POSE = Rigid.exp([10, -20, 600, 0.3, -0.2, 2.0])
CAMERA = Rigid.exp([5, 6, 70, 0.1, 0.2, 0.3])  # camera_from_world


def test_an_estimate_comes_back_to_the_last_bit(tmp_path: Path, rng: np.random.Generator) -> None:
    A = rng.normal(size=(6, 6))
    for dof in (np.inf, 12.5):
        estimate = PoseEstimate(POSE, A @ A.T, np.eye(6) / 7, np.eye(6)[:, :3], dof)
        write_part_pose(tmp_path / "pose.json", estimate)
        back = pose_estimate_at(parsed(read_text(tmp_path / "pose.json")))
        np.testing.assert_array_equal(back.world_from_part.matrix, POSE.matrix)
        for name in ("from_noise", "from_calibration", "freedom", "dof"):
            np.testing.assert_array_equal(getattr(back, name), getattr(estimate, name))
        np.testing.assert_array_equal(read_part_pose(tmp_path / "pose.json").matrix, POSE.matrix)


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
