"""Nonlinear least squares on manifolds: Levenberg-Marquardt to rounding level, and what the data leave undetermined.

A problem gives its residuals with their Jacobian at a state, and moves a state by a step in the tangent space there;
the solver never looks inside a state. Sources: Marquardt (1963); the column scaling of More, "The Levenberg-Marquardt
algorithm: implementation and theory" (1978); the gain ratio of Madsen, Nielsen, Tingleff (2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import DegenerateGeometry, NotConverged

State = TypeVar("State")


class Problem(Protocol[State]):
    """What is minimised: half the sum of squares of the residuals."""

    def residuals_and_jacobian(self, state: State) -> tuple[Array, Array]:
        """Return r (m,) and dr/dstep (m, n) at `state`; a residual that is not finite forbids the state."""
        ...

    def retract(self, state: State, step: Array) -> State:
        """Return the state moved by `step` (n,) in the tangent space at `state`."""
        ...


@dataclass(frozen=True, slots=True)
class Options:
    """When to stop.

    floor: residual changes below this (in the residuals' unit) are rounding, whatever the sum of squares is.
    """

    max_iterations: int = 200
    floor: float = 1e-11
    damping: float = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Solution(Generic[State]):
    """A minimum: the state, its residuals (m,) and Jacobian (m, n), sum of squares, and iterations taken."""

    state: State
    residuals: Array
    jacobian: Array
    sum_of_squares: float
    iterations: int


class Stalled(NotConverged):
    """The iterations ran out on a slope: often towards a limit that is no state at all. Carries where it stood."""

    def __init__(self, iterations: int, sum_of_squares: float, promised: float) -> None:
        super().__init__(
            f"least squares stopped after {iterations} iterations at a sum of squares of {sum_of_squares:.6g}; "
            f"a full step still promised {promised:.3g} less"
        )
        self.sum_of_squares = sum_of_squares


def minimise(problem: Problem[State], start: State, options: Options | None = None) -> Solution[State]:
    """Return the local minimum reached from `start`.

    Converges quadratically for small residuals; the last steps are undamped and end where rounding does. Raises
    `NotConverged` if the start is forbidden, `Stalled` if the iterations run out.
    """
    options = Options() if options is None else options
    state, now = start, _linearise(problem, start, np.zeros(0))
    if not np.isfinite(now.cost):
        raise NotConverged("least squares cannot start: a residual is not finite at the first state")
    damping, growth = options.damping, 2.0
    for iteration in range(options.max_iterations):
        promised = now.promise(0.0)
        if promised <= 1e-13 * now.cost or np.sqrt(promised) <= options.floor:
            return _polish(problem, state, now, iteration)
        candidate = problem.retract(state, now.step(damping))
        then = _linearise(problem, candidate, now.scale)
        gain = (now.cost - then.cost) / now.promise(damping) if np.isfinite(then.cost) else -np.inf
        if gain > 0:
            state, now, growth = candidate, then, 2.0
            damping *= max(1 / 3, 1 - (2 * gain - 1) ** 3)
        elif damping > 1e12:  # no direction goes down any more: rounding rules
            return _polish(problem, state, now, iteration)
        else:
            damping, growth = max(damping, 1e-9) * growth, 2 * growth
    raise Stalled(options.max_iterations, now.cost, now.promise(0.0))


def cofactor(jacobian: Array, names: Sequence[str], *, rank_tolerance: float = 1e-10) -> Array:
    """Return (J^T J)^-1 (n, n): the covariance of the parameters for residuals of unit noise.

    Raises `DegenerateGeometry` naming the combination of parameters that the residuals do not see: a singular value of
    J (columns scaled to one) below `rank_tolerance` of the largest.
    """
    scale = _column_norms(jacobian)
    _, s, Vt = np.linalg.svd(jacobian / scale, full_matrices=False)
    blind = np.flatnonzero(s <= rank_tolerance * s[0]) if s.size else np.arange(0)
    if blind.size or len(s) < len(names):
        direction = Vt[-1] / scale
        raise DegenerateGeometry(
            f"the observations do not determine {_combination(Vt[-1], direction, names)} "
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
        """Return by how much the linear model says that the sum of squares falls."""
        left = 1 - self._filter(damping) * self.s
        return float(np.sum((1 - left**2) * self.along**2))

    def _filter(self, damping: float) -> Array:
        useful = self.s > 1e-13 * self.s[0]
        return np.where(useful, self.s / np.where(useful, self.s**2 + damping, 1.0), 0.0)


def _linearise(problem: Problem[State], state: State, earlier_scale: Array) -> _Linearised:
    r, J = problem.residuals_and_jacobian(state)
    if not (np.isfinite(r).all() and np.isfinite(J).all()):
        nothing = np.zeros(J.shape[1])
        return _Linearised(r, J, nothing, np.inf, nothing, nothing, np.zeros((J.shape[1],) * 2))
    scale = np.maximum(_column_norms(J), earlier_scale) if earlier_scale.size else _column_norms(J)
    U, s, Vt = np.linalg.svd(J / scale, full_matrices=False)
    return _Linearised(r, J, scale, float(r @ r), U.T @ r, s, Vt)


def _polish(problem: Problem[State], state: State, now: _Linearised, iteration: int) -> Solution[State]:
    """Full steps as long as each promises less than half of what the one before did: below what the cost can show."""
    for _ in range(20):
        candidate = problem.retract(state, now.step(0.0))
        then = _linearise(problem, candidate, np.zeros(0))
        if not (np.isfinite(then.cost) and then.cost <= now.cost * (1 + 1e-12)):
            break
        if not then.promise(0.0) < 0.5 * now.promise(0.0):
            break
        state, now = candidate, then
    return Solution(state, now.residuals, now.jacobian, now.cost, iteration)


def _column_norms(J: Array) -> Array:
    norms = np.linalg.norm(J, axis=0)
    return np.where(norms > 0, norms, 1.0)


def _combination(weights: Array, direction: Array, names: Sequence[str]) -> str:
    """Words for a direction: the parameters that carry at least a tenth of it, by weight."""
    order = [i for i in np.argsort(-np.abs(weights)) if abs(weights[i]) >= 0.1 * np.abs(weights).max()]
    if len(order) == 1:
        return f"{names[order[0]]}"
    lead = direction[order[0]]
    rest = " ".join(f"{direction[i] / lead:+.3g} {names[i]}" for i in order[1:])
    return f"the combination {names[order[0]]} {rest}"
