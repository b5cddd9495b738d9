"""Coincident vertices, and the faces that meet at each edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.mesh import Mesh

# Vertices of a part closer than this share of its diagonal are one point: a part of 1 m is welded at 1 µm. The second
# figure is four times the rounding of a float32 coordinate, as in STL, GLB and many OBJ files.
WELD_SHARE = 1e-6
FLOAT32_SHARE = 2.5e-7
# Gaps between open edges are sewn up to this share of the part's diagonal, a tenth of a pixel where the part is 500 px
# large, and up to this share of the shortest edge there, so that no face is lost.
SEAM_SHARE, SEAM_OF_EDGE = 2e-4, 0.25
_ASKEW = np.array([0.4386, 0.5720, 0.6930])  # a direction that no part is aligned with, of length just below 1


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTable:
    """Every edge of a mesh once, with the faces that meet there.

    `vertices` (E, 2) indices into mesh.vertices, directed as the first face runs; `faces` (E, 2) two incident faces,
    the second -1 at a boundary; `count` (E,) number of incident faces (1 boundary, 2 manifold, 3 and more
    non-manifold); `angle` (E,) rad between the outward normals of the two faces, 0 where they continue flat or there is
    only one; `convex` (E,) whether the material lies inside the edge; `corner_edge` (F, 3) the edge that leaves each
    corner of each face, -1 where a face's side has no length.
    """

    vertices: Ids
    faces: Ids
    count: Ids
    angle: Array
    convex: Mask
    corner_edge: Ids


def edge_table(mesh: Mesh, points: Longs | None = None) -> EdgeTable:
    """Return all edges of the mesh; faces of one part meet where their vertices coincide, whatever their indices.

    points: the result of `corner_points` for the mesh, if already known.
    """
    return _edge_table(mesh, corner_points(mesh) if points is None else points)


def _edge_table(mesh: Mesh, points: Longs) -> EdgeTable:
    """Return the edges of faces whose corners are the points (F, 3)."""
    half = HalfEdges.of(points)
    first = half.order[half.start]
    second = half.order[np.minimum(half.start + 1, len(half.order) - 1)]
    alone = half.count == 1
    faces = np.stack([first // 3, np.where(alone, -1, second // 3)], axis=1)
    following = np.roll(mesh.faces, -1, axis=1).ravel()
    vertices = np.stack([mesh.faces.ravel()[first], following[first]], axis=1)
    same_way = half.forward[first] == half.forward[second]
    angle, convex = _dihedral(mesh, faces, vertices[:, 0].astype(np.int64), np.where(same_way, -1.0, 1.0), second)
    return EdgeTable(
        vertices=vertices.astype(np.int32),
        faces=faces.astype(np.int32),
        count=half.count.astype(np.int32),
        angle=angle,
        convex=convex,
        corner_edge=half.edge.reshape(-1, 3).astype(np.int32),
    )


@dataclass(frozen=True, slots=True, eq=False)
class HalfEdges:
    """The sides of faces grouped by edge: side k = 3 face + corner; `order` lists sides edge by edge.

    `start` and `count` (E,) delimit the sides of an edge in `order`; `edge` (3F,) is the edge of a side, -1 without
    length; `forward` (3F,) whether the side runs from the lower to the higher point.
    """

    order: Longs
    start: Longs
    count: Longs
    edge: Longs
    forward: Mask

    @classmethod
    def of(cls, points: Longs) -> HalfEdges:
        """Return the sides of faces whose corners are the points (F, 3)."""
        a, b = points.ravel(), np.roll(points, -1, axis=1).ravel()
        forward = a < b
        key = np.where(forward, a, b) * (np.int64(points.max(initial=0)) + 1) + np.where(forward, b, a)
        order = np.argsort(key, kind="stable")
        order = order[(a != b)[order]]
        first = _starts(key[order])
        start = np.flatnonzero(first)
        edge = np.full(len(a), -1, np.int64)
        edge[order] = np.cumsum(first) - 1
        return cls(order, start, np.diff(start, append=len(order)), edge, forward)


def is_solid(mesh: Mesh, points: Longs | None = None) -> bool:
    """Return whether each part is closed round a volume > 0, its sides in pairs that run against each other.

    points: the result of `corner_points` for the mesh, if already known.
    """
    half = HalfEdges.of(corner_points(mesh) if points is None else points)
    ways = np.where(half.forward[half.order], 1, -1)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[0, 0]] for k in range(3))
    volumes = np.bincount(mesh.part, np.einsum("ij,ij->i", a, np.cross(b, c)), len(mesh.part_names))
    return not np.add.reduceat(ways, half.start).any() and bool((volumes[np.unique(mesh.part)] > 0).all())


def corner_points(mesh: Mesh) -> Longs:
    """Return for every face corner (F, 3) the number of its point: equal where position and part are equal."""
    vertex, part, corner = part_vertices(mesh)
    return weld(mesh.vertices[vertex], part)[corner]


def part_vertices(mesh: Mesh) -> tuple[Longs, Longs, Longs]:
    """Return vertices with one owner each: their vertex (N,), their part (N,), and the corners (F, 3) that use them."""
    parts = np.int64(max(len(mesh.part_names), 1))
    key = mesh.faces * parts + mesh.part[:, None]
    seen = np.zeros(len(mesh.vertices) * int(parts), bool) if len(mesh.vertices) * parts < 50_000_000 else None
    if seen is None:
        unique, corner = np.unique(key, return_inverse=True)
        return unique // parts, unique % parts, corner.reshape(key.shape)
    seen[key.ravel()] = True
    unique = np.flatnonzero(seen)
    return unique // parts, unique % parts, (np.cumsum(seen) - 1)[key]


def components(links: npt.NDArray[np.integer], n: int) -> Longs:
    """Return the number (n,) of the connected component of each of n things; links (L, 2) are pairs of them."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def weld(points: Array, group: Longs) -> Longs:
    """Return for each point (N, 3) the first point of its group that coincides with it, within the weld tolerance."""
    first = same_rows(points, group)
    kept = np.flatnonzero(first == np.arange(len(points)))
    near = _near_pairs(points[kept], group[kept])
    if len(near):
        joined = np.arange(len(points))
        joined[kept] = kept[_lowest(near, len(kept))]
        first = joined[first]
    return first


def sewn(points: Array, group: Longs, corners: Longs) -> tuple[Longs, float]:
    """Return for each point (N, 3) the first one that it is sewn to, and the widest gap, mm, that this closes.

    Only ends of open edges of faces whose corners are the points (F, 3) are sewn, over at most SEAM_SHARE of their
    group's diagonal and SEAM_OF_EDGE of the shortest edge at either, and only in a group of which most open edges then
    meet another: writers that round every triangle by itself, or place it by arithmetic of their own, leave such gaps.
    Sheets that happen to end near each other stay two.
    """
    rim, open_before = _rim(corners, group)
    near, apart = _near_ends(points, group, corners, rim)
    onto = _lowest(near, len(points))
    open_after = _rim(onto[corners], group)[1]
    torn = 2 * open_after <= open_before
    kept = torn[group[near[:, 0]]]
    return np.where(torn[group], onto, np.arange(len(points))), float(apart[kept].max(initial=0.0))


def _rim(corners: Longs, group: Longs) -> tuple[Longs, Longs]:
    """Return the points at open edges of faces whose corners are these (F, 3), and how many edges each group has."""
    half = HalfEdges.of(corners)
    side = half.order[half.start[half.count == 1]]
    a, b = corners.ravel()[side], np.roll(corners, -1, axis=1).ravel()[side]
    return np.unique(np.concatenate([a, b])), np.bincount(group[a], minlength=int(group.max(initial=-1)) + 1)


def _near_ends(points: Array, group: Longs, corners: Longs, rim: Longs) -> tuple[Longs, Array]:
    """Return pairs (P, 2) of the points of `rim` that may be one as `sewn` says, and their distances (P,), mm."""
    from scipy.spatial import cKDTree

    a, b = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    length = np.linalg.norm(points[a] - points[b], axis=1)
    shortest = np.full(len(points), np.inf)
    for end in (a, b):
        np.minimum.at(shortest, end[length > 0], length[length > 0])
    most = SEAM_SHARE / WELD_SHARE * weld_tolerance(points, group)[group]
    rim = rim[most[rim] > 0]
    near = rim[cKDTree(points[rim] / most[rim, None]).query_pairs(1.0, output_type="ndarray")]
    apart = np.linalg.norm(points[near[:, 0]] - points[near[:, 1]], axis=1)
    room = SEAM_OF_EDGE * shortest[near].min(axis=1, initial=np.inf)
    close = (group[near[:, 0]] == group[near[:, 1]]) & (apart <= room)
    return near[close], apart[close]


def _lowest(pairs: Longs, n: int) -> Longs:
    """Return for each of n things the first one that pairs (P, 2) of them link it to."""
    label = components(pairs, n)
    lowest = np.full(n, n, np.int64)
    np.minimum.at(lowest, label, np.arange(n))
    return lowest[label]


def weld_tolerance(points: Array, group: Longs) -> Array:
    """Return the weld distance (mm) of each group, from its diagonal and the size of its coordinates.

    Coordinates of a map, kilometres from their origin, would be welded at millimetres, and the features of a part of a
    metre with them. Most such files are precise to far more than float32; of the others seams stay open and are named.
    """
    n = int(group.max(initial=-1)) + 1
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, group, points)
    np.maximum.at(high, group, points)
    there = np.isfinite(low[:, 0])
    diagonal = np.linalg.norm(np.where(there[:, None], high - low, 0), axis=1)
    largest = np.where(there[:, None], np.maximum(np.abs(low), np.abs(high)), 0).max(axis=1, initial=0)
    rounding = np.minimum(FLOAT32_SHARE * largest, SEAM_SHARE * diagonal)
    return np.asarray(np.maximum(WELD_SHARE * diagonal, rounding))


def _near_pairs(points: Array, group: Longs) -> Longs:
    """Return pairs (N, 2) of points of one group nearer than its tolerance.

    Near points are near along any line: of the points in order along one, each is compared with those within reach.
    """
    tolerance = weld_tolerance(points, group)[group]
    if not len(points) or not (tolerance > 0).all():
        return np.zeros((0, 2), np.int64)
    scaled = points / tolerance[:, None]
    order = np.argsort(scaled @ _ASKEW)
    along = (scaled @ _ASKEW)[order]
    found, place, step = [np.zeros((0, 2), np.int64)], np.arange(len(points) - 1), 1
    while len(place := place[along[place + step] - along[place] <= 1]):
        one, other = order[place], order[place + step]
        off = scaled[one] - scaled[other]
        near = (group[one] == group[other]) & (np.einsum("ij,ij->i", off, off) <= 1)
        found.append(np.column_stack([one[near], other[near]]))
        step += 1
        place = place[place + step < len(points)]
    return np.concatenate(found)


def same_rows(points: Array, group: Longs) -> Longs:
    """Return for each row the first row of its group with exactly its coordinates."""
    bits = np.ascontiguousarray(points + 0.0).view(np.uint64)  # + 0.0 turns -0.0 into 0.0
    hashed = group.astype(np.uint64)
    for column in bits.T:
        hashed = (hashed ^ column) * np.uint64(0x9E3779B97F4A7C15)
        hashed ^= hashed >> np.uint64(29)
    order = np.argsort(hashed, kind="stable")
    begins = _starts(hashed[order])
    first = np.zeros(len(points), np.int64)
    first[order] = order[np.flatnonzero(begins)[np.cumsum(begins) - 1]] if len(order) else order
    if (points[first] == points).all() and (group[first] == group).all():
        return first
    rows = np.column_stack([points + 0.0, group.astype(float)])  # a hash collision: compare the rows themselves
    _, index, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return np.asarray(index[inverse.ravel()], np.int64)


def _starts(keys: npt.NDArray[np.generic]) -> Mask:
    """Return where a run of equal sorted keys begins."""
    begins = np.ones(len(keys), bool)
    begins[1:] = keys[1:] != keys[:-1]
    return begins


def _dihedral(mesh: Mesh, faces: Longs, start: Longs, side: Array, second: Longs) -> tuple[Array, Mask]:
    """Return angle (E,) between the normals and convexity (E,); `side` is -1 where both faces run the same way."""
    normals = mesh.face_normals
    one, other = normals[faces[:, 0]], normals[np.maximum(faces[:, 1], 0)] * side[:, None]
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    cosine = np.einsum("ij,ij->i", one, other)
    opposite = mesh.vertices[mesh.faces[second // 3, (second + 2) % 3]] - mesh.vertices[start]
    convex = np.einsum("ij,ij->i", one, opposite) < 0
    paired = faces[:, 1] >= 0
    flat = (one == 0).all(axis=1) | (other == 0).all(axis=1)  # a face without area defines no bend
    return np.where(paired & ~flat, np.arctan2(sine, cosine), 0.0), convex & paired
