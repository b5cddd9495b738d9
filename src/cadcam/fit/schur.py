"""Residuals in blocks that share parameters: the damped normal equations, each block's own parameters eliminated.

The normal equations of k blocks, shared parameters a and own parameters b_j, are an arrow; eliminating b_j leaves
(H_aa - sum_j H_ab H_bb^-1 H_ba) a = ..., as small as the shared part (Brown 1958; Triggs et al., "Bundle adjustment: a
modern synthesis" (2000), section 6.1). Columns are scaled to length one, so units do not matter; squaring still costs
half of the digits, which repeated steps recover: the rank and the covariance come from `fit.square_root`. Products are
batches of small ones, for which no library starts threads that then spin.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask

_RIDGE = 1e-13  # of a column's squared length: keeps unobservable directions solvable, and at rest
_EMPTY = np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A move of the shared parameters (n,) and of each block's own (k, l), in their tangent spaces."""

    shared: Array
    own: Array


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Residuals and Jacobians of k blocks of m rows, in the unit of their noise: n shared and l own parameters.

    stacked (k, l + n + 1, m): the derivatives by the l own parameters, by the shared ones, and the residuals, one
    column after the other: elimination and factorisation take them as one matrix. Blocks of fewer rows are padded with
    rows of zeros, and `measured` (k, m) marks the real rows (None: all). Rows on shared parameters alone (priors, known
    distances) are in alone_r (p,), alone_by_shared (p, n). A prior on own parameters is a row of its block. pairs (c,
    2): the rows of the two coordinates of each image point, on whose distance a robust loss acts (None: rows 0 1, 2 3,
    ...). n or l may be 0. A residual that is not finite forbids the state.
    """

    stacked: Array
    own: int
    measured: Mask | None = None
    alone_r: Array = field(default_factory=lambda: _EMPTY)
    alone_by_shared: Array | None = None
    pairs: npt.NDArray[np.intp] | None = None

    @classmethod
    def of(
        cls,
        r: Array,
        by_shared: Array,
        by_own: Array,
        measured: Mask | None = None,
        *,
        alone_r: Array = _EMPTY,
        alone_by_shared: Array | None = None,
        pairs: npt.NDArray[np.intp] | None = None,
    ) -> Blocks:
        """Return the blocks of residuals r (k, m) and Jacobians by_shared (k, m, n), by_own (k, m, l)."""
        stacked = np.swapaxes(np.concatenate([by_own, by_shared, r[..., None]], axis=-1), 1, 2)
        return cls(stacked, by_own.shape[2], measured, alone_r, alone_by_shared, pairs)

    @classmethod
    def forbidden(cls, k: int, m: int) -> Blocks:
        """Return the blocks of a forbidden state."""
        return cls(np.full((k, 1, m), np.nan), 0)

    @property
    def r(self) -> Array:
        """Return the residuals (k, m)."""
        return self.stacked[:, -1]

    @property
    def by_shared(self) -> Array:
        """Return the Jacobian (k, m, n) by the shared parameters."""
        return np.swapaxes(self.stacked[:, self.own : -1], 1, 2)

    @property
    def by_own(self) -> Array:
        """Return the Jacobian (k, m, l) of each block by its own parameters."""
        return np.swapaxes(self.stacked[:, : self.own], 1, 2)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Return (k, n, l): the numbers of blocks, of shared and of own parameters."""
        return self.stacked.shape[0], self.stacked.shape[1] - self.own - 1, self.own

    @property
    def rows(self) -> int:
        """Return the number of real rows."""
        in_blocks = self.r.size if self.measured is None else int(self.measured.sum())
        return in_blocks + len(self.alone_r)

    @property
    def dof(self) -> int:
        """Return the degrees of freedom: real rows less parameters."""
        k, n, own = self.sizes
        return self.rows - n - k * own

    @property
    def alone(self) -> Array:
        """Return the Jacobian (p, n) of the rows on shared parameters alone."""
        return np.zeros((0, self.sizes[1])) if self.alone_by_shared is None else self.alone_by_shared

    @property
    def sum_of_squares(self) -> float:
        """Return the sum of squares of all residuals."""
        return float(np.einsum("kr,kr->", self.r, self.r) + self.alone_r @ self.alone_r)

    @property
    def _rows_of_points(self) -> npt.NDArray[np.intp]:
        """The rows (c, 2) of the two coordinates of each image point."""
        return np.arange(self.r.shape[1] // 2 * 2).reshape(-1, 2) if self.pairs is None else self.pairs

    def squared_distances(self) -> Array:
        """Return the squared length (k, c) of each point's residual vector; 0 where nothing was measured."""
        rows = self._rows_of_points
        return np.asarray(self.r[:, rows[:, 0]] ** 2 + self.r[:, rows[:, 1]] ** 2)

    def measured_pairs(self) -> Mask:
        """Return which points (k, c) were measured."""
        rows = self._rows_of_points
        if self.measured is None:
            return np.ones((len(self.r), len(rows)), dtype=bool)
        return np.asarray(self.measured[:, rows].all(axis=-1))

    def weighted(self, weights: Array) -> Blocks:
        """Return the blocks with the rows of each point multiplied by the square root of its weight (k, c)."""
        rows = self._rows_of_points
        w = np.ones_like(self.r)
        w[:, rows] = np.sqrt(weights)[..., None]
        return replace(self, stacked=w[:, None] * self.stacked)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """The scaled normal equations of blocks at one state, and their damped solutions."""

    blocks: Blocks
    cost: float
    shared_scale: Array  # (n,)
    own_scale: Array  # (k, l)
    aa: Array = field(default_factory=lambda: _EMPTY)
    ab: Array = field(default_factory=lambda: _EMPTY)  # (k, l, n), that is own by shared
    bb: Array = field(default_factory=lambda: _EMPTY)
    ga: Array = field(default_factory=lambda: _EMPTY)
    gb: Array = field(default_factory=lambda: _EMPTY)
    _solved: dict[float, tuple[Step, float]] = field(default_factory=dict, repr=False)

    def step(self, damping: float) -> Step:
        """Return the step that solves the damped equations."""
        return self._solution(damping)[0]

    def promise(self, damping: float) -> float:
        """Return the decrease of the sum of squares that the linear problem predicts for this step."""
        return self._solution(damping)[1]

    def _solution(self, damping: float) -> tuple[Step, float]:
        if damping not in self._solved:
            self._solved[damping] = self._solve(damping)
        return self._solved[damping]

    def _solve(self, damping: float) -> tuple[Step, float]:
        d = damping + _RIDGE
        _, n, own = self.blocks.sizes
        right = np.concatenate([self.ab, self.gb[..., None]], axis=-1)
        eliminated = np.linalg.solve(self.bb + d * np.eye(own), right) if own else right
        G, gb = eliminated[..., :n], eliminated[..., n]
        ba = np.swapaxes(self.ab, -1, -2)
        reduced = self.aa + d * np.eye(n) - (ba @ G).sum(axis=0)
        a = -np.linalg.solve(reduced, self.ga - (ba @ gb[..., None])[..., 0].sum(axis=0)) if n else _EMPTY
        b = -gb - G @ a
        promised = -(self.ga @ a) - np.vdot(self.gb, b) + d * (a @ a + np.vdot(b, b))
        return Step(a / self.shared_scale, b / self.own_scale), max(float(promised), 0.0)


def normal_equations(blocks: Blocks, cost: float, earlier: NormalEquations | None) -> NormalEquations:
    """Return the scaled normal equations of (weighted) blocks whose cost is `cost`."""
    k, n, own = blocks.sizes
    if not np.isfinite(cost):
        return NormalEquations(blocks, np.inf, np.ones(n), np.ones((k, own)))
    alone = blocks.alone
    products = blocks.stacked[:, :-1] @ np.swapaxes(blocks.stacked, 1, 2)  # all of them in one
    shared = products[:, own:].sum(axis=0)
    aa, bb = shared[:, own:-1] + alone.T @ alone, products[:, :own, :own]
    a_scale, b_scale = _scale(aa), _scale(bb)
    if earlier is not None:
        a_scale, b_scale = np.maximum(a_scale, earlier.shared_scale), np.maximum(b_scale, earlier.own_scale)
    return NormalEquations(
        blocks,
        cost,
        a_scale,
        b_scale,
        aa=aa / np.outer(a_scale, a_scale),
        ab=products[:, :own, own:-1] / (b_scale[:, :, None] * a_scale),
        bb=bb / (b_scale[:, :, None] * b_scale[:, None, :]),
        ga=(shared[:, -1] + alone.T @ blocks.alone_r) / a_scale,
        gb=products[:, :own, -1] / b_scale,
    )


def _scale(H: Array) -> Array:
    lengths = np.sqrt(np.diagonal(H, axis1=-2, axis2=-1))
    return np.where(lengths > 0, lengths, 1.0)
