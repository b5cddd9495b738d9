"""Predicted uncertainty is that of measuring: of the measuring room's own propagation, and of trials."""

from __future__ import annotations

import numpy as np
import pytest

import cadcam
from cadcam.arrays import Array
from cadcam.camera.error_source import ErrorSource
from cadcam.geometry.plane import Plane
from cadcam.plan.uncertainty.predict import predict_points

POINTS = np.array([[0.0, 0, 0], [300, -200, 50], [-250, 150, -80], [100, 220, 400]])
SIGMA = 0.08


def viewpoints(n: int = 3, *, shared: bool = False) -> list[cadcam.Viewpoint]:
    """Return cameras around the points with errors of their own, or of one calibration for all."""
    camera = cadcam.Camera.from_focal((1600, 1200), 2000.0)
    sd = np.array([0.4, 0.4, 0.4, 2e-4, 2e-4, 2e-4, 1e-4, 0.5, 1e-5, 0.6, 0.6])
    owner = object()
    out = []
    for i, angle in enumerate(np.linspace(-0.5, 0.6, n)):
        eye = 3000 * np.array([np.sin(angle), -np.cos(angle), 0.3 + 0.1 * i])
        pose = cadcam.Rigid.look_at(eye, np.zeros(3))
        source = ErrorSource("calibration", np.diag(sd**2), owner if shared else object())
        out.append(cadcam.Viewpoint(f"c{i}", camera, pose, SIGMA, ((source, np.eye(11)),)))
    return out


def pixels(views: list[cadcam.Viewpoint]) -> Array:
    return np.stack([v.camera.project(v.camera_from_world @ POINTS) for v in views])


@pytest.mark.parametrize("shared", [False, True], ids=["own calibrations", "one calibration"])
def test_prediction_is_the_covariance_that_measuring_states(shared: bool) -> None:
    views = viewpoints(shared=shared)
    measured = cadcam.measure_points(views, pixels(views))
    predicted = predict_points(views, POINTS)
    np.testing.assert_allclose(predicted.covariance, measured.covariance, rtol=1e-6, atol=1e-12)
    budget = measured.budget()
    for cause, covariance in predicted.by_cause.items():
        own = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        np.testing.assert_allclose(own, budget[cause], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("height", [0.0, 0.5])
def test_one_camera_on_a_known_plane_is_predicted_as_it_is_measured(height: float) -> None:
    view = viewpoints(1)
    plane = Plane.through([0, 0, 0], [0.1, 0.2, 1])
    on_plane = plane.foot(POINTS)
    q = view[0].camera.project(view[0].camera_from_world @ on_plane)[None]
    measured = cadcam.measure_points(view, q, plane=plane, plane_sigma_mm=height)
    predicted = predict_points(view, on_plane, plane=plane, plane_sigma_mm=height)
    np.testing.assert_allclose(predicted.sigma, measured.sigma, rtol=1e-5)


def test_predicted_covariance_is_the_spread_of_trials_with_noise_of_any_shape() -> None:
    rng = np.random.default_rng(3)
    views = viewpoints(3)
    stretched = np.zeros((3, len(POINTS), 2, 2))
    for v in range(3):
        A = rng.normal(size=(len(POINTS), 2, 2)) * 0.1
        stretched[v] = A @ np.swapaxes(A, -1, -2) + 0.02**2 * np.eye(2)
    predicted = predict_points(views, POINTS, noise=stretched)
    trials = np.array([_trial(views, stretched, rng) for _ in range(600)])
    for i in range(len(POINTS)):
        spread = np.cov(trials[:, i].T)
        L = np.linalg.cholesky(predicted.covariance[i])
        whitened = np.linalg.solve(L, np.linalg.solve(L, spread).T)
        # the eigenvalues of a covariance of n trials of 3 numbers: (1 +- sqrt(3/n))^2 (Marchenko and Pastur), and a
        # margin of as much again
        assert np.abs(np.sqrt(np.linalg.eigvalsh(whitened)) - 1).max() < 2 * np.sqrt(3 / len(trials))


def _trial(views: list[cadcam.Viewpoint], noise: Array, rng: np.random.Generator) -> Array:
    """Return the points that a weighted least squares finds from true pixels of cameras that err."""
    q, J = [], []
    for v, view in enumerate(views):
        _, by_point, effects = view.project(POINTS)
        error = sum(
            D @ source.root @ rng.normal(size=len(source.covariance))
            for (source, _), D in zip(view.errors, effects, strict=True)
        )
        own = np.linalg.cholesky(noise[v]) @ rng.normal(size=(len(POINTS), 2, 1))
        q.append(np.asarray(error) + own[..., 0])
        J.append(by_point)
    # the total covariance of each picture's pixels decides the weights, as in measuring
    total = []
    for v, view in enumerate(views):
        _, _, effects = view.project(POINTS)
        S = noise[v].copy()
        for (source, _), D in zip(view.errors, effects, strict=True):
            S += D @ source.covariance @ np.swapaxes(D, -1, -2)
        total.append(np.linalg.inv(S))
    A = sum(np.swapaxes(j, -1, -2) @ W @ j for j, W in zip(J, total, strict=True))
    b = sum(np.swapaxes(j, -1, -2) @ W @ e[..., None] for j, W, e in zip(J, total, q, strict=True))
    return np.asarray(np.linalg.solve(A, b)[..., 0])


def test_a_point_of_one_camera_without_a_plane_cannot_be_measured() -> None:
    seen = np.ones((3, len(POINTS)), bool)
    seen[1:, 0] = False
    predicted = predict_points(viewpoints(3), POINTS, seen=seen)
    assert np.isnan(predicted.covariance[0]).all()
    assert np.isfinite(predicted.covariance[1:]).all()
    assert predicted.cameras.tolist() == [1, 3, 3, 3]


def test_noise_that_is_none_and_planes_that_are_several_are_refused() -> None:
    views = viewpoints()
    noise = np.tile(SIGMA**2 * np.eye(2), (3, len(POINTS), 1, 1))
    noise[1, 2] = np.diag([SIGMA**2, 0.0])
    with pytest.raises(cadcam.errors.BadValue, match=r"noise\[1, 2\]"):
        predict_points(views, POINTS, noise=noise)
    several = Plane(np.eye(3), np.zeros(3))
    for call in (predict_points, cadcam.measure_points):
        with pytest.raises(cadcam.errors.BadValue, match="one plane for all"):
            call(views, POINTS if call is predict_points else pixels(views), plane=several)
