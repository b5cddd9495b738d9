"""Rims of holes and pins: circles among the feature edges, also where a file draws each as several arcs.

STEP files have a hole as two half cylinders: its rim is two edges, of different faces, and two chains.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.cad.chains import chain_of_each
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import weld

_LEAST = 8  # segments of a circle
_ROUND = 0.02  # of its radius: how far its points may be off, which rounded coordinates and seams are


def rim_centers(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return the middles (N, 3) mm of round holes and pins: the centre of each closed line that is a circle."""
    points, number, lines = _smooth_lines(mesh, edges)
    closed = (line for line in lines if (np.unique(number[line], return_counts=True)[1] == 2).all())
    centres = [_centre(points[line].reshape(-1, 3)) for line in closed if len(line) >= _LEAST]
    found = np.array([c for c in centres if c is not None]).reshape(-1, 3)
    return found[np.unique(weld(found, np.zeros(len(found), np.int64)))] if len(found) else found


def rim_of_chains(mesh: Mesh, edges: FeatureEdges) -> Longs:
    """Return the rim (C,) that each chain is of: arcs of one circle, end to end, have the first one's number.

    Every other chain has its own. Arcs of different parts are never one rim.
    """
    rim = np.arange(edges.chain.max(initial=-1) + 1, dtype=np.int64)
    points, _, lines = _smooth_lines(mesh, edges)
    for line in lines:
        chains = edges.chain[line]
        if np.ptp(chains) and _centre(points[line].reshape(-1, 3)) is not None:
            rim[chains] = chains.min()
    return rim


def _smooth_lines(mesh: Mesh, edges: FeatureEdges) -> tuple[Array, Longs, Iterator[Longs]]:
    """Return the ends (S, 2, 3) mm of segments, the numbers (S, 2) of their points, and the segments of each line.

    A line runs on across the borders of surfaces, as a chain does not.
    """
    ends = mesh.vertices[edges.vertices]
    number = weld(ends.reshape(-1, 3), np.repeat(edges.part, 2).astype(np.int64)).reshape(-1, 2)
    line = chain_of_each(ends, number, edges.part)
    order = np.argsort(line, kind="stable")
    breaks = np.flatnonzero(np.diff(line[order])) + 1
    return ends, number, iter(np.split(order, breaks) if len(order) else ())


def _centre(points: Array) -> Array | None:
    """Return the centre (3,) of the circle through points (n, 3); None where they lie on none."""
    middle = points.mean(axis=0)
    p = points - middle
    plane = np.linalg.svd(p, full_matrices=False)[2][:2]
    q = p @ plane.T
    found = np.linalg.lstsq(np.column_stack([2 * q, np.ones(len(q))]), np.sum(q * q, axis=1), rcond=None)[0]
    radius = np.linalg.norm(q - found[:2], axis=1)
    out_of_plane = np.linalg.norm(p - q @ plane, axis=1)
    if max(np.ptp(radius), out_of_plane.max()) > _ROUND * radius.mean():
        return None
    return np.asarray(middle + found[:2] @ plane)
