"""Smooth bodies: nothing of them but a contour shows, and the model has it as that of its facets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import chi2

from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import circle, prism
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.locate.in_photos import distinct_poses, locate_part
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo

from .smooth import CAMERA, disc, drop, globe, pictured, posed

VIEWS = ((1.0, 0.4, 0.5), (0.3, -1.0, 0.9), (-0.8, 0.5, -0.3))
STONE = (55.0, 42.0, 33.0)
BODIES = {"stone": (globe(4, STONE), globe(6, STONE)), "drop": (drop(64), drop(300))}
START = Rigid.exp([3.0, -2.0, 4.0, 0.1, -0.12, 0.08])


@pytest.mark.parametrize("views", [VIEWS[:1], pytest.param(VIEWS, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", BODIES)
def test_a_smooth_body_is_found_in_noise_by_its_whole_contour(
    name: str, views: Sequence[tuple[float, float, float]], rng: np.random.Generator
) -> None:
    """From rough starts, and piece by piece, most of these poses were refused."""
    model, body = BODIES[name]
    part, p = Part.of(model), model.vertices
    for direction in views:
        pose = posed(direction, away=460.0)
        found = locate_part(part, [Photo.of(pictured(body, pose, rng, noise=0.03), CAMERA)], pose @ START)
        assert found.found, found.reason
        extents = [np.ptp(CAMERA.project(at @ p), axis=0) for at in (pose, found.pose.world_from_part)]
        assert extents[1] == pytest.approx(extents[0], abs=1.5)


@pytest.mark.parametrize("direction", [pytest.param((1.0, 0.3, 0.1), marks=pytest.mark.slow), (0.2, -1.0, -0.2)])
def test_another_round_body_that_shares_one_end_is_not_taken_for_it(
    direction: tuple[float, float, float], rng: np.random.Generator
) -> None:
    """Half of a ball's contour lies on the round end of a pin, the other half to one side, as if it were hidden."""
    pin = np.array([1.0, 1, 2.2]) * globe(6).vertices
    pin = Mesh.single(np.where(pin[:, 2:] > 0, pin, globe(6).vertices), globe(6).faces)
    pose = posed(direction, away=600.0)
    answer = locate_part(Part.of(globe(4)), [Photo.of(pictured(pin, pose, rng, noise=0.01), CAMERA)], pose @ START)
    assert not answer.found


@pytest.mark.parametrize(
    ("level", "count"), [(3, 3), *(pytest.param(level, 8, marks=pytest.mark.slow) for level in (3, 4, 5))]
)
def test_where_a_ball_is_is_as_uncertain_as_its_facets_make_it(
    level: int, count: int, rng: np.random.Generator
) -> None:
    """1280 facets and more, photos of the true ball, three views or eight.

    At 1280 the contour lies 0.2 px inside the true one. The bound is that of chi square of three a view: one in a
    thousand.
    """
    part, squares = Part.of(globe(level)), []
    for _ in range(count):
        pose = posed(tuple(rng.normal(size=3)), away=450.0)
        start = pose @ Rigid.exp([*rng.normal(scale=4, size=3), *rng.normal(scale=0.2, size=3)])
        found = locate_part(part, [Photo.of(disc(pose, rng), CAMERA)], start)
        assert found.found, found.reason
        off = (found.pose.world_from_part.inv @ pose).translation
        squares.append(off @ np.linalg.solve(found.pose.covariance[:3, :3], off))
    assert sum(squares) < chi2.ppf(0.999, 3 * count)
    assert np.sqrt(found.pose.covariance[3, 3]) == pytest.approx(np.pi / np.sqrt(3), rel=0.01)


@pytest.mark.parametrize("start", [None, pytest.param(START, marks=pytest.mark.slow)])
def test_a_ball_turned_otherwise_is_no_other_pose(start: Rigid | None, rng: np.random.Generator) -> None:
    """Each of a search's hypotheses has it turned by chance; up to nine poses that differ in nothing else were told."""
    pose = posed((1.0, 0.3, 0.4), away=450.0)
    photo = Photo.of(disc(pose, rng), CAMERA)
    found = locate_part(Part.of(globe(3)), [photo], None if start is None else pose @ start)
    assert found.found
    assert found.alternatives == ()
    assert "look" not in found.reason.replace("the part looks the same", "")


def test_of_a_turned_part_only_what_a_photo_tells_apart_is_another_pose() -> None:
    """A pin far from its file's origin; turned about its axis it stays, end for end it does not."""
    away = Rigid(exp(np.array([0.3, -0.5, 0.2])), np.array([900.0, -4000.0, 300.0]))
    part = Part.of(prism(circle((0, 0), 10, 48), -40, 40, name="pin").transformed(away))
    spun, over = (away @ Rigid(exp(np.array(w)), np.zeros(3)) @ away.inv for w in ([0, 0, 0.7], [np.pi, 0, 0]))
    at, slid = Rigid(), away @ Rigid(translation=np.array([0, 0, 2.0])) @ away.inv
    assert len(part.spins.T) == 1
    here, *others = (Location.nowhere(pose, "") for pose in (at, spun, over, over @ spun, slid))
    assert distinct_poses(part, here, others) == [others[1], others[3]]
    assert distinct_poses(part, here, others[2:], others[:2]) == [*others[:2], others[3]]
