"""Each correction of the thesis' section 2.1: the printed form fails on its own example, the corrected one holds.

One test a row of the errata, "Section 2.1, 2D-1D transformation".
"""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.line_camera import LineCamera
from cadcam.fit.dlt import dlt


@pytest.fixture
def p(table):
    return table("2_1")[:, :2]


@pytest.fixture
def U(table):
    return table("2_1")[:, 2]


@pytest.fixture
def C(p, U):
    return dlt(p, U[:, None], form="c23")


@pytest.fixture
def camera(C):
    return LineCamera.from_matrix(C)


def by_parts(camera, f):
    """U P R D of EQ 2.11-2.15 with f in EQ 2.13."""
    c, s = np.cos(camera.alpha), np.sin(camera.alpha)
    D = np.array([[1, 0, -camera.x], [0, 1, -camera.y], [0, 0, 1]])
    R = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return np.array([[1, camera.U0], [0, 1]]) @ np.array([[1.0, 0, 0], [0, -f, 0]]) @ R @ D


def test_eq_2_3_of_the_introduction_the_camera_constant():
    """Width W at distance D imaged w wide by focal length f: 1/D + 1/c = 1/f and w/W = c/D give f = D w/(W + w)."""
    W, D, w = 2221.6, 6000.0, 5.94
    c = D * w / W
    assert D * w / (W + w) == pytest.approx(1 / (1 / D + 1 / c), rel=1e-14)
    assert D * w / (W + w) == pytest.approx(c, rel=3e-3)  # "about D w/W"


def test_eq_2_7_the_last_row_holds_y_too(p, U, C):
    A = np.column_stack([p, np.ones(6), -U[:, None] * p])
    assert np.linalg.lstsq(A, U, rcond=None)[0] == pytest.approx(C.ravel()[:5], rel=1e-6)
    A[-1] = p[-1, 0], p[-1, 0], 1, -U[-1] * p[-1, 0], -U[-1] * p[-1, 0]
    assert np.abs(np.linalg.lstsq(A, U, rcond=None)[0] - C.ravel()[:5]).max() > 1


def test_eq_2_10_prints_c01_wrong_and_eq_2_54_right(C):
    assert C[0, 1] == pytest.approx(-1.508, abs=5e-4)
    assert abs(C[0, 1] + 1.505) > 2e-3


def test_eq_2_13_to_2_53_need_a_negative_f_for_the_example(C, camera):
    """det M > 0, so f = -1/89.44: EQ 2.53 is -1/f, and the length is that of |det M|."""
    det = np.linalg.det(C[:, :2])
    focal = det / (C[1, :2] @ C[1, :2])
    assert focal == pytest.approx(89.443, abs=1e-3)
    assert focal == pytest.approx(-camera.focal, rel=1e-12)
    assert det == pytest.approx(-(1 / camera.focal) / camera.unnormalized_matrix[1, 2] ** 2, rel=1e-9)
    K = by_parts(camera, -1 / focal)
    assert pytest.approx(C, abs=1e-9) == K / K[1, 2]
    printed = by_parts(camera, 1 / focal)
    assert np.abs(printed / printed[1, 2] - C).max() > 1


def test_eq_2_18_sums_the_squares_of_both(C, camera):
    K = camera.unnormalized_matrix
    assert K[1, 0] ** 2 + K[1, 1] ** 2 == pytest.approx(camera.focal**-2, rel=1e-12)
    assert abs(2 * K[1, 1] ** 2 - camera.focal**-2) > 0.5 * camera.focal**-2


def test_eq_2_29_the_translation_is_c02_and_one(p, U, C):
    F = -np.linalg.solve(C[:, :2], [C[0, 2], 1.0])
    t = C[1, :2] @ p[0] + 1
    V = np.linalg.solve(C[:, :2], [U[0], 1.0])
    assert V * t + F == pytest.approx(p[0], abs=1e-6)
    with_t = V * t - np.linalg.solve(C[:, :2], [C[0, 2], t])
    assert np.abs(with_t - p[0]).max() > 1


def test_eq_2_33_needs_a_minus_before_c_over_f(camera):
    f, d = 1 / camera.focal, camera.U0
    c, s = np.cos(camera.alpha), np.sin(camera.alpha)
    inverse = np.linalg.inv(camera.unnormalized_matrix[:, :2])
    right = np.array([[c, s / f - d * c], [s, -c / f - d * s]])
    assert inverse == pytest.approx(right, rel=1e-9)
    right[1, 1] = c / f - d * s
    assert abs(inverse[1, 1] - right[1, 1]) > 10


def test_eq_2_36_is_cramer_s_rule_on_the_first_two_rows(C, camera):
    det = np.linalg.det(C[:, :2])
    dx, dy = (C[0, 1] - C[0, 2] * C[1, 1]) / det, (C[0, 2] * C[1, 0] - C[0, 0]) / det
    assert [dx, dy] == pytest.approx(camera.center, abs=1e-8)
    assert [dx, dy] == pytest.approx([6, 2], abs=1e-7)


def test_eq_2_37_has_its_signs_in_the_other_places(C):
    det = np.linalg.det(C[:, :2])
    right = np.array([[C[1, 1], -C[0, 1]], [-C[1, 0], C[0, 0]]]) / det
    printed = np.array([[-C[1, 1], C[0, 1]], [C[1, 0], -C[0, 0]]]) / det
    assert right @ C[:, :2] == pytest.approx(np.eye(2), abs=1e-12)
    assert printed @ C[:, :2] == pytest.approx(-np.eye(2), abs=1e-12)


def test_eq_2_52_needs_the_absolute_value_under_the_root(golden, C, camera):
    product = (C[0, 0] / C[1, 0] - camera.U0) * (C[0, 1] / C[1, 1] - camera.U0)
    assert product == pytest.approx(-8000, abs=1e-3)
    entry = golden("2d1d.EQ2.52")
    assert np.sqrt(abs(product)) == pytest.approx(entry["value"], abs=entry["tol"])


def test_eq_2_6_is_the_camera_s_line(p, U, C, camera):
    """Every world point lies on y = a x + b of its image."""
    a = (U * C[1, 0] - C[0, 0]) / (C[0, 1] - U * C[1, 1])
    b = (U - C[0, 2]) / (C[0, 1] - U * C[1, 1])
    assert a * p[:, 0] + b == pytest.approx(p[:, 1], abs=1e-6)
    lines = camera.line(U)
    assert -lines[:, 0] / lines[:, 1] == pytest.approx(a, rel=1e-7)
    assert -lines[:, 2] / lines[:, 1] == pytest.approx(b, rel=1e-7)
