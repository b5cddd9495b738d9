"""The hand-eye adjustments: their derivatives, their agreement with each other, and the robot's noise they find."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import internals_of
from cadcam.camera.lens import BrownConrady
from cadcam.fit.block_least_squares import minimise_blocks
from cadcam.fit.hand_eye_pixels import HandEyePixels, HandEyeState, InternalsPrior
from cadcam.fit.hand_eye_poses import PATTERNS, HandEyePoses, adjust, adjust_robustly
from cadcam.fit.many_poses import PaddedViews
from cadcam.fit.schur import Step
from cadcam.fit.variance_components import variance_components
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

H = 1e-6  # step of central differences: their error is H^2 of the third derivative


def random_rigid(rng, n=None, turn=1.0, reach=100.0):
    shape = (3,) if n is None else (n, 3)
    return Rigid(so3.exp(turn * rng.normal(size=shape)), reach * rng.normal(size=shape))


def random_poses(rng, n, covariance, robot=(0.0, 0.0)):
    """Return poses with this robot and camera noise, and the true motions."""
    B, X, Z = random_rigid(rng, n, turn=0.4), random_rigid(rng), random_rigid(rng, reach=600.0)
    off = Rigid(so3.exp(robot[1] * rng.normal(size=(n, 3))), robot[0] * rng.normal(size=(n, 3)))
    S = X.inv @ ((B @ off).inv @ Z) @ Rigid.exp(rng.multivariate_normal(np.zeros(6), covariance, size=n))
    return HandEyePoses(B, S, np.broadcast_to(covariance, (n, 6, 6))), X, Z


def test_the_derivative_on_poses_is_that_of_differences(rng):
    poses, X, Z = random_poses(rng, 5, np.diag([1.0, 1, 1, 1e-4, 1e-4, 1e-4]), (20.0, 0.3))
    _, D, _ = poses.linearised(X, Z)
    for k in range(12):
        d = np.zeros(12)
        d[k] = H
        plus, minus = (poses.offsets(X @ Rigid.exp(s * d[:6]), Z @ Rigid.exp(s * d[6:])) for s in (1, -1))
        np.testing.assert_allclose(D[:, :, k], (plus - minus) / (2 * H), atol=1e-6 * (1 + np.abs(D).max()))


def test_the_covariance_of_an_offset_is_that_of_drawn_camera_poses(rng):
    cov = np.diag([0.04, 0.09, 0.25, 1e-6, 4e-6, 9e-6])
    poses, X, Z = random_poses(rng, 1, np.zeros((6, 6)))
    poses = HandEyePoses(poses.base_from_flange, poses.held_from_fixed, cov[None])
    _, _, M = poses.linearised(X, Z)
    draws = rng.multivariate_normal(np.zeros(6), cov, size=4000)
    moved = HandEyePoses(poses.base_from_flange, poses.held_from_fixed @ Rigid.exp(draws), cov[None])
    e = moved.offsets(X, Z)
    whitened = np.linalg.solve(np.linalg.cholesky(M[0]), e.T)
    np.testing.assert_allclose(whitened @ whitened.T / 4000, np.eye(6), atol=6 / np.sqrt(4000))  # 4 sigma and more


def test_variance_components_are_the_mean_squares_where_those_are_best(rng):
    """Two sources on separate coordinates and a common mean: restricted likelihood gives sum of squares/(n - 1)."""
    n = 12
    y = rng.normal(size=(n, 6)) * np.repeat([2.0, 0.1], 3)
    D = np.broadcast_to(np.eye(6), (n, 6, 6))
    found = variance_components(y, D, np.zeros((n, 6, 6)), PATTERNS, np.array([1.0, 1.0]))
    left = y - y.mean(axis=0)
    expected = [np.sum(left[:, :3] ** 2) / (3 * (n - 1)), np.sum(left[:, 3:] ** 2) / (3 * (n - 1))]
    np.testing.assert_allclose(found.variances, expected, rtol=1e-5)
    spread = 2 * np.square(expected) / (3 * (n - 1))  # of a chi-square with 3 (n - 1) degrees of freedom
    np.testing.assert_allclose(np.diag(found.covariance), spread, rtol=1e-4)


def test_a_source_that_is_not_there_comes_out_as_nothing(rng):
    n, known = 30, np.diag([1.0, 1, 1, 1, 1, 1])
    y = 0.9 * rng.normal(size=(n, 6))
    D = np.broadcast_to(np.eye(6), (n, 6, 6))
    found = variance_components(y, D, np.broadcast_to(known, (n, 6, 6)), PATTERNS, np.array([1.0, 1.0]))
    assert (found.variances < 1e-6).all()


def test_the_robots_noise_is_found_without_bias(rng):
    """Mean of 40 estimates within 4 of its sigmas; a plain likelihood would be 12 of 90 coordinates too small."""
    robot = np.array([0.3, 0.001])
    cov = np.diag([0.01, 0.01, 0.09, 1e-7, 1e-7, 1e-7])
    variances = []
    for _ in range(40):
        poses, X, Z = random_poses(rng, 15, cov, robot)
        variances.append(adjust(poses, X, Z).variances)
    mean, sigma = np.mean(variances, axis=0), np.std(variances, axis=0) / np.sqrt(40)
    assert (np.abs(mean - robot**2) < 4 * sigma).all()
    assert (sigma < 0.12 * robot**2).all()


def test_a_third_of_gross_errors_does_not_move_the_robust_adjustment(rng):
    poses, X, Z = random_poses(rng, 15, np.zeros((6, 6)), (0.1, 0.0003))
    B = poses.base_from_flange
    t = B.translation.copy()
    t[:5] += rng.normal(size=(5, 3)) * 60
    start = Rigid.exp([5, -5, 5, 0.02, 0.02, -0.02])
    wrong = HandEyePoses(Rigid(B.rotation, t), poses.held_from_fixed, poses.covariance)
    fit = adjust_robustly(wrong, X @ start, Z @ start, np.array([1.0, 0.01]))
    clean = adjust(poses, X, Z)
    sigma = np.sqrt(np.diag(np.linalg.inv(clean.information)))
    assert (np.abs((fit.flange_from_held.inv @ X).log()) < 5 * sigma[:6]).all()
    assert (fit.squared_distances[:5] > 100 * 6).all()


@pytest.mark.parametrize("held", [True, False], ids=["camera held", "target held"])
def test_the_derivative_on_pixels_is_that_of_differences(rng, held):
    problem, state = pixel_problem(rng, held=held, prior=True)
    blocks = problem.blocks(state)
    n, m, _ = blocks.sizes
    assert m == 12 + 4
    for k in range(m):
        d = np.zeros(m)
        d[k] = H
        plus, minus = (problem.blocks(problem.retract(state, Step(s * d, np.zeros((n, 6))))) for s in (1, -1))
        column = blocks.by_shared[:, :, k]
        np.testing.assert_allclose(column, (plus.r - minus.r) / (2 * H), atol=1e-5 * (1 + np.abs(column).max()))
        alone = (plus.alone_r - minus.alone_r) / (2 * H)
        np.testing.assert_allclose(blocks.alone[:, k], alone, atol=1e-6 * (1 + np.abs(alone).max()))
    for k in range(6):
        d = np.zeros((n, 6))
        d[:, k] = H
        plus, minus = (problem.blocks(problem.retract(state, Step(np.zeros(m), s * d))) for s in (1, -1))
        column = blocks.by_own[:, :, k]
        np.testing.assert_allclose(column, (plus.r - minus.r) / (2 * H), atol=1e-5 * (1 + np.abs(column).max()))


@pytest.mark.parametrize("held", [True, False], ids=["camera held", "target held"])
def test_exact_pixels_of_an_exact_robot_are_explained_to_rounding(rng, held):
    problem, state = pixel_problem(rng, held=held, prior=False)
    start = HandEyeState(
        state.flange_from_held @ Rigid.exp([3, -2, 4, 0.01, 0.02, -0.01]),
        state.base_from_fixed @ Rigid.exp([3, -2, 4, 0.01, 0.02, -0.01]),
        Rigid(np.broadcast_to(np.eye(3), (6, 3, 3)), np.zeros((6, 3))),
        state.internals,
    )
    found = minimise_blocks(problem, start).state
    assert np.abs((found.flange_from_held.inv @ state.flange_from_held).log()).max() < 1e-7
    assert np.abs(problem.residuals(found)).max() < 1e-8


def pixel_problem(rng, *, held, prior):
    """Return a problem of six views with its true state; with a prior the offsets are not nil."""
    lens = BrownConrady(k1=-0.1)
    camera = Camera.from_focal((1280, 960), 1200.0, lens=lens)
    points = np.append(rng.uniform(-100, 100, (20, 2)), rng.uniform(-20, 20, (20, 1)), axis=1)
    C = Rigid(so3.exp(0.3 * rng.normal(size=(6, 3))), [0, 0, 700] + 40 * rng.normal(size=(6, 3)))
    X, Z = random_rigid(rng), random_rigid(rng, reach=500.0)
    scale = 1.0 if prior else 0.0
    off = Rigid(so3.exp(scale * 0.05 * rng.normal(size=(6, 3))), scale * 3 * rng.normal(size=(6, 3)))
    B = Z @ (X @ (C if held else C.inv)).inv @ off.inv
    q = camera.project(points @ np.swapaxes(C.rotation, 1, 2) + C.translation[:, None])
    internals = np.append(internals_of(camera.K), list(lens.parameters.values()))
    covariance = np.zeros((len(internals),) * 2)
    covariance[[1, 3, 4, 5], [1, 3, 4, 5]] = [4.0, 1.0, 1.0, 1e-4]
    known = InternalsPrior.of(internals, covariance) if prior else InternalsPrior.fixed()
    views = PaddedViews.of(list(zip(np.broadcast_to(points, (6, 20, 3)), q, strict=True)))
    problem = HandEyePixels(views, B, held, lens, known, 0.1, np.array([0.2, 0.001]))
    return problem, HandEyeState(X, Z, off, internals)


def test_few_poses_widen_the_intervals_as_much_as_they_need(rng):
    """Four poses: 1.96 plain sigmas cover 88 %, the small-sample covariance with Student's t 93 % (of 150 cells).

    Here 40 cells of twelve coordinates: what is gained is seen on the same draws, at a loss of precision.
    """
    from scipy.special import stdtrit

    plain, widened = [], []
    for _ in range(40):
        poses, X, Z = random_poses(rng, 4, np.diag([0.01, 0.01, 0.09, 1e-7, 1e-7, 1e-7]), (0.2, 0.0005))
        fit = adjust(poses, X, Z)
        e = np.abs(np.append((fit.flange_from_held.inv @ X).log(), (fit.base_from_fixed.inv @ Z).log()))
        C = np.linalg.inv(fit.information)
        plain.append(e < 1.96 * np.sqrt(np.diag(C)))
        factor = stdtrit(np.minimum(fit.degrees_of_freedom, 1e6), 0.975)
        widened.append(e < factor * np.sqrt(np.diag(C + fit.small_sample)))
    assert np.mean(widened) > np.mean(plain) + 0.02
    assert 0.86 < np.mean(widened) < 0.99
