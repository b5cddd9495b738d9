"""How much noise each of several sources brings, estimated with the parameters: restricted maximum likelihood.

n independent observations y_i (d) = D_i b + noise of covariance V_i = M_i + sum_k s_k E_k: M_i is known, E_k the
pattern of source k and s_k >= 0 its variance, to be found. Maximises the likelihood of what the fit of b leaves over,
so that the variances are not too small for the parameters fitted (Patterson and Thompson, Biometrika 1971), by Fisher
scoring.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array


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
    iterations: int = 60,
) -> Components:
    """Return the variances of the sources `patterns` (k, d, d) for y (n, d), D (n, d, p) and M (n, d, d).

    start (k,): positive variances to begin with; prior (p, p): what is known of b beforehand, as an information matrix.
    A variance that the data hold to be nil comes back as `floor` (k,), default 1e-8 of its start: every weight stays
    finite.
    """
    floor = 1e-8 * start if floor is None else floor
    s = np.maximum(start, floor)
    likelihood = _likelihood(y, D, M, patterns, s, prior)
    information = np.eye(len(s))
    for _ in range(iterations):
        gradient, information = _score(y, D, M, patterns, s, prior)
        held = (s <= floor) & (gradient < 0)
        if held.all():
            break
        step = np.zeros(len(s))
        step[~held] = np.linalg.solve(information[np.ix_(~held, ~held)], gradient[~held])
        change, s, likelihood = _moved(y, D, M, patterns, s, step, floor, prior, likelihood)
        if change < 1e-6:
            break
    V = M + np.einsum("k,kij->ij", s, patterns)
    spread = np.linalg.inv(_score(y, D, M, patterns, s, prior)[1])
    return Components(s, np.asarray(spread), np.asarray(np.linalg.inv(V)))


def _moved(
    y: Array, D: Array, M: Array, patterns: Array, s: Array, step: Array, floor: Array, prior: Array | None, now: float
) -> tuple[float, Array, float]:
    """Take the step, halved until the likelihood does not fall; return the relative change with the new state."""
    for _ in range(30):
        candidate = np.maximum(s + np.clip(step, -0.9 * s, 9 * s), floor)
        then = _likelihood(y, D, M, patterns, candidate, prior)
        if then >= now - 1e-12 * abs(now):
            return float(np.max(np.abs(candidate - s) / s)), candidate, then
        step = step / 2
    return 0.0, s, now


def _solved(y: Array, D: Array, M: Array, patterns: Array, s: Array, prior: Array | None) -> tuple[Array, Array, Array]:
    """Weights W_i (n, d, d), the covariance C (p, p) of b, and z_i = W_i (y_i - D_i b) (n, d)."""
    W = np.linalg.inv(M + np.einsum("k,kij->ij", s, patterns))
    WD = W @ D
    H = np.einsum("nip,niq->pq", D, WD) + (0 if prior is None else prior)
    C = np.linalg.inv(H)
    b = C @ np.einsum("nip,ni->p", WD, y)
    return W, C, np.einsum("nij,nj->ni", W, y - D @ b)


def _likelihood(y: Array, D: Array, M: Array, patterns: Array, s: Array, prior: Array | None) -> float:
    W, C, z = _solved(y, D, M, patterns, s, prior)
    logs = np.linalg.slogdet(W)[1].sum() + np.linalg.slogdet(C)[1]
    return 0.5 * float(logs - np.sum(z * y))


def _score(y: Array, D: Array, M: Array, patterns: Array, s: Array, prior: Array | None) -> tuple[Array, Array]:
    """Gradient (k,) and Fisher information (k, k) of the restricted likelihood by the variances."""
    W, C, z = _solved(y, D, M, patterns, s, prior)
    WE = W[:, None] @ patterns  # (n, k, d, d)
    WD = W @ D
    EWD = patterns @ WD[:, None]  # (n, k, d, p)
    CK = C @ np.tensordot(EWD, WD, axes=((0, 2), (0, 1)))  # (k, p, p)
    trace = np.einsum("nkii->k", WE) - np.einsum("kpp->k", CK)
    Ez = (patterns @ z[:, None, :, None])[..., 0]
    gradient = 0.5 * (np.tensordot(Ez, z, axes=((0, 2), (0, 1))) - trace)
    mixed = np.tensordot(EWD, W[:, None] @ EWD, axes=((0, 2), (0, 2)))  # (k, p, k, p)
    information = np.einsum("nkij,nlji->kl", WE, WE) - 2 * np.einsum("pq,kplq->kl", C, mixed)
    information += np.einsum("kpq,lqp->kl", CK, CK)
    return gradient, 0.5 * information
