"""Maps of the plane: exact on exact points, blind to points without weight, each the least squares of its kind."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.fit.plane_maps import FITTERS, affinities, depths, mapped, perspectives, similarities

H = np.array([[1.3, -0.4, 20.0], [0.5, 1.1, -7.0], [2e-3, -1e-3, 1.0]])
TRUE = {
    "similarity": np.array([[1.2, -0.5, 20.0], [0.5, 1.2, -7.0], [0, 0, 1]]),
    "affine": np.array([[1.3, -0.4, 20.0], [0.9, 1.1, -7.0], [0, 0, 1]]),
    "perspective": H,
}
EXACT = 1e-9  # px of some hundred: rounding of a 9 x 9 eigenvector, with room


def points(rng, batch=5, count=9):
    return rng.uniform(-50, 50, (batch, count, 2))


@pytest.mark.parametrize("kind", FITTERS)
@pytest.mark.parametrize("mirror", [1, -1])
def test_a_map_of_its_kind_comes_back_whatever_side_is_seen(rng, kind, mirror):
    true = TRUE[kind] @ np.diag([1, mirror, 1])
    p = points(rng)
    found = FITTERS[kind][0](p, mapped(true, p), np.ones(p.shape[:2]))
    assert np.abs(mapped(found, p) - mapped(true, p)).max() < EXACT


@pytest.mark.parametrize("kind", FITTERS)
def test_points_without_weight_do_not_count(rng, kind):
    p = points(rng)
    q = mapped(TRUE[kind], p)
    w = np.ones(p.shape[:2])
    q[:, :3], w[:, :3] = 1e3, 0.0
    found = FITTERS[kind][0](p, q, w)
    assert np.abs(mapped(found, p) - mapped(TRUE[kind], p)).max() < EXACT


@pytest.mark.parametrize("fit", [similarities, affinities])
def test_no_small_change_makes_the_sum_of_squares_less(rng, fit):
    p = points(rng, batch=1)
    q = mapped(H, p) + rng.normal(0, 5, p.shape)
    w = rng.uniform(0.5, 2, p.shape[:2])
    best = fit(p, q, w)
    cost = (w[..., None] * (q - mapped(best, p)) ** 2).sum()
    for _ in range(20):
        a, b, x, y = rng.normal(0, 1e-3, 4)
        change = np.array([[1 + a, -b, x], [b, 1 + a, y], [0, 0, 1]])
        assert (w[..., None] * (q - mapped(change @ best, p)) ** 2).sum() >= cost


def test_what_lies_beyond_the_horizon_is_nan_and_depth_is_positive_before_it(rng):
    p = points(rng)
    found = perspectives(p, mapped(H, p), np.ones(p.shape[:2]))
    assert (depths(found, p) > 0).all()
    assert np.isnan(mapped(H, np.array([[-600.0, 0.0]]))).all()
