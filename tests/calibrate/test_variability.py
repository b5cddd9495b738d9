"""Three ways to the spread of a parameter agree with each other; what they refuse; that a study can be made again.

A standard deviation of M draws is known to 1/sqrt(2 M), a mean to 1/sqrt(M) of a sigma, a correlation to 1/sqrt(M).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.calibrate.variability.alternating import alternating_externals
from cadcam.calibrate.variability.methods import (
    FirstOrder,
    first_order_variability,
    markov_chain_variability,
    monte_carlo_variability,
    walk_of,
)
from cadcam.calibrate.variability.projection_map import projection_map
from cadcam.calibrate.variability.repeated import response, seen_exactly
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import EXTERNALS, NAMES, ExtendedPinhole
from cadcam.camera.lens import Division
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, DegenerateGeometry, UnknownName
from cadcam.fit.sampling import NotMixed, Walk
from cadcam.geometry.rigid import Rigid

SIZE = (768, 576)
SMALL = 0.05  # px: first order holds to a thousandth there
DRAWS = 2000
BENCH = np.array(
    [[x, y, z] for z in (-1040.0, -1410.0)
     for x, y in ((0, 80), (10, 220), (10, 400), (100, 140), (110, 300), (220, 230), (250, 80), (290, 400))]
)  # fmt: skip
PINHOLE = ExtendedPinhole(7.7, 416.3, -210.4, *np.radians([-9.04, -9.44, -2.36]), 1.007, 805.9, 0.0002, 319.7, 354.7)


def bench(sigma_px=SMALL, *, lens=None, rng=None):
    """The bench seen by the camera of Table 2.9, with or without noise."""
    q = PINHOLE.camera(SIZE, lens).project(PINHOLE.camera_from_world @ BENCH)
    noise = 0 if rng is None else sigma_px * rng.standard_normal(q.shape)
    return Observations(BENCH, q + noise, sigma_px=sigma_px)


@pytest.fixture(scope="module")
def estimate():
    return calibrate_camera(bench(rng=np.random.default_rng(4)), SIZE)


def generator(seed=5):
    return np.random.default_rng(seed)


def assert_agree(study, first: FirstOrder, *, slack=0.0):
    """4.5 standard errors for each of some seventy numbers; slack: what the curvature of the problem adds."""
    assert study.names == first.names
    size = study.effective.min()
    assert study.sigma == pytest.approx(first.sigma, rel=4.5 / np.sqrt(2 * size) + slack)
    assert np.all(np.abs(study.mean - first.exact) < (4.5 / np.sqrt(size) + slack) * first.sigma)
    assert study.correlation == pytest.approx(first.correlation, abs=4.5 / np.sqrt(size) + slack)


def test_first_order_is_what_the_estimate_says_of_itself(estimate):
    first = first_order_variability(estimate)
    assert first.names == estimate.free
    unit = estimate.covariance / np.outer(first.sigma, first.sigma)
    assert first.covariance / np.outer(first.sigma, first.sigma) == pytest.approx(unit, abs=1e-9)
    assert first.exact == pytest.approx(estimate.values, rel=1e-12)


def test_method_a_agrees_with_first_order_where_the_noise_is_small(estimate):
    assert_agree(monte_carlo_variability(estimate, rng=generator()), first_order_variability(estimate))


def test_method_b_agrees_with_first_order_where_the_noise_is_small(estimate):
    study = markov_chain_variability(estimate, rng=generator(), walk=walk_of(200_000))
    assert study.effective.min() > 3000
    assert study.r_hat.max() < 1.03
    assert_agree(study, first_order_variability(estimate))


@pytest.mark.parametrize("method", ["dlt", "dlt-c23"])
def test_the_linear_transforms_have_first_orders_of_their_own(estimate, method):
    """At a tenth of the noise: the C23 = 1 form has a bias that goes with its square (Table 2.14)."""
    kwargs = {"sigma_px": SMALL / 10, "method": method}
    study, first = (
        monte_carlo_variability(estimate, rng=generator(), **kwargs),
        first_order_variability(estimate, **kwargs),
    )
    assert_agree(study, first)
    assert np.all(first.sigma > first_order_variability(estimate, sigma_px=SMALL / 10).sigma)


@pytest.mark.parametrize("method", ["reprojection", "dlt"])
def test_noise_of_the_world_points_adds_its_part(estimate, method):
    """0.2 mm at 805 px and some 1000 mm is 0.16 px: most of the spread here comes from the world points."""
    kwargs = {"sigma_mm": 0.2, "method": method}
    first, alone = first_order_variability(estimate, **kwargs), first_order_variability(estimate, method=method)
    assert np.all(first.sigma > 2 * alone.sigma)
    assert_agree(monte_carlo_variability(estimate, rng=generator(), **kwargs), first, slack=0.01)


@pytest.mark.parametrize(
    "fixed",
    [
        {"skew": 0.0002, "aspect": 1.007},
        {"a": PINHOLE.a, "X": 7.7},
        pytest.param({"b": PINHOLE.b}, marks=pytest.mark.slow),
    ],
)
def test_fixed_parameters_stay_out_of_it(fixed):
    held = calibrate_camera(bench(), SIZE, fixed=fixed)
    first = first_order_variability(held)
    assert not set(fixed) & set(first.names)
    assert_agree(monte_carlo_variability(held, rng=generator(), draws=1000), first)
    assert_agree(markov_chain_variability(held, rng=generator(), chains=32, walk=walk_of(60_000, 32)), first)


def test_known_internals_leave_the_pose(estimate):
    pose = locate_camera(bench(), estimate.camera)
    study = monte_carlo_variability(pose, rng=generator())
    assert study.names == EXTERNALS
    assert_agree(study, first_order_variability(pose))
    assert_agree(markov_chain_variability(pose, rng=generator(), walk=walk_of(100_000)), first_order_variability(pose))


def test_a_lens_coefficient_is_a_parameter_like_others():
    """Its curvature shows at 0.05 px already: 2 % are left for it."""
    curved = calibrate_camera(bench(lens=Division(-0.2)), SIZE, lens=Division(), free_lens=("k",))
    first = first_order_variability(curved)
    assert first.names == (*NAMES, "k")
    assert_agree(monte_carlo_variability(curved, rng=generator(), draws=150), first, slack=0.02)
    assert_agree(
        markov_chain_variability(curved, rng=generator(), chains=8, walk=Walk(1500, 300, 6)), first, slack=0.02
    )


def test_angles_near_half_a_turn_do_not_tear():
    """The same view in a world turned so that c is 180 deg: half of the draws cross it."""
    turned = replace(PINHOLE, c=np.pi)
    p = turned.camera_from_world.inv @ (PINHOLE.camera_from_world @ BENCH)
    seen = calibrate_camera(Observations(p, bench().q, sigma_px=0.5), SIZE)
    assert abs(seen.value("c")) == pytest.approx(np.pi, abs=1e-6)
    study, first = monte_carlo_variability(seen, rng=generator(), draws=500), first_order_variability(seen)
    assert study.sigma[3:6] == pytest.approx(first.sigma[3:6], rel=0.15)
    assert np.ptp(study.values[:, 5]) < 0.1
    assert (np.abs(study.values[:, 5]) > np.pi).mean() == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("method", ["reprojection", "dlt"])
def test_the_response_is_how_an_estimate_moves(estimate, method):
    """Pixels and world points, all of them moved at random by little, and estimated again; relative 1e-3."""
    exact = calibrate_camera(Observations(BENCH, seen_exactly(estimate)), SIZE, method=method)
    by_q, by_p = response(estimate, method)
    for seed in range(1):
        dq, dp = generator(seed).normal(size=(16, 2)) * 1e-3, generator(seed + 9).normal(size=(16, 3)) * 1e-3
        for moved, predicted in (
            (Observations(BENCH, seen_exactly(estimate) + dq), by_q @ dq.ravel()),
            (Observations(BENCH + dp, seen_exactly(estimate)), by_p @ dp.ravel()),
        ):
            change = calibrate_camera(moved, SIZE, method=method).values - exact.values
            sigma = first_order_variability(estimate).sigma
            assert np.abs((change - predicted) / sigma).max() < 1e-3 * np.abs(predicted / sigma).max()


def test_equal_seeds_give_equal_studies_and_more_draws_begin_with_the_same(estimate):
    some = monte_carlo_variability(estimate, rng=generator(), draws=300)
    more = monte_carlo_variability(estimate, rng=generator(), draws=700)
    other = monte_carlo_variability(estimate, rng=generator(6), draws=300)
    assert np.array_equal(some.values, more.values[:300])
    assert not np.array_equal(some.values, other.values)
    chains = [
        markov_chain_variability(estimate, rng=generator(), walk=Walk(800, 300, 4), chains=16).draws for _ in range(2)
    ]
    assert np.array_equal(*chains)


def test_progress_is_told_block_by_block(estimate):
    calls = []
    monte_carlo_variability(estimate, rng=generator(), draws=600, progress=lambda: calls.append(1))
    assert len(calls) == 3


def test_minimum_maximum_and_quantiles_enclose_the_draws(estimate):
    study = monte_carlo_variability(estimate, rng=generator(), draws=300)
    assert np.all(study.minimum <= study.quantile(0.025))
    assert np.all(study.quantile(0.975) <= study.maximum)
    assert study.mean_error == pytest.approx(study.sigma / np.sqrt(300))
    assert study.failed == 0


def test_method_b_starts_from_the_least_squares_optimum_of_the_measured_points(points, size):
    linear = calibrate_camera(points("2_7", 1), size, method="dlt-c23")
    best = calibrate_camera(points("2_7", 1), size)
    study = markov_chain_variability(linear, rng=generator(), walk=walk_of(30_000), sigma_px=0.5)
    assert study.exact == pytest.approx(best.values, rel=1e-8)


def test_chains_that_hardly_step_are_refused(estimate):
    """The negative control: a hundredth of a sigma a step, nothing tuned."""
    with pytest.raises(NotMixed, match="have not mixed"):
        markov_chain_variability(estimate, rng=generator(), walk=Walk(300, 0, 10, scale=0.01))


def test_draws_without_an_answer_are_counted_and_too_many_refused():
    """Six points in space and 11 unknowns: with 60 px of noise most draws lead to no camera."""
    camera = Camera.from_focal(SIZE, 800.0)
    p = np.random.default_rng(2).uniform(-1, 1, (6, 3)) * [300, 200, 200] + [0, 0, 1000.0]
    weak = calibrate_camera(Observations(p, camera.project(p), sigma_px=0.1), SIZE)
    with pytest.raises(DegenerateGeometry, match=r"\d+ of 512 draws have no camera at 60 px"):
        monte_carlo_variability(weak, rng=generator(), draws=512, sigma_px=60.0)


@pytest.mark.parametrize(
    ("error", "arguments"),
    [
        (UnknownName, {"method": "guess"}),
        (BadValue, {"draws": 1}),
        (BadValue, {"sigma_px": 0.0}),
        (BadValue, {"sigma_px": np.nan}),
        (BadValue, {"sigma_mm": -1.0}),
    ],
)
def test_bad_arguments_are_refused(estimate, error, arguments):
    with pytest.raises(error):
        monte_carlo_variability(estimate, rng=generator(), **arguments)


def test_the_linear_transform_has_no_fixed_parameters():
    held = calibrate_camera(bench(), SIZE, fixed={"skew": 0.0002})
    with pytest.raises(BadValue, match="reprojection"):
        monte_carlo_variability(held, rng=generator(), method="dlt-c23")


def test_one_chain_is_refused(estimate):
    with pytest.raises(BadValue, match="one alone cannot show"):
        markov_chain_variability(estimate, rng=generator(), chains=1)


def test_noise_that_nothing_tells_has_to_be_stated():
    camera = Camera.from_focal(SIZE, 800.0)
    p = np.array([[0.0, 0, 0], [300, 0, 0], [300, 200, 0], [0, 200, 50]])
    pose = Rigid.look_at([-200.0, -400.0, 900.0], [150.0, 100.0, 0.0])
    exact = calibrate_camera(
        Observations(p, camera.project(pose @ p)), SIZE, fixed={"skew": 0.0, "aspect": 1.0, "U0": 287.5}
    )
    with pytest.raises(BadValue, match="state it"):
        first_order_variability(exact)
    assert np.isfinite(first_order_variability(exact, sigma_px=0.1).sigma).all()


def test_alternating_externals_draw_within_their_spread_and_see_every_point(estimate):
    study = alternating_externals(estimate, rng=generator(), spread_mm=100, spread_deg=5, draws=500)
    off = study.drawn - estimate.values[:6]
    limit = np.array([100.0] * 3 + [np.radians(5)] * 3)
    assert np.all(np.abs(off) <= limit * (1 + 1e-12))
    assert np.all(np.abs(off).max(axis=0) > 0.5 * limit)
    for values in study.drawn[:50]:
        moved = ExtendedPinhole.from_vector([*values, *estimate.values[6:]])
        assert estimate.camera.sees(estimate.camera.project(moved.camera_from_world @ BENCH)).all()


def test_alternating_externals_without_spread_are_method_a(estimate):
    study = alternating_externals(estimate, rng=generator(), spread_mm=0, spread_deg=0).errors
    assert_agree(study, first_order_variability(estimate))


def test_alternating_externals_refuse_what_they_cannot_do(estimate):
    with pytest.raises(BadValue, match="nothing to see"):
        alternating_externals(estimate, rng=generator(), spread_mm=1, spread_deg=1, visible=False)
    with pytest.raises(BadValue, match="spread_deg"):
        alternating_externals(estimate, rng=generator(), spread_mm=1, spread_deg=-1)
    with pytest.raises(DegenerateGeometry, match="make spread_mm or spread_deg smaller"):
        alternating_externals(estimate, rng=generator(), spread_mm=0, spread_deg=180, draws=200)
    held = calibrate_camera(bench(), SIZE, fixed={"skew": 0.0002})
    with pytest.raises(BadValue, match="all eleven"):
        alternating_externals(held, rng=generator(), spread_mm=1, spread_deg=1)


def test_the_projection_map_is_the_spread_of_drawn_cameras(estimate):
    """At the picture's centre and corners, along the worse direction, 4.5 standard errors of 2000 draws."""
    m = projection_map(estimate, nodes=5)
    study = monte_carlo_variability(estimate, rng=generator())
    depth = (estimate.camera_from_world @ BENCH)[:, 2].mean()
    for i, j in ((0, 0), (-1, -1), (len(m.y) // 2, len(m.x) // 2)):
        ray = estimate.camera.unproject([m.x[j], m.y[i]])
        p = estimate.camera_from_world.inv @ (ray * depth / ray[2])
        cameras = [ExtendedPinhole.from_vector(v) for v in study.values[:1000]]
        q = np.array([c.camera(SIZE).project(c.camera_from_world @ p) for c in cameras])
        assert np.sqrt(np.linalg.eigvalsh(np.cov(q.T))[-1]) == pytest.approx(m.sigma[i, j], rel=4.5 / np.sqrt(2000))


def test_a_plane_across_the_axis_is_a_depth(estimate):
    pose = estimate.camera_from_world
    forward = pose.rotation[2]
    plane = [*(2 * forward), 2 * (1200.0 + forward @ pose.origin)]
    at_depth, on_plane = projection_map(estimate, depth_mm=1200.0), projection_map(estimate, plane=plane)
    assert on_plane.sigma == pytest.approx(at_depth.sigma, rel=1e-9)
    assert at_depth.sigma.shape == (49, 65)


def test_what_a_plane_hides_is_nan_and_a_plane_out_of_sight_is_refused(estimate):
    pose = estimate.camera_from_world
    half = projection_map(estimate, plane=[*pose.rotation[0], 300.0 + pose.rotation[0] @ pose.origin])
    assert 0.2 < np.isnan(half.sigma).mean() < 0.8
    with pytest.raises(DegenerateGeometry, match="sees nothing"):
        projection_map(estimate, plane=[*pose.rotation[2], -100.0 + pose.rotation[2] @ pose.origin])
    for bad in ({"depth_mm": -1.0}, {"plane": [0, 0, 0, 1]}, {"plane": [0, 0, 1, 1], "depth_mm": 1.0}):
        with pytest.raises(BadValue):
            projection_map(estimate, **bad)
