"""In which poses a part looks the same: the rotations that map its edges onto themselves."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid

_SAMPLES = 400
_MOST = 64  # points that are tried in place of another
_SAME = 2e-3  # of the part's radius: a rotation that leaves the edges this near to each other is a symmetry
_APART = 0.01  # rad: rotations nearer to each other are one, known to within _SAME


def symmetries(mesh: Mesh, edges: FeatureEdges) -> list[Rigid]:
    """Return the motions `part_from_part` that bring the part's edges onto themselves, the identity first.

    Found by trying: two points of the edges far from their middle may only go to points as far from it and as far from
    each other. A round part comes back with as many turns as its circles have sides.
    """
    from scipy.spatial import cKDTree

    points = _along(mesh, edges)
    if len(points) < 3:
        return [Rigid()]
    centre = points.mean(axis=0)
    rays = points - centre
    corners = mesh.vertices[np.unique(edges.vertices)] - centre
    tolerance = _SAME * float(np.linalg.norm(rays, axis=1).max())
    tree = cKDTree(rays)
    spacing = float(np.max(np.asarray(tree.query(rays, k=2)[0])[:, 1])) + tolerance
    lines = cKDTree(_dense(mesh, edges, tolerance) - centre)
    found = [np.eye(3)]
    for R in _candidates(corners, tolerance):
        if any(np.abs(R - known).max() < _APART for known in found):
            continue
        moved = rays @ R.T
        if np.max(tree.query(moved)[0]) < spacing and np.max(lines.query(moved)[0]) < 2 * tolerance:
            found.append(R)
    return [Rigid(R, centre - R @ centre) for R in found]


def _candidates(corners: Array, tolerance: float) -> list[Array]:
    """Return the rotations that take a frame of two corners to a congruent one."""
    length = np.linalg.norm(corners, axis=1)
    a = int(np.argmax(length))
    across = np.linalg.norm(np.cross(corners, corners[a]), axis=1)
    b = int(np.argmax(across * (length > 0.3 * length[a])))
    if not across[b] > 1e-3 * length[a] ** 2:
        return []
    like_a, like_b = (np.flatnonzero(np.abs(length - length[k]) < 2 * tolerance)[:_MOST] for k in (a, b))
    apart = np.linalg.norm(corners[like_a][:, None] - corners[like_b][None], axis=2)
    pairs = np.argwhere(np.abs(apart - np.linalg.norm(corners[a] - corners[b])) < 2 * tolerance)
    home = _frame(corners[a], corners[b])
    return [_frame(corners[like_a[i]], corners[like_b[j]]) @ home.T for i, j in pairs]


def _frame(a: Array, b: Array) -> Array:
    x = a / np.linalg.norm(a)
    z = np.cross(a, b)
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _along(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return about _SAMPLES points (N, 3) on the edges and all their ends."""
    a, b = (mesh.vertices[edges.vertices[:, k]] for k in range(2))
    length = np.linalg.norm(b - a, axis=1)
    return _points(a, b, np.maximum(np.ceil(length / max(length.sum(), 1e-300) * _SAMPLES), 1).astype(int))


def _dense(mesh: Mesh, edges: FeatureEdges, step: float) -> Array:
    a, b = (mesh.vertices[edges.vertices[:, k]] for k in range(2))
    length = np.linalg.norm(b - a, axis=1)
    step = max(step, float(length.sum()) / 200_000)
    return _points(a, b, np.maximum(np.ceil(length / step), 1).astype(int))


def _points(a: Array, b: Array, n: np.ndarray) -> Array:
    """Return the ends and the middles of n equal pieces of each segment."""
    k = np.repeat(np.arange(len(n)), n)
    t = (np.arange(len(k)) - np.repeat(np.cumsum(n) - n, n) + 0.5) / n[k]
    return np.concatenate([a[k] + t[:, None] * (b[k] - a[k]), a, b])
