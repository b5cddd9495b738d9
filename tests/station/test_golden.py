"""Every number of chapter 6 and of programs 4 and 6 that a station must give again, to the golden tolerances."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.plane_camera import PlaneCamera
from cadcam.fit.dlt import dlt
from cadcam.station.cross_prediction import split
from cadcam.station.drawing import trend
from cadcam.station.plate import Plate, place_plate

from ..golden import assert_golden
from .programs import column_scales, rectangle_shares, rectangle_weights


def numbers(rows, *columns):
    return np.array([[float(row[c]) for c in columns] for row in rows])


@pytest.fixture
def prog4(table):
    rows = table("prog4_points")
    return numbers(rows, "X", "Y"), numbers(rows, "U", "V")


@pytest.fixture
def printed_C(golden):
    return np.array(golden("prog4.C")["printed"])


@pytest.fixture
def surveyed(table):
    """The marks as measured: the columns of Table 6.7 are interchanged."""
    return numbers(table("table_6_7"), "x_headed_Corrected", "y_headed_Corrected")


def thesis_plane(xy, UV):
    """C with C22 = 1 by linear least squares on raw numbers, as program calib."""
    H = dlt(xy, UV[:, ::-1], form="c23")
    return PlaneCamera(H).uv_matrix


def test_program_calib_s_matrix_comes_back(golden, prog4):
    assert_golden(golden("prog4.C"), thesis_plane(*prog4))


def test_the_printed_matrix_projects_as_printed(golden, prog4, printed_C):
    camera = PlaneCamera.from_uv_matrix(printed_C).facing(prog4[0])
    UV = camera.project(prog4[0])[:, ::-1]
    assert_golden(golden("prog4.uv"), UV)
    squares = float(np.sum((UV - prog4[1]) ** 2))
    assert_golden(golden("prog4.SqErr"), [squares, np.sqrt(squares / 8)])


def test_the_refitted_matrix_has_the_printed_sum_of_squares(golden, prog4):
    camera = PlaneCamera.from_uv_matrix(thesis_plane(*prog4)).facing(prog4[0])
    assert_golden(golden("prog4.SqErr_refit"), np.sum((camera.project(prog4[0])[:, ::-1] - prog4[1]) ** 2))


def test_program_calib_s_scales_are_those_of_the_matrix_columns(golden, prog4, printed_C):
    for name, C in (("prog4.scales", printed_C), ("prog4.scales_refit", thesis_plane(*prog4))):
        x, y, aspect, angle = column_scales(C)
        assert_golden(golden(name), [x, y, aspect, np.degrees(angle)])


def test_pixels_go_back_to_the_floor(golden, prog4, printed_C):
    camera = PlaneCamera.from_uv_matrix(printed_C).facing(prog4[0])
    back = camera.unproject(np.array([[393.1, 324.7], [360.0, 288.0]]))
    assert_golden(golden("prog4.inverse"), back)


def test_the_plate_is_placed_as_local2global_should_have(golden, surveyed):
    placed = place_plate(Plate.b4(), surveyed)
    assert_golden(golden("rigid.fit"), [*placed.shift, np.degrees(placed.angle), placed.rms])
    assert_golden(golden("rigid.templates"), placed.marks)


def test_the_start_of_table_6_6_is_the_first_measured_mark_unturned(golden, surveyed):
    off = Plate.b4().reflectors + surveyed[0] - surveyed
    assert_golden(golden("rigid.start"), np.sqrt(np.mean(np.sum(off**2, axis=1))))


def test_the_columns_of_table_6_7_are_interchanged(golden, table, surveyed):
    headed_monmos = numbers(table("table_6_7"), "x_headed_Monmos", "y_headed_Monmos")
    assert_golden(golden("rigid.columns"), [place_plate(Plate.b4(), m).rms for m in (headed_monmos, surveyed)])


def test_the_reflectors_distances_are_those_of_table_6_5_with_one_misprint(golden, surveyed):
    distances = np.linalg.norm(surveyed - np.roll(surveyed, -1, axis=0), axis=1)
    assert_golden(golden("rigid.distances"), distances)
    printed = np.array(golden("rigid.distances")["printed"])
    assert np.flatnonzero(np.abs(distances - printed) > 0.06).tolist() == [1], "b-c is printed 212.8 for 211.8"


def test_program_bilinear_s_shares_and_point_come_back(golden, table):
    rows = table("prog6")
    s, t = rectangle_shares((5650.0, 16335.6), (8353.6, 21617.6), (5705.4, 18762.6))
    assert_golden(golden("bilinear.st"), [s, t])
    estimates = numbers(rows, "est_x", "est_y")
    assert_golden(golden("bilinear.xy"), rectangle_weights(s, t) @ estimates)


def test_table_6_10_is_halved_differences_and_whole_sums(golden, table):
    rows = numbers(table("table_6_10"), "d1x", "d1y", "d2x", "d2y")
    found = []
    for d1x, d1y, d2x, d2y in rows:
        d = np.zeros((2, 2, 2))
        d[0, 1], d[1, 0] = (d1x, d1y), (d2x, d2y)
        found.append(np.concatenate(split(d).pair(0, 1)))
    assert_golden(golden("table6.10"), np.array(found))


def test_table_6_12_has_an_offset_and_no_scale(golden, table):
    rows = numbers(table("table_6_12"), "diff", "cad_dist")
    seen, entry = trend(rows[:, 0], rows[:, 1]), golden("table6.12")
    values = {"mean": seen.mean, "sd": seen.sd, "mean_abs": seen.mean_abs, "se": seen.standard_error, "t": seen.t}
    assert values == pytest.approx(entry["value"], abs=entry["tol"])
    assert seen.p_mean == pytest.approx(0.007, abs=5e-4)
    assert seen.correlation == pytest.approx(-0.013, abs=5e-4)
    assert seen.verdict.startswith("a constant offset")


def test_table_6_1_is_mean_and_sample_deviation(golden, table):
    rows = numbers(table("table_6_1"), "Dx", "Dy", "Dz")
    assert_golden(golden("table6.1"), [*rows.mean(axis=0), *rows.std(axis=0, ddof=1)])
