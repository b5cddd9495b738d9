"""The direct linear transform, the three-point problem, evenly spread rotations, and the extents of points."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from cadcam.camera.extended_pinhole import ExtendedPinhole, uv_from_pixel_matrix
from cadcam.errors import DegenerateGeometry, TooFewPoints, UnknownName
from cadcam.fit.dlt import FORMS, dlt
from cadcam.fit.extents import extents, flatness, refuse_flat, spread_subset, triples
from cadcam.fit.global_search import spread_rotations
from cadcam.fit.p3p import p3p
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

D = np.radians
TRUTH = ExtendedPinhole(120.0, 80.0, 300.0, D(20), D(-35), D(75), 1.03, 900.0, D(0.8), 270.0, 400.0)


@pytest.fixture
def cloud(rng):
    return TRUTH.camera_from_world.inv @ (rng.uniform(-1, 1, (10, 3)) * [280, 200, 250] + [0, 0, 900])


def seen(p, e=TRUTH):
    return e.camera((768, 576)).project(e.camera_from_world @ p)


@pytest.mark.parametrize("form", FORMS)
def test_exact_points_give_the_exact_camera(cloud, form):
    e = ExtendedPinhole.from_matrix(uv_from_pixel_matrix(dlt(cloud, seen(cloud), form=form)))
    assert e.vector == pytest.approx(TRUTH.vector, rel=1e-8, abs=1e-8)


def test_the_normalised_form_does_not_depend_on_units_or_origins(cloud, rng):
    """Noise makes the forms differ: a moved and scaled world must still give the same pixels."""
    q = seen(cloud) + rng.normal(size=(10, 2))
    T = Rigid.exp([4e4, -2e4, 1e4, 0.3, -0.8, 0.5])

    def pixels(form, p):
        u = np.column_stack([p, np.ones(10)]) @ dlt(p, q, form=form).T
        return u[:, :2] / u[:, 2:]

    moved = 0.001 * (T @ cloud)
    assert pixels("normalised", moved) == pytest.approx(pixels("normalised", cloud), abs=1e-6)
    assert np.abs(pixels("c23", moved) - pixels("c23", cloud)).max() > 1e-3


def test_degenerate_layouts_are_refused(cloud):
    with pytest.raises(TooFewPoints):
        dlt(cloud[:5], seen(cloud[:5]))
    flat = cloud.copy()
    flat[:, 2] = flat[0, 2]
    with pytest.raises(DegenerateGeometry, match="on a plane"):
        dlt(flat, seen(flat))
    with pytest.raises(UnknownName, match="form of the direct linear transform"):
        dlt(cloud, seen(cloud), form="c22")


def test_points_on_a_cubic_through_the_camera_are_refused():
    """A twisted cubic through the focal centre: the classic configuration without a unique camera."""
    t = np.linspace(-1, 1, 9)
    t = t[np.abs(t) > 0.05]
    curve = np.column_stack([t, t**2, t**3]) * 300
    R = Rigid.look_at([0, 0, 0], [30.0, 80.0, 40.0])
    u = R @ curve
    q = 800 * u[:, :2] / u[:, 2:]  # as a matrix sees them, before or behind
    with pytest.raises(DegenerateGeometry, match="common cubic curve"):
        dlt(curve, q)


def test_the_three_point_problem_contains_the_truth_and_all_its_poses_fit(rng):
    """500 random triples: a true pose is recovered; every real solution sees the points on the rays."""
    R = so3.from_quaternion(rng.normal(size=(500, 4)))
    F = 10 * rng.normal(size=(500, 3))
    in_camera = rng.uniform(-1, 1, (500, 3, 3)) * 2 + [0, 0, 4]
    p = np.einsum("bji,bnj->bni", R, in_camera) + F[:, None]
    rays = in_camera / np.linalg.norm(in_camera, axis=-1, keepdims=True)
    errors = []
    for i in range(500):
        F_i, R_i = p3p(p[i : i + 1], rays[i : i + 1])
        assert 1 <= len(F_i) <= 4
        errors.append(np.abs(F_i - F[i]).max(axis=1).min())
        assert np.abs(R_i @ np.swapaxes(R_i, -1, -2) - np.eye(3)).max() < 1e-12
    assert np.median(errors) < 1e-11
    assert max(errors) < 1e-5


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 1e-6, 1e-5, 1e-4])
def test_corners_of_a_board_seen_straight_on_are_no_exception(tilt):
    """Every triple of a square's corners, in every order: of an isosceles one two equations agree whatever s_2 is."""
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    p = square[list(permutations(range(4), 3))]
    pose = Rigid(so3.exp([0.6 * tilt, 0.8 * tilt, 0.3]), [0.0, 0.0, 7.0])
    in_camera = pose @ p
    rays = in_camera / np.linalg.norm(in_camera, axis=-1, keepdims=True)
    for one, sight in zip(p, rays, strict=True):
        F, _ = p3p(one[None], sight[None])
        assert np.abs(F - pose.origin).max(axis=1).min() < 1e-4  # double roots are known to the root of rounding


def test_a_triple_without_area_gives_no_pose():
    line = np.array([[[0.0, 0, 5], [1, 0, 5], [2, 0, 5]]])
    rays = line / np.linalg.norm(line, axis=-1, keepdims=True)
    F, R = p3p(line, rays)
    assert len(F) == len(R) == 0


def test_spread_rotations_leave_no_hole(rng):
    """24 rotations: none of SO(3) is farther than 90 degrees from one; 500 bring that under 30."""
    anywhere = so3.from_quaternion(rng.normal(size=(2000, 4)))
    for count, hole in ((24, 90.0), (500, 30.0)):
        cosine = (np.einsum("aij,bij->ab", anywhere, spread_rotations(count)) - 1) / 2
        nearest = np.degrees(np.arccos(np.clip(cosine.max(axis=1), -1, 1)))
        assert nearest.max() < hole


def test_extents_are_those_of_the_axes_whatever_the_turn(rng):
    p = rng.normal(size=(4000, 3)) * [30, 10, 0.2]
    turned = Rigid.exp([1e4, 0, 0, 0.5, 0.2, -0.7]) @ p
    assert extents(turned) == pytest.approx([30, 10, 0.2], rel=0.05)
    assert flatness(turned) == pytest.approx(0.2 / 30, rel=0.1)
    assert flatness(np.zeros((4, 3))) == 0


def test_eight_unknowns_are_the_limit_on_a_plane():
    p = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]])
    refuse_flat(p, unknowns=8)
    with pytest.raises(DegenerateGeometry):
        refuse_flat(p, unknowns=9)


def test_a_spread_subset_contains_the_corners():
    grid = np.array([[x, y, 0.0] for x in range(11) for y in range(11)])
    corners = {(0, 0), (0, 10), (10, 0), (10, 10)}
    assert corners <= {tuple(int(v) for v in p[:2]) for p in grid[spread_subset(grid, 5)]}
    assert len(spread_subset(grid, 500)) == 121


def test_triples_put_the_largest_area_first():
    q = np.array([[0.0, 0], [100, 0], [0, 100], [50, 50], [10, 0]])
    picked = triples(np.column_stack([q, np.zeros(5)]), q, 20)
    assert set(picked[0].tolist()) == {0, 1, 2}
    assert len(picked) == 10
