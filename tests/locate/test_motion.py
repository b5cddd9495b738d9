"""The filter foretells even motion, follows sudden motion, and says how sure it is: rightly where errors repeat."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.locate.track.motion import MotionFilter

CENTRE, RADIUS = np.array([30.0, 20.0, 10.0]), 40.0
FIRST = Rigid.exp([-20.0, 5.0, 400.0, 0.4, 0.2, -0.3])
STEP = Rigid.exp([4.0, 0.5, -3.0, 0.02, -0.03, 0.01])
SIGMA = np.diag([0.1, 0.1, 0.5, 0.004, 0.004, 0.002]) ** 2  # weak in depth, as one camera is


def error(of: PoseEstimate, truth: Rigid) -> Array:
    return (truth.inv @ of.world_from_part).log()


def normalised(of: PoseEstimate, truth: Rigid) -> float:
    """Return the square of the error in its own standard deviations: 6 on average where the covariance is right."""
    e = error(of, truth)
    return float(e @ np.linalg.solve(of.covariance, e))


def draws(n: int, rng: np.random.Generator) -> Array:
    return rng.multivariate_normal(np.zeros(6), SIGMA, n)


def moved(n: int, uneven_mm: float, rng: np.random.Generator) -> list[Rigid]:
    """Return a motion whose velocity changes by `uneven_mm` each frame, about the part's middle."""
    middle, v, T = Rigid(np.eye(3), CENTRE), (Rigid(np.eye(3), -CENTRE) @ STEP @ Rigid(np.eye(3), CENTRE)).log(), FIRST
    scale, out = np.repeat([1.0, RADIUS], 3), [FIRST]
    for _ in range(n - 1):
        w = uneven_mm * rng.normal(size=6) / scale
        T = T @ middle @ Rigid.exp(v + 0.5 * w) @ middle.inv
        v = v + w
        out.append(T)
    return out


def test_even_motion_measured_exactly_is_foretold_to_rounding() -> None:
    motion, T = MotionFilter(CENTRE, RADIUS), FIRST
    exact = 1e-12 * np.eye(6)
    for k in range(30):
        motion.measured(k, PoseEstimate(T, exact))
        T = T @ STEP
    ahead = motion.predicted(30)
    assert ahead is not None
    np.testing.assert_allclose(error(ahead, T), 0, atol=1e-6)


def test_nothing_is_foretold_after_a_gap() -> None:
    motion = MotionFilter(CENTRE, RADIUS)
    assert motion.predicted(0) is None
    motion.measured(0, PoseEstimate(FIRST, SIGMA))
    assert motion.predicted(1) is not None
    assert motion.predicted(2) is None
    motion.forget()
    assert motion.predicted(1) is None


@pytest.mark.parametrize(("uneven_mm", "share"), [(0.02, 0.3), (0.3, 0.85)])
def test_filtered_poses_are_steadier_and_what_is_foretold_is_as_sure_as_told(uneven_mm: float, share: float) -> None:
    """Fresh errors in each frame: the mean square of what a frame is off the foretold pose, in sds of both, is 6.

    Over 25 runs of 10 late frames its own sd is about 6 sqrt(2/6/250) = 0.2, more as frames of a run go together; a
    filter that does not find out how unevenly the part moves is off by a factor. share: of a frame's own square error
    in depth that is left: little where the motion is even, most where it is not.
    """
    rng = np.random.default_rng(1)
    told, raw, filtered = [], [], []
    for _ in range(25):
        motion = MotionFilter(CENTRE, RADIUS)
        for k, (T, e) in enumerate(zip(moved(30, uneven_mm, rng), draws(30, rng), strict=True)):
            Z = PoseEstimate(T @ Rigid.exp(e), SIGMA)
            ahead = motion.predicted(k)
            after = motion.measured(k, Z)
            if k >= 20:
                assert ahead is not None
                y = error(ahead, Z.world_from_part)
                told.append(y @ np.linalg.solve(ahead.covariance + SIGMA, y))
                raw.append(e[2] ** 2)
                filtered.append(error(after, T)[2] ** 2)
    assert 0.75 < np.mean(told) / 6 < 1.33
    assert np.mean(filtered) < share * np.mean(raw)


def test_errors_that_repeat_in_every_frame_do_not_average_out_and_the_covariance_says_so() -> None:
    """Each run has one error in all its frames: 80 runs, chi2 of 6 degrees, sd of the mean 0.4."""
    rng = np.random.default_rng(2)
    squares = []
    for e in draws(80, rng):
        motion = MotionFilter(CENTRE, RADIUS)
        for k, T in enumerate(moved(8, 0.02, rng)):
            last = motion.measured(k, PoseEstimate(T @ Rigid.exp(e), SIGMA))
        squares.append(normalised(last, T))
    assert 4.8 < np.mean(squares) < 7.2


def test_a_sudden_stop_is_followed_within_two_frames() -> None:
    """5 mm a frame, then nothing: errors are 0.02 mm, so the frames must win over what is foretold."""
    motion, T = MotionFilter(CENTRE, RADIUS), FIRST
    sure = PoseEstimate(T, SIGMA * 0.04)
    for k in range(20):
        T = T @ STEP if k < 17 else T
        last = motion.measured(k, PoseEstimate(T, sure.from_noise))
    assert np.linalg.norm(last.world_from_part @ CENTRE - T @ CENTRE) < 0.3


def test_a_restricted_motion_stays_restricted() -> None:
    """Along z alone: nothing is foretold, nor believed, in other directions."""
    motion = MotionFilter(CENTRE, RADIUS)
    along = np.eye(6)[:, 2:3]
    for k in range(10):
        T = Rigid(np.eye(3), [0.0, 0.0, 400.0 + 3.0 * k])
        last = motion.measured(k, PoseEstimate(T, 0.04 * along @ along.T, freedom=along))
    ahead = motion.predicted(10)
    assert ahead is not None
    for pose in (last, ahead):
        np.testing.assert_allclose(pose.world_from_part.rotation, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(pose.world_from_part.translation[:2], 0, atol=1e-9)
        across = pose.covariance - along @ along.T * pose.covariance[2, 2]
        np.testing.assert_allclose(across, 0, atol=1e-12)


def test_the_calibration_s_share_is_the_same_in_every_frame() -> None:
    motion = MotionFilter(CENTRE, RADIUS)
    for k in range(10):
        last = motion.measured(k, PoseEstimate(FIRST, SIGMA, 2 * SIGMA))
    np.testing.assert_array_equal(last.from_calibration, 2 * SIGMA)
