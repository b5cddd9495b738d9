"""A part to be located: its scene, and what is computed from it once."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from cadcam.arrays import Array, Ids, Longs
from cadcam.cad.mesh import Mesh
from cadcam.cad.rims import bore_of_chains, rim_of_chains
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect
from cadcam.locate.views.aspects import Aspects
from cadcam.locate.views.likeness import Likeness, likenesses, mirror_image
from cadcam.locate.views.own_edges import OwnEdges
from cadcam.locate.views.resting import RestingFaces
from cadcam.locate.views.symmetry import chain_images, spins_of, symmetries
from cadcam.render.caster import Caster
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.view import Scene


class Part:
    """The CAD model to be found; create it once and use it for many photos.

    What searches need of it (lines to draw, aspects) is computed on first use and kept.
    """

    def __init__(self, scene: Scene) -> None:
        expect(scene, "scene", Scene)
        self.scene = scene

    @classmethod
    def of(cls, mesh: Mesh) -> Part:
        """Return the part of a mesh (mm) with its feature edges."""
        return cls(Scene.of(mesh))

    @cached_property
    def lines(self) -> LineDrawer:
        """The drawer of the part's visible lines, from any viewpoint."""
        return LineDrawer(self.scene, caster=self.caster)

    @cached_property
    def caster(self) -> Caster:
        """The ray caster on the part's mesh."""
        return Caster(self.scene.mesh)

    @cached_property
    def rims(self) -> Longs:
        """The rim (C,) that each chain of its edges is of: arcs of one circle are one."""
        return rim_of_chains(self.scene.mesh, self.scene.edges)

    @cached_property
    def bores(self) -> Longs:
        """The hole or pin (C,) that each chain of its edges is a rim of; of others the chain itself."""
        return bore_of_chains(self.scene.mesh, self.scene.edges)

    @cached_property
    def paints(self) -> Ids:
        """The number (F,) of each face's colour, equal for equal colours."""
        _, number = np.unique(np.round(self.scene.colors, 3), axis=0, return_inverse=True)
        return np.asarray(number.reshape(-1)[self.scene.paint], np.int32)

    @cached_property
    def aspects(self) -> Aspects:
        """The part's visible edges from every direction, each aspect computed on first use."""
        return Aspects(self.scene)

    @cached_property
    def symmetries(self) -> list[Rigid]:
        """The motions part_from_part in which the part looks the same, the identity first."""
        return symmetries(self.scene.mesh, self.scene.edges)

    @cached_property
    def chain_images(self) -> list[Ids]:
        """For each of the symmetries the chain (C,) that it brings onto each chain of its edges."""
        return chain_images(self.scene.mesh, self.scene.edges, self.symmetries)

    @cached_property
    def spins(self) -> Array:
        """The twists (6, k) of rotations that no photo shows: 1 of a part of revolution, 3 of a ball, else 0."""
        return spins_of(self.scene.mesh, self.scene.edges)

    @cached_property
    def resting(self) -> RestingFaces:
        """The faces that the part may lie on."""
        return RestingFaces.of(self.scene.mesh)

    @cached_property
    def mirrored(self) -> Part:
        """The part's mirror image."""
        return Part(mirror_image(self.scene))

    @cached_property
    def likenesses(self) -> list[Likeness]:
        """Near-symmetries: motions that lay the part, or its mirror image, nearly on itself."""
        return likenesses(self.scene.mesh, self.scene.edges, self.mirrored.scene.mesh)

    @cached_property
    def own_edges(self) -> OwnEdges:
        """Which of the part's edges each of its likenesses has, too."""
        return OwnEdges.of(self.scene.mesh, self.scene.edges, self.mirrored.scene.mesh, self.likenesses)

    def __reduce__(self) -> tuple[type[Part], tuple[Scene]]:
        return type(self), (self.scene,)  # a copy, in another process, say, computes anew what it needs

    def __repr__(self) -> str:
        return f"Part({self.scene!r})"
