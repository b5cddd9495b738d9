"""Contact of bodies: contact lines, and seams that are not lines at all.

A body is a connected set of faces of one part. An edge is examined at three places for another body, and for whether
the surface beyond the edge continues in the plane of one of its faces. The middle and one more place make a contact; a
seam that vanishes must continue at all three, so an edge that is only partly covered stays whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.box_tree import TriangleTree
from cadcam.cad.edge_kind import EdgeKind
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import EdgeTable, components, weld

TOLERANCE_SHARE, TOLERANCE_MOST_MM = 1e-5, 0.5
FLUSH_DEG = 2.0  # two faces this parallel continue one another
STEP = 4.0  # how far beyond the edge to look, in tolerances
PLACES = np.array([0.1, 0.5, 0.9])  # fractions of an edge
COLOR_STEP = 0.02  # parts whose colours differ by more have a visible seam


def contact_tolerance(mesh: Mesh) -> float:
    """Return the default distance in mm within which parts of the mesh touch."""
    return min(TOLERANCE_SHARE * float(np.linalg.norm(mesh.size_mm)), TOLERANCE_MOST_MM)


@dataclass(frozen=True, slots=True, eq=False)
class _Touch:
    """For some edges: whether anything lies along them, continues their surface, or meets it at an angle."""

    any: Mask
    flush: Mask
    folded: Mask
    other: Mask  # whether something of another part lies there


def resolve_contacts(
    mesh: Mesh, table: EdgeTable, kind: Ids, *, crease_angle: float, tolerance: float | None, keep_flush: bool
) -> Ids:
    """Return the kinds (E,) with contacts marked, and seams inside flat areas removed.

    A boundary that ends on another face of its own part is a T-junction: it stays, as a crease, where the two bend by
    more than `crease_angle` (rad). Of edges of two bodies that coincide, one stays.
    """
    body = bodies(mesh, table)
    chosen = np.flatnonzero(kind >= 0)
    if not len(chosen) or (body.max(initial=0) == 0 and not (kind == EdgeKind.BOUNDARY).any()):
        return kind
    if tolerance is None:
        tolerance = contact_tolerance(mesh)
    result = kind.copy()
    solid = chosen[kind[chosen] != EdgeKind.BOUNDARY]
    if len(solid) and body.max() > 0:
        touch = _Neighbours(mesh, table, body, tolerance).touch(solid, crease_angle)
        result[solid[touch.any]] = EdgeKind.CONTACT
        if not keep_flush:
            result[solid[touch.flush]] = -1
    free = chosen[kind[chosen] == EdgeKind.BOUNDARY]
    if len(free):
        every = np.arange(mesh.n_faces)  # a boundary may end on its own body
        touch = _Neighbours(mesh, table, every, tolerance).touch(free, crease_angle)
        result[free[touch.any & touch.other]] = EdgeKind.CONTACT
        inner = touch.any & ~touch.other
        result[free[inner]] = np.where(touch.folded[inner], EdgeKind.CREASE, -1)
        if not keep_flush:
            result[free[touch.flush]] = -1
    return _without_twins(mesh, table, result, touched=result != kind)


def bodies(mesh: Mesh, table: EdgeTable) -> Longs:
    """Return the number (F,) of the connected body of each face."""
    edge = table.corner_edge.ravel()
    valid = edge >= 0
    face = np.repeat(np.arange(mesh.n_faces), 3)[valid]
    return components(np.column_stack([face, table.faces[edge[valid], 0]]), mesh.n_faces)


class _Neighbours:
    """The surroundings of a mesh's edges within a tolerance (mm), without the owner (F,) of their first face."""

    def __init__(self, mesh: Mesh, table: EdgeTable, owner: Longs, tolerance: float) -> None:
        self._mesh, self._table, self._owner, self._tolerance = mesh, table, owner, tolerance
        self._normals = mesh.face_normals
        self._tree = TriangleTree(mesh, owner)

    def touch(self, edges: Longs, crease_angle: float) -> _Touch:
        """Return the surroundings of each of the edges."""
        n, mesh, normals = len(edges), self._mesh, self._normals
        home = self._table.faces[edges, 0]
        touched, folded, other = (np.zeros((n, len(PLACES)), bool) for _ in range(3))
        points = self._places(edges)
        middle = np.unique(self._near(points[:, 1:2], edges)[0])  # most edges touch nothing: one query rules them out
        at, place, face = self._near(points[middle], edges[middle])
        edge = middle[at]
        touched[edge, place] = True
        other[edge, place] |= mesh.part[face] != mesh.part[home[edge]]
        bend = np.abs(np.einsum("ij,ij->i", normals[face], normals[home[edge]])) < np.cos(crease_angle)
        folded[edge[bend], place[bend]] = True
        enough = touched.sum(axis=1) >= 2
        flush = np.zeros(n, bool)
        hit = np.flatnonzero(touched.all(axis=1))
        for side in (0, 1):
            flush[hit] |= self._goes_on(edges[hit], side)
        return _Touch(enough, flush, folded.sum(axis=1) >= 2, other.sum(axis=1) >= 2)

    def _near(self, points: Array, edges: Longs) -> tuple[Longs, Longs, Longs]:
        """Return the edge, the place on it (of k) and the face of all that is near points (E, k, 3)."""
        k, own = points.shape[1], self._owner[self._table.faces[edges, 0]]
        at, face = self._tree.touching(points.reshape(-1, 3), self._tolerance, apart_from=np.repeat(own, k))
        return at // k, at % k, face

    def _places(self, edges: Longs) -> Array:
        """Return the points (E, 3, 3) at which the edges are examined."""
        a, b = self._ends(edges)
        return np.asarray(a[:, None] + PLACES[:, None] * (b - a)[:, None])

    def _ends(self, edges: Longs) -> tuple[Array, Array]:
        ends = self._mesh.vertices[self._table.vertices[edges]]
        return ends[:, 0], ends[:, 1]

    def _goes_on(self, edges: Longs, side: int) -> Mask:
        """Return for which edges faces beyond the edge continue the face on the given side flat, in the same colour."""
        mesh, normals = self._mesh, self._normals
        face = self._table.faces[edges, side]
        there = face >= 0
        a, b = self._ends(edges)
        outward = np.cross(b - a, normals[face])
        length = np.linalg.norm(outward, axis=1, keepdims=True)
        outward /= np.where(length > 0, length, 1)
        inward = mesh.vertices[mesh.faces[face]].mean(axis=1) - a
        outward *= -np.sign(np.einsum("ij,ij->i", outward, inward))[:, None]
        beyond = self._places(edges) + STEP * self._tolerance * outward[:, None]
        edge, place, found = self._near(beyond, edges)
        agree = np.einsum("ij,ij->i", normals[found], normals[face[edge]])
        agree = np.where(self._table.count[edges[edge]] == 1, np.abs(agree), agree)
        same = (agree > np.cos(np.radians(FLUSH_DEG))) & there[edge] & ~_colors_differ(mesh, face[edge], found)
        result = np.zeros((len(edges), len(PLACES)), bool)
        result[edge[same], place[same]] = True
        return np.asarray(result.all(axis=1))


def _colors_differ(mesh: Mesh, one: npt.NDArray[np.integer], other: npt.NDArray[np.integer]) -> Mask:
    colors = mesh.colors_of_faces
    step = np.abs(colors[one] - colors[other])
    return np.asarray((step > COLOR_STEP).any(axis=1))  # NaN, an unknown colour, counts as equal


def _without_twins(mesh: Mesh, table: EdgeTable, kind: Ids, *, touched: Mask) -> Ids:
    """Return the kinds with all but the first of coinciding edges removed, among those that touch something."""
    edges = np.flatnonzero(touched & (kind >= 0))
    if not len(edges):
        return kind
    ends = table.vertices[edges]
    vertices, inverse = np.unique(ends, return_inverse=True)
    point = np.sort(weld(mesh.vertices[vertices], np.zeros(len(vertices), np.int64))[inverse.reshape(-1, 2)], axis=1)
    _, first = np.unique(point, axis=0, return_index=True)
    result = kind.copy()
    result[np.delete(edges, first)] = -1
    return result
