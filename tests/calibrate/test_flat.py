"""Plane and line calibrations find the truth, state their own spread, and refuse points that cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.points.flat import calibrate_line, calibrate_plane, measure_on_plane
from cadcam.camera.camera import Camera
from cadcam.camera.line_camera import LineCamera, LineObservations
from cadcam.camera.observations import Observations
from cadcam.camera.plane_camera import PlaneCamera
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints
from cadcam.geometry.rigid import Rigid

SIGMA, DRAWS = 0.3, 200
GRID = np.array([[x, y] for x in (0.0, 100, 200, 300) for y in (0.0, 90, 180)])
PLANE = PlaneCamera.of(Camera.from_focal((768, 576), 900.0), Rigid.look_at([500.0, -300, 600], [150.0, 90, 0]))
LINE = LineCamera(-300.0, 100.0, 1.4, 1500.0, 512.0)


def plane_points(rng=None, shift=(0.0, 0.0), sigma_px=SIGMA):
    q = PLANE.project(GRID)
    q = q if rng is None else q + SIGMA * rng.normal(size=q.shape)
    return Observations(np.column_stack([GRID + shift, np.full(len(GRID), -55.0)]), q, sigma_px=sigma_px)


def line_points(rng=None, sigma_px=SIGMA):
    U = LINE.project(GRID)
    return LineObservations(GRID, U if rng is None else U + SIGMA * rng.normal(size=U.shape), sigma_px=sigma_px)


def test_exact_points_give_the_camera_back():
    plane, line = calibrate_plane(plane_points()), calibrate_line(line_points())
    assert plane.camera.uv_matrix == pytest.approx(PLANE.uv_matrix, rel=1e-9, abs=1e-12)
    assert line.camera.vector == pytest.approx(LINE.vector, rel=1e-9)
    assert plane.height == -55
    assert (plane.dof, line.dof) == (16, 7)


def test_the_plane_s_covariance_is_that_of_its_draws(rng):
    """Where a point beside the grid is seen: chi-square with 2 degrees of freedom, known to 2/sqrt(200), four times."""
    p = np.array([[350.0, 40.0], [-20.0, 200.0], [150.0, 90.0]])
    predicted = calibrate_plane(plane_points()).projection_covariance(p)
    error = np.array([calibrate_plane(plane_points(rng)).camera.project(p) for _ in range(DRAWS)]) - PLANE.project(p)
    square = np.einsum("npi,pij,npj->pn", error, np.linalg.inv(predicted), error)
    assert square.mean(axis=1) == pytest.approx(2, abs=4 * 2 / np.sqrt(DRAWS))


@pytest.mark.parametrize("away", [1e4, 1e6, 1e8])
def test_a_plane_is_calibrated_in_the_coordinates_of_a_map(rng, away):
    """A kilometre away it was said to be seen from its edge; where rounding takes too much is told."""
    shift = np.array([away, -0.7 * away])
    near, far = (calibrate_plane(plane_points(np.random.default_rng(5), s)) for s in ((0.0, 0.0), shift))
    one, other = (measure_on_plane(e, PLANE.project(GRID[:3])) for e in (near, far))
    ratio = np.linalg.norm(shift) / 300
    rounded = 40 * np.finfo(float).eps  # beside 1e-5 of sigma that the iterations leave
    assert other.points[:, :2] - shift == pytest.approx(one.points[:, :2], abs=rounded * ratio * 300 + 1e-6)
    assert other.sigma == pytest.approx(one.sigma, rel=rounded * ratio**2 + 1e-6)
    with pytest.raises(DegenerateGeometry, match=r"2.1e\+09 mm from the origin .* take an origin near them"):
        calibrate_plane(plane_points(rng, (2.1e9, 0.0)))


def test_the_line_camera_s_covariance_is_that_of_its_draws(rng):
    truth = calibrate_line(line_points())
    error = np.array([calibrate_line(line_points(rng)).camera.vector for _ in range(DRAWS)]) - LINE.vector
    square = np.sum(error * np.linalg.solve(truth.covariance, error.T).T, axis=1)
    assert square.mean() == pytest.approx(5, abs=4 * np.sqrt(10 / DRAWS) + 0.1)
    assert error.std(axis=0) == pytest.approx(np.sqrt(np.diag(truth.covariance)), rel=4 * 0.05 + 0.02)
    p = GRID[5]
    seen = [LineCamera.from_vector(LINE.vector + e).project(p) for e in error]
    assert np.std(seen) == pytest.approx(float(truth.projection_sigma(p)), rel=4 * 0.05)


def test_a_plane_far_from_the_world_s_origin_is_calibrated_as_well(rng):
    """22 m away, as Prog 4: the same pixels and sigmas to 1e-6."""
    near = plane_points(rng)
    far = Observations(near.p_world + np.array([5000.0, 22000.0, 0.0]), near.q, sigma_px=SIGMA)
    one, two = calibrate_plane(near), calibrate_plane(far)
    p = np.array([[350.0, 40.0]])
    assert two.sum_of_squares == pytest.approx(one.sum_of_squares, rel=1e-9)
    assert two.projection_covariance(p + np.array([5000.0, 22000.0])) == pytest.approx(
        one.projection_covariance(p), rel=1e-5
    )


def test_points_measured_on_the_plane_err_as_they_say_alone_and_together(rng):
    """Two points 30 mm apart: chi-square with 4 degrees of freedom, known to sqrt(8/200), four times."""
    p = np.array([[40.0, 60.0], [70.0, 60.0]])
    square, length = [], []
    for _ in range(DRAWS):
        q = PLANE.project(p) + SIGMA * rng.normal(size=(2, 2))
        measured = measure_on_plane(calibrate_plane(plane_points(rng)), q, names="AB")
        error = (measured.points[:, :2] - p).ravel()
        flat = measured.joint_covariance()[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
        square.append(error @ np.linalg.solve(flat, error))
        d = measured.distance("A", "B")
        length.append((d.value - 30) / d.sigma)
    assert np.mean(square) == pytest.approx(4, abs=4 * np.sqrt(8 / DRAWS))
    assert np.std(length) == pytest.approx(1, abs=4 * 0.05)
    assert measured.points[:, 2].tolist() == [-55, -55]
    assert measured.sigma[:, 2].tolist() == [0, 0]


def test_pixels_beyond_the_vanishing_line_are_refused():
    estimate = calibrate_plane(plane_points())
    horizon = np.cross(estimate.camera.matrix[:, 0], estimate.camera.matrix[:, 1])
    foot = -horizon[2] * horizon[:2] / (horizon[:2] @ horizon[:2])
    beyond = 2 * foot - PLANE.project(GRID[4])
    measured = measure_on_plane(estimate, [PLANE.project(GRID[4]), beyond])
    assert measured.points[0, :2] == pytest.approx(GRID[4], abs=1e-8)
    assert "vanishing line" in measured.refused["2"]
    with pytest.raises(DegenerateGeometry, match="vanishing"):
        measure_on_plane(estimate, [beyond])
    with pytest.raises(BadValue, match="number of names"):
        measure_on_plane(estimate, [beyond], names="AB")


def test_the_noise_is_the_residuals_where_none_is_stated(rng):
    plane, line = calibrate_plane(plane_points(rng, sigma_px=None)), calibrate_line(line_points(rng, sigma_px=None))
    for estimate in (plane, line):
        assert estimate.noise_px == estimate.sigma0
        assert 0.3 * SIGMA < estimate.sigma0 < 2.2 * SIGMA


def test_as_many_equations_as_unknowns_leave_the_sigmas_unknown():
    four = Observations([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 2, 0]], [[0.0, 0], [9, 1], [1, 8], [10, 20]])
    five = LineObservations(GRID[[0, 1, 4, 8, 11]], LINE.project(GRID[[0, 1, 4, 8, 11]]))
    assert calibrate_plane(four).sigma0 is None
    assert np.isinf(np.diag(calibrate_plane(four).covariance)).any()
    assert np.isinf(calibrate_line(five).sigma("focal"))


def on_conic_with_centre():
    """Points on a circle through the line camera's centre: Chasles' theorem leaves the camera open."""
    middle = LINE.center - 300 * LINE.rotation[1]
    t = np.linspace(0.6, 2 * np.pi - 0.6, 8)
    away = -(LINE.center - middle)
    return middle + np.stack([np.cos(t), np.sin(t)], -1) @ np.array([away, [-away[1], away[0]]]) * 1.0


@pytest.mark.parametrize(
    ("p", "error"),
    [
        (GRID[:0], TooFewPoints),
        (GRID[:3], TooFewPoints),
        (GRID[[0, 0, 1, 2, 2]], TooFewPoints),
        (np.array([[0.0, 0], [1, 1], [2, 2], [3, 3], [4, 4]]), DegenerateGeometry),
        (np.array([[0.0, 0], [1, 1], [2, 2], [5, 3]]), DegenerateGeometry),
    ],
    ids=["none", "three", "repeats", "on a line", "all but one on a line"],
)
def test_points_that_tell_no_plane_are_refused(p, error):
    with pytest.raises(error):
        calibrate_plane(Observations(np.column_stack([p, np.zeros(len(p))]), PLANE.project(p)))


def test_points_of_different_heights_are_no_plane():
    p = np.column_stack([GRID, np.linspace(0, 1, len(GRID))])
    with pytest.raises(DegenerateGeometry, match="Z differ by 1 mm over 300 mm"):
        calibrate_plane(Observations(p, PLANE.project(GRID)))


@pytest.mark.parametrize(
    ("p", "error"),
    [
        (GRID[[0, 1, 4, 8]], TooFewPoints),
        (np.array([[0.0, 0], [1, 1], [2, 2], [3, 3], [4, 4], [5, 5]]), DegenerateGeometry),
        (np.array([[0.0, 0], [1, 1], [2, 2], [3, 3], [4, 4], [50, 3]]), DegenerateGeometry),
        (on_conic_with_centre(), DegenerateGeometry),
    ],
    ids=["four", "on a line", "all but one on a line", "on a conic with the centre"],
)
def test_points_that_tell_no_line_camera_are_refused(p, error):
    U = LINE.project(p)
    assert np.isfinite(U).all()
    with pytest.raises(error):
        calibrate_line(LineObservations(p, U))
