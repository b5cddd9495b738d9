"""Real hand-eye sets against their published answers; docs/benchmarks/real_handeye.md has them beside OpenCV's."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye_from_poses
from cadcam.errors import InconsistentPoses
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid


@pytest.fixture
def moveit(shared):
    """Return base_from_flange and camera_from_target of the fifty samples, mm."""
    pairs = np.array(json.loads(shared("data/moveit_handeye/pose_samples.json").read_text()))
    flange, target = (Rigid(so3.nearest(M[:, :3, :3]), 1000 * M[:, :3, 3]) for M in (pairs[:, 0], pairs[:, 1]))
    return flange, target


def test_moveits_published_camera_is_found(moveit):
    """t = (0.659, -0.249, 0.830) m, intrinsic X-Y-Z angles (0.230, -2.540, 1.950), said to be good to 1 %."""
    found = calibrate_hand_eye_from_poses(*moveit, mounting="eye-to-hand")
    np.testing.assert_allclose(found.base_from_camera.translation, [659, -249, 830], atol=2)
    x, y, z = (so3.exp(a * np.eye(3)[i]) for i, a in enumerate((0.230, -2.540, 1.950)))
    off = np.linalg.norm(so3.log((x @ y @ z).T @ found.base_from_camera.rotation))
    assert np.degrees(off) < 0.5
    assert abs(found.scale - 1) < 4 * found.scale_sigma
    assert not found.suspicious.any()


def test_moveits_set_run_as_eye_in_hand_is_refused(moveit):
    """Elsewhere it "works" and means nothing."""
    with pytest.raises(InconsistentPoses, match="the mounting is eye-to-hand"):
        calibrate_hand_eye_from_poses(*moveit, mounting="eye-in-hand")
