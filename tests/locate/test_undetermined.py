"""What a photo cannot show is said to be undetermined, and never to be known to the last digit."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.files.pose_estimate import pose_estimate_as_json
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.part import Part
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.track.tracker import _spread_px
from cadcam.report.locate import pose_table, track_table

from ..cad.solids import box, prism
from .photos import photo, view

AWAY = Rigid.exp([300.0, -200, 500, 0.3, -0.8, 0.5])
AXIS = np.array([0.0, 0, 1])


def turned(where: Rigid) -> Part:
    """Return a round bar whose axis is `where`'s z axis, with the coordinates of an STL file: of 32 bits."""
    mesh = prism(64).transformed(where)
    return Part.of(Mesh.single(mesh.vertices.astype(np.float32).astype(float), mesh.faces))


@pytest.mark.parametrize("where", [Rigid(), AWAY])
def test_free_to_turn_about_its_own_axis_nothing_is_determined(where: Rigid, rng: np.random.Generator) -> None:
    part = turned(where)
    pose = view(part, (0.8, -0.5, 0.7))
    start = pose @ where @ Rigid.exp([0, 0, 0, 0, 0, 0.3]) @ where.inv
    about = Freedom.about(where.translation, where.rotation @ AXIS, frame="part")
    shot = photo(part, pose, rng)
    found = refine_pose(part, [shot], start, freedom=about)
    assert found.found, found.reason
    assert "; position as stated; not determined: the turn about the axis" in found.reason
    assert "within" not in found.reason
    np.testing.assert_array_equal(found.pose.world_from_part.matrix, start.matrix)
    axis = np.concatenate([np.zeros(3), where.rotation @ AXIS])
    assert np.degrees(np.sqrt(axis @ found.pose.covariance @ axis)) == pytest.approx(180 / np.sqrt(3), rel=1e-6)
    rows = dict(pose_table(found.pose, shot, radius_mm=40.0).rows)
    assert rows["weakest"] == "nothing else was free to move"
    assert rows["not determined"].startswith("the turn about the axis")


def test_a_turned_part_is_as_sure_as_its_axis_is_wherever_its_origin_lies(rng: np.random.Generator) -> None:
    """Of an axis 600 mm beside the origin, the unknown turn made the origin unknown by 870 mm."""
    part = turned(AWAY)
    pose = view(part, (0.8, -0.5, 0.7))
    shot = photo(part, pose, rng)
    found = refine_pose(part, [shot], pose @ Rigid.exp([0.8, -0.5, 0.4, 0, 0, 0]))
    assert found.found, found.reason
    rows = dict(pose_table(found.pose, shot, radius_mm=40.0).rows)
    assert max(float(sd) for sd in rows["sigma of turns about them, deg"].split(",")) < 1.0
    assert "not determined" in rows
    said = pose_estimate_as_json(found.pose)["undetermined"]
    assert said["in_words"] in found.reason
    (twist,) = np.array(said["twists"]).T
    onto = pose @ Rigid.exp(2.0 * twist)
    ends = AWAY @ np.array([[0.0, 0, 0], [0, 0, 30]])
    np.testing.assert_allclose(onto @ ends, pose @ ends, atol=1e-3)


def test_free_to_turn_about_its_middle_it_says_how_sure_the_turn_is(rng: np.random.Generator) -> None:
    """Its middle does not move by that: it was "within 0 mm in any direction"."""
    part = Part.of(box([-20, -15, -10], [20, 15, 10]))
    pose = view(part, (0.8, -0.5, 0.7))
    start = pose @ Rigid.exp([0, 0, 0, 0, 0, 0.02])
    found = refine_pose(part, [photo(part, pose, rng)], start, freedom=Freedom.about([0, 0, 5], AXIS, frame="part"))
    assert found.found, found.reason
    sd = np.degrees(np.sqrt(found.pose.covariance[5, 5]))
    assert found.reason.endswith(f"; position as stated; turn about the part's z axis within {sd:.2g} deg")
    assert pose_estimate_as_json(found.pose)["undetermined"] is None


def test_an_axis_beside_the_part_s_own_is_no_turn_that_cannot_be_seen() -> None:
    part = turned(Rigid())
    middle, radius = part.aspects.centre, part.aspects.radius
    for point, axis in (([0.05, 0, 0], AXIS), ([0, 0, 0], [0, 0.01, 1])):
        beside = Freedom.about(point, axis, frame="part")
        assert beside.among(part.spins, Rigid(), center=middle, radius=radius).shape == (6, 0)


def test_a_turned_part_whose_axis_lies_beside_its_origin_is_tracked_as_its_place_is_known(
    rng: np.random.Generator,
) -> None:
    """Its place was said to be known to 272 mm, and lines were searched for as far as ever."""
    where = Rigid(translation=(150.0, 0.0, 0.0))
    part = turned(where)
    pose = view(part, (0.8, -0.5, 0.7))
    found = refine_pose(part, [photo(part, pose, rng)], pose)
    assert found.found
    assert np.linalg.norm(found.pose.sigma_mm) > 10
    shot = photo(part, pose, rng)
    assert _spread_px(part.scene.mesh.box_corners, found.pose, shot) < 0.5
    entry = {"frame": 0, "found": True, "how": "kept", "quality": 0.9, "pose": pose_estimate_as_json(found.pose)}
    rows = dict(track_table([entry]).rows)
    assert float(rows["median sigma of the place, mm"]) < 1
