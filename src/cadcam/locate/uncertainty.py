"""The covariance of a pose due to its cameras' errors, and its least certain direction in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, significant
from cadcam.camera.error_source import ErrorSource, covariance_of
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.camera.sensitivity import project_with_sensitivity
from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo

_ALONG = 0.9  # cosine from which a direction is named after an axis
_RATIO = 1.5  # ratio by which the weakest direction must stand out to be named
_ROUNDING = 1e-9  # of what is added: a sum this near to zero is zero


def calibration_covariance(
    photos: Sequence[Photo],
    points: Sequence[Array],
    normals: Sequence[Array],
    gains: Sequence[Array],
    pose: Rigid,
    *,
    beside: Sequence[Array] = (),
) -> Array:
    """Return the covariance (6, 6) of the pose's twist due to the errors of cameras and of their poses.

    For each photo points (n, 3) mm of the part, normals (n, 2) along which they were measured, and gain (6, n): the
    derivative of the twist by the offsets. beside: the derivative (6, c) of the twist by each camera's own coordinates
    through what else was measured in its photo (`evidence.moved_by_cameras`), default nothing. Errors of one source
    (one calibration, one motion) act on all photos alike.
    """
    effects: list[tuple[ErrorSource, Array]] = []
    for k, (photo, p, normal, gain) in enumerate(zip(photos, points, normals, gains, strict=True)):
        view = photo.viewpoint
        if not view.errors:
            continue
        _, J = project_with_sensitivity(view.camera, view.camera_from_world, pose @ p)
        by_local = gain @ np.einsum("ni,nij->nj", normal, J)
        if beside:
            by_local = by_local + beside[k]
        effects += [(source, by_local @ D) for source, D in view.errors]
    return covariance_of(effects, 6)


def with_known_poses(own: Array, known: Sequence[tuple[Array, Array]], radius: float) -> Array:
    """Return the covariance (6, 6) of a pose due to its cameras' errors where these have moved poses known before, too.

    own (6, 6): by what was measured in the photos; known: of each pose that was evidence beside them, its covariance
    (6, 6) due to the cameras and the derivative (6, 6) of the fitted pose by it. What both have in common is not known,
    but it is the same errors in much the same view: so they are taken to be as nearly alike as the covariances allow,
    with rotations times the part's radius, mm.
    """
    if not known:
        return own
    scale = np.repeat([1.0, radius], 3)
    root = symmetric_root(scale[:, None] * own * scale)
    for before, share in known:
        theirs, weight = symmetric_root(scale[:, None] * before * scale), scale[:, None] * share / scale
        one, _, other = np.linalg.svd(root @ (np.eye(6) - weight) @ theirs)
        root = root @ one @ other + weight @ theirs
    return np.asarray((root @ root.T) / scale[:, None] / scale)


def symmetric_root(R: Array) -> Array:
    """Return the symmetric square root of a covariance that may be singular: eigenvalues below zero are rounding."""
    values, axes = np.linalg.eigh(R)
    return np.asarray((axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)


def weakest_direction(pose: PoseEstimate, centre: Array, photos: Sequence[Photo]) -> str:
    """Return in words how well the part's centre (3,) mm is known, and where it is known least.

    Where what was free does not move the centre, it is the least certain turn. What no photo determines does not count.
    """
    pose = pose.determined
    if not np.abs(_moves(pose.freedom, centre)).max(initial=0.0) > 0:
        return _weakest_turn(pose)
    S = pose.point_covariance(centre[None])[0]
    variances, axes = np.linalg.eigh(S)
    sd = np.sqrt(np.maximum(variances, 0.0))
    if sd[2] < _RATIO * max(sd[1], 1e-300):
        return f"position within {_mm(sd[2])} in any direction"
    return f"least certain {_named(axes[:, 2], pose.world_from_part, centre, photos)}, {_mm(sd[2])}"


def _moves(twists: Array, centre: Array) -> Array:
    """Return the displacements (3, k) of the centre by twists (6, k); rounding is zero."""
    slide, turn = twists[:3].T, np.cross(twists[3:].T, centre)
    least = _ROUNDING * (np.linalg.norm(slide, axis=1) + np.linalg.norm(turn, axis=1))
    return np.asarray(np.where(np.abs(slide + turn) > least[:, None], slide + turn, 0.0).T)


def _weakest_turn(pose: PoseEstimate) -> str:
    """Return in words how well a part is turned that is free only to turn about its centre."""
    if not pose.freedom.shape[1]:
        return "position as stated"
    variances, axes = np.linalg.eigh(pose.covariance[3:, 3:])
    sd = float(np.degrees(np.sqrt(max(variances[2], 0.0))))
    return f"position as stated; turn about {_axis_words(axes[:, 2])} within {sd:.2g} deg"


def _named(axis: Array, pose: Rigid, centre: Array, photos: Sequence[Photo]) -> str:
    """Return a direction (3,) of the part in words: by a camera that looks along it, by an axis, or by its numbers."""
    for photo in photos:
        sight = (photo.camera_from_world @ pose) @ centre
        view = sight @ (photo.camera_from_world.rotation @ pose.rotation) / np.linalg.norm(sight)
        if abs(view @ axis) > _ALONG:
            whose = "" if len(photos) == 1 else f" of {photo.viewpoint.name}"
            return f"along the viewing direction{whose}"
    return f"along {_axis_words(axis)}"


def _axis_words(axis: Array) -> str:
    """Return an axis (3,) of the part in words: the part's own, or its numbers."""
    for k, name in enumerate("xyz"):
        if abs(axis[k]) > _ALONG:
            return f"the part's {name} axis"
    lead = axis * np.sign(axis[int(np.argmax(np.abs(axis)))])
    return f"({lead[0]:.2f}, {lead[1]:.2f}, {lead[2]:.2f}) of the part"


def _mm(sd: float) -> str:
    return f"{significant(sd)} mm"
