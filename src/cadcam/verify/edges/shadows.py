"""Edges at which the light makes no step: what the photo shows there is a shadow's border.

Between surfaces that face the same way, of one paint, an edge shows by a shadow alone. That begins where the light has
it, beside the edge as often as along it.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.verify.edges.sightlines import Sightlines
from cadcam.verify.edges.surroundings import EdgeSurroundings

# Share of a step that the light has to explain; how far (px) edges of which it explains less are off, 1 sigma. Of 69 in
# simulated photographs 27 were off by more than 0.25 px, up to 0.8 and another by 1.2; of 2048 other edges 2 %.
_EXPLAINED, _OFF_PX = 0.2, 0.5


def shadow_errors(lines: Sightlines, beside: EdgeSurroundings, step: Array) -> Array:
    """Return the error (N,) px common to each edge that shows by a shadow, 0 for others; step (N,): as measured."""
    out = np.zeros(len(lines))
    seen = np.isfinite(step)
    for e in np.unique(lines.edge[seen]):
        its = lines.edge == e
        if np.median(beside.most[its & seen]) < _EXPLAINED * np.median(np.abs(step[its & seen])):
            out[its] = _OFF_PX
    return out
