"""The direct linear transform as an estimate of its own, with the covariance of that estimator, and as a start."""

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
    pinhole = _decomposed(p, q, form)
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
    """Return starts (S, k) from both forms with the fixed internals put in place; none where there is no answer."""
    states = []
    for form in FORMS:
        try:
            pinhole = _decomposed(model.p_world, model.q, form)
        except (DegenerateGeometry, TooFewPoints, BadValue):
            continue
        values = dict(zip(NAMES, pinhole.vector, strict=True)) | dict(fixed)
        pose = pinhole.camera_from_world
        states.append(model.states(pose.origin, pose.rotation, np.array([values[n] for n in INTERNALS])))
    return np.array(states)


def seen_from_the_front(observations: Observations) -> bool:
    """Return whether a linear transform, which knows mirrored cameras too, fits an unmirrored one to the points."""
    for form in FORMS:
        try:
            _refuse_behind(_decomposed(observations.p_world, observations.q, form), observations)
        except (DegenerateGeometry, TooFewPoints, BadValue):
            continue
        return True
    return False


def _decomposed(p: Array, q: Array, form: Form) -> ExtendedPinhole:
    return ExtendedPinhole.from_matrix(uv_from_pixel_matrix(dlt(p, q, form=form)))


def _cofactor(p: Array, q: Array, form: Form) -> Array:
    step = 1e-4 * max(1.0, float(np.ptp(q)) / 500)  # px: the transform is smooth on the scale of a pixel
    columns = []
    for i in range(q.size):
        shift = np.zeros(q.size)
        shift[i] = step
        plus, minus = (_decomposed(p, q + sign * shift.reshape(q.shape), form) for sign in (1, -1))
        columns.append(_local_difference(plus, minus) / (2 * step))
    D = np.stack(columns, axis=1)
    return np.asarray(D @ D.T)


def _local_difference(plus: ExtendedPinhole, minus: ExtendedPinhole) -> Array:
    change = plus.vector - minus.vector
    change[3:6] = so3.log(minus.camera_from_world.rotation.T @ plus.camera_from_world.rotation)
    return change


def _refuse_behind(pinhole: ExtendedPinhole, observations: Observations) -> None:
    z = (pinhole.camera_from_world @ observations.p_world)[:, 2]
    behind = np.flatnonzero(z <= 0)
    if len(behind) == len(z):
        raise MirroredPoints(
            f"all {len(z)} points lie behind the camera that fits them: the world frame is left-handed or the image "
            f"is mirrored "
            "(columns for U and V exchanged, or rows counted upwards)"
        )
    if len(behind):
        raise DegenerateGeometry(
            f"{len(behind)} of {len(z)} points lie behind the camera that fits them, "
            f"{observations.names[behind[0]]!r} first: "
            "points and pixels do not belong together, or are too few and too noisy for a direct linear transform"
        )
