"""How far the curved surface that facets stand for may lie beyond them."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import EdgeTable

_OF_HEIGHTS = 1 / 9  # see `bulges`


def bulges(mesh: Mesh, table: EdgeTable, smooth: Mask) -> Array:
    """Return how far (P,) mm each body's smooth surface bulges over the middle of its facets; 0 of one without.

    smooth (E,): the edges of the table that are not of the body but of its facets. A quadratic surface through the
    corners of a facet, whose smooth edges bend by a_i and lie across its heights h_i, is the sum of a_i h_i / 9 above
    its middle: e^2 / 6R on a ball of radius R with equal sides e, w^2 / 9R on a cylinder in strips of width w. The mean
    over all facets, by how likely their edges are on a contour: each by its length and how much it bends.
    """
    edge = np.flatnonzero(smooth & (table.count == 2))
    faces, angle = table.faces[edge], table.angle[edge]
    a, b = (mesh.vertices[table.vertices[edge, k]] for k in range(2))
    length = np.maximum(np.linalg.norm(b - a, axis=1), 1e-300)
    height = 2 * mesh.face_areas[faces] / length[:, None]
    over = np.bincount(faces.ravel(), (angle[:, None] * height).ravel(), mesh.n_faces) * _OF_HEIGHTS
    likely, body, n = length * angle, mesh.part[faces[:, 0]], len(mesh.part_names)
    seen = np.bincount(body, likely, n)
    return np.asarray(np.bincount(body, likely * over[faces].mean(axis=1), n) / np.maximum(seen, 1e-300))
