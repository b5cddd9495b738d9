"""Any parameter fixed or free, every lens: the truth comes back, fixed values stay, and no random start does better."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import EXTERNALS, INTERNALS, NAMES, ExtendedPinhole
from cadcam.camera.lens import BrownConrady, Division, Fisheye, Ideal, OddRadial
from cadcam.camera.observations import Observations
from cadcam.geometry.rigid import Rigid

SIZE = (768, 576)
D = np.radians
TRUTH = ExtendedPinhole(120.0, 80.0, 300.0, D(20), D(-35), D(75), 1.03, 900.0, D(0.8), 270.0, 400.0)
VALUES = dict(zip(NAMES, TRUTH.vector, strict=True))
CAMERA, POSE = TRUTH.camera(SIZE), TRUTH.camera_from_world


@pytest.fixture(scope="module")
def cloud():
    in_camera = np.random.default_rng(4).uniform(-1, 1, (14, 3)) * [280, 200, 250] + [0, 0, 900]
    return POSE.inv @ in_camera


def seen(p, camera=CAMERA, pose=POSE, noise=0.0, rng=None, **options):
    q = camera.project(pose @ p)
    return Observations(p, q if rng is None else q + noise * rng.normal(size=q.shape), **options)


CHOICES = [
    *((name,) for name in NAMES),
    EXTERNALS,
    INTERNALS,
    ("X", "Y", "Z"),
    ("a", "b", "c"),
    *combinations(("a", "b", "c"), 2),
    ("aspect", "skew"),
    ("aspect", "skew", "U0", "V0"),
    ("Z", "b", "focal"),
    ("X", "a", "V0"),
]


@pytest.mark.parametrize("names", CHOICES, ids="-".join)
def test_whatever_is_fixed_stays_and_the_rest_is_found(cloud, names):
    """Exact points: what is free comes back to 1e-9 of its scale; what is fixed is what was given, to rounding."""
    estimate = calibrate_camera(seen(cloud), SIZE, fixed={n: VALUES[n] for n in names})
    assert set(estimate.free) == set(NAMES) - set(names)
    scale = np.maximum(np.abs(TRUTH.vector), 1.0)
    assert np.abs(estimate.values - TRUTH.vector) / scale == pytest.approx(np.zeros(11), abs=1e-8)
    for name in names:
        assert estimate.value(name) == pytest.approx(VALUES[name], rel=1e-13, abs=1e-12)
        assert estimate.sigma(name) == 0
        assert not estimate.covariance[NAMES.index(name)].any()


@pytest.mark.parametrize("names", [("c",), ("X", "focal"), ("a", "b"), ("skew", "aspect")], ids="-".join)
def test_a_wrong_fixed_value_is_kept_under_noise(cloud, rng, names):
    """Values beside the truth: the estimate bends everything else and leaves them alone."""
    fixed = {n: VALUES[n] + 0.01 * max(abs(VALUES[n]), 1) for n in names}
    estimate = calibrate_camera(seen(cloud, noise=0.3, rng=rng), SIZE, fixed=fixed)
    for name, value in fixed.items():
        assert estimate.value(name) == pytest.approx(value, rel=1e-13)


def test_fixed_angles_give_the_optimum_of_the_free_ones(cloud, rng):
    """At a minimum under a fixed c the full gradient has a component along c alone."""
    o = seen(cloud, noise=1.0, rng=rng)
    fixed = calibrate_camera(o, SIZE, fixed={"c": VALUES["c"]})
    for name in fixed.free:
        step = {"a": 1e-4, "b": 1e-4, "aspect": 1e-4, "skew": 1e-4}.get(name, 0.05)
        for sign in (1, -1):
            moved = dict(zip(NAMES, fixed.values, strict=True))
            moved[name] += sign * step
            e = ExtendedPinhole(**moved)
            r = o.q - e.camera(SIZE).project(e.camera_from_world @ o.p_world)
            assert np.sum(r**2) > fixed.sum_of_squares, name


@pytest.mark.parametrize("names", [("c",), ("a", "b"), ("X", "b")], ids="-".join)
def test_the_covariance_with_fixed_angles_inverts_the_fisher_information_of_the_rest(cloud, rng, names):
    """Differences of projections by the free parameters themselves: J^T J times the covariance is sigma^2."""
    o = seen(cloud, noise=0.5, rng=rng, sigma_px=0.5)
    estimate = calibrate_camera(o, SIZE, fixed={n: VALUES[n] for n in names})
    columns = []
    for name in estimate.free:
        h = 1e-5 * {"a": 0.01, "b": 0.01, "c": 0.01, "aspect": 0.01, "skew": 0.01}.get(name, 1.0)
        q = []
        for sign in (1, -1):
            moved = dict(zip(NAMES, estimate.values, strict=True))
            moved[name] += sign * h
            e = ExtendedPinhole(**moved)
            q.append(e.camera(SIZE).project(e.camera_from_world @ o.p_world).ravel())
        columns.append((q[0] - q[1]) / (2 * h))
    J = np.stack(columns, axis=1)
    index = [NAMES.index(n) for n in estimate.free]
    covariance = estimate.covariance[np.ix_(index, index)]
    sd = np.sqrt(np.diag(covariance))
    unit = (J.T @ J / 0.5**2) @ covariance * sd[:, None] / sd[None, :]
    assert unit == pytest.approx(np.eye(len(index)), abs=1e-4)


def test_a_cut_out_picture_far_from_the_principal_point_is_calibrated(rng):
    """Principal point 5000 px to the right: focal lengths tried at the picture's centre lead nowhere, the DLT does."""
    camera = Camera.from_focal(SIZE, 1500.0, cx=5000.0, cy=-3000.0)
    for _ in range(6):
        q = rng.uniform(0, 1, (10, 2)) * SIZE
        rays = camera.unproject(q)
        p = POSE.inv @ (rays / rays[:, 2:] * rng.uniform(800, 1200, (10, 1)))
        estimate = calibrate_camera(Observations(p, q + 0.1 * rng.normal(size=q.shape)), SIZE)
        assert estimate.thesis_residual < 0.25


def test_fixing_all_internals_is_locating_the_camera(cloud, rng):
    o = seen(cloud, noise=0.5, rng=rng)
    a = calibrate_camera(o, SIZE, fixed={n: VALUES[n] for n in INTERNALS})
    b = locate_camera(o, CAMERA)
    assert a.values == pytest.approx(b.values, rel=1e-9)
    assert a.cofactor == pytest.approx(b.cofactor, rel=1e-6, abs=1e-12)


LENSES = [
    (BrownConrady(-0.25, 0.08, 0.002, -0.001), ("k1", "k2", "p1", "p2")),
    (BrownConrady(k1=0.12, k4=0.3), ("k1", "k4")),
    (BrownConrady(k1=-0.1, s1=0.004, s3=-0.003), ("k1", "s1", "s3")),
    (OddRadial(0.0, -0.2, 0.05), ("a3", "a5")),
    (OddRadial(0.02, -0.2), ("a3",)),
    (Division(-0.2), ("k",)),
    (Division(0.1), ("k",)),
    (Fisheye(-0.05, 0.01, 0.002, -0.001), ("k1", "k2")),
]


def lens_scene(lens):
    camera = Camera.from_focal(SIZE, 430.0, fy=440.0, cx=390.0, cy=280.0, skew=3.0, lens=lens)
    in_camera = np.random.default_rng(8).uniform(-1, 1, (150, 3)) * [800, 600, 300] + [0, 0, 800]
    q = camera.project(in_camera)
    visible = np.isfinite(q).all(axis=1) & camera.sees(q)
    pose = Rigid.look_at([500.0, -300, 200], [0.0, 0, 0])
    return camera, pose, pose.inv @ in_camera[visible]


def given_and_free(lens, names):
    """The same lens with the coefficients to be found set to zero."""
    return type(lens)(**{k: 0.0 if k in names else v for k, v in lens.parameters.items()})


@pytest.mark.parametrize(("lens", "names"), LENSES, ids=lambda x: x.name if hasattr(x, "name") else None)
def test_every_lens_is_found_within_its_uncertainty(rng, lens, names):
    """0.2 px of noise: chi-square of the free parameters' error of the size of their number (4 sigma)."""
    camera, pose, p = lens_scene(lens)
    o = seen(p, camera, pose, noise=0.2, rng=rng, sigma_px=0.2)
    estimate = calibrate_camera(o, SIZE, lens=given_and_free(lens, names), free_lens=names)
    truth = np.append(ExtendedPinhole.from_camera(camera, pose).vector, list(lens.parameters.values()))
    index = [estimate.parameters.index(n) for n in estimate.free]
    error = (estimate.values - truth)[index]
    chi2 = error @ np.linalg.solve(estimate.covariance[np.ix_(index, index)], error)
    assert chi2 < len(index) + 4 * np.sqrt(2 * len(index)) + 6
    assert estimate.sigma0 == pytest.approx(0.2, rel=4 / np.sqrt(2 * estimate.dof))
    assert np.all(np.abs(error) <= 4.5 * np.sqrt(np.diag(estimate.covariance))[index])


@pytest.mark.parametrize(("lens", "names"), LENSES, ids=lambda x: x.name if hasattr(x, "name") else None)
def test_every_lens_gives_its_pose_from_four_points(lens, names):
    camera, pose, p = lens_scene(lens)
    spread = p[[0, 1, 2, 3]]
    found = locate_camera(seen(spread, camera, pose), camera)
    assert found.thesis_residual < 1e-9
    poses = [found, *([found.alternative] if found.alternative else [])]
    assert min(np.linalg.norm((e.camera_from_world.inv @ pose).log()) for e in poses) < 1e-5


def test_fixed_lens_coefficients_stay(rng):
    lens, names = BrownConrady(-0.25, 0.08, 0.002, -0.001), ("k1",)
    camera, pose, p = lens_scene(lens)
    estimate = calibrate_camera(
        seen(p, camera, pose, noise=0.2, rng=rng), SIZE, lens=BrownConrady(0.0, 0.08, 0.002, -0.001), free_lens=names
    )
    assert estimate.camera.lens.k2 == 0.08
    assert estimate.camera.lens.p1 == 0.002
    assert estimate.sigma("k2") == 0
    assert estimate.value("k1") == pytest.approx(-0.25, abs=5 * estimate.sigma("k1"))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_the_unit_of_length_does_not_matter(cloud, scale):
    """The same scene a thousand times smaller or larger: same internals, scaled centre; rounding only."""
    o = Observations(scale * cloud, CAMERA.project(POSE @ cloud))
    estimate = calibrate_camera(o, SIZE)
    assert pytest.approx(CAMERA.K, abs=1e-5) == estimate.camera.K
    assert estimate.camera.lens == Ideal()
    assert estimate.camera_from_world.origin == pytest.approx(scale * POSE.origin, abs=1e-6 * scale)
