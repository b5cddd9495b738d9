"""The pose fitted to datum edges, and what other edges deviate from it: generalised least squares, by cause of error.

Offsets y = J xi + G u + C c + e: xi the motion of the whole part, u a parameter of some edges (a displacement, an
angle), c unit errors of cameras and their poses, e the errors of `EdgeNoise`. xi is estimated from datum edges other
than those of u, so that u is independent of its reference; as c moves both, its effect on u is what the pose does not
follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cadcam.arrays import Array, Brief, Mask
from cadcam.errors import DegenerateGeometry
from cadcam.verify.adjustment.refits import Normals
from cadcam.verify.adjustment.scatter import EdgeNoise, EdgeSums

CAUSES = ("noise", "edges", "pose", "calibration")
CAUSE_WORDS = {
    "noise": "pixel noise",
    "edges": "edges' own errors",
    "pose": "pose",
    "calibration": "camera calibration",
}
_BLIND = 1e-12  # of the largest: information below it is rounding
_ROUNDING = 1e-14  # of what is subtracted from
# Of independent errors of cameras: how many count, and from how far on, rms, they move edges.
_MOST_ERRORS, _LEAST_ERROR_PX = 12, 0.01
_NO_TURN = 1e-9  # rad of a unit twist: it is a translation


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Estimate(Brief):
    """Values (m,) with the covariance (m, m) due to each cause, in the unit of their design.

    noise: the photos', in these edges; edges: their common errors, and whatever else may have moved them; pose: noise
    and common errors of the datum's edges, through the pose; calibration: cameras and their poses, through these edges
    and the pose together. misfit: chi-square over degrees of freedom, dof, of the edges as wholes, 1 where there are
    none.
    """

    value: Array
    noise: Array
    edges: Array
    pose: Array
    calibration: Array
    misfit: float = 1.0
    dof: float = float("inf")

    @property
    def covariance(self) -> Array:
        """Return the covariance (m, m) by all causes, which are independent of each other."""
        return np.asarray(self.noise + self.edges + self.pose + self.calibration)

    @property
    def shares(self) -> dict[str, float]:
        """Return the share of each cause in the variance, in the direction in which that is largest."""
        w = np.linalg.eigh(self.covariance)[1][:, -1]
        return shares_of([float(w @ getattr(self, cause) @ w) for cause in CAUSES])

    def along(self, direction: Array) -> Estimate:
        """Return the estimate of D @ value for D (k, m)."""
        D = np.atleast_2d(direction)
        noise, edges, pose, calibration = (D @ getattr(self, cause) @ D.T for cause in CAUSES)
        return Estimate(D @ self.value, noise, edges, pose, calibration, self.misfit, self.dof)


def shares_of(variances: Sequence[float] | Array) -> dict[str, float]:
    """Return the share of each of `CAUSES` in the sum of its variances (4,); as they are where that is 0."""
    total = float(np.sum(variances))
    return dict(zip(CAUSES, (float(v) / (total if total > 0 else 1.0) for v in variances), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class FittedPose:
    """A motion xi (6,) of the part, its covariance (6, 6) by errors of edges, and derivative (6, r) by cameras."""

    xi: Array
    covariance: Array
    by_cause: Array


@dataclass(frozen=True)
class Adjustment:
    """Offsets (N,) px of edges with J (N, 6), C (N, r), their errors, and which of them the pose is fitted to.

    known: the normal equations of the datum's offsets, where they were found before.
    """

    offset: Array
    J: Array
    C: Array
    errors: EdgeNoise
    datum: Mask
    freedom: Array = field(default_factory=lambda: np.eye(6))
    known: Normals | None = None

    def sums_of(self, rows: Mask, *, every: bool = True, beside: Array | None = None) -> EdgeSums:
        """Return the sums over the offsets of `rows` (N,) that a pose follows from; see `EdgeSums`.

        Of every edge, or of those alone that have any. beside (N, m): what is fitted beside the pose; then what cameras
        do to it is not among the sums.
        """
        J, y = self.J[rows] @ self.freedom, self.offset[rows]
        errors = self.errors.only(rows) if every else self.errors.of_rows(rows)
        if beside is not None:
            return EdgeSums.of(np.column_stack([J, beside[rows], y]), errors, fitted=J.shape[1] + beside.shape[1])
        return EdgeSums.of(np.column_stack([J, y, self.C[rows]]), errors, fitted=J.shape[1])

    def sums_beside(self, cameras: Array, rows: Mask, *, every: bool = True) -> tuple[EdgeSums, EdgeSums]:
        """Return the sums that a pose follows from, and those that the common error does, with `cameras` (N, m) fitted.

        One for both where m is 0. The rest as in `sums_of`.
        """
        alone = self.sums_of(rows, every=every)
        return alone, self.sums_of(rows, every=every, beside=cameras) if cameras.size else alone

    def by_cameras(self) -> Array:
        """Return how far (N, m) px independent errors of cameras, 1 sigma each, move the edges: those that matter."""
        _, px, V = np.linalg.svd(self.C, full_matrices=False)
        kept = px[:_MOST_ERRORS] > _LEAST_ERROR_PX * np.sqrt(len(self.C))
        return np.asarray(self.C @ V[:_MOST_ERRORS][kept].T)

    @cached_property
    def _normals(self) -> Normals:
        return Normals.of(self.sums_of(self.datum).normal(self.errors.tau)) if self.known is None else self.known

    def pose(self, *, without: Mask | None = None, within_px: float = np.inf) -> FittedPose:
        """Return the motion xi fitted to the datum's offsets, without the whole edges of the places `without` (N,).

        within_px: by how much any motion moves the lines at most, before the measurement, 1 sigma. Raises
        `DegenerateGeometry` where the others do not determine the pose.
        """
        F, k = self.freedom, self.freedom.shape[1]
        normal = self._normals.total(None if without is None else self.errors.edge[without])
        if np.isfinite(within_px):
            normal[:, :k] += np.diag(((self.J @ F) ** 2).mean(axis=0)) / within_px**2
        inverse = _inverse(normal[:, :k], F)
        solution = inverse @ normal[:, k:]
        return FittedPose(F @ solution[:, 0], F @ inverse @ F.T, F @ solution[:, 1:])

    def information(self, rows: Mask, design: Array) -> Array:
        """Return the information (m, m) in the offsets of `rows` on u, in their design, for an unknown pose."""
        return np.asarray(design.T @ self.errors.of_rows(rows).white(design))

    def estimate(
        self,
        rows: Mask,
        design: Array,
        pose: FittedPose,
        *,
        prior: float = np.inf,
        enlarged: bool = False,
        shared: bool = False,
    ) -> Estimate:
        """Return the estimate of u by the offsets of `rows` (N,), of design (n, m) px, against a pose without them.

        prior: standard deviation of u before the measurement. enlarged: where the edges disagree on u by more than
        their errors, these are scaled up accordingly (R. T. Birge, Phys. Rev. 40, 1932). shared: whether offsets are
        weighed by the errors that they share, the pose's and the cameras', as well: what moves all of them is no u.
        """
        errors = self.errors.of_rows(rows)
        K = self._shared(rows, pose) if shared else np.zeros((int(rows.sum()), 0))
        WG = _white(errors, K, design)
        N, known = design.T @ WG, np.eye(design.shape[1]) / prior**2
        H = np.asarray(np.linalg.pinv(N + known, rcond=_BLIND, hermitian=True) @ WG.T)
        HJ = H @ self.J[rows]
        Q = errors.common(H)
        seen = H @ self.C[rows] - HJ @ pose.by_cause
        value, noise = H @ self.offset[rows] - HJ @ pose.xi, (H * errors.sigma**2) @ H.T
        common = Q @ Q.T + (H * errors.apart**2) @ H.T
        left = self.offset[rows] - design @ value - self.J[rows] @ pose.xi
        misfit, dof = _misfit(errors, K, left, fitted=design.shape[1])
        if enlarged:
            common = common + max(misfit - 1.0, 0.0) * (noise + common)
        if np.isfinite(prior):
            missed = prior * (np.eye(len(N)) - H @ design)
            common = common + missed @ missed.T
        return Estimate(value, noise, common, HJ @ pose.covariance @ HJ.T, seen @ seen.T, misfit, dof)

    def mean(self, rows: Mask, design: Array, pose: FittedPose) -> tuple[Array, float]:
        """Return the variances (4,) of `CAUSES`, and the value, of one u in its design (n,): as `estimate`, but faster.

        It is called for every piece of every edge.
        """
        errors, J = self.errors.of_rows(rows), self.J[rows]
        weights = errors.white(design[:, None])[:, 0]
        weights = weights / (weights @ design)
        by_pose = weights @ J
        value = float(weights @ self.offset[rows] - by_pose @ pose.xi)
        common = float((errors.common(weights[None]) ** 2).sum() + (weights**2) @ errors.apart**2)
        seen = weights @ self.C[rows] - by_pose @ pose.by_cause
        noise = float((weights**2) @ errors.sigma**2)
        variances = [noise, common, float(by_pose @ pose.covariance @ by_pose), float(seen @ seen)]
        return np.array(variances), value

    def unlikeliness(self, rows: Mask, design: Array, pose: FittedPose, *, prior: float) -> float:
        """Return minus twice the logarithm of the likelihood of the offsets of `rows` (N,), up to a constant.

        As if u were drawn with the standard deviation `prior`; the pose's errors are part of theirs.
        """
        y = self.offset[rows] - self.J[rows] @ pose.xi
        W = _white(self.errors.of_rows(rows), self._shared(rows, pose), np.column_stack([design, y]))
        N, b = np.eye(design.shape[1]) + prior**2 * design.T @ W[:, :-1], design.T @ W[:, -1]
        return float(y @ W[:, -1] - prior**2 * b @ np.linalg.solve(N, b) + np.linalg.slogdet(N)[1])

    def _shared(self, rows: Mask, pose: FittedPose) -> Array:
        """Return K (n, q): how far px the errors of the pose and of the cameras, 1 sigma each, move these places."""
        w, V = np.linalg.eigh(pose.covariance)
        by_pose = self.J[rows] @ V * np.sqrt(np.maximum(w, 0.0))
        return np.column_stack([by_pose, self.C[rows] - self.J[rows] @ pose.by_cause])


def _white(errors: EdgeNoise, K: Array, X: Array) -> Array:
    """Return (V + K K^T)^-1 X (Woodbury)."""
    WX = errors.white(X)
    if not K.shape[1]:
        return WX
    WK = errors.white(K)
    return np.asarray(WX - WK @ np.linalg.solve(np.eye(K.shape[1]) + K.T @ WK, K.T @ WX))


def _misfit(errors: EdgeNoise, K: Array, left: Array, *, fitted: int) -> tuple[float, float]:
    """Return chi-square over degrees of freedom of edges as wholes, without the scatter along them, 1 for none; dof."""
    total = float(left @ _white(errors, K, left[:, None])[:, 0])
    within, lines = errors.about_lines(left)
    dof = float(lines - fitted)
    return ((total - within) / dof, dof) if dof > 0 else (1.0, np.inf)


def _inverse(N: Array, F: Array) -> Array:
    """Return the inverse (m, m) of the pose's information on motions F (6, m); `DegenerateGeometry` names a free one.

    Translations, in mm, are compared with each other, and so are the other motions, each with the translation that it
    is told from the least: turns about points among the edges, wherever the part's origin is.
    """
    _, s, Vt = np.linalg.svd(F[3:])
    turning = int(np.count_nonzero(s > _NO_TURN))
    turns, slides = Vt[:turning].T, Vt[turning:].T
    inverse = slides @ _inverted(slides.T @ N @ slides, F @ slides) @ slides.T
    rounding = _ROUNDING * float(np.einsum("ij,ij->j", turns, N @ turns).max(initial=0.0))
    turns = turns - inverse @ N @ turns
    return np.asarray(inverse + turns @ _inverted(turns.T @ N @ turns, F @ turns, rounding) @ turns.T)


def _inverted(N: Array, motions: Array, rounding: float = 0.0) -> Array:
    """Return the inverse (m, m) of the information on motions (6, m) that are alike, unless one of them is free.

    It is, if the least information is rounding, or rounding beside the most.
    """
    if not len(N):
        return N
    w, V = np.linalg.eigh(N)
    if not w[0] > max(_BLIND * w[-1], rounding):
        free = motions @ V[:, 0]
        kind = "motion" if np.linalg.norm(free[3:]) > _NO_TURN else "translation"
        direction = (np.round(free / max(float(np.linalg.norm(free)), 1e-300), 3) + 0.0).tolist()  # no -0.0
        raise DegenerateGeometry(
            f"the datum edges seen do not hold the part: the {kind} {direction} (mm, rad, part axes) moves none of "
            "them in the photos; take more features into the datum, or another photo"
        )
    return np.asarray((V / w) @ V.T)
