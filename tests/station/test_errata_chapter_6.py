"""What chapter 6 and the appendix print wrongly, beside what is used here; docs/thesis/errata.md names these tests."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.plane_camera import PlaneCamera
from cadcam.files.shot import header_shot
from cadcam.station.cross_prediction import split
from cadcam.station.interpolation import bilinear_weights
from cadcam.station.plane import calibrate_position
from cadcam.station.plate import Plate, place_plate

from .programs import column_scales, rectangle_shares, rectangle_weights


def numbers(rows, *columns):
    return np.array([[float(row[c]) for c in columns] for row in rows])


@pytest.fixture
def position(table):
    rows = table("prog4_points")
    xy, UV = numbers(rows, "X", "Y"), numbers(rows, "U", "V")
    placement = place_plate(Plate(xy, xy[:2]), xy[:2], sigma_mm=0.2)
    return calibrate_position("Prog 4", (5680.60, 21617.60), UV[:, ::-1], placement)


def test_eq_6_2_the_last_row_is_c20_c21_1():
    """With C21 C22 1, as printed, t would not depend on C20: the plane's camera has eight numbers, C20 among them."""
    C = np.array([[1.0, 0, 0], [0, 1, 0], [0.001, 0.002, 1]])
    p = np.array([[10.0, 20.0]])
    assert PlaneCamera.from_uv_matrix(C).project(p)[0, ::-1] == pytest.approx(p[0] / (1 + 0.001 * 10 + 0.002 * 20))


def test_eq_6_9_inverts_eq_6_2(position):
    """The text below EQ 6.10 calls it EQ 2.5."""
    C, (U, V) = position.world_camera.uv_matrix, (324.7, 393.1)
    a0, b0, c0 = C[0] - U * C[2]
    a1, b1, c1 = C[1] - V * C[2]
    x, y = (b0 * c1 - b1 * c0) / (a0 * b1 - a1 * b0), (a1 * c0 - a0 * c1) / (a0 * b1 - a1 * b0)
    assert position.world_camera.unproject(np.array([V, U])) == pytest.approx([x, y], rel=1e-9)


def test_section_6_3_4_the_columns_give_the_scale_only_where_t_is_one(position):
    """At the optimum they give 1.123 and 1.027 mm/px, and 1.290 and 1.182 are right, 3 mm/px (6.3.3) for neither."""
    assert column_scales(position.world_camera.uv_matrix)[:2] == pytest.approx([1.123, 1.027], abs=5e-4)
    assert (position.scale.scale_x, position.scale.scale_y) == pytest.approx((1.290, 1.182), abs=5e-4)


def test_section_6_3_4_the_scale_printed_is_the_reciprocal_of_the_formula(table):
    printed = {row["name"]: float(row["value"]) for row in table("prog4_results")}
    C = np.array([[printed[f"C{i}{j}"] for j in range(3)] for i in range(3)])
    assert column_scales(C)[0] == pytest.approx(printed["scale_x"], abs=1e-5)
    assert np.hypot(C[0, 0], C[1, 0]) == pytest.approx(1 / printed["scale_x"], rel=1e-5)


def test_prog_4_the_skew_is_a_hundredth_of_a_degree_not_ninety(position):
    assert np.degrees(position.scale.skew) == pytest.approx(-0.0105, abs=5e-4)


def test_section_6_3_3_the_aspect_is_that_of_pal_pixels(position):
    """The grabber's 1.09 was no accident: 12/11 (or 59/54), the pixels of BT.601, to a thousandth."""
    assert position.scale.aspect == pytest.approx(12 / 11, abs=1e-3)


def test_table_6_6_the_descent_had_not_converged(table):
    measured = numbers(table("table_6_7"), "x_headed_Corrected", "y_headed_Corrected")
    assert place_plate(Plate.b4(), measured).rms == pytest.approx(0.502, abs=5e-4)  # printed 0.55


def test_section_6_4_3_6_the_pair_of_positions_b_and_d_differs_by_one_to_two_millimetres_in_x():
    d = np.zeros((2, 2, 2))
    d[0, 1], d[1, 0] = (2, 13), (-1, -14)
    total, camera = split(d).pair(0, 1)
    assert total == pytest.approx([1.5, 13.5])
    assert camera == pytest.approx([1, 1])


def test_section_6_4_3_6_one_measurement_of_table_6_11_errs_by_half_a_pixel(table_6_11):
    found = split(table_6_11[1])
    assert found.pairs == 105
    assert found.vision == pytest.approx([0.59, 0.48], abs=5e-3)
    assert found.worst == pytest.approx(22.8, abs=0.1)


def test_prog_6_interpolates_in_an_upright_rectangle_not_by_eq_6_13(table):
    rows = table("prog6")
    corners, estimates = numbers(rows, "cal_x", "cal_y"), numbers(rows, "est_x", "est_y")
    at = np.array([5705.4, 18762.6])
    weights = bilinear_weights(corners, at)
    assert weights is not None
    s, t = rectangle_shares(corners[0], (8353.6, 21617.6), at)
    off = weights @ estimates - rectangle_weights(s, t) @ estimates
    assert 0.01 < np.linalg.norm(off) < 0.03


def test_prog_3_the_size_is_720_575(tmp_path):
    """Printed 720575; the header's comment is read either way."""
    picture = tmp_path / "camera.pgm"
    comment = b"#Camera pos: 8175.40 21616.90 # grab: Fri. Jul 21 09:28:08 1995?\n"
    picture.write_bytes(b"P5\n" + comment + b"720 575\n255\n" + bytes(720 * 575))
    shot = header_shot(picture)
    assert shot is not None
    assert (shot.x, shot.y) == (8175.40, 21616.90)
    assert shot.time is not None
    assert shot.time.isoformat() == "1995-07-21T09:28:08+00:00"
