"""Pictures of a plate with ribs: what is displaced, missing or too much is found, and by how much; all else is not."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.errors import UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.refine.refinement import refine_pose
from cadcam.report.verify.json import VerificationOrigin, verification_as_json
from cadcam.report.verify.words import feature_notes
from cadcam.verify.adjustment.datum_fit import Estimate
from cadcam.verify.bodies.findings import findings_of
from cadcam.verify.bodies.states import believed, state_of
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.deviations.measured import Displacement
from cadcam.verify.edges.presence import Presence
from cadcam.verify.inspection import Inspection, InspectionOptions, inspect
from cadcam.verify.judge import verify_part
from cadcam.verify.tolerances.tolerance import Selection, Tolerances

from ..report.test_verify_page import at
from .scene import CAMERA, POSE, displaced, part, photo, photographed, plate


def flagged(seen: Inspection) -> dict[str, State]:
    return {f.name: f.state for f in seen.features if f.state in (State.DISPLACED, State.MISSING)}


def off(rng: np.random.Generator) -> Rigid:
    """Return a pose some tenths of a pixel off the true one."""
    return Rigid.exp(rng.normal(0, 1, 6) * np.repeat([0.2, 5e-4], 3))


def test_where_nothing_is_wrong_nothing_is_said(rng: np.random.Generator) -> None:
    seen = inspect(part(), [photo(plate(), rng)], off(rng))
    assert flagged(seen) == {}
    assert seen.extra == ()
    assert {f.name for f in seen.features if f.state is State.IN_PLACE} == set(plate().part_names)


def test_every_body_is_drawn_where_the_pose_has_it_near_the_camera_too(rng: np.random.Generator) -> None:
    """Turned by 1 mrad the plate's lines move by 0.1 px, those of a tag before the camera by 1.

    They were left where they stood at first: what hid other lines, or showed them, was drawn as seen from there.
    """
    tag = box((249, -380, 381), (263, -366, 395), name="tag", color=(0.55, 0.55, 0.6))
    whole = Part.of(merge([plate(), tag]))
    start = Rigid.exp(np.array([0.0, 0.0, 0.0, 1e-3, 0.0, 0.0]))
    seen = inspect(whole, [photo(whole.scene.mesh, rng)], start)
    lines = seen.survey.lines
    at = CAMERA.project(POSE @ seen.pose.world_from_part @ lines.p)
    off = np.abs(np.einsum("ni,ni->n", at - lines.q, lines.normal))
    far = [np.quantile(off[seen.survey.body == body], 0.9) for body in np.unique(seen.survey.body)]
    assert len(far) == 6
    assert max(far) < 0.3
    assert flagged(seen) == {}


def test_a_datum_that_would_carry_the_part_away_does_not_hold_it(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a small part half hidden few edges are seen: fitted to them it moved by 133 px, and out of view."""

    def carried(*args: object) -> SimpleNamespace:
        look = findings_of(*args)
        pose = look.measured.adjustment.pose()
        told = replace(pose, xi=pose.xi + np.array([20.0, 0, 0, 0, 0, 0]))
        return SimpleNamespace(measured=SimpleNamespace(adjustment=SimpleNamespace(pose=lambda: told)))

    monkeypatch.setattr("cadcam.verify.inspection.findings_of", carried)
    seen = inspect(part(), [photo(plate(), rng)], off(rng))
    assert not seen.found
    assert re.search(r"do not hold the part: fitted to them it would move by \d\d px", seen.reason)


def test_a_displaced_rib_is_found_with_its_vector(rng: np.random.Generator) -> None:
    """0.6 mm across the line of sight are 0.55 px; the components seen agree within 3.5 sigmas (chi-square, 1e-3)."""
    by = 0.6 * np.array([0.8, 0.6, 0.0])
    seen = inspect(part(), [photo(displaced("rib 1", by), rng)], off(rng))
    assert flagged(seen) == {"rib 1": State.DISPLACED}
    found = seen.feature("rib 1")
    assert found.displacement is not None
    error = found.displacement.value - found.seen.T @ by
    assert error @ np.linalg.solve(found.displacement.covariance, error) < 3.7**2
    assert found.sigma < 0.06
    with pytest.raises(UnknownName, match="unknown feature 'rip 1'; did you mean 'rib 1'"):
        seen.feature("rip 1")


def test_a_rib_displaced_beyond_the_reach_of_a_pose_is_found(rng: np.random.Generator) -> None:
    """5 mm are 4.6 px: no edge of it is where the model has it."""
    by = np.array([0.0, 5.0, 0.0])
    seen = inspect(part(), [photo(displaced("rib 2", by), rng)], off(rng))
    assert flagged(seen) == {"rib 2": State.DISPLACED}
    assert (
        np.linalg.norm(seen.feature("rib 2").vector - seen.feature("rib 2").seen @ seen.feature("rib 2").seen.T @ by)
        < 0.3
    )


def test_a_missing_block_is_found_and_nothing_else_is_blamed(rng: np.random.Generator) -> None:
    seen = inspect(part(), [photo(displaced("block", None), rng)], off(rng))
    assert flagged(seen) == {"block": State.MISSING}


def test_something_too_much_is_a_candidate(rng: np.random.Generator) -> None:
    """A strip that the model does not have lies on the plate; its curves are reported where it is."""
    mesh = merge([plate(), box((0, -95, 12), (60, -75, 22), name="strip", color=(0.55, 0.55, 0.6))])
    seen = inspect(part(), [photo(mesh, rng)], off(rng))
    assert flagged(seen) == {}
    assert seen.extra
    assert all(-10 < e.p[0] < 70 and -100 < e.p[1] < -60 for e in seen.extra)
    assert {e.near for e in seen.extra} <= {"plate"}


def test_the_displaced_part_does_not_pull_the_pose(rng: np.random.Generator) -> None:
    """It is left out of the datum: the pose errs as its covariance says (chi-square of six beyond 1e-4: 27.9)."""
    seen = inspect(part(), [photo(displaced("rib 1", np.array([1.5, 0.0, 0.0])), rng)], off(rng))
    assert seen.left_out == ("rib 1",)
    xi = seen.pose.world_from_part.log()
    assert xi @ np.linalg.solve(seen.pose.covariance, xi) < 27.9


@pytest.mark.parametrize(
    ("name", "photos"),
    [
        ("block", 1),
        ("plate", 2),
        ("bracket", 2),
        ("rib 1", 1),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in (("block", 2), ("plate", 1), ("bracket", 1), ("rib 1", 2), ("rib 2", 1), ("rib 2", 2))
        ),
    ],
)
def test_the_body_that_is_displaced_is_the_one_that_is_named(rng: np.random.Generator, name: str, photos: int) -> None:
    """1 mm in any direction, along the line of sight too: what the photos show of it is told with its uncertainty.

    One photo does not show a displacement along its line of sight: nobody is blamed for it. Three sigmas of what is
    seen make an alarm less than sure; the error of each picture stays within chi-square of its components at 1e-3.
    """
    by = rng.normal(size=3)
    by /= np.linalg.norm(by)
    other = Rigid.look_at((-620.0, -520.0, 500.0), (10.0, 0.0, 10.0))
    mesh = displaced(name, by)
    shots = [photo(mesh, rng), photo(mesh, rng, other, name="second")][:photos]
    seen = inspect(part(), shots, refine_pose(part(), shots, off(rng)).pose.world_from_part)
    assert set(flagged(seen)) <= {name}
    found = seen.feature(name)
    assert found.displacement is not None
    error = found.displacement.value - found.seen.T @ by
    assert error @ np.linalg.solve(found.displacement.covariance, error) < 16.27
    if np.linalg.norm(found.seen.T @ by) > 6 * found.sigma:
        assert flagged(seen) == {name: State.DISPLACED}


def test_a_stated_datum_is_believed(rng: np.random.Generator) -> None:
    """With the displaced rib as the datum all else is displaced against it, by as much, the other way."""
    by = np.array([0.0, 1.0, 0.0])
    stated = Tolerances(datum=(Selection("rib 1"),))
    seen = inspect(part(), [photo(displaced("rib 1", by), rng)], off(rng), tolerances=stated)
    plate_found = seen.feature("plate")
    assert plate_found.displacement is not None
    expected = -plate_found.seen.T @ by
    error = plate_found.displacement.value - expected
    assert error @ np.linalg.solve(plate_found.displacement.covariance, error) < 3.7**2
    assert seen.contradictions == ()  # one body does not contradict itself


@pytest.mark.parametrize(("by", "stand_out"), [(0.0, ()), (2.0, ("rib 1",))])
def test_a_stated_datum_that_contradicts_itself_is_told(
    by: float, stand_out: tuple[str, ...], rng: np.random.Generator
) -> None:
    """It is believed all the same, but whoever stated it reads which of its bodies to leave out."""
    stated = Tolerances(datum=(Selection("*"),))
    taken = photo(displaced("rib 1", np.array([0.0, by, 0.0])), rng)
    seen = inspect(part(), [taken], off(rng), tolerances=stated)
    assert seen.contradictions == stand_out
    assert seen.left_out == ()
    assert set(seen.datum) == set(plate().part_names)
    found = verify_part(part(), [taken], at(Rigid(), 1.0), stated)
    told = ["the datum contradicts itself: rib 1 stands out; leave it out of the datum"] if stand_out else []
    assert [said for said in told if said in found.reason] == told
    assert ("contradicts itself" in found.reason) == bool(stand_out)
    assert found.inspection is not None
    assert sum("contradicts itself" in note for note in feature_notes(found.inspection)) == len(stand_out)
    assert verification_as_json(found, VerificationOrigin("plate"))["datum_contradictions"] == list(stand_out)


def test_another_picture_is_not_the_part(rng: np.random.Generator) -> None:
    gray = photographed(plate(), rng)[::-1, ::-1]
    from cadcam.locate.photo import Photo

    seen = inspect(part(), [Photo.of(gray, CAMERA, POSE)], Rigid())
    assert not seen.found
    assert (seen.pose.sigma_mm > 100).all()  # nothing was measured of it: no uncertainty would look like a certain one
    assert "not there" in seen.reason or "hold the part" in seen.reason


def test_nothing_is_found_in_an_even_picture() -> None:
    from cadcam.locate.photo import Photo

    seen = inspect(part(), [Photo.of(np.full((360, 480), 0.5, np.float32), CAMERA, POSE)], Rigid())
    assert not seen.found
    assert "0 % of the places" in seen.reason


def test_two_photos_see_what_one_cannot(rng: np.random.Generator) -> None:
    """A displacement along the first camera's line of sight: unseen by it alone, found with a second one."""
    sight = np.array([95.0, -40.0, 28.5]) - POSE.inv.translation
    sight /= np.linalg.norm(sight)
    other = Rigid.look_at((-620.0, -520.0, 500.0), (10.0, 0.0, 10.0))
    mesh = displaced("block", 1.5 * sight)
    one, two = photo(mesh, rng), photo(mesh, rng, other, name="second")
    start = off(rng)
    alone = inspect(part(), [one], start).feature("block")
    assert alone.displacement is not None
    np.testing.assert_allclose(alone.seen.T @ sight, 0, atol=0.1)  # one photo says nothing along its line of sight
    seen = inspect(part(), [one, two], start)
    assert seen.feature("block").state is State.DISPLACED
    found = seen.feature("block")
    assert found.displacement is not None
    assert found.seen.shape == (3, 3)
    error = found.displacement.value - found.seen.T @ (1.5 * sight)
    assert error @ np.linalg.solve(found.displacement.covariance, error) < 16.27  # chi-square of three beyond 1e-3
    assert found.sigma < 0.3  # and it is told: five sigmas


@pytest.mark.parametrize(("reach", "alarms"), [(1.0, 0.01), (100.0, 0.01), (8.0, 0.0), (8.0, 1.5)])
def test_options_without_meaning_are_refused(reach: float, alarms: float) -> None:
    from cadcam.errors import BadValue

    with pytest.raises(BadValue):
        InspectionOptions(reach, alarms)


@pytest.mark.slow
def test_alarms_are_as_rare_as_asked_and_displacements_err_as_they_say() -> None:
    """150 pictures: at most 5 with any alarm (binomial at 1 %, beyond 1e-2); normalised squares are 1 on average.

    Components of one picture err together through the pose, so that each picture counts as one drawing; its standard
    error is that of their means. What feet may have slid makes the uncertainties cautious, by no more than a half.
    """
    alarms, squares = 0, []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        seen = inspect(part(), [photo(plate(), rng)], off(rng))
        alarms += bool(flagged(seen))
        told = [f.displacement for f in seen.features if f.displacement is not None]
        each = [m.value @ np.linalg.solve(m.covariance, m.value) for m in told]
        squares.append(sum(each) / sum(len(m.value) for m in told))
    assert alarms <= 5
    assert 0.5 < np.mean(squares) < 1 + 4 * np.std(squares) / np.sqrt(len(squares))


def test_what_contradicts_its_own_edges_is_not_believed() -> None:
    """20 +- 4 mm, of edges that are as likely as not of a feature in place; the same of edges that are not is kept."""
    none = np.zeros((1, 1))
    told = Estimate(np.array([20.0]), none + 16.0, none, none, none)
    assert believed(Displacement(np.eye(3)[:, :1], told, 0.9, 5)) is None
    assert believed(Displacement(np.eye(3)[:, :1], told, 0.04, 5)) is not None
    assert believed(Displacement(np.eye(3)[:, :1], replace(told, value=np.array([5.0])), 0.9, 5)) is not None


def test_one_line_alone_where_others_ought_to_show_does_not_tell_how_far_a_body_is_displaced() -> None:
    """A bracket that was missing was called 1.98 +- 0.03 mm off, by what lay behind one of its five edges."""
    none = np.zeros((1, 1))
    moved = Displacement(np.eye(3)[:, :1], Estimate(np.array([1.98]), np.eye(1) * 3e-4, none, none, none), 5e-28, 1)
    states = {
        Presence(5, 1, 2.8): State.UNCLEAR,
        Presence(2, 1, 2.8): State.DISPLACED,  # seen edge-on or half hidden, it has no more to show
        Presence(5, 1, 20.0): State.DISPLACED,  # surely there
        Presence(5, 2, 2.8): State.DISPLACED,
    }
    for presence, state in states.items():
        told, why = state_of(presence, moved, True, 8.0, near=True, rare=0.0025)
        assert told is state, presence
        assert why is (Unclear.ALONE if state is State.UNCLEAR else None)
