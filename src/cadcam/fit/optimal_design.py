"""Which of many measurements to make: those that determine the unknowns, not those that repeat each other."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array

_ROUNDS = 4
_LEAST = 1e-4  # information on each unknown that is there anyway, in shares of the mean: some may not be determined


def design(rows: Array, share: Array, *, chosen: float) -> Array:
    """Return the share (N,) of measurements to make at each of N places; the sum is 1.

    rows (N, k): derivatives of a measurement there by the unknowns, in comparable units; share (N,): of measurements
    made there without a choice. `chosen` of the measurements are made by the D-optimal design, approximately, the
    others without a choice. A D-optimal design minimises the volume of the unknowns' confidence ellipsoid; some rounds
    of the multiplicative algorithm come near it (S. D. Silvey, D. M. Titterington, B. Torsney, Comm. Statist. Theory
    Methods A 7, 1978): the share of a place grows by how much it tells beyond what all places tell.
    """
    even: Array = share / share.sum()
    best, k = even, rows.shape[1]
    for _ in range(_ROUNDS):
        information = (rows.T * best) @ rows
        told = float(np.trace(information))
        if not told > 0:
            return even
        information += _LEAST * told / k * np.eye(k)
        best = best * np.einsum("ij,ij->i", rows @ np.linalg.inv(information), rows)
        best /= best.sum()
    return np.asarray((1 - chosen) * even + chosen * best)
