"""Rims of holes and ends of pins, as circles: how they are seen if they are displaced, or of another size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.locate.lines.sight import Sight
from cadcam.verify.edges.sightlines import Sightlines
from cadcam.verify.tolerances.circles import Circles


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """N places on visible edges as those of circles; zero at places of none.

    outward, along (N, 3): unit vectors from the axis, and along the circle; radius (N,) mm; inside (N,) mm: how far the
    CAD's chord lies within the circle. lean (N,): of the direction in the circle's plane that the photo shows exactly
    across the edge, mm along the circle for each mm outward.
    """

    outward: Array
    along: Array
    radius: Array
    inside: Array
    lean: Array

    @classmethod
    def of(
        cls, lines: Sightlines, sights: Sequence[Sight], circles: Sequence[Circles | None], members: Sequence[Mask]
    ) -> Rims:
        """Return the places of the circles among the members (N,) of features."""
        n = len(lines)
        out = cls(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n))
        for of, rows in zip(circles, members, strict=False):  # members are of further parts, too
            if of is not None:
                p = lines.p[rows]
                out.outward[rows], out.inside[rows] = of.outward(p), of.inside(p)
                out.along[rows] = np.cross(of.axis, out.outward[rows])
                out.radius[rows] = np.einsum("ni,ni->n", p - of.centre, out.outward[rows])
        round_ = out.radius > 0
        for photo, sight in enumerate(sights):
            here = np.flatnonzero(round_ & (lines.photo == photo))
            pose = sight.photo.camera_from_world @ sight.drawn
            _, J = sight.photo.camera.project_with_jacobian(pose @ lines.p[here])
            tangent = lines.normal[here][:, ::-1] * np.array([-1.0, 1.0])
            seen = np.einsum("ni,nij,jk->nk", tangent, J, pose.rotation)
            by_along = np.einsum("ni,ni->n", seen, out.along[here])
            steep = np.abs(by_along) > 1e-12
            by_outward = np.einsum("ni,ni->n", seen, out.outward[here])
            out.lean[here] = np.where(steep, -by_outward / np.where(steep, by_along, 1.0), 0.0)
        return out

    def select(self, chosen: Mask | Longs) -> Rims:
        """Return the chosen places."""
        return Rims(*(getattr(self, f.name)[chosen] for f in fields(self)))

    def growth(self, by_point: Array) -> Array:
        """Return how far (N,), px/mm, places move across their edges as the radius grows; by_point as in Sightlines."""
        return np.asarray(np.einsum("ni,ni->n", by_point, self.outward))

    def beyond_tangents(self, by_point: Array, moved: Array, larger: float) -> Array:
        """Return how much farther (N,) px circles are seen to move than their tangents.

        They are displaced by (3,) mm, and their radius is larger by so many mm. In the plane of a circle of radius r,
        (s, s lean) mm from a place is on it now where (s + r - outward)^2 + (s lean - along)^2 = (r + larger)^2; its
        tangent is at s = outward + larger.
        """
        outward, along = self.outward @ moved, self.along @ moved
        r, k = self.radius, self.lean
        a, b = 1 + k**2, r - outward - k * along
        c = (outward - 2 * r) * outward + along**2 - (2 * r + larger) * larger
        root = b**2 - a * c
        near = (root > 0) & (b > 0)  # else it is displaced by its own size
        tangent = outward + larger
        s = np.where(near, -c / np.where(near, b + np.sqrt(np.maximum(root, 0.0)), 1.0), tangent)
        return np.asarray((s - tangent) * self.growth(by_point))
