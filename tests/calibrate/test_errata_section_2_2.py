"""Each correction of the thesis' section 2.2: the printed form fails on the thesis' own data, the corrected one holds.

One test a row of the errata, "Chapter 2, 3D-2D", up to EQ 2.160.
"""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.extended_pinhole import ExtendedPinhole, uv_from_pixel_matrix
from cadcam.camera.observations import Observations
from cadcam.fit.dlt import dlt

CHIP_CENTRE = np.array([288.0, 384.0])


@pytest.fixture
def seen(points):
    """Position 1, det M > 0, and the first mock-up image, det M < 0."""
    return {"bench": points("2_7"), "mock-up": points("3_10")}


@pytest.fixture
def matrix(seen):
    def of(name, about=(0.0, 0.0)):
        o = Observations.from_uv(seen[name].p_world, seen[name].UV - np.asarray(about))
        return uv_from_pixel_matrix(dlt(o.p_world, o.q, form="c23"))

    return of


def by_parts(e, *, Ry=None, order="USW"):
    """K from the thesis' factors; Ry replaces the second rotation, order names the three image matrices."""
    (sa, sb, sc), (ca, cb, cc) = np.sin([e.a, e.b, e.c]), np.cos([e.a, e.b, e.c])
    Rx = np.array([[1, 0, 0], [0, ca, sa], [0, -sa, ca]])
    Rz = np.array([[cc, sc, 0], [-sc, cc, 0], [0, 0, 1]])
    Ry = np.array([[cb, 0, -sb], [0, 1, 0], [sb, 0, cb]]) if Ry is None else Ry
    image = {
        "U": np.array([[1, 0, e.U0], [0, 1, e.V0], [0, 0, 1]]),
        "S": np.diag([1, e.aspect, 1]),
        "W": np.array([[1, 0, 0], [np.sin(e.skew), np.cos(e.skew), 0], [0, 0, 1]]),
    }
    A = image[order[0]] @ image[order[1]] @ image[order[2]] @ np.diag([1, 1, -1 / e.focal]) @ Rz @ Ry @ Rx
    return np.column_stack([A, -A @ [e.X, e.Y, e.Z]])


def relative(K, C):
    return np.max(np.abs(K / K[2, 3] / C - 1))


@pytest.fixture
def skewed(matrix):
    """Position 1 with a skew of 3 degrees, so that no term hides."""
    e = ExtendedPinhole.from_matrix(matrix("bench"))
    return ExtendedPinhole.from_vector([*e.vector[:8], np.radians(3.0), *e.vector[9:]])


def test_eq_2_59_needs_c02_z_in_row_one_and_c22_z_in_row_three(seen, matrix):
    C, p, UV = matrix("bench"), seen["bench"].p_world, seen["bench"].UV
    x, y, z = p.T
    u = C[0, 0] * x + C[0, 1] * y + C[0, 2] * z + C[0, 3]
    t = C[2, 0] * x + C[2, 1] * y + C[2, 2] * z + 1
    assert np.abs(u / t - UV[:, 0]).max() < 1.2  # px: the largest residual of this fit
    assert np.abs((C[0, 0] * x + C[0, 1] * y + C[0, 0] * z + C[0, 3]) / t - UV[:, 0]).min() > 100
    assert np.abs(u / (C[2, 0] * x + C[2, 1] * y + C[2, 2] + 1) - UV[:, 0]).min() > 100


def test_eq_2_69_has_the_signs_of_sin_b_exchanged(skewed):
    sb, cb = np.sin(skewed.b), np.cos(skewed.b)
    printed = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    assert relative(by_parts(skewed), skewed.matrix) < 1e-12
    assert relative(by_parts(skewed, Ry=printed), skewed.matrix) > 0.1


def test_eq_2_75_multiplies_u_s_w_in_this_order(skewed):
    K = by_parts(skewed, order="WSU")
    assert relative(by_parts(skewed, order="USW"), skewed.matrix) < 1e-12
    assert relative(K, skewed.matrix) > 1e-3
    yh = K[1, :3] @ K[2, :3] / (K[2, :3] @ K[2, :3])  # EQ 2.101 must give V0 back
    assert abs(yh - skewed.V0) > 1


def test_eq_2_76_lost_sin_a_in_k03_and_k11(skewed):
    e, K = skewed, skewed.unnormalized_matrix
    (sa, sb, sc), (ca, cb, cc) = np.sin([e.a, e.b, e.c]), np.cos([e.a, e.b, e.c])
    f, p, s, c = 1 / e.focal, e.aspect, np.sin(e.skew), np.cos(e.skew)

    def K03(lost):
        return (
            -e.X * cc * cb + e.X * e.U0 * f * sb - e.Y * sc * ca - e.Y * lost * cc * sb - e.Y * sa * e.U0 * f * cb
            - e.Z * sc * sa + e.Z * ca * cc * sb + e.Z * ca * e.U0 * f * cb
        )  # fmt: skip

    def K11(lost):
        return (
            ca * p * s * sc + ca * p * c * cc + sa * sb * p * s * cc - sa * sb * p * c * sc + lost * e.V0 * f * cb
        )  # fmt: skip

    assert K03(sa) == pytest.approx(K[0, 3], abs=1e-12 * np.abs(K).max())
    assert K11(sa) == pytest.approx(K[1, 1], abs=1e-12)
    assert abs(K03(1.0) - K[0, 3]) > 1
    assert abs(K11(1.0) - K[1, 1]) > 0.1


@pytest.mark.parametrize("name", ["bench", "mock-up"])
def test_eq_2_81_the_sign_of_k23_is_minus_that_of_det_m(matrix, name):
    C = matrix(name)
    K = ExtendedPinhole.from_matrix(C).unnormalized_matrix
    assert np.sign(K[2, 3]) == -np.sign(np.linalg.det(C[:, :3]))
    assert abs(K[2, 3]) == pytest.approx(np.linalg.norm(K[2, :3]) / np.linalg.norm(C[2, :3]), rel=1e-9)


def test_eq_2_91_is_the_determinant_of_the_unnormalised_m(matrix):
    C = matrix("bench")
    e = ExtendedPinhole.from_matrix(C)
    right = -e.aspect * np.cos(e.skew) / e.focal
    assert np.linalg.det(e.unnormalized_matrix[:, :3]) == pytest.approx(right, rel=1e-9)
    assert np.linalg.det(C[:, :3]) * right < 0  # the printed |M| has even the other sign here


@pytest.mark.parametrize("name", ["bench", "mock-up"])
def test_eq_2_113_and_2_114_take_c20_in_every_case(matrix, name):
    C = matrix(name)
    sign = -np.sign(np.linalg.det(C[:, :3]))
    b, n = ExtendedPinhole.from_matrix(C).b, np.linalg.norm(C[2, :3])
    assert np.arcsin(-sign * C[2, 0] / n) == pytest.approx(b, abs=1e-9)
    assert abs(np.arcsin(C[2, 2] / n) - b) > 0.1  # C22 as printed in EQ 2.113
    assert C[2, 3] / n > 1  # C23 as printed in EQ 2.114 has no arcsine at all


@pytest.mark.parametrize("name", ["bench", "mock-up"])
def test_eq_2_123_the_focal_length_cancels_from_tan_c(matrix, name):
    C = matrix(name)
    e, n = ExtendedPinhole.from_matrix(C), np.linalg.norm(C[2, :3])
    sign = -np.sign(np.linalg.det(C[:, :3]))
    tan_c = sign * (C[0, 2] * C[2, 1] - C[0, 1] * C[2, 2]) / (n * (C[0, 0] - e.U0 * C[2, 0]))
    assert tan_c == pytest.approx(np.tan(e.c), rel=1e-7)
    with_f = np.degrees(np.arctan(tan_c / e.focal))
    assert abs(with_f) < 0.15  # degrees, against 2.36 and 56.85
    if name == "bench":
        assert abs(with_f) == pytest.approx(0.003, abs=5e-4)


@pytest.mark.parametrize(("name", "positive"), [("bench", True), ("mock-up", False)])
def test_eq_2_126_the_right_side_carries_the_sign_of_det_m(matrix, name, positive):
    C = matrix(name)
    e, n = ExtendedPinhole.from_matrix(C), np.linalg.norm(C[2, :3])
    left = np.array([-np.sin(e.b), np.cos(e.b) * np.sin(e.a), -np.cos(e.b) * np.cos(e.a)]) @ [e.X, e.Y, e.Z]
    assert (np.linalg.det(C[:, :3]) > 0) is np.bool_(positive)
    assert left == pytest.approx((1 if positive else -1) / n, rel=1e-9)


def test_eq_2_142_the_focal_centre_is_minus_m_inverse_t(matrix):
    C = matrix("bench", CHIP_CENTRE)
    printed = np.array([7.68, 416.34, -210.44])
    without_sign = np.linalg.inv(C[:, :3]) @ C[:, 3]
    assert -without_sign == pytest.approx(printed, abs=0.005)
    assert np.abs(without_sign - printed).min() > 10


def test_eq_2_142_below_eq_2_174_the_joint_matrix_needs_the_minus_too(golden):
    C = np.array(golden("joint.C2")["value"])
    F = -np.linalg.inv(C[:, :3]) @ C[:, 3]
    assert pytest.approx(ExtendedPinhole.from_matrix(C).vector[:3], abs=1e-6) == F
    assert pytest.approx([4.99, 205.20, -204.96], abs=0.1) == F  # Table 2.24, Pos 2


def test_eq_2_144_the_third_column_of_m_transposed(matrix):
    row = matrix("bench", CHIP_CENTRE)[2, :3]
    assert row == pytest.approx([-0.0012, 0.0011, 0.0069], abs=5e-5)
    assert np.abs(row - [-0.0011, 0.0012, 0.0069]).max() > 5e-5


def test_eq_2_146_the_chip_is_6_4_by_4_8_mm(matrix):
    """Square pixels of the chip must give one density; the measured aspect of 1.007 allows 1 % between the axes."""
    e = ExtendedPinhole.from_matrix(matrix("bench"))
    used = 0.9  # share of the chip that the 768 x 576 pixels cover
    along_v, along_u = 768 / (6.4 * used), 576 / (4.8 * used)
    assert along_v == pytest.approx(along_u, rel=0.01) == pytest.approx(133.3, abs=0.1)
    assert abs((576 / 3.96) / (768 / 5.94) - e.aspect) > 0.1
    assert e.focal / along_u == pytest.approx(6.04, abs=0.01)


def test_eq_2_147_the_aspect_needs_the_factor_f(matrix):
    C = matrix("bench")
    e, n2 = ExtendedPinhole.from_matrix(C), C[2, :3] @ C[2, :3]
    root = np.sqrt(C[1, :3] @ C[1, :3] / n2 - e.V0**2)
    assert root / e.focal == pytest.approx(e.aspect, rel=1e-9) == pytest.approx(1.00734, abs=1e-5)
    assert root == pytest.approx(811.8, abs=0.1)


def test_eq_2_149_the_root_is_of_squares(matrix):
    C = matrix("bench")
    n = np.linalg.norm(C[2, :3])
    assert np.degrees(np.arcsin(-C[2, 0] / n)) == pytest.approx(9.44, abs=0.005)
    printed = np.degrees(np.arcsin(-C[2, 0] / np.sqrt(C[2, :3].sum())))
    assert abs(printed - 9.44) > 1


def test_eq_2_159_the_arccosine_loses_half_of_the_digits(matrix):
    """A skew of 1e-6 rad: the cosine differs from one by 5e-13, so rounding of 1e-16 leaves half of the digits."""
    e = ExtendedPinhole.from_matrix(matrix("bench"))
    truth = ExtendedPinhole.from_vector([*e.vector[:8], 1e-6, *e.vector[9:]])
    C = truth.matrix
    K23 = truth.unnormalized_matrix[2, 3]
    cosine = -np.linalg.det(C[:, :3]) * K23**3 * truth.focal / truth.aspect
    assert abs(np.arccos(min(cosine, 1.0)) - 1e-6) > 1e-11
    assert ExtendedPinhole.from_matrix(C).skew == pytest.approx(1e-6, abs=1e-13)
