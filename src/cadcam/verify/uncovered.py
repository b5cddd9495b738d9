"""Edges that a part hides as long as it is there: seen, they say that it is not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Scene
from cadcam.verify.association import SEARCH_ROOM_PX, associated, nearby_edges
from cadcam.verify.presence import EdgeEvidence, log_ratio, visibility
from cadcam.verify.sightlines import Sightlines, sightlines
from cadcam.verify.surroundings import surroundings

_INSIDE_PX = 3.0  # across the line, that must lie on the part that hides it


def uncovered_ratio(
    part: Part, photos: Sequence[Photo], world_from_part: Rigid, body: int, evidence: EdgeEvidence, *, clutter: float
) -> float:
    """Return what the edges behind part number `body` add to the log likelihood ratio of "there" to "not there"."""
    mesh = part.scene.mesh
    if (mesh.part == body).all():
        return 0.0
    without = Part(Scene.of(mesh.select(mesh.part != body)))
    lines, sights = sightlines(without, photos, world_from_part)
    behind = _behind(part, photos, world_from_part, body, lines) & (lines.room >= SEARCH_ROOM_PX)
    if not behind.any():
        return 0.0
    beside = surroundings(without, photos, world_from_part, lines)
    found = nearby_edges(lines, sights, reach_px=2.0, way=beside.way)
    matched = associated(lines, sights, found, np.where(behind, 0, -1), reach_px=1.0)
    own = EdgeEvidence.of(lines, behind, matched, beside)
    seen = visibility(evidence, np.ones(len(evidence.seen), bool))
    return -log_ratio(own, np.ones(len(own.seen), bool), seen, clutter)


def _behind(part: Part, photos: Sequence[Photo], world_from_part: Rigid, body: int, lines: Sightlines) -> Mask:
    """Return which places (N,) the part hides, with some room."""
    out = np.zeros(len(lines), bool)
    renderer = open_renderer(part.scene)
    for i, photo in enumerate(photos):
        pose = photo.viewpoint.camera_from_world @ world_from_part
        mask = renderer.render(photo.camera, pose, channels=Channel.PART).part == body
        rows = np.flatnonzero(lines.photo == i)
        inside = np.ones(len(rows), bool)
        for t in (-_INSIDE_PX, 0.0, _INSIDE_PX):
            inside &= _at(mask, lines.q[rows] + t * lines.normal[rows])
        out[rows] = inside
    return out


def _at(mask: Mask, q: Array) -> Mask:
    x, y = np.rint(q).astype(np.int64).T
    height, width = mask.shape
    within = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return np.asarray(within & mask[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)])
