"""A hand-eye calibration is kept in a file to the last bit, and places cameras in the robot's base with its errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cadcam
from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye, calibrate_hand_eye_from_poses
from cadcam.calibrate.handeye.document import read_hand_eye, write_hand_eye
from cadcam.calibrate.handeye.estimate import HandEyeEstimate
from cadcam.errors import BadValue, UnreadableFile

from .robots import CAMERA, cell

MOUNTINGS = ["eye-in-hand", "eye-to-hand"]


@pytest.fixture(scope="module", params=MOUNTINGS)
def found(request: pytest.FixtureRequest) -> HandEyeEstimate:
    c = cell(np.random.default_rng(5), 8, mounting=request.param)
    return calibrate_hand_eye(c.base_from_flange, c.observations, c.camera, mounting=c.mounting)


def same(one: HandEyeEstimate, other: HandEyeEstimate) -> None:
    assert (one.mounting, one.names, one.noise_px) == (other.mounting, other.names, other.noise_px)
    for name in ("base_from_flange", "camera_from_target", "flange_from_held", "base_from_fixed"):
        assert np.array_equal(getattr(one, name).matrix, getattr(other, name).matrix), name
    for name in ("covariance", "degrees_of_freedom", "offsets", "residuals_px", "second_pose", "suspicious"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    for name in ("px", "mm", "rotation", "chance"):
        assert np.array_equal(getattr(one.held_out, name), getattr(other.held_out, name), equal_nan=True), name
    for name in ("translation", "rotation", "translation_sigma", "rotation_sigma"):
        assert getattr(one.robot_noise, name) == getattr(other.robot_noise, name), name
    assert (one.scale, one.scale_sigma) == (other.scale, other.scale_sigma)
    assert [o.sha256 for o in one.observations] == [o.sha256 for o in other.observations]


def test_a_calibration_round_trips_to_the_last_bit(found: HandEyeEstimate, tmp_path: Path) -> None:
    write_hand_eye(tmp_path / "handeye.json", found)
    again = read_hand_eye(tmp_path / "handeye.json")
    same(found, again)
    assert again.camera is not None
    assert found.camera is not None
    assert np.array_equal(again.camera.K, found.camera.K)
    assert np.array_equal(again.coverage_factor(), found.coverage_factor())


@pytest.mark.parametrize("poses", [3, 6], ids=["nothing held out", "all held out"])
def test_one_from_poses_alone_round_trips(tmp_path: Path, poses: int) -> None:
    c = cell(np.random.default_rng(6), poses)
    found = calibrate_hand_eye_from_poses(c.base_from_flange, c.camera_from_target, mounting=c.mounting)
    write_hand_eye(tmp_path / "handeye.json", found)
    again = read_hand_eye(tmp_path / "handeye.json")
    same(found, again)
    assert again.camera is None
    assert again.observations == ()


def test_a_file_that_is_none_is_refused_with_its_key(found: HandEyeEstimate, tmp_path: Path) -> None:
    write_hand_eye(tmp_path / "handeye.json", found)
    text = (tmp_path / "handeye.json").read_text()
    (tmp_path / "other.json").write_text(text.replace(f'"{found.mounting}"', '"eye-on-hand"'))
    with pytest.raises(UnreadableFile, match=r"mounting is unknown mounting 'eye-on-hand'; did you mean"):
        read_hand_eye(tmp_path / "other.json")
    (tmp_path / "older.json").write_text(text.replace('"camera_from_target"', '"something_else"'))
    with pytest.raises(UnreadableFile, match=r"poses.0 has no 'camera_from_target'"):
        read_hand_eye(tmp_path / "older.json")


def test_a_viewpoint_has_the_errors_that_the_cameras_place_has(found: HandEyeEstimate) -> None:
    """The rays' covariance is that of a camera placed with the covariance of base_from_camera."""
    flange = found.base_from_flange[0]
    view = found.viewpoint("one", CAMERA, flange)
    place, covariance = found.base_from_camera_at(flange)
    assert np.allclose(view.camera_from_world.matrix, place.inv.matrix, atol=1e-12)
    assert view.sigma_px == found.noise_px
    q = np.array([[200.0, 300], [900, 700]])
    xi = np.random.default_rng(1).multivariate_normal(np.zeros(6), covariance, 4000)
    moved = place @ cadcam.Rigid.exp(xi)
    drawn = np.einsum("nij,kj->nki", moved.rotation, CAMERA.unproject(q))
    of_pixels = found.viewpoint("two", CAMERA, flange, sigma_px=1e-9).ray_covariance(q)
    assert np.allclose(np.cov(moved.translation.T), of_pixels[0, :3, :3], rtol=0.2, atol=0.05 * of_pixels[0, 0, 0])
    for k in range(2):
        spread = np.cov(drawn[:, k].T)
        assert np.allclose(spread, of_pixels[k, 3:, 3:], atol=0.1 * np.trace(spread))


def test_viewpoints_of_one_calibration_share_its_error(found: HandEyeEstimate) -> None:
    one, two = (found.viewpoint(name, CAMERA, found.base_from_flange[i]) for i, name in enumerate("ab"))
    shared = {id(s.owner) for s, _ in one.errors} & {id(s.owner) for s, _ in two.errors}
    assert shared == {id(found)}
    assert len(one.errors) == (2 if found.mounting == "eye-in-hand" else 1)


def test_a_camera_on_the_flange_asks_where_the_flange_was() -> None:
    c = cell(np.random.default_rng(5), 6)
    found = calibrate_hand_eye(c.base_from_flange, c.observations, c.camera, mounting="eye-in-hand")
    with pytest.raises(BadValue, match="base_from_flange is None; expected a Rigid"):
        found.viewpoint("one", CAMERA)


def test_a_part_s_pose_in_the_robots_base_has_the_errors_of_both(found: HandEyeEstimate) -> None:
    """Drawn: base_from_part = base_from_camera @ camera_from_part, each with errors of its own."""
    rng = np.random.default_rng(2)
    place, covariance = found.base_from_camera_at(found.base_from_flange[0])
    own = np.diag([0.1, 0.2, 0.3, 1e-3, 2e-3, 1e-3]) ** 2
    pose = cadcam.PoseEstimate(cadcam.Rigid.from_rotation_vector([0.3, -2, 1], [20, -30, 700]), own)
    in_base = pose.in_frame(place, covariance)
    moved = place @ cadcam.Rigid.exp(rng.multivariate_normal(np.zeros(6), covariance, 4000))
    seen = pose.world_from_part @ cadcam.Rigid.exp(rng.multivariate_normal(np.zeros(6), own, 4000))
    xi = (in_base.world_from_part.inv @ (moved @ seen)).log()
    sd = np.sqrt(np.diag(in_base.covariance))
    assert np.allclose(np.cov(xi.T) / np.outer(sd, sd), in_base.covariance / np.outer(sd, sd), atol=0.08)
    assert np.allclose(in_base.sigma_mm, sd[:3])
    assert np.allclose(np.radians(in_base.sigma_deg), sd[3:])
    assert np.array_equal(pose.in_frame(place).covariance, pose.covariance)
