"""A pose says its direction and unit; a matrix its shape."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import BadValue, UnreadableFile
from cadcam.files.matrix import pose_as_json, read_matrix, read_pose
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

POSE = Rigid.look_at([100, 200, -900], [0, 0, 0])


def saved(folder: Path, text: str) -> Path:
    path = folder / "pose.txt"
    path.write_text(text)
    return path


def rows(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(repr(float(v)) for v in row) for row in matrix)


@pytest.mark.parametrize("height", [3, 4])
def test_direction_and_unit_are_obeyed(tmp_path: Path, height: int) -> None:
    in_m = POSE.inv.matrix.copy()
    in_m[:3, 3] /= 1000
    pose = read_pose(saved(tmp_path, f"# world_from_camera in m\n{rows(in_m[:height])}\n"))
    np.testing.assert_allclose(pose.matrix, POSE.matrix, rtol=0, atol=1e-12 * 1000)


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("", "does not say which"),
        ("# camera_from_world", "does not say which"),
        ("# mm", "does not say which"),
        ("# camera_from_world, mn", "unknown unit 'mn'"),
        ("# camera_from_world mm or m", "does not say which"),
        ("# camera_from_world, mm\n# world_from_camera, mm", "does not say which"),
    ],
)
def test_a_pose_without_direction_or_unit_is_refused(tmp_path: Path, head: str, message: str) -> None:
    with pytest.raises(UnreadableFile, match=rf"{message}.*add a first line such as"):
        read_pose(saved(tmp_path, f"{head}\n{rows(POSE.matrix)}\n"))


def test_a_pose_in_json_is_that_of_a_camera_file(tmp_path: Path) -> None:
    document = {"camera_from_world": pose_as_json(POSE)}
    np.testing.assert_array_equal(read_pose(saved(tmp_path, json.dumps(document))).matrix, POSE.matrix)
    document = {"world_from_camera": {"rotation": np.eye(3).tolist(), "translation_m": [0, 0, 1]}}
    np.testing.assert_array_equal(read_pose(saved(tmp_path, json.dumps(document))).translation, [0, 0, -1000])
    with pytest.raises(UnreadableFile, match="needs one pose"):
        read_pose(saved(tmp_path, "{}"))


@pytest.mark.parametrize("decimals", [3, 4, 6, 9])
def test_a_pose_written_with_few_decimals_is_the_nearest_exact_one(tmp_path: Path, decimals: int) -> None:
    """Nine rounded numbers turn a rotation by less than their rounding together."""
    few = "\n".join(" ".join(f"{v:.{decimals}f}" for v in row) for row in POSE.matrix)
    pose = read_pose(saved(tmp_path, f"# camera_from_world, mm\n{few}\n"))
    rounding = 0.5 * 10.0**-decimals
    assert np.linalg.norm((pose.inv @ POSE).log()[3:]) <= 3 * rounding
    assert np.abs(pose.rotation @ pose.rotation.T - np.eye(3)).max() <= so3.EXACT


@pytest.mark.parametrize("R", [np.eye(3) * 1.01, np.eye(3) + np.eye(3, k=1) * 0.01])
def test_what_no_rounding_explains_is_no_rotation(R: np.ndarray) -> None:
    with pytest.raises(BadValue, match="rotation is off a rotation by"):
        so3.written(R)
    with pytest.raises(BadValue, match="rotation matrix 2 is off"):
        so3.written(np.stack([np.eye(3), R]))


def test_a_mirror_image_is_called_one() -> None:
    with pytest.raises(BadValue, match=r"rotation is mirrored \(its determinant is negative\); expected"):
        so3.written(np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(BadValue, match=r"rotation is mirrored \(its determinant is negative\); expected"):
        Rigid(np.diag([1.0, 1.0, -1.0]), np.zeros(3))


def test_decimal_commas_are_named(tmp_path: Path) -> None:
    text = "1,0 0,0 0,0 5,5\n0,0 1,0 0,0 0,0\n0 0 1 0\n"
    with pytest.raises(UnreadableFile, match=r"line 2, number 1 is '1,0', not a number; write a decimal point"):
        read_pose(saved(tmp_path, f"# camera_from_world, mm\n{text}"))


def test_a_mirrored_pose_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match=r"is not a pose.*mirrored"):
        read_pose(saved(tmp_path, f"# camera_from_world mm\n{rows(np.diag([1.0, 1, -1, 1]))}"))


@pytest.mark.parametrize(
    "text", ["1 2\n3 4\n", "# c\n1, 2\n3, 4 # d", "[[1, 2], [3, 4]]", "[[1. 2.]\n [3. 4.]]", "1;2\r\n3;4"]
)
def test_a_matrix_is_read_in_every_usual_spelling(tmp_path: Path, text: str) -> None:
    np.testing.assert_array_equal(read_matrix(saved(tmp_path, text), rows=2, columns=2), [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2\n3 x\n", "line 2, number 2 is 'x'"),
        ("1 2\n3 nan\n", "line 2, number 2 is 'nan'"),
        ("1 2\n3\n", "has 2 rows of 2, 1 numbers; give a 2x2 matrix"),
        ("1 2 3\n", "has 1 rows of 3 numbers"),
        ("[1, 2]", "not one of rows"),
    ],
)
def test_a_wrong_matrix_is_refused_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UnreadableFile, match=message):
        read_matrix(saved(tmp_path, text), rows=2, columns=2)
