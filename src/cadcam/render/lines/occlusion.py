"""The points of a mesh visible to an eye: the caster proposes, in float32 by Embree; float64 decides."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import EdgeTable
from cadcam.cores import blocks, on_cores
from cadcam.geometry.rotation import hat
from cadcam.render.caster import Caster

_ROUNDS = 48  # rejected hits per ray: each skips at least twice as far as the last
_SURE = 100.0  # a face whose plane misses the point by this many tolerances is accepted from Embree without a test


class OccludingFaces:
    """The faces of a mesh as occluders.

    A face hides a point from an eye if it meets the open segment between them while the point lies more than the
    tolerance off the face's plane. Faces that contain the point (those of its own edge, a plate that the point's part
    stands on, a coplanar overlap) therefore never hide it, from any direction; neither does a face without area.
    """

    def __init__(self, mesh: Mesh, caster: Caster) -> None:
        self._caster = caster
        self._mesh = mesh
        self.normals: Array = mesh.face_normals
        self._first = mesh.vertices[mesh.faces[:, 0]]

    def height(self, faces: Ids | Longs, points: Array) -> Array:
        """Return the signed distance (N,) in mm of points (N, 3) from the planes of faces (N,), positive outside."""
        return np.asarray(np.einsum("ij,ij->i", self.normals[faces], points - self._first[faces]))

    def heights(self, point: Array) -> Array:
        """Return the signed distance (F,) in mm of a point (3,) from the planes of all faces."""
        return np.asarray(np.einsum("ij,ij->i", self.normals, point - self._first))

    def hidden(self, points: Array, eye: Array, tolerance: Array) -> Mask:
        """Return which points (N, 3) mm are hidden from the eye (3,), or each from its own (N, 3).

        tolerance (N,): in mm, for each point.
        """
        eyes = np.broadcast_to(eye, points.shape)
        return np.concatenate(on_cores(lambda b: self._hidden(points[b], eyes[b], tolerance[b]), blocks(len(points))))

    def _hidden(self, points: Array, eye: Array, tolerance: Array) -> Mask:
        sight = eye - points
        length = np.sqrt(np.einsum("ij,ij->i", sight, sight))
        along = sight / length[:, None]
        hidden = np.zeros(len(points), bool)
        start, skip, live = tolerance.copy(), tolerance.copy(), np.arange(len(points))
        for _ in range(_ROUNDS):
            p, d = points[live], along[live]
            faces = self._caster.first_hit(p + start[live][:, None] * d, d, length[live] - start[live])
            met = faces >= 0
            live, faces = live[met], faces[met]
            if not len(live):
                break
            at = self._distance(faces, points[live], along[live])
            blocked = self._blocks(faces, points[live], along[live], length[live], tolerance[live], at)
            hidden[live[blocked]] = True
            live, at = live[~blocked], at[~blocked]
            start[live] = np.maximum(start[live], np.clip(np.nan_to_num(at), 0, length[live])) + skip[live]
            skip[live] *= 2
            live = live[start[live] < length[live]]
        return hidden

    def _distance(self, faces: Ids, points: Array, along: Array) -> Array:
        """Return the distance along the line to each face's plane, mm."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(-self.height(faces, points) / np.einsum("ij,ij->i", self.normals[faces], along))

    def _blocks(self, faces: Ids, points: Array, along: Array, length: Array, tolerance: Array, at: Array) -> Mask:
        """Return which faces lie between their points and the eyes, `length` mm off along unit directions."""
        off = np.abs(self.height(faces, points))
        blocked = (off > tolerance) & (at > 0) & (at < length)
        near = np.flatnonzero(blocked & (off < _SURE * tolerance))
        if len(near):  # seldom
            blocked[near] = self._inside(faces[near], points[near] + at[near, None] * along[near])
        return blocked

    def _inside(self, faces: Ids, points: Array) -> Mask:
        """Return which points of the faces' planes lie in the closed triangles."""
        corners, normals = self._mesh.vertices[self._mesh.faces[faces]], self.normals[faces]
        inside = np.ones(len(faces), bool)
        for k in range(3):
            side = corners[:, (k + 1) % 3] - corners[:, k]
            turn = np.einsum("ijk,ik,ij->i", hat(side), points - corners[:, k], normals)
            inside &= turn >= -1e-9 * np.einsum("ij,ij->i", side, side)
        return inside

    def piercings(self, starts: Array, ends: Array, tolerance: float) -> tuple[Longs, Array]:
        """Return (segment, t), in order of segments (N, 3), where faces cut through them and do not just touch them."""
        found = on_cores(lambda b: self._piercings(starts[b], ends[b], tolerance, b.start), blocks(len(starts)))
        return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])

    def _piercings(self, starts: Array, ends: Array, tolerance: float, base: int) -> tuple[Longs, Array]:
        sight = ends - starts
        length = np.linalg.norm(sight, axis=1)
        live = np.flatnonzero(length > 2 * tolerance)
        along = sight / np.maximum(length, 1e-300)[:, None]
        start, skip = np.full(len(starts), tolerance), np.full(len(starts), tolerance)
        found: list[tuple[Longs, Array]] = []
        for _ in range(_ROUNDS):
            p, d = starts[live], along[live]
            reach = length[live] - start[live] - tolerance
            faces = self._caster.first_hit(p + start[live][:, None] * d, d, np.maximum(reach, 0.0))
            met = (faces >= 0) & (reach > 0)
            live, faces = live[met], faces[met]
            if not len(live):
                break
            before, after = self.height(faces, starts[live]), self.height(faces, ends[live])
            cuts = (before * after < 0) & (np.minimum(np.abs(before), np.abs(after)) > tolerance)
            with np.errstate(divide="ignore", invalid="ignore"):
                t = np.clip(np.nan_to_num(before / (before - after)), 0, 1)
            found.append((live[cuts], t[cuts]))
            skip[live] = np.where(cuts, tolerance, 2 * skip[live])
            start[live] = np.maximum(start[live], t * length[live]) + skip[live]
        index = np.concatenate([np.zeros(0, np.int64), *(f[0] for f in found)])
        t = np.concatenate([np.zeros(0), *(f[1] for f in found)])
        order = np.argsort(index, kind="stable")
        return index[order] + base, t[order]


def solid_parts(mesh: Mesh, table: EdgeTable) -> Mask:
    """Return which parts (P,) are watertight: every edge joins exactly two faces."""
    bad = table.count != 2
    solid = np.bincount(mesh.part, minlength=len(mesh.part_names)) > 0
    solid[mesh.part[table.faces[bad, 0]]] = False
    return solid


def part_boxes(mesh: Mesh) -> tuple[Array, Array]:
    """Return the lowest and highest corner (P, 3) of each part; inf and -inf for a part without faces."""
    n = len(mesh.part_names)
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    order = np.argsort(mesh.part, kind="stable")
    parts, first = np.unique(mesh.part[order], return_index=True)
    if len(parts):
        corners = mesh.vertices[mesh.faces[order]].reshape(-1, 3)
        low[parts], high[parts] = (f.reduceat(corners, 3 * first, axis=0) for f in (np.minimum, np.maximum))
    return low, high
