"""Long bars, alone in the picture: nearly all of their lines run along them, and only the ends tell where they are."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.lines.attraction import telling_samples
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.support import judged_support
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.search.approach import approach

from .photos import error_px, photo

CAMERA = Camera.from_focal((1280, 1024), 1600.0)
LENGTH = 1500.0
# of the eye from the bar, in its frame, and how the picture is turned, rad
VIEWS = [((0.2, -0.7, 0.9), 0.4), ((-0.3, -0.9, 0.5), -0.7), ((0.1, -0.4, 1.0), 1.4), ((0.4, -0.8, 0.8), 2.6)]


@cache
def bar() -> Part:
    """Return an I-beam 1.5 m long, 120 x 100 mm."""
    low, high = box((0, 0, 0), (LENGTH, 120, 10), name="lower"), box((0, 0, 90), (LENGTH, 120, 100), name="upper")
    return Part.of(merge([low, box((0, 57, 10), (LENGTH, 63, 90), name="web"), high]))


def pose_of(direction: tuple[float, float, float], turn: float) -> Rigid:
    """Return camera_from_part; the bar is 800 px long or somewhat less."""
    low, high = bar().scene.mesh.bounds
    centre, towards = (low + high) / 2, np.array(direction)
    away = LENGTH * CAMERA.fx / 800
    return Rigid.exp([0, 0, 0, 0, 0, turn]) @ Rigid.look_at(centre + away * towards / np.linalg.norm(towards), centre)


def off(pose: Rigid, rng: np.random.Generator) -> Rigid:
    """Return the pose turned about the bar's middle by 12 degrees, 25 px aside and 5 % nearer or farther."""
    middle = Rigid(translation=np.asarray(bar().scene.mesh.bounds).mean(axis=0))
    axis, way = rng.normal(size=3), rng.normal(size=2)
    z = float((pose @ middle.translation)[2])
    aside = 25 * way / np.linalg.norm(way) * z / CAMERA.fx
    turned = Rigid.exp([0, 0, 0, *(np.radians(12) * axis / np.linalg.norm(axis))])
    return Rigid(translation=[*aside, 0.05 * z * rng.choice([-1, 1])]) @ pose @ middle @ turned @ middle.inv


@pytest.mark.parametrize("view", VIEWS)
def test_an_approach_ends_near_both_ends_of_a_bar(
    view: tuple[tuple[float, float, float], float], rng: np.random.Generator
) -> None:
    """With samples along its length it slid hundreds of px, or shrank to a tenth: all lines still lay on lines."""
    pose = pose_of(*view)
    taken = photo(bar(), pose, rng, camera=CAMERA)
    found = approach(bar(), [taken], off(pose, rng))
    assert min(error_px(bar(), CAMERA, h.world_from_part, pose) for h in found) < 25
    depth = (pose @ bar().aspects.centre)[2]
    assert all(abs((h.world_from_part @ bar().aspects.centre)[2] / depth - 1) < 0.5 for h in found)


def test_a_bar_is_found_from_a_rough_start(rng: np.random.Generator) -> None:
    pose = pose_of(*VIEWS[0])
    found = locate_part(bar(), [photo(bar(), pose, rng, camera=CAMERA)], off(pose, rng))
    assert found.found, found.reason
    assert error_px(bar(), CAMERA, found.pose.world_from_part, pose) < 0.5


def test_attraction_asks_the_ends_of_a_bar_more_than_their_length() -> None:
    taken, pose = slid(0.0)
    sight = Sight.of(bar(), taken, pose, step_px=2.0, reach_px=9.0)
    even, chosen = sight.thinned(300), telling_samples(sight, pose, 300)
    assert len(sight.samples) > 800
    assert abs(len(chosen.samples) - 300) < 30
    assert at_ends(chosen) > 3 * at_ends(even) > 0
    assert len(telling_samples(sight, pose, len(sight.samples)).samples) == len(sight.samples)


def at_ends(sight: Sight) -> int:
    """Return how many samples lie on an end of the bar."""
    x = sight.samples.p[:, 0]
    return int(np.sum(np.minimum(x, LENGTH - x) < 1))


def slid(by_mm: float) -> tuple[Photo, Rigid]:
    """Return a photo of the bar, and its pose shifted along itself."""
    pose = pose_of(*VIEWS[3])
    return photo(bar(), pose, np.random.default_rng(4), camera=CAMERA), pose @ Rigid(translation=[by_mm, 0, 0])


@pytest.mark.parametrize("by_mm", [60.0, -40.0])
def test_a_bar_slid_along_itself_is_not_found(by_mm: float) -> None:
    """All lines are there but for the ends, a fortieth of them."""
    taken, pose = slid(by_mm)
    sight = Sight.of(bar(), taken, pose, step_px=4.0, reach_px=9.0)
    support = judged_support([sight], pose, np.eye(6), chosen=0, scatter=0.02)
    assert support.shown > 0.8
    assert support.determined < 0.05
    assert replace(support, determined=1.0).quality > 0.6  # so it is the ends that decide
    assert support.quality < 0.5
    assert "slide or turn" in str(support)
    answer = refine_pose(bar(), [taken], pose)
    assert not answer.found or error_px(bar(), CAMERA, answer.pose.world_from_part, slid(0)[1]) < 1


def test_of_a_bar_that_may_only_be_shifted_across_its_ends_are_not_asked_for() -> None:
    """A motion that is not looked for need not be told."""
    taken, pose = slid(60.0)
    sight = Sight.of(bar(), taken, pose, step_px=4.0, reach_px=9.0)
    support = judged_support([sight], pose, np.eye(6)[:, 1:2], chosen=0, scatter=0.02)
    assert support.determined > 0.5
