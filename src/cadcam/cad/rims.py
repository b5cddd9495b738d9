"""Rims of holes and pins: circles among the feature edges, also where a file draws each as several arcs.

STEP files have a hole as two half cylinders: its rim is two edges, of different faces, and two chains.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.cad.chains import chain_of_each
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import weld

_LEAST = 8  # segments of a circle
_ROUND = 0.02  # of its radius: how far its points may be off, which rounded coordinates and seams are
_PARALLEL = np.cos(np.radians(0.5))  # axes of one bore


def rim_centers(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return the middles (N, 3) mm of round holes and pins: the centre of each closed line that is a circle."""
    found = np.array([rim.centre for _, rim in _closed(mesh, edges)]).reshape(-1, 3)
    return found[np.unique(weld(found, np.zeros(len(found), np.int64)))] if len(found) else found


def rim_of_chains(mesh: Mesh, edges: FeatureEdges) -> Longs:
    """Return the rim (C,) that each chain is of: arcs of one circle, end to end, have the first one's number.

    Every other chain has its own. Arcs of different parts are never one rim.
    """
    rim = np.arange(edges.chain.max(initial=-1) + 1, dtype=np.int64)
    points, _, lines = _smooth_lines(mesh, edges)
    for line in lines:
        chains = edges.chain[line]
        if np.ptp(chains) and _Circle.through(points[line].reshape(-1, 3)) is not None:
            rim[chains] = chains.min()
    return rim


def bore_of_chains(mesh: Mesh, edges: FeatureEdges) -> Longs:
    """Return the bore (C,) that each chain is a rim of: all rims of one hole or pin have the first one's number.

    They are circles of one size about one axis, of one part. Every other chain has its own.
    """
    bore, found = rim_of_chains(mesh, edges), list(_closed(mesh, edges))
    first = np.array([line[0] for line, _ in found], np.int64)
    part, radius = edges.part[first], np.array([circle.radius for _, circle in found])
    centre, axis = (np.array([getattr(c, name) for _, c in found]).reshape(-1, 3) for name in ("centre", "axis"))
    for i, (line, circle) in enumerate(found):  # against all before it at once: plates have thousands of holes
        apart = centre[:i] - circle.centre
        across = np.linalg.norm(apart - np.outer(apart @ circle.axis, circle.axis), axis=1)
        alike = np.maximum(across, np.abs(radius[:i] - circle.radius)) < _ROUND * circle.radius
        same = alike & (np.abs(axis[:i] @ circle.axis) > _PARALLEL) & (part[:i] == part[i])
        if same.any():
            bore[edges.chain[line]] = bore[edges.chain[first[np.argmax(same)]]]
    return bore


def _closed(mesh: Mesh, edges: FeatureEdges) -> Iterator[tuple[Longs, _Circle]]:
    """Yield the segments of each closed line that is a circle, and that circle."""
    points, number, lines = _smooth_lines(mesh, edges)
    for line in lines:
        if len(line) >= _LEAST and (np.unique(number[line], return_counts=True)[1] == 2).all():
            circle = _Circle.through(points[line].reshape(-1, 3))
            if circle is not None:
                yield line, circle


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


@dataclass(frozen=True, slots=True, eq=False)
class _Circle:
    """A circle: centre (3,) mm, axis (3,), radius mm."""

    centre: Array
    axis: Array
    radius: float

    @classmethod
    def through(cls, points: Array) -> _Circle | None:
        """Return the circle through points (n, 3); None where they lie on none."""
        middle = points.mean(axis=0)
        p = points - middle
        axes = np.linalg.svd(p, full_matrices=False)[2]
        q = p @ axes[:2].T
        found = np.linalg.lstsq(np.column_stack([2 * q, np.ones(len(q))]), np.sum(q * q, axis=1), rcond=None)[0]
        radius = np.linalg.norm(q - found[:2], axis=1)
        if max(np.ptp(radius), np.abs(p @ axes[2]).max()) > _ROUND * radius.mean():
            return None
        return cls(np.asarray(middle + found[:2] @ axes[:2]), axes[2], float(radius.mean()))
