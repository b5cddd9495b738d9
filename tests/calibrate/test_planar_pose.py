"""A flat target has two poses: both come back with their residuals, and the right one is among them."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import EXTERNALS, internals_of
from cadcam.camera.lens import Fisheye
from cadcam.camera.observations import Observations
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.multistart import descend
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

CAMERA = Camera.from_focal((768, 576), 800.0)
SQUARE = np.array([[-50.0, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]])


def tilted(degrees, distance):
    R = so3.exp([0, 0, 0.4]) @ so3.exp(np.radians(degrees) * np.array([0.8, 0.6, 0]))
    return Rigid(R, [10.0, -20.0, distance])


def seen(pose, p=SQUARE, camera=CAMERA, noise=0.0, rng=None):
    q = camera.project(pose @ p)
    return Observations(p, q if rng is None else q + noise * rng.normal(size=q.shape))


@pytest.mark.parametrize("degrees", [25.0, 45.0, 65.0])
@pytest.mark.parametrize(
    "camera", [CAMERA, Camera.from_focal((768, 576), 500.0, lens=Fisheye(-0.02))], ids=["ideal", "fisheye"]
)
def test_both_poses_of_a_square_are_reported(degrees, camera):
    pose = tilted(degrees, 900.0)
    found = locate_camera(seen(pose, camera=camera), camera)
    assert found.thesis_residual < 1e-9
    assert np.linalg.norm((found.camera_from_world.inv @ pose).log()) < 1e-6
    assert found.alternative is not None
    assert found.alternative.thesis_residual > 1e-3
    assert found.alternative.dof == 2
    normals = [e.camera_from_world.rotation[:, 2] for e in (found, found.alternative)]
    between = np.degrees(np.arccos(normals[0] @ normals[1]))
    assert between == pytest.approx(2 * degrees, abs=0.3 * degrees)  # the mirror image about the line of sight


def test_random_starts_end_in_these_two_poses_only(rng):
    """200 starts from all sides on a noisy square: no third minimum lies below the second."""
    o = seen(tilted(40.0, 700.0), noise=0.5, rng=rng)
    found = locate_camera(o, CAMERA)
    model = CameraModel(o.p_world, o.q, EXTERNALS, CAMERA.lens)
    R = so3.from_quaternion(rng.normal(size=(200, 4)))
    starts = model.states(-np.exp(rng.uniform(5, 9, 200))[:, None] * R[:, 2], R, internals_of(CAMERA.K))
    ends = descend(model, starts, 100)[1]
    for estimate in (found, found.alternative):
        assert np.mean(np.isclose(ends, estimate.sum_of_squares, rtol=1e-6)) > 0.1
    assert ends.min() >= found.sum_of_squares * (1 - 1e-9)
    between = ends[ends < found.alternative.sum_of_squares * (1 - 1e-6)]
    assert between == pytest.approx(np.full(len(between), found.sum_of_squares), rel=1e-6)


def test_under_noise_the_true_pose_may_be_the_second_one(rng):
    """Far away and noisy, the right pose loses now and then; it is never lost from the pair."""
    pose = tilted(30.0, 4000.0)
    lost = 0
    for _ in range(30):
        found = locate_camera(seen(pose, noise=0.3, rng=rng), CAMERA)
        pair = [found, *([found.alternative] if found.alternative else [])]
        tilts = [
            np.degrees(np.arccos(np.clip(e.camera_from_world.rotation[:, 2] @ pose.rotation[:, 2], -1, 1)))
            for e in pair
        ]
        assert min(tilts) < 15
        lost += int(tilts[0] > 15)
    assert 0 < lost < 25


def test_a_target_in_space_has_no_alternative(rng):
    p = rng.uniform(-80, 80, (8, 3))
    assert locate_camera(seen(tilted(30.0, 900.0), p), CAMERA).alternative is None


def test_a_nearly_flat_target_reports_the_second_pose_too(rng):
    """One is right, the other its mirror image about the line of sight, as far as noise of 0.5 px lets it be known."""
    p = np.vstack([SQUARE, 0.6 * SQUARE]) + [0, 0, 1] * rng.uniform(-2, 2, (8, 1))
    pose = tilted(30.0, 3000.0)
    found = locate_camera(seen(pose, p, noise=0.5, rng=rng), CAMERA)
    assert found.alternative is not None
    pair = [found, found.alternative]
    off = [np.degrees(np.arccos(e.camera_from_world.rotation[:, 2] @ pose.rotation[:, 2])) for e in pair]
    sigma = [np.degrees(np.hypot(e.sigma("a"), e.sigma("b"))) for e in pair]
    right = int(np.argmin(off))
    assert off[right] < 4 * sigma[right]
    assert off[1 - right] == pytest.approx(2 * 30.0, abs=4 * sigma[1 - right])
    assert max(e.rms_px for e in pair) < 2 * 0.5  # neither is ruled out


def test_a_calibrated_flat_target_reports_it_too(rng):
    """Fixed internals given by name lead to the same pair."""
    o = seen(tilted(40.0, 900.0), np.vstack([SQUARE, 0.5 * SQUARE]), noise=0.2, rng=rng)
    fixed = dict(zip(("aspect", "focal", "skew", "U0", "V0"), internals_of(CAMERA.K), strict=True))
    a, b = calibrate_camera(o, (768, 576), fixed=fixed), locate_camera(o, CAMERA)
    assert a.alternative.sum_of_squares == pytest.approx(b.alternative.sum_of_squares, rel=1e-9)
