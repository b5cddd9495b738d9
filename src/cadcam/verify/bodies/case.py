"""What is inspected, and how; and what of the part is near one of its bodies, drawn without the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.cad.contact import contact_tolerance
from cadcam.cad.edges import NO_EDGES, FeatureEdges, feature_edges
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.view import Scene
from cadcam.verify.bodies.likelihood import window_of
from cadcam.verify.bodies.redrawn import moved_apart
from cadcam.verify.bodies.stages import Stages, untold
from cadcam.verify.edges.shown import in_window, may_show
from cadcam.verify.tolerances.tolerance import Tolerances


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """What is inspected, and how.

    freedom (6, k): motions that are free; reach_px: how far bodies are searched for; alarms: accepted share of false
    ones; tell: called with how far it has come; apart: some of the part's bodies alone, as far as drawn; edges: theirs.
    """

    part: Part
    photos: Sequence[Photo]
    world_from_part: Rigid
    asked: Tolerances
    freedom: Array
    reach_px: float
    alarms: float
    tell: Stages = untold
    edges: dict[bytes, FeatureEdges] = field(default_factory=dict)
    apart: dict[tuple[bytes, bytes], Part] = field(default_factory=dict)

    def alone(self, parts: Mask, by: Array) -> Part:
        """Return these parts (P,) without the others, drawn displaced `by` (P, 3) mm.

        In the same places they are drawn once. Their edges are computed once: as in `redrawn`, they are those of the
        CAD.
        """
        key, places = parts.tobytes(), by[parts].tobytes()
        if (key, places) not in self.apart:
            whole = self.part.scene.mesh
            mesh = whole.select(parts[whole.part])
            if key not in self.edges:
                self.edges[key] = feature_edges(mesh, contact_tolerance_mm=contact_tolerance(whole))
            moved = moved_apart(mesh, by) if by[parts].any() else None
            self.apart[key, places] = Part(Scene.of(moved or mesh, edges=self.edges[key]))
        return self.apart[key, places]

    def beside(self, drawn: Part, body: int, by: Sequence[Array]) -> list[Part]:
        """Return what photos show near a body of the `drawn` part, with each of the displacements `by` (P, 3) mm.

        They are those of `drawn` but for the body's. No drawing where bodies share vertices; without edges.
        """
        scene, own = self.part.scene, self.part.scene.mesh.part == body
        p = scene.mesh.vertices[np.unique(scene.mesh.faces[own])]
        places, kept = np.concatenate([p + each[body] for each in by]), own
        for photo in self.photos:
            window = window_of(photo, self.world_from_part, places)
            if window is not None:
                camera, pose = photo.camera.crop(*in_window(window)), photo.camera_from_world @ self.world_from_part
                kept = kept | may_show(drawn.scene.mesh, camera, pose)
        mesh, paint = scene.mesh.select(kept), scene.paint[kept]
        meshes = [moved_apart(mesh, each) for each in by]
        return [Part(Scene(m, NO_EDGES, scene.colors, paint)) for m in meshes if m is not None]
