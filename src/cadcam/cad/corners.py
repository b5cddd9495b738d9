"""Corners of a part: the points of its CAD model that a person can find again in a photo."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import weld

_BEND_DEG = 40.0  # between two edges, from which they meet in a corner: rims of holes have less from segment to segment
_ALIKE = 1 / 50  # of unit vectors: edges of bodies in contact that run along each other are one


def corner_vertices(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return the points (N, 3) mm where edges end, three or more meet, or two meet at an angle."""
    ends = edges.vertices.ravel()
    if not len(ends):
        return np.zeros((0, 3))
    points = mesh.vertices[ends]
    along = np.repeat(points[1::2] - points[::2], 2, axis=0)
    along[1::2] *= -1
    length = np.linalg.norm(along, axis=1)
    number = weld(points, np.zeros(len(points), np.int64))
    whole = length > 0
    way = along[whole] / length[whole, None]
    rows = np.column_stack([number[whole], np.rint(way / _ALIKE).astype(np.int64)])
    _, first = np.unique(rows, axis=0, return_index=True)
    at, way = number[whole][first], way[first]
    count = np.bincount(at, minlength=number.max() + 1)
    total = np.column_stack([np.bincount(at, way[:, k], minlength=len(count)) for k in range(3)])
    bent = np.linalg.norm(total, axis=1) > 2 * np.sin(np.radians(_BEND_DEG) / 2)
    kept = (count > 2) | (count == 1) | ((count == 2) & bent)
    place = np.zeros(len(count), np.int64)
    place[number] = ends
    return np.asarray(mesh.vertices[place[kept]])
