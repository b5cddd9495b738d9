"""What a part shows in each pixel: what a renderer draws there, in a window as in the whole picture."""

from __future__ import annotations

import numpy as np

from cadcam.cad.parts.shape import box
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.render import open_renderer
from cadcam.render.view import Channel
from cadcam.verify.bodies.tones import Tones
from cadcam.verify.edges.shown import ShownFaces

from .scene import CAMERA, POSE, part, photo, plate

WINDOW = (slice(90, 260), slice(120, 333))
EPS32 = float(np.finfo(np.float32).eps)


def test_it_is_what_a_renderer_draws(rng: np.random.Generator) -> None:
    """Normals to a few roundings of the float32 in which the renderer gives them."""
    shown = ShownFaces.of(part(), photo(plate(), rng), Rigid())
    view = open_renderer(part().scene).render(CAMERA, POSE, channels=Channel.NORMAL | Channel.PART)
    np.testing.assert_array_equal(shown.part[shown.face], view.part)
    np.testing.assert_allclose(shown.normal[shown.face] @ POSE.rotation.T, view.normal, atol=8 * EPS32)
    for body in range(len(plate().part_names)):
        np.testing.assert_array_equal(shown.shows(body), view.part == body)


def test_a_window_shows_what_the_whole_picture_shows_there(rng: np.random.Generator) -> None:
    shot = photo(plate(), rng)
    for without in (-1, plate().part_names.index("block")):
        whole, window = (ShownFaces.of(part(), shot, Rigid(), without=without, window=w) for w in (None, WINDOW))
        np.testing.assert_array_equal(window.part[window.face], whole.part[whole.face][WINDOW])
        np.testing.assert_array_equal(window.normal[window.face], whole.normal[whole.face][WINDOW])


def test_a_part_without_its_only_body_shows_nothing_and_that_is_no_error(rng: np.random.Generator) -> None:
    alone, shot = Part.of(box((-60, -60, 0), (60, 60, 50), name="block")), photo(plate(), rng)
    assert not ShownFaces.of(alone, shot, Rigid(), without=0).face.any()
    shown = [ShownFaces.of(alone, shot, Rigid())]
    assert np.isfinite(Tones(alone, [shot], Rigid(), shown).log_ratio(0))
