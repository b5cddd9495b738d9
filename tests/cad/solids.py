"""Small meshes for tests."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cadcam.cad.mesh import Mesh, merge

CUBE = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])


def box(low: npt.ArrayLike, high: npt.ArrayLike, name: str = "box") -> Mesh:
    """Return a closed box wound outwards: eight vertices, twelve triangles."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    corners = np.array(
        [[(low, high)[i >> 2 & 1][0], (low, high)[i >> 1 & 1][1], (low, high)[i & 1][2]] for i in range(8)]
    )
    faces = np.concatenate([CUBE[:, [0, 1, 2]], CUBE[:, [0, 2, 3]]])
    return Mesh.single(corners, faces, name=name)


def soup(mesh: Mesh) -> Mesh:
    """Return the mesh with vertices of its own for every face, as STL has them."""
    faces = np.arange(3 * mesh.n_faces).reshape(-1, 3)
    return Mesh(
        mesh.vertices[mesh.faces].reshape(-1, 3), faces, mesh.part, mesh.surface, mesh.part_names, mesh.part_colors
    )


def one_part(mesh: Mesh) -> Mesh:
    """Return the mesh with all faces in one part."""
    return Mesh(mesh.vertices, mesh.faces, mesh.part * 0, mesh.surface, ("all",), mesh.part_colors[:1])


def prism(n: int, *, radius: float = 10.0, height: float = 30.0, surfaces: bool = False) -> Mesh:
    """Return an upright prism over a regular polygon; with `surfaces`, its sides are one surface, its ends two."""
    t = 2 * np.pi * np.arange(n) / n
    ring = radius * np.column_stack([np.cos(t), np.sin(t)])
    points = [np.column_stack([ring, np.full(n, z)]) for z in (0.0, height)]
    k, after = np.arange(n), (np.arange(n) + 1) % n
    sides = np.concatenate([np.column_stack([k, after, after + n]), np.column_stack([k, after + n, k + n])])
    middle = np.arange(1, n - 1)
    bottom = np.column_stack([np.zeros_like(middle), middle + 1, middle])
    top = np.column_stack([np.zeros_like(middle), middle, middle + 1]) + n
    surface = np.repeat([0, 1, 2], [2 * n, n - 2, n - 2])
    return Mesh.single(
        np.concatenate(points), np.concatenate([sides, bottom, top]), surface=surface if surfaces else None
    )


def sheet(x0: float, x1: float, y0: float, y1: float, *, z: float = 0.0, name: str = "sheet") -> Mesh:
    """Return a flat open rectangle facing up."""
    corners = [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]
    return Mesh.single(corners, [(0, 1, 2), (0, 2, 3)], name=name)


def both(*meshes: Mesh) -> Mesh:
    """Return the meshes as one, each a part."""
    return merge(meshes)


def outward(mesh: Mesh) -> npt.NDArray[np.float64]:
    """Return the signed volume of the mesh in mm³: positive where it is wound outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - mesh.vertices.mean(axis=0) for k in range(3))
    return np.asarray(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
