"""golden.json's values of the 2D-1D camera (section 2.1) and of the 2D-2D one (Prog 4), with their own tolerances."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.points.flat import calibrate_line, calibrate_plane
from cadcam.camera.line_camera import LineCamera, LineObservations
from cadcam.camera.observations import Observations
from cadcam.camera.plane_camera import PlaneCamera
from cadcam.fit.dlt import dlt

from ..golden import assert_golden


@pytest.fixture
def line(table):
    """Table 2.1."""
    rows = table("2_1")
    return LineObservations(rows[:, :2], rows[:, 2])


@pytest.fixture
def C(line):
    return dlt(line.p_world, line.U[:, None], form="c23")


@pytest.fixture
def plate(shared):
    """The eight marks of Prog 4, X Y mm, U V px."""
    lines = shared("thesis/tables/prog4_points.csv").read_text().splitlines()
    rows = np.array([[float(x) for x in line.split(",")] for line in lines if line[:1].isdigit()])
    return Observations.from_uv(np.column_stack([rows[:, :2], np.zeros(len(rows))]), rows[:, 2:4])


@pytest.fixture
def printed(shared):
    """The matrix as Prog 4 prints it."""
    lines = shared("thesis/tables/prog4_results.csv").read_text().splitlines()
    values = [float(line.split(",")[1]) for line in lines if line.startswith("C") and line[1].isdigit()]
    return PlaneCamera.from_uv_matrix(np.reshape(values, (3, 3)))


def test_the_line_camera_s_matrix_is_eq_2_10(golden, C):
    tolerance = np.full((2, 3), golden("2d1d.C")["tol"])
    tolerance[0, 2] = 1e-5
    assert np.all(np.abs(C - golden("2d1d.C")["value"]) <= tolerance)


def test_the_line_camera_s_parameters_are_those_of_section_2_1_3(golden, C):
    camera = LineCamera.from_matrix(C)
    assert_golden(golden("2d1d.F"), camera.center)
    assert_golden(golden("2d1d.U0"), camera.U0)
    assert_golden(golden("2d1d.alpha"), np.degrees(camera.alpha))
    assert_golden(golden("2d1d.focal"), abs(camera.focal))
    assert_golden(golden("2d1d.Minv"), np.linalg.inv(C[:, :2]))
    assert_golden(golden("2d1d.compose"), camera.matrix)


def test_table_2_2_comes_out_of_the_matrix(golden, C, line):
    u = np.column_stack([line.p_world, np.ones(len(line))]) @ C.T
    assert_golden(golden("2d1d.table2.2"), np.column_stack([u, u[:, 0] / u[:, 1]]))


def test_least_squares_gives_the_figure_s_camera_looking_at_its_points(golden, line):
    """Fig 2-3: F = (6, 2), the focal line at atan(1/2), 10 sqrt(80) px; Table 2.1 is exact to 1e-8 px."""
    estimate = calibrate_line(line)
    looks = -estimate.camera.rotation[1]
    assert estimate.camera.center == pytest.approx([6, 2], abs=1e-7)
    assert np.arctan2(looks[1], looks[0]) == pytest.approx(np.arctan(0.5), abs=1e-9)
    assert estimate.camera.focal == pytest.approx(-10 * np.sqrt(80), abs=1e-6)
    assert estimate.thesis_residual < 1e-7
    assert (estimate.camera.depth(line.p_world) > 0).all()


def test_the_plate_s_matrix_is_that_of_prog_4(golden, plate, printed):
    P = dlt(plate.p_world[:, :2], plate.q, form="c23")
    camera = PlaneCamera(P)
    assert_golden(golden("prog4.C"), camera.uv_matrix)
    misfit = np.sum((camera.project(plate.p_world[:, :2]) - plate.q) ** 2)
    assert_golden(golden("prog4.SqErr_refit"), misfit)
    assert_golden(golden("prog4.scales_refit"), scales(camera))


def test_the_printed_matrix_gives_the_printed_image_points(golden, plate, printed):
    q = printed.project(plate.p_world[:, :2])
    assert_golden(golden("prog4.uv"), q[:, ::-1])
    misfit = np.sum((q - plate.q) ** 2)
    assert_golden(golden("prog4.SqErr"), [misfit, np.sqrt(misfit / len(plate))])
    assert_golden(golden("prog4.scales"), scales(printed))


def test_the_equations_of_radiation_invert_the_printed_matrix(golden, printed):
    assert_golden(golden("prog4.inverse"), printed.unproject([[393.1, 324.7], [360.0, 288.0]]))


def scales(camera):
    """Prog 4's mm/px along both axes, their ratio and the angle between the matrix' columns in degrees."""
    C = camera.uv_matrix
    x, y = C[:2, 0], C[:2, 1]
    lengths = np.linalg.norm(x), np.linalg.norm(y)
    angle = np.degrees(np.arccos(abs(x @ y) / (lengths[0] * lengths[1])))
    return [1 / lengths[0], 1 / lengths[1], lengths[1] / lengths[0], 180 - angle]


def test_reprojection_least_squares_fits_the_plate_better_than_prog_4(plate, golden):
    estimate = calibrate_plane(plate)
    assert estimate.sum_of_squares < 0.9 * golden("prog4.SqErr")["value"][0]
    assert estimate.dof == 8
