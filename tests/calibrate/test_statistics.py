"""The uncertainty stated by an estimate, against sampling; and what least squares gains on the linear transform.

400 draws on the bench of Table 2.3: a standard deviation is known to 1/sqrt(2 * 400) = 3.5 %, a mean to 5 % of a sigma.
"""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import EXTERNALS, NAMES, ExtendedPinhole, uv_from_pixel_matrix
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.camera.sensitivity import project_with_sensitivity, rotation_by_angles
from cadcam.errors import UnknownName
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.dlt import dlt
from cadcam.fit.multistart import descend
from cadcam.geometry.rigid import Rigid

SIGMA, DRAWS = 0.5, 400
BENCH = np.array(
    [[x, y, z] for z in (-1040.0, -1410.0)
     for x, y in ((0, 80), (10, 220), (10, 400), (100, 140), (110, 300), (220, 230), (250, 80), (290, 400))]
)  # fmt: skip


@pytest.fixture(scope="module")
def truth():
    """The bench seen by the camera of Table 2.9, without noise."""
    d = np.radians
    e = ExtendedPinhole(7.7, 416.3, -210.4, d(-9.04), d(-9.44), d(-2.36), 1.007, 805.9, d(0.01), 319.7, 354.7)
    camera = e.camera((768, 576))
    q = camera.project(e.camera_from_world @ BENCH)
    return calibrate_camera(Observations(BENCH, q, sigma_px=SIGMA), (768, 576))


def draws(truth, free, rng):
    """Least-squares states (DRAWS, k) of noisy copies, each from the truth on: one model a draw."""
    states = []
    for _ in range(DRAWS):
        q = truth.observations.q + SIGMA * rng.normal(size=truth.observations.q.shape)
        model = CameraModel(BENCH, q, free, truth.camera.lens)
        start = model.state_of(truth.camera, truth.camera_from_world)
        states.append(descend(model, start[None], 12)[0][0])
    return model, np.array(states)


@pytest.fixture(scope="module")
def sampled(truth):
    """Parameters (DRAWS, 11) and poses of full calibrations."""
    model, states = draws(truth, NAMES, np.random.default_rng(11))
    poses = [model.pose(s) for s in states]
    values = [
        ExtendedPinhole.from_camera(model.camera(s, (768, 576)), T).vector for s, T in zip(states, poses, strict=True)
    ]
    return np.array(values), poses


def mahalanobis(samples, mean, covariance):
    d = samples - mean
    return np.sum(d * np.linalg.solve(covariance, d.T).T, axis=1)


def test_the_predicted_covariance_is_that_of_the_draws(truth, sampled):
    """Chi-square of 400 draws with 11 degrees of freedom each: mean 11, sd sqrt(22/400); 4 sigma, 2 % for curvature."""
    values, _ = sampled
    chi2 = mahalanobis(values, truth.values, truth.covariance)
    assert chi2.mean() == pytest.approx(11, abs=4 * np.sqrt(22 / DRAWS) + 0.22)
    sd = np.array([truth.sigma(n) for n in NAMES])
    assert values.std(axis=0) == pytest.approx(sd, rel=4 * 0.035)


def test_the_entries_of_the_camera_matrix_have_the_sigmas_of_the_draws(truth, sampled):
    """As above, 4 sigma of a standard deviation from 400 draws: one of fx needs the correlation of focal and aspect."""
    values, _ = sampled
    K = np.array([ExtendedPinhole.from_vector(v).camera((768, 576)).K for v in values])
    for name, (i, j) in {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}.items():
        assert truth.value(name) == pytest.approx(truth.camera.K[i, j], rel=1e-12)
        assert K[:, i, j].std() == pytest.approx(truth.sigma(name), rel=4 * 0.035)
    with pytest.raises(UnknownName, match=r"unknown parameter 'f0'.*cx, cy"):
        truth.sigma("f0")


def test_the_predicted_pose_covariance_is_that_of_the_draws(truth, sampled):
    _, poses = sampled
    xi = np.array([(truth.camera_from_world.inv @ T).log() for T in poses])
    chi2 = mahalanobis(xi, 0.0, truth.pose_covariance)
    assert chi2.mean() == pytest.approx(6, abs=4 * np.sqrt(12 / DRAWS) + 0.12)


def test_the_predicted_covariance_of_a_pose_alone_is_that_of_the_draws(truth):
    model, states = draws(truth, EXTERNALS, np.random.default_rng(12))
    pose = locate_camera(truth.observations, truth.camera)
    xi = np.array([(pose.camera_from_world.inv @ model.pose(s)).log() for s in states])
    assert mahalanobis(xi, 0.0, pose.pose_covariance).mean() == pytest.approx(6, abs=4 * np.sqrt(12 / DRAWS) + 0.12)


def test_the_predicted_covariance_of_a_projection_is_that_of_the_draws(truth, sampled):
    p = np.array([150.0, 250.0, -1250.0])
    values, poses = sampled
    q = np.array(
        [ExtendedPinhole.from_vector(v).camera((768, 576)).project(T @ p) for v, T in zip(values, poses, strict=True)]
    )
    predicted = truth.projection_covariance(p)
    assert np.cov(q.T) == pytest.approx(predicted, abs=4 * 0.05 * np.trace(predicted))


def test_the_covariance_is_the_inverse_of_the_fisher_information(truth):
    """Cramer and Rao's bound: J^T J / sigma^2, J by differences of projections in the thesis' own parameters."""

    def project(v):
        e = ExtendedPinhole.from_vector(v)
        return e.camera((768, 576)).project(e.camera_from_world @ BENCH).ravel()

    steps = 1e-5 * np.array([1, 1, 1, 1e-2, 1e-2, 1e-2, 1e-2, 1, 1e-2, 1, 1])
    J = np.stack(
        [(project(truth.values + h) - project(truth.values - h)) / (2 * h.sum()) for h in np.diag(steps)], axis=1
    )
    sd = np.sqrt(np.diag(truth.covariance))
    unit = (J.T @ J / SIGMA**2) @ truth.covariance
    assert unit * (1 / sd)[None, :] * sd[:, None] == pytest.approx(np.eye(11), abs=1e-4)


def test_least_squares_has_less_bias_than_the_linear_transform(truth, sampled):
    """The thesis' form shortens the focal length by about 5 px here (golden mcA.pos1.mean); least squares hardly."""
    values, _ = sampled
    rng = np.random.default_rng(11)
    linear = []
    for _ in range(DRAWS):
        q = truth.observations.q + SIGMA * rng.normal(size=truth.observations.q.shape)
        linear.append(ExtendedPinhole.from_matrix(uv_from_pixel_matrix(dlt(BENCH, q, form="c23"))).focal)
    bias_linear = np.mean(linear) - truth.value("focal")
    bias = values[:, NAMES.index("focal")].mean() - truth.value("focal")
    error_of_mean = truth.sigma("focal") / np.sqrt(DRAWS)
    assert bias_linear < -3.5
    assert abs(bias) < 4 * error_of_mean
    assert abs(bias) < abs(bias_linear) / 3


@pytest.mark.parametrize(("position", "draws_sigma"), [(1, 0.5122), (2, 0.6048)])
def test_the_linear_transform_states_the_spread_of_its_own_draws(golden, points, size, position, draws_sigma):
    """Tables 2.14 and 2.19: 2000 draws of the C23 = 1 form; first order against samples, 4 standard errors and 4 %."""
    o = points("2_7", position)
    estimate = calibrate_camera(Observations(o.p_world, o.q, sigma_px=draws_sigma), size, method="dlt-c23")
    sd = np.array([estimate.sigma(n) for n in NAMES])
    sd[[3, 4, 5, 8]] = np.degrees(sd[[3, 4, 5, 8]])
    entry = golden(f"mcA.pos{position}.sd")
    assert np.all(np.abs(sd - entry["value"]) <= np.array(entry["tol"]) + 0.04 * np.array(entry["value"]))


def test_least_squares_is_sharper_than_the_linear_transform(truth):
    o = truth.observations
    linear = calibrate_camera(o, (768, 576), method="dlt-c23")
    assert all(linear.sigma(n) >= truth.sigma(n) for n in NAMES)


def test_sigma0_estimates_the_noise(truth, rng):
    """sigma0^2 dof / sigma^2 is chi-square with 21 degrees of freedom: between 5.0 and 50 but for 4 in 10,000."""
    q = truth.observations.q + SIGMA * rng.normal(size=truth.observations.q.shape)
    estimate = calibrate_camera(Observations(BENCH, q), (768, 576))
    assert estimate.dof == 21
    assert 5.0 < estimate.sigma0**2 * 21 / SIGMA**2 < 50
    assert estimate.noise_px == estimate.sigma0
    assert estimate.thesis_residual == pytest.approx(estimate.rms_px * np.sqrt(2))


def test_without_degrees_of_freedom_the_sigmas_are_unknown_not_zero():
    """Four points with eight unknowns fit exactly: nothing tells the noise unless it is stated."""
    camera = Camera.from_focal((768, 576), 800.0)
    p = np.array([[0.0, 0, 0], [300, 0, 0], [300, 200, 0], [0, 200, 50]])
    pose = Rigid.look_at([-200.0, -400.0, 900.0], [150.0, 100.0, 0.0])
    q = camera.project(pose @ p)
    fixed = {"skew": 0.0, "aspect": 1.0, "U0": 287.5}
    unknown = calibrate_camera(Observations(p, q), (768, 576), fixed=fixed)
    stated = calibrate_camera(Observations(p, q, sigma_px=0.1), (768, 576), fixed=fixed)
    assert unknown.dof == 0
    assert unknown.sigma0 is None
    assert unknown.sigma("focal") == np.inf
    assert unknown.sigma("skew") == 0
    assert unknown.sigma("fx") == np.inf
    assert unknown.sigma("cy") == 0
    assert not np.isnan(unknown.covariance).any()
    assert not np.isnan(unknown.pose_covariance).any()
    assert not np.isnan(unknown.projection_covariance(p)).any()
    assert 0 < stated.sigma("focal") < np.inf
    assert np.isfinite(unknown.correlation).all()


def test_the_covariance_survives_gimbal_lock():
    """b = 90 deg: a and c cannot be told apart there, the pose can."""
    e = ExtendedPinhole(0, 0, 0, 0.3, np.pi / 2, 0, 1.0, 800.0, 0.0, 287.5, 383.5)
    camera, pose = e.camera((768, 576)), e.camera_from_world
    p = pose.inv @ (np.random.default_rng(1).uniform(-1, 1, (9, 3)) * [300, 200, 200] + [0, 0, 1000.0])
    estimate = locate_camera(Observations(p, camera.project(pose @ p), sigma_px=0.2), camera)
    straight = locate_camera(Observations(pose @ p, camera.project(pose @ p), sigma_px=0.2), camera)
    sd = np.sqrt(np.linalg.eigvalsh(estimate.pose_covariance))
    Ad = pose.adjoint()
    assert np.linalg.det(rotation_by_angles(pose.rotation)) == pytest.approx(0, abs=1e-9)
    assert Ad @ estimate.pose_covariance @ Ad.T == pytest.approx(
        straight.pose_covariance, rel=1e-6, abs=1e-6 * sd[0] ** 2
    )


def test_the_pixel_sensitivity_is_that_of_the_lens_and_pose(truth):
    """The Jacobian behind every covariance, against central differences of projections; relative 1e-7."""
    camera = Camera(truth.camera.size, truth.camera.K, BrownConrady(-0.1, 0.02, 0.001, -0.002))
    T = truth.camera_from_world
    _, J = project_with_sensitivity(camera, T, BENCH)
    h = 1e-4
    for axis in range(3):
        twist = np.zeros(6)
        twist[axis] = -h  # the focal centre moves against the world
        ahead = camera.project(T @ Rigid.exp(twist) @ BENCH)
        back = camera.project(T @ Rigid.exp(-twist) @ BENCH)
        assert (ahead - back) / (2 * h) == pytest.approx(J[..., axis], abs=1e-7 * np.abs(J[..., axis]).max())


def test_an_estimate_says_what_speaks_against_it(truth):
    """Two points outside a smaller picture, then so few points that their residuals hardly tell the noise."""
    assert truth.doubts == ()
    seen = truth.observations
    beyond = int((seen.q > [599.5, 449.5]).any(axis=1).sum())
    small = calibrate_camera(seen, (600, 450))
    assert small.doubts == (
        f"warning: {beyond} of 16 pixels lie outside the picture of 600 x 450 px: is it the right one?",
    )
    assert repr(small).endswith("1 doubt: see .doubts)")
    rng = np.random.default_rng(3)
    few = Observations(1e-3 * BENCH[[0, 1, 2, 5, 8, 11, 14]], seen.q[[0, 1, 2, 5, 8, 11, 14]] + rng.normal(size=(7, 2)))
    said = calibrate_camera(few, (768, 576)).doubts
    assert [d.partition(",")[0] for d in said] == [
        "warning: with 3 degrees of freedom the noise",
        "warning: the points span 0.37 mm: is their unit right? X_m",
    ]
