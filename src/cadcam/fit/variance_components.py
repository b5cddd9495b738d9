"""The noise variances of several sources, estimated together with the parameters by restricted maximum likelihood.

n independent observations y_i (d) = D_i b + noise of covariance V_i = M_i + sum_k s_k E_k: M_i is known, E_k the
pattern of source k and s_k >= 0 its unknown variance. Maximises the likelihood of the residuals of b's fit, so that the
variances are not too small for the number of parameters fitted (Patterson and Thompson, Biometrika 1971), by Fisher
scoring.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array

_ITERATIONS, _HALVINGS = 60, 30
_SETTLED = 1e-6  # relative change of the variances


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """Variances (k,) of the sources, the covariance (k, k) of these estimates, and the weights V_i^-1 (n, d, d)."""

    variances: Array
    covariance: Array
    weights: Array


def variance_components(
    y: Array,
    D: Array,
    M: Array,
    patterns: Array,
    start: Array,
    *,
    floor: Array | None = None,
    prior: Array | None = None,
) -> Components:
    """Return the variances of the sources `patterns` (k, d, d) for y (n, d), D (n, d, p) and M (n, d, d).

    start (k,): positive initial variances; prior (p, p): prior information matrix of b. A variance that the data
    estimate as zero is returned as `floor` (k,), default 1e-8 of its start: every weight stays finite.
    """
    floor = 1e-8 * start if floor is None else floor
    model = _Model(y, D, M, patterns, np.zeros((D.shape[2],) * 2) if prior is None else prior)
    s = np.maximum(start, floor)
    likelihood = model.likelihood(s)
    for _ in range(_ITERATIONS):
        gradient, information = model.score(s)
        held = (s <= floor) & (gradient < 0)
        if held.all():
            break
        step = np.zeros(len(s))
        step[~held] = np.linalg.solve(information[np.ix_(~held, ~held)], gradient[~held])
        before, (s, likelihood) = s, model.uphill(s, step, floor, likelihood)
        if float(np.max(np.abs(s - before) / before)) < _SETTLED:
            break
    return Components(s, np.asarray(np.linalg.inv(model.score(s)[1])), model.weights(s))


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """The observations y (n, d), D (n, d, p), M (n, d, d), the patterns (k, d, d) and the prior (p, p) on b."""

    y: Array
    D: Array
    M: Array
    patterns: Array
    prior: Array

    def weights(self, s: Array) -> Array:
        """Return V_i^-1 (n, d, d) at variances s (k,)."""
        return np.asarray(np.linalg.inv(self.M + np.einsum("k,kij->ij", s, self.patterns)))

    def solved(self, s: Array) -> tuple[Array, Array, Array]:
        """Return the weights W_i (n, d, d), the covariance C (p, p) of b, and z_i = W_i (y_i - D_i b) (n, d)."""
        W = self.weights(s)
        WD = W @ self.D
        C = np.linalg.inv(np.einsum("nip,niq->pq", self.D, WD) + self.prior)
        b = C @ np.einsum("nip,ni->p", WD, self.y)
        return W, C, np.einsum("nij,nj->ni", W, self.y - self.D @ b)

    def likelihood(self, s: Array) -> float:
        """Return the logarithm of the restricted likelihood, up to a constant."""
        W, C, z = self.solved(s)
        logs = np.linalg.slogdet(W)[1].sum() + np.linalg.slogdet(C)[1]
        return 0.5 * float(logs - np.sum(z * self.y))

    def score(self, s: Array) -> tuple[Array, Array]:
        """Return gradient (k,) and Fisher information (k, k) of the restricted likelihood by the variances."""
        W, C, z = self.solved(s)
        WE = W[:, None] @ self.patterns  # (n, k, d, d)
        WD = W @ self.D
        EWD = self.patterns @ WD[:, None]  # (n, k, d, p)
        CK = C @ np.tensordot(EWD, WD, axes=((0, 2), (0, 1)))  # (k, p, p)
        trace = np.einsum("nkii->k", WE) - np.einsum("kpp->k", CK)
        Ez = (self.patterns @ z[:, None, :, None])[..., 0]
        gradient = 0.5 * (np.tensordot(Ez, z, axes=((0, 2), (0, 1))) - trace)
        mixed = np.tensordot(EWD, W[:, None] @ EWD, axes=((0, 2), (0, 2)))  # (k, p, k, p)
        information = np.einsum("nkij,nlji->kl", WE, WE) - 2 * np.einsum("pq,kplq->kl", C, mixed)
        information += np.einsum("kpq,lqp->kl", CK, CK)
        return gradient, 0.5 * information

    def uphill(self, s: Array, step: Array, floor: Array, now: float) -> tuple[Array, float]:
        """Return variances and likelihood after the step, halved until the likelihood does not fall."""
        for _ in range(_HALVINGS):
            candidate = np.maximum(s + np.clip(step, -0.9 * s, 9 * s), floor)
            then = self.likelihood(candidate)
            if then >= now - 1e-12 * abs(now):
                return candidate, then
            step = step / 2
        return s, now
