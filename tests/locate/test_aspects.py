"""Aspects: an even net of views, each with the edges that are visible from there."""

from __future__ import annotations

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.views.aspects import sphere_net
from cadcam.locate.views.pieces import PLACES

from ..cad.solids import box

CUBE = Part.of(box([0, 0, 0], [100, 100, 100]))


def test_the_net_is_even() -> None:
    net = sphere_net(400)
    assert np.allclose(np.linalg.norm(net, axis=1), 1, atol=1e-12)
    nearest = np.degrees(np.arccos(np.partition(net @ net.T, -2, axis=1)[:, -2]))
    assert nearest.min() > 6
    assert nearest.max() < 12
    assert np.linalg.norm(net.mean(axis=0)) < 0.01


def test_the_nearest_view_is_found_to_within_a_cell(rng: np.random.Generator) -> None:
    aspects = CUBE.aspects
    eyes = rng.normal(size=(500, 3))
    eyes = aspects.centre + 700.0 * eyes / np.linalg.norm(eyes, axis=1, keepdims=True)
    number, step = aspects.nearest(eyes)
    best = np.max((eyes - aspects.centre) / 700.0 @ aspects.net.T, axis=1)
    own = np.einsum("ij,ij->i", (eyes - aspects.centre) / 700.0, aspects.net[number])
    assert np.degrees(np.arccos(np.clip(own, -1, 1)) - np.arccos(np.clip(best, -1, 1))).max() < 3.5
    assert len(set(step.tolist())) == 1


def test_a_cube_shows_nine_edges_to_a_corner() -> None:
    aspects = CUBE.aspects
    number, step = aspects.nearest(aspects.centre + np.array([[500.0, 510.0, 490.0]]))
    aspect = aspects.aspect(int(number[0]), int(step[0]))
    assert len(np.unique(aspect.line)) == 9
    assert len(aspect.places) == PLACES


def test_places_lie_on_edges_that_the_eye_sees() -> None:
    aspects = CUBE.aspects
    aspect = aspects.aspect(57, 2)
    p = aspect.places["p"].astype(float)
    on = np.sort(np.minimum(np.abs(p), np.abs(p - 100)), axis=1)
    assert on[:, 1].max() < 1e-3  # two of three coordinates on the faces
    eye = aspects.centre + aspect.distance * aspect.direction
    towards = [(0, 0.0, -1), (0, 100.0, 1), (1, 0.0, -1), (1, 100.0, 1), (2, 0.0, -1), (2, 100.0, 1)]
    facing = np.zeros(len(p), int)
    for axis, at, sign in towards:
        facing += (np.abs(p[:, axis] - at) < 1e-3) & (sign * (eye[axis] - at) > 0)
    assert facing.min() >= 1
    assert np.allclose(np.linalg.norm(aspect.places["tangent"], axis=1), 1, atol=1e-6)


def test_any_first_places_are_spread_as_all_are() -> None:
    aspect = CUBE.aspects.aspect(100, 2)
    counts = [np.bincount(aspect.line[:n], minlength=aspect.line.max() + 1) / n for n in (64, PLACES)]
    assert np.abs(counts[0] - counts[1]).max() < 0.04


def test_an_aspect_is_made_once() -> None:
    assert CUBE.aspects.aspect(3, 1) is CUBE.aspects.aspect(3, 1)


def test_the_middle_of_the_part_is_seen_where_it_is() -> None:
    pose = Rigid.look_at([900, 700, 400], CUBE.aspects.centre)
    q = Camera.from_focal((101, 101), 80.0).project(pose @ CUBE.aspects.centre)
    assert np.allclose(q, 50, atol=1e-9)
