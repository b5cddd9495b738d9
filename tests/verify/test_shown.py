"""What a part shows in each pixel: what a renderer draws there, in a window as in the whole picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Ideal
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Scene
from cadcam.verify.bodies.redrawn import redrawn
from cadcam.verify.bodies.tones import Tones
from cadcam.verify.edges import shown as shown_module
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


@pytest.mark.parametrize(
    ("lens", "pose"),
    [
        (BrownConrady(k1=-0.25, k2=0.07, p1=1e-3), POSE),
        (BrownConrady(k1=0.3), POSE),
        (BrownConrady(k1=-0.25, k2=0.07), Rigid.look_at((-100.0, 0.0, 60.0), (120.0, 10.0, 12.0))),  # amid the part
    ],
)
def test_faces_that_no_sight_of_a_window_meets_are_not_drawn_and_nothing_else_is_lost(
    lens: BrownConrady, pose: Rigid, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    drawn: list[int] = []

    def opened(scene: Scene) -> object:
        drawn.append(scene.mesh.n_faces)
        return open_renderer(scene)

    camera = Camera.from_focal((480, 360), 380.0, lens=lens)
    shot = Photo.of(np.zeros((360, 480), np.float32), camera)
    whole = ShownFaces.of(part(), shot, pose)
    monkeypatch.setattr(shown_module, "open_renderer", opened)
    for _ in range(40):
        x, y = rng.integers(0, (440, 320))
        window = slice(int(y), int(y) + 30), slice(int(x), int(x) + 25)
        inside = ShownFaces.of(part(), shot, pose, window=window)
        np.testing.assert_array_equal(inside.part[inside.face], whole.part[whole.face][window])
        np.testing.assert_array_equal(inside.normal[inside.face], whole.normal[whole.face][window])
    assert min(drawn) < plate().n_faces / 2


def test_a_part_without_its_only_body_shows_nothing_and_that_is_no_error(rng: np.random.Generator) -> None:
    alone, shot = Part.of(box((-60, -60, 0), (60, 60, 50), name="block")), photo(plate(), rng)
    assert not ShownFaces.of(alone, shot, Rigid(), without=0).face.any()
    shown = [ShownFaces.of(alone, shot, Rigid())]
    assert np.isfinite(Tones(alone, [shot], Rigid(), shown).log_ratio(0))


@pytest.mark.parametrize("lens", [Ideal(), BrownConrady(k1=-0.25, k2=0.07)])
@pytest.mark.parametrize("mm", [3.0, 60.0, 4000.0])
def test_a_body_elsewhere_is_drawn_where_it_is_and_was_alone(
    lens: Ideal | BrownConrady, mm: float, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """What is seen is what a drawing of the whole shows, to the bit; 4 m off the body is out of the picture."""
    shot = Photo.of(photo(plate(), rng).gray, replace(CAMERA, lens=lens), POSE)
    still = ShownFaces.of(part(), shot, Rigid())
    asked: list[object] = []
    of = ShownFaces.of.__func__  # type: ignore[attr-defined]
    monkeypatch.setattr(ShownFaces, "of", classmethod(lambda *a, **k: asked.append(k["window"]) or of(*a, **k)))
    for body in range(len(plate().part_names)):
        shift = np.zeros((len(plate().part_names), 3))
        shift[body, 1] = mm
        drawn = redrawn(part(), shift)
        assert drawn is not None
        told, whole = still.moved(drawn, shot, Rigid(), body), of(ShownFaces, drawn, shot, Rigid())
        for name in ("part", "color", "surface", "normal"):
            np.testing.assert_array_equal(getattr(told, name)[told.face], getattr(whole, name)[whole.face])
    assert len(asked) == len(plate().part_names)  # each in a window
