"""Closed forms of hand-eye calibration, screws, and what motions leave open."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import DegenerateGeometry, TooFewPoints
from cadcam.fit.hand_eye import daniilidis, fixed_in_base, kronecker, motions, park_martin, tsai_lenz
from cadcam.fit.screw import angles_and_slides, freedom, line_of
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

ON_MOTIONS = {"tsai_lenz": tsai_lenz, "park_martin": park_martin, "daniilidis": daniilidis}
HALF_TURNS = [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])]


def random_poses(rng, n, *, turn=1.0, reach=300.0):
    return Rigid(so3.exp(turn * rng.normal(size=(n, 3))), reach * rng.normal(size=(n, 3)))


def exact(rng, n, X=None):
    """Return base_from_flange, held_from_fixed, X, Z of an exact robot."""
    B, Z = random_poses(rng, n), Rigid(so3.exp(rng.normal(size=3)), 900 * rng.normal(size=3))
    X = Rigid(so3.exp(2 * rng.normal(size=3)), 100 * rng.normal(size=3)) if X is None else X
    return B, X.inv @ (B.inv @ Z), X, Z


def apart(one, other):
    return np.abs((one.inv @ other).log()).max()


@pytest.mark.parametrize("solve", ON_MOTIONS.values(), ids=ON_MOTIONS)
@pytest.mark.parametrize("n", [3, 4, 12])
def test_a_closed_form_is_exact_on_exact_motions(rng, solve, n):
    """1e-7 mm: a thousand roundings of 1000 mm, for three poses that happen to turn alike."""
    for _ in range(20):
        B, S, X, _ = exact(rng, n)
        assert apart(solve(*motions(B, S)), X) < 1e-7


@pytest.mark.parametrize("solve", ON_MOTIONS.values(), ids=ON_MOTIONS)
@pytest.mark.parametrize("R", HALF_TURNS)
def test_half_a_turn_is_no_singularity(rng, solve, R):
    B, S, X, _ = exact(rng, 8, Rigid(R, [10.0, -20, 30]))
    assert apart(solve(*motions(B, S)), X) < 1e-7


def flipped(rng, turns_deg, noise=0.0):
    """A flange upright, turned by half about its x, y and z axes, each also turned about z; held_from_fixed, and X."""
    R = np.stack([so3.exp([0, 0, np.radians(turn)]) @ half for turn in turns_deg for half in (np.eye(3), *HALF_TURNS)])
    B = Rigid(R, 300 * rng.normal(size=(len(R), 3)))
    X, Z = (Rigid(so3.exp(rng.normal(size=3)), 100 * rng.normal(size=3)) for _ in range(2))
    off = Rigid.exp(noise * rng.normal(size=(len(R), 6)) * [1, 1, 1, 0.002, 0.002, 0.002])
    return B, (B @ off @ X).inv @ Z, X


@pytest.mark.parametrize("turns_deg", [(0.0,), (0.0, 25.0), (0.0, 40.0, 75.0)], ids=str)
def test_half_turns_about_perpendicular_axes_count_either_way_round(rng, turns_deg):
    """Rotations alone leave half a turn about one of the axes open, and noise reverses axes; positions decide."""
    for _ in range(10):
        B, S, X = flipped(rng, turns_deg)
        assert apart(park_martin(*motions(B, S)), X) < 1e-6
        B, S, X = flipped(rng, turns_deg, noise=0.05)
        off = X.inv @ park_martin(*motions(B, S))
        assert np.linalg.norm(off.log()[3:]) < 10 * 0.05 * 0.002
        assert np.linalg.norm(off.translation) < 10 * (0.05 + 0.05 * 0.002 * 1000)  # by mm, and rad over a metre


def test_poses_without_pairs_give_both_motions_exactly(rng):
    for _ in range(20):
        B, S, X, Z = exact(rng, 6)
        found = kronecker(B, S)
        assert apart(found[0], X) < 1e-7
        assert apart(found[1], Z) < 1e-7
        assert apart(fixed_in_base(B, X, S), Z) < 1e-9


@pytest.mark.parametrize("solve", ON_MOTIONS.values(), ids=ON_MOTIONS)
def test_weights_silence_a_motion_that_is_wrong(rng, solve):
    B, S, X, _ = exact(rng, 6)
    A, C = motions(B, S)
    wrong = Rigid(np.concatenate([A.rotation[:1].swapaxes(1, 2), A.rotation[1:]]), A.translation)
    weights = np.ones(len(A.rotation))
    assert apart(solve(wrong, C, weights=weights), X) > 1e-3
    weights[0] = 1e-24
    assert apart(solve(wrong, C, weights=weights), X) < 1e-6


@pytest.mark.parametrize("solve", ON_MOTIONS.values(), ids=ON_MOTIONS)
def test_parallel_axes_are_refused(rng, solve):
    B = Rigid(so3.exp(np.outer(rng.normal(size=8), [0.6, 0.0, 0.8])), rng.normal(size=(8, 3)))
    S = Rigid().inv @ (B.inv @ Rigid())
    with pytest.raises(DegenerateGeometry, match="parallel"):
        solve(*motions(B, S))
    with pytest.raises(DegenerateGeometry, match="parallel"):
        kronecker(B, S)


def test_too_few_poses_are_refused(rng):
    B, S, *_ = exact(rng, 2)
    with pytest.raises(TooFewPoints):
        park_martin(*motions(B, S))
    with pytest.raises(TooFewPoints):
        kronecker(B, S)


def test_angle_and_slide_of_a_motion_do_not_depend_on_the_frame(rng):
    B, S, *_ = exact(rng, 10)
    (a, d), (b, e) = map(angles_and_slides, motions(B, S))
    np.testing.assert_allclose(a, b, atol=1e-12)
    np.testing.assert_allclose(d, e, atol=1e-9 * 1000 / np.sin(a.min() / 2))


def test_no_pair_of_poses_shows_that_they_are_inverted_but_the_axes_together_do(rng):
    """Inverted poses give motions that are alike the inverse ones: the same angle, the same slide, other axes."""
    B, S, *_ = exact(rng, 10)
    (a, d), (b, e) = angles_and_slides(motions(B, S)[0]), angles_and_slides(motions(B.inv, S)[0])
    np.testing.assert_allclose(a, b, atol=1e-12)
    np.testing.assert_allclose(d, e, atol=1e-9)
    v, w = so3.log(motions(B, S)[0].rotation), so3.log(motions(B.inv, S)[0].rotation)
    assert np.median(np.abs(v @ v.T - w @ w.T)) > 0.1


@pytest.mark.parametrize("n", [3, 8])
def test_inverted_robot_poses_with_the_other_mounting_are_the_same_data(rng, n):
    """B X S = Z for all is inv(B) Z inv(S) = X for all: nothing in the data can tell the two apart."""
    B, S, X, Z = exact(rng, n)
    other = kronecker(B.inv, S.inv)
    assert apart(other[0], Z) < 1e-6
    assert apart(other[1], X) < 1e-6


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def test_motions_about_two_axes_leave_nothing_open(rng):
    for _ in range(50):
        A, _ = motions(*exact(rng, 3)[:2])
        assert not freedom(A, length=500, floor=1e-6).any


def test_turns_about_one_direction_leave_the_slide_along_it(rng):
    for _ in range(50):
        u = unit(rng)
        B = Rigid(so3.exp(rng.uniform(-1, 1, (6, 1)) * u), 50 * rng.normal(size=(6, 3)))
        left = freedom(motions(B, B)[0], length=500, floor=1e-6)
        assert left.turns.shape == (0, 6)
        np.testing.assert_allclose(np.abs(left.slides @ u), [1.0], atol=1e-9)


def test_turns_about_one_line_leave_the_slide_along_and_the_turn_about_it(rng):
    for _ in range(50):
        u, p = unit(rng), 100 * rng.normal(size=3)
        R = so3.exp(rng.uniform(-1, 1, (6, 1)) * u)
        left = freedom(motions(Rigid(R, p - R @ p), Rigid(R, p - R @ p))[0], length=500, floor=1e-6)
        np.testing.assert_allclose(np.abs(left.slides @ u), [1.0], atol=1e-9)
        point, direction = line_of(left.turns[0])
        np.testing.assert_allclose(np.abs(direction @ u), 1.0, atol=1e-9)
        np.testing.assert_allclose(np.cross(point - p, u), 0, atol=1e-6)


def test_what_is_open_commutes_with_every_motion_and_so_cannot_be_seen(rng):
    """exp(xi) X solves A X = X B as well as X does: the theorem behind the refusals."""
    u, p = unit(rng), 100 * rng.normal(size=3)
    R = so3.exp(rng.uniform(-1, 1, (6, 1)) * u)
    B = Rigid(R, p - R @ p)
    X = Rigid(so3.exp(rng.normal(size=3)), 100 * rng.normal(size=3))
    S = X.inv @ (B.inv @ Rigid())
    A, C = motions(B, S)
    left = freedom(A, length=500, floor=1e-6)
    for xi in [np.append(left.slides[0] * 40, [0, 0, 0]), 0.7 * left.turns[0]]:
        other = Rigid.exp(xi) @ X
        np.testing.assert_allclose((A @ other).matrix, (other @ C).matrix, atol=1e-9)
        assert apart(other, X) > 0.1


@pytest.mark.parametrize("n", [2, 6])
def test_no_turn_leaves_every_slide(rng, n):
    B = Rigid(np.broadcast_to(np.eye(3), (n, 3, 3)), 50 * rng.normal(size=(n, 3)))
    left = freedom(motions(B, B)[0], length=500, floor=1e-6)
    assert len(left.slides) == 3
    assert len(left.turns) == (1 if n == 2 else 0)  # one translation also leaves the turn about its own direction
