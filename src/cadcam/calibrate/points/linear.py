"""The direct linear transform as an estimate, with the covariance of that estimator, and as a start."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import INTERNALS, NAMES, ExtendedPinhole, uv_from_pixel_matrix
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, DegenerateGeometry, MirroredPoints, TooFewPoints
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.dlt import FORMS, Form, dlt
from cadcam.geometry import rotation as so3


def dlt_estimate(observations: Observations, size: tuple[int, int], form: Form) -> CameraEstimate:
    """Return the camera of the direct linear transform, its matrix decomposed into the eleven parameters.

    The covariance is that of this estimator to first order, by central differences in every pixel coordinate: not that
    of least squares. Raises `MirroredPoints` if the points lie behind the camera that the matrix describes.
    """
    p, q = observations.p_world, observations.q
    pinhole = decomposed(p, q, form)
    _refuse_behind(pinhole, observations)
    return CameraEstimate(
        camera=pinhole.camera(size),
        camera_from_world=pinhole.camera_from_world,
        observations=observations,
        free=NAMES,
        cofactor=_cofactor(p, q, form),
        method=f"direct linear transform, {'normalised' if form == 'normalised' else 'C23 = 1'} form",
    )


def dlt_states(model: CameraModel, fixed: Mapping[str, float]) -> Array:
    """Return starts (S, k) from both forms with the fixed internals set; none where there is no solution."""
    states = []
    for form in FORMS:
        try:
            pinhole = decomposed(model.p_world, model.q, form)
        except (DegenerateGeometry, TooFewPoints, BadValue):
            continue
        values = dict(zip(NAMES, pinhole.vector, strict=True)) | dict(fixed)
        pose = pinhole.camera_from_world
        states.append(model.states(pose.origin, pose.rotation, np.array([values[n] for n in INTERNALS])))
    return np.array(states)


def seen_from_the_front(observations: Observations) -> bool:
    """Return whether a linear transform, which also fits mirrored cameras, gives an unmirrored one for the points."""
    for form in FORMS:
        try:
            _refuse_behind(decomposed(observations.p_world, observations.q, form), observations)
        except (DegenerateGeometry, TooFewPoints, BadValue):
            continue
        return True
    return False


def decomposed(p: Array, q: Array, form: Form) -> ExtendedPinhole:
    """Return the eleven parameters of the direct linear transform, wherever the points lie relative to that camera."""
    return ExtendedPinhole.from_matrix(uv_from_pixel_matrix(dlt(p, q, form=form)))


def derivatives(p: Array, q: Array, form: Form) -> tuple[Array, Array]:
    """Return d(local coordinates)/dq (11, 2N) and /dp_world (11, 3N) of the direct linear transform.

    By central differences: it is smooth on the scale of a pixel, and of a thousandth of the points' extent.
    """
    pixel = 1e-4 * max(1.0, float(np.ptp(q)) / 500)
    mm = 1e-6 * float(np.ptp(p))
    by_q = [_difference((p, q - d), (p, q + d), form) / (2 * pixel) for d in _units(q.shape, pixel)]
    by_p = [_difference((p - d, q), (p + d, q), form) / (2 * mm) for d in _units(p.shape, mm)]
    return np.stack(by_q, axis=1), np.stack(by_p, axis=1)


def _cofactor(p: Array, q: Array, form: Form) -> Array:
    D, _ = derivatives(p, q, form)
    return np.asarray(D @ D.T)


def _units(shape: tuple[int, ...], step: float) -> Array:
    return (step * np.eye(int(np.prod(shape)))).reshape(-1, *shape)


def _difference(one: tuple[Array, Array], other: tuple[Array, Array], form: Form) -> Array:
    return _local_difference(decomposed(*other, form), decomposed(*one, form))


def _local_difference(plus: ExtendedPinhole, minus: ExtendedPinhole) -> Array:
    change = plus.vector - minus.vector
    change[3:6] = so3.log(minus.camera_from_world.rotation.T @ plus.camera_from_world.rotation)
    return change


def _refuse_behind(pinhole: ExtendedPinhole, observations: Observations) -> None:
    z = (pinhole.camera_from_world @ observations.p_world)[:, 2]
    behind = np.flatnonzero(z <= 0)
    if len(behind) == len(z):
        raise MirroredPoints(
            f"all {len(z)} points lie behind the camera that fits them: the world frame is left-handed or the image is "
            "mirrored (columns for U and V exchanged, or rows counted upwards)"
        )
    if len(behind):
        raise DegenerateGeometry(
            f"{len(behind)} of {len(z)} points lie behind the camera that fits them, "
            f"{observations.names[behind[0]]!r} first: points and pixels do not belong together, or are too few "
            "and too noisy for a direct linear transform"
        )
