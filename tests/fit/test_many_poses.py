"""Poses of one target in many views: the global search's answers, both of them for a flat target."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.points.camera import locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.fit.many_poses import PaddedViews, pose_jacobian, poses_of_views
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

CAMERA = Camera.from_focal((1280, 960), 1200.0)
SQUARE = np.array([[0.0, 0, 0], [60, 0, 0], [60, 60, 0], [0, 60, 0]])


def seen(rng, points, n, noise=0.2):
    views = []
    for _ in range(n):
        R = so3.exp(np.array([0, 0, rng.uniform(-3, 3)])) @ so3.exp(np.append(rng.normal(size=2) * 0.4, 0))
        t = [0, 0, 700] + 40 * rng.normal(size=3) - R @ points.mean(axis=0)
        views.append((points, CAMERA.project(points @ R.T + t) + noise * rng.normal(size=(len(points), 2))))
    return views


@pytest.mark.parametrize("count", [4, 30], ids=["a square", "a cloud"])
def test_both_minima_are_those_of_the_search_of_one_view(rng, count):
    points = SQUARE if count == 4 else rng.uniform(-80, 80, (count, 3))
    views = seen(rng, points, 8)
    found = poses_of_views(CAMERA, PaddedViews.of(views))
    for i, (p, q) in enumerate(views):
        one = locate_camera(Observations(p, q), CAMERA)
        assert found.sum_of_squares[i, 0] == pytest.approx(one.sum_of_squares, rel=1e-6)
        np.testing.assert_allclose(found.rotation[i, 0], one.camera_from_world.rotation, atol=1e-5)
        if count == 4 and one.alternative is not None:
            assert found.sum_of_squares[i, 1] == pytest.approx(one.alternative.sum_of_squares, rel=1e-4)


def test_views_of_different_lengths_do_not_disturb_each_other(rng):
    points = rng.uniform(-80, 80, (20, 3))
    views = [(p[:k], q[:k]) for (p, q), k in zip(seen(rng, points, 4), (20, 5, 11, 16), strict=True)]
    together = poses_of_views(CAMERA, PaddedViews.of(views))
    for i, view in enumerate(views):
        alone = poses_of_views(CAMERA, PaddedViews.of([view]))
        np.testing.assert_allclose(together.translation[i, 0], alone.translation[0, 0], atol=1e-3)


def test_points_on_a_line_have_no_pose(rng):
    line = np.outer(np.arange(5.0), [30.0, 0, 0])
    found = poses_of_views(CAMERA, PaddedViews.of(seen(rng, line, 1)))
    assert np.isinf(found.sum_of_squares).all()


def test_the_pose_jacobian_is_that_of_differences(rng):
    p = rng.uniform(-80, 80, (2, 6, 3))
    C = Rigid(so3.exp(0.3 * rng.normal(size=(2, 3))), np.array([[0.0, 0, 600], [10, 20, 700]]))
    _, J = pose_jacobian(CAMERA, C.rotation, C.translation, p)
    for k in range(6):
        d = np.zeros(6)
        d[k] = 1e-6
        plus, minus = (C @ Rigid.exp(s * d) for s in (1, -1))
        difference = [CAMERA.project(p @ np.swapaxes(c.rotation, 1, 2) + c.translation[:, None]) for c in (plus, minus)]
        np.testing.assert_allclose(J[..., k], (difference[0] - difference[1]) / 2e-6, atol=1e-4)
