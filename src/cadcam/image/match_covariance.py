"""How well a peak of the correlation is known: from what the template does not explain, and the slopes on both sides.

A peak is where the template's slopes J by its motions are orthogonal to the residual r: J r = 0. So an error of the
motions is H^-1 J r, with H = J Jp^T, Jp the picture's slopes there, and the covariance s^2 H^-1 J J^T H^-T, s^2 the
variance of r. Noise in the template's slopes adds to J J^T, which therefore says that more is known than is; noise of
template and picture have nothing to do with each other, so that H holds what both show.
"""

from __future__ import annotations

import math

import numpy as np

from cadcam.arrays import Array, Longs, Picture
from cadcam.native.correlate import Points

# Points by which the slopes are compared: what they say of both sides is a ratio of sums, known to a few hundredths by
# a thousand. Of more points, those a golden section of them apart, round and round: in no step with their rows.
_MOST, _APART = 1024, (np.sqrt(5.0) - 1) / 2
_LEAST = 1e-3  # of what the template's slopes say: below, the picture does not show a motion at all


def peak_covariances(picture: Picture, points: Points, poses: Array, score: Array) -> Array:
    """Return the covariances (N, 4, 4) of x, y (px), angle (rad) and scale (0 where it was not free) of peaks."""
    motions = len(points.slope)
    noise = (1 - score**2) / np.maximum(score**2, 1e-12) / max(points.count - 2 - motions, 1)
    J = points.slope.astype(np.float64)
    some = _spread(points.count)
    u, v, value = (a[some].astype(np.float64) for a in (points.u, points.v, points.value))
    compared = [_in_common(picture, u, v, value, J[:, some], pose) for pose in poses]
    H = points.count / len(some) * np.array(compared).reshape(-1, motions, motions)
    # in units in which the template's slopes are orthonormal
    units = np.linalg.inv(np.linalg.cholesky(J @ J.T))
    U, shown, Vt = np.linalg.svd(units @ H @ units.T)
    error = units.T @ (Vt.mT / np.maximum(shown, _LEAST)[:, None]) @ U.mT
    L = _per_motion(poses, motions) @ error
    return np.asarray(noise[:, None, None] * L @ L.mT)


def _spread(count: int) -> Longs:
    """Return the numbers of at most `_MOST` of so many points, spread over all of them."""
    if count <= _MOST:
        return np.arange(count)
    return np.asarray(np.arange(_MOST) * _APART % 1.0 * count, np.int64)


def _per_motion(poses: Array, motions: int) -> Array:
    """Return the derivatives (N, 4, m) of x, y, angle and scale by shifts along the template's axes, turn and size."""
    c, s = poses[:, 3] * np.cos(poses[:, 2]), poses[:, 3] * np.sin(poses[:, 2])
    G = np.zeros((len(poses), 4, motions))
    G[:, 0, 0], G[:, 0, 1], G[:, 1, 0], G[:, 1, 1], G[:, 2, 2] = c, -s, s, c, 1
    if motions == 4:
        G[:, 3, 3] = poses[:, 3]
    return G


def _in_common(picture: Picture, u: Array, v: Array, value: Array, slope: Array, pose: Array) -> Array:
    """Return J Jp^T (m, m) of the points, the picture's slopes taken in grey levels of the template."""
    c, s = pose[3] * math.cos(pose[2]), pose[3] * math.sin(pose[2])
    x, y = pose[0] + c * u - s * v, pose[1] + s * u + c * v
    left, top = (max(math.floor(a.min()) - 2, 0) for a in (x, y))
    crop = picture[top : math.ceil(y.max()) + 3, left : math.ceil(x.max()) + 3]
    if min(crop.shape) < 2:
        return np.zeros((len(slope), len(slope)))
    seen, right, down = _between((crop, *_slopes(crop)), x - left, y - top)
    gu, gv = c * right + s * down, c * down - s * right
    gain = float(value @ (seen - seen.mean())) / max(float(value @ value), 1e-12)
    shown = np.stack([gu, gv, gv * u - gu * v, gu * u + gv * v][: len(slope)])
    return np.asarray(slope @ shown.T / (gain if abs(gain) > 1e-12 else 1e-12))


def _slopes(crop: Picture) -> tuple[Picture, Picture]:
    """Return the central differences (H, W) by x and y; none at the outline."""
    right, down = np.zeros_like(crop), np.zeros_like(crop)
    right[:, 1:-1] = 0.5 * (crop[:, 2:] - crop[:, :-2])
    down[1:-1] = 0.5 * (crop[2:] - crop[:-2])
    return right, down


def _between(planes: tuple[Picture, ...], x: Array, y: Array) -> list[Array]:
    """Return each plane (H, W) at points, bilinearly; beyond the outline as on it."""
    height, width = planes[0].shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    i, j = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
    a, b, at = x - i, y - j, j * width + i
    corners = ((at, (1 - a) * (1 - b)), (at + 1, a * (1 - b)), (at + width, (1 - a) * b), (at + width + 1, a * b))
    return [np.asarray(sum(weight * plane.ravel().take(k) for k, weight in corners)) for plane in planes]
