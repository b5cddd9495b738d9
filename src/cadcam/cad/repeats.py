"""Faces that coincide with others of their part."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Longs, Mask
from cadcam.cad.topology import HalfEdges, components


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
