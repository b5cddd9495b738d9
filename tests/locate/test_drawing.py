"""What a part shows in small pictures is what it shows exactly, whoever is drawn beside it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.cad.parts import machined_bracket, ship_block
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.views.aspects import Aspect
from cadcam.locate.views.drawing import FILLED, SIZE
from cadcam.render.lines.wireframe import Polylines

from ..cad.solids import prism

PARTS = {"bracket": machined_bracket, "block": lambda: ship_block(triangles=5000), "cylinder": lambda: prism(96)}


def exactly(part: Part, aspect: Aspect) -> tuple[Camera, Rigid, Polylines]:
    """Return the camera that drew an aspect, camera_from_part, and the part's visible lines without any picture."""
    centre, r = part.aspects.centre, part.aspects.radius
    up = np.eye(3)[np.argmin(np.abs(aspect.direction))]
    pose = Rigid.look_at(centre + aspect.distance * aspect.direction, centre, up=up)
    camera = Camera.from_focal((SIZE, SIZE), FILLED * SIZE / 2 * math.sqrt(aspect.distance**2 - r**2) / r)
    return camera, pose, part.lines.draw(camera, pose).visible


def away(q: Array, lines: Array) -> Array:
    """Return how far points q (N, 2) are from the nearest of lines (M, 2) given as points close to each other."""
    return np.array([np.hypot(*(lines - one).T).min() for one in q])


@pytest.mark.parametrize("name", PARTS)
def test_places_lie_on_what_is_visible_and_on_all_of_it(name: str) -> None:
    """To two pixels: of plates that are no thicker, as the block's, both sides may show."""
    part = Part.of(PARTS[name]())
    for key in ((5, 0), (111, 1), (250, 2), (333, 1)):
        aspect = part.aspects.aspect(*key)
        camera, pose, visible = exactly(part, aspect)
        drawn, *_ = visible.points_along(0.25)
        q = camera.project(pose @ aspect.places["p"].astype(float))
        assert np.mean(away(q, drawn) < 2.0) > 0.95
        step = aspect.length * FILLED * SIZE / len(q)
        assert np.mean(away(drawn[::20], q) < 2.0 + step) > 0.95
        exact = visible.length_px[visible.length_px > 0.004 * SIZE].sum() / (FILLED * SIZE)
        assert aspect.length > 0.96 * exact
        assert name == "block" or aspect.length < 1.06 * exact


def test_an_aspect_does_not_depend_on_which_are_made_with_it() -> None:
    mesh = machined_bracket()
    alone, together = Part.of(mesh).aspects, Part.of(mesh).aspects
    made: list[None] = []
    keys = [(k, 1) for k in range(40)]
    together.make(keys, lambda: made.append(None))
    assert len(made) == 40
    together.make(keys, lambda: made.append(None))
    assert len(made) == 40
    for key in keys[::7]:
        one, other = alone.aspect(*key), together.made[key]
        assert one.places.tobytes() == other.places.tobytes()
        assert np.array_equal(one.line, other.line)
        assert one.telling.tobytes() == other.telling.tobytes()
        assert one.length == other.length
