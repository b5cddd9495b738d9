"""Where the curves of a STEP file are among the edges of the mesh that was made of it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.cad.pmi.faces import Curve

_SHARE = 3e-4  # largest distance between a curve and the mesh's edge, of its size: six times the chords' of a STEP file
_AT_ONCE = 64  # points whose distances to all edges are in memory together


def chains_of(curves: Iterable[Curve], mesh: Mesh, edges: FeatureEdges) -> dict[int, int]:
    """Return the feature chain of each curve that is one, by the curve's number in its file.

    Curves that are no feature edges, where surfaces are tangent or a cylinder closes, have none; nor has what lies on
    several chains.
    """
    named = {curve.number: curve for curve in curves if len(curve.points)}
    if not named or not len(edges):
        return {}
    points = np.concatenate([curve.points for curve in named.values()])
    distance, nearest = _nearest(points, mesh.vertices[edges.vertices])
    chain = np.where(distance < _SHARE * float(np.linalg.norm(mesh.size_mm)), edges.chain[nearest], -1)
    pieces = np.split(chain, np.cumsum([len(curve.points) for curve in named.values()])[:-1])
    return {
        number: int(piece[0])
        for number, piece in zip(named, pieces, strict=True)
        if piece[0] >= 0 and np.ptp(piece) == 0
    }


def _nearest(points: Array, segments: Array) -> tuple[Array, Longs]:
    """Return the distance (n,) of each point (n, 3) to the nearest of segments (m, 2, 3), and which (n,) that is."""
    begin, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
    distance, nearest = np.zeros(len(points)), np.zeros(len(points), np.int64)
    for first in range(0, len(points), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        away = points[some, None] - begin
        at = np.clip(np.einsum("nmi,mi->nm", away, along) / length, 0.0, 1.0)
        squared = ((away - at[..., None] * along) ** 2).sum(axis=2)
        nearest[some] = squared.argmin(axis=1)
        distance[some] = np.sqrt(squared.min(axis=1))
    return distance, nearest
