"""The edges and points that a rendered view shows, by the view's own depth: as quick as the picture, and one with it.

`visible` decides in space, to rounding; here the view decides, whose depth and normals are exact at pixel centres. A
point counts as seen if at one of the four pixel centres around it no surface stands in front: the face seen there is
continued, as a plane, to the point's own ray, and may lie in front of it by what half a pixel spans. So visible
stretches end to within a pixel, an edge thinner than that is seen where it borders on anything that is not in front,
and whatever else was rendered into the view's depth hides edges as it hides pixels.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.cad.edges import EdgeKind, edge_table
from cadcam.native.seen import seen as _seen
from cadcam.render.clip import FlatSegments, Frustum
from cadcam.render.occlusion import solid_parts
from cadcam.render.segments import Segments
from cadcam.render.stretches import Stretches
from cadcam.render.trace import Tracer
from cadcam.render.view import Scene, View
from cadcam.render.wireframe import Polylines

_SLACK_PX = 0.5  # by how much of a pixel's width a surface may stand in front of a point and not hide it
_STEEPEST = 0.5  # a face's plane is continued by at most this share of its depth
_STEP_PX = 1.0
_SHORTEST_PX = 1.5  # stretches below it are chance
_NEAR = 1e-5  # of the scene's diagonal
_FLAT = 1e-5  # rad: between faces this close to coplanar there is no contour
_CHORD_PX = 0.02


def seen_points(view: View, p: Array, q: Array) -> Mask:
    """Return which points (N,) the view shows: p (N, 3) mm in the camera frame, q (N, 2) their pixels.

    The view holds DEPTH and NORMAL. False outside the picture. Raises `MissingCore` without the compiled core.
    """
    focal = (view.camera.fx, view.camera.fy)
    slack = _SLACK_PX / min(focal)
    return _seen(view.depth, view.normal, focal, p, q, slack=slack, steepest=_STEEPEST)


class SeenEdges:
    """Labels views of one scene with its edges: what does not depend on the view is computed once."""

    def __init__(self, scene: Scene) -> None:
        mesh, edges = scene.mesh, scene.edges
        self.scene = scene
        low, high = mesh.bounds
        self._near = _NEAR * float(np.linalg.norm(high - low))
        self._normals = mesh.face_normals
        self._heights = np.einsum("ij,ij->i", self._normals, mesh.vertices[mesh.faces[:, 0]])
        table = edge_table(mesh)
        self._solid = solid_parts(mesh, table)[edges.part] & (edges.faces[:, 1] >= 0)
        smooth = (table.count == 2) & (table.angle > _FLAT) & ~_among(table.vertices, edges.vertices, mesh.vertices)
        self._curved, self._beside = table.vertices[smooth], table.faces[smooth]

    def draw(self, view: View) -> Polylines:
        """Return the visible stretches of features and contours, cut at the picture's border.

        `view` holds DEPTH and NORMAL of the scene, and of whatever else may hide it; points `p` are in the scene's
        frame. Contours come edge by edge, each a chain of its own. Raises `MissingCore` without the compiled core.
        """
        camera, pose = view.camera, view.camera_from_world
        every = self._facing(pose.origin)
        p = pose @ self.scene.mesh.vertices
        a, b = p[every.vertices[:, 0]], p[every.vertices[:, 1]]
        t0, t1, kept = Frustum.of(camera, near=self._near, margin_px=0.0).clip(a, b)
        segments, lines = every.select(kept), FlatSegments.of(a[kept], b[kept], t0[kept], t1[kept])
        trace = Tracer(self.scene, camera, segments, np.flatnonzero(kept), lines, _CHORD_PX)
        found = trace.polylines(_shown(view, lines))
        return found.select(found.length_px >= _SHORTEST_PX)

    def _facing(self, eye: Array) -> Segments:
        """Return the features but those whose solid turns both their faces away, and this view's contours."""
        front = self._normals @ eye > self._heights
        edges = self.scene.edges
        kept = np.flatnonzero(front[edges.faces].any(axis=1) | ~self._solid)
        turning = front[self._beside[:, 0]] != front[self._beside[:, 1]]
        contours = self._curved[turning]
        n, none = len(contours), np.full(len(contours), -1, np.int32)
        after = int(edges.chain.max(initial=-1)) + 1
        return Segments(
            vertices=np.concatenate([edges.vertices[kept], contours]),
            kind=np.concatenate([edges.kind[kept], np.full(n, EdgeKind.CONTOUR, np.int32)]),
            part=np.concatenate([edges.part[kept], self.scene.mesh.part[self._beside[turning, 0]]]),
            chain=np.concatenate([edges.chain[kept], np.arange(after, after + n, dtype=np.int32)]),
            edge=np.concatenate([none, np.full(len(kept), -1, np.int32)]),
            feature=np.concatenate([kept.astype(np.int32), none]),
            away=np.zeros(len(kept) + n, bool),
        )


def _shown(view: View, lines: FlatSegments) -> Stretches:
    """Return the stretches of the lines that the view shows: runs of samples a pixel apart, each for its share."""
    camera = view.camera
    ends = [camera.project(np.column_stack([u, np.ones(len(u))])) for u in (lines.a, lines.b)]
    n = np.maximum(np.ceil(np.linalg.norm(ends[1] - ends[0], axis=1) / _STEP_PX), 1).astype(np.int64)
    line = np.repeat(np.arange(len(n)), n)
    step = np.arange(len(line)) - (np.cumsum(n) - n)[line]
    s = (step + 0.5) / n[line]
    u = lines.a[line] + s[:, None] * (lines.b - lines.a)[line]
    z = 1 / (lines.wa[line] + s * (lines.wb - lines.wa)[line])
    ray = np.column_stack([u, np.ones(len(u))])
    shown = seen_points(view, ray * z[:, None], camera.project(ray))
    begins = shown & np.append(True, ~shown[:-1] | (line[1:] != line[:-1]))
    ends_here = shown & np.append(~shown[1:] | (line[1:] != line[:-1]), True)
    first, last = np.flatnonzero(begins), np.flatnonzero(ends_here)
    return Stretches(line[first], step[first] / n[line[first]], (step[last] + 1) / n[line[last]])


def _among(edges: Ids, chosen: Ids, vertices: Array) -> Mask:
    """Return which edges (E, 2) are among the chosen ones (S, 2), either way round."""
    of = np.array([len(vertices), 1], np.int64)
    return np.isin(np.sort(edges, axis=1).astype(np.int64) @ of, np.sort(chosen, axis=1).astype(np.int64) @ of)
