"""Bends between the facets of rounded surfaces that the file gives only as facets."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import EdgeTable, components

# A run of at least FACET_RUN equal bends is a rounded surface: half a round has four of the steepest, a chamfer two.
# A cylinder of nine facets has bends of 40 degrees; an octagonal bar keeps its edges, as 45 is beyond the steepest.
FACET_RUN, STEEPEST_DEG = 4, 41.0
# Equal bends differ by no more than this share of the larger: the facets of a surface are of one chord, but for a last
# one that is often shorter. From a ratio of about 3 to 4 on it is a prism of unequal sides.
ALIKE = 0.25
# Adjacent edges of a coarse cone are this nearly parallel up to half an angle of 30 degrees, and the cone counts as
# round; of a pyramid of as many sides that is blunter the edges are drawn.
PARALLEL_DEG = 20.0
# Triangles that meet at less are one facet: far more than the rounding of a file bends a flat one, and a sixtieth of
# the least bend that is drawn by default.
FLAT_DEG = 0.5
_SAME_BEND = 0.6  # of the steepest bends of both surfaces together, of which a tangent seam, chord to chord, has half


def facet_edges(mesh: Mesh, table: EdgeTable, sharp: Mask) -> Mask:
    """Return which of the sharp edges (E,) are bends between the facets of one rounded surface.

    Flat patches are joined into facets first. From facet to facet the run continues where it leaves by a bend of the
    same sense and nearly the same angle and direction as the one it entered by. Made for STL and other files without
    surfaces.
    """
    result = np.zeros(len(sharp), bool)
    candidates = np.flatnonzero(sharp & (table.angle <= np.radians(STEEPEST_DEG)))
    if len(candidates) < FACET_RUN:
        return result
    facet = _flat_patches(table, mesh.n_faces)
    sides = np.sort(facet[table.faces[candidates]], axis=1)
    _, representative, bend = np.unique(sides, axis=0, return_index=True, return_inverse=True)
    edges = candidates[representative]
    run = components(_links(mesh, table, edges, sides[representative]), len(edges))
    long = np.bincount(run)[run] >= FACET_RUN
    result[candidates] = long[bend.ravel()]
    return result


def seam_angle(mesh: Mesh, table: EdgeTable, edges: Longs) -> Array:
    """Return the angle (rad) at which the two true surfaces meet along each of the edges.

    Taken from the surface normals at both ends where the mesh has them. Otherwise the bend between the facets, unless
    that is no more than the facets of the two surfaces bend among themselves, when the surfaces count as tangent: 0.
    """
    if mesh.corner_normals is not None:
        return _normal_angle(mesh, table, edges)
    step = _step(mesh, table)[table.faces[edges]].sum(axis=1)
    return np.where(table.angle[edges] <= _SAME_BEND * step, 0.0, table.angle[edges])


def _normal_angle(mesh: Mesh, table: EdgeTable, edges: Longs) -> Array:
    """Return the mean over both ends of the angle between the corner normals of the two faces."""
    assert mesh.corner_normals is not None
    ends = mesh.vertices[table.vertices[edges]]
    normals = []
    for side in (0, 1):
        face = table.faces[edges, side]
        corners = mesh.vertices[mesh.faces[face]]
        nearest = np.linalg.norm(corners[:, None] - ends[:, :, None], axis=3).argmin(axis=2)
        normals.append(mesh.corner_normals[face[:, None], nearest].astype(float))
    sine = np.linalg.norm(np.cross(*normals), axis=2)
    return np.asarray(np.arctan2(sine, (normals[0] * normals[1]).sum(axis=2)).mean(axis=1))


def _step(mesh: Mesh, table: EdgeTable) -> Array:
    """Return the steepest bend inside its own surface near each face (F,): on its sides or on its neighbours' sides."""
    one, other = table.faces[:, 0], np.maximum(table.faces[:, 1], 0)
    inside = np.flatnonzero((table.count == 2) & (mesh.surface[one] == mesh.surface[other]))
    one, other = one[inside], other[inside]
    own = np.zeros(mesh.n_faces)
    for face in (one, other):
        np.maximum.at(own, face, table.angle[inside])
    near = own.copy()
    np.maximum.at(near, one, own[other])
    np.maximum.at(near, other, own[one])
    return near


def _flat_patches(table: EdgeTable, n_faces: int) -> Longs:
    """Return for each face the number of the flat patch it lies in."""
    flat = table.faces[(table.count == 2) & (table.angle < np.radians(FLAT_DEG))]
    return components(flat, n_faces)


def _links(mesh: Mesh, table: EdgeTable, edges: Longs, sides: Longs) -> Longs:
    """Return pairs (N, 2) of bends that follow one another across a facet."""
    along = mesh.vertices[table.vertices[edges, 1]] - mesh.vertices[table.vertices[edges, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    facet = sides.T.ravel()
    bend = np.tile(np.arange(len(edges)), 2)
    order = np.argsort(facet, kind="stable")
    facet, bend = facet[order], bend[order]
    found = []
    for ahead in range(1, 8):  # a facet of a rounded surface has two to four bends; further ones are not examined
        one, other = bend[:-ahead], bend[ahead:]
        angle, angle2 = table.angle[edges[one]], table.angle[edges[other]]
        alike = np.abs(angle - angle2) <= ALIKE * np.maximum(angle, angle2)
        alike &= (facet[:-ahead] == facet[ahead:]) & (table.convex[edges[one]] == table.convex[edges[other]])
        alike &= np.abs(np.einsum("ij,ij->i", along[one], along[other])) > np.cos(np.radians(PARALLEL_DEG))
        found.append(np.column_stack([one[alike], other[alike]]))
    return np.concatenate(found)
