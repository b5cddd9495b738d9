"""The first step of a search for a part that lies on a known plane: which of its poses there fit a coarse field.

The field is cut into tiles so small that each face and turn is one view of the part in all of a tile. Only these views
are slid over it, each within its tile, and laid onto the plane where they fit best.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from cadcam.arrays import Array, Ids, Mask, Picture
from cadcam.cores import on_cores
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.direction_field import DirectionField
from cadcam.locate.search.climb import FieldLevel, composed, pose_edges, turned
from cadcam.locate.search.lying import Lying
from cadcam.locate.search.scales import SWEPT_PX, Scales, size_px
from cadcam.locate.views.view_range import ViewRange

_TURN_DEG = 10.0  # step of turns on the plane
_SLID = 42  # samples of an aspect that are slid
_TILE_PX, _TILE = 23, 0.07  # half a tile: at most so many px of the field, and rad
_DEEPER, _STEEPEST = 0.1, math.radians(80)  # most change of the distance within half a tile; most oblique view counted
_SMALLEST_PX, _LARGEST = 24.0, 1.5  # size of the part that is searched for: px, over the photo's shorter side
_RAYS = 16  # along each side of a field, to see how obliquely it shows the plane
_TOGETHER = 512  # poses that are slid at once


def lying_poses(
    scales: Scales, eye: int, lying: Lying, views: ViewRange, keep: int
) -> Iterator[tuple[list[int], Array, Array, Array]]:
    """Yield, for each size at which a photo shows the plane, poses (N, 12) that lie there and fit the photo.

    With them the reductions at which they climb, their scores (N,), and their places (N, 2) px in the coarsest field.
    keep: how many are kept of each face and turn in each tile.
    """
    place = scales.places[eye]
    for reduction in scales.reductions(eye):
        field = scales.swept(eye, reduction)
        half = _half_tile(scales, eye, lying, reduction)
        if half is None:
            continue
        centres = _centres(field, half)
        centres = centres[_reaches_this_size(scales, eye, lying, reduction, centres, half)]
        start = _at(lying, field, place, centres)
        q = np.repeat(centres, len(start) // max(len(centres), 1), axis=0)
        seen = _in_range(lying, views, place, start, slack=1 + _DEEPER)
        poses, score, at = _slid(lying, field, place, start[seen], q[seen], half, keep)
        kept = np.isfinite(score) & _in_range(lying, views, place, poses)
        if kept.any():
            yield scales.chosen(eye, reduction * SWEPT_PX), poses[kept], score[kept], at[kept]


def _half_tile(scales: Scales, eye: int, lying: Lying, reduction: int) -> int | None:
    """Return half the width (px) of the tiles of a field; None where the part is nowhere of the size that it is for."""
    field = scales.swept(eye, reduction)
    x, y = (np.linspace(0, side - 1, _RAYS) for side in field.camera.size)
    q = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    q = q[_at_this_size(scales, eye, lying, reduction, q)]
    if not len(q):
        return None
    sight = field.camera.unproject(q) @ scales.places[eye].rotation
    oblique = np.minimum(np.arccos(np.clip(-sight @ lying.plane.normal, -1, 1)), _STEEPEST).max()
    angle = min(_TILE, _DEEPER / max(math.tan(oblique), 1e-9))
    return max(2, min(_TILE_PX, int(angle * field.camera.fx)))


def _centres(field: DirectionField, half: int) -> Array:
    """Return the centres (T, 2) px of tiles that cover a field."""
    x, y = (np.arange(half, side + half, 2 * half + 1, dtype=np.float64) for side in field.camera.size)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _at_this_size(scales: Scales, eye: int, lying: Lying, reduction: int, q: Array) -> Mask:
    """Return at which places (N, 2) px of a field a part on the plane is so large that it is swept over this field."""
    field, place = scales.swept(eye, reduction), scales.places[eye]
    sight = field.camera.unproject(q) @ place.rotation
    face = np.zeros(len(q), np.int64)
    poses = lying.placed(np.broadcast_to(np.eye(3), (len(q), 3, 3)), face, sight, place.origin)
    away = np.linalg.norm(scales.middles(poses) - place.origin, axis=1)
    size = size_px(scales.aspects, scales.focal[eye], away)
    side = min(field.camera.size) * reduction
    right = [scales.chosen(eye, float(s))[0] == reduction if np.isfinite(s) else False for s in size]
    return np.array(right, bool) & (size > _SMALLEST_PX) & (size < _LARGEST * side)


def _reaches_this_size(scales: Scales, eye: int, lying: Lying, reduction: int, centres: Array, half: int) -> Mask:
    """Return in which tiles (T,) of a field a part on the plane is anywhere so large that it is swept over this field.

    In the middle alone would leave places out: those that lie in tiles of one field whose middle is of the next one's
    size, and of the next field in tiles whose middle is of this one's.
    """
    within = half * np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
    q = (centres[:, None] + within).reshape(-1, 2)
    return np.asarray(_at_this_size(scales, eye, lying, reduction, q).reshape(-1, len(within)).any(axis=1))


def _at(lying: Lying, field: DirectionField, place: Rigid, q: Array) -> Array:
    """Return the poses (N, 12) whose middle is seen at places q (T, 2) px: at each every face with every turn."""
    turns = np.radians(np.arange(0.0, 360.0, _TURN_DEG))
    about = so3.exp(turns[:, None] * lying.plane.normal)
    R = (about @ lying.upright()[:, None]).reshape(-1, 3, 3)
    face = np.repeat(np.arange(len(lying.searched)), len(turns))
    sight = field.camera.unproject(q) @ place.rotation
    return lying.placed(
        np.tile(R, (len(q), 1, 1)), np.tile(face, len(q)), np.repeat(sight, len(face), axis=0), place.origin
    )


def _in_range(lying: Lying, views: ViewRange, place: Rigid, poses: Array, slack: float = 1.0) -> Mask:
    """Return which of poses (N, 12) are seen from a camera as declared; distances: times or over `slack`."""
    R, middle = poses[:, :9].reshape(-1, 3, 3), lying.part.aspects.centre
    towards = place.origin - poses[:, 9:] - R @ middle
    away = np.linalg.norm(towards, axis=1)
    near, far = (0.0, np.inf) if views.distance_mm is None else views.distance_mm
    allowed = views.allows(np.einsum("nji,nj->ni", R, towards) / away[:, None])
    return np.asarray(allowed & (away >= near / slack) & (away <= far * slack))


def _slid(
    lying: Lying, field: DirectionField, place: Rigid, poses: Array, q: Array, half: int, keep: int
) -> tuple[Array, Array, Array]:
    """Return poses (N, 12), seen at places q (N, 2), slid to where they fit best, laid; their scores and places."""
    if not len(poses):
        return poses, np.zeros(0), q
    aspects, stage = lying.part.aspects, FieldLevel((field,), (place,))
    edges = pose_edges(aspects, stage, poses, _SLID, telling=False)

    def best(s: slice) -> tuple[Ids, Picture]:
        return edges.part(s).slide(0, poses[s], centre=(0, 0), reach=(half, half), keep=keep, apart=2)

    some = [slice(k, k + _TOGETHER) for k in range(0, len(poses), _TOGETHER)]
    done = on_cores(best, some)
    shift, score = (np.concatenate([d[k] for d in done]) for k in range(2))
    which, by = np.repeat(np.arange(len(poses)), keep), shift.reshape(-1, 2).astype(np.float64)
    moved = turned(aspects, field.camera, composed(place, poses[which]), by)
    return lying.laid(composed(place.inv, moved), place.origin), score.ravel(), q[which] + by
