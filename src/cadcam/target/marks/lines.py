"""Errors shared by the pixels of a line: where a camera shifts whole lines, its pixels are not independent.

Analogue cameras and grabbers start each line a little early or late (section 5.3 of the dissertation). That moves both
borders of a mark on a line alike, and a variance from independent residuals is too small.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.target.boards.photometric import Fit, Model
from cadcam.target.marks.window import Window

_SIGMAS = 3.0  # beyond which chance is ruled out


def shared_by_lines(model: Model, fit: Fit, window: Window, weight: Array) -> Array:
    """Return the variance (B,) of x relative to that of the fit; 1 where chance explains the difference.

    A pixel changes x by z = (H^-1 J)_x r. For independent pixels the variance is sum z^2; for lines that move as a
    whole it is the sum over lines of (sum z)^2 (K.-Y. Liang, S. Zeger, Biometrika 73, 1986). Two lines at equal
    distance above and below the centre count as one: a misfit that is alike on all sides shifts nothing, and cancels in
    the pair.
    """
    with np.errstate(all="ignore"):
        value, J = model(fit.parameters, window.pixels, weight)
    r, J = np.nan_to_num(value - window.values) * weight, np.nan_to_num(J) * weight[..., None]
    H = np.swapaxes(J, 1, 2) @ J
    scale = 1 / np.sqrt(np.maximum(np.einsum("bii->bi", H), 1e-12))
    cofactor = np.linalg.pinv(H * scale[:, :, None] * scale[:, None, :], rcond=1e-12, hermitian=True)
    z = (J @ (cofactor[:, 0] * scale * scale[:, :1])[..., None])[..., 0] * r
    line = np.floor(np.abs(window.pixels[..., 1] - fit.parameters[:, 1:2])).astype(np.int32)
    together, alone = _summed(z, line), _summed(z * z, line)
    variance, apart = (together**2).sum(axis=1), alone.sum(axis=1)
    beyond = variance > apart + _SIGMAS * np.sqrt(2 * (alone**2).sum(axis=1))
    predicted = np.maximum(fit.covariance[:, 0, 0], 1e-300)
    return np.asarray(np.where(beyond, np.maximum(variance / predicted, 1.0), 1.0), np.float64)


def _summed(values: Array, line: Ids) -> Array:
    """Return the sums (B, L) of values (B, P) over the lines that they belong to."""
    lines = int(line.max(initial=0)) + 1
    at = line + lines * np.arange(len(line))[:, None]
    sums = np.bincount(at.ravel(), values.ravel(), len(line) * lines)
    return np.asarray(sums.reshape(len(line), lines), np.float64)
