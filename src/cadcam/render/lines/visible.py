"""The visible wireframe: feature edges and contours as the camera sees them, hidden parts removed in object space.

Visibility is decided exactly, for a picture of any size. Straight edges are straight in the plane u = (x, y)/z. Along
an edge, visibility can only change where, in that plane, it passes behind a border of some surface (a silhouette edge,
or one that does not join exactly two faces), or where in space it passes through a face. All those places are computed
in float64 and cut the edge into stretches of constant visibility; one point of each stretch is then tested in space. So
nothing is sampled, and the ends of visible lines are exact to rounding.

The definition of visible. A point of an edge is hidden if a face meets the open segment to the camera's centre while
the point lies more than a tolerance off that face's plane (`occlusion.OccludingFaces`). Hence:

- the edge's own faces never hide it, nor do faces that coincide with it: the foot of a stiffener on a plate, coplanar
  overlaps, T-junctions. A sheet without thickness does not hide lines lying in it from either side.
- an edge of a watertight part is hidden if its own faces turn away: both of them at a convex edge, either of them at a
  concave one. There the sight line starts inside the material; deciding it by the two faces needs no tolerance. It is
  not applied to open sheets, nor to a part whose material holds the camera.
- contours of convex and saddle-shaped regions follow the same rule: outer ones are convex edges, inner ones concave.
- parts that pass through each other hide one another from where they cross; the line of crossing itself is not drawn.

The tolerance is 1e-6 of the scene's diagonal, ten times what Embree's float32 can resolve there; for contact edges, as
wide as the one by which contacts are found.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.bulges import bulges
from cadcam.cad.contact import contact_tolerance
from cadcam.cad.edges import EdgeKind
from cadcam.cad.topology import corner_points
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect
from cadcam.render.caster import Caster
from cadcam.render.lines.clip import FlatSegments, ViewVolume
from cadcam.render.lines.crossing import crossings
from cadcam.render.lines.moved import MovedFaces
from cadcam.render.lines.occlusion import OccludingFaces
from cadcam.render.lines.segments import FLAT, Segments, contours, features
from cadcam.render.lines.silhouette import Topology, Turn
from cadcam.render.lines.stretches import Stretches
from cadcam.render.lines.trace import Tracer
from cadcam.render.lines.wireframe import NO_LINES, PLAIN_LINES, LineOptions, Wireframe
from cadcam.render.view import Scene, nothing_in_view

COINCIDENT_SHARE = 1e-6  # of the scene's diagonal
_BEND = np.radians(30.0)  # largest bend between facets of a curved surface


def visible_wireframe(
    scene: Scene, camera: Camera, camera_from_world: Rigid, *, options: LineOptions = PLAIN_LINES
) -> Wireframe:
    """Return the visible wireframe of one view. Raises `NothingInView`, with the numbers, if none is in the picture.

    `MissingCore` without the compiled core. For many views of a scene use one `LineDrawer`.
    """
    expect(scene, "scene", Scene)
    expect(camera, "camera", Camera)
    expect_motion(camera_from_world, "camera_from_world")
    expect(options, "options", LineOptions)
    wireframe = LineDrawer(scene).draw(camera, camera_from_world, options=options)
    if wireframe.empty:
        raise nothing_in_view(scene.mesh, camera, camera_from_world)
    return wireframe


def edge_points(scene: Scene, camera: Camera, camera_from_world: Rigid, *, apart_px: float) -> Array:
    """Return points (n, 2) px along all feature edges in the picture, hidden ones too, at most that far apart."""
    near = 1e-5 * float(np.linalg.norm(scene.mesh.size_mm))
    clipped = _Clipped(camera_from_world @ scene.mesh.vertices, ViewVolume.of(camera, near=near, margin_px=apart_px))
    lines, _ = clipped.segments(scene.edges.vertices)
    first, last = (camera.project(np.column_stack([u, np.ones(len(u))])) for u in (lines.a, lines.b))
    n = 1 + np.ceil(np.nan_to_num(np.hypot(*(last - first).T)) / apart_px).astype(np.int64)
    line = np.repeat(np.arange(len(n)), n)
    s = (np.arange(len(line)) - np.repeat(np.cumsum(n) - n, n)) / np.maximum(n - 1, 1)[line]
    u = lines.a[line] + s[:, None] * (lines.b - lines.a)[line]
    return camera.project(np.column_stack([u, np.ones(len(u))]))


class LineDrawer:
    """Draws wireframes of a scene: what does not depend on the view is computed once.

    like: a drawer of the same scene before its parts were moved as wholes, none sharing a vertex with another, from
    which all is taken over that stays.
    """

    def __init__(self, scene: Scene, *, caster: Caster | None = None, like: LineDrawer | None = None) -> None:
        mesh = scene.mesh
        self.scene = scene
        if like is None:
            self._topology = Topology(mesh)
            self._edge = self._topology.number_of(scene.edges.vertices)
            self._points = np.zeros(len(mesh.vertices), np.int64)
            self._points[mesh.faces.ravel()] = corner_points(mesh).ravel()
        else:
            self._topology, self._edge, self._points = like._topology.moved(mesh), like._edge, like._points
        if like is None or not np.array_equal(self._topology.bounds, like._topology.bounds):
            caster = caster or Caster(mesh)
            self._diagonal, self._contact = 2 * caster.radius, contact_tolerance(mesh)
            self._occluders = OccludingFaces(mesh, caster)
            a, b = (mesh.vertices[self._topology.table.vertices[:, k]] for k in range(2))
            self._pierced = self._occluders.piercings(a, b, COINCIDENT_SHARE * self._diagonal)
        else:
            self._diagonal, self._contact = like._diagonal, like._contact
            moved = self._occluders = MovedFaces(like._occluders, like._topology, self._topology)
            self._pierced = moved.pierced_again(self._topology, like._pierced, COINCIDENT_SHARE * self._diagonal)

    def draw(self, camera: Camera, camera_from_world: Rigid, *, options: LineOptions = PLAIN_LINES) -> Wireframe:
        """Return the wireframe seen from `camera_from_world`; empty where the model is not in view."""
        near = 1e-5 * self._diagonal if options.near_mm is None else options.near_mm
        frustum = ViewVolume.of(camera, near=near, margin_px=options.margin_px)
        clipped = _Clipped(camera_from_world @ self.scene.mesh.vertices, frustum)
        turn = Turn(self._topology, self._occluders, camera_from_world.origin)
        every = self._segments(turn, options)
        asked = np.arange(len(every.edge)) if options.hidden else np.flatnonzero(~every.away)
        lines, kept = clipped.segments(every.vertices[asked])
        source = asked[kept]
        segments = every.select(source)
        borders, _ = clipped.segments(self._topology.table.vertices[turn.borders])
        stretches = Stretches.between(*self._cuts(segments, lines, borders), lines)
        hidden = self._hidden(segments, lines, stretches, camera_from_world.origin, options)
        trace = Tracer(self.scene, camera, segments, source, lines, options.chord_px)
        unseen = trace.polylines(stretches.merged(hidden, True)) if options.hidden else NO_LINES
        return Wireframe(camera, camera_from_world, trace.polylines(stretches.merged(hidden, False)), unseen)

    @cached_property
    def bulges(self) -> Array:
        """How far (P,) mm each body's curved surfaces may bulge over their facets, and its contours lie beyond."""
        table = self._topology.table
        smooth = (table.angle > FLAT) & (table.angle < _BEND)
        smooth[self._edge[self._edge >= 0]] = False
        return bulges(self.scene.mesh, table, smooth)

    def _segments(self, turn: Turn, options: LineOptions) -> Segments:
        """Return the feature segments and, if requested, this view's contours."""
        own = features(self.scene, self._edge, turn)
        if not options.contours:
            return own
        return own.followed_by(contours(self.scene, self._topology, self._edge, turn, self._points))

    def _cuts(self, segments: Segments, lines: FlatSegments, borders: FlatSegments) -> tuple[Longs, Array]:
        """Return (line, fraction of its image) of all places where its visibility may change."""
        facing = np.flatnonzero(~segments.away)
        slack = 2 * COINCIDENT_SHARE * self._diagonal * np.maximum(borders.wa, borders.wb)
        index, s = crossings(lines.select(facing), borders, slack=slack)
        pierced, at = self._piercings(segments, lines)
        return np.concatenate([facing[index], pierced]), np.concatenate([s, at])

    def _piercings(self, segments: Segments, lines: FlatSegments) -> tuple[Longs, Array]:
        """Return (line, fraction of its image) where the lines pass through faces."""
        edge, t = self._pierced
        first, last = (np.searchsorted(edge, segments.edge, side) for side in ("left", "right"))
        n = last - first
        line = np.repeat(np.arange(len(n)), n)
        t = t[np.repeat(first - (np.cumsum(n) - n), n) + np.arange(len(line))]
        turned = segments.vertices[:, 0] != self._topology.table.vertices[segments.edge, 0]
        t = np.where(turned[line], 1 - t, t)
        inside = (t > lines.t0[line]) & (t < lines.t1[line])
        return line[inside], lines.in_image(line[inside], t[inside])

    def _hidden(
        self, segments: Segments, lines: FlatSegments, stretches: Stretches, eye: Array, options: LineOptions
    ) -> Mask:
        """Return which stretches are hidden, decided at the middle of each."""
        hidden = segments.away[stretches.line]
        asked = np.flatnonzero(~hidden)
        line = stretches.line[asked]
        a, b = (self.scene.mesh.vertices[segments.vertices[line, k]] for k in range(2))
        points = a + stretches.middle(lines)[asked, None] * (b - a)
        hidden[asked] = self._occluders.hidden(points, eye, self._tolerance(segments.kind, options)[line])
        return hidden

    def _tolerance(self, kind: Ids, options: LineOptions) -> Array:
        """Return for each segment the distance (mm) of a face's plane within which it does not hide it."""
        plain = COINCIDENT_SHARE * self._diagonal if options.coincident_mm is None else options.coincident_mm
        contact = max(plain, self._contact)
        return np.where(kind == EdgeKind.CONTACT, contact, plain)


class _Clipped:
    """Points p (V, 3) mm of the camera frame, and the parts of segments between them within a frustum."""

    def __init__(self, p: Array, frustum: ViewVolume) -> None:
        self._p, self._frustum = p, frustum
        self._inside = frustum.holds(p)

    def segments(self, vertices: Ids) -> tuple[FlatSegments, Mask]:
        """Return the images of segments (N, 2), and the indices of those in the frustum."""
        if self._inside:
            return FlatSegments.whole(self._p, vertices), np.ones(len(vertices), bool)
        a, b = self._p[vertices[:, 0]], self._p[vertices[:, 1]]
        t0, t1, kept = self._frustum.clip(a, b)
        return FlatSegments.of(a[kept], b[kept], t0[kept], t1[kept]), kept
