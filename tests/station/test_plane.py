"""One calibrated position: local scales with their covariance, and how errors of the plate move what it measures."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.plane_camera import PlaneCamera
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints
from cadcam.station.cross_prediction import plate_effect
from cadcam.station.plane import calibrate_position, local_scale, refuse_misfit
from cadcam.station.plate import Plate, place_plate, turn

AT = np.array([5000.0, 8000.0])
PLATE = Plate.b4(sigma_mm=0.0)
CAMERA = PlaneCamera.from_uv_matrix([[0.02, 0.843, 250.0], [-0.773, 0.01, 380.0], [2e-5, -3e-5, 1.0]])


def position(q=None, made=PLATE, sigma_px=0.05):
    """Return a calibration whose plate was made as `made`, and is thought to be PLATE."""
    lie, place = turn(0.1), AT - np.array([230.0, 140.0])
    placed = place_plate(PLATE, made.reflectors @ lie.T + place, sigma_mm=0.1)
    true = made.marks @ lie.T + place - AT
    return calibrate_position("p", AT, CAMERA.project(true) if q is None else q, placed, sigma_px=sigma_px)


def test_the_local_scale_is_the_jacobian_s():
    one = position()
    step = 1e-3 * np.eye(2)
    J = np.stack([(CAMERA.project(one.centre + s) - CAMERA.project(one.centre - s)) / 2e-3 for s in step], axis=-1)
    assert (one.scale.scale_x, one.scale.scale_y) == pytest.approx(1 / np.linalg.norm(J, axis=0), rel=1e-6)
    cosine = J[:, 0] @ J[:, 1] / np.prod(np.linalg.norm(J, axis=0))
    assert one.scale.skew == pytest.approx(np.pi / 2 - np.arccos(cosine), abs=1e-8)


def test_scales_and_skew_scatter_as_their_covariance_says(rng):
    """400 calibrations: variances are good to 7 %, so 25 % is more than three sigma of them."""
    exact, found = position(), []
    q = exact.estimate.observations.q
    for _ in range(400):
        scale = position(q + 0.05 * rng.normal(size=q.shape)).estimate
        local = local_scale(scale, exact.centre)
        found.append([local.scale_x, local.scale_y, local.aspect, local.skew])
    sigma = np.sqrt(np.diag(exact.scale.covariance))
    assert np.std(found, axis=0) / sigma == pytest.approx(1, abs=0.12)
    assert np.cov(np.array(found).T) / np.outer(sigma, sigma) == pytest.approx(
        exact.scale.covariance / np.outer(sigma, sigma), abs=0.25
    )


def test_errors_of_the_plate_s_making_move_points_as_predicted(rng):
    """The calibration of a plate that is not quite as drawn, against the derivative; of second order what is left."""
    one = position()
    off = 1e-3 * rng.normal(size=PLATE.points.shape)
    made = Plate(PLATE.marks + off[:8], PLATE.reflectors + off[8:])
    p = one.centre + np.array([[120.0, -90.0]])
    _, by_entry = one.by_entries(p)
    predicted = plate_effect(one, by_entry, p + AT)[0] @ off.ravel()
    seen = position(made=made).camera.unproject(one.camera.project(p))[0] - p[0]
    assert seen == pytest.approx(predicted, abs=1e-6)
    assert np.linalg.norm(seen) > 1e-4


def test_a_plate_that_is_only_moved_moves_nothing():
    """Marks and reflectors shifted together: the survey follows, so the measured point stays."""
    one = position()
    p = one.centre[None]
    effect = plate_effect(one, one.by_entries(p)[1], p + AT)[0]
    assert effect @ np.tile([1.0, 0.0], 12) == pytest.approx([0, 0], abs=1e-9)


def test_the_world_camera_takes_world_points():
    one = position()
    p = one.placement.marks
    assert one.world_camera.project(p) == pytest.approx(one.camera.project(p - AT), abs=1e-9)
    assert one.predict(one.world_camera.project(p), AT) == pytest.approx(p, abs=1e-6)


def test_marks_that_were_not_found_are_left_out():
    q = np.array(position().estimate.observations.q)
    q[2] = np.nan
    one = position(q)
    assert one.seen == (0, 1, 3, 4, 5, 6, 7)
    q[3:] = np.nan
    with pytest.raises(TooFewPoints):
        position(q)


def test_a_mark_out_of_its_place_is_a_misfit():
    q = position().estimate.observations.q
    with pytest.raises(DegenerateGeometry, match=r"the worst is mark '6'"):
        refuse_misfit(position(q + np.outer(np.arange(8) == 5, [15.0, 0.0])), limit_px=2.0)
    refuse_misfit(position(), limit_px=2.0)


def test_pixels_have_to_be_one_for_each_mark():
    with pytest.raises(BadValue, match="pixels of the marks"):
        position(np.zeros((5, 2)))
