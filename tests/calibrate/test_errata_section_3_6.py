"""Section 3.6, hand-eye calibration: its equations hold on simulated cells, one of them not as printed."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.fit.hand_eye import motions, park_martin
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

from .robots import cell

TINY = 1e-11  # relative to mm of order 1000: a few dozen roundings


@pytest.fixture
def frames(rng):
    """A[i] = Cam_T_W, B[i] = M_T_Hand, X = Cam_T_Hand, as in Fig 3-22, of an exact robot."""
    c = cell(rng, 4)
    A = [Rigid(R, t) for R, t in zip(c.camera_from_target.rotation, c.camera_from_target.translation, strict=True)]
    B = [Rigid(R, t) for R, t in zip(c.base_from_flange.rotation, c.base_from_flange.translation, strict=True)]
    return A, B, c.flange_from_held.inv


def same(one, other):
    return np.abs(one.matrix - other.matrix).max() < TINY * 1000


def test_eq_3_188_to_3_191_every_position_gives_the_same_world(frames):
    A, B, X = frames
    M_T_W = [b @ X.inv @ a for a, b in zip(A, B, strict=True)]
    assert all(same(M_T_W[0], other) for other in M_T_W[1:])


def test_eq_3_192_and_3_193_are_the_equation_of_motions(frames):
    A, B, X = frames
    motion_A, motion_B = A[1] @ A[0].inv, B[1].inv @ B[0]
    assert same(motion_A @ X, X @ motion_B)


def test_eq_3_194_needs_the_inverse_of_the_first_pose(frames):
    """Printed is a product of three motions, the first of them of camera 1; the relation is Cam2_T_W W_T_Cam1."""
    A, *_ = frames
    cam2_from_cam1 = A[1] @ A[0].inv
    assert same(A[1], cam2_from_cam1 @ A[0])
    printed = A[0].inv @ A[1].inv @ cam2_from_cam1
    assert not same(printed, cam2_from_cam1)


def test_eq_3_195_and_3_196_are_its_rotation_and_its_translation(frames):
    A, B, X = frames
    motion_A, motion_B = A[2] @ A[0].inv, B[2].inv @ B[0]
    R_A, R_B, R_X = motion_A.rotation, motion_B.rotation, X.rotation
    np.testing.assert_allclose(R_A @ R_X, R_X @ R_B, atol=TINY)
    left = (R_A - np.eye(3)) @ X.translation
    np.testing.assert_allclose(left, R_X @ motion_B.translation - motion_A.translation, atol=TINY * 1000)


def test_eq_3_197_to_3_199_the_axes_correspond(frames):
    A, B, X = frames
    motion_A, motion_B = A[3] @ A[1].inv, B[3].inv @ B[1]
    np.testing.assert_allclose(motion_A.rotation, X.rotation @ motion_B.rotation @ X.rotation.T, atol=TINY)
    n_A, n_B = so3.log(motion_A.rotation), so3.log(motion_B.rotation)
    np.testing.assert_allclose(n_A, X.rotation @ n_B, atol=TINY)
    np.testing.assert_allclose(motion_B.rotation @ n_B, n_B, atol=TINY)


def test_three_positions_determine_x_and_two_do_not(rng):
    """The thesis: at least three positions. Two give one motion, and X exp(k log B) solves it for every k."""
    c = cell(rng, 3)
    A, B = motions(c.base_from_flange, c.camera_from_target)
    np.testing.assert_allclose(park_martin(A, B).matrix, c.flange_from_held.matrix, atol=1e-7)
    one_A, one_B = Rigid(A.rotation[0], A.translation[0]), Rigid(B.rotation[0], B.translation[0])
    other = c.flange_from_held @ Rigid.exp(0.3 * one_B.log())
    assert same(one_A @ other, other @ one_B)
    assert not same(other, c.flange_from_held)
