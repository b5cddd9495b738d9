"""A minimal interface to Embree. The only file that imports embreex."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids


class EmbreeRays:
    """Triangles that rays are cast at, in float32: vertices (V, 3) and faces (F, 3), indices into them.

    Raises `ImportError` where embreex is missing: it has no wheels for Linux on ARM, for one.
    """

    def __init__(self, vertices: Array, faces: Ids) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=True)  # watertight along shared edges
        TriangleMesh(self._scene, vertices.astype(np.float32), np.ascontiguousarray(faces, np.int32))
        beside = vertices.max(axis=0)[None] + 1
        self.first_hit(beside, np.ones((1, 3)), np.ones(1))  # builds the tree

    def first_hit(self, origins: Array, directions: Array, reach: Array) -> Ids:
        """Return the first face (N,) that rays from origins along directions (N, 3) meet up to reach (N,), or -1."""
        rays = (np.ascontiguousarray(values, np.float32) for values in (origins, directions, reach))
        return np.asarray(self._scene.run(*rays), np.int32)
