"""Feet, where a body stands on another: the line that the photo shows there belongs to both of them.

A foot is a contact line. A body that is lifted, or slides on the other, takes it along. A body that sinks into the
other does not: then the visible line is where its side meets the other's surface, farther up the side. The same line
moves when the other body does. How a foot follows a displacement thus depends on the sign of the component normal to
the ground, and it measures the displacement once both cases are considered (`cadcam.verify.adjustment.following`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.cad.edges import EdgeKind
from cadcam.verify.edges.sightlines import Sightlines
from cadcam.verify.edges.surroundings import EdgeSurroundings

_FLAT = 0.95  # cosine between side and ground from which they are one surface


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """N places as feet.

    lever (N,) px/mm: how far the line in the photo slides across itself if the body sinks by 1 mm, 0 for edges that are
    no feet; mate (N,): number of the part that it stands on, -1 for none; ground (N, 3): unit normal of the surface
    that it stands on, in the part frame, zero for none.
    """

    lever: Array
    mate: Longs
    ground: Array

    @classmethod
    def of(cls, lines: Sightlines, beside: EdgeSurroundings) -> Feet:
        """Return the feet among places, given what lies on both sides of them."""
        own = beside.part == lines.part[:, None]
        ground = (beside.part >= 0) & ~own
        standing = (lines.kind == EdgeKind.CONTACT) & own.any(axis=1) & ground.any(axis=1)
        which = np.argmax(own, axis=1)
        i = np.arange(len(lines))
        side, floor = beside.normal[i, which], beside.normal[i, 1 - which]
        mate = np.where(standing, beside.part[i, 1 - which], -1).astype(np.int64)
        lever = np.where(standing, _slide(lines.by_point, side, floor), 0.0)
        return cls(lever, mate, np.where(standing[:, None], floor, 0.0))

    def of_bodies(self, lines: Sightlines, body: Longs) -> Longs:
        """Return the body (N,) that each foot stands on, -1 for none: a visible part is a body, or belongs to one."""
        out = np.full(len(body), -1, np.int64)
        for part in np.unique(self.mate[self.mate >= 0]):
            of = body[(lines.part == part) & (body >= 0)]
            if len(of):
                out[self.mate == part] = np.bincount(of).argmax()
        return out


def _slide(by_point: Array, side: Array, ground: Array) -> Array:
    """Return by how many px/mm the intersection of two surfaces slides across itself in the photo as the side sinks.

    It stays on the side and moves up from the ground: along s = a (a . b) - b, for normals a of the side and b of the
    ground, by -1 / (s . b) per mm.
    """
    cosine = np.einsum("ni,ni->n", side, ground)
    s = side * cosine[:, None] - ground
    rise = np.minimum(cosine**2 - 1.0, _FLAT**2 - 1.0)
    return np.asarray(np.einsum("ni,ni->n", by_point, s) / rise)
