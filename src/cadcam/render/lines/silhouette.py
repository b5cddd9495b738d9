"""Edges relative to an eye: silhouettes, edges that can change the visibility of what is behind, edges turned away."""

from __future__ import annotations

from copy import copy

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.edges import edge_table
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import EdgeTable
from cadcam.cad.winding import winding_number
from cadcam.render.lines.occlusion import OccludingFaces, part_boxes, solid_parts

_EDGE_ON = 1e-12  # of the distance: an eye this close to a face's plane sees the face edge-on


class Topology:
    """The edges of a mesh with what does not depend on the view."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh: Mesh = mesh
        self.bounds: Array = mesh.bounds
        self.table: EdgeTable = edge_table(mesh)
        self.pair: Longs = np.maximum(self.table.faces, 0)  # (E, 2): at a boundary the second is any face
        self.solid: Mask = solid_parts(mesh, self.table)
        self.two: Mask = self.table.count == 2
        self.owner: Ids = mesh.part[self.table.faces[:, 0]]
        self.boxes: tuple[Array, Array] = part_boxes(mesh)
        self.flipped: Mask = _flipped(mesh, self.table)

    def moved(self, mesh: Mesh) -> Topology:
        """Return that of the same mesh with its parts moved as wholes: what meets at an edge, and how, stays."""
        out = copy(self)
        out.mesh, out.boxes = mesh, part_boxes(mesh)
        out.bounds = np.stack([out.boxes[0].min(axis=0), out.boxes[1].max(axis=0)])
        return out

    def shut(self, eye: Array) -> Mask:
        """Return the parts (P,) that are watertight and do not have the eye inside their material."""
        low, high = self.boxes
        shut = self.solid.copy()
        for part in np.flatnonzero(shut & (low <= eye).all(axis=1) & (eye <= high).all(axis=1)):
            corners = self.mesh.vertices[self.mesh.faces[self.mesh.part == part]]
            shut[part] = abs(winding_number(corners, eye)) < 0.5
        return shut

    def number_of(self, vertices: Ids) -> Ids:
        """Return the edge (S,) that runs between two vertices (S, 2), either way round; -1 where there is none."""
        n = np.int64(len(self.mesh.vertices))
        own, wanted = (np.sort(v.astype(np.int64), axis=1) @ np.array([n, 1]) for v in (self.table.vertices, vertices))
        if not len(own):
            return np.full(len(wanted), -1, np.int32)
        order = np.argsort(own)
        at = order[np.minimum(np.searchsorted(own[order], wanted), len(own) - 1)]
        return np.where(own[at] == wanted, at, -1).astype(np.int32)


class Turn:
    """The edges of the topology relative to an eye, as masks.

    `silhouette`: joins two faces on the same side of it in the picture. `away`: hidden by its own solid, its faces
    being turned away. `borders`: what lies behind it may be hidden on one side only. `ahead`: directed as in the table,
    it has the material that is seen on its left.
    """

    def __init__(self, topology: Topology, occluders: OccludingFaces, eye: Array) -> None:
        table, pair = topology.table, topology.pair
        height = occluders.heights(eye)
        front = height > 0
        one, other = front[pair[:, 0]], front[pair[:, 1]]
        self.silhouette: Mask = topology.two & (one != (other ^ topology.flipped))
        self.ahead: Mask = one
        shut = topology.shut(eye)[topology.owner]
        self.away: Mask = topology.two & shut & ~np.where(table.convex, one | other, one & other)
        edge_on = np.abs(height) <= _EDGE_ON * np.abs(topology.bounds - eye).max()
        self.borders: Mask = (self.silhouette & ~self.away) | ~topology.two
        if edge_on.any():
            self.borders |= edge_on[pair].any(axis=1)


def _flipped(mesh: Mesh, table: EdgeTable) -> Mask:
    """Return the edges (E,) whose two faces run along them in the same direction: their outsides are opposite."""
    second = np.maximum(table.faces[:, 1], 0)
    edges = np.arange(len(second))
    corner = np.argmax(table.corner_edge[second] == edges[:, None], axis=1)
    start = mesh.vertices[mesh.faces[second, corner]]
    a, b = mesh.vertices[table.vertices[:, 0]], mesh.vertices[table.vertices[:, 1]]
    nearer_a = np.sum((start - a) ** 2, axis=1) < np.sum((start - b) ** 2, axis=1)
    return np.asarray(nearer_a & (table.count == 2))
