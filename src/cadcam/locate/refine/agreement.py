"""Motions that most of the edges of a loose fit agree on closely.

If some lines were mistaken for others, and the pose is a compromise, all of them are off by a pixel; a regression takes
that for the scatter of edges and accepts it. But the lines that were assigned correctly agree on one motion ten times
more closely. It is found by random sampling: motions that fit a few random edges exactly, of which the one is chosen
that fits most of the others too (Fischler and Bolles, Comm. ACM 24, 1981).
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.geometry.rigid import Rigid
from cadcam.locate.refine.solution import PoseSolution

SCATTERED_PX = 0.15  # common offset of edges that is rarely exceeded at a good pose
# Where a share w of a fit's edges agrees, w^6 of the sixes drawn are of those alone. At the least share asked for,
# _MOST of the edges beyond six, a thousand draws hold such a six with a chance of 1 - (1 - w^6)^1000: 0.99 where there
# are 60 edges, 0.92 of 200, 0.84 of very many.
_TRIALS = 1000
_CLOSE_PX, _CLOSE_SDS = 0.12, 2.5  # tolerance for agreement: px, and sds of an edge's noise
_MOST = 0.35  # share of the edges that must agree, beyond those that any motion can fit
_GAIN = 2.0  # least ratio to the number that agree now
_NEARBY = 2.0  # largest distance of the right pose from the compromise, relative to the offsets of edges
BESIDE_BANDS_PX, _GAIN_BESIDE_BANDS = 0.08, 1.25  # the same beside bands: their far side is as clear a line
_FLAT = 1e-4  # determinant, of unit columns, below which edges determine no motion


def agreed(fitted: PoseSolution) -> list[Rigid]:
    """Return the poses that most edges of a loose fit agree on, where far more do than agree on the fitted one.

    At most two: the best supported of all motions, and the best of those that move no edge by much more than edges are
    off. A few edges can be fitted by chance by any motion, but a compromise between two kinds of lines is no farther
    from either.
    """
    fit, B = fitted.fit, fitted.B
    beside_bands = any((cells.doubt > 0).any() for cells in fitted.cells)
    scattered, least_gain = (BESIDE_BANDS_PX, _GAIN_BESIDE_BANDS) if beside_bands else (SCATTERED_PX, _GAIN)
    if fit.between <= scattered:
        return []
    J, count = _edge_jacobian(fitted)
    if len(J) <= J.shape[1]:
        return []
    unit = np.sqrt(np.mean(J**2, axis=0))  # px by a unit step in each direction of B: makes them comparable
    if not (unit > 0).all():
        return []
    offset, close = fit.offset[: len(J)], np.hypot(_CLOSE_PX, _CLOSE_SDS * fit.sd_offset[: len(J)])
    motions = np.concatenate([np.zeros((1, len(unit))), _motions(offset, J / unit)])  # the first: the fitted pose
    moved = motions @ (J / unit).T
    share = np.maximum(1 - (np.abs(offset - moved) / close) ** 2, 0.0) @ count / count.sum()
    fitted_to = len(unit) / len(J)
    enough = max(fitted_to + _MOST * (1 - fitted_to), least_gain * share[0])
    near = np.abs(moved).max(axis=1) <= _NEARBY * fit.between
    best = dict.fromkeys(int(np.argmax(np.where(among, share, -1.0))) for among in (share >= 0, near))
    return [fitted.pose @ Rigid.exp(B @ (motions[k] / unit)) for k in best if share[k] >= enough]


def _edge_jacobian(fitted: PoseSolution) -> tuple[Array, Longs]:
    """Return the mean derivative (edges, k) of each edge's offset by the motion in B, and its number of samples."""
    rows = np.concatenate([at.row[m.usable] for at, m in zip(fitted.places, fitted.measured, strict=True)]) @ fitted.B
    group = fitted.fit.group[: len(rows)]
    count = np.bincount(group)
    return np.stack([np.bincount(group, column) / count for column in rows.T], axis=1), count


def _motions(offset: Array, J: Array) -> Array:
    """Return motions (n, k), each of which fits k of the edges exactly; always the same sample."""
    rng = np.random.default_rng(0)
    few = np.argsort(rng.random((_TRIALS, len(J))), axis=1)[:, : J.shape[1]]
    few = few[np.abs(np.linalg.det(J[few])) > _FLAT]
    return np.asarray(np.linalg.solve(J[few], offset[few][:, :, None])[:, :, 0])
