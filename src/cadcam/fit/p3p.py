"""The perspective three-point problem: the poses at which three known points lie on three known rays."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs

_VANISHING = 1e-4  # difference of cosines: noise of a pixel is of this size where a triangle is wide


def p3p(p_world: Array, rays: Array) -> tuple[Array, Array]:
    """Return focal centres (S, 3) mm and rotations (S, 3, 3) camera_from_world of a batch of triples, up to 4 each.

    p_world (B, 3, 3): three points per row; rays (B, 3, 3): unit directions in the camera frame. Solves for the
    distances s_i along the rays, s_i^2 + s_j^2 - 2 s_i s_j cos_ij = |p_i - p_j|^2, by Grunert's quartic in s_3/s_1
    (1841; reviewed by Haralick et al., IJCV 1994). Complex roots count with their real part: with noisy rays a pair of
    poses may just miss being real, and the results are refined anyway. Where a triple looks symmetrical, two poses may
    share a root, and some are given twice. Triples without area or behind the camera give nothing.
    """
    v, owner = _ratio_roots(p_world, rays)
    s, owner = _distances(v, owner, p_world, rays)
    in_camera = s[..., None] * rays[owner]
    A, B = _frame(in_camera), _frame(p_world[owner])
    R = A @ np.swapaxes(B, -1, -2)
    F = p_world[owner].mean(axis=1) - (np.swapaxes(R, -1, -2) @ in_camera.mean(axis=1)[..., None])[..., 0]
    good = np.isfinite(R).all(axis=(1, 2)) & np.isfinite(F).all(axis=1)
    return F[good], R[good]


def _cosines(rays: Array) -> tuple[Array, Array, Array]:
    j1, j2, j3 = rays[:, 0], rays[:, 1], rays[:, 2]
    return np.sum(j2 * j3, axis=-1), np.sum(j1 * j3, axis=-1), np.sum(j1 * j2, axis=-1)


def _squared_sides(p: Array) -> tuple[Array, Array, Array]:
    return (
        np.sum((p[:, 1] - p[:, 2]) ** 2, axis=-1),
        np.sum((p[:, 0] - p[:, 2]) ** 2, axis=-1),
        np.sum((p[:, 0] - p[:, 1]) ** 2, axis=-1),
    )


def _ratio_roots(p: Array, rays: Array) -> tuple[Array, Longs]:
    """Roots v = s3/s1 of Grunert's quartic and the triple each belongs to."""
    a2, b2, c2 = _squared_sides(p)
    ca, cb, cg = _cosines(rays)
    with np.errstate(all="ignore"):
        k, a, c = (a2 - c2) / b2, a2 / b2, c2 / b2
        coefficients = np.stack(
            [
                (k - 1) ** 2 - 4 * c * ca**2,
                4 * (k * (1 - k) * cb - (1 - a - c) * ca * cg + 2 * c * ca**2 * cb),
                2
                * (
                    k**2 - 1 + 2 * k**2 * cb**2 + 2 * (1 - c) * ca**2 - 4 * (a + c) * ca * cb * cg + 2 * (1 - a) * cg**2
                ),
                4 * (-k * (1 + k) * cb + 2 * a * cg**2 * cb - (1 - a - c) * ca * cg),
                (1 + k) ** 2 - 4 * a * cg**2,
            ],
            axis=-1,
        )
        monic = coefficients[:, 1:] / coefficients[:, :1]
    usable = np.isfinite(monic).all(axis=1)
    companion = np.zeros((int(usable.sum()), 4, 4))
    companion[:, 0] = -monic[usable]
    companion[:, 1, 0] = companion[:, 2, 1] = companion[:, 3, 2] = 1.0
    roots = np.linalg.eigvals(companion).real
    return np.asarray(roots.ravel()), np.repeat(np.flatnonzero(usable), 4)


def _distances(v: Array, owner: Longs, p: Array, rays: Array) -> tuple[Array, Longs]:
    """Distances (S, 3) along the rays, all positive.

    Subtracted from each other, two of the equations are linear in u = s_2/s_1. Where its factor vanishes, as for an
    isosceles triangle seen straight on, they say nothing of u, and both roots of one of them are taken.
    """
    a2, b2, c2 = (x[owner] for x in _squared_sides(p))
    ca, cb, cg = (x[owner] for x in _cosines(rays))
    k = (a2 - c2) / b2
    with np.errstate(all="ignore"):
        factor = 2 * (cg - v * ca)
        u = ((k - 1) * v**2 - 2 * k * cb * v + 1 + k) / factor
        s1 = np.sqrt(b2 / (1 + v**2 - 2 * v * cb))
        twice = np.flatnonzero(np.abs(factor) < _VANISHING)
        root = np.sqrt(np.maximum(cg**2 - 1 + c2 / s1**2, 0.0))[twice]
        u, every = np.concatenate([u, cg[twice] + root]), np.concatenate([np.arange(len(v)), twice])
        u[twice] = cg[twice] - root
        s1, v, owner = s1[every], v[every], owner[every]
        s = np.stack([s1, u * s1, v * s1], axis=-1)
        good = np.isfinite(s).all(axis=1) & (s > 0).all(axis=1)
    return s[good], owner[good]


def _frame(triangle: Array) -> Array:
    """Orthonormal axes (S, 3, 3), as columns, of triangles (S, 3, 3)."""
    x = triangle[:, 1] - triangle[:, 0]
    z = np.cross(x, triangle[:, 2] - triangle[:, 0])
    with np.errstate(all="ignore"):
        x = x / np.linalg.norm(x, axis=-1, keepdims=True)
        z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)
