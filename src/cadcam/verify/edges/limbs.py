"""Limbs, the borders of round surfaces: what the photo shows there may be shade.

Brightness changes ever faster towards a limb, and under a lamp at the camera falls off there: of a dark limb before a
dark ground the photo shows a border of light, inside of where the surface ends. No light makes it end farther out. So a
limb seen inside of its place tells nothing as far as that is; one seen outside has been displaced.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import EdgeKind
from cadcam.verify.edges.sightlines import Sightlines
from cadcam.verify.edges.surroundings import EdgeSurroundings

_LEAST_PX = 0.5  # by which limbs may be off, wherever they are seen


def limb_errors(lines: Sightlines, beside: EdgeSurroundings, offset: Array) -> Array:
    """Return the error (N,) px by shade that a whole edge has, 0 for what is no limb; offset (N,) px: where it is seen.

    At least as large as the edge is seen inside of its place, in the middle.
    """
    out = np.zeros(len(lines))
    inwards = -_outwards(lines, beside) * offset
    for e in np.unique(lines.edge[lines.kind == EdgeKind.CONTOUR]):
        rows = lines.edge == e
        seen = inwards[rows & np.isfinite(inwards)]
        out[rows] = max(_LEAST_PX, float(np.median(seen)) if len(seen) else 0.0)
    return out


def _outwards(lines: Sightlines, beside: EdgeSurroundings) -> Array:
    """Return 1 where the normal of a limb points away from its surface, -1 where it points to it, 0 where neither is.

    The surface lies on that side from which it bends away towards the other.
    """
    bends = np.einsum("nki,ni->nk", beside.normal, lines.by_point) * [1.0, -1.0]
    bends = np.where(beside.part == lines.part[:, None], bends, 0.0)
    best = np.argmax(bends, axis=1)
    return np.where(bends.max(axis=1) > 0, 1.0 - 2.0 * best, 0.0)
