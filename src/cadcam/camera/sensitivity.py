"""The derivatives of a pixel by every parameter of its camera, shared by calibration, pose and covariance.

Coordinates of a change ("local" coordinates, in this order):
X Y Z    the focal centre F in mm,
rx ry rz a rotation of the camera about its focal centre, R <- R exp(r), r in world axes, rad,
aspect focal skew U0 V0   the internals in the thesis' names,
then the lens' coefficients in their own order.
They have no gimbal lock and do not depend on the distance of the world's origin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, component_major
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import OURS_FROM_THESIS, angles_of, internals_of
from cadcam.camera.lens import Lens
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import hat


def project_with_sensitivity(camera: Camera, camera_from_world: Rigid, p_world: Array) -> tuple[Array, Array]:
    """Return pixels q (N, 2) of world points (N, 3) and dq/d(local coordinates) (N, 2, 11 + lens terms).

    NaN where the camera images nothing (`Camera.project`).
    """
    F, R = camera_from_world.origin, camera_from_world.rotation
    return project_local(F, R, internals_of(camera.K), camera.lens, p_world)


def project_local(F: Array, R: Array, internals: Array, lens: Lens, p_world: Array) -> tuple[Array, Array]:
    """Return q (..., N, 2) and its Jacobian (..., N, 2, 11 + lens terms) for a batch of cameras sharing one lens.

    F (..., 3) mm, R (..., 3, 3) rows = our camera axes, internals (..., 5), p_world (N, 3).
    """
    from_F = p_world - F[..., None, :]
    in_camera = np.moveaxis(R @ np.swapaxes(from_F, -1, -2), -1, -2)
    q, dq_dp, dq_di = project_in_camera(internals, lens, in_camera)
    dq_dw = dq_dp @ R[..., None, :, :]  # by the world point
    J = np.zeros((*q.shape, 6 + dq_di.shape[-1]))
    np.negative(dq_dw, out=J[..., 0:3])
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # -row . hat(x) = (x cross row); np.cross takes four times that
        J[..., 3 + i] = from_F[..., None, j] * dq_dw[..., k] - from_F[..., None, k] * dq_dw[..., j]
    J[..., 6:] = dq_di
    return q, J


def project_in_camera(
    internals: Array, lens: Lens, p: Array, columns: Sequence[int] | None = None, *, out: Array | None = None
) -> tuple[Array, Array, Array]:
    """Return q (..., N, 2), dq/dp (..., N, 2, 3) and dq/d(internals, lens) (..., N, 2, 5 + lens terms).

    p (..., N, 3): points in the camera frame; internals (..., 5). columns: those of the last Jacobian to compute, in
    that order; None: all. out: zeros of its shape to write to. Fast where each coordinate of all points is contiguous
    in memory (`component_major`).
    """
    every = range(5 + len(lens.parameters))
    wanted = every if columns is None else columns
    m, dm_dp, dm_dc = lens.project_with_jacobians(p, [column - 5 for column in wanted if column >= 5])
    aspect, focal, skew, U0, V0 = (internals[..., None, i] for i in range(5))
    c, s = np.cos(skew), np.sin(skew)
    scale = focal * aspect
    along = c * m[..., 0] + s * m[..., 1]
    q = component_major(m.shape[:-1], 2)
    q[..., 0], q[..., 1] = scale * along + V0, focal * m[..., 1] + U0
    by = np.swapaxes(component_major(m.shape[:-1], len(wanted), 2), -1, -2) if out is None else out
    to_pixels = scale * c, scale * s, focal
    by[..., [i for i, column in enumerate(wanted) if column >= 5]] = _in_pixels(dm_dc, *to_pixels)
    for i, column in enumerate(wanted):
        if column == 0:
            by[..., 0, i] = focal * along
        elif column == 1:
            by[..., 0, i], by[..., 1, i] = aspect * along, m[..., 1]
        elif column == 2:
            by[..., 0, i] = scale * (c * m[..., 1] - s * m[..., 0])
        elif column in (3, 4):
            by[..., 4 - column, i] = 1.0
    return q, _in_pixels(dm_dp, *to_pixels), by


def _in_pixels(dm: Array, xx: Array, xy: Array, yy: Array) -> Array:
    """Return [[xx, xy], [0, yy]] @ dm (..., N, 2, n) in a layout that is contiguous by component."""
    out = component_major(dm.shape[:-2], 2, dm.shape[-1])
    np.multiply(dm[..., 0, :], xx[..., None], out=out[..., 0, :])
    np.multiply(dm[..., 1, :], yy[..., None], out=out[..., 1, :])
    if xy.any():
        out[..., 0, :] += xy[..., None] * dm[..., 1, :]
    return out


def rotation_by_angles(R: Array) -> Array:
    """Return G (..., 3, 3): the local rotation r = G d(a, b, c) of a change of the thesis' angles, at our rotations R.

    From Rz(c) Ry(b) Rx(a) with Rx(a) = exp(-a e_x) and so on; det G = -cos b, singular at b = +-90 deg.
    """
    angles = angles_of(OURS_FROM_THESIS.T @ R)[..., :2]
    (sa, sb), (ca, cb) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    G = np.zeros(R.shape)
    G[..., 0, 0], G[..., 1, 1], G[..., 2, 1] = -1.0, -ca, -sa
    G[..., 0, 2], G[..., 1, 2], G[..., 2, 2] = -sb, sa * cb, -ca * cb
    return G


def twist_by_local(F: Array) -> Array:
    """Return (6, 6): the twist xi of `camera_from_world @ exp(xi)` from the first six local coordinates.

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
