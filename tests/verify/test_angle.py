"""Limits of an angle: by one photo of the turn about the line of sight, by several of that about any axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.verify.adjustment.datum_fit import Estimate
from cadcam.verify.deviations.deviation import FeatureDeviation, State
from cadcam.verify.edges.presence import Presence
from cadcam.verify.inspection import Inspection, inspect
from cadcam.verify.judge import judged, verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict

from .scene import CAMERA, POSE, part, photographed, plate

FRONT, LEFT = POSE, Rigid.look_at((-620.0, -520.0, 500.0), (10.0, 0.0, 10.0))
BACK = Rigid.look_at((300.0, 700.0, 560.0), (10.0, 0.0, 10.0))
LIMIT = Limit(Quantity.ANGLE, np.radians(0.5))


def turned(name: str, about: Sequence[float], degrees: float, by: Sequence[float] = (0.0, 0.0, 0.0)) -> Mesh:
    """Return the plate with one of its bodies turned about an axis through its middle, and moved (mm)."""
    mesh = plate()
    mine = np.unique(mesh.faces[mesh.part == mesh.part_names.index(name)])
    vertices = mesh.vertices.copy()
    middle = vertices[mine].mean(axis=0)
    R = Rigid.exp(np.array([0.0, 0.0, 0.0, *(np.radians(degrees) * np.array(about))])).rotation
    vertices[mine] = (vertices[mine] - middle) @ R.T + middle + by
    return replace(mesh, vertices=vertices)


def judgement(mesh: Mesh, name: str, *places: Rigid, limit: Limit = LIMIT) -> Judgement:
    rng = np.random.default_rng(1)
    photos = [Photo.of(photographed(mesh, rng, w), CAMERA, w, name=f"{i}") for i, w in enumerate(places)]
    asked = Tolerances((Feature(name, Selection(name), (limit,)),), (Selection("plate"),))
    return verify_part(part(), photos, refine_pose(part(), photos, Rigid()), asked).judgements[0]


def test_a_turn_that_does_not_show_about_the_mean_line_of_sight_fails_by_several_photos() -> None:
    """The block turned by 1 deg on the plate; about the photos' common line of sight it is turned by 0.1 deg only."""
    found = judgement(turned("block", (0.0, 0.0, 1.0), 1.0), "block", FRONT, LEFT, BACK)
    assert found.verdict is Verdict.FAIL
    assert abs(found.deviation - np.radians(1.0)) < 2 * found.U
    assert "turned about (" in found.reason


def test_a_body_in_place_passes_by_several_photos_and_by_one_that_says_what_it_judges() -> None:
    assert judgement(plate(), "block", FRONT, LEFT, BACK).verdict is Verdict.PASS
    by_one = judgement(plate(), "block", FRONT)
    assert by_one.verdict is Verdict.PASS
    assert "one photo judges no other turn" in by_one.reason


@pytest.mark.parametrize(
    ("about", "places", "sure"),
    [
        # the rib of the next but one test seems to turn by 0.82 deg and does not: as much as 3 sigmas of less than 0.35
        ((1.0, 0.0, 0.0), (FRONT,), 0.35),
        ((1.0, 0.0, 0.0), (FRONT, LEFT), 0.12),
        ((0.0, 0.0, 1.0), (FRONT,), 0.12),
    ],
)
def test_a_body_that_tips_is_not_taken_for_one_that_turns(
    about: tuple[float, float, float], places: Sequence[Rigid], sure: float
) -> None:
    """A rib turned by 0.8 deg on its foot, or tipped by as much, turns by half of that about the line of sight.

    If nothing but that turn could have moved its long edges, they say 0.67 and 0.04 deg: 8 and 17 of their own sigmas
    off. By one photo one that tips looks like one that sinks upright (the next tests), and neither is told as surely.
    """
    rng = np.random.default_rng(1)
    photos = [Photo.of(photographed(turned("rib 1", about, 0.8), rng, w), CAMERA, w) for w in places]
    asked = Tolerances((Feature("rib", Selection("rib 1"), (LIMIT,)),), (Selection("plate"),))
    found = verify_part(part(), photos, refine_pose(part(), photos, Rigid()), asked).inspection
    assert found is not None
    assert found.measured is not None
    turn, sigma, axis = found.measured.turn(found.measured.members[0])
    assert abs(turn - np.radians(0.8) * np.asarray(about) @ axis) < 3 * sigma
    assert sigma < np.radians(sure)


@pytest.mark.parametrize("places", [(FRONT,), pytest.param((FRONT, LEFT, BACK), marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("name", "about", "degrees", "by"),
    [
        ("rib 2", (0.1, 0.7, -0.7), 1.1, (-0.2, 2.3, -1.0)),
        pytest.param("rib 1", (0.3, 0.5, 0.8), 1.0, (1.0, -0.5, -1.0), marks=pytest.mark.slow),
        pytest.param("rib 1", (0.0, 0.0, 1.0), 1.0, (1.0, 1.0, 0.0), marks=pytest.mark.slow),
        ("block", (0.0, 0.0, 1.0), 1.0, (1.0, 1.0, 0.0)),
    ],
)
def test_a_body_that_sinks_and_turns_is_turned_as_much_as_is_said(
    name: str,
    about: tuple[float, float, float],
    degrees: float,
    by: tuple[float, float, float],
    places: Sequence[Rigid],
) -> None:
    """Two ribs that tip, turn and sink by 1 mm, a rib and a block that turn on the plate: errors within 4 sigmas.

    Were feet taken to follow, the ribs' would be up to 18 sigmas; were a turn by several photos taken to be about their
    mean line of sight alone, the block's too.
    """
    rng, axis = np.random.default_rng(1), np.array(about) / np.linalg.norm(about)
    mesh = turned(name, tuple(axis), degrees, by)
    photos = [Photo.of(photographed(mesh, rng, w), CAMERA, w, name=f"{i}") for i, w in enumerate(places)]
    asked = Tolerances((Feature("it", Selection(name), (LIMIT,)),), (Selection("plate"),))
    found = verify_part(part(), photos, refine_pose(part(), photos, Rigid()), asked).inspection
    assert found is not None
    assert found.measured is not None
    turn, sigma, sight = found.measured.turn(found.measured.members[0])
    assert abs(turn - np.radians(degrees) * axis @ sight) < 4 * sigma
    assert sigma < np.radians(0.5)


def test_a_body_that_sinks_upright_is_not_taken_for_one_that_tilts() -> None:
    """A rib displaced, by 1.4 mm into the plate: its feet stay, as if it had tilted. Error within 4 sigmas, once 11."""
    mesh = turned("rib 2", (0.0, 0.0, 1.0), 0.0, (0.1, 0.1, -1.4))
    shot = Photo.of(photographed(mesh, np.random.default_rng(1), FRONT), CAMERA, FRONT)
    found = inspect(part(), [shot], Rigid()).feature("rib 2")
    assert abs(found.turn) < 4 * found.turn_sigma
    assert found.turn_sigma < np.radians(0.5)


def by_one_photo(misfit: float, limit: float) -> Judgement:
    """Return what is said of a body turned by 0.01 +- 0.002 rad, unsure by noise; its displacement, by calibration."""
    large, none, three = np.array([[1.0]]), np.zeros((1, 1)), np.eye(3)[:, :1]
    by_calibration = Estimate(np.zeros(1), none, none, none, large)
    found = FeatureDeviation(
        "rib", State.IN_PLACE, Presence(4, 4, 20.0), three, by_calibration, turn=0.01, turn_sigma=0.002, p_value=0.5
    )
    measured = SimpleNamespace(
        eye=np.zeros(3),
        members=(np.ones(1, bool),),
        turns=lambda rows, about: (about, Estimate(np.array([0.01]), large, none, none, none, misfit)),
    )
    survey = SimpleNamespace(names=("rib",))
    seen = cast(Inspection, SimpleNamespace(feature=lambda name: found, measured=measured, survey=survey))
    (said,) = judged(Feature("rib", Selection("rib"), (replace(LIMIT, value=limit),)), seen)
    return said


def test_a_turn_undecided_by_one_photo_is_told_with_the_causes_of_its_own_uncertainty() -> None:
    """Those of the displacement are others: here the calibration's, while the turn is unsure by its noise."""
    said = by_one_photo(1.0, 0.01)
    assert said.verdict is Verdict.UNDECIDED
    assert "most of U is pixel noise (100%)" in said.reason


@pytest.mark.parametrize(("limit", "verdict"), [(0.005, Verdict.FAIL), (0.02, Verdict.PASS)])
def test_a_turn_that_edges_contradict_is_undecided(limit: float, verdict: Verdict) -> None:
    """A rib that tilted, half of its feet in the plate: turned by 0.79 +- 0.02 deg, misfit 26, where 0.95 is true."""
    assert by_one_photo(1.0, limit).verdict is verdict
    said = by_one_photo(26.0, limit)
    assert said.verdict is Verdict.UNDECIDED
    assert "do not agree on one turn" in said.reason


def test_what_several_photos_show_about_some_axes_alone_is_undecided() -> None:
    """Two photos from one side tell the turn about their line of sight, and those about others hardly."""
    beside = Rigid.look_at((430.0, -610.0, 640.0), (10.0, 0.0, 10.0))
    found = judgement(plate(), "bracket", FRONT, beside, limit=replace(LIMIT, value=np.radians(0.25)))
    assert found.verdict is Verdict.UNDECIDED
    assert "is not known well enough" in found.reason
    assert found.reason.endswith(found.remedy)


def test_a_direction_is_that_of_a_position() -> None:
    for quantity in (Quantity.ANGLE, Quantity.PROFILE):
        with pytest.raises(BadValue, match="direction"):
            Limit(quantity, 0.1, direction=np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("degrees", [1.0, -1.0])
def test_a_position_of_a_body_that_turns_too_is_decided_by_what_the_middle_of_its_places_is(degrees: float) -> None:
    """A block turned and moved by 1.4 mm: error within 4 sigmas. By a shift alone its edges disagree: undecided."""
    rng, about = np.random.default_rng(1), np.array([0.0, 0.0, np.radians(degrees)])
    by, middle = np.array([1.0, 1.0, 0.0]), np.array([95.0, -40.0, 28.5])
    photos = [Photo.of(photographed(turned("block", (0.0, 0.0, 1.0), degrees, by), rng, FRONT), CAMERA, FRONT)]
    asked = Tolerances((Feature("it", Selection("block"), (Limit(Quantity.POSITION, 0.5),)),), (Selection("plate"),))
    judged = verify_part(part(), photos, refine_pose(part(), photos, Rigid()), asked)
    assert judged.judgements[0].verdict is Verdict.FAIL
    assert judged.inspection is not None
    found = judged.inspection.feature("it")
    assert found.displacement is not None
    true = by + np.cross(about, found.p - middle)
    error = found.displacement.value - found.seen.T @ true
    assert error @ np.linalg.solve(found.displacement.covariance, error) < 4**2
    assert found.sigma < 0.1


def test_a_body_that_turns_upright_and_sinks_is_displaced_by_as_much_as_is_said() -> None:
    """A rib slides by 2.8 mm, turns by 1.8 deg and sinks by 0.3 mm: its feet stay, as if it had tipped a little.

    Were it not weighed that it stays upright, a component would be 2 to 6 sigmas off. Within 3 sigmas.
    """
    place = Rigid.look_at((-276.6, 454.7, 725.1), (-3.5, 8.0, 0.0))
    mesh = turned("rib 1", (0.0, 0.0, 1.0), 1.79, (2.12, 1.85, -0.29))
    shot = Photo.of(photographed(mesh, np.random.default_rng(2), place), CAMERA, place)
    found = inspect(part(), [shot], Rigid()).feature("rib 1")
    assert found.displacement is not None
    middle = np.array([-40.0, -54.0, 32.0])
    R = Rigid.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.radians(1.79)])).rotation
    was = R.T @ (found.p - middle - [2.12, 1.85, -0.29]) + middle  # what now is where the edges were measured
    off = found.displacement.value - found.seen.T @ (found.p - was)
    z = np.linalg.solve(np.linalg.cholesky(found.displacement.covariance), off)
    assert np.abs(z).max() < 3
    assert found.sigma < 0.5
