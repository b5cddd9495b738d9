"""The solver: minima to rounding, forbidden states, and what the residuals do not see, by name."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import DegenerateGeometry, NotConverged
from cadcam.fit.least_squares import Options, Stalled, cofactor, minimise
from cadcam.geometry import rotation as so3


class Flat:
    """Residuals of a function of R^n, Jacobian given."""

    def __init__(self, residuals, jacobian):
        self.residuals, self.jacobian = residuals, jacobian

    def residuals_and_jacobian(self, state):
        return self.residuals(state), self.jacobian(state)

    def retract(self, state, step):
        return state + step


ROSENBROCK = Flat(
    lambda x: np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), lambda x: np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
)


def test_rosenbrock_from_far_away():
    solution = minimise(ROSENBROCK, np.array([-12.0, 10.0]))
    assert solution.state == pytest.approx([1, 1], abs=1e-12)
    assert solution.sum_of_squares < 1e-24


def test_a_linear_problem_is_solved_to_rounding_in_spite_of_its_scales(rng):
    """Columns from 1e-8 to 1e8: scaling makes it as good as lstsq on scaled columns."""
    A = rng.normal(size=(30, 6)) * 10.0 ** np.array([-8, -4, 0, 2, 5, 8])
    b = rng.normal(size=30)
    solution = minimise(Flat(lambda x: A @ x - b, lambda x: A), np.zeros(6))
    scale = np.linalg.norm(A, axis=0)
    expected = np.linalg.lstsq(A / scale, b)[0] / scale
    assert solution.state == pytest.approx(expected, rel=1e-9)
    gradient = A.T @ solution.residuals / scale
    assert np.abs(gradient).max() < 1e-12 * np.linalg.norm(b)


class MeanRotation:
    """The rotation nearest to given ones; the state is a matrix, the step a rotation vector."""

    def __init__(self, rotations):
        self.rotations = rotations

    def residuals_and_jacobian(self, R):
        return (R - self.rotations).ravel(), (R @ so3.hat(np.eye(3))).transpose(1, 2, 0).reshape(9, 3)[
            np.tile(np.arange(9), len(self.rotations))
        ]

    def retract(self, R, step):
        return R @ so3.exp(step)


def test_a_minimum_on_the_rotations_is_the_projected_mean(rng):
    """The chordal mean has a closed form: the rotation nearest to the mean matrix."""
    rotations = so3.exp(rng.normal(size=(7, 3)) * 0.4)
    solution = minimise(MeanRotation(rotations), np.eye(3))
    assert solution.state == pytest.approx(so3.nearest(rotations.mean(axis=0)), abs=1e-12)


def test_forbidden_states_are_walked_around():
    """log x has no value for x <= 0; a full step from 0.1 would land there."""

    def residuals(x):
        return np.array([np.log(x[0]) - 3.0]) if x[0] > 0 else np.array([np.nan])

    solution = minimise(Flat(residuals, lambda x: np.array([[1 / x[0]]])), np.array([1e4]))
    assert solution.state[0] == pytest.approx(np.exp(3), rel=1e-12)


def test_a_forbidden_start_is_an_error():
    with pytest.raises(NotConverged, match="cannot start"):
        minimise(Flat(lambda x: x * np.nan, lambda x: np.eye(2)), np.zeros(2))


def test_a_slope_without_end_stalls_and_says_where():
    """exp(-x) falls for ever: no minimum, and no pretending."""
    slope = Flat(lambda x: 1e3 * np.exp(-1e-3 * x), lambda x: np.diag(-np.exp(-1e-3 * x)))
    with pytest.raises(Stalled, match="stopped after 7 iterations") as stalled:
        minimise(slope, np.zeros(1), Options(max_iterations=7))
    assert 0 < stalled.value.sum_of_squares < 1e6


def test_the_cofactor_inverts_the_normal_matrix(rng):
    J = rng.normal(size=(20, 4)) * [1, 1e3, 1e-5, 10]
    assert cofactor(J, "abcd") @ (J.T @ J) == pytest.approx(np.eye(4), abs=1e-6)


def test_a_blind_combination_is_named_with_its_ratio(rng):
    J = rng.normal(size=(20, 3))
    J[:, 2] = -2 * J[:, 0]
    with pytest.raises(DegenerateGeometry, match=r"combination (focal \+0.5 depth|depth \+2 focal)"):
        cofactor(J, ("focal", "tilt", "depth"))


def test_a_single_blind_parameter_is_named(rng):
    J = rng.normal(size=(20, 3))
    J[:, 1] = 0
    with pytest.raises(DegenerateGeometry, match="do not determine tilt "):
        cofactor(J, ("focal", "tilt", "depth"))


def test_fewer_residuals_than_parameters_are_blind(rng):
    with pytest.raises(DegenerateGeometry, match="do not determine"):
        cofactor(rng.normal(size=(2, 3)), "abc")
