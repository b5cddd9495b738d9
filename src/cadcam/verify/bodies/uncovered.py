"""Edges that a body hides as long as it is there: if they are seen, it is missing, or displaced."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.deviations.measured import MeasuredEdges
from cadcam.verify.edges.association import associated, nearby_edges, on_other_lines, searchable
from cadcam.verify.edges.presence import EdgeEvidence, edge_visibility, log_ratio
from cadcam.verify.edges.shown import ShownFaces, in_window, may_show
from cadcam.verify.edges.sightlines import REACH_PX, STEP_PX, Sightlines, sightlines
from cadcam.verify.edges.surroundings import edge_surroundings
from cadcam.verify.edges.survey import Survey

_ON_PX = 0.5  # largest distance of an edge from a line that may be what was measured
_INSIDE_PX = 3.0  # px to each side of the line that must lie on the body that hides it
_ROOM_PX = int(2 * (REACH_PX + STEP_PX))  # around a body: as far as a place looks for other lines, and their cells


def around(drawn: Part, photos: Sequence[Photo], world_from_part: Rigid, body: int, survey: Survey) -> Mask:
    """Return the parts (P,), part number `body` apart, of which something may show where that is, or would without it.

    What is farther away neither hides nor draws a line there: of a large model the rest need not be looked at.
    """
    mesh = drawn.scene.mesh
    seen = np.zeros(mesh.n_faces, bool)
    for photo, shown in zip(photos, survey.shown, strict=True):
        window = shown.window(body, _ROOM_PX)
        if window is not None:
            seen |= may_show(mesh, photo.camera.crop(*in_window(window)), photo.camera_from_world @ world_from_part)
    out = np.zeros(len(mesh.part_names), bool)
    out[mesh.part[seen]] = True
    out[body] = False
    return out


def uncovered_ratio(
    drawn: Part, near: Part, photos: Sequence[Photo], world_from_part: Rigid, body: int, survey: Survey
) -> float:
    """Return what the edges behind part number `body` add to the log likelihood ratio of "present" to "absent".

    drawn: the part that the survey is of; near: its parts `around` that body alone.
    """
    lines, sights = sightlines(near, photos, world_from_part)
    behind = _behind(survey.shown, body, lines) & searchable(lines, [photo.camera for photo in photos])
    if not behind.any():
        return 0.0
    every = zip(survey.shown, photos, strict=True)
    shown = [seen.uncovered(drawn, photo, world_from_part, body) for seen, photo in every]
    beside = edge_surroundings(photos, shown, lines)
    found = nearby_edges(lines, sights, reach_px=2.0, way=beside.way)
    matched = associated(lines, sights, found, np.where(behind, 0, -1), reach_px=1.0)
    own = EdgeEvidence.of(lines, behind, matched, beside)
    seen = edge_visibility(survey.evidence, np.ones(len(survey.evidence.seen), bool))
    return -log_ratio(own, np.ones(len(own.seen), bool), seen, survey.clutter.share)


def taken_for_its_own(
    near: Part, photos: Sequence[Photo], world_from_part: Rigid, measured: MeasuredEdges, rows: Mask, by: Array
) -> Mask:
    """Return which of the places `rows` (n,) of a displaced body are of edges that may be lines of what it hides.

    As it moves aside these show, and where they are stronger, its own edges beside them do not. near: the parts
    `around` that body alone; by (3,) mm: where it is drawn.
    """
    lines, _ = sightlines(near, photos, world_from_part)
    its = measured.lines.select(rows)
    offset = measured.adjustment.offset[rows] - its.by_point @ by
    on = on_other_lines(its, offset, its.part, lines, lines.part, within_px=_ON_PX)
    n = int(its.edge.max(initial=-1)) + 1
    out = np.zeros(len(rows), bool)
    out[rows] = (2 * np.bincount(its.edge, on, n) > np.bincount(its.edge, minlength=n))[its.edge]
    return out


def _behind(shown: Sequence[ShownFaces], body: int, lines: Sightlines) -> Mask:
    """Return which places (N,) the body hides, with some margin."""
    out = np.zeros(len(lines), bool)
    for i, seen in enumerate(shown):
        mask = seen.shows(body)
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
