"""Many sets of observations of one camera estimated at once, and the derivative of an estimate by observations."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.calibrate.points.camera import METHODS, Method
from cadcam.calibrate.points.linear import decomposed, derivatives
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES
from cadcam.camera.lens import Ideal
from cadcam.camera.sensitivity import rotation_by_angles
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.dlt import Form
from cadcam.fit.least_squares import cofactor
from cadcam.fit.multistart import descend
from cadcam.kinds import expect_known

ANGULAR = ("a", "b", "c")
_FORMS: dict[Method, Form] = {"dlt": "normalised", "dlt-c23": "c23"}
_ITERATIONS = 30
_SETTLED = 1e-6  # in units of the noise variance: predicted decrease at convergence


def model_of(estimate: CameraEstimate) -> tuple[CameraModel, Array]:
    """Return the reprojection problem behind an estimate, and the estimate as its state."""
    seen = estimate.observations
    model = CameraModel(seen.p_world, seen.q, estimate.free, estimate.camera.lens)
    return model, model.state_of(estimate.camera, estimate.camera_from_world)


def refuse_method(method: Method, estimate: CameraEstimate) -> None:
    """Raise `UnknownName`, or `BadValue` for a linear transform where anything is fixed or the lens is not ideal."""
    expect_known(method, "calibration method", METHODS)
    if method in _FORMS and (estimate.free != NAMES or estimate.camera.lens != Ideal()):
        raise BadValue("method", repr(method), "'reprojection' where anything is fixed or a lens is there")


def estimates(model: CameraModel, starts: Array, method: Method, *, noise_px: float) -> tuple[Array, Mask]:
    """Return the free parameters (B, n) of B sets of observations, each estimated from its start, and which are good.

    model: with p_world (B, N, 3), q (B, N, 2); starts (B, k). A set whose estimation fails or does not converge to a
    thousandth of a sigma is not good.
    """
    if method in _FORMS:
        return _linear_estimates(model, _FORMS[method])
    states, costs = descend(model, starts, _ITERATIONS)
    r, J = model.residuals_and_jacobian(states)
    good = np.isfinite(costs)
    good[good] = _promises(r[good], J[good]) <= _SETTLED * noise_px**2
    return free_of(model, model.parameters(states)), good


def response(estimate: CameraEstimate, method: Method) -> tuple[Array, Array]:
    """Return the derivatives of the free parameters by pixels, (n, 2N), and by world coordinates, (n, 3N).

    For least squares at exact observations it is G = (J^T J)^-1 J^T and -G dq/dp_world; for a linear transform finite
    differences.
    """
    model, state = model_of(estimate)
    p, q = model.p_world, seen_exactly(estimate)
    if method in _FORMS:
        back = np.eye(len(NAMES))
        back[3:6, 3:6] = np.linalg.inv(rotation_by_angles(state[3:12].reshape(3, 3)))
        by_q, by_p = derivatives(p, q, _FORMS[method])
        return back @ by_q, back @ by_p
    J = model.jacobian_by_parameters(state)
    G = cofactor(J, model.free) @ J.T
    _, dq_dp = estimate.camera.project_with_jacobian(estimate.camera_from_world @ p)
    dq_dp = dq_dp @ estimate.camera_from_world.rotation
    return G, -np.einsum("nid,idk->nik", G.reshape(len(G), -1, 2), dq_dp).reshape(len(G), -1)


def seen_exactly(estimate: CameraEstimate) -> Array:
    """Return the images of the points (N, 2) in the estimated camera, px."""
    return estimate.camera.project(estimate.camera_from_world @ estimate.observations.p_world)


def free_of(model: CameraModel, parameters: Array) -> Array:
    """Return the free ones of all parameters (..., k), (..., n)."""
    return np.asarray(parameters[..., model.columns])


def unwrapped(values: Array, names: tuple[str, ...], about: Array) -> Array:
    """Return parameters (..., n) with their angles within half a turn of those of `about` (..., n)."""
    angular = np.isin(names, ANGULAR)
    return np.where(angular, about + (values - about + np.pi) % (2 * np.pi) - np.pi, values)


def _linear_estimates(model: CameraModel, form: Form) -> tuple[Array, Mask]:
    values = np.full((len(model.q), len(NAMES)), np.nan)
    for row, p, q in zip(values, model.p_world, model.q, strict=True):
        try:
            row[:] = decomposed(p, q, form).vector
        except (DegenerateGeometry, BadValue):  # a draw without a solution: counted, not fatal
            continue
    return values, np.isfinite(values).all(axis=1)


def _promises(r: Array, J: Array) -> Array:
    """Return the decrease of each sum of squares by a full step, to first order."""
    scale = np.maximum(np.linalg.norm(J, axis=1, keepdims=True), 1e-300)
    S = J / scale
    g = np.swapaxes(S, 1, 2) @ r[..., None]
    A = np.swapaxes(S, 1, 2) @ S + 1e-14 * np.eye(J.shape[2])
    return np.asarray(np.sum(g * np.linalg.solve(A, g), axis=(1, 2)))
