"""Repair of common errors in files: split vertices, faces without area, repeats of faces and parts, mixed winding."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.mesh import Mesh, compacted
from cadcam.cad.needles import height_ratio, without_needles
from cadcam.cad.repeats import first_in_place, repeats
from cadcam.cad.topology import HalfEdges, components, part_vertices, sewn, weld
from cadcam.cad.winding import winding_number
from cadcam.errors import DegenerateGeometry


@dataclass(frozen=True, slots=True)
class Repairs:
    """What `mend` did, in numbers, and what it found but left alone."""

    welded_vertices: int = 0
    sewn_vertices: int = 0
    widest_seam_mm: float = 0.0
    degenerate_faces: int = 0
    duplicate_faces: int = 0
    duplicate_parts: int = 0
    turned_faces: int = 0
    open_edges: int = 0
    non_manifold_edges: int = 0

    def lines(self) -> list[str]:
        """Return one sentence for each repair or finding."""
        gap = f" to others up to {self.widest_seam_mm:.2g} mm away"
        said = [
            (self.welded_vertices, "vertex welded", "vertices welded"),
            (self.sewn_vertices, f"open end sewn{gap}", f"open ends sewn{gap}"),
            (self.degenerate_faces, "face without area mended", "faces without area mended"),
            (self.duplicate_faces, "repeated face removed", "repeated faces removed"),
            (self.duplicate_parts, "part removed where another is", "parts removed where others are"),
            (self.turned_faces, "face turned to point outwards", "faces turned to point outwards"),
            (self.open_edges, "open edge (a sheet or a gap)", "open edges (sheets or gaps)"),
            (self.non_manifold_edges, "edge shared by three or more faces", "edges shared by three or more faces"),
        ]
        return [f"{count} {one if count == 1 else many}" for count, one, many in said if count]


def mend(mesh: Mesh) -> tuple[Mesh, Repairs]:
    """Return the mesh welded, cleaned and wound outwards, and the repairs made.

    Vertices of one part are welded by position, and ends of its open edges sewn together that lie closer than a photo
    shows. Faces with a corner welded away are removed, and so are repeats of a face within its part, the double walls
    between bodies of one part that touch face to face, and parts that stand face by face where another does; faces too
    low to have a normal are merged into their neighbour. Each component of faces joined by two-faced edges is wound
    consistently; closed ones outwards by their signed volume (a cavity keeps its sense relative to the body around it),
    components that only close together with those of other parts likewise. Open sheets keep the sense of the majority
    of their faces, and one-sided (Möbius) components are left alone. Raises `DegenerateGeometry` when no face is left.
    """
    vertex, part, corner = part_vertices(mesh)
    points = mesh.vertices[vertex]
    first = weld(points, part)
    onto, seam = sewn(points, part, first[corner])
    n_sewn, points = int((onto != np.arange(len(onto))).sum()), _in_the_middle(points, onto)
    n_welded = len(points) - int(np.unique(first).size)
    corners = onto[first][corner]
    kept = _distinct_corners(corners)
    n_collapsed = int((~kept).sum())
    kept[kept] = ~repeats(corners[kept])
    n_repeats = mesh.n_faces - int(kept.sum()) - n_collapsed
    welded = replace(
        mesh.select(kept) if not kept.all() else mesh,
        vertices=points,
        faces=corners[kept].astype(np.int32),
    )
    if not welded.n_faces:
        raise DegenerateGeometry("every face has zero area")
    first = first_in_place(welded)
    once = first == np.arange(len(first))
    if not once.all():
        welded = welded.subset(np.flatnonzero(once).tolist())
    turned = _turned(welded)
    sound = _faces_turned(welded, turned)
    n_flat = int((height_ratio(sound) <= 1).sum())
    sound = without_needles(sound)
    half = HalfEdges.of(sound.faces.astype(np.int64))
    return _facing_normals(compacted(sound)), Repairs(
        welded_vertices=n_welded,
        sewn_vertices=n_sewn,
        widest_seam_mm=seam,
        degenerate_faces=n_collapsed + n_flat,
        duplicate_faces=n_repeats,
        duplicate_parts=int((~once).sum()),
        turned_faces=int(turned.sum()),
        open_edges=int((half.count == 1).sum()),
        non_manifold_edges=int((half.count > 2).sum()),
    )


def _in_the_middle(points: Array, onto: Longs) -> Array:
    """Return points (N, 3) with each that others are sewn onto in the middle of them all."""
    if (onto == np.arange(len(onto))).all():
        return points
    count = np.bincount(onto, minlength=len(points))
    mean = np.stack([np.bincount(onto, points[:, k], len(points)) for k in range(3)], axis=1)
    return np.where((count > 1)[:, None], mean / np.maximum(count, 1)[:, None], points)


def _distinct_corners(corners: Longs) -> Mask:
    a, b, c = corners.T
    return np.asarray((a != b) & (b != c) & (c != a))


def _faces_turned(mesh: Mesh, turned: Mask) -> Mesh:
    if not turned.any():
        return mesh
    faces = mesh.faces.copy()
    faces[turned] = faces[turned][:, ::-1]
    normals = mesh.corner_normals
    if normals is not None:
        normals = normals.copy()
        normals[turned] = normals[turned][:, ::-1]
    return replace(mesh, faces=faces, corner_normals=normals)


def _facing_normals(mesh: Mesh) -> Mesh:
    """Return the mesh with corner normals on the outer side, like the winding."""
    if mesh.corner_normals is None:
        return mesh
    inward = np.einsum("fck,fk->f", mesh.corner_normals, mesh.face_normals) < 0
    if not inward.any():
        return mesh
    return replace(mesh, corner_normals=np.where(inward[:, None, None], -mesh.corner_normals, mesh.corner_normals))


def _turned(mesh: Mesh) -> Mask:
    """Return which faces to flip: within each part first, then across parts for what stays open."""
    corners = mesh.faces.astype(np.int64)
    turned, closed = _winding(mesh.vertices, corners, mesh.part)
    if closed.all() or len(mesh.part_names) == 1:
        return turned
    rest = np.flatnonzero(~closed)
    where = np.where(turned[rest, None], corners[rest][:, ::-1], corners[rest])
    shared = weld(mesh.vertices, np.zeros(len(mesh.vertices), np.int64))
    again, now_closed = _winding(mesh.vertices, shared[where], np.zeros(len(rest), np.int32))
    turned[rest[now_closed]] ^= again[now_closed]
    return turned


def _winding(vertices: Array, corners: Longs, part: Ids) -> tuple[Mask, Mask]:
    """Return which faces (F,) to flip and which belong to a closed component."""
    half = HalfEdges.of(corners)
    component, state, orientable = _components(half, len(corners))
    closed = _closed(half, component) & orientable
    outward = np.where(state[:, None], corners[:, ::-1], corners)
    inverted = _inverted(vertices, outward, component, closed, part)
    turned = np.where(orientable[component], state ^ inverted[component], False)
    return np.asarray(turned), np.asarray(closed[component])


def _components(half: HalfEdges, n_faces: int) -> tuple[Longs, Mask, Mask]:
    """Return the component (F,) of each face, whether it is wound against the rest (F,), and which are orientable.

    Two copies of each face, one flipped: an edge whose faces run in opposite senses links equal copies, an edge whose
    faces run in the same sense links unlike ones. A component splits into two mirror images, or is one-sided.
    """
    first = half.start[half.count == 2]
    one, other = half.order[first], half.order[first + 1]
    against = half.forward[one] == half.forward[other]
    one, other = one // 3, other // 3
    component = components(np.column_stack([one, other]), n_faces)
    n = int(component.max(initial=-1)) + 1
    if not against.any():
        return component, np.zeros(n_faces, bool), np.ones(n, bool)
    rows = np.concatenate([one, one + n_faces])
    columns = np.concatenate([other + n_faces * against, other + n_faces * ~against])
    copy = components(np.column_stack([rows, columns]), 2 * n_faces).reshape(2, -1)
    state = copy[0] > copy[1]
    orientable = np.ones(n, bool)
    orientable[component[copy[0] == copy[1]]] = False
    minority = 2 * np.bincount(component, state, minlength=n) > np.bincount(component, minlength=n)
    return component, np.asarray(state ^ minority[component]), orientable


def _closed(half: HalfEdges, component: Longs) -> Mask:
    """Return which components (C,) have exactly two of their own faces at every edge."""
    closed = np.ones(int(component.max(initial=-1)) + 1, bool)
    side = half.order
    of_edge = component[side // 3]
    simple = np.repeat(half.count == 2, half.count)
    edge = half.edge[side[~simple]]
    key, count = np.unique(edge * len(closed) + of_edge[~simple], return_counts=True)
    closed[(key % len(closed))[count != 2]] = False
    return closed


def _inverted(vertices: Array, corners: Longs, component: Longs, closed: Mask, part: Ids) -> Mask:
    """Return which closed components (C,) are inside out; those within another body follow that body."""
    n = len(closed)
    low, high, volume = _boxes_and_volumes(vertices, corners, component, n)
    solid = closed & ~(np.abs(volume) <= 1e-9 * np.linalg.norm(high - low, axis=1) ** 3)
    inverted: Mask = solid & (volume < 0)
    if not inverted.any():
        return inverted
    a_vertex, its_part = np.zeros(n, np.int64), np.zeros(n, np.int64)
    a_vertex[component], its_part[component] = corners[:, 0], part
    largest_first = np.argsort(-np.prod(high - low, axis=1), kind="stable")
    largest_first = largest_first[solid[largest_first]]
    result = inverted.copy()
    for inner in largest_first:
        boxed = (its_part == its_part[inner]) & (low < low[inner]).all(axis=1) & (high > high[inner]).all(axis=1)
        for outer in largest_first[boxed[largest_first]]:
            if abs(winding_number(vertices[corners[component == outer]], vertices[a_vertex[inner]])) > 0.5:
                result[inner] = result[outer]
                break
    return result


def _boxes_and_volumes(vertices: Array, corners: Longs, component: Longs, n: int) -> tuple[Array, Array, Array]:
    """Return the lowest and highest corner (n, 3) of each component's box, and its signed volume (n,)."""
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    for k in range(3):
        np.minimum.at(low, component, vertices[corners[:, k]])
        np.maximum.at(high, component, vertices[corners[:, k]])
    centre = ((low + high) / 2)[component]  # volumes about it lose no digits far from the origin
    a, b, c = (vertices[corners[:, k]] - centre for k in range(3))
    volume = np.bincount(component, np.einsum("ij,ij->i", a, np.cross(b, c)), minlength=n) / 6
    return low, high, volume
