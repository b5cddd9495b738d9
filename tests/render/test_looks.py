"""Looks: light that both renderers cast alike, colours of parts, and the model cut out of its background."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cadcam.arrays import Picture
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.errors import BadValue, MissingCore, MissingExtra, MissingOpenGL, SizeMismatch, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.native import core
from cadcam.render import RENDERERS, open_renderer
from cadcam.render.cutout import Cutout
from cadcam.render.lines.visible import visible_wireframe
from cadcam.render.looks import LOOKS, named_look, repaint
from cadcam.render.raster import RasterRenderer
from cadcam.render.ray import RayRenderer
from cadcam.render.standard_view import standard_view
from cadcam.render.view import Channel, Look, Scene, View

SIZE = (160, 120)
BRACKET = Scene.of(machined_bracket())
CAMERA, POSE = standard_view(BRACKET.mesh, size=SIZE)
BENT = Camera(SIZE, CAMERA.K, lens=BrownConrady(k1=-0.2))


def seen(look: Look = Look(supersampling=3), scene: Scene = BRACKET) -> View:  # noqa: B008 - frozen
    return RayRenderer(scene).render(CAMERA, POSE, channels=Channel.IMAGE, look=look)


def tilted(degrees: float) -> Scene:
    """A plate in front of a camera at the origin, turned about the y axis so that its right edge comes nearer."""
    a = np.radians(degrees)
    x, z = np.array([np.cos(a), 0, -np.sin(a)]), np.array([0, 1.0, 0])
    p = np.array([[0, 0, 500.0] + 100 * (i * x + j * z) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return Scene.of(Mesh.single(p, [[0, 1, 2], [0, 2, 3]]), colors=[[0.5, 0.5, 0.5]])


@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["plain", "distorted"])
def test_both_renderers_cast_every_light_alike(name: str, camera: Camera) -> None:
    """Float32 shading: a few steps of 6e-8 a light. A light turned or left out by one of them is above 1e-2."""
    try:
        core.library()
    except MissingCore as error:
        pytest.skip(str(error))
    for look in (LOOKS[name], Look(head=0, ambient=0, fill=0, back=1.0), Look(head=0, ambient=0, fill=1.0, back=0)):
        a, b = (kind(BRACKET).render(camera, POSE, look=look) for kind in (RasterRenderer, RayRenderer))
        both = (a.face == b.face) & (a.face >= 0)
        assert both.sum() > 5000
        assert np.abs(a.image[both] - b.image[both]).max() < 1e-5


@pytest.mark.parametrize("degrees", [-70.0, -40.0, 0.0, 40.0, 70.0])
def test_the_light_of_a_face_is_the_sum_of_its_three_lights(degrees: float) -> None:
    """Lambert's law, written out, for a plate whose normal towards the camera is (-sin a, 0, -cos a)."""
    look, a = Look(), np.radians(degrees)
    normal = np.array([-np.sin(a), 0, -np.cos(a)])
    camera = Camera.from_focal((3, 3), 500.0)
    image = RayRenderer(tilted(degrees)).render(camera, Rigid(), channels=Channel.IMAGE, look=look).image
    light = look.ambient + look.head * np.cos(a)
    for strength, towards in ((look.fill, look.fill_from), (look.back, look.back_from)):
        light += strength * max(0.0, normal @ np.array(towards) / np.linalg.norm(towards))
    assert image[1, 1] == pytest.approx(0.5 * light, abs=1e-6)


def test_inspection_leaves_no_face_dark_and_lights_both_sides_alike() -> None:
    look = named_look("inspection")
    assert look.fill == look.back == 0
    assert look.ambient >= 0.5
    camera = Camera.from_focal((3, 3), 500.0)
    left, right = (RayRenderer(tilted(a)).render(camera, Rigid(), look=look).image[1, 1] for a in (-60.0, 60.0))
    assert left == pytest.approx(right, abs=1e-6)


def test_flat_gives_each_part_its_own_colour() -> None:
    view = RayRenderer(BRACKET).render(CAMERA, POSE, look=named_look("flat"))
    assert view.image[view.mask] == pytest.approx(np.broadcast_to(BRACKET.colors[0], (view.mask.sum(), 3)), abs=1e-6)


@pytest.mark.parametrize(
    "wrong", [{"back": -0.1}, {"head": float("nan")}, {"back_from": (0, 0, 0)}, {"fill_from": (float("inf"), 0, 0)}]
)
def test_a_light_that_is_none_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(BadValue):
        Look(**wrong)


def test_an_unknown_look_or_part_is_named_with_the_nearest() -> None:
    with pytest.raises(UnknownName, match="inspection"):
        named_look("inspect")
    with pytest.raises(UnknownName, match="unknown part 'nut'"):
        repaint(BRACKET, [("nut", (1, 0, 0))])


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ({"*": (1, 0, 0)}, "part and colour is the text"),
        (("*", (1, 0, 0)), "part and colour is the text"),
        ([("*", 1, 0, 0)], "is a tuple of 4; expected a pair"),
        ([("*", "#ff0000")], "numbers of shape"),
        ([("*", (255, 0, 0))], "divide bytes by 255"),
    ],
)
def test_a_colour_that_is_none_is_refused(chosen: Any, said: str) -> None:
    with pytest.raises(BadValue, match=said):
        repaint(BRACKET, chosen)


def test_parts_are_repainted_by_name_and_pattern_the_last_one_winning() -> None:
    p = np.concatenate([np.eye(3) + 5 * i for i in range(4)])
    names = ("bolt 1", "bolt 2", "plate", "rib[1]")
    mesh = Mesh.single(p, np.arange(12).reshape(4, 3))
    mesh = replace(mesh, part=np.arange(4), part_names=names, part_colors=np.full((4, 3), 0.25))
    red, blue = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    scene = repaint(Scene.of(mesh), [("bolt*", red), ("bolt 2", blue), ("rib[1]", blue)])
    assert scene.colors.tolist() == [[*red], [*blue], [0.25] * 3, [*blue]]
    assert np.all(Scene.of(mesh).colors == 0.25)


@pytest.mark.parametrize("name", RENDERERS)
def test_faces_show_their_own_colour_and_a_repainted_part_only_its_own(name: str) -> None:
    mesh = BRACKET.mesh
    red = np.arange(mesh.n_faces)[:, None] % 2 == 0
    scene = Scene.of(replace(mesh, face_colors=np.where(red, np.float32([1, 0, 0]), np.float32(np.nan))))
    shown = []
    for painted in (scene, repaint(scene, [("*", (0.0, 0.5, 0.0))])):
        try:
            shown.append(open_renderer(painted, name).render(CAMERA, POSE, look=named_look("flat")))
        except (MissingCore, MissingExtra, MissingOpenGL) as error:
            pytest.skip(str(error))
    view, over = shown
    own = red[view.face, 0] & view.mask
    assert own.any()
    assert np.array_equal(view.image[own], np.broadcast_to(np.float32([1, 0, 0]), (own.sum(), 3)))
    plain = view.mask & ~own
    assert np.allclose(view.image[plain], BRACKET.colors[view.part[plain]], rtol=0, atol=1e-6)
    assert np.allclose(over.image[view.mask], (0, 0.5, 0), rtol=0, atol=1e-6)


def test_laying_the_cutout_over_its_own_background_gives_the_image_back() -> None:
    """A few float32 steps of values up to 1."""
    for color in ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.2, 0.5, 0.9)):
        view = seen(Look(supersampling=3, background=color))
        assert np.abs(Cutout.of(view).over(color) - view.image).max() < 1e-6


def test_the_straight_colour_at_an_outline_is_the_models_and_not_mixed_with_the_background() -> None:
    scene = tilted(30.0)
    view = RayRenderer(scene).render(Camera.from_focal(SIZE, 250.0, cx=80.3), Rigid(), look=Look(supersampling=4))
    cut = Cutout.of(view)
    rim = (cut.alpha > 0) & (cut.alpha < 1)
    assert rim.sum() > 50
    inside = cut.straight[cut.alpha == 1]
    assert cut.straight[rim].min() > inside.min() - 1e-3
    assert cut.straight[rim].max() < inside.max() + 1e-3
    assert not cut.straight[cut.alpha == 0].any()


def test_what_is_rendered_on_black_is_the_model_s_light_without_a_copy() -> None:
    """Of 8000 x 8000 px it would take 768 MB."""
    view = seen(Look(supersampling=3, background=(0.0, 0.0, 0.0)))
    assert np.shares_memory(Cutout.of(view).color, view.image)
    white = seen(Look(supersampling=3, background=(1.0, 1.0, 1.0)))
    assert np.array_equal(Cutout.of(white).color, white.image - (1 - white.coverage)[..., None])


def over(cut: Cutout, background: float) -> Picture:
    return cut.over((background,) * 3)


def test_lines_are_part_of_the_cutout() -> None:
    """Over any background the lines look as if drawn there: on white they are those of `overlay` on the image."""
    from cadcam.render.cutout import SOFT
    from cadcam.render.overlay import overlay

    view = seen(Look(supersampling=3, background=(1, 1, 1)))
    wires = visible_wireframe(BRACKET, CAMERA, POSE)
    cut = Cutout.of(view).with_lines(wires)
    assert np.abs(over(cut, 1.0) - overlay(view.image, wires, style=SOFT)).max() < 1e-5
    assert cut.alpha.max() <= 1
    assert (cut.alpha >= view.coverage - 1e-6).all()
    assert (cut.alpha > view.coverage + 0.1).any(), "the outer half of an outline's line lies beside the model"


def test_a_photo_shows_where_the_model_is_not_and_must_have_the_cameras_size() -> None:
    photo = np.random.default_rng(3).uniform(size=(SIZE[1], SIZE[0], 3)).astype(np.float32)
    view = seen()
    picture = Cutout.of(view).over_photo(photo)
    assert np.array_equal(picture[view.coverage == 0], photo[view.coverage == 0])
    full = view.coverage == 1
    assert np.abs(picture[full] - view.image[full]).max() < 1e-6
    with pytest.raises(SizeMismatch):
        Cutout.of(view).over_photo(photo[:-1])
    with pytest.raises(BadValue):
        Cutout.of(view).over((1, 2, 3))


@pytest.mark.parametrize("samples", [0, 17, 1.5])
def test_samples_of_a_pixel_are_a_whole_number_a_side(samples: float) -> None:
    with pytest.raises(BadValue, match=r"supersampling is .* expected a whole number from 1 to 16"):
        Look(supersampling=samples)  # type: ignore[arg-type]  # the mistake that is tested
