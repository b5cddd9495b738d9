"""Where the datum's edges leave a motion of the part free it is named, however its axes and its origin lie."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.errors import DegenerateGeometry
from cadcam.geometry.rotation import exp
from cadcam.verify.adjustment.datum_fit import Adjustment
from cadcam.verify.adjustment.scatter import EdgeNoise

SIGMA = 0.05


def rows(p: Array, way: Array) -> Array:
    """Return J (n, 6) of offsets along the ways (n, 3) of places (n, 3) mm, at 1 px a mm."""
    return np.concatenate([way, np.cross(p, way)], axis=1)


def adjustment(J: Array) -> Adjustment:
    n = len(J)
    errors = EdgeNoise.of(np.full(n, SIGMA), np.arange(n), np.zeros(n), 0.0)
    return Adjustment(np.zeros(n), J, np.zeros((n, 0)), errors, np.ones(n, bool))


@pytest.mark.parametrize("turn", [0.0, 1e-4, 1e-2, 0.5])
def test_lines_that_are_parallel_do_not_hold_the_part_along_them(turn: float, rng: np.random.Generator) -> None:
    """But for rounding, of which along an axis of the part nothing but this is left: it was scaled up to hold."""
    R, p = exp(np.array([0.0, 0.0, turn])), rng.uniform(-100, 100, (60, 3))
    way = rng.normal(size=(60, 3)) * [1.0, 1e-14, 1.0]
    along = R @ [0.0, 1.0, 0.0]
    J = rows(p, way @ R.T)
    J[:, 3:] += np.outer(rng.normal(size=60), along)  # so that turns about the lines are held
    with pytest.raises(DegenerateGeometry, match="the translation") as told:
        adjustment(J).pose()
    stated = np.fromstring(str(told.value).split("[")[1].split("]")[0], sep=",")[:3]
    assert abs(stated @ along) == pytest.approx(1.0, abs=2e-3)


def test_a_turn_that_nothing_holds_is_told_wherever_the_origin_is(rng: np.random.Generator) -> None:
    """About an axis along z through (2000, 3000): lines across it all point at it."""
    beside = rng.uniform(-100, 100, (60, 3))
    out, p = beside * [1.0, 1.0, 0.0], np.array([2000.0, 3000.0, 0.0]) + beside
    way = rng.normal(size=(60, 1)) * out / 100 + rng.normal(size=(60, 1)) * [0.0, 0.0, 1.0]
    with pytest.raises(DegenerateGeometry, match="the motion"):
        adjustment(rows(p, way)).pose()


def test_a_part_far_from_its_origin_is_held(rng: np.random.Generator) -> None:
    """Twenty metres off, of a tenth of a metre; the covariance is the inverse of the information."""
    p, way = np.array([20000.0, 5000.0, -3000.0]) + rng.uniform(-50, 50, (60, 3)), rng.normal(size=(60, 3))
    J = rows(p, way)
    fitted = adjustment(J).pose()
    np.testing.assert_allclose(fitted.covariance @ J.T @ J / SIGMA**2, np.eye(6), atol=1e-3)


def test_a_large_part_far_off_is_held_whatever_motions_its_freedom_is_made_of(rng: np.random.Generator) -> None:
    """Ten metres large, depth a thousandth as well known; five motions, each of mm and rad mixed.

    Of the information on depth, 1e-13 of the most in these motions, rounding leaves some 1 %.
    """
    p, way = rng.uniform(-5000, 5000, (60, 3)), rng.normal(size=(60, 3)) * [1.0, 1.0, 1e-3]
    apart, J = np.eye(6)[:, :5], rows(p, way)
    mixed = apart @ np.linalg.qr(rng.normal(size=(5, 5)))[0]
    found = replace(adjustment(J), freedom=mixed).pose().covariance
    told = apart @ np.linalg.inv(apart.T @ J.T @ J @ apart) @ apart.T * SIGMA**2
    np.testing.assert_allclose(np.diag(found), np.diag(told), rtol=0.05)
