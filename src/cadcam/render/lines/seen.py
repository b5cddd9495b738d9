"""The edges and points that a rendered view shows, by the view's own depth: as fast as the picture, and consistent.

`visible` decides in space, to rounding; here the view decides, whose depth and normals are exact at pixel centres. A
point counts as seen if at one of the four pixel centres around it no surface is in front: the face seen there is
continued, as a plane, to the point's own ray, and may lie in front of the point by what half a pixel spans. So visible
stretches end to within a pixel, an edge thinner than that is seen where its surroundings are not in front, and whatever
else was rendered into the view's depth hides edges as it hides pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask
from cadcam.cad.edges import EdgeKind, edge_table
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import corner_points, is_solid, same_rows
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.native.seen import ALWAYS, FACING, TURNING, DepthView, EdgesInSpace, EyePoint, SeenLines
from cadcam.render.lines.clip import FlatSegments, ViewVolume
from cadcam.render.lines.occlusion import solid_parts
from cadcam.render.lines.segments import FLAT, Segments
from cadcam.render.lines.stretches import Stretches
from cadcam.render.lines.trace import Tracer
from cadcam.render.lines.wireframe import Polylines
from cadcam.render.view import Scene, View

_SLACK_PX = 0.5  # pixel widths by which a surface may lie in front of a point and not hide it
_STEEPEST = 0.5  # a face's plane is continued by at most this share of its depth
_STEP_PX = 1.0
_SHORTEST_PX = 1.5  # shorter stretches are chance
_NEAR = 1e-5  # of the scene's diagonal
_CHORD_PX = 0.02  # largest distance of a line from those of its points that are left out
_SAME_PLANE = 1e-9  # of a normal's length, and of the largest distance of a plane from the origin


def seen_points(view: View, p: Array, q: Array) -> Mask:
    """Return which points (N,) the view shows: p (N, 3) mm in the camera frame, q (N, 2) their pixels.

    The view holds DEPTH and NORMAL. False outside the picture. Raises `MissingCore` without the compiled core.
    """
    return _depth_view(view).points(p, q)


@dataclass(frozen=True, slots=True, eq=False)
class Drawable:
    """The edges of a scene that some view may show: segments, the planes (S, 2) of their faces, a rule (S,) for each.

    Features come first, then the edges that may be contours, each a chain of its own. A feature of a solid is seen only
    where one of its faces is turned to the eye (FACING), a contour where only one is (TURNING). planes (P, 4): normal
    and offset; n x + d > 0 in front of it. solid: whether the whole mesh is.
    """

    segments: Segments
    sides: Ids
    rule: npt.NDArray[np.uint8]
    planes: Array
    solid: bool

    def wanted(self, front: Mask) -> Mask:
        """Return which of them may be visible to an eye in front of these planes (P,), as in native/seen.c."""
        one, other = front[self.sides[:, 0]], front[self.sides[:, 1]]
        return np.asarray(np.where(self.rule == TURNING, one ^ other, one | other | (self.rule == ALWAYS)))


def drawable_edges(scene: Scene) -> Drawable:
    """Return the features of a scene and the edges that may be contours."""
    mesh, edges = scene.mesh, scene.edges
    points = corner_points(mesh)
    table = edge_table(mesh, points)
    solid = solid_parts(mesh, table)[edges.part] & (edges.faces[:, 1] >= 0)
    smooth = (table.count == 2) & (table.angle > FLAT) & ~_among(table.vertices, edges.vertices, mesh.vertices)
    faces, n = table.faces[smooth], int(smooth.sum())
    none, after = np.full(n, -1, np.int32), int(edges.chain.max(initial=-1)) + 1
    segments = Segments(
        vertices=np.concatenate([edges.vertices, table.vertices[smooth]]),
        kind=np.concatenate([edges.kind, np.full(n, EdgeKind.CONTOUR, np.int32)]),
        part=np.concatenate([edges.part, mesh.part[faces[:, 0]]]),
        chain=np.concatenate([edges.chain, np.arange(after, after + n, dtype=np.int32)]),
        edge=np.full(len(edges) + n, -1, np.int32),
        feature=np.concatenate([np.arange(len(edges), dtype=np.int32), none]),
        away=np.zeros(len(edges) + n, bool),
    )
    rule = np.concatenate([np.where(solid, FACING, ALWAYS), np.full(n, TURNING)]).astype(np.uint8)
    planes, plane_of = _planes(mesh)
    sides = plane_of[np.concatenate([edges.faces, faces])]
    return Drawable(segments, sides, rule, planes, is_solid(mesh, points))


def _planes(mesh: Mesh) -> tuple[Array, Ids]:
    """Return the distinct planes (P, 4) of the faces of a mesh, and the plane (F,) of each face."""
    normals = mesh.face_normals
    offset = -np.einsum("ij,ij->i", normals, mesh.vertices[mesh.faces[:, 0]])
    planes = np.column_stack([normals, offset])
    size = np.append(np.ones(3), max(float(np.abs(offset).max(initial=0.0)), 1.0))
    first = same_rows(np.rint(planes / (_SAME_PLANE * size)), np.zeros(len(planes), np.int64))
    kept = first == np.arange(len(planes))
    return planes[kept], (np.cumsum(kept) - 1)[first].astype(np.int32)


class SeenEdges:
    """Finds the scene's edges in its views: what does not depend on the view is computed once.

    drawable: the result of `drawable_edges` for the scene, if already known.
    """

    def __init__(self, scene: Scene, drawable: Drawable | None = None) -> None:
        mesh = scene.mesh
        self.scene: Scene = scene
        self._drawable = drawable or drawable_edges(scene)
        low, high = mesh.bounds
        self._near = _NEAR * float(np.linalg.norm(high - low))
        every = self._drawable
        ends = mesh.vertices[every.segments.vertices]
        self._edges = EdgesInSpace(ends, every.sides, every.segments.chain, every.rule)

    def draw(self, view: View) -> Polylines:
        """Return the visible stretches of features and contours, cut at the picture's border.

        `view` holds DEPTH and NORMAL of the scene, and of whatever else may hide it; points `p` are in the scene's
        frame. Contours are given edge by edge, each a chain of its own. Raises `MissingCore` without the compiled core.
        """
        return self._walked(view) if isinstance(view.camera.lens, Ideal) else self._traced(view)

    def stretches(self, view: View, *, shortest_px: float, bend_px: float) -> SeenLines:
        """Return the visible stretches of `drawable_edges` for cameras without distortion.

        `draw`, of such a camera, as plain arrays: `edge` are indices of drawable edges.
        """
        eye = EyePoint(view.camera_from_world.matrix[:3], view.camera.K[:2], self._near)
        lengths = {"step": _STEP_PX, "shortest": shortest_px, "bend": bend_px}
        return self._edges.seen(_depth_view(view), eye, self._front(view), **lengths)

    def _front(self, view: View) -> Mask:
        """Return which planes the camera is in front of."""
        eye = np.append(view.camera_from_world.origin, 1.0)
        return np.asarray(np.einsum("ij,j->i", self._drawable.planes, eye) > 0)  # BLAS would start threads for it

    def _walked(self, view: View) -> Polylines:
        """Return the stretches that the core traces along straight edges."""
        found = self.stretches(view, shortest_px=_SHORTEST_PX, bend_px=_CHORD_PX)
        every, first = self._drawable.segments, found.edge[found.start[:-1]]
        of_line = (every.kind[first], every.part[first], every.chain[first])
        return Polylines(found.q, found.p, every.feature[found.edge], found.start, *of_line)

    def _traced(self, view: View) -> Polylines:
        """Return the stretches as bent by the camera's lens."""
        every = self._drawable.segments
        number = np.flatnonzero(self._drawable.wanted(self._front(view)))
        p = view.camera_from_world @ self.scene.mesh.vertices
        a, b = (p[every.vertices[number, k]] for k in range(2))
        t0, t1, kept = ViewVolume.of(view.camera, near=self._near, margin_px=0.0).clip(a, b)
        lines = FlatSegments.of(a[kept], b[kept], t0[kept], t1[kept])
        number = number[kept]
        tracer = Tracer(self.scene, view.camera, every.select(number), number, lines, _CHORD_PX)
        found = tracer.polylines(_shown(view, lines))
        return found.select(found.length_px >= _SHORTEST_PX)


def _depth_view(view: View) -> DepthView:
    pixel = (1 / view.camera.fx, 1 / view.camera.fy)
    return DepthView(view.depth, view.normal, pixel, slack=_SLACK_PX * max(pixel), steepest=_STEEPEST)


def _shown(view: View, lines: FlatSegments) -> Stretches:
    """Return the visible stretches of the lines: runs of samples a pixel apart, each for its share."""
    ends = [_pixels(view.camera, u) for u in (lines.a, lines.b)]
    n = np.maximum(np.ceil(np.hypot(*(ends[1] - ends[0]).T) / _STEP_PX), 1).astype(np.int64)
    line = np.repeat(np.arange(len(n)), n)
    s = (np.arange(len(line)) - (np.cumsum(n) - n)[line] + 0.5) / n[line]
    u = lines.a[line] + s[:, None] * (lines.b - lines.a)[line]
    z = 1 / (lines.wa[line] + s * (lines.wb - lines.wa)[line])
    shown = seen_points(view, np.column_stack([u * z[:, None], z]), _pixels(view.camera, u))
    another = line[1:] != line[:-1]
    first = np.flatnonzero(shown & np.append(True, ~shown[:-1] | another)[: len(shown)])
    last = np.flatnonzero(shown & np.append(~shown[1:] | another, True)[: len(shown)])
    before = (np.cumsum(n) - n)[line[first]]
    return Stretches(line[first], (first - before) / n[line[first]], (last + 1 - before) / n[line[first]])


def _pixels(camera: Camera, u: Array) -> Array:
    """Return the pixels of points u (N, 2) of the plane (x, y)/z."""
    return camera.project(np.column_stack([u, np.ones(len(u))]))


def _among(edges: Ids, chosen: Ids, vertices: Array) -> Mask:
    """Return which edges (E, 2) are among the chosen ones (S, 2), either way round."""
    of = np.array([len(vertices), 1], np.int64)
    return np.isin(np.sort(edges, axis=1).astype(np.int64) @ of, np.sort(chosen, axis=1).astype(np.int64) @ of)
