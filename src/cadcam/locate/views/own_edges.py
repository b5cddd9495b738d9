"""Which of a part's edges are its own beside each of its look-alikes, in three dimensions: known before any photo is.

A pose of a look-alike shows the edges that the two have in common. How far each place along the part's edges lies from
the edges of a look-alike does not depend on the view, so that a photo asks for no more than a look-up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.locate.views.likeness import Likeness, even_points

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_PLACES, _DENSE = 4_000, 16_000  # places along the part's edges, and points along a look-alike's


@dataclass(frozen=True, slots=True, eq=False)
class OwnEdges:
    """Places along a part's edges, and how far off (K, n) mm the edges of each of its K look-alikes pass at least."""

    places: cKDTree
    apart: Array

    @classmethod
    def of(cls, mesh: Mesh, edges: FeatureEdges, image: Mesh, likenesses: Sequence[Likeness]) -> OwnEdges:
        """Return those of a mesh with these likenesses; image: its mirror image."""
        from scipy.spatial import cKDTree

        places = even_points(mesh, edges, _PLACES)
        trees = {mirrored: cKDTree(even_points(m, edges, _DENSE)) for m, mirrored in ((mesh, False), (image, True))}
        between = float(edges.lengths(mesh).sum()) / _DENSE
        nearest = [trees[one.mirrored].query(one.motion.inv @ places)[0] for one in likenesses]
        apart = np.array(nearest).reshape(len(likenesses), len(places)) - between / 2
        return cls(cKDTree(places), np.asarray(apart, np.float32))

    def at(self, points: Array) -> Array:
        """Return how far (K, n) mm the look-alikes' edges pass at least from points (n, 3) mm on the part's edges."""
        return np.asarray(self.apart[:, self.places.query(points)[1]])
