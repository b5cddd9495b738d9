"""The segments a wireframe is made of: the scene's features and one view's contours, side by side."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cadcam.arrays import Ids, Index, Longs, Mask
from cadcam.cad.chains import chained
from cadcam.cad.edges import EdgeKind
from cadcam.render.lines.silhouette import Topology, Turn
from cadcam.render.view import Scene

FLAT = 1e-5  # rad: between faces this close to coplanar there is no contour


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """S segments as arrays.

    `edge` (number in the edge table) and `feature` (in the scene) are -1 where there is none; `away` says whether a
    segment's own faces turn away and hide it.
    """

    vertices: Ids
    kind: Ids
    part: Ids
    chain: Ids
    edge: Ids
    feature: Ids
    away: Mask

    def select(self, which: Index) -> Segments:
        """Return the chosen segments."""
        return Segments(*(getattr(self, f.name)[which] for f in fields(self)))

    def followed_by(self, other: Segments) -> Segments:
        """Return these segments and then the others."""
        return Segments(*(np.concatenate([getattr(s, f.name) for s in (self, other)]) for f in fields(self)))


def features(scene: Scene, edge: Ids, turn: Turn) -> Segments:
    """Return the scene's feature segments, in their order; `edge` (S,) are their numbers in the edge table."""
    lines = scene.edges
    away = np.where(edge >= 0, turn.away[np.maximum(edge, 0)], False)
    feature = np.arange(len(lines), dtype=np.int32)
    return Segments(lines.vertices, lines.kind, lines.part, lines.chain, edge, feature, away)


def contours(scene: Scene, topology: Topology, edge: Ids, turn: Turn, points: Longs) -> Segments:
    """Return this view's silhouette edges that are no features, chained; `points` (V,) numbers coinciding vertices.

    The surface lies on the left of each, as the picture shows it. However a faceted surface makes its contour zigzag in
    space, the contour is one line: of a smooth surface it has no corners.
    """
    table = topology.table
    drawn = np.zeros(len(table.count), bool)
    drawn[edge[edge >= 0]] = True
    found = np.flatnonzero(turn.silhouette & ~drawn & (table.angle > FLAT))
    vertices = table.vertices[found]
    part, away = scene.mesh.part[table.faces[found, 0]], turn.away[found]
    order, turned, chain = _oriented(
        turn.ahead[found], *chained(scene.mesh.vertices[vertices], points[vertices], part, turn_deg=180.0)
    )
    vertices = vertices[order]
    vertices[turned] = vertices[turned][:, ::-1]
    after = int(scene.edges.chain.max(initial=-1)) + 1
    return Segments(
        vertices,
        np.full(len(order), EdgeKind.CONTOUR, np.int32),
        part[order],
        chain + np.int32(after),
        found[order].astype(np.int32),
        np.full(len(order), -1, np.int32),
        away[order],
    )


def _oriented(ahead: Mask, order: Longs, turned: Mask, chain: Ids) -> tuple[Longs, Mask, Ids]:
    """Return chains of segments, as of `chained`, each running as its first segment does that is `ahead` (S,)."""
    first = np.flatnonzero(np.diff(chain, prepend=-1))
    back = (ahead[order] == turned)[first][chain]
    place = np.arange(len(order))
    again = np.lexsort([np.where(back, -place, place), chain])
    return order[again], (turned ^ back)[again], chain[again]
