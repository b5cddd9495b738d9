"""Many starts at once: the basins of a cost, found by minimising from all starts together as one batch of arrays."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.fit.camera_model import CameraModel

_SETTLED = 1e-10  # steps with a smaller predicted relative decrease do not separate basins


def descend(model: CameraModel, states: Array, iterations: int) -> tuple[Array, Array]:
    """Return the states (B, k) after at most `iterations` of Levenberg-Marquardt each, and their sums of squares (B,).

    Normal equations with scaled columns: good to about 1e-8, enough to separate basins; the best is then refined by
    `least_squares.minimise`. States that image nothing are unchanged, with cost inf.
    """
    states = states.copy()
    r, J = model.residuals_and_jacobian(states)
    cost = _cost(r)
    damping, growth = np.full(len(states), 1e-3), np.full(len(states), 2.0)
    moving = np.flatnonzero(np.isfinite(cost))
    for _ in range(iterations):
        if not moving.size:
            break
        step, promised = _steps(r[moving], J[moving], damping[moving])
        candidates = model.retract(states[moving], step)
        r_new, J_new = model.of_states(moving).residuals_and_jacobian(candidates)
        cost_new = _cost(r_new)
        gain = np.clip((cost[moving] - cost_new) / promised, 0, 1)
        better = cost_new < cost[moving]
        up = moving[better]
        states[up], r[up], J[up], cost[up] = candidates[better], r_new[better], J_new[better], cost_new[better]
        damping[up] = np.maximum(damping[up] * np.maximum(1 / 3, 1 - (2 * gain[better] - 1) ** 3), 1e-12)
        growth[up] = 2.0
        down = moving[~better]
        damping[down], growth[down] = damping[down] * growth[down], 2 * growth[down]
        moving = moving[(promised > _SETTLED * cost[moving]) & (damping[moving] < 1e9)]
    return states, cost


def _cost(r: Array) -> Array:
    total = np.sum(r * r, axis=-1)
    return np.where(np.isfinite(total), total, np.inf)


def _steps(r: Array, J: Array, damping: Array) -> tuple[Array, Array]:
    r, J = np.nan_to_num(r), np.nan_to_num(J)
    A = np.swapaxes(J, -1, -2) @ J
    g = (np.swapaxes(J, -1, -2) @ r[..., None])[..., 0]
    d = np.sqrt(np.diagonal(A, axis1=-2, axis2=-1))
    d = np.where(d > 0, d, 1.0)
    S = A / (d[:, :, None] * d[:, None, :]) + (damping[:, None, None] + 1e-14) * np.eye(A.shape[-1])
    h = np.linalg.solve(S, (g / d)[..., None])[..., 0]
    promised = np.sum(h * (g / d + damping[:, None] * h), axis=-1)
    return -h / d, np.maximum(promised, 1e-300)
