"""Least squares with one dense Jacobian: minima to rounding level, and what the data leave undetermined.

A problem gives its residuals with their Jacobian at a state, and moves a state by a step in the tangent space there;
the solver never looks inside a state. Small problems only: each step takes a singular value decomposition. For views
that share parameters see `fit.block_least_squares`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import DegenerateGeometry
from cadcam.fit.levenberg_marquardt import Options as Options
from cadcam.fit.levenberg_marquardt import Stalled as Stalled
from cadcam.fit.levenberg_marquardt import levenberg_marquardt

State = TypeVar("State")
_RANK = 1e-10


class Problem(Protocol[State]):
    """What is minimised: half the sum of squares of the residuals."""

    def residuals_and_jacobian(self, state: State) -> tuple[Array, Array]:
        """Return r (m,) and dr/dstep (m, n) at `state`; a residual that is not finite forbids the state."""
        ...

    def retract(self, state: State, step: Array) -> State:
        """Return the state moved by `step` (n,) in the tangent space at `state`."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Solution(Generic[State]):
    """A minimum: the state, its residuals (m,) and Jacobian (m, n), sum of squares, and iterations taken."""

    state: State
    residuals: Array
    jacobian: Array
    sum_of_squares: float
    iterations: int


def minimise(problem: Problem[State], start: State, options: Options | None = None) -> Solution[State]:
    """Return the local minimum reached from `start` (`levenberg_marquardt`).

    Raises `NotConverged` if the start is forbidden, `Stalled` if the iterations run out.
    """

    def linearise(state: State, earlier: _Linearised | None) -> _Linearised:
        return _linearise(problem, state, earlier)

    found = levenberg_marquardt(linearise, problem.retract, start, options)
    return Solution(found.state, found.model.residuals, found.model.jacobian, found.model.cost, found.iterations)


def cofactor(jacobian: Array, names: Sequence[str]) -> Array:
    """Return (J^T J)^-1 (n, n): the covariance of the parameters for residuals of unit noise.

    Raises `DegenerateGeometry` naming the combination of parameters that the residuals do not determine: a singular
    value of J (columns scaled to one) below 1e-10 of the largest.
    """
    scale = column_norms(jacobian)
    enough = np.zeros((max(0, len(names) - len(jacobian)), len(names)))  # rows at least as many as columns: Vt is whole
    _, s, Vt = np.linalg.svd(np.concatenate([jacobian / scale, enough]), full_matrices=False)
    if (s <= _RANK * s[:1]).any():
        direction = Vt[-1] / scale
        raise DegenerateGeometry(
            f"the observations do not determine {combination(Vt[-1], direction, names)} "
            f"(singular value ratio {s[-1] / s[0]:.2g}); fix one of these parameters, or add points that tell "
            "them apart"
        )
    W = Vt.T / s
    return np.asarray((W @ W.T) / np.outer(scale, scale))


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """Residuals and the singular value decomposition of the scaled Jacobian at one state."""

    residuals: Array
    jacobian: Array
    scale: Array
    cost: float
    along: Array  # U^T r
    s: Array
    Vt: Array

    def step(self, damping: float) -> Array:
        return np.asarray(-(self.Vt.T @ (self._filter(damping) * self.along)) / self.scale)

    def promise(self, damping: float) -> float:
        """Return the decrease of the sum of squares predicted by the linear model."""
        left = 1 - self._filter(damping) * self.s
        return float(np.sum((1 - left**2) * self.along**2))

    def _filter(self, damping: float) -> Array:
        useful = self.s > 1e-13 * self.s[0]
        return np.where(useful, self.s / np.where(useful, self.s**2 + damping, 1.0), 0.0)


def _linearise(problem: Problem[State], state: State, earlier: _Linearised | None) -> _Linearised:
    r, J = problem.residuals_and_jacobian(state)
    if not (np.isfinite(r).all() and np.isfinite(J).all()):
        nothing = np.zeros(J.shape[1])
        return _Linearised(r, J, nothing, np.inf, nothing, nothing, np.zeros((J.shape[1],) * 2))
    scale = column_norms(J) if earlier is None else np.maximum(column_norms(J), earlier.scale)
    U, s, Vt = np.linalg.svd(J / scale, full_matrices=False)
    return _Linearised(r, J, scale, float(r @ r), U.T @ r, s, Vt)


def column_norms(J: Array) -> Array:
    """Return the length of every column of J (m, n); 1 for a column of zeros."""
    norms = np.linalg.norm(J, axis=0)
    return np.where(norms > 0, norms, 1.0)


def combination(weights: Array, direction: Array, names: Sequence[str]) -> str:
    """Return a description of a direction (n,): the parameters that have at least a tenth of it by weight (n,)."""
    order = [i for i in np.argsort(-np.abs(weights)) if abs(weights[i]) >= 0.1 * np.abs(weights).max()]
    if len(order) == 1:
        return f"{names[order[0]]}"
    lead = direction[order[0]]
    rest = " ".join(f"{direction[i] / lead:+.3g} {names[i]}" for i in order[1:])
    return f"the combination {names[order[0]]} {rest}"
