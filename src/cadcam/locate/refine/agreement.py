"""Motions that most of the edges of a loose fit agree on closely.

Where some of the lines were taken for others, and the pose lies between what the two kinds ask for, all of them are off
by a pixel; a regression takes that for how edges scatter, and is content. But the lines that were taken for themselves
agree on one motion to a tenth of that. It is looked for by trial: motions that put few edges, drawn by chance, right,
and that of them which puts most of the others right too (Fischler and Bolles, Comm. ACM 24, 1981).
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry.rigid import Rigid
from cadcam.locate.refine.solution import PoseSolution

SCATTERED_PX = 0.15  # by which edges of a good pose are seldom off as a whole
_TRIALS = 1000
_CLOSE_PX, _CLOSE = 0.12, 2.5  # px, and standard deviations of its noise, that an edge may be off and still agree
_MOST = 0.35  # of the edges have to agree, beyond as many as any motion can be fitted to
_GAIN = 2.0  # times as many as do now
_NEARBY = 2.0  # times what edges are off by: how far the pose in between is from the right one
BESIDE_BANDS_PX, _BESIDE_BANDS = 0.08, 1.25  # px and times instead: the far side of a band is as clear a line
_FLAT = 1e-4  # determinant, of unit columns, of edges that tell no motion


def agreed(fitted: PoseSolution) -> list[Rigid]:
    """Return the poses that most edges of a fit agree on, where these are much more than agree on the fitted one.

    The one of all motions, and the one of those that move no edge by much more than edges are off: few edges that are
    put right by chance are so by any motion, a pose between two kinds of lines is no farther from either.
    """
    fit, B = fitted.fit, fitted.B
    beside_bands = any((m.doubt > 0).any() for m in fitted.measured)
    scattered, times = (BESIDE_BANDS_PX, _BESIDE_BANDS) if beside_bands else (SCATTERED_PX, _GAIN)
    if fit.between <= scattered:
        return []
    rows = np.concatenate([at.row[m.usable] for at, m in zip(fitted.places, fitted.measured, strict=True)]) @ B
    group = fit.group[: len(rows)]
    count = np.bincount(group)
    J = np.stack([np.bincount(group, column) / count for column in rows.T], axis=1)
    unit = np.sqrt(np.mean(J**2, axis=0))
    if len(J) <= len(unit) or not (unit > 0).all():
        return []
    offset, close = fit.offset[: len(J)], np.hypot(_CLOSE_PX, _CLOSE * fit.sd_offset[: len(J)])
    motions = np.concatenate([np.zeros((1, len(unit))), _motions(offset, J / unit)])
    moved = motions @ (J / unit).T
    share = np.maximum(1 - (np.abs(offset - moved) / close) ** 2, 0.0) @ count / count.sum()
    fitted_to = len(unit) / len(J)
    enough = max(fitted_to + _MOST * (1 - fitted_to), times * share[0])
    near = np.abs(moved).max(axis=1) <= _NEARBY * fit.between
    best = dict.fromkeys(int(np.argmax(np.where(among, share, -1.0))) for among in (share >= 0, near))
    return [fitted.pose @ Rigid.exp(B @ (motions[k] / unit)) for k in best if share[k] >= enough]


def _motions(offset: Array, J: Array) -> Array:
    """Return motions (n, k), each of which puts k of the edges right; the same ones each time."""
    rng = np.random.default_rng(0)
    few = np.argsort(rng.random((_TRIALS, len(J))), axis=1)[:, : J.shape[1]]
    few = few[np.abs(np.linalg.det(J[few])) > _FLAT]
    return np.asarray(np.linalg.solve(J[few], offset[few][:, :, None])[:, :, 0])
