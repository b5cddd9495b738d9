"""Borders for which no line is drawn: where a body sinks into another and hides its edges, and where a fillet begins.

Such a border shows in the photo as edges do, and nearly parallel to some: the side of a nut that has sunk by half its
height ends in no line of the model, nor does a strip of wall before the fillet at its foot, which joins it smoothly.
Nearer to a line than other lines may be, it shifts the step that is measured there. So it takes away room like a line
that is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.edge_kind import EdgeKind
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.verify.edges.sightlines import Sightlines

_ASIDE = np.array([0.25, 0.75, 1.25, 1.75, 2.5, 3.25, 4.0])  # px from a line at which it is asked which body shows
# Degrees per px by which a surface turns that is no slope of the brightness beside an edge, but another step: a fillet
# of 4 px. Over 1 px at least, that is over two of the places above, so that one facet of 12 degrees does not.
_FILLET_DEG = 12.0
_ROUND = 1.0  # px beside a contour within which it says nothing: a line along facets is no nearer to their border


def room_beside(part: Part, sights: Sequence[Sight], lines: Sightlines) -> Array:
    """Return the distance (N,) px across each place's line to the next other line or undrawn border."""
    room, normals = lines.room.copy(), part.scene.mesh.face_normals
    for i, sight in enumerate(sights):
        rows = np.flatnonzero(lines.photo == i)
        drawn = sight.samples.below, sight.samples.above
        for beside, side in zip(drawn, (-1.0, 1.0), strict=True):
            face = _shown(part, sight, lines.q[rows] + _ASIDE[:, None, None] * side * lines.normal[rows])
            body = np.where(face >= 0, part.scene.mesh.part[face], -1)
            away, contour = np.broadcast_to(_ASIDE[:, None], face.shape), lines.kind[rows] == EdgeKind.CONTOUR
            same = ((body[1:] == body[:-1]) & (contour | _even(face, normals))) | (away[1:] >= beside)
            same |= contour & (away[:-1] < _ROUND)
            first = np.argmin(same, axis=0)
            room[rows] = np.minimum(room[rows], np.where(same.all(axis=0), np.inf, _ASIDE[first]))
    return room


def _even(face: Longs, normals: Array) -> Mask:
    """Return whether the surface is even from each of places (k, n) beside lines to the next (k - 1, n)."""
    n, there = normals[face], face >= 0
    cosine = np.einsum("kni,kni->kn", n[2:], n[:-2])
    most = np.cos(np.radians(_FILLET_DEG * (_ASIDE[2:] - _ASIDE[:-2])))[:, None]
    first = np.ones((1, face.shape[1]), bool)
    return np.concatenate([first, (cosine >= most) | ~there[2:] | ~there[:-2]])


def _shown(part: Part, sight: Sight, q: Array) -> Longs:
    """Return the number of the face that shows at places (..., 2) px of a photo, -1 for none."""
    camera_from_part, caster = sight.photo.camera_from_world @ sight.drawn, part.caster
    eye, ray = camera_from_part.origin, sight.photo.camera.unproject(q.reshape(-1, 2)) @ camera_from_part.rotation
    away = float(np.linalg.norm(eye - caster.center))
    start = eye + max(away - 2 * caster.radius, 0.0) * ray
    face = caster.first_hit(start, ray, np.full(len(ray), away + 4 * caster.radius))
    return np.asarray(face, np.int64).reshape(q.shape[:-1])
