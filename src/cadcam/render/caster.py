"""The first face that a ray meets: by Embree where it is installed, else by the C core, four to six times as slowly.

Embree computes in float32. Coordinates are therefore relative to the model's centre, and callers start their rays close
to the model: positions are then good to about 1e-7 of its diagonal. Whatever needs more is confirmed in float64.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.cad.mesh import Mesh
from cadcam.errors import DegenerateGeometry
from cadcam.native.rays import NativeRays
from cadcam.render.embree import EmbreeRays


class Caster:
    """First hits of rays with a mesh. Raises `MissingCore` where there is neither Embree nor the core.

    center (3,) mm: what coordinates are rounded relative to; of some faces of a model, that of the whole.
    """

    def __init__(self, mesh: Mesh, *, center: Array | None = None) -> None:
        if not mesh.n_faces:
            raise DegenerateGeometry("a mesh without faces cannot be rendered")
        low, high = mesh.bounds
        self.center: Array = (low + high) / 2 if center is None else center
        self.radius: float = float(np.linalg.norm(high - low)) / 2
        self._rays = _rays(mesh.vertices - self.center, mesh.faces)

    def first_hit(self, origins: Array, directions: Array, reach: Array) -> Ids:
        """Return the first face (N,) met by rays from `origins` (N, 3) mm along unit `directions`, within `reach` mm.

        -1 if none, also for rays with NaN. Good to about 1e-7 of the model's diagonal, across and along.
        Threads may call it at the same time.
        """
        return self._rays.first_hit(origins - self.center, directions, reach)


def _rays(vertices: Array, faces: Ids) -> EmbreeRays | NativeRays:
    try:
        return EmbreeRays(vertices, faces)
    except ImportError:
        return NativeRays(vertices, faces)
