"""The part drawn with displaced bodies where they appear to be, so that edges are searched for there.

A body some pixels off its place hides other edges than in the CAD, shows other ones of its own, and its edges cross
those of its neighbours on the way there: seen from its nominal place they are mistaken for each other. Once it is drawn
where it is, none of this remains, and its edges are as near to their lines as those of bodies in place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.locate.part import Part
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges, of_known_size
from cadcam.verify.edges.survey import Survey

AGREES_PX = 1.0  # accuracy to which a body is drawn where it was found: enough to tell its edges from others


def redrawn(part: Part, by: Array) -> Part | None:
    """Return the part with each of its bodies moved by `by` (P, 3) mm; None where bodies share vertices."""
    mesh = part.scene.mesh
    owner = np.full(len(mesh.vertices), -1, np.int64)
    owner[mesh.faces.ravel()] = np.repeat(mesh.part, 3)
    if (owner[mesh.faces] != mesh.part[:, None]).any():
        return None
    vertices = mesh.vertices + np.where(owner[:, None] >= 0, by[owner], 0.0)
    return Part(replace(part.scene, mesh=replace(mesh, vertices=vertices)))


def displaced(measured: MeasuredEdges, number: int) -> Displacement | None:
    """Return the displacement of a feature, as far as its size was measured."""
    return of_known_size(measured.moved(number)) if measured.members[number].any() else None


def off_px(survey: Survey, rows: Mask, by: Array) -> float:
    """Return by how many px, at most, a displacement (3,) mm moves the lines of places `rows` (N,) in the photos."""
    return float(np.abs(survey.lines.by_point[rows] @ by).max(initial=0.0))
