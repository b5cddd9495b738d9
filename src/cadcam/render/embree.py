"""A minimal interface to Embree: the first face that a ray meets. The only file that imports embreex.

Embree computes in float32. Coordinates are therefore relative to the model's centre, and callers start their rays close
to the model: positions are then good to about 1e-7 of its diagonal. Whatever needs more is confirmed in float64.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.cad.mesh import Mesh
from cadcam.errors import DegenerateGeometry


class Caster:
    """First hits of rays with a mesh."""

    def __init__(self, mesh: Mesh) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        if not mesh.n_faces:
            raise DegenerateGeometry("a mesh without faces cannot be rendered")
        low, high = mesh.bounds
        self.center: Array = (low + high) / 2
        self.radius = float(np.linalg.norm(high - low)) / 2
        self._scene = EmbreeScene(robust=True)  # watertight along shared edges
        vertices = (mesh.vertices - self.center).astype(np.float32)
        TriangleMesh(self._scene, vertices, np.ascontiguousarray(mesh.faces, np.int32))
        self.first_hit(np.full((1, 3), 2 * self.radius + 1), np.ones((1, 3)), np.ones(1))  # builds the tree

    def first_hit(self, origins: Array, directions: Array, reach: Array) -> Ids:
        """Return the first face (N,) met by rays from `origins` (N, 3) mm along unit `directions`, within `reach` mm.

        -1 if none, also for rays with NaN. Good to about 1e-7 of the model's diagonal, across and along.
        Threads may call it at the same time.
        """
        near = np.ascontiguousarray(origins - self.center, np.float32)
        return np.asarray(
            self._scene.run(near, np.ascontiguousarray(directions, np.float32), reach.astype(np.float32)), np.int32
        )
