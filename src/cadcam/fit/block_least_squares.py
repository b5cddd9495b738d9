"""Block least squares: views with poses of their own that share a camera, robot poses that share a hand-eye motion.

A problem gives its residuals in `Blocks` at a state and moves a state by a `Step`. A single view is one block; a
problem may also have only shared or only own parameters. The loop is that of `fit.levenberg_marquardt`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from cadcam.arrays import Array
from cadcam.fit.levenberg_marquardt import Options, levenberg_marquardt
from cadcam.fit.robust import Loss, noise_of_the_good
from cadcam.fit.schur import Blocks, NormalEquations, Step, normal_equations

State = TypeVar("State")

_ROUNDS = 20  # of alternating between the scale of a robust loss and the fit
_SETTLED = 1e-3  # relative change of that scale


class BlockProblem(Protocol[State]):
    """What is minimised: the sum of squares (or a robust loss) of residuals that come in blocks."""

    def blocks(self, state: State) -> Blocks:
        """Return the residuals and Jacobians at `state`; a residual that is not finite forbids the state."""
        ...

    def retract(self, state: State, step: Step) -> State:
        """Return the state moved by `step` in the tangent spaces at `state`."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class BlockSolution(Generic[State]):
    """A minimum of a block problem.

    blocks: residuals and Jacobians there, unweighted. weights (k, c): the loss' weight of each point, 1 without one.
    cost: the minimised sum. scale: of the loss, in the residuals' unit (nan without one). excess: by how much the
    cofactors of blocks with these weights exceed their covariance (`Loss.excess`); 1 without. variance: of a residual,
    which turns the cofactors of `weighted` into covariances where the noise is unknown; nan without freedom.
    """

    state: State
    blocks: Blocks
    weights: Array
    cost: float
    scale: float
    excess: float
    variance: float
    iterations: int

    @property
    def weighted(self) -> Blocks:
        """Return the blocks with as much information as their points give: what `fit.square_root.factorise` takes."""
        return self.blocks if np.isnan(self.scale) else self.blocks.weighted(self.excess * self.weights)


def minimise_blocks(
    problem: BlockProblem[State], start: State, *, loss: Loss | None = None, options: Options | None = None
) -> BlockSolution[State]:
    """Return the local minimum reached from `start`.

    With a robust loss each step solves the reweighted problem. Its scale starts from the median distance at the start
    and is updated from each fit until it converges, so that a poor start is no outlier; a stated scale is kept for the
    last fit. Raises `NotConverged` if the start is forbidden, `Stalled` if the iterations run out.
    """
    loss = Loss() if loss is None else loss
    if loss.is_squared:
        return _fit(problem, start, loss, np.nan, options)
    scale = _scale_of(problem.blocks(start))
    for _ in range(_ROUNDS):
        found = _fit(problem, start, loss, scale, options)
        start, earlier, scale = found.state, scale, _scale_of(found.blocks)
        if abs(scale - earlier) <= _SETTLED * earlier:
            break
    return found if loss.scale is None else _fit(problem, start, loss, loss.scale, options)


def _fit(
    problem: BlockProblem[State], start: State, loss: Loss, scale: float, options: Options | None
) -> BlockSolution[State]:
    def linearise(state: State, earlier: NormalEquations | None) -> NormalEquations:
        blocks = problem.blocks(state)
        if loss.is_squared:
            return normal_equations(blocks, blocks.sum_of_squares, earlier)
        d2 = blocks.squared_distances()
        weighted = blocks.weighted(loss.weights(d2, scale))
        cost = blocks.sum_of_squares - float(d2.sum()) + float(loss.values(d2, scale).sum())
        return normal_equations(weighted, cost, earlier)

    found = levenberg_marquardt(linearise, problem.retract, start, options)
    blocks = found.model.blocks if loss.is_squared else problem.blocks(found.state)
    d2 = blocks.squared_distances()
    weights = loss.weights(d2, scale)
    excess = 1.0 if loss.is_squared else loss.excess(scale / _scale_of(blocks))
    variance = _variance(blocks, loss, scale) * excess
    return BlockSolution(found.state, blocks, weights, found.model.cost, scale, excess, variance, found.iterations)


def _scale_of(blocks: Blocks) -> float:
    """Return the noise of one coordinate from the median distance, corrected for the number of fitted parameters."""
    distance = np.sqrt(blocks.squared_distances()[blocks.measured_pairs()])
    share = max(blocks.dof, 1) / blocks.rows
    return max(noise_of_the_good(distance) / float(np.sqrt(share)), 1e-12)


def _variance(blocks: Blocks, loss: Loss, scale: float) -> float:
    """Return what turns cofactors of the weights into covariances: the sum of squares over dof, without a loss.

    Of an M-estimator it is E[psi^2] E[w] / E[psi']^2 (Huber 1981, section 7.6).
    """
    if blocks.dof <= 0:
        return np.nan
    if loss.is_squared:
        return blocks.sum_of_squares / blocks.dof
    d2, real = blocks.squared_distances(), blocks.measured_pairs()
    w, stiff = loss.weights(d2, scale)[real], loss.stiffness(d2, scale)[real]
    others = blocks.sum_of_squares - float(d2.sum())
    psi2 = (float(np.sum(w * w * d2[real])) + others) / blocks.dof
    return float(psi2 * w.mean() / stiff.mean() ** 2)
