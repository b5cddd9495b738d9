"""Observations and the estimate as values: checked at the door, and able to answer for their origin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid

P, Q = np.arange(12.0).reshape(4, 3), np.arange(8.0).reshape(4, 2)


def test_names_default_to_the_rows_counted_from_one():
    assert Observations(P, Q).names == ("1", "2", "3", "4")


def test_the_hash_follows_the_numbers_unless_a_file_gave_it():
    assert Observations(P, Q).sha256 == Observations(P.tolist(), Q.tolist()).sha256
    assert Observations(P, Q).sha256 != Observations(P, Q + 1e-9).sha256
    assert Observations(P, Q, sha256="ab").sha256 == "ab"


def test_u_is_the_row_and_v_the_column():
    o = Observations.from_uv(P, Q)
    assert np.array_equal(o.q, Q[:, ::-1])
    assert np.array_equal(o.UV, Q)


def test_the_arrays_cannot_be_changed():
    o = Observations(P, Q)
    with pytest.raises(ValueError, match="read-only"):
        o.q[0, 0] = 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"q": Q[:3]}, r"\(4, 3, 4\)"),
        ({"names": ("a", "b")}, r"\(4, 4, 2\)"),
        ({"p_world": P[:, :2]}, "world points"),
        ({"q": np.where(Q == 5, np.inf, Q)}, "row of point '3' is inf"),
        ({"q": np.full((4, 2), np.nan)}, "column of point '1' is nan .8 such numbers"),
        ({"sigma_px": 0.0}, "sigma_px"),
        ({"sigma_px": np.nan}, "sigma_px"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, words):
    with pytest.raises(BadValue, match=words):
        Observations(**{"p_world": P, "q": Q, **arguments})


@pytest.fixture
def estimate(rng):
    camera = Camera.from_focal((640, 480), 700.0)
    pose = Rigid.look_at([300.0, -500, 400], [0.0, 0, 0])
    p = rng.uniform(-100, 100, (12, 3))
    q = camera.project(pose @ p) + 0.3 * rng.normal(size=(12, 2))
    q[7] += [5.0, 0]
    return calibrate_camera(Observations(p, q, names=tuple("abcdefghijkl")), camera.size)


def test_the_worst_point_is_named(estimate):
    name, distance = estimate.worst()
    assert name == "h"
    assert distance == pytest.approx(np.linalg.norm(estimate.residuals[7]))


def test_the_three_residual_measures_agree(estimate):
    squares = np.sum(estimate.residuals**2)
    assert estimate.thesis_residual == pytest.approx(np.sqrt(squares / 12))
    assert estimate.rms_px == pytest.approx(np.sqrt(squares / 24))
    assert estimate.sigma0 == pytest.approx(np.sqrt(squares / 13))


def test_residuals_are_measured_minus_projected(estimate):
    projected = estimate.camera.project(estimate.camera_from_world @ estimate.observations.p_world)
    assert estimate.residuals == pytest.approx(estimate.observations.q - projected)
    assert estimate.residuals[7, 0] > 0  # the point was moved to the right


def test_the_correlation_is_scaled_covariance(estimate):
    C = estimate.correlation
    assert np.diag(C) == pytest.approx(np.ones(11))
    sd = np.array([estimate.sigma(n) for n in estimate.free])
    assert C * np.outer(sd, sd) == pytest.approx(estimate.covariance, rel=1e-9)


def test_unknown_parameters_are_named(estimate):
    with pytest.raises(UnknownName, match="did you mean 'focal'"):
        estimate.value("focl")
    with pytest.raises(UnknownName):
        replace(estimate, free=("k1",))


def test_a_stated_noise_replaces_the_estimated_one(estimate):
    o = estimate.observations
    stated = replace(estimate, observations=Observations(o.p_world, o.q, sigma_px=2 * estimate.sigma0))
    assert stated.sigma("X") == pytest.approx(2 * estimate.sigma("X"))
    assert np.array_equal(stated.correlation, estimate.correlation)
