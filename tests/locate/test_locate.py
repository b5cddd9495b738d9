"""Locating a part, apart from the approach as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import Trial, _alone, _ranked, locate_part
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.options import EDGES
from cadcam.locate.refine.refinement import Refinement
from cadcam.locate.search.hypothesis import Hypothesis

from .moving import location
from .photos import error_px, photo, view
from .scene import CAMERA, block, largest_miss, off, photo_of, pose_of

around = Refinement.around
BRACKET = Part.of(machined_bracket())


@pytest.mark.parametrize(
    ("eye", "target"),
    [
        ((392, 165, 192), (193, 258, 23)),
        ((280, 195, 246), (472, 309, 30)),
        ((392, 77, 141), (399, 317, 48)),
        ((250, 240, 160), (220, 392, 60)),  # the part's middle lies behind the camera
    ],
)
def test_from_within_a_part_a_start_is_refined_though_no_approach_finds_it(
    eye: tuple[float, float, float], target: tuple[float, float, float], rng: np.random.Generator
) -> None:
    """25 to 45 px off, among few lines of a part of which most is beside the picture or behind the camera."""
    part, pose = block(), Rigid.look_at(eye, target)
    p = part.lines.draw(CAMERA, pose).visible.p
    middle = pose @ p.mean(axis=0)
    about = Rigid(translation=middle)
    aside = Rigid(translation=middle[2] * np.array([14 / CAMERA.fx, -10 / CAMERA.fx, 0.02]))
    start = aside @ about @ Rigid.exp([0, 0, 0, 0.03, -0.02, 0.025]) @ about.inv @ pose
    found = locate_part(part, [photo_of(pose, rng)], start)
    assert found.found, found.reason
    q, truth = CAMERA.project(found.pose.world_from_part @ p), CAMERA.project(pose @ p)
    assert np.linalg.norm(q - truth, axis=1).max() < 1


def test_a_start_that_no_approach_helps_is_refined_nearby_before_far_off(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Among clutter a search of 40 px loses what lies 7 px off."""
    pose, asked = pose_of(rng), []

    def noted(asks: Refinement, start: Rigid) -> object:
        asked.append(asks.options.search_px)
        return around(asks, start)

    aside = Hypothesis(Rigid(translation=[150.0, 0, 0]) @ pose, 1.0, 8.0)
    monkeypatch.setattr("cadcam.locate.in_photos.approach", lambda *_, **__: [aside])
    monkeypatch.setattr(Refinement, "around", noted)
    found = locate_part(block(), [photo_of(pose, rng)], off(pose, rng, degrees=2, px=3))
    assert found.found
    assert largest_miss(found.pose.world_from_part, pose) < 1
    assert asked == [EDGES.search_px] * 2


@pytest.mark.parametrize(("aside_mm", "doubted"), [(75.0, True), (75.0, False), (150.0, False)])
def test_a_start_better_than_what_its_approach_leads_to_is_preferred(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, aside_mm: float, doubted: bool
) -> None:
    """An approach may lead to a pose that is half believed, or farther off than the start may be."""
    pose, asked = pose_of(rng), []
    aside = Rigid(translation=[aside_mm, 0, 0]) @ pose

    def half_believed(asks: Refinement, start: Rigid) -> object:
        asked.append(start)
        location, sights = around(asks, start)
        return (replace(location, quality=0.7, doubted=doubted), sights) if start is aside else (location, sights)

    monkeypatch.setattr("cadcam.locate.in_photos.approach", lambda *_, **__: [Hypothesis(aside, 1.0, 8.0)])
    monkeypatch.setattr(Refinement, "around", half_believed)
    found = locate_part(block(), [photo_of(pose, rng)], off(pose, rng, degrees=1, px=2))
    sure = not doubted and aside_mm < 100.0
    assert (largest_miss(found.pose.world_from_part, pose) < 1) == (not sure)
    assert len(asked) == (1 if sure else 2)


def test_a_start_without_promise_is_not_fitted_and_one_with_it_is(rng: np.random.Generator) -> None:
    """Turned by 40 degrees, few of its lines lie on steps; 3 px off, pulled onto them, they show what the fit will."""
    pose = pose_of(rng)
    asked = Refinement(block(), [photo_of(pose, rng)], least=0.25)
    found, _ = asked.around(off(pose, rng, degrees=2, px=3))
    assert found.found
    assert largest_miss(found.pose.world_from_part, pose) < 1
    lost, _ = asked.around(off(pose, rng, degrees=40, px=60))
    assert lost.quality == 0
    assert "too few of its lines" in lost.reason
    assert not np.isfinite(lost.matches.offset).any()


def test_a_pose_that_is_hardly_found_is_held_against_the_start(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a lattice of equal bays a pose one bay off was found with quality 0.58, from a start 2 mm off."""
    pose = pose_of(rng)
    aside = Rigid(translation=[150.0, 0, 0]) @ pose

    def hardly(asks: Refinement, start: Rigid) -> object:
        location, sights = around(asks, start)
        return (replace(location, quality=0.58, doubted=False), sights) if start is aside else (location, sights)

    monkeypatch.setattr("cadcam.locate.in_photos.approach", lambda *_, **__: [Hypothesis(aside, 1.0, 8.0)])
    monkeypatch.setattr(Refinement, "around", hardly)
    found = locate_part(block(), [photo_of(pose, rng)], off(pose, rng, degrees=1, px=2))
    assert largest_miss(found.pose.world_from_part, pose) < 1


def test_of_answers_that_are_as_good_one_without_doubt_is_first() -> None:
    """A pose that needs a body of the part to be absent, half a lattice off, had 0.5619 and the right one 0.5612."""
    doubted, right = replace(location(Rigid(), 0.5619), doubted=True), location(Rigid(), 0.5612)
    assert _ranked([Trial(1.0, doubted), Trial(0.9, right)])[0].location is right
    for worse in (location(Rigid(), 0.3), location(Rigid(), 0.0)):
        ranked = _ranked([Trial(0.9, worse), Trial(1.0, doubted)])
        assert ranked[0].location is doubted, "doubted, but the only one that holds"


def test_a_hypothesis_that_leads_where_one_led_before_is_not_refined(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether that was found or not: turned and nearer, it is another pose in space and the same in the photo."""
    pose, asked = pose_of(rng), []

    def noted(asks: Refinement, start: Rigid) -> tuple[Location, object]:
        asked.append(start)
        location, sights = around(asks, start)
        return replace(location, quality=0.4), sights

    nearer = Rigid(translation=-0.04 * (pose @ block().aspects.centre))
    starts = [off(pose, rng, degrees=0.3, px=1), nearer @ pose, off(pose, rng, degrees=0.3, px=4)]
    monkeypatch.setattr(
        "cadcam.locate.in_photos.approach", lambda *_, **__: [Hypothesis(start, 1.0, 8.0) for start in starts]
    )
    monkeypatch.setattr(Refinement, "around", noted)
    monkeypatch.setattr(Photo, "calmed", lambda photo: photo)  # looked at once
    locate_part(block(), [photo_of(pose, rng)], off(pose, rng, degrees=0.3, px=2))
    assert len(asked) == 1


def test_a_start_that_sees_nothing_of_the_part_is_refused(rng: np.random.Generator) -> None:
    pose = Rigid.look_at((392, 165, 192), (193, 258, 23))
    with pytest.raises(NothingInView, match="outside of every photo"):
        locate_part(block(), [photo_of(pose, rng)], Rigid.look_at((700, 500, 300), (1500, 900, 300)))


@pytest.mark.parametrize("focal", [4e4, 2e5])
def test_a_part_is_found_however_long_the_lens(focal: float, rng: np.random.Generator) -> None:
    """Of 40 m and of 200 m away: a step that nears and turns the part must not throw it out of the picture."""
    camera = Camera.from_focal((640, 480), focal)
    pose = view(BRACKET, (1.0, 0.7, 0.9), away=4.2 * focal / CAMERA.fx)
    middle = pose @ BRACKET.aspects.centre
    about, nearer = Rigid(translation=middle), Rigid(translation=0.06 * middle)
    start = nearer @ about @ Rigid.exp([0, 0, 0, 0.15, -0.1, 0.1]) @ about.inv @ pose
    found = locate_part(BRACKET, [photo(BRACKET, pose, rng, camera=camera)], start)
    assert found.found, found.reason
    assert error_px(BRACKET, camera, found.pose.world_from_part, pose) < 1


def test_a_picture_that_is_given_twice_is_no_evidence_twice(rng: np.random.Generator) -> None:
    """Its noise was taken for that of two: a pose by four copies had half its sigma."""
    taken = photo_of(pose_of(rng), rng)
    again = replace(taken, gray=taken.gray.copy())
    with pytest.raises(BadValue, match=r"photo 2, '.*', is pixel by pixel '.*' again; expected each picture once"):
        locate_part(block(), [taken, again], pose_of(rng))


def test_a_pose_among_many_places_is_sure_only_if_its_edges_are_where_the_part_s_are() -> None:
    """Of tiles and boards some lines nearly fit a box, better than all else that is tried, but off as a whole."""
    here, far = location(Rigid(translation=[0, 0, 2000.0]), 0.9), location(Rigid(translation=[9000.0, 0, 2000.0]), 0.1)
    trials = [Trial(1.0, here), Trial(1.0, far)]
    assert _alone(block(), here, trials)
    assert not _alone(block(), replace(here, off_px=0.8), trials)
