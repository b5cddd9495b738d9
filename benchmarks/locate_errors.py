"""Errors of located poses, and their statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry.rigid import Rigid
from cadcam.locate.location import Location
from locate_sets import PhotoSet, Start

CLOSE_PX, NEAR_PX = 2.0, 5.0  # a start that ends closer counts as right; nearer counts for accuracy


@dataclass(frozen=True)
class Outcome:
    """How one start ended.

    vertex_px: largest reprojection error of a corner; shift (3,) mm: estimated minus true centroid in camera axes; xi
    (6,): true pose = estimated @ exp(xi), mm and rad in part axes; mahalanobis: xi^T C^-1 xi; cpu_s: what it took.
    """

    start: int
    frame: int
    vertex_px: float
    shift: Array
    xi: Array
    mahalanobis: float
    quality: float
    cpu_s: float

    @property
    def right(self) -> bool:
        """Whether it counts as right."""
        return self.vertex_px < CLOSE_PX


def judged(photos: PhotoSet, start: Start, location: Location, cpu_s: float) -> Outcome:
    """Return how far the located pose is from the truth of the start's frame."""
    truth, found = photos.truth[start.frame], location.pose.world_from_part
    xi = (found.inv @ truth).log()
    return Outcome(
        start.row,
        start.frame,
        vertex_error(photos, found, truth),
        found @ photos.centroid - truth @ photos.centroid,
        xi,
        squared(xi, location.pose.covariance),
        location.quality,
        cpu_s,
    )


def vertex_error(photos: PhotoSet, pose: Rigid, truth: Rigid) -> float:
    """Return the largest distance in px between the corners' pictures; inf where one falls behind the camera."""
    p, t = (photos.camera.project(T @ photos.vertices) for T in (pose, truth))
    seen = np.isfinite(t).all(axis=1)
    d = np.linalg.norm(p[seen] - t[seen], axis=1)
    return float(d.max()) if np.isfinite(d).all() else np.inf


def squared(xi: Array, covariance: Array) -> float:
    """Return xi^T C^-1 xi; inf where C claims certainty in a direction it cannot have."""
    scale = np.sqrt(np.diag(covariance))
    if not (scale > 0).all():
        return np.inf
    C = covariance / np.outer(scale, scale)
    w, V = np.linalg.eigh(C)
    return float(((V.T @ (xi / scale)) ** 2 / w).sum()) if (w > 0).all() else np.inf


@dataclass(frozen=True)
class Summary:
    """Of many outcomes. Centroid errors and normalised errors are of those below `NEAR_PX`."""

    starts: int
    close: float
    near: float
    median_mm: float
    rms_mm: float
    bias: Array
    scatter: Array
    normalised: float
    cpu_ms: float
    worst_quality_right: float
    best_quality_wrong: float


def summary(outcomes: Sequence[Outcome]) -> Summary:
    """Return shares, errors and times of outcomes.

    scatter (3,): standard deviation over frames of each frame's mean error, mm, about the bias; normalised: root of
    the mean of mahalanobis / 6, one where covariances are true.
    """
    e = np.array([o.vertex_px for o in outcomes])
    near = [o for o in outcomes if o.vertex_px < NEAR_PX]
    shift = np.array([o.shift for o in near]).reshape(-1, 3)
    frames = np.array([o.frame for o in near])
    means = np.array([shift[frames == f].mean(axis=0) for f in np.unique(frames)]).reshape(-1, 3)
    size = np.linalg.norm(shift, axis=1)
    some, several = len(near) > 0, len(means) > 1
    nothing = np.full(3, np.nan)
    return Summary(
        len(outcomes),
        float(np.mean(e < CLOSE_PX)),
        float(np.mean(e < NEAR_PX)),
        float(np.median(size)) if some else np.nan,
        float(np.sqrt(np.mean(size**2))) if some else np.nan,
        means.mean(axis=0) if some else nothing,
        means.std(axis=0, ddof=1) if several else nothing,
        float(np.sqrt(np.mean([o.mahalanobis / 6 for o in near]))) if some else np.nan,
        1000 * float(np.mean([o.cpu_s for o in outcomes])),
        min((o.quality for o in outcomes if o.right), default=np.nan),
        max((o.quality for o in outcomes if not o.right), default=np.nan),
    )


def auc(right: Sequence[float] | Array, wrong: Sequence[float] | Array) -> float:
    """Return the chance that a right pose scores above a wrong one, ties counted half: the area under the ROC curve.

    By ranks (Mann and Whitney 1947): U / (n m).
    """
    from scipy.stats import rankdata

    n, m = len(right), len(wrong)
    if not (n and m):
        return float("nan")
    ranks = rankdata(np.concatenate([right, wrong]))[:n]
    return float((ranks.sum() - n * (n + 1) / 2) / (n * m))
