"""A restriction that the photo contradicts: the answer says so, and is as unsure as it has moved the pose."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.cad.parts import machined_bracket
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.uncertainty import weakest_direction

from .photos import photo, view

PART = Part.of(machined_bracket())
POSE = view(PART, (0.5, 0.7, 1.0))
ON_ITS_FLOOR = Freedom.planar([0, 0, 1], frame="part")
ASIDE = Rigid.exp(np.array([1.5, -1.0, 0, 0, 0, 0.01]))


def normalised(found: Location) -> float:
    """Return the root of xi' C^-1 xi / k of the motions that were free."""
    B = found.pose.freedom
    xi = B.T @ (found.pose.world_from_part.inv @ POSE).log()
    return float(np.sqrt(xi @ np.linalg.solve(B.T @ found.pose.covariance @ B, xi) / B.shape[1]))


def test_a_restriction_that_holds_is_not_doubted(rng: np.random.Generator) -> None:
    found = refine_pose(PART, [photo(PART, POSE, rng)], POSE @ ASIDE, freedom=ON_ITS_FLOOR)
    assert found.found
    assert "free to move" not in found.reason
    assert normalised(found) < 3


@pytest.mark.parametrize("beside", [(0, 0, 1.5, 0, 0, 0), (0, 0, -2.0, 0, 0, 0), (0, 0, 0, 0.012, 0, 0)])
def test_a_start_beside_the_plane_is_told_and_counted(beside: tuple[float, ...], rng: np.random.Generator) -> None:
    """Most lines agree with a part a few mm above its floor and as far aside: it was believed to hundredths of a mm."""
    start = POSE @ Rigid.exp(np.array(beside)) @ ASIDE
    found = refine_pose(PART, [photo(PART, POSE, rng)], start, freedom=ON_ITS_FLOOR)
    assert found.found
    assert "free to move it would lie" in found.reason
    assert normalised(found) < 3


def test_where_a_start_was_foretold_the_plane_is_asked_about_too(rng: np.random.Generator) -> None:
    """A tracked part that leaves its plane was stated ten times too sure."""
    start = POSE @ Rigid.exp(np.array([0, 0, 0, 0.012, 0, 0])) @ ASIDE
    found = refine_pose(PART, [photo(PART, POSE, rng)], start, freedom=ON_ITS_FLOOR, wider=False)
    assert "free to move it would lie" in found.reason
    assert normalised(found) < 3


@pytest.mark.parametrize("above", [0.1, 0.2, 0.3, 0.5])
def test_a_start_little_beside_the_plane_is_counted_too(above: float, rng: np.random.Generator) -> None:
    """Too little to doubt the plane, or enough: the pose is as unsure as that makes it, and the reason says so once."""
    start = POSE @ Rigid(translation=[0, 0, above]) @ ASIDE
    found = refine_pose(PART, [photo(PART, POSE, rng)], start, freedom=ON_ITS_FLOOR)
    assert normalised(found) < 3
    assert found.reason.count("free to move it would lie") == 1
    assert weakest_direction(found.pose, PART.aspects.centre, [photo(PART, POSE, rng)]) in found.reason


def test_a_part_far_from_where_it_may_move_has_no_pose(rng: np.random.Generator) -> None:
    start = POSE @ Rigid(translation=[0, 0, 9.0]) @ ASIDE
    assert not refine_pose(PART, [photo(PART, POSE, rng)], start, freedom=ON_ITS_FLOOR).found
