"""Overlays: what is drawn where, what is left alone, and what the distance to image edges means."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cadcam.arrays import Picture
from cadcam.cad.edges import EdgeKind
from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, SizeMismatch
from cadcam.geometry.rigid import Rigid
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions, Wireframe
from cadcam.render.overlay import (
    KIND_COLORS,
    LineStyle,
    add_pictures,
    blend_pictures,
    edge_distances,
    overlay,
    overlay_on_edges,
    side_by_side,
    write_overlay_svg,
)
from cadcam.render.ray import RayRenderer
from cadcam.render.view import Look, Scene, View

CAMERA = Camera.from_focal((160, 120), 200.0, fy=190.0, cx=70.5, cy=64.2)
POSE = Rigid(np.eye(3), np.array([0.0, 0.0, 400.0]))
CARD = Scene.of(Mesh.single([[-80, -60, 0], [80, -60, 0], [80, 60, 0], [-80, 60, 0]], [[0, 2, 1], [0, 3, 2]]))
GRAY = np.full((120, 160), 0.5, np.float32)


def card_wireframe(pose: Rigid = POSE) -> Wireframe:
    return LineDrawer(CARD).draw(CAMERA, pose)


def card_view(look: Look = Look(supersampling=5)) -> View:  # noqa: B008 - frozen
    return RayRenderer(CARD).render(CAMERA, POSE, look=look)


def test_lines_are_drawn_where_the_edges_project() -> None:
    picture = overlay(GRAY, card_wireframe())
    x, y = CAMERA.project(POSE @ np.array([-80.0, 0.0, 0.0]))
    row = np.abs(picture[round(y)] - 0.5).sum(axis=1)
    near = slice(round(x) - 4, round(x) + 5)
    assert np.average(np.arange(160)[near], weights=row[near]) == pytest.approx(x, abs=0.02)
    assert np.array_equal(picture[5, 5], [0.5, 0.5, 0.5])


def test_lines_have_the_colour_of_their_kind_or_part() -> None:
    picture = overlay(GRAY, card_wireframe(), style=LineStyle(width=3.0))
    x, y = np.rint(CAMERA.project(POSE @ np.array([-80.0, 0.0, 0.0]))).astype(int)
    assert np.allclose(picture[y, x], KIND_COLORS[EdgeKind.BOUNDARY], atol=1e-3)
    single = overlay(GRAY, card_wireframe(), style=LineStyle(color_by="one", color=(0.0, 0.0, 1.0), width=3.0))
    assert np.allclose(single[y, x], [0, 0, 1], atol=1e-3)
    with pytest.raises(BadValue, match="color_by"):
        LineStyle(color_by="length")


@pytest.mark.parametrize(("shape", "remedy"), [((120, 161), "resize"), ((160, 120), "turned by 90 degrees")])
def test_a_photo_of_another_size_is_refused_with_a_remedy(shape: tuple[int, int], remedy: str) -> None:
    photo = np.zeros(shape, np.float32)
    for job in (lambda: overlay(photo, card_wireframe()), lambda: blend_pictures(photo, card_view())):
        with pytest.raises(SizeMismatch, match=remedy):
            job()


def test_a_photo_in_bytes_is_drawn_on_as_it_is() -> None:
    """As OpenCV and cameras give it; divided by 255, it is the same photo."""
    photo, lines = np.full((120, 160, 3), 102, np.uint8), card_wireframe()
    np.testing.assert_array_equal(overlay(photo, lines), overlay(photo / np.float32(255), lines))


def test_blending_leaves_the_background_and_mixes_the_model() -> None:
    view = card_view()
    picture = blend_pictures(GRAY, view, opacity=0.25)
    inside, outside = view.coverage == 1, view.coverage == 0
    assert inside.any()
    assert outside.any()
    assert np.array_equal(picture[outside], np.full((outside.sum(), 3), 0.5, np.float32))
    assert np.abs(picture[inside] - (0.75 * 0.5 + 0.25 * view.image[inside])).max() < 1e-6
    assert np.array_equal(blend_pictures(GRAY, view, opacity=0.0)[inside], np.full((inside.sum(), 3), 0.5, np.float32))


def test_the_background_colour_of_the_view_does_not_reach_the_blend() -> None:
    white, black = (card_view(Look(background=(v, v, v), supersampling=3)) for v in (1.0, 0.0))
    assert np.abs(blend_pictures(GRAY, white) - blend_pictures(GRAY, black)).max() < 1e-6
    assert np.abs(add_pictures(GRAY, white) - add_pictures(GRAY, black)).max() < 0.02  # ranks of nearly equal values


def test_the_added_picture_has_a_flat_histogram(rng: np.random.Generator) -> None:
    photo = rng.random((120, 160)).astype(np.float32) ** 3
    levels = np.histogram(add_pictures(photo, card_view()), bins=8, range=(0, 1))[0]
    assert levels.min() > 0.8 * photo.size / 8


def test_canny_edges_are_white_under_the_wireframe() -> None:
    photo = np.zeros((120, 160), np.float32)
    photo[:, 20:] = 1.0  # an edge away from the card
    picture = overlay_on_edges(photo, card_wireframe(), style=LineStyle(color_by="one", color=(1.0, 0.0, 0.0)))
    assert (picture[10:110, 19:21].max(axis=1) == 1.0).all()
    x, y = np.rint(CAMERA.project(POSE @ np.array([-80.0, 0.0, 0.0]))).astype(int)
    assert picture[y, x, 0] > picture[y, x, 1] + 0.3
    assert overlay_on_edges(GRAY, card_wireframe())[y, x].max() < 0.2  # black lines as in the thesis, unless asked


def test_side_by_side_keeps_both_pictures_apart() -> None:
    picture = side_by_side(GRAY, np.zeros((120, 30, 3), np.float32), gap=4)
    assert picture.shape == (120, 160 + 4 + 30, 3)
    assert (picture[:, 160:164] == 1).all()
    with pytest.raises(BadValue, match="picture height"):
        side_by_side(GRAY, GRAY[:50])


def test_distances_to_image_edges_measure_a_planted_shift() -> None:
    """The card moved by a whole 1 px and 0.3 px sideways: a quarter of pixel profiles say so within 0.05 px."""
    photo: Picture = card_view().gray
    for shift in (0.0, 0.3, 1.0):
        moved = Rigid(np.eye(3), np.array([shift * 400.0 / CAMERA.fx, 0.0, 400.0]))
        wireframe = card_wireframe(moved)
        upright = np.abs(wireframe.visible.points_along(1.0)[1][:, 0]) > 0.9
        distance = edge_distances(photo, wireframe)
        assert len(distance) == pytest.approx(len(upright), abs=4)
        assert np.median(distance[upright]) == pytest.approx(shift, abs=0.06)


def test_the_svg_holds_the_lines_half_a_pixel_from_the_corner_and_the_photo(tmp_path: Path) -> None:
    wireframe = card_wireframe()
    write_overlay_svg(tmp_path / "card.svg", wireframe, photo=GRAY)
    text = (tmp_path / "card.svg").read_text()
    assert "data:image/jpeg;base64," in text
    x, y = (float(v) for v in re.search(r'<path d="M([\d.]+) ([\d.]+)L', text).groups())
    assert np.hypot(*(wireframe.visible.q - [x - 0.5, y - 0.5]).T).min() < 1e-3


def test_hidden_lines_are_dashed_and_fainter() -> None:
    box = Scene.of(Mesh.single(*_box()))
    pose = Rigid.look_at([250.0, 200.0, 220.0], [30.0, 30.0, 30.0])
    drawer = LineDrawer(box)
    plain = drawer.draw(CAMERA, pose)
    dashed = drawer.draw(CAMERA, pose, options=LineOptions(hidden=True))
    more = np.abs(overlay(GRAY, dashed) - overlay(GRAY, plain)).sum(axis=2) > 0.01
    assert 0 < more.sum() < 0.9 * dashed.hidden.length_px.sum() * 3


def _box() -> tuple[list[list[int]], list[list[int]]]:
    vertices = [[x, y, z] for z in (0, 60) for y in (0, 60) for x in (0, 60)]
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    return vertices, [[q[i] for i in t] for q in quads for t in ((0, 1, 2), (0, 2, 3))]
