"""Faces that coincide with others of their part, and parts that coincide with others."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import HalfEdges, components, weld_tolerance


def repeats(corners: Longs) -> Mask:
    """Return which faces to drop because others have the same three corners.

    Of faces wound alike one stays. Of two wound against each other one stays too (a sheet given from both sides),
    unless they are the wall between two bodies that touch: then every edge has an even number of faces, not all of
    them such pairs, and both go.
    """
    group, sense = _same_corners(corners)
    _, first = np.unique(2 * group + sense, return_index=True)
    dropped = np.ones(len(corners), bool)
    dropped[first] = False
    left = np.flatnonzero(~dropped)
    paired = np.bincount(group[left], minlength=len(corners))[group[left]] == 2
    if paired.any():
        walls = paired & _between_bodies(corners[left], paired)
        lowest = np.full(len(corners), len(corners))
        np.minimum.at(lowest, group[left], left)
        later = paired & (left > lowest[group[left]])
        dropped[left[walls | later]] = True
    return dropped


def first_in_place(mesh: Mesh) -> Longs:
    """Return for each part (P,) the first one that stands where it does, face by face, within the weld tolerance.

    Careless exports hold a body twice. Each of its edges would then lie on another body's, as the foot of a weld does.
    """
    from scipy.spatial import cKDTree

    count = np.bincount(mesh.part, minlength=len(mesh.part_names))
    first = np.arange(len(count))
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    within = weld_tolerance(middles, mesh.part.astype(np.int64))
    of_part = np.split(np.argsort(mesh.part, kind="stable"), np.cumsum(count)[:-1])
    for n in np.unique(count[count > 0]).tolist():
        alike = np.flatnonzero(count == n)
        box = np.array([[middles[of_part[k]].min(axis=0), middles[of_part[k]].max(axis=0)] for k in alike])
        near = cKDTree(box.reshape(-1, 6)).query_pairs(3 * within[alike].max(), output_type="ndarray")
        for one, other in alike[near[np.lexsort(near.T)]].tolist():  # one < other, the lowest first
            if first[one] == one and first[other] == other:
                there = _coincide(middles[of_part[one]], middles[of_part[other]], float(within[one]))
                first[other] = one if there else other
    return first


def _coincide(one: Array, other: Array, within: float) -> bool:
    """Return whether each of some points (N, 3) lies on another one of as many (N, 3)."""
    from scipy.spatial import cKDTree

    away, which = cKDTree(one).query(other, distance_upper_bound=max(within, np.finfo(float).tiny))
    return bool(np.isfinite(away).all()) and len(np.unique(which)) == len(one)


def _same_corners(corners: Longs) -> tuple[Longs, Longs]:
    """Return a number (F,) shared by faces with the same corners, and 0 or 1 for their winding."""
    low, high = corners.min(axis=1, initial=2**62), corners.max(axis=1, initial=-1)
    middle = corners.sum(axis=1) - low - high
    order = np.lexsort((high, middle, low))
    keys = np.column_stack([low, middle, high])[order]
    starts = np.ones(len(corners), bool)
    starts[1:] = (keys[1:] != keys[:-1]).any(axis=1)
    group = np.zeros(len(corners), np.int64)
    group[order] = np.cumsum(starts) - 1
    lowest = corners.argmin(axis=1) if len(corners) else np.zeros(0, np.int64)
    after = np.take_along_axis(corners, ((lowest + 1) % 3)[:, None], axis=1)[:, 0] if len(corners) else lowest
    return group, (after != middle).astype(np.int64)


def _between_bodies(corners: Longs, paired: Mask) -> Mask:
    """Return which faces (F,) have only edges of even count, in a component that has unpaired faces too."""
    half = HalfEdges.of(corners)
    even = (half.count[half.edge] % 2 == 0).reshape(-1, 3).all(axis=1)
    face = np.arange(len(corners)).repeat(3)
    first = half.order[half.start[half.edge]] // 3
    component = components(np.column_stack([face, first]), len(corners))
    mixed = np.bincount(component, ~paired)[component] > 0
    return np.asarray(even & mixed)
