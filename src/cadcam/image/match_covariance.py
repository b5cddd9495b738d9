"""How well a peak of the correlation is known: from what the template does not explain, and the slopes on both sides.

A peak is where the template's slopes J by its motions are orthogonal to the residual r: J r = 0. So an error of the
motions is H^-1 J r, with H = J Jp^T, Jp the picture's slopes there, and the covariance s^2 H^-1 J J^T H^-T, s^2 the
variance of r. Noise in the template's slopes adds to J J^T, which therefore says that more is known than is; noise of
template and picture have nothing to do with each other, so that H holds what both show.
"""

from __future__ import annotations

import math

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.native.correlate import Points

_MOST, _APART = 4096, 7919  # points by which the slopes are compared: of more, every so manieth, round and round
_LEAST = 1e-3  # of what the template's slopes say: below, the picture does not show a motion at all


def peak_covariance(picture: Picture, points: Points, pose: Array, score: float) -> Array:
    """Return the covariance (4, 4) of x, y (px), angle (rad) and scale (0 where it was not free) of a peak."""
    motions = len(points.slope)
    noise = (1 - score**2) / max(score**2, 1e-12) / max(points.count - 2 - motions, 1)
    J = points.slope.astype(np.float64)
    own, H = J @ J.T, _in_common(picture, points, pose)
    # in units in which the template's slopes are orthonormal
    root = np.linalg.cholesky(own)
    U, shown, Vt = np.linalg.svd(np.linalg.solve(root, np.linalg.solve(root, H).T).T)
    error = (Vt.T / np.maximum(shown, _LEAST)) @ U.T
    c, s = pose[3] * math.cos(pose[2]), pose[3] * math.sin(pose[2])
    G = np.eye(4)[:, :motions]
    G[:2, :2] = [[c, -s], [s, c]]
    if motions == 4:
        G[3, 3] = pose[3]
    L = G @ np.linalg.solve(root.T, error)
    return np.asarray(noise * L @ L.T)


def _in_common(picture: Picture, points: Points, pose: Array) -> Array:
    """Return J Jp^T (m, m), the picture's slopes taken in grey levels of the template."""
    n = points.count
    some = np.arange(n) if n <= _MOST else np.arange(_MOST) * _APART % n
    u, v, value = (a[some].astype(np.float64) for a in (points.u, points.v, points.value))
    slope = points.slope[:, some].astype(np.float64)
    c, s = pose[3] * math.cos(pose[2]), pose[3] * math.sin(pose[2])
    x, y = pose[0] + c * u - s * v, pose[1] + s * u + c * v
    left, top = (max(math.floor(a.min()) - 2, 0) for a in (x, y))
    crop = picture[top : math.ceil(y.max()) + 3, left : math.ceil(x.max()) + 3].astype(np.float64)
    if min(crop.shape) < 2:
        return np.zeros((len(slope), len(slope)))
    seen, down, right = _between((crop, *np.gradient(crop)), x - left, y - top)
    gu, gv = c * right + s * down, c * down - s * right
    gain = float(value @ (seen - seen.mean())) / max(float(value @ value), 1e-12)
    shown = np.stack([gu, gv, gv * u - gu * v, gu * u + gv * v][: len(slope)])
    return np.asarray(n / len(u) * slope @ shown.T / (gain if abs(gain) > 1e-12 else 1e-12))


def _between(planes: tuple[Array, ...], x: Array, y: Array) -> list[Array]:
    """Return each plane (H, W) at points, bilinearly; beyond the outline as on it."""
    height, width = planes[0].shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    i, j = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
    a, b, at = x - i, y - j, j * width + i
    corners = ((at, (1 - a) * (1 - b)), (at + 1, a * (1 - b)), (at + width, (1 - a) * b), (at + width + 1, a * b))
    return [np.asarray(sum(weight * plane.ravel().take(k) for k, weight in corners)) for plane in planes]
