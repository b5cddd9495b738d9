"""Errors that viewpoints share, or do not: those of one joint calibration, and of poses known from elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.calibrate.joint.adjustment import calibrate_jointly
from cadcam.calibrate.measure.points import measure_points
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.camera.observations import Observations
from cadcam.camera.resampled import PictureMap
from cadcam.camera.sensitivity import project_with_sensitivity
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid

from .cell import BENCH, EYES, POINT, SIGMA, SIZE

STEP = Rigid.exp([250.0, -120.0, 60.0, 0.1, -0.15, 0.3])
CAMERA = EYES[0].camera
PLACES = (EYES[0].pose, EYES[0].pose @ STEP.inv, EYES[0].pose @ STEP)
CONTROL_MM = 0.5


@pytest.fixture(scope="module", params=[None, CONTROL_MM], ids=["targets known", "targets free"])
def calibrated(request: pytest.FixtureRequest) -> tuple[JointEstimate, float | None]:
    """One camera from three places by exact pixels, so that it is the true one with the covariance of noisy ones."""
    seen = [Observations(BENCH, CAMERA.project(w @ BENCH), sigma_px=SIGMA, source=f"{i}") for i, w in enumerate(PLACES)]
    return calibrate_jointly(seen, SIZE, guess=CAMERA, control_sigma=request.param), request.param


def test_a_point_seen_by_two_views_is_as_certain_as_one_adjustment_of_all_pixels_makes_it(
    calibrated: tuple[JointEstimate, float | None],
) -> None:
    """To 1e-5: the calibration's minimum is found to some 1e-5 sigma, and its Jacobians vary little over that."""
    joint, control_mm = calibrated
    views = [Viewpoint.fixed(f"{j}", joint.view(j)) for j in range(2)]
    q = np.array([CAMERA.project(w @ POINT[None]) for w in PLACES[:2]])
    said = measure_points(views, q).covariance[0]
    assert said == pytest.approx(in_one_adjustment(control_mm), rel=1e-5, abs=1e-5 * np.trace(said))
    alone = [Viewpoint.fixed(f"{j}", replace(joint.view(j), errors=())) for j in range(2)]
    assert measure_points(alone, q).covariance[0] != pytest.approx(said, rel=1e-3)  # as if calibrated twice


def in_one_adjustment(control_mm: float | None) -> Array:
    """Return the covariance (3, 3) of POINT from a dense adjustment of camera, poses, targets and the point."""
    targets = 0 if control_mm is None else 3 * len(BENCH)
    n = 5 + 6 * len(PLACES) + targets + 3
    rows = []
    for j, place in enumerate(PLACES):
        points = BENCH if j == 2 else np.vstack([BENCH, POINT])  # the point is not seen from the third place
        _, by = project_with_sensitivity(CAMERA, place, points)
        J = np.zeros((len(points), 2, n))
        J[..., :5], J[..., 5 + 6 * j : 11 + 6 * j] = by[..., 6:], by[..., :6]
        for i in range(len(BENCH) if targets else 0):
            at = 5 + 6 * len(PLACES) + 3 * i
            J[i, :, at : at + 3] = -by[i, :, :3]
        if j < 2:
            J[-1, :, -3:] = -by[-1, :, :3]
        rows.append(J.reshape(-1, n) / SIGMA)
    if control_mm is not None:
        known = np.zeros((targets, n))
        known[:, -3 - targets : -3] = np.eye(targets) / control_mm
        rows.append(known)
    R = np.linalg.qr(np.concatenate(rows), mode="r")  # the point comes last: its covariance is that of the last corner
    corner = np.linalg.inv(R[-3:, -3:])
    return np.asarray(corner @ corner.T)


def test_the_errors_that_a_view_s_estimate_names_are_its_covariance(
    calibrated: tuple[JointEstimate, float | None],
) -> None:
    joint, _ = calibrated
    for j in range(3):
        view = joint.view(j)
        total = sum(D @ s.covariance @ D.T for s, D in view.errors)
        size = np.sqrt(np.diag(view.cofactor)) * view.noise_px
        assert np.abs(total - view.cofactor * view.noise_px**2).max() <= 1e-12 * size.max() ** 2


def test_two_estimates_of_one_view_are_one_error_and_pictures_of_another_size_keep_it() -> None:
    seen = [Observations(BENCH, CAMERA.project(w @ BENCH), sigma_px=SIGMA, source=f"{i}") for i, w in enumerate(PLACES)]
    joint = calibrate_jointly(seen, SIZE, guess=CAMERA)
    once, again, other = (Viewpoint.fixed(name, joint.view(j)) for name, j in (("a", 0), ("b", 0), ("c", 1)))
    owners = [[source.owner for source, _ in view.errors] for view in (once, again, other)]
    assert [a is b for a, b in zip(owners[0], owners[1], strict=True)] == [True, True]
    assert [a is b for a, b in zip(owners[0], owners[2], strict=True)] == [True, False]
    halved = PictureMap((SIZE[0] // 2, SIZE[1] // 2), scale=(0.5, 0.5))
    smaller, by_estimate = halved.viewpoint(once), Viewpoint.fixed("d", halved.estimate(joint.view(0)))
    for (source, D), (same, E) in zip(smaller.errors, by_estimate.errors, strict=True):
        assert source.owner is same.owner
        np.testing.assert_allclose(E, D, rtol=1e-12)


def test_the_error_of_a_pose_is_its_viewpoint_s_own_unless_it_is_given_an_owner() -> None:
    """By what is given, not by whether it is the same object: one Rigid for two viewpoints is no common error."""
    rng, pose = np.random.default_rng(4), PLACES[1]
    one, known = EYES[0].calibrated(rng), np.diag([0.1**2] * 3 + [1e-4**2] * 3)

    def owners(*views: Viewpoint) -> list[object]:
        return [view.errors[1][0].owner for view in views]

    a, b = owners(*(Viewpoint.placed(name, one, pose, pose_covariance=known) for name in "ab"))
    assert a is not b
    cell = object()
    equal = Rigid(pose.rotation, pose.translation)
    a, b = owners(
        *(Viewpoint.placed(n, one, at, pose_covariance=known, pose_owner=cell) for n, at in (("a", pose), ("b", equal)))
    )
    assert a is b is cell


def test_two_covariances_of_one_owner_are_refused() -> None:
    """And not the first of them taken for both."""
    rng, known, cell = np.random.default_rng(4), np.diag([0.1**2] * 3 + [1e-4**2] * 3), object()
    views = [
        Viewpoint.placed(f"{i}", EYES[0].calibrated(rng), place, pose_covariance=(1 + i) * known, pose_owner=cell)
        for i, place in enumerate(PLACES[:2])
    ]
    q = np.array([CAMERA.project(w @ POINT[None]) for w in PLACES[:2]])
    with pytest.raises(BadValue, match="covariance of pose of 0 is another than that of pose of 1"):
        measure_points(views, q)
