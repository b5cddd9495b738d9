"""The labelled points of a part: read from a file, or spread over its corners."""

from __future__ import annotations

import os

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.corners import corner_vertices
from cadcam.cad.mesh import used_vertices
from cadcam.errors import UnknownName, UnreadableFile
from cadcam.files.text import lines_of_cells, number_in, read_text
from cadcam.render.view import Scene

_COLUMNS = ("name", "x", "y", "z")
_MOST = 1000
_CORNERS = 12


def read_key_points(path: str | os.PathLike[str]) -> tuple[tuple[str, ...], Array]:
    """Return names and places (K, 3) mm of the points in a file: a line `name, X, Y, Z`, then a point a line.

    Raises `UnreadableFile` naming the line.
    """
    file = read_text(path)
    lines = lines_of_cells(file)
    columns = tuple(cell.lower() for cell in next(lines).cells)
    for column in columns:
        if column not in _COLUMNS:
            raise UnreadableFile(path, f"line 1 names an {UnknownName('column', column, _COLUMNS)}")
    if missing := [c for c in _COLUMNS if c not in columns]:
        raise UnreadableFile(path, f"has no column {missing[0]!r}", "its first line is: name, X, Y, Z")
    names, places = [], []
    for line in lines:
        if len(line.cells) != len(columns):
            raise UnreadableFile(path, f"line {line.number} has {len(line.cells)} cells", f"there are {len(columns)}")
        cell = dict(zip(columns, line.cells, strict=True))
        if cell["name"] in names:
            raise UnreadableFile(path, f"line {line.number} names {cell['name']!r} again", "give each its own name")
        names.append(cell["name"])
        places.append([number_in(file, line.number, axis.upper(), cell[axis]) for axis in "xyz"])
    if not 0 < len(names) <= _MOST:
        raise UnreadableFile(path, f"holds {len(names)} points", f"1 to {_MOST} are needed")
    return tuple(names), np.array(places)


def corners(scene: Scene) -> tuple[tuple[str, ...], Array]:
    """Return names and places (K, 3) mm of corners as far apart as possible.

    For a part with fewer corners, places along its edges; without edges, any vertices.
    """
    mesh, edges = scene.mesh, scene.edges
    places = corner_vertices(mesh, edges)
    for others in (np.unique(edges.vertices), used_vertices(mesh)):
        places = places if len(places) >= _CORNERS else mesh.vertices[others]
    places = np.unique(np.round(places, 6), axis=0) + 0.0
    spread = _spread(places, _CORNERS)
    return tuple(f"corner {i + 1}" for i in range(len(spread))), spread


def _spread(points: Array, count: int) -> Array:
    """Return `count` points, each the farthest from those before it; the first is farthest from the middle."""
    far = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = [int(np.argmax(far))]
    left = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argmax(left)))
        left = np.minimum(left, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]
