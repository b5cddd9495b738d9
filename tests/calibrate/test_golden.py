"""Every value of the thesis that a 3D-2D calibration must give again: golden.json's own values and tolerances."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.extended_pinhole import ExtendedPinhole, uv_from_pixel_matrix, uv_from_pixels
from cadcam.camera.observations import Observations
from cadcam.fit.dlt import dlt

from ..golden import assert_golden

ANGLES = [3, 4, 5, 8]
CHIP_CENTRE = np.array([288.0, 384.0])


def thesis_matrix(observations, about=(0.0, 0.0)):
    """C with C23 = 1 for (U, V) relative to `about`."""
    shifted = Observations.from_uv(observations.p_world, observations.UV - np.asarray(about))
    return uv_from_pixel_matrix(dlt(shifted.p_world, shifted.q, form="c23"))


def in_degrees(values):
    out = np.array(values[:11])
    out[ANGLES] = np.degrees(out[ANGLES])
    return out


def residual(C, observations):
    u = np.column_stack([observations.p_world, np.ones(len(observations))]) @ C.T
    return np.sqrt(np.sum((u[:, :2] / u[:, 2:] - observations.UV) ** 2) / len(observations))


@pytest.fixture
def bench(points):
    return {1: points("2_7", 1), 2: points("2_7", 2)}


def test_table_2_3_is_position_1_of_table_2_7(points):
    assert np.array_equal(points("2_3").q, points("2_7", 1).q)


@pytest.mark.parametrize("position", [1, 2])
def test_the_direct_linear_transform_gives_the_thesis_matrix(golden, bench, position):
    assert_golden(golden(f"dlt.pos{position}.C"), thesis_matrix(bench[position]))


def test_the_direct_linear_transform_gives_eq_2_66_about_the_chip_centre(golden, bench):
    assert_golden(golden("dlt.pos1.C_centred"), thesis_matrix(bench[1], CHIP_CENTRE))


@pytest.mark.parametrize("position", [1, 2])
def test_calibrate_gives_table_2_9(golden, bench, size, position):
    estimate = calibrate_camera(bench[position], size, method="dlt-c23")
    assert_golden(golden(f"dlt.pos{position}.params"), in_degrees(estimate.values))
    assert_golden(golden(f"dlt.pos{position}.residual"), estimate.thesis_residual)


@pytest.mark.parametrize(("name", "number"), [("mockup11.dlt", "3_10"), ("mockup7.dlt", "3_13")])
def test_calibrate_gives_the_direct_mock_up_calibrations(golden, points, size, name, number):
    estimate = calibrate_camera(points(number), size, method="dlt-c23")
    assert_golden(golden(name), [*in_degrees(estimate.values), estimate.thesis_residual])


@pytest.mark.parametrize("camera", [1, 2])
def test_the_fixed_cameras_give_their_matrices_and_centres(golden, points, camera):
    observations = points("2_4", camera)
    C = thesis_matrix(observations)
    assert_golden(golden(f"fixed.C{camera}"), C)
    assert_golden(golden(f"fixed.F_pos{camera}"), -np.linalg.solve(C[:, :3], C[:, 3]))


@pytest.mark.parametrize("camera", [1, 2])
def test_the_fixed_cameras_see_point_a_along_the_thesis_rays(golden, points, table, camera):
    U, V = table("2_5")[0, 3 + 2 * (camera - 1) :][:2]
    M = thesis_matrix(points("2_4", camera))[:, :3]
    assert_golden(golden(f"fixed.V_pos{camera}"), np.linalg.solve(M, [U, V, 1.0]))


def thesis_chain(C):
    """The formulas of EQ 2.85-2.160 as corrected, case by case as the thesis has them, with what they name."""
    M, T = C[:, :3], C[:, 3]
    n3 = np.linalg.norm(M[2])
    F = -np.linalg.inv(M) @ T  # EQ 2.93
    U0, V0 = M[0] @ M[2] / n3**2, M[1] @ M[2] / n3**2  # EQ 2.96
    f = 1 / np.sqrt(M[0] @ M[0] / n3**2 - U0**2)  # EQ 2.104, f = 1/focal
    p = f * np.sqrt(M[1] @ M[1] / n3**2 - V0**2)  # EQ 2.107
    sign = -np.sign(np.linalg.det(M))  # EQ 2.81
    K23 = sign * f / n3
    b = np.arcsin(-sign * C[2, 0] / n3)  # EQ 2.114
    a = next(  # EQ 2.109 with condition EQ 2.131, its right side -K23/f
        a
        for a in (np.arctan(-C[2, 1] / C[2, 2]), np.arctan(-C[2, 1] / C[2, 2]) + np.pi)
        if np.isclose(np.array([-np.sin(b), np.cos(b) * np.sin(a), -np.cos(b) * np.cos(a)]) @ F, -K23 / f, rtol=1e-6)
    )
    tan_c = sign * (C[0, 2] * C[2, 1] - C[0, 1] * C[2, 2]) / (n3 * (C[0, 0] - U0 * C[2, 0]))  # EQ 2.124, no f

    def first_row(c):
        return np.array(
            [
                np.cos(c) * np.cos(b) - U0 * f * np.sin(b),
                np.sin(c) * np.cos(a) + np.sin(a) * np.cos(c) * np.sin(b) + U0 * f * np.sin(a) * np.cos(b),
                np.sin(c) * np.sin(a) - np.cos(a) * np.cos(c) * np.sin(b) - U0 * f * np.cos(a) * np.cos(b),
            ]
        )

    # EQ 2.133 without its absolute bars, which cannot tell c from c + 180 deg where K03 is small
    c = min((np.arctan(tan_c), np.arctan(tan_c) + np.pi), key=lambda c: abs(first_row(c) @ F + K23 * C[0, 3]))
    n = np.tan(c)  # EQ 2.157
    m = K23 * (np.cos(a) * C[1, 1] + np.sin(a) * C[1, 2]) / (p * np.cos(c))  # EQ 2.136
    root = np.sqrt(max(1 + n**2 - m**2, 0.0))
    roots = [2 * np.arctan((n + s * root) / (1 + m)) for s in (1, -1)]  # EQ 2.138
    cos_beta = -np.linalg.det(M) * K23**3 / (f * p)  # EQ 2.128
    beta = min(roots, key=lambda x: abs(np.cos(x) - cos_beta))
    values = np.array([*F, a, b, c, p, 1 / f, beta, U0, V0])
    values[3:6] = np.arctan2(np.sin(values[3:6]), np.cos(values[3:6]))
    return {"values": values, "K23": K23, "n": n, "m": m, "roots": np.degrees(sorted(roots, reverse=True)), "norm": n3}


def test_the_thesis_chain_agrees_with_the_branch_free_decomposition(golden, bench):
    C = thesis_matrix(bench[1])
    difference = thesis_chain(C)["values"] - ExtendedPinhole.from_matrix(C).vector
    entry = golden("thesis.chain.equals.branchfree")
    assert np.abs(difference).max() <= entry["tol"]


def test_the_thesis_chain_agrees_for_either_sign_of_det_m(points):
    signs = set()
    for name, camera in [("2_7", 1), ("2_7", 2), ("2_4", 1), ("2_4", 2), ("3_10", 1), ("3_13", 1)]:
        C = thesis_matrix(points(name, camera))
        signs.add(np.sign(np.linalg.det(C[:, :3])))
        branch_free = ExtendedPinhole.from_matrix(C).vector
        assert thesis_chain(C)["values"] == pytest.approx(branch_free, rel=1e-9, abs=1e-7)
    assert signs == {1.0, -1.0}


def test_the_chain_passes_through_the_printed_intermediate_values(golden, bench):
    chain = thesis_chain(thesis_matrix(bench[1]))
    assert_golden(golden("pos1.K23"), chain["K23"])
    assert_golden(golden("pos1.n"), chain["n"])
    assert_golden(golden("pos1.m"), chain["m"])
    assert_golden(golden("pos1.beta.roots"), chain["roots"])
    assert_golden(golden("pos1.row3norm"), chain["norm"])


def test_the_centred_matrices_of_eq_2_141_and_2_161_come_out(golden, bench):
    C = thesis_matrix(bench[1], CHIP_CENTRE)
    assert_golden(golden("pos1.Minv_centred"), np.linalg.inv(C[:, :3]))
    assert_golden(golden("pos1.K_centred"), ExtendedPinhole.from_matrix(C).unnormalized_matrix)


def test_the_focal_length_of_eq_2_146_in_mm(golden, bench, size):
    focal = calibrate_camera(bench[1], size, method="dlt-c23").value("focal")
    assert_golden(golden("pos1.focal_mm"), focal / (768 / 5.94))


def factors(e, Ry=None):
    """The thesis' matrices W, S, U, P, R, D of EQ 2.67-2.74."""
    f = 1 / e.focal
    W = np.array([[1, 0, 0], [np.sin(e.skew), np.cos(e.skew), 0], [0, 0, 1]])
    S = np.diag([1, e.aspect, 1])
    U = np.array([[1, 0, e.U0], [0, 1, e.V0], [0, 0, 1]])
    P = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -f, 0.0]])
    R, D = np.eye(4), np.eye(4)
    R[:3, :3] = e.rotation
    D[:3, 3] = -e.X, -e.Y, -e.Z
    return W, S, U, P, R, D


def test_the_order_of_eq_2_75_gives_c_again_and_the_printed_one_does_not(golden, bench):
    entry = golden("pos1.compose.order")
    C = thesis_matrix(bench[1])
    W, S, U, P, R, D = factors(ExtendedPinhole.from_matrix(C))

    def off(K):
        return np.max(np.abs(K / K[2, 3] / C - 1))

    assert off(U @ S @ W @ P @ R @ D) <= entry["tol"][0]
    assert off(W @ S @ U @ P @ R @ D) == pytest.approx(entry["value"][1], abs=entry["tol"][1])


def closed_form_eq_2_76(e):
    (sa, sb, sc), (ca, cb, cc) = np.sin([e.a, e.b, e.c]), np.cos([e.a, e.b, e.c])
    f, p, xh, yh, dx, dy, dz = 1 / e.focal, e.aspect, e.U0, e.V0, e.X, e.Y, e.Z
    s, c = np.sin(e.skew), np.cos(e.skew)
    K = np.zeros((3, 4))
    K[0, :3] = (
        cc * cb - xh * f * sb,
        sc * ca + sa * cc * sb + sa * xh * f * cb,
        sc * sa - ca * cc * sb - ca * xh * f * cb,
    )
    K[1, 0] = cb * p * s * cc - cb * p * c * sc - yh * f * sb
    K[1, 1] = ca * p * s * sc + ca * p * c * cc + sa * sb * p * s * cc - sa * sb * p * c * sc + sa * yh * f * cb
    K[1, 2] = sa * p * s * sc + sa * p * c * cc - ca * sb * p * s * cc + ca * sb * p * c * sc - ca * yh * f * cb
    K[2, :3] = -f * sb, f * cb * sa, -f * cb * ca
    K[0, 3] = (
        -dx * cc * cb + dx * xh * f * sb - dy * sc * ca - dy * sa * cc * sb - dy * sa * xh * f * cb
        - dz * sc * sa + dz * ca * cc * sb + dz * ca * xh * f * cb
    )  # fmt: skip
    K[1, 3] = -K[1, :3] @ [dx, dy, dz]
    K[2, 3] = f * sb * dx - f * cb * sa * dy + f * cb * ca * dz
    return K


def test_the_closed_form_of_eq_2_76_is_the_product(golden, bench, size):
    e = ExtendedPinhole.from_matrix(thesis_matrix(bench[1]))
    skewed = ExtendedPinhole.from_vector([*e.vector[:8], np.radians(3.0), *e.vector[9:]])
    difference = closed_form_eq_2_76(skewed) - skewed.unnormalized_matrix
    assert np.abs(difference).max() <= golden("EQ2.76")["tol"] * np.abs(skewed.unnormalized_matrix).max()


@pytest.mark.parametrize(("name", "internals", "externals"), [("2.21", 1, 2), ("2.22", 2, 1)])
def test_internals_of_one_position_with_externals_of_the_other(golden, bench, size, name, internals, externals):
    own, other = (calibrate_camera(bench[i], size, method="dlt-c23") for i in (internals, externals))
    seen = own.camera.project(other.camera_from_world @ bench[externals].p_world)
    d = uv_from_pixels(seen) - bench[externals].UV
    assert_golden(golden(f"fixedint.{name}.raw"), np.sqrt(np.sum(d**2) / len(d)))


def test_poses_with_given_internals_converge_where_the_thesis_optimiser_had_not(golden, bench, size):
    """Tables 2.21 and 2.22: one position as calibrated, the other posed with its internals; printed 1.1, 1.0 px."""
    linear = {i: calibrate_camera(bench[i], size, method="dlt-c23") for i in (1, 2)}
    totals = [
        (linear[own].thesis_residual + locate_camera(bench[other], linear[own].camera).thesis_residual) / 2
        for own, other in ((1, 2), (2, 1))
    ]
    assert_golden(golden("joint.alpha0.totals"), totals)


def test_poses_with_the_joint_internals_give_table_2_24(golden, bench, size):
    value = golden("joint.alpha0.5")["value"]
    aspect, focal, skew, U0, V0 = value["internals"]
    camera = ExtendedPinhole(0, 0, 0, 0, 0, 0, aspect, focal, np.radians(skew), U0, V0).camera(size)
    for i in (1, 2):
        pose = locate_camera(bench[i], camera)
        assert in_degrees(pose.values)[:6] == pytest.approx(value[f"ext{i}"], abs=5e-3)
        assert pose.thesis_residual == pytest.approx(value["residuals"][i - 1], abs=1e-5)
