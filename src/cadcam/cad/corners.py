"""Corners of a part: the points of its CAD model that a person can find again in a photo."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import weld

_BEND_DEG = 40.0  # between two edges, from which they meet in a corner: rims of holes have less from segment to segment
_ALIKE = 1 / 50  # of unit vectors: edges of bodies in contact that run along each other are one
_LEAST = 8  # segments of a circle
_ROUND = 0.02  # of its radius: how far its points may be off, which rounded coordinates and seams are


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


def rim_centers(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return the middles (N, 3) mm of round holes and pins: the centre of each closed edge that is a circle."""
    centres = [
        _centre(line) for line in edges.polylines(mesh) if len(line) > _LEAST and np.array_equal(line[0], line[-1])
    ]
    found = np.array([c for c in centres if c is not None]).reshape(-1, 3)
    return found[np.unique(weld(found, np.zeros(len(found), np.int64)))] if len(found) else found


def _centre(line: Array) -> Array | None:
    """Return the centre (3,) of the circle through a closed line's points (n, 3); None where they lie on none."""
    middle = line[1:].mean(axis=0)
    p = line[1:] - middle
    plane = np.linalg.svd(p, full_matrices=False)[2][:2]
    q = p @ plane.T
    found = np.linalg.lstsq(np.column_stack([2 * q, np.ones(len(q))]), np.sum(q * q, axis=1), rcond=None)[0]
    radius = np.linalg.norm(q - found[:2], axis=1)
    out_of_plane = np.linalg.norm(p - q @ plane, axis=1)
    if max(np.ptp(radius), out_of_plane.max()) > _ROUND * radius.mean():
        return None
    return np.asarray(middle + found[:2] @ plane)
