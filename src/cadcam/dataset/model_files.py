"""The part as files of a data set: BOP's model, its size and diameter, and its edges in space."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import compacted
from cadcam.cad.write import write_model
from cadcam.dataset.layout import MODEL, MODEL_EDGES, MODELS_INFO, OBJECT
from cadcam.dataset.npz import arrays_file
from cadcam.render.view import Scene
from cadcam.whole import write_whole

_FEW = 500


def write_model_files(folder: Path, scene: Scene) -> None:
    """Write the model's files into a data set."""
    write_model(folder / MODEL, scene.mesh)
    (low, high), points = scene.mesh.bounds, compacted(scene.mesh).vertices
    info = {"diameter": diameter(points)}
    info |= {f"min_{axis}": value for axis, value in zip("xyz", low.tolist(), strict=True)}
    info |= {f"size_{axis}": value for axis, value in zip("xyz", (high - low).tolist(), strict=True)}
    write_whole(folder / MODELS_INFO, (json.dumps({str(OBJECT): info}, indent=2) + "\n").encode())
    write_whole(folder / MODEL_EDGES, _edges(scene))


def diameter(points: Array) -> float:
    """Return the largest distance (mm) between two of the points (N, 3)."""
    out = np.linalg.norm(points - (points.min(axis=0) + points.max(axis=0)) / 2, axis=1)
    some = float(np.linalg.norm(points - points[np.argmax(out)], axis=1).max())
    ends = points[out >= (some - out.max()) * (1 - 1e-9)]  # points nearer the middle cannot be ends of the diameter
    if len(ends) <= _FEW:
        return float(np.linalg.norm(ends[:, None] - ends, axis=2).max())
    from scipy.spatial import ConvexHull  # takes a third of a second to import, and is rarely needed
    from scipy.spatial.distance import cdist

    corners = ends[ConvexHull(ends, qhull_options="QJ").vertices]  # QJ: flat ones too
    blocks = (corners[i : i + _FEW] for i in range(0, len(corners), _FEW))
    return max(float(cdist(block, corners).max()) for block in blocks)


def _edges(scene: Scene) -> bytes:
    """Return every feature edge as a polyline: p (N, 3) mm, start (M + 1,), its number (M,), kind, part."""
    edges = scene.edges
    lines = edges.polylines(scene.mesh)
    first = np.flatnonzero(np.diff(edges.chain, prepend=-1)) if len(edges) else np.zeros(0, np.int64)
    return arrays_file(
        p=np.concatenate(lines) if lines else np.zeros((0, 3)),
        start=np.cumsum([0, *(len(line) for line in lines)]).astype(np.int32),
        edge=edges.chain[first],
        kind=edges.kind[first],
        part=edges.part[first],
    )
