"""The search for triangles at a point agrees with looking at every triangle."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from cadcam.cad.box_tree import TriangleTree
from cadcam.cad.mesh import Mesh


@pytest.mark.parametrize("n_faces", [1, 3, 17, 400])
def test_the_tree_finds_exactly_the_triangles_within_the_tolerance(n_faces: int, rng: np.random.Generator) -> None:
    corners = rng.uniform(0, 10, (n_faces, 1, 3)) + rng.normal(size=(n_faces, 3, 3))
    mesh = Mesh.single(corners.reshape(-1, 3), np.arange(3 * n_faces).reshape(-1, 3))
    body = rng.integers(0, 3, n_faces)
    # points above random places on random triangles, at a known height below or above the tolerance
    face = rng.integers(0, n_faces, 500)
    weights = rng.dirichlet((1, 1, 1), 500)
    height = rng.choice([0.0, 0.04, 0.06], 500)
    points = np.einsum("pk,pkc->pc", weights, corners[face]) + height[:, None] * mesh.face_normals[face]
    own = rng.integers(0, 3, 500)
    at, faces = TriangleTree(mesh, body).touching(points, 0.05, apart_from=own)
    found = set(zip(at.tolist(), faces.tolist(), strict=True))
    for p in range(500):
        expected = height[p] < 0.05 and body[face[p]] != own[p]
        if height[p] < 0.05 or n_faces == 1:
            assert ((p, face[p]) in found) == expected
    for p, f in found:
        assert body[f] != own[p]
        assert distance(points[p], corners[f]) <= 0.05 + 1e-8


def distance(point: np.ndarray, triangle: np.ndarray) -> float:
    """Return the distance of a point to a triangle: non-negative weights that sum to one, by least squares."""
    heavy = 1e5  # holds the sum of the weights to one part in 1e10
    relative = (triangle - point).T
    weights, _ = nnls(np.vstack([relative, np.full(3, heavy)]), np.array([0, 0, 0, heavy]))
    return float(np.linalg.norm(relative @ weights))
