"""The errors of edges in a photo: white noise along an edge, and an error common to the whole edge.

Offsets along one edge have errors in common: chamfers, shadows, unequal blur, neighbouring edges. An edge's common
error is modelled as a random straight line, a shift and a tilt of variance tau^2 each (variance components): V =
diag(sigma^2) + tau^2 Z Z^T with Z = (1, t) for each edge, t its position scaled to unit mean square. A covariance from
noise alone lacks tau, which does not average out over the samples of an edge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask

# Range in which tau is searched for. At twice the least it is a 50th of what edges have in common in most photos (0.01
# px), 0.04 % of that variance: none. At the most it is twice as large as an edge may be off and be taken for a line's.
_LEAST_PX, _MOST_PX = 1e-4, 3.0
_NEAR = 1e-2  # of the logarithm of tau, when it is found: 1 %, while few edges tell it to better than 30 %
_NODES, _BEND = 5, 0.25  # of a mean over the logarithm of tau, and where the density's curvature is taken
_LEAST_FOR_SCALE = 5  # places: from 3 degrees of freedom on Wilson and Hilferty's median is right to 0.7 %
_SINGULAR = 1e-12  # share of the largest eigenvalue below which one is rounding
_GOLDEN = (np.sqrt(5.0) - 1) / 2  # the golden section's share


@dataclass(frozen=True, slots=True, eq=False)
class EdgeNoise:
    """The covariance V (N, N) of offsets: sigma (N,) px, edge (N,) numbers from 0, Z (N, 2), tau (edges,) px.

    apart (N,) px: a further error of each place by itself, other than the photo's noise.
    """

    sigma: Array
    edge: Longs
    Z: Array
    tau: Array
    apart: Array

    @classmethod
    def of(cls, sigma: Array, edge: Longs, along: Array, tau: float) -> EdgeNoise:
        """Return the model of offsets at positions `along` (N,) px of their edges."""
        number = np.unique(edge, return_inverse=True)[1].reshape(-1).astype(np.int64)
        count = np.maximum(np.bincount(number), 1)
        middle = along - (np.bincount(number, along) / count)[number]
        spread = np.sqrt(np.bincount(number, middle**2) / count)[number]
        t = np.divide(middle, spread, out=np.zeros_like(middle), where=spread > 0)
        Z = np.stack([np.ones_like(t), t], axis=1)
        return cls(np.asarray(sigma, np.float64), number, Z, np.full(len(count), float(tau)), np.zeros(len(number)))

    def of_rows(self, rows: Mask) -> EdgeNoise:
        """Return the errors of some offsets (mask over N); part of an edge keeps the edge's common line."""
        edges, number = np.unique(self.edge[rows], return_inverse=True)
        number = number.reshape(-1).astype(np.int64)
        return EdgeNoise(self.sigma[rows], number, self.Z[rows], self.tau[edges], self.apart[rows])

    def only(self, rows: Mask) -> EdgeNoise:
        """Return the errors of some offsets (mask over N); edges keep their numbers, also those without offsets."""
        return EdgeNoise(self.sigma[rows], self.edge[rows], self.Z[rows], self.tau, self.apart[rows])

    def with_more(self, more: Array) -> EdgeNoise:
        """Return the errors with a further one common to each edge, more (N,) px at its places."""
        count = np.maximum(np.bincount(self.edge, minlength=self.edges), 1)
        square = np.bincount(self.edge, more**2, minlength=self.edges) / count
        return replace(self, tau=np.sqrt(self.tau**2 + square))

    @property
    def each(self) -> Array:
        """Return the standard deviation (N,) px of each place about its edge's common line."""
        return np.hypot(self.sigma, self.apart)

    @property
    def edges(self) -> int:
        """Return how many edges there are."""
        return len(self.tau)

    def white(self, X: Array) -> Array:
        """Return V^-1 X for X (N, k), edge by edge (Woodbury)."""
        each = self.each
        by_noise = X / each[:, None] ** 2
        if not len(X) or not self.tau.any():
            return np.asarray(by_noise)
        K, _ = _drawn_by(self.sums(self.Z / each[:, None] ** 2), self.tau**2)
        one, other = np.moveaxis(self.sums(by_noise), 1, 0)
        for i in range(2):
            line = K[:, i, :1] * one + K[:, i, 1:] * other
            by_noise -= (self.Z[:, i] / each**2)[:, None] * line[self.edge]
        return np.asarray(by_noise)

    def common(self, H: Array) -> Array:
        """Return Q (m, 2 edges) with Q Q^T the covariance of H (m, N) times the edges' common errors."""
        Q = np.zeros((len(H), 2 * self.edges))
        for i in range(2):
            for m in range(len(H)):
                Q[m, i::2] = self.tau * np.bincount(self.edge, H[m] * self.Z[:, i], minlength=self.edges)
        return Q

    def log_determinant(self) -> float:
        """Return log det V."""
        each = self.each
        _, inner = _drawn_by(self.sums(self.Z / each[:, None] ** 2), self.tau**2)
        return float(2 * np.log(each).sum() + np.log(inner).sum())

    def about_lines(self, X: Array) -> tuple[float, int]:
        """Return chi-square of values X (N,) about a line fitted to each edge, and these lines' parameters in all."""
        W, each = self.Z / self.each[:, None] ** 2, X / self.each
        A, b = self.sums(W), self.sums(X[:, None] / self.each[:, None] ** 2)[:, :, 0]
        numbers = np.minimum(np.bincount(self.edge, minlength=self.edges), 2)  # one place tells no slope
        taken = np.einsum("ei,eij,ej->e", b, np.linalg.pinv(A, rcond=_SINGULAR, hermitian=True), b)
        return float(each @ each - taken.sum()), int(numbers.sum())

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
    do not make it vanish; then the root of the mean square of what tau may be: few edges leave it open, and a value is
    as far off as the larger ones have it.
    """
    sums = EdgeSums.of(np.column_stack([J, offset]), noise, fitted=J.shape[1])
    return sums.common_error(noise.tau, usual=usual)


def _drawn_by(A: Array, T: Array) -> tuple[Array, Array]:
    """Return T (1 + T A)^-1 (E, 2, 2), and det(1 + T A) (E,), for symmetric A (E, 2, 2) and variances T (E,).

    Written out: there are thousands of edges, and LAPACK is called for each matrix by itself.
    """
    a, b, d = 1 + T * A[:, 0, 0], T * A[:, 0, 1], 1 + T * A[:, 1, 1]
    det = a * d - b * b
    K = (T / det)[:, None] * np.stack([d, -b, -b, a], axis=1)
    return K.reshape(-1, 2, 2), det


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSums:
    """Sums over the offsets of E edges, from which a motion fitted to them follows whatever tau is.

    Of columns X (N, m) = (J, y, C): the fitted k, the offsets, and any more. With D = diag(sigma^-2) and S = Z^T D X of
    each edge, for the p pairs of columns that are needed: plain (E, p) from X^T D X; crossed (3, E, p) from S_0 S_0,
    S_0 S_1 + S_1 S_0 and S_1 S_1. of_lines (E, 2, 2): Z^T D Z; log_noise (E,): log det of the noise alone.
    """

    fitted: int
    columns: int
    plain: Array
    crossed: Array
    of_lines: Array
    log_noise: Array

    @classmethod
    def of(cls, X: Array, noise: EdgeNoise, *, fitted: int) -> EdgeSums:
        """Return the sums of X (N, m), of which the first k = `fitted` columns are J."""
        D = noise.each**-2.0
        one, other = np.moveaxis(noise.sums(X * D[:, None]), 1, 0)
        i, j = _pairs(fitted, X.shape[1])
        crossed = one[:, i] * other[:, j] + other[:, i] * one[:, j]
        pairs = zip(i, j, strict=True)
        every = [np.bincount(noise.edge, D * X[:, a] * X[:, b], minlength=noise.edges) for a, b in pairs]
        return cls(
            fitted,
            X.shape[1],
            np.stack(every, axis=1),
            np.stack([one[:, i] * one[:, j], crossed, other[:, i] * other[:, j]]),
            noise.sums(noise.Z * D[:, None]),
            np.asarray(np.bincount(noise.edge, 2 * np.log(noise.each), minlength=noise.edges), np.float64),
        )

    def of_none(self) -> EdgeSums:
        """Return the sums of the same columns over no edges."""
        none = slice(0)
        rest = self.plain[none], self.crossed[:, none], self.of_lines[none], self.log_noise[none]
        return EdgeSums(self.fitted, self.columns, *rest)

    def normal(self, tau: Array) -> Array:
        """Return J^T V^-1 X (E, k, m) of each edge, for common errors tau (E,).

        X^T V^-1 X = X^T D X - S^T T (1 + T Z^T D Z)^-1 S, with T = tau^2.
        """
        weight, _ = self._drawn(tau**2)
        each = self.plain - np.einsum("pe,pek->ek", weight, self.crossed)
        (i, j), k = _pairs(self.fitted, self.columns), self.fitted
        out = np.zeros((len(each), k + 1, self.columns))
        out[:, i, j] = each
        within = j <= k
        out[:, j[within], i[within]] = each[:, within]
        return out[:, :k]

    def common_error(self, known: Array, *, usual: float | None) -> float:
        """Return tau (px) beyond the `known` (E,) of each edge; see `common_error`."""
        noise = float(self.log_noise.sum())

        def terms(log_tau: float) -> tuple[Array, float]:
            each, inner = self.terms(known, log_tau)
            return each.sum(axis=0), noise + float(inner.sum())

        return likeliest(terms, self.fitted, usual=usual)

    def terms(self, known: Array, log_tau: float) -> tuple[Array, Array]:
        """Return what each edge adds to (J, y)^T V^-1 (J, y), (E, p) of its upper triangle, and to log det V, (E,).

        Of the latter without what the noise alone adds. known (E,): its common error (px) besides tau.
        """
        own = slice((self.fitted + 1) * (self.fitted + 2) // 2)
        weight, inner = self._drawn(known**2 + np.exp(2 * log_tau))
        return self.plain[:, own] - np.einsum("pe,pek->ek", weight, self.crossed[:, :, own]), np.log(inner)

    def _drawn(self, T: Array) -> tuple[Array, Array]:
        K, inner = _drawn_by(self.of_lines, T)
        return np.stack([K[:, 0, 0], K[:, 0, 1], K[:, 1, 1]]), inner


def likeliest(
    terms: Callable[[float], tuple[Array, float]], k: int, *, usual: float | None, free: int | None = None
) -> float:
    """Return tau (px) by the restricted likelihood of offsets y, J (N, k) being the Jacobian of the fit.

    terms: of the logarithm of tau, the upper triangle of (J, y)^T V^-1 (J, y) and log det V. usual: see `common_error`.
    free: how many of what is fitted are unknown; the others have a standard deviation of 1. Default all.
    """
    i, j = np.triu_indices(k + 1)
    N, known = np.zeros((k + 1, k + 1)), np.arange(k if free is None else free, k)

    def loss(log_tau: float) -> float:
        N[i, j], log_det = terms(log_tau)
        N[j, i] = N[i, j]
        N[known, known] += 1.0
        unusual = 0.0 if usual is None else (log_tau - np.log(usual)) ** 2
        return log_det + _log_det_and_rest(N) + unusual

    at = _least(loss, np.log(_LEAST_PX), np.log(_MOST_PX))
    if usual is not None:
        return _root_mean_square(loss, at)
    return float(np.exp(at)) if at > np.log(2 * _LEAST_PX) else 0.0


def _root_mean_square(loss: Callable[[float], float], at: float) -> float:
    """Return the root of the mean of tau^2, given minus twice the log density of log tau, which is least at `at`.

    By Gauss and Hermite's rule about there (J. C. Naylor and A. F. M. Smith, Appl. Stat. 31, 1982).
    """
    x, weight = np.polynomial.hermite.hermgauss(_NODES)
    below, least, above = loss(at - _BEND), loss(at), loss(at + _BEND)
    if not np.isfinite([below, least, above]).all():  # edges that leave a motion free
        return float(np.exp(at))
    bend = (below + above - 2 * least) / _BEND**2
    logs = at + 2 * x / np.sqrt(max(bend, 1.0))  # a usual error alone has 2, and edges may take some of it away
    more = np.array([loss(float(t)) for t in logs]) - least
    density = weight * np.exp(x**2 - 0.5 * np.where(np.isfinite(more), more, np.inf))
    mean = 0.5 * np.log(density @ np.exp(2 * logs) / density.sum())
    return float(np.exp(_NEAR * np.rint(mean / _NEAR)))  # in steps, as many fits of nearly the same edges share them


def _log_det_and_rest(N: Array) -> float:
    """Return log det J^T V^-1 J + chi-square of the fit, for N = (J, y)^T V^-1 (J, y)."""
    try:
        L = np.diag(np.linalg.cholesky(N))
    except np.linalg.LinAlgError:  # a motion that the edges leave free, or a fit without a residual
        x = np.linalg.lstsq(N[:-1, :-1], N[:-1, -1], rcond=None)[0]
        return float(np.linalg.slogdet(N[:-1, :-1])[1] + N[-1, -1] - N[:-1, -1] @ x)
    return float(2 * np.log(L[:-1]).sum() + L[-1] ** 2)


def _pairs(k: int, m: int) -> tuple[Longs, Longs]:
    """Return the pairs of m columns that are needed: of the first k + 1, then of the first k and the rest."""
    i, j = np.triu_indices(k + 1)
    rest = np.arange(k + 1, m)
    return np.append(i, np.repeat(np.arange(k), len(rest))), np.append(j, np.tile(rest, k))


def _least(loss: Callable[[float], float], low: float, high: float) -> float:
    """Return where a function of one minimum is least, by the golden section."""
    a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_a, at_b = loss(a), loss(b)
    while high - low >= _NEAR:
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - _GOLDEN * (high - low)
            at_a = loss(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + _GOLDEN * (high - low)
            at_b = loss(b)
    return (low + high) / 2
