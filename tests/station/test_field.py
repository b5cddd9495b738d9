"""The field of deviations: exact where it was seen, honest between, and its errors those it predicts."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from cadcam.errors import BadValue, TooFewPoints
from cadcam.station.field import DeviationField, fit_field

X, Y = np.meshgrid([0.0, 4000.0, 8000.0], [0.0, 2400.0, 4800.0, 7200.0, 9600.0], indexing="ij")
GRID = np.column_stack([X.ravel(), Y.ravel()])
QUIET = np.stack([1e-6 * np.eye(15)] * 2)


def smooth(p):
    s, t = np.asarray(p)[..., 0] / 8000, np.asarray(p)[..., 1] / 9600
    return np.stack([8 * np.sin(3 * t + s), 6 * np.cos(2 * s - t) + 2 * t], axis=-1)


def test_weights_add_up_to_one_and_find_what_was_seen(rng):
    field = fit_field(GRID, smooth(GRID), QUIET)
    W = field.weights(rng.uniform(0, 8000, (20, 2)))
    assert W.sum(axis=2) == pytest.approx(np.ones((2, 20)), abs=1e-6)
    assert np.einsum("anN,Na->na", field.weights(GRID), smooth(GRID)) == pytest.approx(smooth(GRID), abs=5e-3)


def test_between_positions_a_smooth_field_is_found_within_its_sigma(rng):
    field = fit_field(GRID, smooth(GRID), QUIET)
    places = rng.uniform([200, 200], [7800, 9400], (50, 2))
    W = field.weights(places)
    found = np.einsum("anN,Na->na", W, smooth(GRID))
    sigma = np.sqrt(np.einsum("ann->na", field.error_covariance(places, W)))
    assert np.abs(found - smooth(places)).max() < 1.0
    assert (np.abs(found - smooth(places)) < 2 * sigma).mean() > 0.9


def test_the_best_weights_have_the_least_predicted_error(rng):
    field = fit_field(GRID, smooth(GRID), QUIET)
    at = np.array([[2100.0, 3500.0]])
    W = field.weights(at)
    least = field.error_covariance(at, W)[:, 0, 0]
    for _ in range(20):
        other = W + 0.05 * (lambda d: d - d.mean(axis=2, keepdims=True))(rng.normal(size=W.shape))
        assert (field.error_covariance(at, other)[:, 0, 0] > 0.97 * least).all()  # best of each hypothesis, averaged


def test_predicted_errors_are_those_of_fields_drawn_from_the_hypothesis(rng):
    """One hypothesis, 4000 fields drawn from it: variances are good to 2.2 %, so 10 % is more than four sigma."""
    one = np.array([[6.0, 4000.0, 5000.0, 2.5]])
    field = DeviationField(GRID, (one, one), (np.ones(1), np.ones(1)), QUIET)
    at = np.array([[1000.0, 1500.0], [1500.0, 2000.0]])
    W = field.weights(at)
    both = np.concatenate([at, GRID])
    root = np.linalg.cholesky(field._covariance(0, both) + 1e-9 * np.eye(17))
    drawn = root @ rng.normal(size=(17, 4000))
    seen = np.cov(W[0] @ drawn[2:] - drawn[:2])
    predicted = field.error_covariance(at, W)[0]
    scale = np.sqrt(np.diag(predicted))
    assert seen / np.outer(scale, scale) == pytest.approx(predicted / np.outer(scale, scale), abs=0.1)


def test_noisy_values_are_smoothed():
    field = fit_field(GRID, smooth(GRID), np.stack([9.0 * np.eye(15)] * 2))
    assert (np.diagonal(field.weights(GRID), axis1=1, axis2=2) < 0.9).all()


def test_the_real_mechanics_of_table_6_11_is_foretold_from_its_neighbours(table_6_11):
    """Each position of robot 6 left out in turn: errors of 4.6 mm are foretold to within a third."""
    places, d = table_6_11
    m, grid = (d - np.swapaxes(d, 0, 1)).sum(axis=1) / 30, 1000 * places
    z = []
    for k in range(15):
        kept = np.arange(15) != k
        field = fit_field(grid[kept], m[kept], np.stack([0.1 * np.eye(14)] * 2))
        W = field.weights(grid[k : k + 1])
        sigma = np.sqrt(field.error_covariance(grid[k : k + 1], W)[:, 0, 0])
        z.append((np.einsum("aN,Na->a", W[:, 0], m[kept]) - m[k]) / sigma)
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 4 / 3


def test_a_field_between_many_places_is_added_up_hypothesis_by_hypothesis(rng):
    """All at once they would take gigabytes for a day of 1000 marks."""
    field = fit_field(GRID, smooth(GRID), 1e6 * QUIET)  # of so noisy a field many hypotheses are probable
    at = rng.uniform(0, 8000, (200, 2))
    W, pairs = field.weights(at), 8 * (len(at) + len(GRID)) ** 2
    assert len(field.probability[0]) > 30
    tracemalloc.start()
    try:
        field.error_covariance(at, W)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 20 * pairs  # a dozen steps of one covariance, the sum, and what is done with it


def test_a_field_of_nothing_or_of_other_places_is_refused():
    with pytest.raises(TooFewPoints, match="1 position"):
        fit_field(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((2, 0, 0)))
    with pytest.raises(BadValue, match="deviations"):
        fit_field(GRID, smooth(GRID)[1:], QUIET)
