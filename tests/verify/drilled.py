"""A drilled plate with two pins, photographed: holes and pins off their places, of another size, or both."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import circle, extruded, filled
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances

from .scene import photographed

CAMERA = Camera.from_focal((1200, 900), 2250.0)
ABOVE = Rigid.look_at((25.0, -35.0, 560.0), (0.0, 0.0, 5.0))
OBLIQUE = Rigid.look_at((220.0, -400.0, 330.0), (0.0, 0.0, 5.0))
SIDE = Rigid.look_at((-330.0, 240.0, 390.0), (0.0, 0.0, 5.0))
HIGH = 12.0
HOLES = {"A": (-60.0, -35.0, 9.0), "B": (0.0, -35.0, 6.0), "C": (60.0, -35.0, 9.0), "D": (60.0, 35.0, 12.0)}
PINS = {"pin": (-60.0, 30.0, 8.0), "peg": (0.0, 35.0, 6.0)}


@cache
def drilled(sides: int = 192, **wrong: tuple[float, float, float]) -> Mesh:
    """Return the plate of 200 x 140 x 12 mm; wrong: by how much holes and pins are off in x, y and radius, mm."""

    def round_(name: str) -> Array:
        x, y, r = np.add((HOLES | PINS)[name], wrong.get(name, (0.0, 0.0, 0.0)))
        return circle((x, y), r, sides)

    outline = np.array([(-100, -70), (100, -70), (100, 70), (-100, 70)], float)
    color = (0.55, 0.55, 0.6)
    plate = extruded([filled(outline, [round_(name) for name in HOLES])], 0, HIGH, name="plate", color=color)
    pins = [extruded([filled(round_(name))], HIGH, 30, name=name, color=color) for name in PINS]
    return merge([plate, *pins])


@cache
def part(sides: int = 192) -> Part:
    return Part.of(drilled(sides))


def around(name: str, low: float = -1.0, high: float = HIGH + 1) -> Selection:
    """Return the edges of a hole: both rims, or those between two heights (mm)."""
    x, y, r = HOLES[name]
    return Selection("plate", box=np.array([[x - r - 3, y - r - 3, low], [x + r + 3, y + r + 3, high]]))


def selected(name: str) -> Selection:
    return around(name) if name in HOLES else Selection(name)


def verified(
    mesh: Mesh,
    limits: Sequence[Limit],
    *places: Rigid,
    names: Sequence[str] = (),
    seed: int = 1,
    sides: int = 192,
    camera: Camera = CAMERA,
) -> Verification:
    """Return the verdict on the plate, photographed as `mesh`; names: of what has limits, by default all."""
    rng = np.random.default_rng(seed)
    shots = [Photo.of(photographed(mesh, rng, at, camera), camera, at, name=f"{i}") for i, at in enumerate(places)]
    features = [Feature(name, selected(name), tuple(limits)) for name in names or (*HOLES, *PINS)]
    model = part(sides)
    return verify_part(model, shots, refine_pose(model, shots, Rigid()), Tolerances(tuple(features)))


def within(mm: float) -> Limit:
    """Return a limit of a position across the holes' axis."""
    return Limit(Quantity.POSITION, mm, axis=np.array([0.0, 0.0, 1.0]))
