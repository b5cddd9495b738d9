"""Limbs, the borders of round surfaces: what the photo shows there may be shading.

Brightness changes ever faster towards a limb, and under a light at the camera it falls off there: for a dark limb on a
dark background the photo shows the border of the bright area, inside of where the surface ends. No light makes a
surface seem to end farther out. So the offset of a limb seen inside its place is no evidence; one seen outside is
displaced.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import EdgeKind
from cadcam.verify.edges.sightlines import Sightlines
from cadcam.verify.edges.surroundings import EdgeSurroundings

_LEAST_PX = 0.5  # least error of limbs, wherever they are seen


def limb_errors(lines: Sightlines, beside: EdgeSurroundings, offset: Array) -> Array:
    """Return the common error (N,) px of each limb by shading, 0 for other edges; offset (N,) px: where it is seen.

    At least the median offset by which the edge is seen inside its place.
    """
    out = np.zeros(len(lines))
    inwards = -_outwards(lines, beside) * offset
    for e in np.unique(lines.edge[lines.kind == EdgeKind.CONTOUR]):
        rows = lines.edge == e
        seen = inwards[rows & np.isfinite(inwards)]
        out[rows] = max(_LEAST_PX, float(np.median(seen)) if len(seen) else 0.0)
    return out


def _outwards(lines: Sightlines, beside: EdgeSurroundings) -> Array:
    """Return 1 where the normal of a limb points away from its surface, -1 where towards it, 0 where undetermined.

    The surface lies on the side from which it curves away towards the other.
    """
    bends = np.einsum("nki,ni->nk", beside.normal, lines.by_point) * [1.0, -1.0]
    bends = np.where(beside.part == lines.part[:, None], bends, 0.0)
    best = np.argmax(bends, axis=1)
    return np.where(bends.max(axis=1) > 0, 1.0 - 2.0 * best, 0.0)
