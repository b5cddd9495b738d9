"""A pose of which a turn cannot be determined says so, and all else as surely as if there were no such turn."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid

PLACE = np.array([300.0, -200, 100])


def turns(point: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the twists (6, k) of turns about axes (k, 3) through a point."""
    return np.concatenate([np.cross(point, axes), axes], axis=1).T


def test_what_is_determined_is_known_as_without_the_turn_that_is_not(rng: np.random.Generator) -> None:
    turn = turns(PLACE, np.array([[0.6, 0, 0.8]]))
    across = np.linalg.svd(turn)[0][:, 1:]
    A = across @ rng.normal(size=(5, 5))
    noise, calibration = A @ A.T, across @ across.T
    whole = PoseEstimate(Rigid(), noise + 3.3 * turn @ turn.T, calibration, undetermined=turn)
    known = whole.determined
    assert known.from_noise == pytest.approx(noise, abs=1e-9 * 3.3 * 360**2)  # the turn's part, rounded
    assert known.from_calibration == pytest.approx(calibration, abs=1e-12)
    assert known.freedom.shape == (6, 5)
    assert np.abs(turn.T @ known.freedom).max() < 1e-10 * 360
    assert not known.undetermined_words
    assert PoseEstimate(Rigid(), noise).determined.from_noise is not None


def test_nothing_is_left_where_only_that_turn_was_free() -> None:
    turn = turns(PLACE, np.array([[0.0, 0, 1]]))
    free = np.linalg.qr(turn)[0]
    known = PoseEstimate(Rigid(), free @ free.T, freedom=free, undetermined=turn).determined
    assert known.freedom.shape == (6, 0)
    assert np.abs(known.covariance).max() < 1e-12


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ([[0, 0, -1]], "the turn about the axis (0, 0, 1) through (300, -200, 0) mm of the part"),
        ([[1, 0, 0], [0, 1, 0]], "the turn about the axes (1, 0, 0) and (0, 1, 0) through (300, -200, 100) mm"),
        (np.eye(3), "the turn about any axis through (300, -200, 100) mm of the part"),
    ],
)
def test_the_turn_is_named_by_its_axis_and_a_place_on_it(axes: list[list[float]], words: str) -> None:
    estimate = PoseEstimate(Rigid(), np.eye(6), undetermined=turns(PLACE, np.array(axes, float)))
    assert estimate.undetermined_words.startswith(words)


def test_a_point_of_the_part_varies_as_small_motions_move_it(rng: np.random.Generator) -> None:
    """World_from_part @ exp(xi), by central differences: exact but for rounding, as exp is odd to second order."""
    root, points = rng.normal(size=(6, 6)) * 1e-3, rng.normal(scale=100.0, size=(4, 3))
    pose = PoseEstimate(Rigid.exp(rng.normal(size=6)), root @ root.T)
    steps = [(Rigid.exp(1e-5 * xi) @ points - Rigid.exp(-1e-5 * xi) @ points) / 2e-5 for xi in np.eye(6)]
    J = np.stack(steps, axis=-1)
    np.testing.assert_allclose(pose.point_covariance(points), J @ pose.covariance @ J.swapaxes(1, 2), rtol=1e-6)
