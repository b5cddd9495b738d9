"""The part drawn with displaced bodies where they appear to be, so that edges are searched for there.

A body some pixels off its place hides other edges than in the CAD, shows other ones of its own, and its edges cross
those of its neighbours on the way there: seen from its nominal place they are mistaken for each other. Once it is drawn
where it is, none of this remains, and its edges are as near to their lines as those of bodies in place.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.mesh import Mesh
from cadcam.locate.part import Part
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.view import Scene
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges, of_known_size
from cadcam.verify.edges.survey import Survey

AGREES_PX = 1.0  # accuracy to which a body is drawn where it was found: enough to tell its edges from others


class RedrawnPart(Part):
    """A part with its bodies moved as wholes: it takes over from it `still` standing what does not depend on places."""

    def __init__(self, still: Part, scene: Scene) -> None:
        super().__init__(scene)
        self._still = still

    @cached_property
    def lines(self) -> LineDrawer:
        """The drawer of the part's visible lines, from any viewpoint."""
        return LineDrawer(self.scene, like=self._still.lines)

    @cached_property
    def rims(self) -> Longs:
        """The rim (C,) that each chain of its edges is of: arcs of one circle are one."""
        return self._still.rims

    @cached_property
    def bores(self) -> Longs:
        """The hole or pin (C,) that each chain of its edges is a rim of; of others the chain itself."""
        return self._still.bores


def redrawn(part: Part, by: Array) -> Part | None:
    """Return the part with each of its bodies moved by `by` (P, 3) mm; None where bodies share vertices."""
    mesh = moved_apart(part.scene.mesh, by)
    return None if mesh is None else RedrawnPart(part, replace(part.scene, mesh=mesh))


def moved_apart(mesh: Mesh, by: Array) -> Mesh | None:
    """Return the mesh with each of its parts moved by `by` (P, 3) mm; None where parts share vertices."""
    owner = np.full(len(mesh.vertices), -1, np.int64)
    owner[mesh.faces.ravel()] = np.repeat(mesh.part, 3)
    if (owner[mesh.faces] != mesh.part[:, None]).any():
        return None
    return replace(mesh, vertices=mesh.vertices + np.where(owner[:, None] >= 0, by[owner], 0.0))


def displaced(measured: MeasuredEdges, number: int) -> Displacement | None:
    """Return the displacement of a feature, as far as its size was measured."""
    return of_known_size(measured.moved(number)) if measured.members[number].any() else None


def off_px(survey: Survey, rows: Mask, by: Array) -> float:
    """Return by how many px, at most, a displacement (3,) mm moves the lines of places `rows` (N,) in the photos."""
    return float(np.abs(survey.lines.by_point[rows] @ by).max(initial=0.0))
