"""golden.json's values of section 2.3: points measured with fixed cameras and with a moved one."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.measure.points import measure_points
from cadcam.camera.extended_pinhole import ExtendedPinhole, pixels_from_uv, uv_from_pixel_matrix
from cadcam.camera.viewpoint import KnownMotion, Viewpoint
from cadcam.fit.dlt import dlt
from cadcam.geometry.ray import Ray
from cadcam.geometry.rigid import Rigid

from ..golden import assert_golden


@pytest.fixture
def fixed(points, size):
    """Return a function giving the viewpoints of two positions by the thesis' own linear transform."""

    def of(name):
        pinholes = []
        for camera in (1, 2):
            o = points(name, camera)
            pinholes.append(ExtendedPinhole.from_matrix(uv_from_pixel_matrix(dlt(o.p_world, o.q, form="c23"))))
        return [
            Viewpoint.exact(f"pos {i}", p.camera(size), p.camera_from_world, sigma_px=0.5)
            for i, p in enumerate(pinholes, 1)
        ]

    return of


def pixels(row):
    return pixels_from_uv(np.reshape(row[3:7], (2, 2)))[:, None]


@pytest.mark.parametrize(("point", "row"), [("A", 0), ("B", 1)])
def test_two_fixed_cameras_measure_the_points_of_table_2_6(golden, fixed, table, point, row):
    measured = measure_points(fixed("2_4"), pixels(table("2_5")[row]), method="rays")
    assert_golden(golden(f"fixed.point_{point}"), measured.points[0])
    gap = {"A": 0.212, "B": 0.098}[point]  # golden.json's notes
    assert measured.gap[0] == pytest.approx(gap, abs=5e-4)


@pytest.mark.parametrize(("point", "row"), [("A", 0), ("B", 1)])
def test_the_crossing_values_are_those_of_eq_2_167_with_their_sign(golden, fixed, table, points, point, row):
    """The thesis counts t in lengths of V = M^-1 (U, V, 1), which points backwards here (K23 < 0)."""
    rays, lengths = [], []
    for view, (camera, q) in zip(fixed("2_4"), enumerate(pixels(table("2_5")[row]), 1), strict=True):
        o = points("2_4", camera)
        M = uv_from_pixel_matrix(dlt(o.p_world, o.q, form="c23"))[:, :3]
        V = np.linalg.solve(M, [q[0, 1], q[0, 0], 1.0])
        ray = view.rays(q)
        lengths.append(np.linalg.norm(V) * np.sign(V @ ray.direction[0]))
        rays.append(Ray(ray.origin[0], ray.direction[0]))
    t = rays[0].approach(rays[1]).along / lengths
    assert_golden(golden(f"fixed.t_{point}"), t[::-1])


def test_independent_calibrations_of_one_camera_give_table_2_10(golden, fixed, table):
    measured = measure_points(fixed("2_7"), pixels(table("2_8")[0]), method="rays")
    assert_golden(golden("movable.point_independent"), measured.points[0])


def test_the_motion_of_eq_2_171_and_2_172_comes_from_the_two_positions(golden, table_2_24):
    one, two = (p.camera_from_world for p in table_2_24)
    assert_golden(golden("RT.R"), two.rotation.T @ one.rotation)
    assert_golden(golden("RT.T"), two.origin - one.origin)


def test_a_camera_moved_by_eq_2_170_measures_the_point_of_table_2_12(golden, table_2_24, table, size):
    one, two = (p.camera_from_world for p in table_2_24)
    motion = KnownMotion.of_center(one.origin, two.rotation.T @ one.rotation, two.origin - one.origin)
    camera = table_2_24[0].camera(size)
    moved = one @ motion.new_from_old.inv
    views = [
        Viewpoint.exact("home", camera, one, sigma_px=0.5),
        Viewpoint.exact("moved", camera, moved, sigma_px=0.5),
    ]
    assert moved.matrix == pytest.approx(two.matrix, abs=1e-11)
    measured = measure_points(views, pixels(table("2_8")[0]), method="rays")
    assert_golden(golden("RT.point"), measured.points[0])


def test_the_printed_matrices_taken_literally_give_their_own_point(golden, table):
    """EQ 2.173-2.176 with three digits; R and T as printed but T's sign, which puts the point 100 mm off."""
    minv = np.array([[-0.153, -0.007, 30.97], [0.002, -0.151, 72.33], [-0.026, 0.029, 119.80]])
    R = np.array([[0.998, -0.055, 0.006], [0.054, 0.947, -0.317], [0.012, 0.317, 0.948]])
    F1, F2 = np.array([7.8, 416.4, -211.7]), np.array([5.0, 205.2, -205.0])
    V1, V2 = minv @ [263.9, 390.2, 1], R @ minv @ [263.9, 287.2, 1]
    point = Ray(F1, V1).approach(Ray(F2, V2)).point
    assert_golden(golden("RT.point_printed_matrices"), point)


def test_the_joint_matrix_of_position_2_is_the_one_of_table_2_24(golden, table_2_24):
    assert_golden(golden("joint.C2"), table_2_24[1].matrix)


def test_a_motion_is_about_the_world_and_of_centre_about_the_camera():
    """Rigid(R, F + T - R F) takes the focal centre F to F + T and turns by R."""
    F, T = np.array([10.0, 20, 30]), np.array([1.0, -2, 3])
    R = Rigid.exp([0, 0, 0, 0.1, 0.2, -0.3]).rotation
    motion = KnownMotion.of_center(F, R, T).new_from_old
    assert motion @ F == pytest.approx(F + T, abs=1e-13)
    assert motion.rotation == pytest.approx(R)
