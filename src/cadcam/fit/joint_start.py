"""Starts for views that share a camera: homographies of flat fields, direct linear transforms of deep ones, batched.

Only starts: noise and distortion are ignored. Sources: Zhang, "A flexible new technique for camera calibration" (2000),
sections 2.3 and 3.1; Hartley and Zisserman, "Multiple View Geometry", algorithms 4.1, 4.2 and 8.2.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.geometry import rotation as so3


def plane_frames(p: Array, measured: Mask) -> tuple[Array, Array, Array]:
    """Return origin (k, 3) and axes (k, 3, 3) in columns of the planes nearest to the views' points, and rms extents.

    The extents (k, 3), in the points' unit, are along the axes: length, width, thickness.
    """
    w = measured / measured.sum(axis=1, keepdims=True)
    origin = np.einsum("kn,kni->ki", w, p)
    centred = p - origin[:, None]
    values, axes = np.linalg.eigh(np.einsum("kn,kni,knj->kij", w, centred, centred))
    axes = axes[..., ::-1]
    axes = axes * np.where(np.linalg.det(axes) < 0, np.array([1.0, 1.0, -1.0])[:, None], 1.0).T[:, None, :]
    return origin, axes, np.sqrt(np.maximum(values[:, ::-1], 0))


def homographies(p: Array, q: Array, measured: Mask) -> Array:
    """Return H (k, 3, 3) with (q, 1) ~ H (p, 1) for points p, q (k, N, 2), by the normalised linear transform."""
    return _linear_maps(p, q, measured)


def camera_matrices(p: Array, q: Array, measured: Mask) -> Array:
    """Return P (k, 3, 4) with (q, 1) ~ P (p, 1) for points p (k, N, 3) and q (k, N, 2), N >= 6 not on a plane."""
    return _linear_maps(p, q, measured)


def _linear_maps(p: Array, q: Array, measured: Mask) -> Array:
    """Return M (k, 3, n + 1) with (q, 1) ~ M (p, 1) for points p (k, N, n) and q (k, N, 2)."""
    S, T = _normaliser(p, measured), _normaliser(q, measured)
    maps = _null_vectors(_apply(S, p), _apply(T, q)[..., :2], measured)
    return np.asarray(np.linalg.inv(T) @ maps.reshape(-1, 3, p.shape[2] + 1) @ S)


def poses_of_homographies(H: Array, K: Array) -> tuple[Array, Array]:
    """Return R (k, 3, 3) and t (k, 3), camera_from_plane, of homographies seen through K; the plane is in front.

    NaN for t, and no rotation, where a homography is of no camera: all points at one pixel.
    """
    B = np.asarray(np.linalg.solve(K, H), np.float64)
    B = _over(B, np.sqrt(np.linalg.norm(B[..., 0], axis=-1) * np.linalg.norm(B[..., 1], axis=-1)))
    B = B * np.where(B[:, 2, 2] < 0, -1.0, 1.0)[:, None, None]
    r3 = np.cross(B[..., 0], B[..., 1])
    return _nearest(np.stack([B[..., 0], B[..., 1], r3], axis=-1)), B[..., 2]


def poses_of_matrices(P: Array, K: Array) -> tuple[Array, Array]:
    """Return R (k, 3, 3), t (k, 3), camera_from_world, of camera matrices seen through K; singular ones as above."""
    B = np.asarray(np.linalg.solve(K, P), np.float64)
    B = _over(B, np.asarray(np.cbrt(np.linalg.det(B[..., :3]))))
    return _nearest(B[..., :3]), B[..., 3]


def _over(B: Array, size: Array) -> Array:
    """Return matrices (k, m, n) divided by their size (k,), NaN where that is 0."""
    return np.asarray(B / np.where(size == 0, np.nan, size)[:, None, None])


def _nearest(M: Array) -> Array:
    """Return the rotations nearest to M (k, 3, 3), none for a matrix that is not finite."""
    finite: Mask = np.asarray(np.isfinite(M).all(axis=(1, 2)))
    return so3.nearest(np.where(finite[:, None, None], M, np.eye(3)))


def internals_of_homographies(H: Array, size: tuple[int, int], *, skew: bool) -> Array | None:
    """Return K (3, 3) from three homographies or more (two without skew); None where noise leaves no camera."""
    T = _picture(size)
    H = T @ H
    H = H / np.linalg.norm(H, axis=(-2, -1), keepdims=True)
    V = np.concatenate([_v(H, 0, 1), _v(H, 0, 0) - _v(H, 1, 1)])
    if not skew:
        V[:, 1] = 0
        V = np.concatenate([V, [[0, 1, 0, 0, 0, 0]]])
    b = np.linalg.svd(np.concatenate([V, np.zeros((6, 6))]), full_matrices=False)[2][-1]
    B = np.array([[b[0], b[1], b[3]], [b[1], b[2], b[4]], [b[3], b[4], b[5]]])
    try:
        L = np.linalg.cholesky(B if B[0, 0] > 0 else -B)
    except np.linalg.LinAlgError:
        return None
    K = np.linalg.inv(L.T)
    return np.asarray(np.linalg.inv(T) @ (K / K[2, 2]))


def focal_of_homographies(H: Array, size: tuple[int, int], aspect: float, centre: Array) -> float | None:
    """Return the focal length of a camera with a known aspect and principal point (cx, cy), px, or None."""
    unit = max(size)
    A = np.array([[1 / aspect, 0, -centre[0] / aspect], [0, 1, -centre[1]], [0, 0, unit]]) / unit
    G = A @ H
    G = G / np.linalg.norm(G, axis=(-2, -1), keepdims=True)
    h1, h2 = G[..., 0], G[..., 1]
    # (h1 . h2)_xy / f^2 + h1_z h2_z = 0 and (|h1|^2 - |h2|^2)_xy / f^2 + h1_z^2 - h2_z^2 = 0
    a = np.concatenate([np.sum(h1[:, :2] * h2[:, :2], axis=1), np.sum(h1[:, :2] ** 2 - h2[:, :2] ** 2, axis=1)])
    b = np.concatenate([h1[:, 2] * h2[:, 2], h1[:, 2] ** 2 - h2[:, 2] ** 2])
    over_f2 = -(a @ b) / (a @ a) if a @ a > 0 else -1.0
    return float(unit / np.sqrt(over_f2)) if over_f2 > 0 else None


def _v(H: Array, i: int, j: int) -> Array:
    a, b = H[..., i], H[..., j]
    return np.stack(
        [
            a[:, 0] * b[:, 0],
            a[:, 0] * b[:, 1] + a[:, 1] * b[:, 0],
            a[:, 1] * b[:, 1],
            a[:, 2] * b[:, 0] + a[:, 0] * b[:, 2],
            a[:, 2] * b[:, 1] + a[:, 1] * b[:, 2],
            a[:, 2] * b[:, 2],
        ],
        axis=-1,
    )


def _picture(size: tuple[int, int]) -> Array:
    s = 2.0 / max(size)
    return np.array([[s, 0, -s * (size[0] - 1) / 2], [0, s, -s * (size[1] - 1) / 2], [0, 0, 1.0]])


def _normaliser(x: Array, measured: Mask) -> Array:
    """Homogeneous matrices (k, d+1, d+1) that centre x (k, N, d) and make its rms length sqrt(d)."""
    d = x.shape[-1]
    w = measured / measured.sum(axis=1, keepdims=True)
    centre = np.einsum("kn,kni->ki", w, x)
    spread = np.sqrt(np.einsum("kn,kn->k", w, np.sum((x - centre[:, None]) ** 2, axis=-1)) / d)
    out = np.zeros((len(x), d + 1, d + 1))
    out[:, range(d), range(d)] = (1 / np.maximum(spread, 1e-300))[:, None]
    out[:, :d, d] = -centre / np.maximum(spread, 1e-300)[:, None]
    out[:, d, d] = 1.0
    return out


def _apply(S: Array, x: Array) -> Array:
    """Homogeneous normalised coordinates (k, N, d+1)."""
    d = x.shape[-1]
    out = np.ones((*x.shape[:-1], d + 1))
    out[..., :d] = x @ np.swapaxes(S[:, :d, :d], -1, -2) + S[:, None, :d, d]
    return out


def _null_vectors(one: Array, u: Array, measured: Mask) -> Array:
    """Vectors h (k, 3 d) of least |A h| over |h| = 1, A the rows (p, 0, -x p), (0, p, -y p), p = one (k, N, d).

    A^T A is made of four moments of p, weighted by 1, x, y and x^2 + y^2.
    """
    k, _, d = one.shape
    x, y = u[..., 0], u[..., 1]
    across = np.swapaxes(one, -1, -2)
    weights = (np.ones_like(x), x, y, x * x + y * y)
    S, Sx, Sy, Sq = ((across * (w * measured)[:, None, :]) @ one for w in weights)
    N = np.zeros((k, 3, d, 3, d))
    N[:, 0, :, 0] = N[:, 1, :, 1] = S
    N[:, 0, :, 2] = N[:, 2, :, 0] = -Sx
    N[:, 1, :, 2] = N[:, 2, :, 1] = -Sy
    N[:, 2, :, 2] = Sq
    return np.asarray(np.linalg.eigh(N.reshape(k, 3 * d, 3 * d))[1][..., 0])
