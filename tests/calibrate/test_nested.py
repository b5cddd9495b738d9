"""Which parameters the views show: significance by pixels and by views, error on views left out, and the advice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.calibrate.joint.adjustment import fit_jointly
from cadcam.calibrate.joint.held_out import held_out_error
from cadcam.calibrate.joint.nested import ask, nested_advice
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.errors import TooFewPoints
from cadcam.fit.block_least_squares import minimise_blocks

from .scenes import SIZE, board, scene

PLAIN = Camera.from_focal(SIZE, 1100, fy=1080, cx=655, cy=470, lens=BrownConrady(-0.15))


def asked(advice, *names):
    (question,) = [q for q in advice.questions if q.names == names]
    return question


def test_missing_distortion_is_asked_for_and_skew_that_is_none_is_let_go(rng):
    views = scene(rng, PLAIN, [board()] * 8).seen(rng, 0.2)
    advice = nested_advice(fit_jointly(views, SIZE))
    assert asked(advice, "k1").verdict.startswith("free k1: significant by the scatter between views")
    assert not asked(advice, "skew").needed
    assert "set k1 free and ask again" in advice.recommendation
    advice = nested_advice(fit_jointly(views, SIZE, fixed={"skew": 0}, lens=BrownConrady(), free_lens=("k1",)))
    assert asked(advice, "k1").needed
    assert asked(advice, "aspect").needed
    assert asked(advice, "U0", "V0").needed
    assert not asked(advice, "k2").needed
    assert advice.recommendation == "the model fits the views: nothing to add, nothing to leave out"


def test_parameters_with_a_prior_are_asked_about_as_well(rng):
    """Held, the value is tested against its prior too: a skew known to be 1 deg cannot be left out."""
    views = scene(rng, PLAIN, [board()] * 8).seen(rng, 0.2, stated=True)
    options = {"lens": BrownConrady(), "free_lens": ("k1",)}
    plain, near, far = (
        ask(fit_jointly(views, SIZE, priors=priors, **options), ("skew",))
        for priors in (None, {"skew": (0.0, 1e-4)}, {"skew": (np.radians(1.0), 1e-4)})
    )
    advised = asked(nested_advice(fit_jointly(views, SIZE, priors={"skew": (0.0, 1e-4)}, **options)), "skew")
    assert (advised.values, advised.sigmas, advised.chance) == (near.values, near.sigmas, near.chance)
    assert near.sigmas[0] < 1e-4 < plain.sigmas[0]
    assert near.chance > 0.01
    assert far.chance < 1e-12


def test_a_skewed_camera_keeps_its_skew(rng):
    skewed = replace(PLAIN, K=PLAIN.K + np.array([[0, 6.0, 0], [0, 0, 0], [0, 0, 0]]))
    views = scene(rng, skewed, [board()] * 8).seen(rng, 0.2)
    advice = nested_advice(fit_jointly(views, SIZE, lens=BrownConrady(), free_lens=("k1",)))
    assert asked(advice, "skew").needed


def test_the_f_test_is_right_as_often_as_it_says_and_errors_that_views_share_deceive_it(rng):
    """80 cameras without k2. With independent noise a chance below 0.05 comes in 5 % (4 sigma: 14 %); with boards that
    are each printed a little wrong, the F-test cries wolf and the test by views does not."""
    chances = {0.0: [], 0.4: []}
    for _ in range(40):
        for shared, found in chances.items():
            world = scene(rng, PLAIN, [board()] * 8)
            views = []
            for v in world.seen(rng, 0.2):
                x = (v.p_world[:, :2] / 90) ** 3  # an error of the board's own, the same for a whole view
                views.append(replace(v, p_world=v.p_world + np.pad(shared * rng.normal(size=2) * x, ((0, 0), (0, 1)))))
            fit = fit_jointly(views, SIZE, fixed={"skew": 0}, lens=BrownConrady(), free_lens=("k1",), guess=PLAIN)
            k2 = ask(fit, ("k2",))
            found.append((k2.chance < 0.05, k2.chance_by_view < 0.05))
    independent, alike = (np.mean(chances[s], axis=0) for s in (0.0, 0.4))
    margin = 4 * np.sqrt(0.05 * 0.95 / 40)
    assert abs(independent[0] - 0.05) < margin
    assert independent[1] < 0.05 + margin
    assert alike[0] > 0.3
    assert alike[1] < 0.05 + margin


def test_the_held_out_error_is_the_noise_for_the_right_model_and_more_for_a_poor_one(rng):
    """Right model, many points: the noise and a little for the pose; without k1: what the lens bends."""
    views = scene(rng, PLAIN, [board()] * 8).seen(rng, 0.2)
    right = fit_jointly(views, SIZE, fixed={"skew": 0}, lens=BrownConrady(), free_lens=("k1",))
    assert 0.2 < held_out_error(right) < 0.2 * 1.15
    assert held_out_error(fit_jointly(views, SIZE)) > 0.35
    with pytest.raises(TooFewPoints, match="at least 2 views; 1 given"):
        held_out_error(
            fit_jointly(scene(rng, PLAIN, [np.c_[board()[:, :2], rng.uniform(0, 90, 63)]]).seen(rng, 0.1), SIZE)
        )


def resampled(fit, rng):
    """Return the free internals of a calibration from views drawn with replacement."""
    drawn, start = rng.integers(len(fit.views), size=len(fit.views)), fit.solution.state
    begin = replace(start, R=start.R[drawn], t=start.t[drawn])
    values = fit.model.values(minimise_blocks(fit.model.with_views(drawn), begin).state)
    return [values[name] for name in fit.model.free]


def test_the_bootstrap_by_view_scatters_as_the_covariance_by_views_says(rng):
    """30 views: two estimates of the same scatter, each good to about 1/sqrt(2 x 30) = 13 %; together within 60 %."""
    views = scene(rng, PLAIN, [board(5, 5, 36.0)] * 30).seen(rng, 0.2)
    fit = fit_jointly(views, SIZE, fixed={"skew": 0}, lens=BrownConrady(), free_lens=("k1",))
    drawn = np.std([resampled(fit, rng) for _ in range(100)], axis=0)
    assert np.abs(np.log(drawn / np.sqrt(np.diag(fit.known.jackknifed())))).max() < np.log(1.6)


def test_one_radial_term_ends_the_thesis_flat_optimum(points, size):
    """docs/joint-calibration.md: Table 2.7 calls for k1 by any test; with it the internals of both positions agree."""
    views = [points("2_7", 1), points("2_7", 2)]
    pinhole = nested_advice(fit_jointly(views, size))
    k1 = asked(pinhole, "k1")
    assert abs(k1.F - 471.9) < 0.1
    assert k1.chance < 1e-20
    assert (k1.residual_without, k1.residual_with) == pytest.approx((0.839, 0.250), abs=5e-4)
    assert (k1.held_out_without, k1.held_out_with) == pytest.approx((1.396, 0.377), abs=2e-3)
    assert k1.values[0] == pytest.approx(-0.204, abs=5e-4)
    radial = nested_advice(fit_jointly(views, size, lens=BrownConrady(), free_lens=("k1",)))
    assert not asked(radial, "skew").needed
    assert not asked(radial, "k2").needed
    assert asked(radial, "aspect").needed
