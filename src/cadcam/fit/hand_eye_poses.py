"""The simultaneous hand-eye adjustment on poses: every pose weighted by its own covariance, robot noise estimated.

The robot is where it says, except for an offset e of the flange, in flange axes: base_from_flange @ offset(e), where
offset(t, r) rotates by r about the flange's origin and moves it by t. Then, in the names of `cadcam.fit.hand_eye`,

    offset(e_i) = inv(base_from_flange[i]) @ base_from_fixed @ inv(held_from_fixed[i]) @ inv(flange_from_held),

and the adjustment finds flange_from_held and base_from_fixed, and the variances of the offsets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.errors import DegenerateGeometry
from cadcam.fit.variance_components import variance_components
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

PATTERNS = np.stack([np.diag([1.0, 1, 1, 0, 0, 0]), np.diag([0.0, 0, 0, 1, 1, 1])])  # translation, rotation
_STEP = np.tile(np.repeat([1.0, 1e-3], 3), 2)  # mm and rad that count as one
SMALLEST = np.array([1e-4, 1e-7])  # mm, rad: smaller noise counts as none


@dataclass(frozen=True, slots=True, eq=False)
class HandEyePoses:
    """A robot's n poses and the relative poses of the held and the fixed thing, with covariance (n, 6, 6).

    Covariance of held_from_fixed @ exp(xi), mm and rad; zeros for poses without noise.
    """

    base_from_flange: Rigid
    held_from_fixed: Rigid
    covariance: Array

    def offsets(self, flange_from_held: Rigid, base_from_fixed: Rigid) -> Array:
        """Return the offsets e (n, 6) of the flange that explain the poses exactly: translation mm, rotation rad."""
        T = self._offset_motions(flange_from_held, base_from_fixed)
        return np.concatenate([T.translation, so3.log(T.rotation)], axis=1)

    def linearised(self, flange_from_held: Rigid, base_from_fixed: Rigid) -> tuple[Array, Array, Array]:
        """Return offsets e (n, 6), de/d(xi of flange_from_held, of base_from_fixed) (n, 6, 12), cov of e (n, 6, 6)."""
        T = self._offset_motions(flange_from_held, base_from_fixed)
        r = so3.log(T.rotation)
        chart = np.zeros((len(r), 6, 6))
        chart[:, :3, :3], chart[:, 3:, 3:] = T.rotation, so3.inverse_left_jacobian(-r)
        through = chart @ (flange_from_held @ self.held_from_fixed).adjoint()
        D = np.concatenate([-chart @ flange_from_held.adjoint(), through], axis=-1)
        return np.concatenate([T.translation, r], axis=1), D, through @ self.covariance @ np.swapaxes(through, 1, 2)

    def some(self, index: Longs) -> HandEyePoses:
        """Return some of the poses."""
        return HandEyePoses(self.base_from_flange[index], self.held_from_fixed[index], self.covariance[index])

    def _offset_motions(self, flange_from_held: Rigid, base_from_fixed: Rigid) -> Rigid:
        return self.base_from_flange.inv @ (base_from_fixed @ (flange_from_held @ self.held_from_fixed).inv)


@dataclass(frozen=True, slots=True, eq=False)
class PosesFit:
    """The adjusted poses, the offsets e (n, 6), their Jacobian D (n, 6, 12) and weights W (n, 6, 6) by all noise.

    variances (2,): of one coordinate of the robot's translation (mm^2) and rotation (rad^2); their covariance (2, 2).
    """

    flange_from_held: Rigid
    base_from_fixed: Rigid
    offsets: Array
    jacobian: Array
    weights: Array
    variances: Array
    variances_covariance: Array

    @property
    def information(self) -> Array:
        """Return the inverse covariance (12, 12) of (flange_from_held, base_from_fixed)."""
        return np.asarray(np.einsum("nip,nij,njq->pq", self.jacobian, self.weights, self.jacobian))

    @property
    def degrees_of_freedom(self) -> Array:
        """Return the degrees of freedom behind each of the twelve variances, (12,), at least 1.

        2 C^2 / var(C) (Satterthwaite, Biometrics Bulletin 1946): few where the robot's noise, estimated from few poses,
        makes up the variance; inf where it is zero and the camera's noise is known.
        """
        C = np.linalg.inv(self.information)
        slopes = np.einsum("pq,kqr,rp->kp", C, self._by_variance[0], C)  # of the variances C by those of the robot
        spread = np.einsum("kp,kl,lp->p", slopes, self._spread, slopes)
        with np.errstate(divide="ignore"):
            return np.asarray(np.maximum(2 * np.diag(C) ** 2 / spread, 1.0))

    @property
    def small_sample(self) -> Array:
        """Return what the inverse information (12, 12) lacks as the robot's noise comes from the same poses.

        Kenward and Roger, Biometrics 1997, equation 5, for variances that enter linearly; zero for many poses.
        """
        C = np.linalg.inv(self.information)
        P, Q = self._by_variance
        lack = np.einsum("kl,kplq->pq", self._spread, Q) - np.einsum("kl,kpq,qr,lrs->ps", self._spread, P, C, P)
        return np.asarray(C @ (lack + lack.T) @ C)

    @property
    def _spread(self) -> Array:
        """Covariance (2, 2) of the variances, without those that are zero."""
        there = self.variances > SMALLEST**2
        return np.asarray(self.variances_covariance * np.outer(there, there))

    @property
    def _by_variance(self) -> tuple[Array, Array]:
        """Sums over the poses of D' W E W D (k, 12, 12) and of D' W E W E W D (k, 12, k, 12), E the patterns."""
        WD = self.weights @ self.jacobian
        EWD = PATTERNS @ WD[:, None]
        first = np.tensordot(EWD, WD, axes=((0, 2), (0, 1)))
        return first, np.tensordot(EWD, self.weights[:, None] @ EWD, axes=((0, 2), (0, 2)))

    @property
    def squared_distances(self) -> Array:
        """Return each offset's squared size relative to its noise, (n,): about 6 if all is well."""
        return np.asarray(np.einsum("ni,nij,nj->n", self.offsets, self.weights, self.offsets))


def adjust(poses: HandEyePoses, flange_from_held: Rigid, base_from_fixed: Rigid) -> PosesFit:
    """Return the least-squares adjustment from a start near it, with an estimate of the robot's noise."""
    X, Z = flange_from_held, base_from_fixed
    e, D, M = poses.linearised(X, Z)
    s, spread = _median_variances(e), np.zeros((2, 2))
    smallest = np.inf
    for _ in range(30):
        found = variance_components(e, D, M, PATTERNS, s, floor=SMALLEST**2)
        s, spread = found.variances, found.covariance
        W = _weights(M, s)
        step = _step(e, D, W)
        size = float(np.max(np.abs(step) / _STEP))
        if size < 1e-9 or (size < 1e-5 and size >= smallest):
            break
        smallest = min(size, smallest)
        X, Z = X @ Rigid.exp(step[:6]), Z @ Rigid.exp(step[6:])
        e, D, M = poses.linearised(X, Z)
    return PosesFit(X, Z, e, D, W, s, spread)


def evaluated(poses: HandEyePoses, flange_from_held: Rigid, base_from_fixed: Rigid, like: PosesFit) -> PosesFit:
    """Return offsets, Jacobian and weights at other motions, with the robot's noise of another fit."""
    e, D, M = poses.linearised(flange_from_held, base_from_fixed)
    W = _weights(M, like.variances)
    return PosesFit(flange_from_held, base_from_fixed, e, D, W, like.variances, like.variances_covariance)


def smoothed(fit: PosesFit) -> Array:
    """Return the robot's part (n, 6) of the offsets, as opposed to the camera's, by their covariances."""
    robot = np.einsum("k,kij->ij", fit.variances, PATTERNS)
    return np.asarray(np.einsum("ij,njk,nk->ni", robot, fit.weights, fit.offsets))


def adjust_robustly(poses: HandEyePoses, flange_from_held: Rigid, base_from_fixed: Rigid, noise: Array) -> PosesFit:
    """Return an adjustment that is robust to gross errors in less than half of the poses: Cauchy's loss.

    noise (2,): initial sigmas of translation (mm) and rotation (rad), then estimated from the medians of the offsets.
    """
    X, Z, s = flange_from_held, base_from_fixed, noise**2
    for _ in range(40):
        e, D, M = poses.linearised(X, Z)
        W = _weights(M, s)
        d2 = np.einsum("ni,nij,nj->n", e, W, e)
        tamed = W / (1 + d2 / 6)[:, None, None]
        step = _step(e, D, tamed)
        X, Z = X @ Rigid.exp(step[:6]), Z @ Rigid.exp(step[6:])
        s = np.maximum(_median_variances(e), SMALLEST**2)
        if float(np.max(np.abs(step) / _STEP)) < 1e-3:
            break
    return PosesFit(X, Z, e, D, W, s, np.zeros((2, 2)))


def _weights(M: Array, s: Array) -> Array:
    """Inverse covariances (n, 6, 6) of offsets whose cameras have M (n, 6, 6) and whose robot has variances s (2,)."""
    return np.asarray(np.linalg.inv(M + np.einsum("k,kij->ij", s, PATTERNS)))


def _median_variances(e: Array) -> Array:
    """Variances of one coordinate of translation and rotation by the median length: chi-square of 3 has 2.366."""
    lengths = np.stack([np.sum(e[:, :3] ** 2, axis=1), np.sum(e[:, 3:] ** 2, axis=1)])
    return np.asarray(np.median(lengths, axis=1) / 2.366)


def _step(e: Array, D: Array, W: Array) -> Array:
    N = np.einsum("nip,nij,njq->pq", D, W, D)
    scale = 1 / np.sqrt(np.diag(N))
    try:
        return np.asarray(
            -scale * np.linalg.solve(N * np.outer(scale, scale), scale * np.einsum("nip,nij,nj->p", D, W, e))
        )
    except np.linalg.LinAlgError:
        raise DegenerateGeometry("the robot's motions do not determine where the held thing sits") from None
