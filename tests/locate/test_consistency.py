"""Cameras that do not stand where they are said to: the answer is as unsure as that makes it, and says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cadcam.arrays import Picture
from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.viewpoint import Viewpoint
from cadcam.geometry.rigid import Rigid
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.consistency import PhotoShift, _variance
from cadcam.locate.refine.refinement import Refinement, refine_pose
from cadcam.locate.track.frames import Frame
from cadcam.locate.track.tracker import TrackedFrame, track_part

from .photos import noisy, shot, view

PART = Part.of(machined_bracket())
NEAR, TELE = Camera.from_focal((640, 480), 900.0), Camera.from_focal((800, 600), 3000.0)
VIEWS = {
    "left": ((0.5, 0.7, 1.0), NEAR, 4.2),
    "right": ((0.9, 0.2, 1.0), NEAR, 4.4),
    "tele": ((0.1, 0.9, 0.8), TELE, 14),
}
START = Rigid.exp(np.array([0.6, -0.4, 0.5, 0.006, -0.004, 0.005]))


def photos(rng: np.random.Generator, off: dict[str, Sequence[float]], *names: str) -> list[Photo]:
    """Return photos of the part, which is the world, by cameras told to stand so many mm beside where they do."""
    taken = []
    for name in names:
        direction, camera, away = VIEWS[name]
        pose = view(PART, direction, away=away)
        told = pose @ Rigid(translation=off.get(name, (0, 0, 0)))
        taken.append(Photo.of(noisy(shot(PART, pose, camera), 0.01, rng), camera, told, name=name))
    return taken


def normalised(found: Location) -> float:
    """Return the root of xi' C^-1 xi / 6 of a pose that should be where the world is."""
    xi = found.pose.world_from_part.inv.log()
    return float(np.sqrt(xi @ np.linalg.solve(found.pose.covariance, xi) / 6))


def test_cameras_that_stand_where_they_are_said_to_agree(rng: np.random.Generator) -> None:
    found = refine_pose(PART, photos(rng, {}, "left", "right", "tele"), START)
    assert found.found
    assert "disagree" not in found.reason
    assert "left out" not in found.reason
    assert found.disagreements == ()
    assert normalised(found) < 2.5


def test_a_camera_that_is_known_poorly_does_not_make_one_that_is_known_well_disagree(rng: np.random.Generator) -> None:
    """Stated as off by 1 mm, and off by that: all its pull on the pose of both was taken for the other's error."""
    effect = np.zeros((11, 3))
    effect[:3] = np.eye(3)  # local coordinates: X Y Z ...
    blamed = 0
    for _ in range(3):
        well, poorly = photos(rng, {"right": rng.normal(0, 1.0, 3)}, "tele", "right")
        source = ErrorSource("its place", np.eye(3), object())
        stated = replace(poorly, viewpoint=replace(poorly.viewpoint, errors=((source, effect),)))
        found = refine_pose(PART, [well, stated], START)
        assert found.found
        assert found.disagreements == ()
        assert normalised(found) < 2.5
        blamed += bool(refine_pose(PART, [well, poorly], START).disagreements)
    assert blamed >= 1  # the negative control: the same photos, nothing stated


@pytest.mark.parametrize(
    "pair", [("left", "right"), pytest.param(("left", "tele"), marks=pytest.mark.slow), ("tele", "right")]
)
@pytest.mark.parametrize("off", [(0.4, 0.3, 0.0), pytest.param((-0.8, 0.2, 0.3), marks=pytest.mark.slow)])
def test_a_pose_between_two_cameras_that_disagree_is_as_unsure_as_they_make_it(
    pair: tuple[str, str], off: tuple[float, float, float], rng: np.random.Generator
) -> None:
    """Edges scatter little: depth takes most of it up. The error was 5 to 60 of the standard deviations told."""
    found = refine_pose(PART, photos(rng, {pair[1]: off}, *pair), START)
    assert found.found
    assert "disagree" in found.reason
    assert found.disputed
    assert found.left_out == set()
    assert {one.name for one in found.disagreements} <= set(pair)
    assert normalised(found) < 3


@pytest.mark.parametrize("names", [("left", "right"), ("left", "right", "tele")])
@pytest.mark.parametrize("off", [(0.02, 0.01, 0.0), (-0.03, 0.0, 0.02)])
def test_what_calibrations_leave_makes_a_pose_less_sure_and_no_more(
    names: tuple[str, ...], off: tuple[float, float, float], rng: np.random.Generator
) -> None:
    """Less than 0.2 px is no reason to doubt a rig whose files do not say how well they are known."""
    taken = photos(rng, {"right": off}, *names)
    found = refine_pose(PART, taken, START)
    assert found.found
    assert found.disagreements == ()
    assert "disagree" not in found.reason
    assert found.cameras_off_mm > 0
    assert normalised(found) < 3


def test_two_photos_that_contradict_each_other_have_no_pose(rng: np.random.Generator) -> None:
    """Each shows the part clearly, 6 px apart: neither camera is likelier to be the one that is off."""
    found = refine_pose(PART, photos(rng, {"right": (3.0, -2.0, 0.0)}, "left", "right"), START)
    assert not found.found
    assert found.disputed


@pytest.mark.parametrize(
    ("name", "off"),
    [
        pytest.param("left", (0.7, 0.5, 0.0), marks=pytest.mark.slow),
        ("tele", (0.0, 0.9, 0.0)),
        ("right", (4.0, 3.0, 0)),
    ],
)
def test_of_three_cameras_the_one_that_is_off_is_left_out_and_named(
    name: str, off: tuple[float, float, float], rng: np.random.Generator
) -> None:
    taken = photos(rng, {name: off}, *VIEWS)
    found = refine_pose(PART, taken, START)
    assert found.found
    assert f"{name!r} left out" in found.reason
    (one,) = found.disagreements
    assert (one.name, one.photo, one.left_out) == (name, list(VIEWS).index(name), True)
    assert one.px > 0
    assert not found.disputed
    assert normalised(found) < 2.5
    assert set(found.matches.photo.tolist()) == {k for k, other in enumerate(VIEWS) if other != name}


def test_photos_that_agree_are_believed_however_little_of_all_lines_shows_where_all_together_have_them(
    rng: np.random.Generator,
) -> None:
    """Of a part of many lines a camera that is 3 px off leaves the pose of all with hardly any that are met."""
    asked = Refinement(PART, photos(rng, {"left": (0.7, 0.5, 0.0)}, *VIEWS))
    best = asked.from_start(START)
    loose = replace(best, location=replace(best.location, quality=0.3))
    told = asked.consistent(loose).location
    assert told.left_out == {0}
    assert told.found
    assert told.quality == asked.consistent(best).location.quality


def test_where_a_photo_shows_nothing_that_is_the_reason_why_nothing_is_found(rng: np.random.Generator) -> None:
    """What the other photo shows is 95 % of the edges: said alone, that is no reason."""
    left, right = photos(rng, {}, "left", "right")
    asked = Refinement(PART, [left, Photo(noisy(np.zeros(right.gray.shape), 0.02, rng), right.viewpoint)])
    best = asked.from_start(START)
    half = replace(best, location=replace(best.location, quality=0.3))
    told = asked.consistent(half).location
    assert told.quality == 0.3
    assert told.reason.startswith("not certain: nothing of the part shows in 'right'")


def test_what_follows_rests_on_the_photos_that_agree(rng: np.random.Generator) -> None:
    """Whether a restriction is contradicted is asked of them alone (`cadcam.locate.refine.released`)."""
    asked = Refinement(PART, photos(rng, {"left": (0.7, 0.5, 0.0)}, *VIEWS))
    answer = asked.consistent(asked.from_start(START))
    assert answer.location.left_out == {0}
    assert [sight.photo.viewpoint.name for sight in answer.sights] == ["right", "tele"]
    assert answer.solution is not None
    assert answer.solution.sights is answer.sights


def test_a_photo_that_shows_nothing_of_the_part_is_left_out(rng: np.random.Generator) -> None:
    left, right = photos(rng, {}, "left", "right")
    dark = Photo(noisy(np.zeros(right.gray.shape), 0.02, rng), right.viewpoint)
    found = refine_pose(PART, [left, dark], START)
    assert "'right' left out: nothing of the part shows there" in found.reason
    assert str(found.disagreements[0]) == "photo 'right' shows nothing of the part, and was left out"
    assert normalised(found) < 2.5


@pytest.mark.parametrize("n", [2, 3, 5])
def test_how_far_cameras_are_off_is_estimated_on_the_safe_side_by_one_photo(n: int, rng: np.random.Generator) -> None:
    """Each is off by 1 mm, in x and in y: of 600 rigs the mean variance is n / (n - 1) mm^2 to four standard errors.

    All have their share in the pose of all, so that two show half of it.
    """
    moved = np.eye(2, 6)
    found = []
    for _ in range(600):
        off = rng.normal(size=(n, 2))
        shifts = off - off.mean(axis=0)
        photos = [
            PhotoShift(k, shifts[k], np.eye(2), moved, np.eye(6) / n, np.eye(6), noise=1e-12, px=1.0) for k in range(n)
        ]
        found.append(_variance(photos))
    assert np.mean(found) * (n - 1) / n == pytest.approx(1.0, abs=4 / np.sqrt(600 * (n - 1)))


def tracked(rng: np.random.Generator, off: dict[str, Sequence[float]], cover: dict[int, Picture]) -> list[TrackedFrame]:
    """Return four frames of the part at rest, by two cameras; cover: what the right one sees instead, by frame."""
    frames = []
    for k in range(4):
        left, right = photos(rng, off, "left", "right")
        seen = right if k not in cover else replace(right, gray=cover[k])
        frames.append(Frame.of(k, left, seen))
    return list(track_part(PART, frames, START))


def test_a_tracked_pose_is_as_unsure_as_cameras_that_disagree_make_it(rng: np.random.Generator) -> None:
    """In the first frame it was; where the motion had foretold it, its error was three of the standard deviations."""
    steps = tracked(rng, {"right": (0.4, 0.3, 0.0)}, {})
    assert [step.how for step in steps[1:]] == ["predicted"] * 3
    for step in steps:
        assert "disagree" in step.location.reason
        assert normalised(step.location) < 3


@pytest.mark.parametrize("sees", ["black", "noise"])
def test_a_camera_that_sees_nothing_for_some_frames_does_not_lose_the_part(sees: str, rng: np.random.Generator) -> None:
    """Neither without light, nor with a hand before its lens: the other camera shows the part where it was foretold."""
    width, height = NEAR.size
    noise = rng.normal(0.5, 0.02, (height, width)).clip(0, 1).astype(np.float32)
    steps = tracked(rng, {}, {2: np.zeros_like(noise) if sees == "black" else noise})
    assert all(step.location.found for step in steps)
    assert [len(step.location.disagreements) for step in steps] == [0, 0, 1, 0]
    (gone,) = steps[2].location.disagreements
    assert (gone.photo, gone.name, gone.left_out) == (1, "right", True)
    assert "left out" in steps[2].location.reason
    assert set(steps[2].location.matches.photo) == {0}
    assert normalised(steps[2].location) < 3


def test_a_camera_that_begins_in_the_dark_ends_no_track(rng: np.random.Generator) -> None:
    """The other one looks away: that the start is not in its picture was taken for a mistake."""
    aside = Viewpoint.exact("aside", NEAR, Rigid(translation=(9e3, 0, 0)) @ view(PART, VIEWS["right"][0]), sigma_px=0.1)
    frames = []
    for k in range(3):
        (left,) = photos(rng, {}, "left")
        dark = replace(left, gray=np.zeros_like(left.gray)) if k == 0 else left
        frames.append(Frame.of(k, dark, Photo(noisy(np.full_like(left.gray, 0.5), 0.02, rng), aside)))
    assert [step.location.found for step in track_part(PART, frames, START)] == [False, True, True]
