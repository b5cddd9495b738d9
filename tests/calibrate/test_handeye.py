"""Hand-eye calibration on simulated cells: exact to the pixels' noise, honest about the robot's."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye, calibrate_hand_eye_from_poses
from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.report.handeye import pose_table, quality_notes

from .robots import CAMERA, cell, target_poses

MOUNTINGS = ["eye-in-hand", "eye-to-hand"]


def solved(c, **options):
    return calibrate_hand_eye(c.base_from_flange, c.observations, c.camera, mounting=c.mounting, **options)


def camera_pose(estimate):
    return estimate.flange_from_camera if estimate.mounting == "eye-in-hand" else estimate.base_from_camera


def target_pose(estimate):
    return estimate.base_from_target if estimate.mounting == "eye-in-hand" else estimate.flange_from_target


def error(estimate, c):
    return (camera_pose(estimate).inv @ c.camera_pose).log()


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_exact_robot_and_pixels_give_the_cell_back(rng, mounting):
    """1e-6 mm and rad: the pixels are exact to 1e-13 of 1000, and the adjustment stops where rounding rules."""
    c = cell(rng, 6, mounting=mounting, noise_px=0.0)
    found = solved(c)
    assert np.abs(error(found, c)).max() < 1e-6
    assert np.abs((target_pose(found).inv @ c.target_pose).log()).max() < 1e-6


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_an_exact_robot_is_found_to_be_exact_and_the_pixels_limit_is_reached(rng, mounting):
    """The predicted sigma is that of pixels alone, and the errors keep to it: chi-square of 6, mean of 5 cells."""
    squares, sigmas = [], []
    for _ in range(5):
        c = cell(rng, 12, mounting=mounting, noise_px=0.1)
        found = solved(c)
        assert found.robot_noise.translation < 0.05
        assert found.robot_noise.rotation < 2e-4  # a picture alone knows the target's tilt to 3e-4
        sigmas.append(np.sqrt(np.diag(found.covariance_of_camera))[:3].max())
        squares.append(error(found, c) @ np.linalg.solve(found.covariance_of_camera, error(found, c)))
    assert np.median(sigmas) < 0.05  # mm at 700 mm: 0.1 px is 0.06 mm a corner, and there are 54 x 12
    assert np.mean(squares) < 6 + 4 * np.sqrt(12 / 5)


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_with_a_noisy_robot_the_camera_stays_within_its_sigmas(rng, mounting):
    c = cell(rng, 20, mounting=mounting, robot=(0.3, 0.001))
    found = solved(c)
    assert (np.abs(error(found, c)) < 4 * np.sqrt(np.diag(found.covariance_of_camera))).all()
    assert found.robot_noise.translation == pytest.approx(0.3, abs=4 * found.robot_noise.translation_sigma)
    assert found.robot_noise.rotation == pytest.approx(0.001, abs=4 * found.robot_noise.rotation_sigma)


def coverage(rng, cells, n, robot):
    """Return the share of the camera's six coordinates within 1.96 sigma over cells of both mountings."""
    inside = []
    for k in range(cells):
        c = cell(rng, n, mounting=MOUNTINGS[k % 2], robot=robot)
        found = solved(c)
        factor = found.coverage_factor(0.95)
        inside.append(np.abs(error(found, c)) < factor * np.sqrt(np.diag(found.covariance_of_camera)))
    return float(np.mean(inside))


@pytest.mark.parametrize("robot", [(0.0, 0.0), (0.2, 0.0005)], ids=["exact robot", "noisy robot"])
def test_the_intervals_cover(rng, robot):
    """16 cells of six coordinates, counted as 32 independent ones: four binomial sigmas below 95 %."""
    assert coverage(rng, 16, 8, robot) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / 32)


@pytest.mark.slow
@pytest.mark.parametrize("n", [8, 15, 30])
@pytest.mark.parametrize("robot", [(0.0, 0.0), (0.2, 0.0005)], ids=["exact robot", "noisy robot"])
def test_the_intervals_cover_93_to_97_percent(rng, robot, n):
    assert 0.93 <= coverage(rng, 500, n, robot) <= 0.97


def test_robot_noise_does_not_corrupt_a_camera_adjusted_along(rng):
    """With its own covariance as prior the camera moves less than 2 sigma though the robot is off by 5 px."""
    points = np.append(rng.uniform(-150, 150, (40, 2)), rng.uniform(-60, 60, (40, 1)), axis=1)
    pose = Rigid(so3.exp([0.2, -0.1, 0.1]), [0.0, 0, 700])
    q = CAMERA.project(pose @ points) + 0.1 * rng.normal(size=(40, 2))
    known = calibrate_camera(Observations(points, q), CAMERA.size, fixed={"skew": 0.0, "aspect": 1.0})
    c = cell(rng, 15, robot=(1.0, 0.003))
    found = calibrate_hand_eye(c.base_from_flange, c.observations, known, mounting="eye-in-hand")
    assert found.camera is not None
    moved = np.array(
        [found.camera.fy - known.camera.fy, *(found.camera.principal_point - known.camera.principal_point)]
    )
    sigma = np.array([known.sigma("focal"), known.sigma("V0"), known.sigma("U0")])
    assert (np.abs(moved) < 2 * sigma).all()
    assert (np.abs(error(found, c)) < 4 * np.sqrt(np.diag(found.covariance_of_camera))).all()
    assert abs(found.camera.fy - CAMERA.fy) < abs(known.camera.fy - CAMERA.fy) + sigma[0]


def test_a_wrong_focal_length_costs_less_with_its_covariance_than_without(rng):
    """Internals within a prior are moved by what the views themselves say; held, they spoil the camera's place."""
    points = np.append(rng.uniform(-150, 150, (12, 2)), rng.uniform(-10, 10, (12, 1)), axis=1)
    pose = Rigid(so3.exp([0.2, -0.1, 0.1]), [0.0, 0, 900])
    q = CAMERA.project(pose @ points) + 1.0 * rng.normal(size=(12, 2))
    poor = calibrate_camera(Observations(points, q), CAMERA.size, fixed={"skew": 0.0, "aspect": 1.0})
    assert abs(poor.camera.fy - CAMERA.fy) > 10
    c = cell(rng, 12)
    adjusted = calibrate_hand_eye(c.base_from_flange, c.observations, poor, mounting="eye-in-hand")
    held = calibrate_hand_eye(c.base_from_flange, c.observations, poor.camera, mounting="eye-in-hand")
    assert np.linalg.norm(error(adjusted, c)[:3]) < 0.1 * np.linalg.norm(error(held, c)[:3])
    assert (np.abs(error(adjusted, c)) < 4.5 * np.sqrt(np.diag(adjusted.covariance_of_camera))).all()


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_poses_with_their_covariance_say_nearly_what_pixels_say(rng, mounting):
    """To first order they are the same problem: answers within a tenth of a sigma, sigmas within 2 %."""
    c = cell(rng, 12, mounting=mounting, robot=(0.2, 0.0005))
    pixels = solved(c)
    seen = pixels.camera_from_target
    cov = np.stack([pose_covariance(c.camera, C, c.points, pixels.noise_px) for C in seen.matrix])
    poses = calibrate_hand_eye_from_poses(c.base_from_flange, seen, mounting=mounting, covariance=cov)
    sigma = np.sqrt(np.diag(pixels.covariance_of_camera))
    assert (np.abs((camera_pose(poses).inv @ camera_pose(pixels)).log()) < 0.1 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.diag(poses.covariance_of_camera)), sigma, rtol=0.02)


def pose_covariance(camera, matrix, points, noise):
    from cadcam.fit.many_poses import pose_jacobian

    C = Rigid.from_matrix(matrix)
    _, J = pose_jacobian(camera, C.rotation[None], C.translation[None], points[None])
    J = J.reshape(-1, 6)
    return noise**2 * np.linalg.inv(J.T @ J)


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_poses_alone_are_enough(rng, mounting):
    c = cell(rng, 15, mounting=mounting, robot=(0.3, 0.001))
    found = calibrate_hand_eye_from_poses(c.base_from_flange, c.camera_from_target, mounting=mounting)
    assert (np.abs(error(found, c)) < 4 * np.sqrt(np.diag(found.covariance_of_camera))).all()
    assert found.noise_px is None
    assert np.isnan(found.held_out.px).all()
    np.testing.assert_allclose(found.offsets[:, :3], offsets(found, c)[:, :3], atol=1e-9)


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_exact_poses_give_the_cell_back(rng, mounting):
    c = cell(rng, 5, mounting=mounting)
    found = calibrate_hand_eye_from_poses(c.base_from_flange, c.camera_from_target, mounting=mounting)
    assert np.abs(error(found, c)).max() < 1e-8
    assert not found.suspicious.any()


def offsets(found, c):
    S = c.camera_from_target if c.mounting == "eye-in-hand" else c.camera_from_target.inv
    T = c.base_from_flange.inv @ found.base_from_fixed @ (found.flange_from_held @ S).inv
    return np.concatenate([T.translation, so3.log(T.rotation)], axis=1)


def test_the_held_out_error_is_that_of_calibrating_without_the_pose(rng):
    """One linear step against a calibration anew (whose noise estimate differs a little): within 10 %."""
    c = cell(rng, 10, robot=(0.3, 0.001))
    found = solved(c)
    for i in (0, 7):
        keep = np.delete(np.arange(10), i)
        rest = calibrate_hand_eye(
            Rigid(c.base_from_flange.rotation[keep], c.base_from_flange.translation[keep]),
            [c.observations[k] for k in keep],
            c.camera,
            mounting="eye-in-hand",
        )
        B = Rigid(c.base_from_flange.rotation[i], c.base_from_flange.translation[i])
        C = rest.flange_from_camera.inv @ B.inv @ rest.base_from_target
        off = c.camera.project(C @ c.points) - c.observations[i].q
        assert found.held_out.px[i] == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=1))), rel=0.1)


def test_poses_without_which_nothing_is_determined_are_predicted_by_none(rng):
    """Two poses determine nothing: what three leave over of each other is no held-out error."""
    c = cell(rng, 3, robot=(0.3, 0.001))
    found = solved(c)
    for name in ("px", "mm", "rotation"):
        assert np.isnan(getattr(found.held_out, name)).all(), name
    assert np.isnan(found.held_out.rms).all()
    assert (found.held_out.chance == 1).all()
    assert "do not determine the solution, so none is predicted" in " ".join(quality_notes(found))
    assert not any("nan" in cell for row in pose_table(found).rows for cell in row)


def test_flips_of_a_small_flat_target_are_told_apart_by_the_robot(rng):
    """A square of 40 mm at 0.7 m, 0.3 px: the picture alone takes the wrong pose in some of 20 views."""
    square = np.array([[-20.0, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0]])
    C = target_poses(rng, 20, tilt=0.25, points=square)
    c = cell(rng, mounting="eye-to-hand", camera_from_target=C, points=square, noise_px=0.3, robot=(0.05, 0.0002))
    found = solved(c)
    assert found.second_pose.any()
    turn = np.linalg.norm(so3.log(np.swapaxes(found.camera_from_target.rotation, 1, 2) @ C.rotation), axis=1)
    first = np.degrees(turn)
    assert first.max() < 12  # the better of both; flips are off by up to twice the tilt, 28 deg
    assert (np.abs(error(found, c)) < 4 * np.sqrt(np.diag(found.covariance_of_camera))).all()


@pytest.mark.parametrize("size", [0.98, 1.03])
def test_a_target_of_another_size_than_stated_is_noticed(rng, size):
    c = cell(rng, 12, robot=(0.1, 0.0003))
    wrong = [Observations(size * o.p_world, o.q) for o in c.observations]
    found = calibrate_hand_eye(c.base_from_flange, wrong, c.camera, mounting=c.mounting)
    assert found.scale == pytest.approx(1 / size, abs=4 * found.scale_sigma)
    assert abs(found.scale - 1) > 4 * found.scale_sigma
    assert any("the target is" in doubt and "check its size" in doubt for doubt in found.doubts)
    assert repr(found).endswith("1 doubt: see .doubts)")
    right = solved(c)
    assert abs(right.scale - 1) < 4 * right.scale_sigma
    assert right.doubts == ()
    assert "doubt" not in repr(right)


def test_metres_in_place_of_millimetres_are_doubted(rng):
    """Robot and target alike, so that nothing contradicts: the camera's place would be in metres and called mm."""
    c = cell(rng, 8)
    metres = Rigid(c.base_from_flange.rotation, c.base_from_flange.translation / 1000)
    seen = [Observations(o.p_world / 1000, o.q) for o in c.observations]
    found = calibrate_hand_eye(metres, seen, c.camera, mounting=c.mounting)
    assert any("the robot moved by" in doubt and "in mm?" in doubt for doubt in found.doubts)
    assert not any("in mm?" in doubt for doubt in solved(c).doubts)


def test_where_the_camera_is_comes_with_the_robots_noise(rng):
    """Eye-in-hand: over cells, the camera's true place at a new pose keeps to the stated covariance."""
    squares = []
    for _ in range(6):
        c = cell(rng, 10, robot=(0.2, 0.0005))
        found = solved(c)
        stated = Rigid(so3.exp(0.3 * rng.normal(size=3)), rng.uniform(-300, 300, 3))
        true = stated @ Rigid(so3.exp(0.0005 * rng.normal(size=3)), 0.2 * rng.normal(size=3)) @ c.flange_from_held
        place, covariance = found.base_from_camera_at(stated)
        e = (place.inv @ true).log()
        squares.append(e @ np.linalg.solve(covariance, e))
    assert np.mean(squares) < 6 + 4 * np.sqrt(12 / 6)


def test_what_another_mounting_has_is_refused_by_name(rng):
    found = solved(cell(rng, 6))
    with pytest.raises(BadValue, match="flange_from_camera"):
        _ = found.base_from_camera
    with pytest.raises(BadValue, match="base_from_target"):
        _ = found.flange_from_target


def test_views_may_show_different_points(rng):
    c = cell(rng, 10)
    some = [Observations(o.p_world[k:], o.q[k:]) for k, o in enumerate(c.observations)]
    found = calibrate_hand_eye(c.base_from_flange, some, c.camera, mounting=c.mounting)
    assert (np.abs(error(found, c)) < 4 * np.sqrt(np.diag(found.covariance_of_camera))).all()


def test_a_lens_and_a_skew_are_part_of_the_camera(rng):
    from cadcam.camera.lens import BrownConrady

    camera = Camera.from_focal((1280, 960), 1100.0, fy=1130.0, skew=4.0, lens=BrownConrady(k1=-0.15, k2=0.02))
    c = cell(rng, 8, camera=camera)
    assert (np.abs(error(solved(c), c)) < 4 * np.sqrt(np.diag(solved(c).covariance_of_camera))).all()
