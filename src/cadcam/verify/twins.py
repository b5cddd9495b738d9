"""Lines of the model too close to tell apart: which of the photo's edges is whose is then a guess."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Mask
from cadcam.verify.sightlines import Sightlines

APART_PX = 4.0
_PARALLEL = np.cos(np.radians(25.0))


def twins(lines: Sightlines, *, apart_px: float = APART_PX) -> Mask:
    """Return the places (N,) that have another edge's line within `apart_px`, nearly parallel."""
    from scipy.spatial import cKDTree

    out = np.zeros(len(lines), bool)
    for photo in np.unique(lines.photo):
        rows = np.flatnonzero(lines.photo == photo)
        pairs = rows[cKDTree(lines.q[rows]).query_pairs(1.3 * apart_px, output_type="ndarray")]
        a, b = pairs.reshape(-1, 2).T
        other = lines.edge[a] != lines.edge[b]
        alike = np.abs(np.sum(lines.normal[a] * lines.normal[b], axis=1)) > _PARALLEL
        across = np.abs(np.sum((lines.q[a] - lines.q[b]) * lines.normal[a], axis=1)) < apart_px
        close = other & alike & across
        out[a[close]] = out[b[close]] = True
    return out
