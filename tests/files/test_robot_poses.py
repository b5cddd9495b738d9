"""Robot poses: every maker's convention against its definition, every layout, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import BadValue, CadcamError, UnknownName, UnreadableFile
from cadcam.files.robot_conventions import CONVENTIONS, robot_numbers, robot_poses
from cadcam.files.robot_poses import read_robot_numbers, read_robot_poses
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

SIX = [100.0, -200.0, 300.0, 30.0, -40.0, 125.0]


def about(axis, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


# from the definitions: turning axes (Z-Y'-X'') multiply on the right, fixed axes (X, Y, Z) on the left
ANGLES = {
    "kuka": about("z", 30) @ about("y", -40) @ about("x", 125),
    "fanuc": about("z", 125) @ about("y", -40) @ about("x", 30),
    "yaskawa": about("z", 125) @ about("y", -40) @ about("x", 30),
    "staubli": about("x", 30) @ about("y", -40) @ about("z", 125),
    "kawasaki": about("z", 30) @ about("y", -40) @ about("z", 125),
}


def one(folder, text, convention, **options):
    (folder / "robot.txt").write_text(text)
    return next(iter(read_robot_poses(folder / "robot.txt", convention=convention, **options).values()))


@pytest.mark.parametrize("convention", ANGLES)
def test_three_angles_are_read_as_their_maker_defines_them(tmp_path, convention):
    pose = one(tmp_path, " ".join(map(str, SIX)), convention)
    np.testing.assert_allclose(pose.rotation, ANGLES[convention], atol=1e-15)
    np.testing.assert_array_equal(pose.translation, SIX[:3])


@pytest.mark.parametrize(
    ("convention", "cells"),
    [
        ("abb", "100 200 300 0.5 0.1 -0.7 0.5"),
        ("quaternion-wxyz", "100 200 300 0.5 0.1 -0.7 0.5"),
        ("quaternion-xyzw", "100 200 300 0.1 -0.7 0.5 0.5"),
        ("ros", "0.1 0.2 0.3 0.1 -0.7 0.5 0.5"),
    ],
)
def test_a_quaternion_has_w_where_the_convention_says(tmp_path, convention, cells):
    pose = one(tmp_path, cells, convention, unit=None if CONVENTIONS[convention].unit else "mm")
    np.testing.assert_allclose(pose.rotation, so3.from_quaternion([0.5, 0.1, -0.7, 0.5]), atol=1e-15)
    np.testing.assert_allclose(pose.translation, [100, 200, 300], rtol=1e-15)


def test_a_rotation_vector_is_in_rad_and_its_position_in_metres_by_universal_robots(tmp_path):
    pose = one(tmp_path, "0.1, 0.2, 0.3, 0.3, -1.2, 2.0", "ur")
    np.testing.assert_allclose(pose.rotation, so3.exp([0.3, -1.2, 2.0]), atol=1e-15)
    np.testing.assert_allclose(pose.translation, [100, 200, 300], rtol=1e-15)
    in_mm = one(tmp_path, "0.1, 0.2, 0.3, 0.3, -1.2, 2.0", "rotation-vector", unit="m")
    np.testing.assert_array_equal(in_mm.matrix, pose.matrix)


def test_a_matrix_comes_in_twelve_or_sixteen_numbers_and_may_be_rounded(tmp_path):
    R = so3.exp([0.3, -1.2, 2.0])
    rows = np.column_stack([R, [100, 200, 300]])
    text = " ".join(f"{v:.4f}" for v in rows.ravel())
    for tail in ("", " 0 0 0 1"):
        pose = one(tmp_path, text + tail, "matrix", unit="mm")
        np.testing.assert_allclose(pose.rotation, R, atol=1e-4)
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-14)


def test_inverted_poses_are_turned_round(tmp_path):
    text = " ".join(map(str, SIX))
    there, back = one(tmp_path, text, "kuka"), one(tmp_path, text, "kuka", inverted=True)
    np.testing.assert_allclose((there @ back).matrix, np.eye(4), atol=1e-12)


LAYOUTS = {
    "bare.txt": "1 2 3 10 20 30\n4 5 6 40 50 60\n",
    "comma.csv": "# shift\n1, 2, 3, 10, 20, 30\n4, 5, 6, 40, 50, 60\n",
    "named.csv": "left;1;2;3;10;20;30\nright;4;5;6;40;50;60\n",
    "header.csv": "name,X_mm,Y_mm,Z_mm,A_deg,B,C\nleft,1,2,3,10,20,30\nright,4,5,6,40,50,60\n",
    "swapped.csv": "A,B,C,X,Y,Z,name\n10,20,30,1,2,3,left\n40,50,60,4,5,6,right\n",
    "metres.csv": "name\tx [m]\ty [m]\tz [m]\ta\tb\tc\n"
    "left\t.001\t.002\t.003\t10\t20\t30\nright\t.004\t.005\t.006\t40\t50\t60\n",
    "list.json": "[[1, 2, 3, 10, 20, 30], [4, 5, 6, 40, 50, 60]]",
    "names.json": '{"left": [1, 2, 3, 10, 20, 30], "right": [4, 5, 6, 40, 50, 60]}',
    "poses.json": '{"poses": [{"name":"left","pose":[1,2,3,10,20,30]}, {"name":"right","pose":[4,5,6,40,50,60]}]}',
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_gives_the_same_poses(tmp_path, name):
    (tmp_path / name).write_text(LAYOUTS[name])
    poses = read_robot_poses(tmp_path / name, convention="kuka")
    assert list(poses) == (["1", "2"] if name in ("bare.txt", "comma.csv", "list.json") else ["left", "right"])
    first, second = poses.values()
    np.testing.assert_allclose(first.translation, [1, 2, 3], rtol=1e-14)
    np.testing.assert_allclose(second.rotation, about("z", 40) @ about("y", 50) @ about("x", 60), atol=1e-15)


def test_matrices_in_json_come_as_rows(tmp_path):
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = so3.exp([0.1, 0.2, 0.3]), [1, 2, 3]
    (tmp_path / "robot.json").write_text(json.dumps([M.tolist(), M[:3].tolist()]))
    poses = read_robot_poses(tmp_path / "robot.json", convention="matrix", unit="m")
    for pose in poses.values():
        np.testing.assert_allclose(pose.translation, [1000, 2000, 3000])


def test_a_folder_of_yaml_matrices_is_read_by_number(tmp_path):
    """As ViSP writes them: pose_2 before pose_10."""
    for i in (10, 2):
        data = "\n".join(f"  - [{v}]" for v in (0.1 * i, 0.2, 0.3, 0.01, -0.02, 3.0))
        (tmp_path / f"pose_{i}.yaml").write_text(f"rows: 6\ncols: 1\ndata: \n{data}\n")
    poses = read_robot_poses(tmp_path, convention="ur")
    assert list(poses) == ["pose_2", "pose_10"]
    np.testing.assert_allclose(poses["pose_10"].translation, [1000, 200, 300], rtol=1e-14)
    np.testing.assert_allclose(poses["pose_2"].rotation, so3.exp([0.01, -0.02, 3.0]), atol=1e-15)


def test_the_real_franka_poses_are_read(shared):
    folder = shared("data/visp_franka_eye_in_hand")
    numbers = read_robot_numbers(folder / "franka_pose_rPe_1.yaml")
    assert numbers.numbers.shape == (1, 6)
    assert numbers.numbers[0, 0] == 0.335091


BAD = {
    "empty.txt": ("", "is empty"),
    "comment.txt": ("# nothing\n", "only comments"),
    "heads.csv": ("x,y,z,a,b,c\n", "column names but no poses"),
    "short.txt": ("1 2 3 4 5 6\n1 2 3 4 5\n", "line 2 has 5 cells"),
    "word.txt": ("1 2 3 4 5 6\n1 2 3 4 five 6\n", "line 2, cell 5 is 'five'"),
    "nan.txt": ("1 2 3 4 5 nan\n", "give a finite number"),
    "seven.txt": ("1 2 3 4 5 6 7\n", "7 numbers a pose; kuka is x y z a b c .* abb"),
    "columns.csv": ("x,y,z,w,p,r\n1,2,3,4,5,6\n", "columns x, y, z, w, p, r; kuka is x y z a b c .* fanuc would fit"),
    "units.csv": ("x_mm,y_m,z_mm,a,b,c\n1,2,3,4,5,6\n", "names positions in m and mm at once"),
    "angles.csv": ("x,y,z,a_deg,b_rad,c_deg\n1,2,3,4,5,6\n", "names angles in deg and rad at once"),
    "rad.csv": ("x,y,z,a_rad,b_rad,c_rad\n1,2,3,4,5,6\n", r"angles are in rad; kuka has deg \(A about Z"),
    "twice.csv": ("a,1,2,3,4,5,6\na,1,2,3,4,5,7\n", "names two poses 'a'"),
    "cut.json": ("[[1, 2", "is not JSON"),
    "huge.json": (f"[[1, 2, 3, 4, 5, 1{'0' * 400}]]", "pose '1' is"),
    "text.json": ('["a", "b"]', "pose '1' is"),
    "uneven.json": ("[[1,2,3,4,5,6],[1,2,3]]", r"poses of \[3, 6\] numbers"),
    "none.json": ("[]", "holds no poses"),
    "map.yaml": ("a: 1\n", "is not a YAML matrix"),
    "few.yaml": ("rows: 6\ncols: 1\ndata: [1, 2, 3]\n", "has 3 numbers in data"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_with_its_place(tmp_path, name):
    text, match = BAD[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(UnreadableFile, match=match) as caught:
        read_robot_poses(tmp_path / name, convention="kuka")
    assert name in str(caught.value)


def test_conventions_units_and_rotations_are_checked(tmp_path):
    (tmp_path / "q.txt").write_text("1 2 3 1 0 0 0\n")
    with pytest.raises(UnknownName, match="did you mean 'kuka'"):
        read_robot_poses(tmp_path / "q.txt", convention="kuca")
    with pytest.raises(UnreadableFile, match="unit of the robot's positions"):
        read_robot_poses(tmp_path / "q.txt", convention="quaternion-wxyz")
    (tmp_path / "zero.txt").write_text("1 2 3 0 0 0 0\n")
    with pytest.raises(UnreadableFile, match="not all zero"):
        read_robot_poses(tmp_path / "zero.txt", convention="abb")
    (tmp_path / "skew.txt").write_text("1 0.1 0 0  0 1 0 0  0 0 1 0\n")
    with pytest.raises(UnreadableFile, match="rotation matrix 1 is off a rotation by"):
        read_robot_poses(tmp_path / "skew.txt", convention="matrix", unit="mm")
    (tmp_path / "columns.txt").write_text("1 0 0 0  0 1 0 0  0 0 1 0  5 6 7 1\n")
    with pytest.raises(UnreadableFile, match="last row of matrix 1 is"):
        read_robot_poses(tmp_path / "columns.txt", convention="matrix", unit="mm")
    (tmp_path / "m.csv").write_text("x_m,y_m,z_m,a,b,c\n1,2,3,4,5,6\n")
    with pytest.raises(UnreadableFile, match="says its positions are in m"):
        read_robot_poses(tmp_path / "m.csv", convention="kuka", unit="mm")


def test_a_folder_without_poses_or_with_uneven_ones_is_refused(tmp_path):
    with pytest.raises(UnreadableFile, match="holds no pose file"):
        read_robot_poses(tmp_path, convention="kuka")
    (tmp_path / "a.txt").write_text("1 2 3 4 5 6\n")
    (tmp_path / "b.txt").write_text("1 2 3 4 5 6\n1 2 3 4 5 7\n")
    with pytest.raises(UnreadableFile, match="holds 2 poses of 6 numbers"):
        read_robot_poses(tmp_path, convention="kuka")


def test_degrees_are_not_read_as_a_rotation_vector_in_rad(tmp_path):
    """Universal Robots' columns have the names of Yaskawa's and Staubli's: the unit tells which they are not."""
    (tmp_path / "deg.csv").write_text("x_mm,y_mm,z_mm,rx [deg],ry [deg],rz [deg]\n1,2,3,0,0,90\n")
    with pytest.raises(UnreadableFile, match="angles are in deg; ur has rad"):
        read_robot_poses(tmp_path / "deg.csv", convention="ur")
    assert read_robot_numbers(tmp_path / "deg.csv").possible == ("yaskawa", "staubli")


def test_the_files_of_a_folder_are_read_by_their_column_names(tmp_path):
    for i in (1, 2):
        (tmp_path / f"pose_{i}.csv").write_text(f"A,B,C,X_m,Y_m,Z_m\n{10 * i},20,30,0.1,0.2,0.3\n")
    poses = read_robot_poses(tmp_path, convention="kuka")
    np.testing.assert_allclose(poses["pose_2"].translation, [100, 200, 300])
    np.testing.assert_allclose(poses["pose_2"].rotation, about("z", 20) @ about("y", 20) @ about("x", 30), atol=1e-15)
    (tmp_path / "pose_3.csv").write_text("X_m,Y_m,Z_m,A,B,C\n0.1,0.2,0.3,10,20,30\n")
    with pytest.raises(UnreadableFile, match=r"pose_3\.csv: names other columns or units; the same in each file"):
        read_robot_poses(tmp_path, convention="kuka")


def test_no_damage_to_a_file_escapes_as_another_error(tmp_path: Path, rng):
    """Bytes changed, lines cut: a pose or a `CadcamError`, never anything else."""
    for name, text in LAYOUTS.items():
        for _ in range(60):
            data = bytearray(text.encode())
            for _ in range(int(rng.integers(1, 4))):
                data[rng.integers(len(data))] = rng.choice(list(b'0,;. \n"[]{}e-xN\xff'))
            (tmp_path / name).write_bytes(bytes(data[: rng.integers(1, len(data) + 1)]))
            try:
                read_robot_poses(tmp_path / name, convention="kuka")
            except CadcamError:
                continue


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_pose_is_written_as_it_is_read(convention: str, rng: np.random.Generator) -> None:
    """Many poses and one; the numbers themselves come back for angles that are the usual ones."""
    poses = Rigid(Rigid.exp(rng.normal(size=(20, 6))).rotation, rng.uniform(-900, 900, (20, 3)))
    unit = None if CONVENTIONS[convention].unit else "m"
    numbers = robot_numbers(poses, convention=convention, unit=unit)
    assert numbers.shape == (20, len(CONVENTIONS[convention].columns))
    assert np.allclose(robot_poses(numbers, convention=convention, unit=unit).matrix, poses.matrix, atol=1e-9)
    one = robot_numbers(poses[3], convention=convention, unit=unit)
    assert np.array_equal(one, numbers[3])
    assert np.allclose(robot_poses(list(one), convention=convention, unit=unit).matrix, poses[3].matrix, atol=1e-9)


@pytest.mark.parametrize(
    ("convention", "angles"),
    [
        ("kuka", (30, 90, 0)),
        ("kuka", (30, -90, 0)),
        ("fanuc", (0, 90, 30)),
        ("staubli", (30, 90, 0)),
        ("kawasaki", (30, 0, 0)),
    ],
)
def test_where_two_axes_coincide_the_pose_is_still_the_same(convention: str, angles: tuple[float, ...]) -> None:
    pose = robot_poses([1, 2, 3, *angles], convention=convention)
    again = robot_poses(robot_numbers(pose, convention=convention), convention=convention)
    assert np.allclose(again.matrix, pose.matrix, atol=1e-7)


def test_a_kuka_pose_in_numbers_is_that_of_its_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("X,Y,Z,A,B,C\n100,200,300,10,20,30\n")
    read = read_robot_poses(tmp_path / "a.csv", convention="kuka")["1"]
    assert np.array_equal(robot_poses([100, 200, 300, 10, 20, 30], convention="kuka").matrix, read.matrix)
    assert np.allclose(robot_numbers(read, convention="kuka"), [100, 200, 300, 10, 20, 30], atol=1e-12)


def test_numbers_that_do_not_fit_the_convention_are_refused() -> None:
    with pytest.raises(BadValue, match=r"kuka numbers \(x y z a b c\) is of shape \(7,\)"):
        robot_poses(np.zeros(7), convention="kuka")
    with pytest.raises(UnknownName, match=r"unknown robot pose convention 'KUKA'.*known: abb"):
        robot_poses(np.zeros(6), convention="KUKA")
    with pytest.raises(BadValue, match="unit of the robot's positions is not stated"):
        robot_numbers(Rigid(), convention="rotation-vector")
    with pytest.raises(BadValue, match="poses is an array"):
        robot_numbers(np.eye(4), convention="kuka")
