"""How edges bend in their photos: what a displaced rim does beyond moving its tangents."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edge_kind import EdgeKind
from cadcam.verify.edges.sightlines import STEP_PX, Sightlines


def curvature(lines: Sightlines) -> Array:
    """Return the curvature (N,), 1/px, of the edges at their places; that of contours is taken as 0."""
    order = np.lexsort([lines.along, lines.edge])
    edge, along, normal = lines.edge[order], lines.along[order], lines.normal[order]
    apart = np.diff(along)
    run = (edge[1:] == edge[:-1]) & (apart < 2 * STEP_PX) & (lines.kind[order][1:] != EdgeKind.CONTOUR)
    turn = np.arccos(np.clip(np.einsum("ni,ni->n", normal[1:], normal[:-1]), -1.0, 1.0))
    turned, length = (np.concatenate([[0.0], np.where(run, v, 0.0), [0.0]]) for v in (turn, apart))
    out = np.zeros(len(order))
    out[order] = (turned[1:] + turned[:-1]) / np.maximum(length[1:] + length[:-1], 1e-300)
    return out


def bent_away(lines: Sightlines, outward: Array, moved: Array) -> Array:
    """Return by how much (N,) px more than to first order lines of circles move that are displaced by (3,) mm.

    outward (N, 3): unit vectors from the circles' axis. A circle that slides along its tangent leaves it inwards.
    """
    out = np.zeros(len(lines))
    for photo in np.unique(lines.photo):
        mine = lines.photo == photo
        normal = lines.normal[mine]
        shift = np.linalg.lstsq(normal, lines.by_point[mine] @ moved, rcond=None)[0]  # px: nearly that of all of it
        out[mine] = (normal[:, 0] * shift[1] - normal[:, 1] * shift[0]) ** 2
    away = np.sign(np.einsum("ni,ni->n", lines.by_point, outward))
    return np.asarray(-0.5 * away * curvature(lines) * out)
