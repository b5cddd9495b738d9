"""The error of a joint calibration on views that were left out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.calibrate.joint.adjustment import JointFit
from cadcam.errors import CadcamError, TooFewPoints
from cadcam.fit.block_least_squares import minimise_blocks
from cadcam.fit.joint_model import JointModel, JointState

_FOLDS = 10
_HALF = 4  # points for a pose


def held_out_error(fit: JointFit) -> float:
    """Return the rms (px, of one coordinate) at points of views that were left out of the estimate of the internals.

    The views are left out in ten groups in turn. In a left-out view every other point gives the pose, and the error
    is evaluated at the others; then vice versa. Unlike the residual it decreases only as long as a richer model
    describes the camera and not the views. nan where the remaining views do not determine the internals. Raises
    `TooFewPoints` for fewer than two views, or without any view of eight points.
    """
    k = len(fit.views)
    if k < 2:
        raise TooFewPoints("a held-out error", k, 2, of="views")
    squares, count = 0.0, 0
    for held in np.array_split(np.arange(k), min(_FOLDS, k)):
        try:
            rest = np.setdiff1d(np.arange(k), held)
            trained = minimise_blocks(fit.model.with_views(rest), _views(fit.solution.state, rest)).state
        except CadcamError:
            return float("nan")
        for side in (0, 1):
            error = _errors(fit.model.with_views(held), _shared(trained, fit.solution.state, held), side)
            squares, count = squares + float(np.sum(error**2)), count + error.size
    if not count:
        most = int(fit.model.measured.sum(axis=1).max())
        raise TooFewPoints("a held-out error", most, 2 * _HALF, of="points in a view")
    return float(np.sqrt(squares / count))


def _views(state: JointState, index: Longs) -> JointState:
    return replace(state, R=state.R[index], t=state.t[index])


def _shared(trained: JointState, poses: JointState, index: Longs) -> JointState:
    return replace(trained, R=poses.R[index], t=poses.t[index])


def _errors(model: JointModel, state: JointState, side: int) -> Array:
    """Errors (..., 2) at the points of one side, the poses fitted to the other; views with too few points left out."""
    odd = _alternate(model.measured) == side
    enough = (model.measured & ~odd).sum(axis=1) >= _HALF
    if not enough.any():
        return np.zeros((0, 2))
    index = np.flatnonzero(enough)
    few, at = model.with_views(index), odd[index] & model.measured[index]
    half = replace(few, free=(), measured=few.measured & ~at, control=None, priors=())
    flat = replace(_views(state, index), shift=np.zeros((0, 3)))
    posed = minimise_blocks(half, flat).state
    return np.asarray(replace(half, measured=at).residuals(posed)[at])


def _alternate(measured: Mask) -> Longs:
    """0, 1, 0, 1 ... along the measured points of each view."""
    return np.asarray((np.cumsum(measured, axis=1) - 1) % 2)
