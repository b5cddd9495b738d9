"""Poses files: what is written comes back bit by bit, and what is wrong is named by line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import BadValue, UnreadableFile
from cadcam.files.matrix import pose_as_json
from cadcam.files.poses import read_poses, write_poses
from cadcam.geometry.rigid import Rigid

RNG = np.random.default_rng(8)
POSES = {name: Rigid.look_at(RNG.normal(size=3) * 500, [1, 2, 3]) for name in ("left", "a, b", "Ø 3", "#4")}
HEAD = "# camera_from_world, mm\nname, r11, r12, r13, r21, r22, r23, r31, r32, r33, tx, ty, tz\n"
ONE = "a, 1,0,0, 0,1,0, 0,0,1, 1,2,3\n"


def same(a: Rigid, b: Rigid) -> bool:
    return np.array_equal(a.rotation, b.rotation) and np.array_equal(a.translation, b.translation)


def test_poses_come_back_bit_by_bit_in_their_order(tmp_path: Path) -> None:
    write_poses(tmp_path / "p.csv", POSES)
    back = read_poses(tmp_path / "p.csv")
    assert list(back) == list(POSES)
    assert all(same(back[name], POSES[name]) for name in POSES)


def test_json_and_a_folder_hold_the_same(tmp_path: Path) -> None:
    folder = tmp_path / "poses"
    folder.mkdir()
    for name, pose in POSES.items():
        (folder / f"{name}.json").write_text(json.dumps({"camera_from_world": pose_as_json(pose)}))
    entries = [{"name": n, "camera_from_world": pose_as_json(p)} for n, p in POSES.items()]
    (tmp_path / "p.json").write_text(json.dumps({"poses": entries}))
    for path in (folder, tmp_path / "p.json"):
        back = read_poses(path)
        assert set(back) == set(POSES)
        assert all(same(back[name], POSES[name]) for name in POSES)


def test_direction_unit_and_order_of_columns_are_obeyed(tmp_path: Path) -> None:
    pose = POSES["left"].inv
    numbers = {f"r{i + 1}{j + 1}": pose.rotation[i, j] for i in range(3) for j in range(3)}
    numbers |= dict(zip(("tx", "ty", "tz"), pose.translation / 1000, strict=True))
    columns = sorted(numbers, reverse=True)
    line = " ".join(repr(float(numbers[c])) for c in columns)
    (tmp_path / "p.txt").write_text(f"# world_from_camera, m\n{' '.join(columns)}\n{line}\n")
    back = read_poses(tmp_path / "p.txt")
    assert list(back) == ["0000"]
    assert np.allclose(back["0000"].matrix, POSES["left"].matrix, atol=1e-10)  # 500 mm to and fro: 500 eps * some


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD, "holds no pose"),
        (HEAD + ONE + ONE, "names two poses 'a'"),
        (HEAD + ONE + "b, 1, 2\n", "line 4 has 3 cells"),
        (HEAD + ONE.replace("3\n", "x\n"), "line 3, tz is 'x', not a number"),
        (HEAD + ONE.replace("1,0,0,", "2,0,0,"), "line 3 is not a pose"),
        (HEAD.replace("r22", "r32") + ONE, "lacks r22"),
        (HEAD.replace("name", "nmae") + ONE, "did you mean 'name'"),
        ("# camera_from_world, mm\n" + ONE, "does not name the columns"),
        (HEAD.replace("camera_from_world, mm", "poses") + ONE, "does not say which pose it is"),
        ('{"poses": {}}', "poses is not a list"),
        ('{"poses": [{"name": "a"}]}', "poses.0 needs one pose"),
        ('{"poses": []}', "holds no pose"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(UnreadableFile, match=message):
        read_poses(tmp_path / "p.csv")


def test_an_empty_folder_and_a_name_of_two_lines_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match="holds no pose file"):
        read_poses(tmp_path)
    for name in ("", " a", "a\nb"):
        with pytest.raises(BadValue, match=r"^name is"):
            write_poses(tmp_path / "p.csv", {name: Rigid()})
