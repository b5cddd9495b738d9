"""The models' derivatives are correct, and their covariance is that of repeated noise."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.target.boards import photometric
from cadcam.target.boards.photometric import fit_corners

CORNER = [0.1, -0.2, 0.3, 1.7, 0.4, 0.9, 0.5, 0.01, 0.02]
DISC = [0.1, -0.2, 0.05, 0.01, -0.4, 0.9, 0.5, 0.01, 0.02, 0.07]


@pytest.mark.parametrize(("model", "at"), [(photometric._corner, CORNER), (photometric._disc, DISC)])
def test_slopes_are_derivatives(model: photometric.Model, at: list[float], rng: np.random.Generator) -> None:
    """Central differences of step 1e-6: exact to 1e-10 of values of order 1, derivatives to 1e-8 or so."""
    pixels = rng.uniform(-6, 6, (1, 60, 2))
    p = np.array([at])
    _, J = model(p, pixels)
    for k in range(len(at)):
        h = np.zeros_like(p)
        h[0, k] = 1e-6
        slope = (model(p + h, pixels)[0] - model(p - h, pixels)[0]) / 2e-6
        assert np.allclose(J[..., k], slope, atol=3e-8)


def test_the_covariance_is_that_of_repeated_pictures(rng: np.random.Generator) -> None:
    """400 corners, alike but for their noise: variances by chi-square of 400 within 4 x sqrt(2/400) = 0.28."""
    grid = np.arange(-12, 13)
    u, v = np.meshgrid(grid, grid)
    true = np.array([[0.23, -0.31, 0.2, 1.5, 0.35, 0.8, 0.5, 0.0, 0.0]])
    clean = photometric._corner(true, np.stack([u, v], axis=-1).reshape(1, -1, 2))[0].reshape(25, 25)
    strip = np.tile(clean, (20, 20)) + rng.normal(0, 0.02, (500, 500))
    y, x = np.mgrid[12:500:25, 12:500:25]
    q = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    fit = fit_corners(strip.astype(np.float32), q, np.tile([0.2, 1.5], (400, 1)), np.full(400, 9.0))
    assert fit.good.all()
    scatter = np.cov((fit.q - q).T)
    assert np.allclose(np.diag(scatter) / np.diag(fit.covariance.mean(axis=0)), 1.0, atol=0.28)
    bias = (fit.q - q - true[:, :2]).mean(axis=0)
    assert np.abs(bias).max() < 4 * np.sqrt(scatter.max() / 400)


def test_a_mark_that_is_not_there_is_not_good(rng: np.random.Generator) -> None:
    """A plain edge, a flat patch: no position along the edge, none at all."""
    edge = np.repeat((np.arange(60) > 30).astype(np.float32)[None], 60, axis=0)
    edge += rng.normal(0, 0.01, edge.shape).astype(np.float32)
    fit = fit_corners(edge, np.array([[30.0, 30.0], [10.0, 30.0]]), np.tile([0.0, 1.57], (2, 1)), np.full(2, 8.0))
    sigma = np.sqrt(np.einsum("nii->n", fit.covariance))
    assert (~fit.good | (sigma > 0.1) | (fit.misfit > 0.3)).all()
