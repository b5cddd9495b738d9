"""The error of a hand-eye calibration on poses left out, and a test of the target's stated size."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.handeye.estimate import HeldOut
from cadcam.camera.camera import Camera
from cadcam.fit.hand_eye_poses import PATTERNS, HandEyePoses, PosesFit
from cadcam.fit.many_poses import PaddedViews
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid


def held_out(
    poses: HandEyePoses, fit: PosesFit, *, held: bool, views: PaddedViews | None = None, camera: Camera | None = None
) -> HeldOut:
    """Return each pose predicted by all the others: the fit without it, in one exact linear step.

    held: the flange holds the camera. Where the others do not determine the solution a pose's numbers are nan.
    """
    shift, distance2 = _without_each(fit)
    seen = poses.held_from_fixed
    should = (fit.flange_from_held @ Rigid.exp(shift[:, :6])).inv @ (
        poses.base_from_flange.inv @ (fit.base_from_fixed @ Rigid.exp(shift[:, 6:]))
    )
    if not held:
        should, seen = should.inv, seen.inv
    rotation = np.linalg.norm(so3.log(np.swapaxes(should.rotation, 1, 2) @ seen.rotation), axis=1)
    known = np.isfinite(distance2)
    px, mm = (np.where(known, off, np.nan) for off in _distances(should, seen, views, camera))
    return HeldOut(px, mm, np.where(known, rotation, np.nan), np.where(known, _chance(distance2), 1.0))


def scale_of_target(poses: HandEyePoses, fit: PosesFit) -> tuple[float, float]:
    """Return how many of the robot's millimetres are one of the target's, and its sigma: 1 where both are right.

    The result of the adjustment with a free scale of the camera's distances, one step from its minimum. (1, inf) where
    the motions do not determine it.
    """
    R, t = poses.held_from_fixed.rotation, poses.held_from_fixed.translation
    along = (np.swapaxes(R, 1, 2) @ t[..., None])[..., 0]
    through = fit.jacobian[:, :, 6:]
    column = -np.einsum("nij,nj->ni", through[:, :, :3], along)
    WD = fit.weights @ fit.jacobian
    Wc = np.einsum("nij,nj->ni", fit.weights, column)
    coupled = np.einsum("nip,ni->p", WD, column)
    own = float(np.sum(column * Wc))
    left = own - float(coupled @ np.linalg.solve(fit.information, coupled))
    if not left > 1e-9 * own:
        return 1.0, np.inf
    gradient = float(np.sum(Wc * fit.offsets))
    gradient -= float(coupled @ np.linalg.solve(fit.information, np.einsum("nip,ni->p", WD, fit.offsets)))
    return 1 - gradient / left, 1 / float(np.sqrt(left))


def _without_each(fit: PosesFit) -> tuple[Array, Array]:
    """Return the changes (n, 12) of the parameters without each pose, and its squared distance (n,) from the rest.

    No change, and nan, where the rest does not determine the parameters.
    """
    D, W, e = fit.jacobian, fit.weights, fit.offsets
    H = fit.information
    scale = 1 / np.sqrt(np.diag(H))
    DW = np.swapaxes(D, 1, 2) @ W
    rest = (H - DW @ D) * np.outer(scale, scale)
    known = np.linalg.eigvalsh(rest)[:, 0] > 1e-12
    rest[~known] = np.eye(12)
    C = np.linalg.inv(rest) * np.outer(scale, scale)
    shift = np.einsum("npq,nqi,ni->np", C, DW, e)
    left = e + np.einsum("nip,np->ni", D, shift)
    less = (_variances_without_each(fit) - fit.variances) @ PATTERNS.reshape(2, 36)
    V = np.linalg.inv(W) + less.reshape(-1, 6, 6) + D @ C @ np.swapaxes(D, 1, 2)
    distance2 = np.einsum("ni,nij,nj->n", left, np.linalg.inv(V), left)
    shift[~known], distance2[~known] = 0.0, np.nan
    return shift, distance2


def _distances(should: Rigid, seen: Rigid, views: PaddedViews | None, camera: Camera | None) -> tuple[Array, Array]:
    """Return rms distances (n,) of pixels and of target points in mm."""
    if views is None or camera is None:
        return np.full(len(should.translation), np.nan), np.linalg.norm(should.translation - seen.translation, axis=1)
    count = views.seen.sum(axis=1)
    p_should = views.p @ np.swapaxes(should.rotation, 1, 2) + should.translation[:, None]
    p_seen = views.p @ np.swapaxes(seen.rotation, 1, 2) + seen.translation[:, None]
    square = np.sum((p_should - p_seen) ** 2, axis=2) * views.seen
    off = np.sum((camera.project(p_should) - views.q) ** 2, axis=2)
    off = np.where(views.seen > 0, off, 0.0)
    return np.sqrt(off.sum(axis=1) / count), np.sqrt(square.sum(axis=1) / count)


def _variances_without_each(fit: PosesFit) -> Array:
    """Return the robot's variances (n, 2) estimated from the other poses, by one step of Fisher scoring.

    Otherwise a single blunder would raise the noise that it is judged by.
    """
    D, W, E = fit.jacobian, fit.weights, PATTERNS
    z = np.einsum("nij,nj->ni", W, fit.offsets)
    WD = W @ D
    known = np.einsum("kij,nij->nk", E, W) - np.einsum("kij,nip,pq,njq->nk", E, WD, np.linalg.inv(fit.information), WD)
    gradient = 0.5 * (np.einsum("ni,kij,nj->nk", z, E, z) - known)
    each = 0.5 * np.einsum("kij,njl,mlo,noi->nkm", E, W, E, W)
    moved = np.linalg.solve(each.sum(axis=0) - each, -gradient[..., None])[..., 0]
    return np.clip(fit.variances + moved, 0.05 * fit.variances, 2 * fit.variances)


def _chance(distance2: Array) -> Array:
    """Return the tail of the F distribution: 6 and the degrees of freedom that the noise was estimated from."""
    from scipy.special import fdtrc

    freedom = 6 * (len(distance2) - 1) - 12
    return np.asarray(fdtrc(6, freedom, distance2 / 6)) if freedom > 0 else np.ones(len(distance2))
