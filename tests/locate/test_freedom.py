"""Restricted motions: what they leave fixed stays fixed, wherever the part is."""

from __future__ import annotations

import pickle
from functools import partial

import numpy as np
import pytest

from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE, Freedom, aligned, carried
from cadcam.locate.track.tracker import Tracker
from cadcam.locate.views.view_range import WHOLE_SPHERE

from .scene import block


@pytest.fixture
def pose(rng: np.random.Generator) -> Rigid:
    return Rigid.exp(np.concatenate([rng.normal(size=3) * 500, rng.normal(size=3)]))


def moved(freedom: Freedom, pose: Rigid, rng: np.random.Generator) -> Rigid:
    for _ in range(3):
        B = freedom.at(pose)
        pose = pose @ Rigid.exp(B @ rng.normal(size=B.shape[1]) * 0.5)
    return pose


def test_a_part_on_a_floor_keeps_every_point_s_height(pose: Rigid, rng: np.random.Generator) -> None:
    n, p = np.array([0.1, -0.3, 1.0]), rng.normal(size=(5, 3)) * 100
    after = moved(Freedom.planar(n), pose, rng)
    assert np.abs((after @ p - pose @ p) @ n).max() < 1e-10 * 1000
    assert np.abs(after @ p - pose @ p).max() > 0.1


def test_a_part_on_an_axis_keeps_the_axis(pose: Rigid, rng: np.random.Generator) -> None:
    c, w = np.array([30.0, -20.0, 700.0]), np.array([1.0, 2.0, 0.5])
    on_axis = pose.inv @ (c + np.linspace(-3, 3, 4)[:, None] * w)
    after = moved(Freedom.about(c, w), pose, rng)
    np.testing.assert_allclose(after @ on_axis, pose @ on_axis, atol=1e-9)


def test_a_part_on_a_rail_keeps_its_rotation(pose: Rigid, rng: np.random.Generator) -> None:
    d = np.array([0.0, 3.0, 4.0])
    after = moved(Freedom.along(d), pose, rng)
    np.testing.assert_allclose(after.rotation, pose.rotation, atol=1e-14)
    assert np.linalg.norm(np.cross(after.translation - pose.translation, d)) < 1e-10
    own = moved(Freedom.along(d, frame="part"), pose, rng)
    assert np.linalg.norm(np.cross(own.translation - pose.translation, pose.rotation @ d)) < 1e-9


@pytest.mark.parametrize("freedom", [FREE, Freedom.planar([0, 0, 1]), Freedom.along([1, 0, 0])])
def test_directions_are_orthonormal(freedom: Freedom, pose: Rigid) -> None:
    B = freedom.at(pose)
    np.testing.assert_allclose(B.T @ B, np.eye(B.shape[1]), atol=1e-12)


@pytest.mark.parametrize("basis", [np.zeros((6, 0)), np.ones((6, 2)), np.eye(6)[:5]])
def test_what_is_no_basis_is_refused(basis: np.ndarray) -> None:
    with pytest.raises(BadValue):
        Freedom(basis)


def test_directions_without_length_are_refused() -> None:
    with pytest.raises(BadValue, match="normal of the plane"):
        Freedom.planar([0, 0, 0])
    with pytest.raises(BadValue, match="frame"):
        Freedom(np.eye(6), "camera")  # type: ignore[arg-type]  # the mistake that is tested


def test_signatures_show_a_freedom_in_a_few_words() -> None:
    assert repr(FREE) == "Freedom()"
    assert repr(Freedom.planar([0, 0, 1])) == "Freedom(3 of 6 twists, frame='world')"


@pytest.mark.parametrize("freedom", [FREE, Freedom.planar([0.1, -0.3, 1.0]), Freedom.along([1, 2, 3])])
def test_aligned_motions_are_the_same_ones_about_a_point_and_a_line_of_sight(
    freedom: Freedom, pose: Rigid, rng: np.random.Generator
) -> None:
    point, sight = np.array([1e4, -4e3, 2e3]), rng.normal(size=3)
    B = freedom.at(pose)
    A = aligned(B, point, sight)
    assert A.shape == B.shape
    assert np.linalg.matrix_rank(A) == B.shape[1]
    left = A - B @ np.linalg.lstsq(B, A)[0]
    assert np.abs(left).max() < 1e-10 * np.linalg.norm(point)
    turns = np.linalg.norm(A[3:], axis=0) > 1e-6
    still = A[:3] + np.cross(A[3:].T, point).T  # how the point moves: a turn leaves it where it is, but along the turn
    assert np.abs(np.cross(still.T, A[3:].T)[turns]).max(initial=0) < 1e-9 * np.linalg.norm(point)
    if freedom is FREE:
        np.testing.assert_allclose(np.cross(A[:3, 2], sight), 0, atol=1e-12)


@pytest.mark.parametrize(
    "freedom",
    [FREE, Freedom.planar([0.1, -0.3, 1.0]), Freedom.along([1, 2, 3]), Freedom.about([30, -20, 700], [1, 2, 0])],
)
def test_what_is_carried_moves_as_its_twist_says_and_only_as_it_may(
    freedom: Freedom, pose: Rigid, rng: np.random.Generator
) -> None:
    """To first order as along a screw: half the step leaves a quarter of the difference; and what is free stays so."""
    point, p = rng.normal(size=3) * 100, rng.normal(size=(5, 3)) * 100
    B = aligned(freedom.at(pose), point, rng.normal(size=3))
    x = rng.normal(size=B.shape[1]) / np.maximum(np.abs(B[3:]).max(axis=0) * 100, 1)

    def apart(step: float) -> float:
        screw = pose @ Rigid.exp(B @ (step * x))
        return float(np.linalg.norm(carried(pose, B, step * x, point) @ p - screw @ p, axis=1).max())

    assert apart(0.01) <= 0.26 * apart(0.02) + 1e-9
    done = (pose.inv @ carried(pose, B, 100 * x, point)).log()
    free = freedom.at(pose)
    assert np.linalg.norm(done - free @ (free.T @ done)) < 1e-9 * np.linalg.norm(done)


def test_a_part_that_nears_and_turns_stays_on_its_line_of_sight(pose: Rigid) -> None:
    """Along a screw it would slide aside by half its turn times its path: a long lens' whole picture."""
    point, sight = np.array([40.0, -30.0, 20.0]), np.array([2e4, -1e4, 5e4])
    B, x = aligned(FREE.basis, point, sight), np.array([0, 0, 500.0, 0.05, -0.08, 0.02])
    along = pose.rotation @ sight / np.linalg.norm(sight)
    path = carried(pose, B, x, point) @ point - pose @ point
    np.testing.assert_allclose(path, 500.0 * along, atol=1e-9)
    slid = pose @ Rigid.exp(B @ x) @ point - pose @ point
    assert np.linalg.norm(slid - along * (slid @ along)) > 15


def test_all_six_motions_are_no_restriction_whoever_made_them(rng: np.random.Generator) -> None:
    """A copy of `FREE`, and six twists of the world, mean the same: no start is needed then."""
    tracker = partial(Tracker, block(), None, velocity=True, texture=False, views=WHOLE_SPHERE)
    for freedom in (Freedom(), pickle.loads(pickle.dumps(FREE)), Freedom(rng.normal(size=(6, 6)), "world")):
        assert freedom.full
        tracker(freedom=freedom)
    with pytest.raises(BadValue, match="freedom is given without a start"):
        tracker(freedom=Freedom.planar([0, 0, 1]))
