"""What contradicts itself or cannot be told is refused: with the evidence, the direction, and the way out."""

from __future__ import annotations

import re

import numpy as np
import pytest

from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye, calibrate_hand_eye_from_poses
from cadcam.calibrate.handeye.conventions import conventions_that_fit
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, DegenerateMotions, InconsistentPoses, TooFewPoints, UnknownName
from cadcam.files.robot_conventions import CONVENTIONS
from cadcam.fit.screw import line_of
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

from .robots import board, cell, random_rigid, target_poses

MOUNTINGS = ["eye-in-hand", "eye-to-hand"]
WIDE = Camera.from_focal((4000, 3000), 1200.0)


@pytest.fixture(params=MOUNTINGS)
def noisy(rng, request):
    return cell(rng, 12, mounting=request.param, robot=(0.1, 0.0003))


def refused(c, error, match, *, robot=None, observations=None, mounting=None):
    with pytest.raises(error, match=match) as caught:
        calibrate_hand_eye(
            c.base_from_flange if robot is None else robot,
            c.observations if observations is None else observations,
            c.camera,
            mounting=c.mounting if mounting is None else mounting,
        )
    return str(caught.value)


def picked(poses, index):
    return Rigid(poses.rotation[index], poses.translation[index])


def test_inverted_robot_poses_are_named(noisy):
    said = refused(noisy, InconsistentPoses, "invert them", robot=noisy.base_from_flange.inv)
    assert "flange_from_base" in said


def test_the_other_mounting_is_named(noisy):
    other = MOUNTINGS[noisy.mounting == "eye-in-hand"]
    said = refused(noisy, InconsistentPoses, f"the mounting is {noisy.mounting}", mounting=other)
    assert f"contradict an {other} camera" in said


def test_a_robot_in_metres_is_named(noisy):
    B = noisy.base_from_flange
    refused(noisy, InconsistentPoses, "m against mm", robot=Rigid(B.rotation, B.translation / 1000))


def test_a_target_in_metres_or_inches_is_named(noisy):
    for unit, name in ((1000, "m against mm"), (25.4, "inches against mm")):
        seen = [Observations(o.p_world / unit, o.q) for o in noisy.observations]
        refused(noisy, InconsistentPoses, name, observations=seen)


def test_inverted_and_in_metres_at_once_is_named(noisy):
    B = noisy.base_from_flange
    robot = Rigid(B.rotation, B.translation / 1000).inv
    said = refused(noisy, InconsistentPoses, "invert them", robot=robot)
    assert "m against mm" in said


def test_quaternions_read_in_the_wrong_order_are_named(noisy):
    """A quaternion with w moved to the end gives rotations that turn by the same angles, about other axes."""
    B = noisy.base_from_flange
    q = np.roll(so3.quaternion(B.rotation), 1, axis=1)
    refused(noisy, InconsistentPoses, "w first or last", robot=Rigid(so3.from_quaternion(q), B.translation))


def test_lists_that_are_shifted_against_each_other_are_named(noisy):
    robot = picked(noisy.base_from_flange, np.roll(np.arange(12), 1))
    refused(noisy, InconsistentPoses, "moved up by 1 line", robot=robot)
    refused(noisy, InconsistentPoses, "in reversed order", robot=picked(noisy.base_from_flange, np.arange(12)[::-1]))


def test_lists_in_no_common_order_are_refused(noisy, rng):
    robot = picked(noisy.base_from_flange, rng.permutation(12))
    refused(noisy, InconsistentPoses, "do not belong together", robot=robot)


def test_two_poses_exchanged_are_named(noisy):
    index = np.arange(12)
    index[[3, 8]] = [8, 3]
    said = refused(noisy, InconsistentPoses, "2 of 12 poses", robot=picked(noisy.base_from_flange, index))
    assert "'4'" in said
    assert "'9'" in said


def test_a_mistyped_coordinate_is_named(noisy):
    t = noisy.base_from_flange.translation.copy()
    t[5, 1] += 20
    said = refused(noisy, InconsistentPoses, "1 of 12 poses", robot=Rigid(noisy.base_from_flange.rotation, t))
    off = re.search(r"'6' \((\S+) mm", said)
    assert off is not None
    assert float(off[1]) == pytest.approx(20, abs=3)


def test_a_flip_among_camera_poses_is_named_as_such(noisy):
    """Camera poses alone cannot be flipped back: the second pose of a flat target is named, and called what it is."""
    C = noisy.camera_from_target
    R = C.rotation.copy()
    sight = C.translation[2] / np.linalg.norm(C.translation[2])
    R[2] = (np.eye(3) - 2 * np.outer(sight, sight)) @ R[2] @ np.diag([1.0, 1, -1])
    assert np.linalg.norm(so3.log(R[2].T @ C.rotation[2])) > 0.1
    with pytest.raises(InconsistentPoses, match=r"'3'.*flat target's second pose"):
        calibrate_hand_eye_from_poses(noisy.base_from_flange, Rigid(R, C.translation), mounting=noisy.mounting)


def test_a_small_mistake_is_marked_and_nothing_else(noisy):
    t = noisy.base_from_flange.translation.copy()
    t[7] += [1.2, -0.8, 0.9]
    found = calibrate_hand_eye(
        Rigid(noisy.base_from_flange.rotation, t), noisy.observations, noisy.camera, mounting=noisy.mounting
    )
    assert np.flatnonzero(found.suspicious).tolist() == [7]
    clean = calibrate_hand_eye(noisy.base_from_flange, noisy.observations, noisy.camera, mounting=noisy.mounting)
    assert not clean.suspicious.any()


def moved(rng, kind, n):
    """Return motions (n) of a flange that leave something open, their direction and a point of their axis."""
    u, p = rng.normal(size=3), rng.uniform(-50, 50, 3)
    u /= np.linalg.norm(u)
    still = np.broadcast_to(np.eye(3), (n, 3, 3))
    R = so3.exp(u * rng.uniform(-0.6, 0.6, (n, 1)))
    motions = {
        "one axis": lambda: Rigid(R, rng.uniform(-40, 40, (n, 3))),
        "one line": lambda: Rigid(R, p - R @ p),
        "no turn": lambda: Rigid(still, rng.uniform(-60, 60, (n, 3))),
        "one way": lambda: Rigid(still, u * rng.uniform(-60, 60, (n, 1))),
        "no motion": lambda: Rigid(still, np.zeros((n, 3))),
    }
    return motions[kind](), u, p


def degenerate(rng, kind, mounting, robot):
    """Return a cell whose robot makes such motions, and their direction and point."""
    n = int(rng.integers(3, 16))
    D, u, p = moved(rng, kind, n)
    held = random_rigid(rng, 60)
    C = target_poses(rng, 1, tilt=0.3, distance=800)
    first = Rigid(C.rotation[0], C.translation[0])
    S = held.inv @ (D.inv @ (held @ (first if mounting == "eye-in-hand" else first.inv)))
    C = S if mounting == "eye-in-hand" else S.inv
    seen = [
        Observations(board(), WIDE.project(board() @ R.T + t) + 0.2 * rng.normal(size=(54, 2)))
        for R, t in zip(C.rotation, C.translation, strict=True)
    ]
    off = Rigid(so3.exp(robot[1] * rng.normal(size=(n, 3))), robot[0] * rng.normal(size=(n, 3)))
    return random_rigid(rng, 500) @ D @ off, seen, u, p


@pytest.mark.parametrize("kind", ["one axis", "one line", "no turn", "one way", "no motion"])
@pytest.mark.parametrize("robot", [(0.0, 0.0), (0.1, 0.0003), (0.5, 0.002)], ids=["exact", "good", "poor"])
def test_motions_that_cannot_tell_are_refused_and_what_is_open_is_named(rng, kind, robot):
    """Four random cells a case, of 3 to 15 poses; directions to 0.1 rad, many times what the noise allows."""
    for k in range(4):
        mounting = MOUNTINGS[k % 2]
        robot_poses, seen, u, p = degenerate(rng, kind, mounting, robot)
        with pytest.raises(DegenerateMotions, match=r"free (is|are).*Evidence.*Add poses") as caught:
            calibrate_hand_eye(robot_poses, seen, WIDE, mounting=mounting)
        slides, turns = np.array(caught.value.slides), np.array(caught.value.turns)
        if kind in ("one axis", "one line"):
            assert np.abs(slides @ u).max() > np.cos(0.1)
        else:
            assert len(slides) == 3
        if kind == "one line":
            point, direction = line_of(turns[np.argmax(np.abs(turns[:, 3:] @ u))])
            assert abs(direction @ u) > np.cos(0.1)
            assert np.linalg.norm(np.cross(point - p, u)) < 1 + 300 * 5 * robot[1] + 10 * robot[0]
        if kind == "no motion":
            assert len(turns) == 3
        words = "camera" if mounting == "eye-in-hand" else "target"
        assert f"where the {words} sits on the flange" in str(caught.value)


def test_small_but_sufficient_turns_are_not_refused(rng):
    """5 deg about two axes, a good robot: uncertain, and the sigmas say so."""
    C = target_poses(rng, 12, tilt=0.09)
    C = Rigid(so3.exp(so3.log(C.rotation) * [1, 1, 0.1]), C.translation)
    for mounting in MOUNTINGS:
        c = cell(rng, mounting=mounting, camera_from_target=C, robot=(0.05, 0.0002))
        found = calibrate_hand_eye(c.base_from_flange, c.observations, c.camera, mounting=mounting)
        pose = found.flange_from_held if mounting == "eye-in-hand" else found.base_from_fixed
        z = (pose.inv @ c.camera_pose).log() / np.sqrt(np.diag(found.covariance_of_camera))
        assert np.abs(z).max() < 4.5


def test_too_few_poses_and_wrong_arguments_are_refused(rng):
    c = cell(rng, 4)
    with pytest.raises(TooFewPoints, match="at least 3"):
        calibrate_hand_eye(picked(c.base_from_flange, [0, 1]), c.observations[:2], c.camera, mounting=c.mounting)
    with pytest.raises(BadValue, match="one number for all"):
        calibrate_hand_eye(c.base_from_flange, c.observations[:3], c.camera, mounting=c.mounting)
    with pytest.raises(BadValue, match="a batch of n poses"):
        calibrate_hand_eye(Rigid(), c.observations, c.camera, mounting=c.mounting)
    with pytest.raises(UnknownName, match="eye-in-hand"):
        calibrate_hand_eye(c.base_from_flange, c.observations, c.camera, mounting="eye-in-head")  # type: ignore[arg-type]  # the mistake that is tested
    poses = (c.base_from_flange, c.camera_from_target)
    with pytest.raises(BadValue, match=r"shape \(6, 6\) or \(4, 6, 6\)"):
        calibrate_hand_eye_from_poses(*poses, mounting=c.mounting, covariance=np.zeros((3, 6, 6)))
    line = [*c.observations[:3], Observations(np.outer(np.arange(4.0), [30, 0, 0]), c.observations[3].q[:4])]
    with pytest.raises(BadValue, match="picture '4'"):
        calibrate_hand_eye(c.base_from_flange, line, c.camera, mounting=c.mounting)
    few = [*c.observations[:3], Observations(board()[:3], c.observations[3].q[:3])]
    with pytest.raises(TooFewPoints, match="'4'"):
        calibrate_hand_eye(c.base_from_flange, few, c.camera, mounting=c.mounting)


def written(R, convention):
    """Return the numbers of rotations (n, 3, 3) in some of the conventions, from their definitions."""
    zyx = np.degrees([np.arctan2(R[:, 1, 0], R[:, 0, 0]), np.arcsin(-R[:, 2, 0]), np.arctan2(R[:, 2, 1], R[:, 2, 2])]).T
    xyz = np.degrees(
        [np.arctan2(-R[:, 1, 2], R[:, 2, 2]), np.arcsin(R[:, 0, 2]), np.arctan2(-R[:, 0, 1], R[:, 0, 0])]
    ).T
    q = so3.quaternion(R)
    return {
        "kuka": zyx,
        "fanuc": zyx[:, ::-1],
        "staubli": xyz,
        "ur": so3.log(R),
        "abb": q,
        "quaternion-xyzw": q[:, [1, 2, 3, 0]],
    }[convention]


@pytest.mark.parametrize("convention", ["kuka", "fanuc", "staubli", "ur", "abb", "quaternion-xyzw"])
def test_the_cameras_motion_tells_which_convention_a_robot_writes(rng, noisy, convention):
    B = noisy.base_from_flange
    mm = 1e-3 if CONVENTIONS[convention].unit == "m" else 1.0
    numbers = np.concatenate([B.translation * mm, written(B.rotation, convention)], axis=1)
    alike = [name for name, c in CONVENTIONS.items() if len(c.columns) == numbers.shape[1]]
    readings = {name: CONVENTIONS[name].poses(numbers, unit=CONVENTIONS[name].unit or "mm") for name in alike}
    fits = conventions_that_fit(readings, noisy.camera_from_target, mounting=noisy.mounting)
    same_rule = {"fanuc": {"fanuc", "yaskawa"}, "ur": {"ur", "rotation-vector"}}
    same_rule |= {"abb": {"abb", "quaternion-wxyz"}, "quaternion-xyzw": {"quaternion-xyzw", "ros"}}
    right = {f.convention for f in fits if f.fits and not f.inverted}
    assert right == same_rule.get(convention, {convention})
    assert not [f for f in fits if f.fits and f.inverted]
    for f in fits:
        if f.fits and f.convention == convention:
            assert f.scale == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_a_flange_turned_over_by_half_turns_is_not_refused(rng, mounting):
    """Exact half turns about perpendicular axes and turns about one of them: noise reverses half of the axes."""
    halves = [np.eye(3), *(np.diag(d) for d in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1]))]
    R = np.stack([so3.exp([0.0, 0, turn]) @ half for turn in (0.0, 0.4) for half in halves])
    robot = Rigid(R, 300 * rng.normal(size=(8, 3)))
    X, Z = random_rigid(rng, 100.0), random_rigid(rng, 900.0)
    off = Rigid.exp(rng.normal(size=(8, 6)) * np.repeat([0.05, 3e-4], 3))
    held_from_fixed = (robot @ off @ X).inv @ Z
    seen = held_from_fixed if mounting == "eye-in-hand" else held_from_fixed.inv
    found = calibrate_hand_eye_from_poses(robot, seen, mounting=mounting)
    xi = (X.inv @ found.flange_from_held).log()
    assert np.all(np.abs(xi) < 6 * np.sqrt(np.diag(found.covariance)[:6]))
    assert found.robot_noise.translation < 0.15
