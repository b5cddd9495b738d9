"""Occluders: boxes and cylinders of all proportions, and CAD parts, made once for a whole data set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import box, circle, prism
from cadcam.dataset.plan import BOX, Occluders, middle_and_radius
from cadcam.render.view import PALETTE, Scene

_SHAPES = 24  # boxes and cylinders to choose from
_SIDES = 48


@dataclass(frozen=True, slots=True, eq=False)
class Prop:
    """An occluder: a scene without edges, the middle (3,) and radius (mm) of the sphere around it, what it is."""

    name: str
    scene: Scene
    middle: Array
    radius: float


def props_of(occluders: Occluders, diameter: float, seed: int) -> tuple[Prop, ...]:
    """Return the possible occluders of a part of this diameter (mm): the same for the same seed."""
    if not occluders.count[1]:
        return ()
    rng = np.random.default_rng([seed, 0x0CC1])
    kinds = [occluders.shapes[i % len(occluders.shapes)] for i in range(_SHAPES)] if occluders.shapes else []
    made = [_shape(kind, occluders.size, diameter, rng) for kind in kinds]
    return tuple(_prop(mesh) for mesh in (*made, *occluders.meshes))


def _shape(kind: str, size: tuple[float, float], diameter: float, rng: np.random.Generator) -> Mesh:
    """Return a box or a cylinder whose diagonal is the share `size` of the part's diameter."""
    sides = rng.uniform(0.15, 1.0, 3)
    sides *= rng.uniform(*size) * diameter / np.linalg.norm(sides)
    color = PALETTE[int(rng.integers(len(PALETTE)))] * rng.uniform(0.3, 1.0)
    paint = (float(color[0]), float(color[1]), float(color[2]))
    if kind == BOX:
        return box((-sides / 2).tolist(), (sides / 2).tolist(), name=BOX, color=paint)
    radius = float(np.hypot(*sides[:2])) / 2
    return prism(circle((0.0, 0.0), radius, _SIDES), -sides[2] / 2, sides[2] / 2, name=kind, color=paint)


def _prop(mesh: Mesh) -> Prop:
    middle, radius = middle_and_radius(mesh)
    return Prop(mesh.part_names[0], Scene.of(mesh, edges=NO_EDGES), middle, radius)
