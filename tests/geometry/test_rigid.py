"""Rigid motions form a group; exp and log are inverse; the adjoint moves perturbations from one side to the other."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid, by_twist

EPS = np.finfo(float).eps
BATCHES = [(), (1,), (7,), (2, 3)]


def random_twists(rng: np.random.Generator, batch: tuple[int, ...], angle: float = 3.0) -> Array:
    xi = rng.normal(size=(*batch, 6)) * 100
    w = xi[..., 3:]
    xi[..., 3:] = w / np.linalg.norm(w, axis=-1, keepdims=True) * rng.uniform(0, angle, (*batch, 1))
    return xi


@pytest.mark.parametrize("batch", BATCHES)
def test_composition_with_the_inverse_is_the_identity(rng: np.random.Generator, batch: tuple[int, ...]) -> None:
    T = Rigid.exp(random_twists(rng, batch))
    # 100 mm translations times a handful of rounded products
    assert np.abs((T @ T.inv).matrix - np.eye(4)).max() < 20 * EPS * 300


@pytest.mark.parametrize("batch", BATCHES)
def test_composition_is_associative_and_acts_on_points(rng: np.random.Generator, batch: tuple[int, ...]) -> None:
    A, B, C = (Rigid.exp(random_twists(rng, batch)) for _ in range(3))
    p = rng.normal(size=(*batch, 3)) * 100
    assert np.allclose(((A @ B) @ C).matrix, (A @ (B @ C)).matrix, rtol=0, atol=50 * EPS * 500)
    assert np.allclose((A @ B) @ p, A @ (B @ p), rtol=0, atol=50 * EPS * 500)


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("angle", [1e-12, 1e-7, 1e-3, 0.01, 1.0, 3.0, np.pi - 1e-9])
def test_log_undoes_exp(rng: np.random.Generator, batch: tuple[int, ...], angle: float) -> None:
    xi = random_twists(rng, batch)
    xi[..., 3:] *= angle / np.linalg.norm(xi[..., 3:], axis=-1, keepdims=True)
    # translation 100 mm; near pi the inverse of V amplifies by a small factor
    assert np.allclose(Rigid.exp(xi).log(), xi, rtol=0, atol=100 * EPS * 500)


def test_log_at_half_a_turn_gives_an_axis_of_length_pi(rng: np.random.Generator) -> None:
    axis = rng.normal(size=(50, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    w = so3.log(so3.exp(np.pi * axis))
    assert np.allclose(np.linalg.norm(w, axis=1), np.pi, rtol=0, atol=10 * EPS)
    assert np.allclose(np.abs(np.sum(w * axis, axis=1)), np.pi, rtol=0, atol=10 * EPS)


def test_exp_agrees_with_the_matrix_exponential(rng: np.random.Generator) -> None:
    from scipy.linalg import expm

    for xi in random_twists(rng, (20,)):
        generator = np.zeros((4, 4))
        generator[:3, :3], generator[:3, 3] = so3.hat(xi[3:]), xi[:3]
        assert np.allclose(Rigid.exp(xi).matrix, expm(generator), rtol=0, atol=1e-11)  # expm's own error dominates


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.00999, 0.01001, 0.3, 3.0, 6.0])
def test_one_motion_is_what_it_is_in_a_batch(rng: np.random.Generator, angle: float) -> None:
    w = rng.normal(size=(5, 3))
    xi = np.concatenate([rng.normal(size=(5, 3)), angle * w / np.linalg.norm(w, axis=1, keepdims=True)], axis=1)
    for one, of_batch in zip(map(Rigid.exp, xi), Rigid.exp(xi).each, strict=True):
        assert np.allclose(one.matrix, of_batch.matrix, rtol=0, atol=50 * EPS)


@pytest.mark.parametrize("batch", BATCHES)
def test_the_adjoint_carries_a_perturbation_to_the_other_side(rng: np.random.Generator, batch: tuple[int, ...]) -> None:
    T = Rigid.exp(random_twists(rng, batch))
    xi = random_twists(rng, batch, 0.5) * 0.01
    left = Rigid.exp(np.einsum("...ij,...j->...i", T.adjoint(), xi)) @ T
    assert np.allclose(left.matrix, (T @ Rigid.exp(xi)).matrix, rtol=0, atol=100 * EPS * 500)


def test_points_move_by_a_twist_as_differences_have_it(rng: np.random.Generator) -> None:
    """Of distances from a plane; central differences are off by 1e-10 of the lever, less than rounding here."""
    n, p, h = rng.normal(size=3), 100 * rng.normal(size=(9, 3)), 1e-5
    J = by_twist(p, np.broadcast_to(n, p.shape))
    for xi, column in zip(h * np.eye(6), J.T, strict=True):
        ahead, behind = (Rigid.exp(sign * xi) @ p @ n for sign in (1, -1))
        rounding = EPS * np.abs(p).max() / h
        np.testing.assert_allclose((ahead - behind) / (2 * h), column, rtol=0, atol=20 * rounding)


def test_covariance_of_the_inverse_is_the_adjoint_sandwich(rng: np.random.Generator) -> None:
    T = Rigid.exp(random_twists(rng, ()))
    xi = rng.normal(size=(4000, 6)) * 1e-4
    inverse = (T @ Rigid.exp(xi)).inv  # perturbed b_from_a, inverted
    delta = (T @ inverse).log()  # its own right perturbation: T^-1 exp(d) = inverse
    predicted = T.adjoint() @ np.eye(6) @ T.adjoint().T * 1e-8
    ratio = np.linalg.eigvals(np.linalg.solve(predicted, np.cov(delta.T))).real
    assert ratio.min() > 1 - 5 * np.sqrt(12 / 4000)  # eigenvalues of a Wishart of 4000 draws in 6 dimensions
    assert ratio.max() < 1 + 5 * np.sqrt(12 / 4000)


def test_left_jacobian_is_the_derivative_of_exp_and_its_inverse_inverts_it(rng: np.random.Generator) -> None:
    w = random_twists(rng, (30,))[:, 3:]
    J, h = so3.exp_and_left_jacobian(w)[1], 1e-6
    for k, d in enumerate(np.eye(3)):
        step = so3.log(so3.exp(w + h * d) @ np.swapaxes(so3.exp(w - h * d), -1, -2)) / (2 * h)
        assert np.allclose(step, J[..., k], rtol=0, atol=1e-9)  # h^2 + eps/h
    assert np.allclose(J @ so3.inverse_left_jacobian(w), np.eye(3), rtol=0, atol=100 * EPS)


def test_quaternion_and_matrix_are_inverse_maps(rng: np.random.Generator) -> None:
    R = so3.exp(random_twists(rng, (200,), np.pi)[:, 3:])
    q = so3.quaternion(R)
    assert np.all(q[:, 0] >= 0)
    assert np.allclose(np.linalg.norm(q, axis=1), 1, rtol=0, atol=4 * EPS)
    assert np.allclose(so3.from_quaternion(q), R, rtol=0, atol=20 * EPS)


def test_a_written_rotation_is_made_one_and_what_is_none_is_refused(rng: np.random.Generator) -> None:
    R = so3.exp(random_twists(rng, (20,))[:, 3:])
    mended = so3.written(np.round(R, 4))
    assert np.abs(mended - R).max() < 2e-4  # of half a last digit in nine numbers
    assert np.abs(mended @ np.swapaxes(mended, -1, -2) - np.eye(3)).max() < 20 * EPS
    assert np.array_equal(so3.written(R), R)
    for wrong in (np.diag([1.0, 1.0, 1.05]), np.diag([1.0, -1.0, 1.0])):
        with pytest.raises(BadValue, match="rotation"):
            so3.written(wrong)


def test_nearest_rotation_is_a_rotation_even_of_a_mirror_image(rng: np.random.Generator) -> None:
    M = rng.normal(size=(40, 3, 3))
    R = so3.nearest(M)
    assert np.allclose(R @ np.swapaxes(R, -1, -2), np.eye(3), rtol=0, atol=20 * EPS)
    assert np.allclose(np.linalg.det(R), 1, rtol=0, atol=20 * EPS)
    w = rng.normal(size=(40, 3)) * 0.01
    assert np.all(np.linalg.norm(M - so3.exp(w) @ R, axis=(1, 2)) >= np.linalg.norm(M - R, axis=(1, 2)))


def test_look_at_puts_the_target_on_the_axis_and_up_upwards() -> None:
    T = Rigid.look_at([1000, 200, 300], [0, 0, 0])
    assert np.allclose(T @ np.zeros(3), [0, 0, np.linalg.norm([1000, 200, 300])], atol=1e-12 * 1000)
    assert np.allclose(T.origin, [1000, 200, 300], atol=1e-12 * 1000)
    assert (T @ np.array([0.0, 0, 1]))[1] < 0  # y points down in the picture


def test_what_is_not_a_rigid_motion_is_refused() -> None:
    with pytest.raises(BadValue, match="mirrored"):
        Rigid(np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(BadValue, match="orthonormal"):
        Rigid(1.001 * np.eye(3))
    with pytest.raises(BadValue, match=r"translation\[1\]"):
        Rigid(np.eye(3), [0, np.nan, 0])
    with pytest.raises(BadValue, match="last row"):
        Rigid.from_matrix(np.eye(4) + np.eye(4)[::-1] * 0.1)
    with pytest.raises(DegenerateGeometry, match="up"):
        Rigid.look_at([0, 0, 100], [0, 0, 0])
    with pytest.raises(BadValue, match=r"shape \(3, 3\); expected one for each of rotations \(2, 3, 3\)"):
        Rigid(np.stack([np.eye(3)] * 2), np.zeros((3, 3)))


def test_arrays_inside_are_copies_and_read_only() -> None:
    t = np.zeros(3)
    T = Rigid(np.eye(3), t)
    t[0] = 5
    assert T.translation[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        T.translation[0] = 1


def test_motions_of_a_batch_are_taken_by_index() -> None:
    batch = Rigid.exp(np.random.default_rng(5).normal(size=(5, 6)))
    for index in (2, np.int64(2), slice(1, 3), [0, 4], np.array([4, 0]), np.array([True, False, True, False, False])):
        assert np.array_equal(batch[index].matrix, batch.matrix[index])
    with pytest.raises(BadValue, match="a batch of motions"):
        batch[2][0]
    with pytest.raises(IndexError):
        batch[5]


def test_a_stack_is_the_batch_of_its_motions() -> None:
    batch = Rigid.exp(np.random.default_rng(5).normal(size=(5, 6)))
    assert np.array_equal(Rigid.stack(batch.each).matrix, batch.matrix)
    assert np.array_equal(Rigid.stack({"a": batch[1], "b": batch[0]}.values()).matrix, batch.matrix[[1, 0]])
    assert Rigid.stack([]).each == []
    with pytest.raises(BadValue, match=r"motions\[0\] is Rigid\(batch.*a single motion"):
        Rigid.stack([batch])


def test_a_rotation_is_given_and_told_as_quaternion_and_vector() -> None:
    batch = Rigid.exp(np.random.default_rng(5).normal(size=(5, 6)))
    by_quaternion = Rigid.from_quaternion(-2 * batch.quaternion_wxyz, batch.translation)
    by_vector = Rigid.from_rotation_vector(batch.rotation_vector, batch.translation)
    for same in (by_quaternion, by_vector):
        assert np.allclose(same.matrix, batch.matrix, atol=1e-14)
    quarter = Rigid.from_rotation_vector([0, 0, np.pi / 2], [1, 2, 3])
    assert np.allclose(quarter @ [1, 0, 0], [1, 3, 3])  # the translation as given: no screw
    assert np.allclose(quarter.quaternion_wxyz, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    with pytest.raises(BadValue, match="quaternion"):
        Rigid.from_quaternion([0, 0, 0, 0])
    with pytest.raises(BadValue, match=r"rotation vector is of shape \(4,\)"):
        Rigid.from_rotation_vector([0, 0, 0, 1])


def test_a_matrix_rounded_to_three_decimals_is_made_a_motion_and_a_scaled_one_is_none() -> None:
    motion = Rigid.exp([100, -20, 5, 0.3, -0.2, 1.1])
    rounded = Rigid.from_matrix(motion.matrix.round(3))
    assert np.allclose(rounded.rotation @ rounded.rotation.T, np.eye(3), atol=1e-14)
    assert np.allclose(rounded.rotation, motion.rotation, atol=2e-3)
    assert np.array_equal(Rigid.from_matrix(motion.matrix).matrix, motion.matrix)
    with pytest.raises(BadValue, match="off a rotation by"):
        Rigid.from_matrix(np.diag([1.01, 1.01, 1.01, 1]))
    with pytest.raises(BadValue, match="mirrored"):
        Rigid.from_matrix(np.diag([1.0, 1, -1, 1]))
    with pytest.raises(BadValue, match=r"rotation\[1, 0\] is nan"):
        Rigid.from_matrix(np.where(np.arange(16).reshape(4, 4) == 4, np.nan, np.eye(4)))
