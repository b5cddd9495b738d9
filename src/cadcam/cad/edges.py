"""Feature edges: the lines of a part that a draughtsman would draw, independent of the camera's pose.

Contours of curved surfaces depend on the view; the renderer finds those and marks them `EdgeKind.CONTOUR`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Ids, Mask, frozen
from cadcam.cad.chains import chained
from cadcam.cad.contact import resolve_contacts
from cadcam.cad.edge_kind import EdgeKind
from cadcam.cad.facets import facet_edges, seam_angle
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import EdgeTable, corner_points, edge_table
from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_flag, expect_number, expect_positive

__all__ = ["NO_EDGES", "EdgeKind", "EdgeTable", "FeatureEdges", "edge_table", "feature_edges"]

# Two surfaces whose normals agree this well along their common edge are tangent.
SMOOTH_SEAM_DEG = 1.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FeatureEdges(Brief):
    """Segments along mesh edges, in chains.

    `vertices` (S, 2) indices into mesh.vertices; `faces` (S, 2) the incident faces, -1 for none; `kind` (S,) of type
    `EdgeKind`; `chain` (S,) number of the polyline, whose segments follow one another in the arrays and are directed
    head to tail; `part` (S,) part of the first face.
    """

    vertices: Ids
    faces: Ids
    kind: Ids
    chain: Ids
    part: Ids

    def __post_init__(self) -> None:
        for name, shape in (("vertices", (None, 2)), ("faces", (None, 2))):
            object.__setattr__(self, name, frozen(getattr(self, name), f"edge {name}", shape, np.int32))
        for name in ("kind", "chain", "part"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"edge {name}", (None,), np.int32))

    def __len__(self) -> int:
        return len(self.kind)

    def select(self, segments: Mask | Ids) -> FeatureEdges:
        """Return the chosen segments; chains keep their numbers."""
        return FeatureEdges(
            self.vertices[segments],
            self.faces[segments],
            self.kind[segments],
            self.chain[segments],
            self.part[segments],
        )

    def repeated(self, mesh: Mesh, times: int) -> FeatureEdges:
        """Return the segments of so many copies of their mesh, merged in order."""
        copy = np.repeat(np.arange(times, dtype=np.int32), len(self))
        faces = np.tile(self.faces, (times, 1))
        return FeatureEdges(
            np.tile(self.vertices, (times, 1)) + copy[:, None] * np.int32(len(mesh.vertices)),
            np.where(faces < 0, -1, faces + copy[:, None] * np.int32(mesh.n_faces)),
            np.tile(self.kind, times),
            np.tile(self.chain, times) + copy * (self.chain.max(initial=-1) + np.int32(1)),
            np.tile(self.part, times) + copy * np.int32(len(mesh.part_names)),
        )

    def of_kind(self, *kinds: EdgeKind) -> FeatureEdges:
        """Return the segments of these kinds only."""
        return self.select(np.isin(self.kind, kinds))

    def lengths(self, mesh: Mesh) -> Array:
        """Return the length (S,) of each segment in mm."""
        a, b = mesh.vertices[self.vertices[:, 0]], mesh.vertices[self.vertices[:, 1]]
        return np.asarray(np.linalg.norm(b - a, axis=1))

    def polylines(self, mesh: Mesh) -> list[Array]:
        """Return one (n, 3) array of points in mm for each chain; a closed chain ends where it began."""
        if not len(self):
            return []
        breaks = np.flatnonzero(np.diff(self.chain)) + 1
        return [mesh.vertices[np.append(run[:, 0], run[-1, 1])] for run in np.split(self.vertices, breaks, axis=0)]


# For scenes whose lines are not drawn: finding edges takes time.
NO_EDGES = FeatureEdges(*(np.zeros((0, 2), np.int32),) * 2, *(np.zeros(0, np.int32),) * 3)


def feature_edges(
    mesh: Mesh,
    *,
    crease_angle_deg: float = 30.0,
    smooth_seams: bool = False,
    flush_seams: bool = False,
    contacts: bool = True,
    contact_tolerance_mm: float | None = None,
) -> FeatureEdges:
    """Return creases, boundaries, contacts of parts and B-rep edges of the mesh, as directed chains.

    Where both faces name their surface, an edge between two surfaces is BREP if the surfaces meet at more than 1
    degree (or `smooth_seams` asks for the tangent ones too), and no edge inside a surface is ever drawn, however coarse
    its facets. Elsewhere an edge is a CREASE above `crease_angle_deg`, unless it is one of a run of equal parallel
    bends that `facet_edges` takes for a rounded surface. An edge with one face is a BOUNDARY; with three or more, a
    CREASE. `contacts` looks for edges that touch another body within `contact_tolerance_mm` (default 1e-5 of the
    diagonal, at most 0.5): they become CONTACT, or vanish where the surface simply continues flat across them (flush
    plates, T-junctions) unless `flush_seams` keeps them. Curves along which bodies pass through each other have no mesh
    edge and are not found. Raises `BadValue` for an angle outside (0, 180) or a tolerance that is no length.
    """
    expect(mesh, "mesh", Mesh)
    expect_number(crease_angle_deg, "crease_angle_deg")
    for name, flag in (("smooth_seams", smooth_seams), ("flush_seams", flush_seams), ("contacts", contacts)):
        expect_flag(flag, name)
    if not 0 < crease_angle_deg < 180:
        raise BadValue("crease_angle_deg", crease_angle_deg, "degrees between 0 and 180")
    if contact_tolerance_mm is not None:
        expect_positive(contact_tolerance_mm, "contact_tolerance_mm", "a number of mm from 0 on", zero=True)
    table = edge_table(mesh)
    kind = _kinds(mesh, table, np.radians(crease_angle_deg), smooth_seams)
    if contacts:
        kind = resolve_contacts(
            mesh,
            table,
            kind,
            crease_angle=np.radians(crease_angle_deg),
            tolerance=contact_tolerance_mm,
            keep_flush=flush_seams,
        )
    return _assemble(mesh, table, kind)


def _kinds(mesh: Mesh, table: EdgeTable, crease_angle: float, smooth_seams: bool) -> Ids:
    """Return the kind (E,) of each edge as far as its own faces tell, -1 for no feature."""
    one, other = mesh.surface[table.faces[:, 0]], mesh.surface[np.maximum(table.faces[:, 1], 0)]
    manifold = table.count == 2
    known = (one >= 0) & (other >= 0) & (table.count > 1)
    kind = np.full(len(table.count), -1, np.int32)
    sharp = manifold & ~known & (table.angle > crease_angle + 1e-3)
    if sharp.any():
        sharp &= ~facet_edges(mesh, table, sharp)
    kind[sharp] = EdgeKind.CREASE
    kind[table.count == 1] = EdgeKind.BOUNDARY
    kind[table.count > 2] = EdgeKind.CREASE
    seam = known & (one != other)
    if seam.any() and not smooth_seams:
        seam[seam] = seam_angle(mesh, table, np.flatnonzero(seam)) > np.radians(SMOOTH_SEAM_DEG)
    kind[seam] = EdgeKind.BREP
    return kind


def _assemble(mesh: Mesh, table: EdgeTable, kind: Ids) -> FeatureEdges:
    """Return the edges that have a kind, chained."""
    chosen = np.flatnonzero(kind >= 0)
    vertices, faces = table.vertices[chosen], table.faces[chosen]
    surfaces = np.sort(np.where(faces < 0, -1, mesh.surface[faces]), axis=1)
    part = mesh.part[faces[:, 0]]
    _, group = np.unique(np.column_stack([part, kind[chosen], surfaces]), axis=0, return_inverse=True)
    points = np.zeros(len(mesh.vertices), np.int64)
    points[mesh.faces.ravel()] = corner_points(mesh).ravel()
    order, flipped, chain = chained(mesh.vertices[vertices], points[vertices], group.ravel())
    vertices = vertices[order]
    vertices[flipped] = vertices[flipped][:, ::-1]
    return FeatureEdges(vertices, faces[order], kind[chosen][order], chain, part[order])
