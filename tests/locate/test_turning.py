"""Parts with rings of holes: turned by a hole, or turned over and by a hole, they look nearly the same."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box, circle, extruded, filled
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.locate.freedom import FREE
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.apart import Apart
from cadcam.locate.refine.options import EDGES
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.rivals import Rivals
from cadcam.locate.views.turning import turns_onto
from cadcam.render import open_renderer
from cadcam.render.view import Scene

CAMERA = Camera.from_focal((640, 480), 1000.0)
RADIUS, THICK, HOLES = 46.0, 9.0, 5
PITCH = 2 * np.pi / HOLES


@cache
def flange() -> Mesh:
    """Return a disc with a ring of five holes and a block on one side, off its middle."""
    angles = PITCH * np.arange(HOLES)
    holes = [circle((32 * np.cos(a), 32 * np.sin(a)), 6.0, 64) for a in angles]
    disc = extruded([filled(circle((0, 0), RADIUS, 256), holes)], 0, THICK, name="disc", color=None)
    return merge([disc, box((-12, -9, THICK), (14, 8, 24), name="block")])


@cache
def flange_part() -> Part:
    """Return the part, whose look-alikes are found once."""
    return Part.of(flange())


def turned(by: int, *, over: bool) -> Rigid:
    """Return the motion that turns the disc onto itself: over, about the axis of its first hole, and by some holes."""
    flip = Rigid(np.diag([1.0, -1.0, -1.0]), np.array([0, 0, THICK])) if over else Rigid()
    return Rigid(exp(np.array([0, 0, by * PITCH]))) @ flip


def photo_of(mesh: Mesh, pose: Rigid) -> Photo:
    image = open_renderer(Scene.of(mesh)).render(CAMERA, pose).image.mean(axis=2)
    noisy = image * 0.8 + 2 / 255 * np.random.default_rng(0).standard_normal(image.shape)
    return Photo.of(np.clip(noisy, 0, 1).astype(np.float32), CAMERA)


def looking() -> Rigid:
    return Rigid.look_at(np.array([60.0, -230.0, 260.0]), np.array([0, 0, 8.0]))


@pytest.mark.parametrize("over", [False, True])
def test_turned_by_any_hole_on_either_side_it_is_a_likeness(over: bool) -> None:
    """No hole of five but the first is where a quarter turn leads to. Edges are compared to a hundredth of the size."""
    part, mesh = flange_part(), flange()
    for by in range(0 if over else 1, HOLES):
        wanted = turned(by, over=over) @ mesh.vertices
        off = [np.abs(o.motion @ mesh.vertices - wanted).max() for o in part.likenesses if not o.mirrored]
        assert min(off) < 0.02 * RADIUS, f"{by} holes on"


@pytest.mark.parametrize("by", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_a_flange_found_upside_down_is_turned_back(by: int) -> None:
    """Nothing of the block shows at a pose upside down, and the disc fits: the right pose comes back."""
    part, pose = flange_part(), looking()
    photo = photo_of(flange(), pose)
    wrong = refine_pose(part, [photo], pose @ turned(by, over=True), wider=False)
    right = Rivals(part, [photo], FREE, EDGES, 0).checked(wrong)
    apart = CAMERA.project(right.pose.world_from_part @ flange().vertices) - CAMERA.project(pose @ flange().vertices)
    assert right.found, right.reason
    assert np.abs(apart).max() < 0.5


def test_what_every_angle_turns_onto_itself_has_no_turn_of_its_own(rng: np.random.Generator) -> None:
    angle = rng.uniform(0, 2 * np.pi, 4000)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(4000)], axis=1)
    assert not list(turns_onto(ring[:400], ring, 1.0, 0.45))


def test_turns_and_shifts_lay_points_on_points() -> None:
    """Of a ring of seven posts, drawn elsewhere along its axis: each seventh of a turn, to the half of a cell."""
    angles = 2 * np.pi * np.arange(7) / 7
    heights = np.linspace(0, 0.5, 40)
    posts = np.array([(np.cos(a), np.sin(a), h) for a in angles for h in heights])
    found = list(turns_onto(posts, posts + np.array([0, 0, 0.21]), 1.0, 0.9))
    sevenths = sorted({round(angle / (2 * np.pi / 7)) % 7 for angle, _ in found})
    assert sevenths == list(range(7))
    assert all(abs(angle / (2 * np.pi / 7) - round(angle / (2 * np.pi / 7))) < 0.02 for angle, _ in found)
    assert min(abs(up - 0.21) for _, up in found) < 0.03


def test_many_lines_of_one_reading_make_up_for_few_of_the_other() -> None:
    """The variances of two shares add: nine samples beside 150 are worth as much as 17 beside 17."""
    assert not Apart(9, 0.0, 150, 0.48).few
    assert Apart(9, 0.0, 150, 0.48).against
    assert Apart(9, 0.0, 15, 0.48).few
