"""How a pixel moves with every parameter of its camera: the one Jacobian that calibration, pose and covariance share.

Coordinates of a change ("local" coordinates, in this order):
X Y Z    the focal centre F in mm,
rx ry rz a rotation of the camera about its focal centre, R <- R exp(r), r in world axes, rad,
aspect focal skew U0 V0   the internals in the thesis' names,
then the lens' coefficients in their own order.
They have no gimbal lock and do not care how far the world's origin is away.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import OURS_FROM_THESIS, angles_of
from cadcam.camera.lens import Lens
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import hat


def project_with_sensitivity(camera: Camera, camera_from_world: Rigid, p_world: Array) -> tuple[Array, Array]:
    """Return pixels q (N, 2) of world points (N, 3) and dq/d(local coordinates) (N, 2, 11 + lens terms).

    NaN where the camera sees nothing (`Camera.project`).
    """
    F, R = camera_from_world.origin, camera_from_world.rotation
    internals = internals_of(camera.K)
    q, J = project_local(F, R, internals, camera.lens, p_world)
    return q, J


def internals_of(K: Array) -> Array:
    """Return (aspect, focal, skew, U0, V0) of a camera matrix."""
    return np.array(
        [np.hypot(K[0, 0], K[0, 1]) / K[1, 1], K[1, 1], np.arctan2(K[0, 1], K[0, 0]), K[1, 2], K[0, 2]],
    )


def project_local(F: Array, R: Array, internals: Array, lens: Lens, p_world: Array) -> tuple[Array, Array]:
    """Return q (..., N, 2) and its Jacobian (..., N, 2, 11 + lens terms) for a batch of cameras sharing one lens.

    F (..., 3) mm, R (..., 3, 3) rows = our camera axes, internals (..., 5), p_world (N, 3).
    """
    from_F = p_world - F[..., None, :]
    m, dm_dp, dm_dc = lens.project_with_jacobians(from_F @ np.swapaxes(R, -1, -2))
    aspect, focal, skew, U0, V0 = (internals[..., None, i] for i in range(5))
    c, s = np.cos(skew), np.sin(skew)
    along = c * m[..., 0] + s * m[..., 1]
    q = np.stack([focal * aspect * along + V0, focal * m[..., 1] + U0], axis=-1)

    A = np.zeros((*q.shape[:-1], 2, 2))  # dq/dm
    A[..., 0, 0], A[..., 0, 1], A[..., 1, 1] = focal * aspect * c, focal * aspect * s, focal
    dq_dw = A @ (dm_dp @ R[..., None, :, :])  # by the world point
    J = np.zeros((*q.shape, 11 + dm_dc.shape[-1]))
    J[..., 0:3] = -dq_dw
    J[..., 3:6] = np.cross(from_F[..., None, :], dq_dw)  # -row . hat(x) = (x cross row)
    J[..., 0, 6], J[..., 0, 7], J[..., 1, 7] = focal * along, aspect * along, m[..., 1]
    J[..., 0, 8] = focal * aspect * (c * m[..., 1] - s * m[..., 0])
    J[..., 1, 9] = J[..., 0, 10] = 1.0
    J[..., 11:] = A @ dm_dc
    return q, J


def rotation_by_angles(R: Array) -> Array:
    """Return G (3, 3): the local rotation r = G d(a, b, c) of a change of the thesis' angles, at our rotation R.

    From Rz(c) Ry(b) Rx(a) with Rx(a) = exp(-a e_x) and so on; det G = -cos b, singular at b = +-90 deg.
    """
    a, b, _ = angles_of(OURS_FROM_THESIS.T @ R)
    (sa, sb), (ca, cb) = np.sin([a, b]), np.cos([a, b])
    return -np.array([[1.0, 0.0, sb], [0.0, ca, -sa * cb], [0.0, sa, ca * cb]])


def twist_by_local(F: Array) -> Array:
    """Return (6, 6): the twist xi of `camera_from_world @ exp(xi)` of the first six local coordinates.

    The focal centre moves by dF = -v - r x F and the rotation by r, so v = -dF + hat(F) r.
    """
    out = np.eye(6)
    out[:3, :3], out[:3, 3:] = -np.eye(3), hat(F)
    return out


def project_batch(F: Array, R: Array, internals: Array, lens: Lens, p_world: Array) -> Array:
    """Return the pixels q (..., N, 2) of `project_local` without their Jacobian."""
    m = lens.project((p_world - F[..., None, :]) @ np.swapaxes(R, -1, -2))
    aspect, focal, skew, U0, V0 = (internals[..., None, i] for i in range(5))
    along = np.cos(skew) * m[..., 0] + np.sin(skew) * m[..., 1]
    return np.stack([focal * aspect * along + V0, focal * m[..., 1] + U0], axis=-1)
