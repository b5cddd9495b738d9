"""Each correction of the thesis' section 2.3: the printed form fails on its own tables, the corrected one holds.

One test a row of the errata, "Section 2.3, 3D measuring".
"""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.extended_pinhole import uv_from_pixel_matrix
from cadcam.camera.viewpoint import KnownMotion
from cadcam.fit.dlt import dlt
from cadcam.geometry.ray import Ray


@pytest.fixture
def matrix(points):
    """Return a function giving C of one position of a table."""

    def of(name, camera):
        o = points(name, camera)
        return uv_from_pixel_matrix(dlt(o.p_world, o.q, form="c23"))

    return of


def line(C, U, V):
    """F and V of EQ 2.163 for an image point."""
    return -np.linalg.solve(C[:, :3], C[:, 3]), np.linalg.solve(C[:, :3], [U, V, 1.0])


@pytest.fixture
def lines(matrix, table):
    """The two lines of point A."""
    row = table("2_5")[0]
    return [line(matrix("2_4", i), *row[1 + 2 * i : 3 + 2 * i]) for i in (1, 2)]


def crossing(F1, V1, F2, V2):
    """EQ 2.164 put right."""
    n = np.cross(V1, V2)
    t1, t2 = (np.cross(F2 - F1, V) @ n / (n @ n) for V in (V2, V1))
    return t1, t2


def test_eq_2_164_as_printed_gives_t2_twice_with_the_wrong_sign(lines):
    (F1, V1), (F2, V2) = lines
    n = np.cross(V1, V2)
    printed_1 = V1 @ np.cross(n, F1 - F2) / (n @ n)
    printed_2 = np.cross(F2 - F1, V1) @ np.cross(V2, V1) / (n @ n)
    t1, t2 = crossing(F1, V1, F2, V2)
    assert printed_1 == pytest.approx(-t2, rel=1e-12)
    assert printed_2 == pytest.approx(-t2, rel=1e-12)
    link = (F1 + V1 * t1) - (F2 + V2 * t2)
    assert abs(link @ V1) < 1e-9 * np.linalg.norm(V1)
    assert abs(link @ V2) < 1e-9 * np.linalg.norm(V2)


def test_eq_2_164_put_right_is_the_rays_nearest_approach(lines):
    (F1, V1), (F2, V2) = lines
    t = crossing(F1, V1, F2, V2)
    middle = (F1 + V1 * t[0] + F2 + V2 * t[1]) / 2
    near = Ray(F1, V1).approach(Ray(F2, V2))
    assert near.point == pytest.approx(middle, abs=1e-8)
    assert near.along == pytest.approx([t[0] * np.linalg.norm(V1), t[1] * np.linalg.norm(V2)], rel=1e-9)


def test_eq_2_166_and_2_167_name_the_other_camera_and_lost_a_digit_and_a_sign(lines):
    (F1, V1), (F2, V2) = lines
    t1, t2 = crossing(F1, V1, F2, V2)
    assert pytest.approx([1.46, 242.36, -208.14], abs=0.01) == F1  # printed as F2
    assert pytest.approx([199.27, 489.41, -166.65], abs=0.01) == F2  # printed as F1, with 1999.27
    assert pytest.approx([-0.835, 10.168, 42.8], abs=2e-3) == V2
    assert (t2, t1) == pytest.approx((-25.487, -5.118), abs=2e-3)
    off = np.array([1999.27, 489.41, -166.65]) + V2 * t2
    assert np.linalg.norm(off - (F1 + V1 * t1)) > 1000


def test_c2_below_table_2_8_has_a_positive_c02(matrix):
    C = matrix("2_7", 2)
    assert C[0, 2] == pytest.approx(0.774, abs=1e-3)
    C[0, 2] = -0.77
    assert np.linalg.norm(-np.linalg.solve(C[:, :3], C[:, 3]) - [5.5, 204.8, -210.7]) > 50


def test_eq_2_171_t_is_where_the_camera_went_not_where_it_came_from(table_2_24, table):
    """EQ 2.169 needs F + T = F2; with the printed F1 - F2 the point comes out half a metre off."""
    one, two = (p.camera_from_world for p in table_2_24)
    R, T = two.rotation.T @ one.rotation, two.origin - one.origin
    row = table("2_8")[0]
    rays = [p.matrix for p in table_2_24]
    F1, V1 = line(rays[0], *row[3:5])
    V2 = R @ np.linalg.solve(rays[0][:, :3], [*row[5:7], 1.0])

    def point(t):
        return Ray(F1, V1).approach(Ray(F1 + t, V2)).point

    assert point(T) == pytest.approx([110, 300, -1250], abs=10)
    assert point(-T) == pytest.approx([-95, 533, 836], abs=1)
    assert KnownMotion.of_center(F1, R, T).new_from_old @ F1 == pytest.approx(two.origin, abs=1e-9)


def test_eq_2_172_takes_the_unnormalised_matrices(table_2_24):
    """R = R2^T R1; from the C23 = 1 matrices it comes out scaled by the ratio of their K23."""
    one, two = table_2_24
    R = two.camera_from_world.rotation.T @ one.camera_from_world.rotation
    from_K = np.linalg.solve(two.unnormalized_matrix[:, :3], one.unnormalized_matrix[:, :3])
    from_C = np.linalg.solve(two.matrix[:, :3], one.matrix[:, :3])
    assert from_K == pytest.approx(R, abs=1e-12)
    assert np.cbrt(np.linalg.det(from_C)) == pytest.approx(1.78, abs=0.01)


def test_the_joint_c1_printed_is_not_that_of_table_2_24(table_2_24):
    """EQ 2.173 prints -6.76 ... 91.91; the parameters of Table 2.24 give -6.57 ... 105.0: another run."""
    C = table_2_24[0].matrix
    assert C[0, 0] == pytest.approx(-6.57, abs=0.01)
    assert C[0, 3] == pytest.approx(105.0, abs=0.5)
    assert abs(C[0, 0] + 6.76) > 0.1
