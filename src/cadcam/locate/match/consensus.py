"""The pose that most features agree on, when each has several candidate places in the photos, most of them wrong.

Three features give a pose (fit.p3p), and all others judge it: random sample consensus (M. Fischler and R. Bolles,
CACM 1981). How much agreement chance explains follows from the number and density of the candidates (after L. Moisan
and B. Stival, A probabilistic criterion to detect rigid point matches, IJCV 2004).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource, covariance_of
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.fit.least_squares import Stalled, minimise
from cadcam.fit.many_poses import pose_jacobian
from cadcam.fit.p3p import p3p
from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo

_TRIPLES = 3000  # triples tried, of four times as many drawn: most are rotated inconsistently
_ALIKE = 0.2  # rad: largest spread of the rotations of three features of one pose near the start
_NEAR_START = 1.5  # reaches: poses that move the features by more than this, in the median, are not tried
_TURN_SHARE, _LEAST_TURN = 0.3, math.radians(4)  # tolerance of an angle: share of the range searched; at least
_SETTLED = 5  # best supported poses that are refined
LEAST_AGREEING = 4  # agreeing features, including the three that gave the pose
_MISFIT_PX = 0.3  # sd of the difference between drawings and photos that the matches' covariances lack


@dataclass(frozen=True, slots=True, eq=False)
class PlaceCandidates:
    """M candidate places of F features: feature (M,), q (M, 2) px, angle (M,) rad, covariance (M, 2, 2), score (M,).

    p_part, right (F, 3) mm and photo (F,) belong to the features: p_part to right is the x direction of the window.
    reach px, turn rad: how far from its expected place and angle each was searched for.
    """

    feature: Ids
    q: Array
    angle: Array
    covariance: Array
    score: Array
    p_part: Array
    right: Array
    photo: Ids
    reach: float
    turn: float


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """world_from_part, and the candidates (K,) that agree with it, at most one per feature.

    by_chance: the expected number of equally well supported poses among those tried if candidates lay at random.
    """

    world_from_part: Rigid
    chosen: Ids
    by_chance: float


def consensus(
    candidates: PlaceCandidates, photos: Sequence[Photo], start: Rigid, *, tolerance: float, rng: np.random.Generator
) -> Consensus | None:
    """Return the pose near `start` (world_from_part) that most features agree on to `tolerance` px, or None."""
    R, t, tried = _poses_of_triples(candidates, photos, start, rng)
    if not len(R):
        return None
    support = _support(candidates, photos, R, t, tolerance).sum(axis=1)
    order = np.argsort(-support, kind="stable")[:_SETTLED]
    settled = [_settled(candidates, photos, Rigid(R[k], t[k]), tolerance) for k in order]
    pose, chosen = max(settled, key=lambda s: len(s[1]))
    if len(chosen) < LEAST_AGREEING:
        return None
    return Consensus(pose, chosen, _by_chance(candidates, len(chosen), tolerance, tried))


def pose_of_matches(
    photos: Sequence[Photo], photo: Ids, p_part: Array, q: Array, covariance: Array, start: Rigid
) -> PoseEstimate:
    """Return the weighted least-squares pose of matches p_part (N, 3) mm, q (N, 2) px, covariance (N, 2, 2).

    The pose's covariance is scaled up by the residuals where they exceed what the matches' covariances predict.
    """
    problem = _Matches(photos, photo, p_part, q, covariance)
    pose = _least_squares(problem, start)
    r, J = problem.residuals_and_jacobian(pose)
    dof = max(len(r) - 6, 1)
    cofactor = np.asarray(np.linalg.pinv(J.T @ J), np.float64)
    scale = max(1.0, float(r @ r) / dof)
    return PoseEstimate(pose, scale * cofactor, _calibration_share(problem, pose, J, cofactor), dof=float(dof))


class _Matches:
    """Reprojection of matches into photos, in units of their standard deviations."""

    def __init__(self, photos: Sequence[Photo], photo: Ids, p: Array, q: Array, covariance: Array) -> None:
        self.photos, self.photo, self.p, self.q = photos, photo, p, q
        self.whiten = np.linalg.inv(np.linalg.cholesky(covariance + _MISFIT_PX**2 * np.eye(2)))

    def residuals_and_jacobian(self, state: Rigid) -> tuple[Array, Array]:
        """Return r (2N,) and dr/dxi (2N, 6) of world_from_part @ exp(xi)."""
        r, J = np.zeros((len(self.p), 2)), np.zeros((len(self.p), 2, 6))
        for k, photo in enumerate(self.photos):
            mine = np.flatnonzero(self.photo == k)
            if mine.size:
                T = photo.camera_from_world @ state
                q, J_mine = pose_jacobian(photo.camera, T.rotation[None], T.translation[None], self.p[None, mine])
                r[mine], J[mine] = q[0] - self.q[mine], J_mine[0]
        r = (self.whiten @ r[..., None])[..., 0]
        return r.ravel(), (self.whiten @ J).reshape(-1, 6)

    def retract(self, state: Rigid, step: Array) -> Rigid:
        """Return state @ exp(step)."""
        return state @ Rigid.exp(step)


def _least_squares(problem: _Matches, start: Rigid) -> Rigid:
    try:
        return minimise(problem, start).state
    except Stalled:
        return start


def _calibration_share(problem: _Matches, pose: Rigid, J: Array, cofactor: Array) -> Array:
    """Return the pose's covariance due to the errors of the cameras' calibrations and positions."""
    effects: list[tuple[ErrorSource, Array]] = []
    for k, photo in enumerate(problem.photos):
        mine = np.flatnonzero(problem.photo == k)
        if not (mine.size and photo.viewpoint.errors):
            continue
        _, _, by_source = photo.viewpoint.project(pose @ problem.p[mine])
        rows = (2 * mine[:, None] + np.arange(2)).ravel()
        for (source, _), D in zip(photo.viewpoint.errors, by_source, strict=True):
            effects.append((source, -cofactor @ J[rows].T @ (problem.whiten[mine] @ D).reshape(len(rows), -1)))
    return covariance_of(effects, 6)


def _poses_of_triples(
    c: PlaceCandidates, photos: Sequence[Photo], start: Rigid, rng: np.random.Generator
) -> tuple[Array, Array, int]:
    """Return the poses world_from_part of random triples that lie near the start, and how many triples were tried.

    The poses are rotations (S, 3, 3) and translations (S, 3). A triple is of candidates in one photo.
    """
    rotations, translations, tried = [np.zeros((0, 3, 3))], [np.zeros((0, 3))], 0
    for k, photo in enumerate(photos):
        mine = np.flatnonzero(c.photo[c.feature] == k)
        camera_from_world = photo.camera_from_world
        expected = camera_from_world @ start
        triples = _triples(c, mine, _turns(c, photo.camera, expected), rng, _TRIPLES // len(photos))
        if not len(triples):
            continue
        focal_centre, R = p3p(c.p_part[c.feature[triples]], photo.camera.unproject(c.q[triples]))
        t = -(R @ focal_centre[..., None])[..., 0]
        near = _median_motion(photo.camera, c.p_part[c.photo == k], R, t, expected) < _NEAR_START * c.reach
        back = camera_from_world.inv
        rotations.append(back.rotation @ R[near])
        translations.append(t[near] @ back.rotation.T + back.translation)
        tried += len(triples)
    return np.concatenate(rotations), np.concatenate(translations), tried


def _median_motion(camera: Camera, p: Array, R: Array, t: Array, expected: Rigid) -> Array:
    """Return how far (S,) px, in the median, poses camera_from_part move points p (n, 3) from where one expects them.

    R (S, 3, 3), t (S, 3): the poses. Points that a pose does not image count as infinitely far.
    """
    q = camera.project(p @ np.swapaxes(R, -1, -2) + t[:, None])
    moved = np.linalg.norm(q - camera.project(expected @ p), axis=-1)
    return np.asarray(np.median(np.where(np.isfinite(moved), moved, np.inf), axis=1))


def _turns(c: PlaceCandidates, camera: Camera, camera_from_part: Rigid) -> Array:
    """Return each candidate's rotation (M,) rad in the picture relative to a pose."""
    side = camera.project(camera_from_part @ c.right) - camera.project(camera_from_part @ c.p_part)
    return np.asarray(c.angle - np.arctan2(side[:, 1], side[:, 0])[c.feature])


def _triples(
    c: PlaceCandidates, mine: npt.NDArray[np.intp], turn: Array, rng: np.random.Generator, count: int
) -> npt.NDArray[np.intp]:
    """Return distinct triples (at most count, 3) of candidates of three features, high scores drawn more often."""
    if len(np.unique(c.feature[mine])) < 3:
        return np.zeros((0, 3), np.intp)
    chance = c.score[mine] ** 4
    triples = mine[rng.choice(len(mine), size=(4 * count, 3), p=chance / chance.sum())]
    apart = (turn[triples] - turn[triples[:, :1]] + math.pi) % (2 * math.pi)  # from the first, which has pi
    triples = triples[np.ptp(apart, axis=1) < _ALIKE][:count]
    triples = np.unique(np.sort(triples, axis=1), axis=0)
    f = np.sort(c.feature[triples], axis=1)
    triples = triples[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2])]
    a, b, d = (c.p_part[c.feature[triples[:, k]]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, d - a), axis=1)
    wide: npt.NDArray[np.intp] = triples[area > 0.25 * np.median(area)] if len(area) else triples
    return wide


def _support(c: PlaceCandidates, photos: Sequence[Photo], R: Array, t: Array, tolerance: float) -> Array:
    """Return each candidate's support for each pose (S, M), 0 to its score; only the best candidate of a feature."""
    d2, turned = _misses(c, photos, R, t)
    value = np.where(turned < _turn_tolerance(c), c.score * np.maximum(0.0, 1 - d2 / tolerance**2), 0.0)
    order = np.argsort(c.feature, kind="stable")
    _, first, of = np.unique(c.feature[order], return_index=True, return_inverse=True)
    best = np.maximum.reduceat(value[:, order], first, axis=1)[:, of[np.argsort(order)]]
    return np.where((value > 0) & (value == best), value, 0.0)


def _turn_tolerance(c: PlaceCandidates) -> float:
    return max(_TURN_SHARE * c.turn, _LEAST_TURN)


def _misses(c: PlaceCandidates, photos: Sequence[Photo], R: Array, t: Array) -> tuple[Array, Array]:
    """Return squared distances (px^2) and angles (rad) of candidates from their features, (S, M); inf if unseen."""
    q, side = np.full((len(R), len(c.p_part), 2), np.nan), np.zeros((len(R), len(c.p_part), 2))
    for k, photo in enumerate(photos):
        mine, place = c.photo == k, photo.camera_from_world
        R_k, t_k = place.rotation @ R, t @ place.rotation.T + place.translation
        q[:, mine] = photo.camera.project(c.p_part[mine] @ np.swapaxes(R_k, -1, -2) + t_k[:, None])
        side[:, mine] = photo.camera.project(c.right[mine] @ np.swapaxes(R_k, -1, -2) + t_k[:, None]) - q[:, mine]
    d2 = np.sum((q[:, c.feature] - c.q) ** 2, axis=-1)
    angle = np.arctan2(side[..., 1], side[..., 0])[:, c.feature] - c.angle
    turned = np.abs((angle + math.pi) % (2 * math.pi) - math.pi)
    return np.where(np.isfinite(d2), d2, np.inf), np.where(np.isfinite(turned), turned, np.inf)


def _settled(c: PlaceCandidates, photos: Sequence[Photo], pose: Rigid, tolerance: float) -> tuple[Rigid, Ids]:
    """Return the least-squares pose of the agreeing candidates, and these, iterated until they do not change."""
    chosen = np.zeros(0, np.int32)
    for _ in range(6):
        agree: Mask = _support(c, photos, pose.rotation[None], pose.translation[None], tolerance)[0] > 0
        now = np.flatnonzero(agree).astype(np.int32)
        if len(now) < LEAST_AGREEING or np.array_equal(now, chosen):
            return pose, now
        chosen = now
        f = c.feature[chosen]
        problem = _Matches(photos, c.photo[f], c.p_part[f], c.q[chosen], c.covariance[chosen])
        pose = _least_squares(problem, pose)
    return pose, chosen


def _by_chance(c: PlaceCandidates, agreeing: int, tolerance: float, tried: int) -> float:
    """Return the expected number of poses tried that as many features would agree with by chance."""
    from scipy.stats import binom

    features = len(np.unique(c.feature))
    peaks = len(c.feature) / features
    angle = min(1.0, _turn_tolerance(c) / max(c.turn, 1e-9))
    hit = min(0.5, peaks * math.pi * tolerance**2 / (2 * c.reach) ** 2 * angle)
    return float(tried * binom.sf(agreeing - 4, features - 3, hit))
