"""Which of many measurements to make: those that determine the unknowns, not those that repeat each other."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array

_ROUNDS = 4
_LEAST = 1e-4  # information on each unknown that is there anyway, in shares of the mean: some may not be determined


def design(rows: Array, share: Array, *, most: float = 0.6, enough: float = 0.6, poor: float = 0.35) -> Array:
    """Return the share (N,) of measurements to make at each of N places; the sum is 1.

    rows (N, k): derivatives of a measurement there by the unknowns, in comparable units; share (N,): of measurements
    made there without a choice. The D-optimal design minimises the volume of the unknowns' confidence ellipsoid. But it
    makes nearly all measurements at few places, which is wrong where some of these are not what they seem. So none are
    made by it where those without a choice are `enough` of its efficiency, the k-th root of the ratio of the
    information's determinants; `most` of them where these are `poor`; between in proportion. Some rounds of the
    multiplicative algorithm come near it (S. D. Silvey, D. M. Titterington, B. Torsney, Comm. Statist. Theory Methods
    A 7, 1978): the share of a place grows by how much it tells beyond what all places tell.
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
    by_chance, by_design = ((rows.T * each) @ rows for each in (even, best))
    anyway = _LEAST * float(np.trace(by_design)) / k * np.eye(k)
    efficiency = np.exp((np.linalg.slogdet(by_chance + anyway)[1] - np.linalg.slogdet(by_design + anyway)[1]) / k)
    chosen = most * np.clip((enough - efficiency) / (enough - poor), 0, 1)
    return np.asarray((1 - chosen) * even + chosen * best)
