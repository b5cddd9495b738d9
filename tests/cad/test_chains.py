"""Chains of segments, in order or by number."""

from __future__ import annotations

import numpy as np

from cadcam.cad.chains import chain_of_each, chained


def test_numbered_or_in_order_the_chains_are_the_same(rng: np.random.Generator) -> None:
    """On rings that touch each other and have gaps, their segments in any order and either way round."""
    turn = np.arange(20) * (2 * np.pi / 20)
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    grid = np.concatenate([ring + np.array([2.0 * x, 2.0 * y, 0]) for x in range(3) for y in range(3)])
    where, point = np.unique(np.round(grid, 6) + 0.0, axis=0, return_inverse=True)
    first = np.arange(len(grid)).reshape(-1, 20)
    every = point.ravel()[np.stack([first, np.roll(first, -1, axis=1)], axis=-1).reshape(-1, 2)]
    assert len(where) < len(grid)
    for n in (0, 1, 90, 160, 180):
        points = rng.permuted(every[rng.permutation(len(every))[:n]], axis=1)
        group = rng.integers(0, 2, n) * rng.integers(0, 2)
        order, _, chain = chained(where[points], points, group)
        number = chain_of_each(where[points], points, group)
        assert np.array_equal(number[order][:, None] == number[order], chain[:, None] == chain)
    assert np.bincount(chain).max() > 4
