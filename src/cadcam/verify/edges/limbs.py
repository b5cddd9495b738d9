"""Limbs, the borders of round surfaces: what the photo shows there may be shading.

Brightness changes ever faster towards a limb, and under a light at the camera it falls off there: for a dark limb on a
dark background the photo shows the border of the bright area, inside of where the surface ends. Farther out a surface
seems to end by little: before a brighter ground, as far as the photo's blur mixes the fall into the step (0.1 to 0.6 px
in simulated pictures). So the offset of a limb seen inside its place is no evidence; one seen farther outside is.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import EdgeKind
from cadcam.verify.edges.sightlines import Sightlines, pieces
from cadcam.verify.edges.surroundings import EdgeSurroundings

_LEAST_PX = 0.5  # least error of limbs, wherever they are seen
_STRAIGHT = np.cos(np.radians(5.0))  # a place of a straight limb faces its mean direction so nearly


def limb_errors(lines: Sightlines, beside: EdgeSurroundings, offset: Array) -> tuple[Array, Array]:
    """Return the errors (N,) px of limbs by shading, 0 for other edges; offset (N,) px: where they are seen.

    The first is common to all of a straight limb, the second that of each place of a limb that turns. The pieces of
    that face different ways, in a light of their own each, and along each the error need not follow a line: a
    displacement makes such differences, too, and they are seen far more accurately than they tell of it. So the n
    places of a piece have independent errors, sqrt(n) times as large, and together tell no more than one.

    The error is at least the median offset by which the limb, or a piece of it, is seen inside its place.
    """
    common, apart = np.zeros(len(lines)), np.zeros(len(lines))
    inwards = -_outwards(lines, beside) * offset
    for e in np.unique(lines.edge[lines.kind == EdgeKind.CONTOUR]):
        rows = np.flatnonzero(lines.edge == e)
        if _straight(lines.normal[rows]):
            common[rows] = _error(inwards[rows])
            continue
        piece = pieces(lines.edge[rows], lines.normal[rows])
        for its in (rows[piece == i] for i in np.unique(piece)):
            apart[its] = _error(inwards[its]) * np.sqrt(max(np.isfinite(inwards[its]).sum(), 1))
    return common, apart


def _error(inwards: Array) -> float:
    """Return the error (px) by shading of what is seen `inwards` (n,) px inside its place, nan where it is not."""
    seen = inwards[np.isfinite(inwards)]
    return max(_LEAST_PX, float(np.median(seen)) if len(seen) else 0.0)


def _straight(normal: Array) -> bool:
    """Return whether all of the unit normals (n, 2) of an edge point the same way."""
    mean = normal.mean(axis=0)
    return bool((normal @ mean).min() >= _STRAIGHT * np.linalg.norm(mean))


def _outwards(lines: Sightlines, beside: EdgeSurroundings) -> Array:
    """Return 1 where the normal of a limb points away from its surface, -1 where towards it, 0 where undetermined.

    The surface lies on the side from which it curves away towards the other.
    """
    bends = np.einsum("nki,ni->nk", beside.normal, lines.by_point) * [1.0, -1.0]
    bends = np.where(beside.part == lines.part[:, None], bends, 0.0)
    best = np.argmax(bends, axis=1)
    return np.where(bends.max(axis=1) > 0, 1.0 - 2.0 * best, 0.0)
