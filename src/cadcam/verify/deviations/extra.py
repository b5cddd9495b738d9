"""Edges of the photo, within the part's outline, that no line of the model explains: candidates for foreign matter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry.rigid import Rigid
from cadcam.image.edges import canny
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.lines.wireframe import LineOptions
from cadcam.render.view import Channel, View
from cadcam.verify.deviations.deviation import Extra

# Shorter curves may be texture: of noise whose grain has an sd of up to 2 px, one in 4 Mpx is as long as this, of noise
# of 4 px three are (6 pictures of each grain).
LEAST_PX = 25.0
# How far from a line an edge is the line's own: of 47442 points in 12 pictures of a good block 0.05 % lay more than 3
# px off, 0.01 % more than 4 px, at corners that smoothing rounds.
EXPLAINED_PX = 4.0
_SMOOTHED_PX = 1.5  # as both were counted
_STEP_PX = 1.9  # of neighbours on a curve: above a pixel's diagonal (999 of 1000 are within 1.6), below two pixels
_RIM_PX = int(EXPLAINED_PX)  # inside the part's outline, which is one of its lines


def unexplained(
    part: Part, photos: Sequence[Photo], world_from_part: Rigid, *, shifted: Sequence[Array]
) -> list[Extra]:
    """Return curves, longest first, that lie clear of all model lines and of the places `shifted` (n, 2) px.

    shifted: for each photo, where the edges of displaced features were found.
    """
    out: list[Extra] = []
    renderer = open_renderer(part.scene)
    for i, photo in enumerate(photos):
        camera_from_part = photo.camera_from_world @ world_from_part
        view = renderer.render(photo.camera, camera_from_part, channels=Channel.PART | Channel.DEPTH)
        lines = part.lines.draw(photo.camera, camera_from_part, options=LineOptions(hidden=False)).visible
        explained = np.concatenate([lines.points_along(2.0)[0], shifted[i]])
        out += _in_photo(part, photo, i, camera_from_part, view, explained)
    return sorted(out, key=lambda e: -e.length_px)


def _in_photo(
    part: Part, photo: Photo, number: int, camera_from_part: Rigid, view: View, explained: Array
) -> list[Extra]:
    from scipy.ndimage import binary_erosion
    from scipy.spatial import cKDTree

    edges = canny(photo.gray, sigma=_SMOOTHED_PX)
    if not len(edges):
        return []
    inside = binary_erosion(view.part >= 0, iterations=_RIM_PX)
    x, y = np.clip(np.rint(edges.q), 0, np.array(photo.camera.size) - 1).astype(int).T
    distance = cKDTree(explained).query(edges.q)[0] if len(explained) else np.full(len(edges), np.inf)
    free = inside[y, x] & (distance > EXPLAINED_PX)
    out = []
    for q in _curves(edges.q[free]):
        if len(q) < LEAST_PX:  # one point per pixel
            continue
        middle = q[np.argmin(np.linalg.norm(q - q.mean(axis=0), axis=1))]
        at = int(middle[1] + 0.5), int(middle[0] + 0.5)
        name = part.scene.mesh.part_names[int(view.part[at])] if view.part[at] >= 0 else ""
        out.append(Extra(number, q, float(len(q)), _place(view, camera_from_part, middle), name))
    return out


def _curves(q: Array) -> list[Array]:
    """Return the connected runs of edge points (n, 2)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not len(q):
        return []
    pairs = cKDTree(q).query_pairs(_STEP_PX, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(q), len(q)))
    label = connected_components(graph, directed=False)[1]
    return [q[label == i] for i in np.flatnonzero(np.bincount(label) >= LEAST_PX)]


def _place(view: View, camera_from_part: Rigid, q: Array) -> Array:
    """Return the point (3,) mm of the part that pixel q sees."""
    depth = float(view.depth[int(q[1] + 0.5), int(q[0] + 0.5)])
    ray = view.camera.unproject(q)
    return np.asarray(camera_from_part.inv @ (ray * depth / ray[2]))
