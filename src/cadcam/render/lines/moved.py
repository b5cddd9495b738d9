"""The faces of a mesh as occluders, some of its parts moved as wholes: most sights meet what they met before.

A sight that passes by the boxes of the moved parts, where they were and where they are, is answered by the faces as
they were. The others are cast at those parts alone whose boxes they cross. So no tree of all faces is built again, and
every answer is the one that such a tree would give: a ray meets a triangle, or does not, whatever else is in the tree.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.render.caster import Caster
from cadcam.render.lines.occlusion import OccludingFaces
from cadcam.render.lines.silhouette import Topology

_ROOM = 1e-5  # of the diagonal, around boxes: a hundred times what casters resolve


class MovedFaces(OccludingFaces):
    """The faces of a mesh in which parts were moved; the box around the whole, to which coordinates relate, stayed."""

    def __init__(self, still: OccludingFaces, before: Topology, after: Topology) -> None:
        mesh, was = after.mesh, before.mesh
        moved = (mesh.vertices != was.vertices).any(axis=1)[mesh.faces[:, 0]]
        self._still, self._mesh = still, mesh
        self._moved = np.isin(np.arange(len(mesh.part_names)), mesh.part[moved])
        self.normals: Array = still.normals.copy()
        self._first = mesh.vertices[mesh.faces[:, 0]]
        if moved.any():
            self.normals[moved] = mesh.select(moved).face_normals
        low, high = after.bounds
        room = _ROOM * float(np.linalg.norm(high - low))
        self._center = (low + high) / 2
        self._low, self._high = after.boxes[0] - room, after.boxes[1] + room
        there = [(boxes[0][self._moved] - room, boxes[1][self._moved] + room) for boxes in (before.boxes, after.boxes)]
        self._beside = [np.concatenate(corners) for corners in zip(*there, strict=True)]

    def hidden(self, points: Array, eye: Array, tolerance: Array) -> Mask:
        """Return which points (N, 3) mm are hidden from the eye (3,), or each from its own (N, 3)."""
        eyes = np.broadcast_to(eye, points.shape)
        anew = self._concerned(points, eyes)
        of = [(~anew, self._still)] + ([(anew, self._near(points[anew], eyes[anew]))] if anew.any() else [])
        out = np.zeros(len(points), bool)
        for rows, faces in of:
            out[rows] = faces.hidden(points[rows], eyes[rows], tolerance[rows])
        return out

    def piercings(self, starts: Array, ends: Array, tolerance: float) -> tuple[Longs, Array]:
        """Return (segment, t), in order of segments (N, 3), where faces cut through them and do not just touch them."""
        return self._near(starts, ends).piercings(starts, ends, tolerance)

    def pierced_again(self, topology: Topology, before: tuple[Longs, Array], tolerance: float) -> tuple[Longs, Array]:
        """Return (edge, t) where faces cut through the edges of the topology, which was so `before` parts moved."""
        low, high = self._beside
        overlap = ((self._low[:, None] <= high) & (self._high[:, None] >= low)).all(axis=2)
        near = np.flatnonzero(np.any(overlap, axis=1)[topology.owner])
        a, b = (self._mesh.vertices[topology.table.vertices[near, k]] for k in range(2))
        asked = self._concerned(a, b)
        again = np.zeros(len(topology.owner), bool)
        again[near[asked]] = True
        edge, t = before
        kept = ~again[edge]
        if not asked.any():
            return edge[kept], t[kept]
        number, at = self.piercings(a[asked], b[asked], tolerance)
        edge, t = np.concatenate([edge[kept], near[asked][number]]), np.concatenate([t[kept], at])
        order = np.argsort(edge, kind="stable")
        return edge[order], t[order]

    def _concerned(self, a: Array, b: Array) -> Mask:
        """Return which segments (N,) come near a moved part, where it was or where it is."""
        out = np.zeros(len(a), bool)
        for low, high in zip(*self._beside, strict=True):
            out[_crossing(a, b, low, high)] = True
        return out

    def _near(self, a: Array, b: Array) -> OccludingFaces:
        """Return the faces of the parts that any of the segments (N, 3) may meet, and of those that were moved."""
        kept = self._moved.copy()
        for part in np.flatnonzero(~kept & (self._low <= self._high).all(axis=1)):
            kept[part] = len(_crossing(a, b, self._low[part], self._high[part])) > 0
        mesh = self._mesh.select(kept[self._mesh.part])
        return OccludingFaces(mesh, Caster(mesh, center=self._center))


def _crossing(a: Array, b: Array, low: Array, high: Array) -> Longs:
    """Return which of the segments (N,) from a to b (N, 3) meet a box: no plane lies between the two.

    Planes that might are square to an edge of the box, or along such an edge and the segment.
    """
    middle, half = (low + high) / 2, (high - low) / 2
    m, e = (a + b) / 2 - middle, np.abs(b - a) / 2
    rows = np.flatnonzero((np.abs(m) <= half + e).all(axis=1))
    m, e, d = m[rows], e[rows], (b[rows] - a[rows]) / 2
    width = half[[1, 2, 0]] * e[:, [2, 0, 1]] + half[[2, 0, 1]] * e[:, [1, 2, 0]]
    return rows[(np.abs(np.cross(m, d)) <= width).all(axis=1)]
