"""What lies on both sides of an edge, and how bright it should be: whether an edge is visible depends on the light.

Edges between the same two surfaces have contrast, or lack it, together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.image.profile import BRIGHT
from cadcam.locate.photo import Photo
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.sightlines import Sightlines

FAINT = 0.02  # contrast below which an edge may be invisible
_SURE_WAY = 4.0  # sigmas of a change of brightness from which its sign is certain
_ASIDE_PX = 1.5  # distance at which the sides are evaluated: twins are farther apart
_ALIKE = 0.3  # difference of normals (about rad) up to which surfaces are lit alike


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSurroundings:
    """What lies beside N places.

    normal (N, 2, 3): of the surfaces before and after the place along its normal, in the part frame, zero where there
    is no part; part, color (N, 2): the numbers of their body and paint, -1 for none; contrast, most (N,): least and
    largest change of brightness between them, given the uncertainty of the light; way (N,): its expected sign, 1 where
    it should rise along the normal, -1 where it should fall, 0 where that is uncertain; glare (N,): whether the photo
    is white on both sides, though both are the part's, so that nothing shows whether there is an edge.
    """

    normal: Array
    part: Ids
    color: Ids
    contrast: Array
    most: Array
    way: Array
    glare: Mask


def edge_surroundings(photos: Sequence[Photo], shown: Sequence[ShownFaces], lines: Sightlines) -> EdgeSurroundings:
    """Return what lies beside each place, under the light of the photos; shown: what the part shows in each photo."""
    n = len(lines)
    normals = np.zeros((n, 2, 3))
    contrast, most, way, glare = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n, bool)
    parts, colors = np.full((n, 2), -1, np.int32), np.full((n, 2), -1, np.int32)
    for i, (photo, seen) in enumerate(zip(photos, shown, strict=True)):
        light = seen.light(photo)
        rows = np.flatnonzero(lines.photo == i)
        white = np.zeros((len(rows), 2), bool)
        for side, sign in enumerate((-1.0, 1.0)):
            q = np.rint(lines.q[rows] + sign * _ASIDE_PX * lines.normal[rows]).astype(np.int64)
            x, y = np.clip(q, 0, np.array(photo.camera.size) - 1).T
            face = seen.face[y, x]
            normals[rows, side], colors[rows, side] = seen.normal[face], seen.color[face]
            parts[rows, side] = seen.part[face]
            white[:, side] = photo.gray[y, x] >= BRIGHT
        change, sigma = light.contrast(normals[rows], colors[rows])
        contrast[rows], most[rows] = np.maximum(np.abs(change) - sigma, 0.0), np.abs(change) + sigma
        glare[rows] = (colors[rows] >= 0).all(axis=1) & white.all(axis=1)
        known = (np.abs(change) > _SURE_WAY * np.hypot(sigma, light.scale)) & (colors[rows] >= 0).all(axis=1)
        way[rows] = np.where(known, np.sign(change), 0.0)
    return EdgeSurroundings(normals, parts, colors, contrast, most, way, glare)


def alike(normal: Array, color: Ids) -> Longs:
    """Return the group number (E,) of each edge, by its two sides: normals (E, 2, 3), colours (E, 2)."""
    group = np.full(len(normal), -1, np.int64)
    for i in range(len(normal)):
        if group[i] >= 0:
            continue
        same = np.zeros(len(normal), bool)
        for order in ([0, 1], [1, 0]):
            close = np.linalg.norm(normal - normal[i, order], axis=2).max(axis=1) <= _ALIKE
            same |= close & (color == color[i, order]).all(axis=1)
        group[same & (group < 0)] = group.max() + 1
    return group
