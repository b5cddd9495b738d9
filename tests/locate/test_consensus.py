"""The agreed pose: exact from exact matches, indifferent to wrong ones, with the covariance that its inputs give."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array, Ids
from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import camera_of
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.camera.viewpoint import Viewpoint
from cadcam.geometry.rigid import Rigid
from cadcam.locate.match.consensus import PlaceCandidates, _triples, consensus, pose_of_matches
from cadcam.locate.photo import Photo

from .scene import CAMERA, off, pose_of

SIGMA = 0.2


def blank(viewpoint: Viewpoint | None = None) -> Photo:
    gray = np.zeros((480, 640), np.float32)
    return Photo.of(gray, CAMERA) if viewpoint is None else Photo(gray, viewpoint)


def points(rng: np.random.Generator, n: int) -> Array:
    return rng.uniform([0, 0, 0], [600, 400, 250], size=(n, 3))


def sought(
    truth: Rigid, p: Array, right: Array, wrong: int, rng: np.random.Generator, *, hidden: int = 0
) -> PlaceCandidates:
    """Return the right place of every feature, less hidden ones, among wrong ones anywhere within 45 px."""
    n = len(p)
    q = CAMERA.project(truth @ p)
    side = CAMERA.project(truth @ right) - q
    angle = np.arctan2(side[:, 1], side[:, 0])
    feature = np.concatenate([np.arange(hidden, n), np.repeat(np.arange(n), wrong)]).astype(np.int32)
    noisy = q[hidden:] + rng.normal(scale=SIGMA, size=(n - hidden, 2))
    anywhere = q[feature[n - hidden :]] + rng.uniform(-45, 45, size=(n * wrong, 2))
    angles = np.concatenate([angle[hidden:], rng.uniform(-0.3, 0.3, n * wrong)])
    score = np.concatenate([rng.uniform(0.4, 0.9, n - hidden), rng.uniform(0.4, 0.9, n * wrong)])
    covariance = np.tile(SIGMA**2 * np.eye(2), (len(feature), 1, 1))
    photo: Ids = np.zeros(n, np.int32)
    at = np.concatenate([noisy, anywhere])
    return PlaceCandidates(feature, at, angles, covariance, score, p, right, photo, 45.0, 0.35)


def level(truth: Rigid, p: Array) -> Array:
    """Return the points one mm beside others that the picture shows to their right."""
    return p + truth.rotation[0]


def test_half_the_features_hidden_and_three_wrong_places_each_are_survived(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    p = points(rng, 24)
    candidates = sought(truth, p, level(truth, p), 3, rng, hidden=12)
    start = off(truth, rng, degrees=4, px=10)
    found = consensus(candidates, [blank()], start, tolerance=4.0, rng=rng)
    assert found is not None
    assert found.by_chance < 1e-2
    assert set(range(12)) <= set(found.chosen.tolist())  # the right places stand first
    assert np.abs((found.world_from_part.inv @ truth).log()[3:]).max() < 0.005


def test_places_at_random_agree_on_nothing(rng: np.random.Generator) -> None:
    """Over 20 draws, a threshold of 0.01 poses by chance is passed in one test of five, if it is true."""
    passed = 0
    for _ in range(20):
        truth = pose_of(rng)
        p = points(rng, 20)
        nothing = sought(truth, p, level(truth, p), 3, rng, hidden=20)
        found = consensus(nothing, [blank()], truth, tolerance=5.0, rng=rng)
        passed += found is not None and found.by_chance < 1e-2
    assert passed <= 1


def test_exact_matches_give_the_exact_pose(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    p = points(rng, 10)
    C = np.tile(1e-4 * np.eye(2), (10, 1, 1))
    pose = pose_of_matches(
        [blank()], np.zeros(10, np.int32), p, CAMERA.project(truth @ p), C, off(truth, rng, degrees=5, px=9)
    )
    assert np.abs((pose.world_from_part.inv @ truth).log()).max() < 1e-6


def test_the_covariance_of_the_pose_is_that_of_repeated_measurement(rng: np.random.Generator) -> None:
    """Mean square of 60 x 6 normalised errors: 1 +- 4 sqrt(2/360); the allowance of 0.3 px is part of the noise."""
    truth, squares = pose_of(rng), []
    p = points(rng, 15)
    q, C = CAMERA.project(truth @ p), np.tile(SIGMA**2 * np.eye(2), (15, 1, 1))
    noise = np.hypot(SIGMA, 0.3)
    for _ in range(60):
        seen = q + rng.normal(scale=noise, size=q.shape)
        pose = pose_of_matches([blank()], np.zeros(15, np.int32), p, seen, C, truth)
        xi = (truth.inv @ pose.world_from_part).log()
        squares.append(xi @ np.linalg.solve(pose.covariance, xi) / 6)
    assert 1 - 4 * np.sqrt(2 / 360) - 0.15 < np.mean(squares) < 1 + 4 * np.sqrt(2 / 360)  # never scaled below one


def test_the_calibrations_share_is_what_a_wrong_camera_does(rng: np.random.Generator) -> None:
    """A principal point known to 2 px: its share is the outer product of the motion that 2 px of it cause."""
    truth, sigma = pose_of(rng), 2.0
    p, photo = points(rng, 12), np.zeros(12, np.int32)
    q, C = CAMERA.project(truth @ p), np.tile(1e-2 * np.eye(2), (12, 1, 1))
    by_v0 = np.zeros((11, 1))
    by_v0[10, 0] = 1.0  # V0, the last of the eleven parameters: where the axis meets the picture, to the right
    source = ErrorSource("principal point", np.array([[sigma**2]]), object())
    uncertain = Viewpoint("uncertain", CAMERA, Rigid(), 0.1, ((source, by_v0),))
    pose = pose_of_matches([blank(uncertain)], photo, p, q, C, truth)
    small = 1e-3
    moved = pose_of_matches([blank()], photo, p, q + np.array([small, 0]), C, truth)
    xi = (truth.inv @ moved.world_from_part).log() / small * sigma
    assert np.allclose(pose.from_calibration, np.outer(xi, xi), rtol=1e-3, atol=1e-6 * float(xi @ xi))


@pytest.mark.parametrize("draws", [300, pytest.param(800, marks=pytest.mark.slow)])
def test_drawn_calibrations_scatter_the_pose_as_its_share_says(draws: int, rng: np.random.Generator) -> None:
    """Cameras as likely as the calibrated one: each normalised square is 1 within 4 sqrt(2/draws), linearised."""
    truth = pose_of(rng)
    p, photo = points(rng, 12), np.zeros(12, np.int32)
    q, C = CAMERA.project(truth @ p), np.tile(1e-2 * np.eye(2), (12, 1, 1))
    calibration = calibrated(rng)
    found = pose_of_matches([Photo.of(blank().gray, calibration)], photo, p, q, C, truth)
    names, mean = tuple(calibration.camera.lens.parameters), calibration.values[6:]
    covariance = calibration.noise_px**2 * calibration.cofactor[6:, 6:]
    xi = []
    for drawn in rng.multivariate_normal(mean, covariance, size=draws):
        camera = camera_of(drawn[:5], CAMERA.size, BrownConrady(**dict(zip(names, drawn[5:], strict=True))))
        other = pose_of_matches([Photo.of(blank().gray, camera)], photo, p, q, C, found.world_from_part)
        xi.append((found.world_from_part.inv @ other.world_from_part).log())
    sd = np.sqrt(np.diag(found.from_calibration))
    w, V = np.linalg.eigh(found.from_calibration / np.outer(sd, sd))
    seen = w > 1e-4
    scatter = np.mean((np.array(xi) / sd @ V[:, seen]) ** 2, axis=0) / w[seen]
    assert seen.sum() >= 4
    assert np.abs(scatter - 1).max() < 4 * np.sqrt(2 / draws) + 0.05
    assert not pose_of_matches(
        [Photo.of(blank().gray, calibration.camera)], photo, p, q, C, truth
    ).from_calibration.any()


def calibrated(rng: np.random.Generator) -> CameraEstimate:
    """Return a calibration of the camera from 40 points known to 0.3 px."""
    p = rng.uniform([-300, -250, 1200], [300, 250, 1800], size=(40, 3))
    seen = CAMERA.project(p) + rng.normal(scale=0.3, size=(40, 2))
    observations = Observations(p, seen, tuple(map(str, range(40))))
    return calibrate_camera(observations, CAMERA.size, lens=BrownConrady(k1=0.0), free_lens=("k1",))


@pytest.mark.parametrize("n", [0, 2])
def test_too_few_places_are_no_pose(n: int, rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    p = points(rng, max(n, 1))
    candidates = sought(truth, p, level(truth, p), 0, rng, hidden=0 if n else 1)
    assert consensus(candidates, [blank()], truth, tolerance=4.0, rng=rng) is None


def test_triples_that_are_turned_alike_are_so_at_half_a_turn_too(rng: np.random.Generator) -> None:
    p, n = points(rng, 6), np.arange(6)
    ids, zero = n.astype(np.int32), np.zeros((6, 2))
    near = np.array([-0.05, 0.05] * 3)
    found = []
    for turn in (near, (near + 2 * np.pi) % (2 * np.pi) - np.pi):
        c = PlaceCandidates(ids, zero, turn, np.zeros((6, 2, 2)), np.ones(6), p, p, np.zeros(6, np.int32), 45.0, np.pi)
        found.append(len(_triples(c, n, turn, np.random.default_rng(0), 1000)))
    assert found[0] == found[1] > 0
