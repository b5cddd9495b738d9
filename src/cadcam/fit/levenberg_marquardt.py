"""The loop behind every fit: Levenberg-Marquardt down to rounding, on opaque states.

The callers' linear algebra (`fit.least_squares` dense, `fit.block_least_squares` with blocks eliminated) provides a
linearisation with its cost, the step for a damping, and the decrease of the cost predicted for that step. Sources:
Marquardt (1963); the column scaling of More, "The Levenberg-Marquardt algorithm: implementation and theory" (1978); the
gain ratio of Madsen, Nielsen, Tingleff (2004).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from cadcam.errors import NotConverged


class Linearised(Protocol):
    """A least-squares problem linearised at one state."""

    @property
    def cost(self) -> float:
        """Return the sum of squares there (of a robust loss: its sum), inf for a forbidden state."""
        ...

    def step(self, damping: float) -> Any:
        """Return the step of the damped linear problem, in the form that `retract` takes."""
        ...

    def promise(self, damping: float) -> float:
        """Return the decrease of the cost that the linear problem predicts for this step."""
        ...


State = TypeVar("State")
Model = TypeVar("Model", bound=Linearised)


@dataclass(frozen=True, slots=True)
class Options:
    """Stopping criteria.

    settled: a step with a predicted relative decrease below this ends the damped iterations; full steps follow until
    one is below `enough`, 0 for down to rounding. floor: residual changes below this (in the residuals' unit) are
    rounding, whatever the sum of squares is.
    """

    max_iterations: int = 200
    floor: float = 1e-11
    damping: float = 1e-4
    settled: float = 1e-13
    enough: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Minimum(Generic[State, Model]):
    """The end of the loop: the state, the problem linearised there, and the number of iterations."""

    state: State
    model: Model
    iterations: int


class Stalled(NotConverged):
    """The iterations ran out on a slope: often towards a limit that is not a state."""

    def __init__(self, iterations: int, sum_of_squares: float, promised: float) -> None:
        super().__init__(
            f"least squares stopped after {iterations} iterations at a sum of squares of {sum_of_squares:.6g}; "
            f"a full step still promised {promised:.3g} less"
        )
        self.sum_of_squares = sum_of_squares


def levenberg_marquardt(
    linearise: Callable[[State, Model | None], Model],
    retract: Callable[[State, Any], State],
    start: State,
    options: Options | None = None,
) -> Minimum[State, Model]:
    """Return the local minimum reached from `start`.

    linearise(state, earlier) linearises the problem; from `earlier`, if given, it takes over the column scale, which
    only grows. Converges quadratically for small residuals; the last steps are undamped and end at rounding. Raises
    `NotConverged` if the start is forbidden, `Stalled` if the iterations run out.
    """
    options = Options() if options is None else options
    state, now = start, linearise(start, None)
    if not np.isfinite(now.cost):
        raise NotConverged("least squares cannot start: a residual is not finite at the first state")
    damping, growth = options.damping, 2.0
    for iteration in range(options.max_iterations):
        promised = now.promise(0.0)
        if promised <= options.settled * now.cost or np.sqrt(promised) <= options.floor:
            return _polish(linearise, retract, state, now, iteration, options)
        candidate = retract(state, now.step(damping))
        then = linearise(candidate, now)
        gain = (now.cost - then.cost) / now.promise(damping) if np.isfinite(then.cost) else -np.inf
        if gain > 0:
            state, now, growth = candidate, then, 2.0
            damping *= max(1 / 3, 1 - (2 * gain - 1) ** 3)
        elif damping > 1e12:  # no direction goes down any more: rounding rules
            return _polish(linearise, retract, state, now, iteration, options)
        else:
            damping, growth = max(damping, 1e-9) * growth, 2 * growth
    raise Stalled(options.max_iterations, now.cost, now.promise(0.0))


def _polish(
    linearise: Callable[[State, Model | None], Model],
    retract: Callable[[State, Any], State],
    state: State,
    now: Model,
    iteration: int,
    options: Options,
) -> Minimum[State, Model]:
    """Full steps as long as each promises less than half of what the one before did: below what the cost can show."""
    for _ in range(20):
        if now.promise(0.0) <= options.enough * now.cost:
            break
        candidate = retract(state, now.step(0.0))
        then = linearise(candidate, None)
        if not (np.isfinite(then.cost) and then.cost <= now.cost * (1 + 1e-12)):
            break
        if not then.promise(0.0) < 0.5 * now.promise(0.0):
            break
        state, now = candidate, then
    return Minimum(state, now, iteration)
