"""Coverage of the covariances of measured points: calibrate and measure repeatedly, compare with the true point.

Seventy draws in the suite: the mean of chi-square with 6 degrees of freedom is known to sqrt(12/70) = 0.41, the share
of 95 % intervals that hold to 2.6 %, both taken four times. `pytest -m slow` draws 2000 and asks for 93-97 %.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.calibrate.measure.points import measure_points
from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.measurement import Measurement
from cadcam.camera.observations import Observations
from cadcam.camera.viewpoint import KnownMotion, Viewpoint
from cadcam.geometry.plane import Plane
from cadcam.geometry.rigid import Rigid

from .cell import BENCH, EYES, FEW, POINT, SIGMA, SIZE, Eye

SECOND = POINT + np.array([40.0, 25.0, -30.0])
TARGETS = np.stack([POINT, SECOND])
STEP = Rigid.exp([250.0, -120.0, 60.0, 0.1, -0.15, 0.3])
SIGMA_MM, SIGMA_RAD, HEIGHT_MM = 0.05, 1e-4, 0.1
DRAWS = 70
Calibrate = Callable[[Eye, np.random.Generator], CameraEstimate]


@cache
def pool(eye: int) -> list[CameraEstimate]:
    """Calibrations of one camera, used by every job of the suite."""
    rng = np.random.default_rng(100 + eye)
    return [EYES[eye].calibrated(rng) for _ in range(DRAWS)]


def by_descent(draw: int) -> Calibrate:
    return lambda eye, _: pool(EYES.index(eye))[draw]


def fixed(rng: np.random.Generator, find: Calibrate, method: str = "reprojection") -> Measurement:
    views = [Viewpoint.fixed(f"{i}", find(eye, rng)) for i, eye in enumerate(EYES[:2])]
    return measure_points(views, [eye.see(rng, TARGETS) for eye in EYES[:2]], method=method)


def midpoint(rng: np.random.Generator, find: Calibrate) -> Measurement:
    return fixed(rng, find, "rays")


def four_rays(rng: np.random.Generator, find: Calibrate) -> Measurement:
    views = [Viewpoint.fixed(f"{i}", find(eye, rng)) for i, eye in enumerate(EYES)]
    q = np.array([eye.see(rng, TARGETS) for eye in EYES])
    q[3, 1] = np.nan  # the fourth camera does not see the second point
    return measure_points(views, q)


def nearest_to_four(rng: np.random.Generator, find: Calibrate) -> Measurement:
    views = [Viewpoint.fixed(f"{i}", find(eye, rng)) for i, eye in enumerate(EYES)]
    return measure_points(views, [eye.see(rng, TARGETS) for eye in EYES], method="rays")


def moved(rng: np.random.Generator, find: Calibrate) -> Measurement:
    """One camera at home and after a motion that is known with errors of its own."""
    eye, home = EYES[0], find(EYES[0], rng)
    F = home.camera_from_world.origin
    known = KnownMotion(STEP).known_to(SIGMA_MM, SIGMA_RAD, about=F)
    error = np.linalg.cholesky(known.covariance + 1e-18 * np.eye(6)) @ rng.normal(size=6)
    reported = KnownMotion(STEP @ Rigid.exp(error), known.covariance)
    there = eye.pose @ STEP.inv
    views = [Viewpoint.fixed("home", home), Viewpoint.moved("away", home, reported)]
    return measure_points(views, [eye.see(rng, TARGETS), eye.see(rng, TARGETS, there)])


def located(rng: np.random.Generator, find: Calibrate) -> Measurement:
    """One camera at home and where seven of the targets located it with its internals kept."""
    eye, home = EYES[0], find(EYES[0], rng)
    there = eye.pose @ STEP.inv
    pose = eye.located(rng, home.camera, there, BENCH[[0, 2, 5, 9, 12, 16, 23]])
    views = [Viewpoint.fixed("home", home), Viewpoint.located("away", home, pose)]
    return measure_points(views, [eye.see(rng, TARGETS), eye.see(rng, TARGETS, there)])


def placed(rng: np.random.Generator, find: Calibrate) -> Measurement:
    """A fixed camera, and another at a pose told with errors."""
    one, two = find(EYES[0], rng), find(EYES[1], rng)
    there = EYES[1].pose @ STEP.inv
    covariance = np.diag([0.1**2] * 3 + [2e-4**2] * 3)
    told = there @ Rigid.exp(np.sqrt(np.diag(covariance)) * rng.normal(size=6))
    views = [Viewpoint.fixed("one", one), Viewpoint.placed("two", two, told, pose_covariance=covariance)]
    return measure_points(views, [EYES[0].see(rng, TARGETS), EYES[1].see(rng, TARGETS, there)])


def on_a_plane(rng: np.random.Generator, find: Calibrate, eyes: int = 1) -> Measurement:
    normal = np.cross(SECOND - POINT, [0.3, 0.2, 1.0])
    plane = Plane.through(POINT, normal)
    told = Plane(plane.normal, plane.offset + HEIGHT_MM * rng.normal())
    views = [Viewpoint.fixed(f"{i}", find(eye, rng)) for i, eye in enumerate(EYES[:eyes])]
    q = [eye.see(rng, TARGETS) for eye in EYES[:eyes]]
    return measure_points(views, q, plane=told, plane_sigma_mm=HEIGHT_MM)


def on_a_plane_by_two(rng: np.random.Generator, find: Calibrate) -> Measurement:
    return on_a_plane(rng, find, 2)


JOBS = [fixed, midpoint, four_rays, nearest_to_four, moved, located, placed, on_a_plane, on_a_plane_by_two]


def drawn(
    job: Callable[..., Measurement], draws: int, seed: int, find: Callable[[int], Calibrate]
) -> tuple[Array, ...]:
    """Return errors by sigma (draws, 6), Mahalanobis squares (draws,), distance errors by sigma, misfits and dof."""
    rng = np.random.default_rng(seed)
    z, square, length, chi2, dof = [], [], [], [], []
    for draw in range(draws):
        measured = job(rng, find(draw))
        error = measured.points - TARGETS
        z.append((error / measured.sigma).ravel())
        joint = measured.joint_covariance()
        square.append(error.ravel() @ np.linalg.pinv(joint, rcond=1e-12, hermitian=True) @ error.ravel())
        d = measured.distance("1", "2")
        length.append((d.value - np.linalg.norm(SECOND - POINT)) / d.sigma)
        chi2.append(measured.chi2.sum())
        dof.append(measured.dof.sum())
    return tuple(np.array(v) for v in (z, square, length, chi2, dof))


@pytest.mark.slow
@pytest.mark.parametrize("job", JOBS, ids=lambda j: j.__name__)
def test_errors_are_as_large_as_their_covariance_says(job: Callable[..., Measurement]) -> None:
    draws = DRAWS
    z, square, length, chi2, dof = drawn(job, draws, 20, by_descent)
    rank = 6
    assert square.mean() == pytest.approx(rank, abs=4 * np.sqrt(2 * rank / draws))
    single = 4 * np.sqrt(0.95 * 0.05 / draws)
    assert (np.abs(z) < 1.96).mean(axis=0) == pytest.approx(0.95, abs=single)
    assert (np.abs(length) < 1.96).mean() == pytest.approx(0.95, abs=single)
    if dof[0]:  # the two points share their calibration: their misfits are correlated, at worst wholly
        assert chi2.mean() == pytest.approx(dof[0], abs=4 * np.sqrt(4 * dof[0] / draws))


@pytest.mark.slow
def test_intervals_of_estimated_noise_hold_where_gauss_would_not() -> None:
    """Eight targets leave 5 degrees of freedom: 1.96 sigma holds 89 %, Student's 2.57 the 95 % asked for.

    Three hundred draws know a share to 1.3 %; the coordinates of two points add little to that.
    """
    rng, eye, draws = np.random.default_rng(9), EYES[0], 300
    there = eye.pose @ STEP.inv
    gauss, student = [], []
    for _ in range(draws):
        home = eye.calibrated(rng, stated=False, targets=BENCH[FEW])
        views = [Viewpoint.fixed("home", home), Viewpoint.moved("away", home, KnownMotion(STEP))]
        measured = measure_points(views, [eye.see(rng, TARGETS), eye.see(rng, TARGETS, there)])
        error = np.abs(measured.points - TARGETS)
        gauss.append(error < 1.96 * measured.sigma)
        student.append(error < measured.half_width())
    assert np.mean(student) == pytest.approx(0.95, abs=0.03)
    assert np.mean(gauss) < 0.92


def afresh(_: int) -> Calibrate:
    return lambda eye, rng: eye.calibrated(rng)


def search(eye: Eye, rng: np.random.Generator) -> CameraEstimate:
    terms = [name for name in eye.free if name in eye.camera.lens.parameters]
    fresh = type(eye.camera.lens)()
    if "k2" in fresh.parameters:
        fresh = type(eye.camera.lens)(k2=eye.camera.lens.parameters["k2"])
    observations = Observations(BENCH, eye.see(rng, BENCH), sigma_px=SIGMA)
    return calibrate_camera(observations, SIZE, lens=fresh, free_lens=terms)


def test_the_public_search_finds_what_the_descent_from_the_truth_finds() -> None:
    """So that the studies below may calibrate by descent: the same pixels, the same optimum and covariance."""
    for eye in EYES[1:3]:
        one, two = search(eye, np.random.default_rng(5)), eye.calibrated(np.random.default_rng(5))
        sd = np.sqrt(np.diag(two.covariance))
        assert np.all(np.abs(one.values - two.values) <= 1e-6 * sd + 1e-12)
        assert np.diag(one.cofactor) == pytest.approx(np.diag(two.cofactor), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("job", JOBS, ids=lambda j: j.__name__)
def test_95_percent_intervals_cover_93_to_97_percent_of_2000_calibrations(job: Callable[..., Measurement]) -> None:
    z, square, length, chi2, dof = drawn(job, 2000, 2, afresh)
    covered = (np.abs(z) < 1.96).mean(axis=0)
    print(f"{job.__name__}: {100 * covered.mean():.1f} %, by coordinate {np.round(100 * covered, 1)}, ", end="")
    print(f"distance {100 * (np.abs(length) < 1.96).mean():.1f} %, chi2/6 {square.mean() / 6:.3f}, ", end="")
    print(f"misfit {chi2.mean():.3f} of {dof[0]}")
    single = 4 * np.sqrt(0.95 * 0.05 / 2000)  # what 2000 draws know of one coordinate, four standard errors: 2 %
    assert np.all(np.abs(covered - 0.95) < single)
    assert abs((np.abs(length) < 1.96).mean() - 0.95) < single
