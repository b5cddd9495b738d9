"""Faces without height: three collinear corners, where a mesher split one side of an edge and not the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import HalfEdges, weld_tolerance
from cadcam.errors import DegenerateGeometry

# The normal of a face lower than this share of the weld tolerance consists of rounding errors.
LOW = 0.1


def height_ratio(mesh: Mesh) -> Array:
    """Return the height (F,) of each face over its longest side, as a multiple of the least that gives a normal."""
    sides = (mesh.vertices[mesh.faces[:, k - 1]] - mesh.vertices[mesh.faces[:, k]] for k in range(3))
    longest = np.sqrt(np.max([np.einsum("ij,ij->i", side, side) for side in sides], axis=0, initial=0))
    owner = np.zeros(len(mesh.vertices), np.int64)
    owner[mesh.faces.ravel()] = np.repeat(mesh.part, 3)
    limit = LOW * weld_tolerance(mesh.vertices, owner)[mesh.part] * longest
    return np.asarray(2 * mesh.face_areas / np.maximum(limit, 1e-300))


def without_needles(mesh: Mesh) -> Mesh:
    """Return the mesh without faces that have no height.

    The middle corner of such a face lies on its longest side. The neighbour across that side is split there and takes
    the face's place, so that no gap opens; without a single neighbour the face is removed. Faces that were split keep
    the part and surface of the neighbour. The mesh must be wound consistently. Raises `DegenerateGeometry` when nothing
    is left.
    """
    before = mesh.n_faces + 1
    while True:
        low = height_ratio(mesh) <= 1
        left = int(low.sum())
        if not left:
            return mesh
        if low.all():
            raise DegenerateGeometry("every face has zero area")
        needle, side, other = _pairs(mesh, low)
        if not len(needle) or left >= before:
            return mesh.select(~low)
        before = left
        mesh = _split(mesh, needle, side, other)


def _pairs(mesh: Mesh, low: Mask) -> tuple[Longs, Longs, Longs]:
    """Return needles, the corner before their longest side, and the side (3 face + corner) of the neighbour across it.

    Each neighbour appears once; other needles with the same one wait for the next round.
    """
    half = HalfEdges.of(mesh.faces.astype(np.int64))
    corner = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).argmax(axis=1)
    needle = np.flatnonzero(low)
    side = 3 * needle + longest[needle]
    edge = half.edge[side]
    fits = (edge >= 0) & (half.count[edge] == 2)
    needle, side, edge = needle[fits], side[fits], edge[fits]
    one, two = half.order[half.start[edge]], half.order[half.start[edge] + 1]
    other = np.where(one == side, two, one)
    fits = ~low[other // 3] & (half.forward[other] != half.forward[side])
    needle, side, other = needle[fits], side[fits], other[fits]
    _, first = np.unique(other // 3, return_index=True)
    return needle[first], side[first] % 3, other[first]


def _split(mesh: Mesh, needle: Longs, side: Longs, other: Longs) -> Mesh:
    """Replace each needle (a, b, c), b between c and a, and its neighbour (c, a, d) by (c, b, d) and (b, a, d)."""
    neighbour, k = other // 3, other % 3
    middle = mesh.faces[needle, (side + 2) % 3]
    start, end, apex = (mesh.faces[neighbour, (k + i) % 3] for i in range(3))
    faces, part, surface = mesh.faces.copy(), mesh.part.copy(), mesh.surface.copy()
    faces[neighbour] = np.column_stack([start, middle, apex])
    faces[needle] = np.column_stack([middle, end, apex])
    part[needle], surface[needle] = part[neighbour], surface[neighbour]
    normals = mesh.corner_normals
    if normals is not None:
        at_start, at_end, at_apex = (normals[neighbour, (k + i) % 3] for i in range(3))
        between = _between(at_start, at_end, *(mesh.vertices[i] for i in (start, middle, end)))
        normals = normals.copy()
        normals[neighbour] = np.stack([at_start, between, at_apex], axis=1)
        normals[needle] = np.stack([between, at_end, at_apex], axis=1)
    paint = mesh.face_colors
    if paint is not None:
        paint = paint.copy()
        paint[needle] = paint[neighbour]
    return replace(mesh, faces=faces, part=part, surface=surface, corner_normals=normals, face_colors=paint)


def _between(
    at_start: npt.NDArray[np.float32], at_end: npt.NDArray[np.float32], start: Array, middle: Array, end: Array
) -> npt.NDArray[np.float32]:
    """Return the unit normals (n, 3) at points between two ends, from those at the ends."""
    share = np.linalg.norm(middle - start, axis=1) / np.maximum(np.linalg.norm(end - start, axis=1), 1e-300)
    between = at_start + np.clip(share, 0, 1)[:, None].astype(np.float32) * (at_end - at_start)
    length = np.linalg.norm(between, axis=1, keepdims=True)
    return np.asarray(between / np.where(length > 0, length, 1))
