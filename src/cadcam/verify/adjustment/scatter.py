"""The errors of edges in a photo: white noise along an edge, and an error common to the whole edge.

Offsets along one edge have errors in common: chamfers, shadows, unequal blur, neighbouring edges. An edge's common
error is modelled as a random straight line, a shift and a tilt of variance tau^2 each (variance components): V =
diag(sigma^2) + tau^2 Z Z^T with Z = (1, t) for each edge, t its position scaled to unit mean square. A covariance from
noise alone lacks tau, which does not average out over the samples of an edge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask

_LEAST_PX, _MOST_PX = 1e-4, 3.0  # range in which tau is searched for
_TRIES = 40
_LEAST_FOR_SCALE = 5
_GOLDEN = (np.sqrt(5.0) - 1) / 2


@dataclass(frozen=True, slots=True, eq=False)
class EdgeNoise:
    """The covariance V (N, N) of offsets: sigma (N,) px, edge (N,) numbers from 0, Z (N, 2), tau (edges,) px."""

    sigma: Array
    edge: Longs
    Z: Array
    tau: Array

    @classmethod
    def of(cls, sigma: Array, edge: Longs, along: Array, tau: float) -> EdgeNoise:
        """Return the model of offsets at positions `along` (N,) px of their edges."""
        number = np.unique(edge, return_inverse=True)[1].reshape(-1).astype(np.int64)
        count = np.maximum(np.bincount(number), 1)
        middle = along - (np.bincount(number, along) / count)[number]
        spread = np.sqrt(np.bincount(number, middle**2) / count)[number]
        t = np.divide(middle, spread, out=np.zeros_like(middle), where=spread > 0)
        Z = np.stack([np.ones_like(t), t], axis=1)
        return cls(np.asarray(sigma, np.float64), number, Z, np.full(len(count), float(tau)))

    def of_rows(self, rows: Mask) -> EdgeNoise:
        """Return the errors of some offsets (mask over N); part of an edge keeps the edge's common line."""
        edges, number = np.unique(self.edge[rows], return_inverse=True)
        return EdgeNoise(self.sigma[rows], number.reshape(-1).astype(np.int64), self.Z[rows], self.tau[edges])

    def with_more(self, more: Array) -> EdgeNoise:
        """Return the errors with a further one common to each edge, more (N,) px at its places."""
        count = np.maximum(np.bincount(self.edge, minlength=self.edges), 1)
        square = np.bincount(self.edge, more**2, minlength=self.edges) / count
        return replace(self, tau=np.sqrt(self.tau**2 + square))

    @property
    def edges(self) -> int:
        """Return how many edges there are."""
        return len(self.tau)

    def white(self, X: Array) -> Array:
        """Return V^-1 X for X (N, k), edge by edge (Woodbury)."""
        by_noise = X / self.sigma[:, None] ** 2
        if not len(X) or not self.tau.any():
            return np.asarray(by_noise)
        T = (self.tau**2)[:, None, None]
        drawn = T * np.linalg.solve(np.eye(2) + T * self.sums(self.Z / self.sigma[:, None] ** 2), self.sums(by_noise))
        return np.asarray(by_noise - np.einsum("ni,nik->nk", self.Z, drawn[self.edge]) / self.sigma[:, None] ** 2)

    def common(self, H: Array) -> Array:
        """Return Q (m, 2 edges) with Q Q^T the covariance of H (m, N) times the edges' common errors."""
        Q = np.zeros((len(H), 2 * self.edges))
        for i in range(2):
            for m in range(len(H)):
                Q[m, i::2] = self.tau * np.bincount(self.edge, H[m] * self.Z[:, i], minlength=self.edges)
        return Q

    def log_determinant(self) -> float:
        """Return log det V."""
        inner = np.eye(2) + (self.tau**2)[:, None, None] * self.sums(self.Z / self.sigma[:, None] ** 2)
        return float(2 * np.log(self.sigma).sum() + np.linalg.slogdet(inner)[1].sum())

    def about_lines(self, X: Array) -> tuple[float, int]:
        """Return chi-square of values X (N,) about a line fitted to each edge, and these lines' parameters in all."""
        W = self.Z / self.sigma[:, None] ** 2
        A, b = self.sums(W), self.sums(X[:, None] / self.sigma[:, None] ** 2)[:, :, 0]
        numbers = 1 + (A[:, 1, 1] > 0).astype(np.int64)
        taken = np.einsum("ei,eij,ej->e", b, np.linalg.pinv(A, hermitian=True), b)
        return float((X / self.sigma) @ (X / self.sigma) - taken.sum()), int(numbers.sum())

    def sums(self, X: Array) -> Array:
        """Return Z^T X of each edge, (edges, 2, k)."""
        out = np.zeros((self.edges, 2, X.shape[1]))
        for i in range(2):
            for k in range(X.shape[1]):
                out[:, i, k] = np.bincount(self.edge, self.Z[:, i] * X[:, k], minlength=self.edges)
        return out


def white_scale(offset: Array, noise: EdgeNoise) -> float:
    """Return the ratio of the offsets' scatter about straight lines along their edges to that predicted by sigma.

    The root of the median over edges of chi-square over its usual value: a single bad edge has no influence.
    """
    ratios = []
    for e in range(noise.edges):
        rows = noise.edge == e
        n = int(rows.sum())
        if n < _LEAST_FOR_SCALE:
            continue
        Z, y = noise.Z[rows] / noise.sigma[rows, None], offset[rows] / noise.sigma[rows]
        r = y - Z @ np.linalg.lstsq(Z, y, rcond=None)[0]
        usual = (n - 2) * (1 - 2 / (9 * (n - 2))) ** 3  # median of chi-square (Wilson and Hilferty, 1931)
        ratios.append(float(r @ r) / usual)
    return float(np.sqrt(np.median(ratios))) if ratios else 1.0


def improbability(offset: Array, noise: EdgeNoise, J: Array, K: Array) -> float:
    """Return minus twice the logarithm of the restricted likelihood of offsets (N,), up to a constant.

    J (N, k): the motion fitted to them; K (N, r) px: other effects on them, each column by a unit error. (H. D.
    Patterson and R. Thompson, Biometrika 58, 1971.)
    """
    W = noise.white(np.column_stack([J, offset, K]))
    inner = np.eye(K.shape[1]) + K.T @ W[:, J.shape[1] + 1 :]
    W = W[:, : J.shape[1] + 1] - W[:, J.shape[1] + 1 :] @ np.linalg.solve(inner, K.T @ W[:, : J.shape[1] + 1])
    N = J.T @ W[:, :-1]
    x = np.linalg.lstsq(N, J.T @ W[:, -1], rcond=None)[0]
    chi_square = float(offset @ (W[:, -1] - W[:, :-1] @ x))
    return float(noise.log_determinant() + np.linalg.slogdet(inner)[1] + np.linalg.slogdet(N)[1] + chi_square)


def common_error(offset: Array, noise: EdgeNoise, J: Array, *, usual: float | None = None) -> float:
    """Return tau (px), beyond that of the noise model, for offsets (N,), J (N, k) being the Jacobian of the fit.

    The maximum of the restricted likelihood, which accounts for the fit of the motion to the same offsets. 0 where
    noise alone explains them. usual (px): prior value, within a factor of e, so that a few edges that happen to agree
    do not make it vanish.
    """
    sums = _Sums.of(np.column_stack([J, offset]), noise)

    def loss(log_tau: float) -> float:
        unusual = 0.0 if usual is None else (log_tau - np.log(usual)) ** 2
        return sums.improbability(noise.tau**2 + np.exp(2 * log_tau)) + unusual

    low, high = np.log(_LEAST_PX), np.log(_MOST_PX)
    a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_a, at_b = loss(a), loss(b)
    for _ in range(_TRIES):
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - _GOLDEN * (high - low)
            at_a = loss(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + _GOLDEN * (high - low)
            at_b = loss(b)
        if high - low < 1e-2:
            break
    tau = float(np.exp((low + high) / 2))
    return tau if tau > 2 * _LEAST_PX else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Sums over offsets y (N,) of edges and the Jacobian J (N, k) of the fitted motion, independent of tau.

    whole (k + 1, k + 1): X^T X over sigma^2 for X = (J, y); of_lines (edges, 2, 2): Z^T Z over sigma^2, and of_edges
    (edges, 2, k + 1): Z^T X over sigma^2, edge by edge; log_noise: log det of the noise alone.
    """

    whole: Array
    of_lines: Array
    of_edges: Array
    log_noise: float

    @classmethod
    def of(cls, X: Array, noise: EdgeNoise) -> _Sums:
        """Return the sums of X (N, k + 1)."""
        W = X / noise.sigma[:, None] ** 2
        lines = noise.sums(noise.Z / noise.sigma[:, None] ** 2)
        return cls(X.T @ W, lines, noise.sums(W), float(2 * np.log(noise.sigma).sum()))

    def improbability(self, tau2: Array) -> float:
        """Return `improbability` for edges of variances tau2 (edges,) and no other effects.

        X^T V^-1 X = X^T D X - sum over edges of S^T T (1 + T Z^T D Z)^-1 S for S = Z^T D X, D = diag(sigma^-2).
        """
        T = tau2[:, None, None]
        inner = np.eye(2) + T * self.of_lines
        drawn = T * np.linalg.solve(inner, self.of_edges)
        N = self.whole - np.einsum("eik,eil->kl", self.of_edges, drawn)
        x = np.linalg.lstsq(N[:-1, :-1], N[:-1, -1], rcond=None)[0]
        log_V = self.log_noise + np.log(np.linalg.det(inner)).sum()
        return float(log_V + np.linalg.slogdet(N[:-1, :-1])[1] + N[-1, -1] - N[:-1, -1] @ x)
