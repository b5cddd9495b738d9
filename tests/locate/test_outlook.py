"""Cameras that stand within a part: what they see of it there, and how far off a start may be."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.in_photos import locate_part
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.search.approach import Reach, approach, middle_in_view
from cadcam.locate.views.outlook import Outlook
from cadcam.locate.views.view_range import ViewRange

from .photos import noisy, shot

CAMERA = Camera.from_focal((640, 480), 450.0)
MARGIN_PX = 10.0
WIDER = Camera.from_focal((640 + 20, 480 + 20), 450.0)  # its picture holds the margin, moved by that
RIGHT_PX = 1.0  # lines that are farther off are other lines
WALLS = [((0, 0, 0), (3000, 12, 900)), ((0, 1488, 0), (3000, 1500, 900)), ((0, 12, 0), (12, 1488, 900))]
RIBS = [(300, 180, 12), (780, 120, 12), (1350, 220, 16), (1800, 150, 12), (2500, 200, 20)]  # x, height, thickness


@cache
def hold() -> Part:
    """Return a hold, 3 x 1.5 x 0.9 m: a floor, three walls, and ribs at unequal distances."""
    sides = [box(low, high, name=f"wall {k}") for k, (low, high) in enumerate(WALLS)]
    ribs = [box((x, 12, 12), (x + t, 1488, 12 + h), name=f"rib {x}") for x, h, t in RIBS]
    return Part.of(merge([box((0, 0, 0), (3000, 1500, 12), name="floor"), *sides, *ribs]))


def pose_towards(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Rigid:
    return Rigid.look_at(np.array(eye), np.array(target))


EYES = {
    "down at the ribs": pose_towards((1500, 500, 880), (1000, 1150, 60)),
    "along the hold": pose_towards((2300, 500, 500), (600, 900, 150)),
    "into a corner": pose_towards((900, 700, 600), (150, 1400, 150)),
}


def photo(pose: Rigid, rng: np.random.Generator, world: Rigid | None = None) -> Photo:
    """Return a noisy photo; its world is the camera, or where that is stated the one in which it is there."""
    return Photo.of(noisy(shot(hold(), pose, CAMERA), 0.01, rng), CAMERA, world)


def off(pose: Rigid, rng: np.random.Generator, *, degrees: float, px: float) -> Rigid:
    """Return a pose turned about the middle of what is in view, and shifted across the line of sight."""
    middle = middle_in_view(hold(), [Photo.of(np.zeros((480, 640)), CAMERA)], pose, Reach())
    axis, (x, y) = rng.normal(size=3), rng.normal(size=2)
    turn, at = Rigid.exp([0, 0, 0, *(np.radians(degrees) * axis / np.linalg.norm(axis))]), Rigid(translation=middle)
    mm = px * float((pose @ middle)[2]) / CAMERA.fx / np.hypot(x, y)
    return Rigid(translation=[mm * x, mm * y, 0]) @ pose @ at @ turn @ at.inv


def error_px(pose: Rigid, truth: Rigid) -> float:
    """Return how far off (px) what is in view is, at most."""
    lines = hold().lines.draw(CAMERA, truth).visible
    p = lines.p[CAMERA.sees(lines.q)]
    return float(np.linalg.norm(CAMERA.project(pose @ p) - CAMERA.project(truth @ p), axis=1).max())


@pytest.mark.parametrize("degrees", [3.0, 18.0])
@pytest.mark.parametrize("eye", EYES)
def test_from_inside_a_start_may_be_as_far_off_as_from_outside(
    eye: str, degrees: float, rng: np.random.Generator
) -> None:
    truth = EYES[eye]
    found = locate_part(hold(), [photo(truth, rng)], off(truth, rng, degrees=degrees, px=35))
    assert found.found, found.reason
    assert error_px(found.pose.world_from_part, truth) < RIGHT_PX


def test_cameras_that_look_apart_from_one_place_see_their_own_lines(rng: np.random.Generator) -> None:
    """A pan head in the middle of the hold; one of its photos is of the sky."""
    first, second = pose_towards((1200, 700, 700), (500, 1000, 50)), pose_towards((1200, 700, 700), (2200, 600, 50))
    sky = pose_towards((1200, 700, 700), (1200.5, 700, 5000))
    views = [(CAMERA, sky), (CAMERA, first), (CAMERA, second)]
    outlook = Outlook.of(hold().lines, views, MARGIN_PX)
    assert outlook is not None
    assert outlook.seeing == (1, 2)
    for number, (_, pose) in enumerate(views[1:]):
        beside = second.origin[None] + [3.0, 0.0, -2.0]  # of both: where it looks tells them apart
        assert outlook.nearest(beside, pose.rotation[2:]) == (number, 0)
        p = outlook.made[number, 0].places["p"].astype(float)
        assert WIDER.sees(CAMERA.project(pose @ p) + MARGIN_PX).all()
    shown = [photo(pose, rng, pose @ first.inv) for _, pose in views]
    start = off(first, rng, degrees=10, px=20)
    found = locate_part(hold(), shown, start)
    assert found.found, found.reason
    assert error_px(found.pose.world_from_part, first) < RIGHT_PX


def test_on_a_known_plane_what_is_in_view_is_spread(rng: np.random.Generator) -> None:
    """The hold stands on its floor: two shifts and a turn about the vertical, in the world of the hold itself."""
    pose = EYES["down at the ribs"]
    start = Rigid.exp([0, 0, 0, 0, 0, np.radians(6)]) @ Rigid(translation=[-60, 40, 0])
    found = locate_part(hold(), [photo(pose, rng, pose)], start, freedom=Freedom.planar((0, 0, 1)))
    assert found.found, found.reason
    assert error_px(pose @ found.pose.world_from_part, pose) < RIGHT_PX


def test_a_camera_outside_takes_the_part_as_a_whole(rng: np.random.Generator) -> None:
    away = pose_towards((1500, -6000, 4000), (1500, 750, 300))
    assert middle_in_view(hold(), [photo(away, rng)], away, Reach()) == pytest.approx(hold().aspects.centre)
    inside = EYES["into a corner"]
    assert np.linalg.norm(middle_in_view(hold(), [photo(inside, rng)], inside, Reach()) - [150, 1400, 150]) < 600


def test_a_start_in_metres_is_asked_whether_it_is(rng: np.random.Generator) -> None:
    truth = pose_towards((1500, -6000, 4000), (1500, 750, 300))
    start = Rigid(truth.rotation, truth.translation / 1000)
    assert approach(hold(), [photo(truth, rng)], start)  # something of the part is in view
    found = locate_part(hold(), [photo(truth, rng)], start)
    assert not found.found
    assert "mm from camera 'photo': are both in one unit, mm?" in found.reason


def test_a_search_from_within_the_part_asks_for_a_start(rng: np.random.Generator) -> None:
    shown = [photo(EYES["into a corner"], rng)]
    views = ViewRange(half_angle_deg=10, roll_deg=20, distance_mm=(600, 900))
    found = locate_part(hold(), shown, views=views)
    assert not found.found
    said = "up to 900 mm from the middle of the part, 3473 mm large, pieces are in view, not all: give a start"
    assert found.reason.endswith(said)
