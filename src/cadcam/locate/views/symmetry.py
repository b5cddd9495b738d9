"""The poses in which a part looks the same: its symmetries, and the rotations that no photo shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh, used_vertices
from cadcam.geometry.rigid import Rigid
from cadcam.locate.views.aspects import sphere_net

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SAMPLES = 400
_MARKED = 20_000  # points along all edges by which the chain nearest to a place is told
_FEW = 24  # portions in which points are tested
_MOST = 64  # points tried as the image of one
_SAME = 2e-3  # radii: a rotation that maps the edges onto themselves to this tolerance is a symmetry ...
_OF_THICKNESS = 0.2  # ... and to this share of half of its thickness: a long bar turned a little is not the same
_ROUNDED, _SIDES = 0.03, 400  # radii: by how much facets of round surfaces may stand out otherwise; directions tried
_FLAT = 1e-6  # radii: what is thinner lies in a plane
_ROUND = np.radians(30.0)  # largest angle between the corners of a faceted circle: beyond it they are edges
_APART = 0.01  # rad: corners of a faceted circle are at least so exactly in their places
_ONE = 4.0  # tolerances: symmetries that move corners by less are one, as each leads to within two of the edges


def symmetries(mesh: Mesh, edges: FeatureEdges) -> list[Rigid]:
    """Return the motions `part_from_part` that bring the part's edges onto themselves, the identity first.

    Nothing may stand out of the part then: a cone turned over has its rim where it was, but not its tip. Found by
    trial: two edge points far from the centroid may only map to points at the same distances from it and from each
    other. A part of revolution yields as many rotations as its faceted circles have sides.
    """
    from scipy.spatial import cKDTree

    points = _along(mesh, edges)
    if len(points) < 3:
        return [Rigid()]
    centre = points.mean(axis=0)
    rays = points - centre
    corners = mesh.vertices[np.unique(edges.vertices)] - centre
    extent = _extent(corners)
    thickness, radius = np.linalg.norm(extent[:, -1]), np.linalg.norm(corners, axis=1).max()
    tolerance = float(min(_SAME * radius, _OF_THICKNESS * thickness if thickness > _FLAT * radius else np.inf))
    tree = cKDTree(rays)
    spacing = float(np.max(np.asarray(tree.query(rays, k=2)[0])[:, 1])) + tolerance
    dense, step = _dense(mesh, edges, tolerance)
    lines = cKDTree(dense - centre)
    some = [rays[k::_FEW] for k in range(_FEW)]  # each spread over the part: most candidates fail on the first
    solid, net = mesh.vertices[used_vertices(mesh)] - centre, sphere_net(_SIDES)
    along = solid @ net.T
    most = along.max(axis=0)
    outermost, within = solid[np.unique(along.argmax(axis=0))], most + _ROUNDED * most.max()
    found = [np.eye(3)]
    for R in _candidates(corners, tolerance):
        if any(np.linalg.norm((R - known) @ extent) < _ONE * tolerance for known in found):
            continue
        if (outermost @ R.T @ net.T > within).any():
            continue
        if all(_within(tree, p @ R.T, spacing) and _within(lines, p @ R.T, tolerance + step) for p in some):
            found.append(R)
    return [Rigid(R, centre - R @ centre) for R in found]


def chain_images(mesh: Mesh, edges: FeatureEdges, motions: Sequence[Rigid]) -> list[Ids]:
    """Return for each symmetry `part_from_part` the number (C,) of the chain that it brings onto each chain."""
    from scipy.spatial import cKDTree

    if not len(edges):
        return [np.zeros(0, np.int32) for _ in motions]
    a, b = (mesh.vertices[edges.vertices[:, k]] for k in range(2))
    length = np.linalg.norm(b - a, axis=1)
    n = np.maximum(np.ceil(length / max(length.sum(), 1e-300) * _MARKED), 1).astype(int)
    tree, chain = cKDTree(_points(a, b, n)), np.concatenate([np.repeat(edges.chain, n), edges.chain, edges.chain])
    order, count = np.argsort(edges.chain, kind="stable"), np.bincount(edges.chain)
    middle = order[np.minimum(np.cumsum(count) - count + count // 2, len(order) - 1)]  # segment of each chain
    return [chain[tree.query(S.inv @ ((a[middle] + b[middle]) / 2))[1]] for S in motions]


def _extent(corners: Array) -> Array:
    """Return the principal axes of corners (N, 3) as columns (3, 3), each as long as half of their extent along it."""
    axes = np.linalg.svd(corners, full_matrices=False)[2]
    return np.asarray(axes.T * np.ptp(corners @ axes.T, axis=0) / 2)


def _within(tree: cKDTree, points: Array, reach: float) -> bool:
    """Return whether every one of the points (N, 3) has a point of the tree within `reach`."""
    return bool(np.isfinite(tree.query(points, distance_upper_bound=reach)[0]).all())


def spins_of(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return the twists (6, k), mm and rad in its frame, of a part's rotations that no photo shows.

    k: 3 of a ball, about its centre; 1 of a part of revolution, about its axis; 0 of others. Of a part of revolution
    all corners lie on circles about the axis, all around, and all edges run along these. Circles and ball have corners
    only in the faceted model.
    """
    T = mesh.vertices[mesh.faces]
    area = mesh.face_areas
    if not area.sum() > 0:
        return np.zeros((6, 0))
    centre = (area @ T.mean(axis=1)) / area.sum()
    T = T - centre  # surface integral of x x': area / 12 (sum of v v' + (sum v) (sum v)')
    total = T.sum(axis=1)
    moments = np.einsum("f,fki,fkj->ij", area, T, T) + np.einsum("f,fi,fj->ij", area, total, total)
    used = np.unique(mesh.faces)
    radius = np.linalg.norm(mesh.vertices[used] - centre, axis=1)
    if not len(edges.vertices) and np.ptp(radius) < _SAME * radius.max():
        axes = np.eye(3)
    else:
        principal = np.linalg.eigh(moments)[1].T
        about = (axis for axis in principal if _is_of_revolution(mesh.vertices - centre, axis, used, edges.vertices))
        axes = np.array([*about][:1]).reshape(-1, 3)
    return np.concatenate([np.cross(centre, axes), axes], axis=1).T


def _is_of_revolution(p: Array, axis: Array, used: Ids, edges: Ids) -> bool:
    """Return whether a part is one of revolution about an axis (3,) through the origin, as far as its facets allow.

    p (V, 3): vertices, of which `used` (n,) belong to faces; edges (S, 2): vertices that edges join. Edges must run
    along circles about the axis, and the vertices on each circle leave no gap wider than between two facets.
    """
    across = np.linalg.svd(axis[None])[2][1:]
    height, (x, y) = p @ axis, across @ p.T
    radius = np.hypot(x, y)
    tolerance = _SAME * float(np.hypot(height, radius)[used].max())
    a, b = edges.T
    if (np.maximum(np.abs(height[a] - height[b]), np.abs(radius[a] - radius[b])) > tolerance).any():
        return False
    off = used[radius[used] > 2 * tolerance]
    level, ring = (_clusters(value[off], tolerance) for value in (height, radius))
    circle = level * (int(ring.max(initial=0)) + 1) + ring
    return len(off) > 0 and _widest_gap(circle, np.arctan2(y, x)[off]) < _ROUND + _APART


def _widest_gap(circle: Ids, turn: Array) -> float:
    """Return the largest angle (rad) between neighbours on any circle; circle, turn (n,): of each point."""
    order = np.lexsort((turn, circle))
    circle, turn = circle[order], turn[order]
    first = np.flatnonzero(np.diff(circle, prepend=-1))
    last = np.append(first[1:], len(circle)) - 1
    gap = np.diff(turn, append=0.0)
    gap[last] = turn[first] + 2 * np.pi - turn[last]
    return float(gap.max())


def _clusters(values: Array, tolerance: float) -> Ids:
    """Return each value's cluster number; clusters are separated by gaps larger than the tolerance."""
    order = np.argsort(values)
    out = np.zeros(len(values), np.int32)
    out[order] = np.cumsum(np.diff(values[order], prepend=values[order[:1]]) > tolerance)
    return out


def _candidates(corners: Array, tolerance: float) -> list[Array]:
    """Return the rotations that take a frame of two corners to a congruent one, the most congruent first."""
    length = np.linalg.norm(corners, axis=1)
    a = int(np.argmax(length))
    across = np.linalg.norm(np.cross(corners, corners[a]), axis=1)
    b = int(np.argmax(across * (length > 0.3 * length[a])))
    if not across[b] > 1e-3 * length[a] ** 2:
        return []
    like_a, like_b = (np.flatnonzero(np.abs(length - length[k]) < 2 * tolerance)[:_MOST] for k in (a, b))
    apart = np.linalg.norm(corners[like_a][:, None] - corners[like_b][None], axis=2)
    aside = np.linalg.norm(np.cross(corners[like_a][:, None], corners[like_b][None]), axis=2)  # 0: no frame
    amiss = np.abs(apart - np.linalg.norm(corners[a] - corners[b]))
    pairs = np.argwhere((amiss < 2 * tolerance) & (aside > 0.5 * across[b]))
    amiss += np.abs(length[like_a] - length[a])[:, None] + np.abs(length[like_b] - length[b])
    pairs = pairs[np.argsort(amiss[tuple(pairs.T)], kind="stable")]
    home = _frame(corners[a], corners[b])
    return [_frame(corners[like_a[i]], corners[like_b[j]]) @ home.T for i, j in pairs]


def _frame(a: Array, b: Array) -> Array:
    x = a / np.linalg.norm(a)
    z = np.cross(a, b)
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _along(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return about _SAMPLES points (N, 3) on the edges, with all end points."""
    a, b = (mesh.vertices[edges.vertices[:, k]] for k in range(2))
    length = np.linalg.norm(b - a, axis=1)
    return _points(a, b, np.maximum(np.ceil(length / max(length.sum(), 1e-300) * _SAMPLES), 1).astype(int))


def _dense(mesh: Mesh, edges: FeatureEdges, step: float) -> tuple[Array, float]:
    """Return points (N, 3) on the edges that are at most a step (mm) apart, and that step: longer on many edges."""
    a, b = (mesh.vertices[edges.vertices[:, k]] for k in range(2))
    length = np.linalg.norm(b - a, axis=1)
    step = max(step, float(length.sum()) / 200_000)
    return _points(a, b, np.maximum(np.ceil(length / step), 1).astype(int)), step


def _points(a: Array, b: Array, n: np.ndarray) -> Array:
    """Return the end points of each segment and the midpoints of n equal pieces of it."""
    k = np.repeat(np.arange(len(n)), n)
    t = (np.arange(len(k)) - np.repeat(np.cumsum(n) - n, n) + 0.5) / n[k]
    return np.concatenate([a[k] + t[:, None] * (b[k] - a[k]), a, b])
