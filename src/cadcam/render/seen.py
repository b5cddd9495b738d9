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
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.native.seen import seen as _seen
from cadcam.native.seen import seen_lines
from cadcam.render.clip import FlatSegments, Frustum
from cadcam.render.occlusion import solid_parts
from cadcam.render.segments import Segments
from cadcam.render.stretches import Stretches
from cadcam.render.trace import Tracer
from cadcam.render.view import Scene, View
from cadcam.render.wireframe import Longs, Polylines

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
        self._curved, self._beside = table.vertices[smooth], np.ascontiguousarray(table.faces[smooth].T)
        self._faces = np.ascontiguousarray(edges.faces.T)

    def draw(self, view: View) -> Polylines:
        """Return the visible stretches of features and contours, cut at the picture's border.

        `view` holds DEPTH and NORMAL of the scene, and of whatever else may hide it; points `p` are in the scene's
        frame. Contours come edge by edge, each a chain of its own. Raises `MissingCore` without the compiled core.
        """
        camera, pose = view.camera, view.camera_from_world
        segments, kept, lines = self._in_view(self._facing(pose.origin), pose @ self.scene.mesh.vertices, camera)
        found = Tracer(self.scene, camera, segments, kept, lines, _CHORD_PX).polylines(_shown(view, lines))
        return found.select(found.length_px >= _SHORTEST_PX)

    def _in_view(self, every: Segments, p: Array, camera: Camera) -> tuple[Segments, Longs, FlatSegments]:
        """Return the segments that reach into the picture, their numbers, and their images; p (V, 3) camera frame."""
        frustum = Frustum.of(camera, near=self._near, margin_px=0.0)
        first, second = every.vertices[:, 0], every.vertices[:, 1]
        if isinstance(camera.lens, Ideal) and frustum.holds(p):
            w = 1 / p[:, 2]
            u, n = p[:, :2] * w[:, None], len(first)
            lines = FlatSegments(u[first], u[second], w[first], w[second], np.zeros(n), np.ones(n))
            return every, np.arange(n), lines
        a, b = p[first], p[second]
        t0, t1, kept = frustum.clip(a, b)
        return every.select(kept), np.flatnonzero(kept), FlatSegments.of(a[kept], b[kept], t0[kept], t1[kept])

    def _facing(self, eye: Array) -> Segments:
        """Return the features but those whose solid turns both their faces away, and this view's contours."""
        front = self._normals @ eye > self._heights
        edges = self.scene.edges
        kept = np.flatnonzero(front[self._faces[0]] | front[self._faces[1]] | ~self._solid)
        turning = np.flatnonzero(front[self._beside[0]] != front[self._beside[1]])
        contours = self._curved[turning]
        n, none = len(contours), np.full(len(contours), -1, np.int32)
        after = int(edges.chain.max(initial=-1)) + 1
        return Segments(
            vertices=np.concatenate([edges.vertices[kept], contours]),
            kind=np.concatenate([edges.kind[kept], np.full(n, EdgeKind.CONTOUR, np.int32)]),
            part=np.concatenate([edges.part[kept], self.scene.mesh.part[self._beside[0][turning]]]),
            chain=np.concatenate([edges.chain[kept], np.arange(after, after + n, dtype=np.int32)]),
            edge=np.concatenate([none, np.full(len(kept), -1, np.int32)]),
            feature=np.concatenate([kept.astype(np.int32), none]),
            away=np.zeros(len(kept) + n, bool),
        )


def _shown(view: View, lines: FlatSegments) -> Stretches:
    """Return the stretches of the lines that the view shows: runs of samples a pixel apart, each for its share."""
    ends = [_pixels(view.camera, u) for u in (lines.a, lines.b)]
    n = np.maximum(np.ceil(np.hypot(*(ends[1] - ends[0]).T) / _STEP_PX), 1).astype(np.int64)
    line = np.repeat(np.arange(len(n)), n)
    shown = _shown_samples(view, lines, n, line)
    another = line[1:] != line[:-1]
    first = np.flatnonzero(shown & np.append(True, ~shown[:-1] | another)[: len(shown)])
    last = np.flatnonzero(shown & np.append(~shown[1:] | another, True)[: len(shown)])
    before = (np.cumsum(n) - n)[line[first]]
    return Stretches(line[first], (first - before) / n[line[first]], (last + 1 - before) / n[line[first]])


def _shown_samples(view: View, lines: FlatSegments, n: Longs, line: Longs) -> Mask:
    """Return which samples the view shows: n (N,) of them on each line, in the middles of its shares."""
    camera = view.camera
    how = {"slack": _SLACK_PX / min(camera.fx, camera.fy), "steepest": _STEEPEST}
    if isinstance(camera.lens, Ideal):
        return seen_lines(view.depth, view.normal, camera.K[:2], (lines.a, lines.b, lines.wa, lines.wb), n, **how)
    s = (np.arange(len(line)) - (np.cumsum(n) - n)[line] + 0.5) / n[line]
    u = lines.a[line] + s[:, None] * (lines.b - lines.a)[line]
    z = 1 / (lines.wa[line] + s * (lines.wb - lines.wa)[line])
    return seen_points(view, np.column_stack([u * z[:, None], z]), _pixels(camera, u))


def _pixels(camera: Camera, u: Array) -> Array:
    """Return the pixels of points u (N, 2) of the plane (x, y)/z."""
    return camera.project(np.column_stack([u, np.ones(len(u))]))


def _among(edges: Ids, chosen: Ids, vertices: Array) -> Mask:
    """Return which edges (E, 2) are among the chosen ones (S, 2), either way round."""
    of = np.array([len(vertices), 1], np.int64)
    return np.isin(np.sort(edges, axis=1).astype(np.int64) @ of, np.sort(chosen, axis=1).astype(np.int64) @ of)
