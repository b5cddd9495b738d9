"""From a rough start to poses that edge refinement can take up: many hypotheses, then fewer and finer ones.

1. Around the start, rotations (tilts of the view, turns in the picture) and depths on a grid; for each, the visible edges
   of the aspect seen from there are slid over a coarse direction field to find where in the picture they fit best.
   A shift in the picture is a turn of the camera about its centre: it changes nothing of what is seen.
2. The best climb on finer and finer fields, all photos together; what runs into the same pose is one.
The result is ranked by how far the certainty under the edges exceeds what edges put down anywhere would meet, in
standard deviations of that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.direction_field import DirectionField, direction_fields
from cadcam.locate.aspects import Aspects
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.native.fields import PLACE, Eye, Views

_FINE_PX = 300.0  # the part's size in the finest field: enough to tell poses apart, few pixels to look at
_LEVELS = 3
_TILT_DEG, _ROLL_DEG, _DEPTH = 7.5, 4.0, 0.045  # steps of the grid: half of one is in reach of the climb
_SLID, _CLIMBED = 64, 160  # samples of an aspect that are used
_KEPT = (48, 12)  # hypotheses that climb on the middle and the finest field
_COARSE_BLUR = (3.0, 3.0, 2.5, 2.0, 1.5, 1.0)
_FINE_BLUR = (3.0, 2.5, 2.0, 1.5, 1.0, 1.0, 0.7)
_SAME = 0.02  # of the part's radius: poses whose corners differ by less are one


@dataclass(frozen=True, slots=True)
class Reach:
    """How far off a start may be: rotation (deg), place in the picture (px of the photo), share of the depth."""

    rotation_deg: float = 20.0
    shift_px: float = 40.0
    depth: float = 0.10

    def __post_init__(self) -> None:
        for name, value, most in (("rotation_deg", self.rotation_deg, 60.0), ("depth", self.depth, 0.5)):
            if not 0 <= value <= most:
                raise BadValue(f"reach {name}", value, f"0 to {most:g}")
        if not 0 <= self.shift_px < math.inf:
            raise BadValue("reach shift_px", self.shift_px, "a number of px, at least 0")


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A pose that the photos may show, and how much speaks for it.

    score: certainty of lines under the visible edges above what edges put down anywhere meet, in standard deviations of
    that. agreement in [0, 1]: mean certainty under the edges in the picture.
    """

    world_from_part: Rigid
    score: float
    agreement: float


def approach(part: Part, photos: Sequence[Photo], start: Rigid, *, reach: Reach = Reach()) -> list[Hypothesis]:
    """Return poses (world_from_part) within reach of a rough start that the photos may show, best first.

    Good to about a pixel of the photo: for `refine` to take up. Empty where nothing is in reach. Raises
    `NothingInView` where the start puts the part outside every photo.
    """
    stages = _stages(part, photos, start, reach)
    poses = _slid(part.aspects, stages[-1], start, reach)
    free = np.eye(6)
    poses, score, _ = climbed(part.aspects, stages[-2], poses, free, _COARSE_BLUR)
    poses, score = distinct(part.aspects, poses, score, _KEPT[1])
    poses, score, agreement = climbed(part.aspects, stages[0], poses, free, _FINE_BLUR)
    order = np.argsort(-score)
    found = [Hypothesis(_rigid(poses[k]), float(score[k]), float(agreement[k])) for k in order]
    return _without_twins(part.aspects, found)


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The fields of all photos at one level, and where their cameras stand."""

    fields: tuple[DirectionField, ...]
    cameras_from_world: tuple[Rigid, ...]

    @property
    def eyes(self) -> list[Eye]:
        """Return them as the C core takes them."""
        pairs = zip(self.fields, self.cameras_from_world, strict=True)
        return [Eye(f.planes, f.camera.K, T.rotation, T.translation) for f, T in pairs]


def _stages(part: Part, photos: Sequence[Photo], start: Rigid, reach: Reach) -> list[Stage]:
    """Return the stages of all photos that see the part at its start, finest first."""
    aspects, fields, places = part.aspects, [], []
    for photo in photos:
        pose = photo.viewpoint.camera_from_world
        span = _span(aspects, photo.camera, pose @ start)
        region = None if span is None else _region(span, photo.camera, reach)
        if region is None:
            continue
        size = float(np.max(span[1] - span[0])) if span is not None else 0.0
        k = max(1, round(size / _FINE_PX))
        fields.append(direction_fields(photo.gray, photo.camera, reduction=k, levels=_LEVELS, region=region))
        places.append(pose)
    if not fields:
        raise NothingInView("the start puts the part outside of every photo; check the start and the part's unit")
    levels = min(len(f) for f in fields)
    return [Stage(tuple(f[k] for f in fields), tuple(places)) for k in range(levels)]


def _span(aspects: Aspects, camera: Camera, camera_from_part: Rigid) -> tuple[Array, Array] | None:
    """Return the corners of the box of px that the part's ball takes in a photo; None where it is behind."""
    centre = camera_from_part @ aspects.centre
    if centre[2] < 0.2 * aspects.radius:
        return None
    offsets = aspects.radius * np.concatenate([np.eye(3)[:2], -np.eye(3)[:2]])
    q = camera.project(np.concatenate([[centre], centre + offsets]))
    q = q[np.isfinite(q).all(axis=1)]
    return (q.min(axis=0), q.max(axis=0)) if len(q) else None


def _region(span: tuple[Array, Array], camera: Camera, reach: Reach) -> tuple[int, int, int, int] | None:
    grow = reach.shift_px + (reach.depth + 0.02) * (span[1] - span[0])
    low = np.clip(np.floor(span[0] - grow), 0, camera.size).astype(int)
    high = np.clip(np.ceil(span[1] + grow) + 1, 0, camera.size).astype(int)
    return None if (high - low).min() < 16 else (int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def _slid(aspects: Aspects, stage: Stage, start: Rigid, reach: Reach) -> Array:
    """Return the best poses (N, 12), world_from_part, of a grid around the start, each where it fits best."""
    poses, scores = [], []
    for eye, (field, camera_from_world) in enumerate(zip(stage.fields, stage.cameras_from_world, strict=True)):
        seen = _grid(aspects, camera_from_world @ start, reach)
        world = _composed(camera_from_world.inv, seen)
        shift_px = math.ceil(reach.shift_px / field.reduction) + 1
        views = views_of(aspects, stage, world, _SLID)
        shift, score = views.slide(eye, world, centre=(0, 0), reach=(shift_px, shift_px), keep=1, apart=2)
        best = np.argsort(-score[:, 0])[: _KEPT[0]]
        moved = _turned(aspects, field.camera, seen[best], shift[best, 0].astype(float))
        poses.append(_composed(camera_from_world.inv, moved))
        scores.append(score[best, 0])
    order = np.argsort(-np.concatenate(scores), kind="stable")[: _KEPT[0]]
    return np.concatenate(poses)[order]


def _grid(aspects: Aspects, camera_from_part: Rigid, reach: Reach) -> Array:
    """Return poses (N, 12) camera_from_part around one: turned about the part's middle, nearer and farther."""
    centre = camera_from_part @ aspects.centre
    axis = centre / np.linalg.norm(centre)
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    vectors = _turns(reach.rotation_deg) @ np.stack([side, np.cross(axis, side), axis])
    R = so3.exp(np.radians(vectors)) @ camera_from_part.rotation
    n = round(reach.depth / _DEPTH)
    depth = np.exp(np.linspace(-1, 1, 2 * n + 1) * math.log1p(reach.depth)) if n else np.ones(1)
    middle = depth[:, None, None] * centre
    t = middle - (R @ aspects.centre)[None]
    R = np.broadcast_to(R, (len(depth), *R.shape))
    return np.concatenate([R.reshape(-1, 9), t.reshape(-1, 3)], axis=1)


def _turns(reach_deg: float) -> Array:
    """Return rotation vectors (N, 3), degrees, in a ball: a hexagonal net of tilts (0, 1), even turns (2) about z."""
    n = math.ceil(reach_deg / _TILT_DEG) + 1
    i, j = (a.ravel() for a in np.meshgrid(np.arange(-2 * n, 2 * n + 1), np.arange(-2 * n, 2 * n + 1)))
    tilt = _TILT_DEG * np.stack([i + 0.5 * j, math.sqrt(0.75) * j], axis=1)
    m = round(reach_deg / _ROLL_DEG)
    roll = _ROLL_DEG * np.arange(-m, m + 1)
    every = np.concatenate([np.broadcast_to(tilt[:, None], (len(tilt), len(roll), 2)),
                            np.broadcast_to(roll[None, :, None], (len(tilt), len(roll), 1))], axis=2).reshape(-1, 3)  # fmt: skip
    return every[np.linalg.norm(every, axis=1) <= reach_deg + 0.25 * _TILT_DEG]


def _turned(aspects: Aspects, camera: Camera, seen: Array, shift: Array) -> Array:
    """Return poses (N, 12) camera_from_part after the camera turned so that the part's middle moved by shift (N, 2) px."""
    R, t = seen[:, :9].reshape(-1, 3, 3), seen[:, 9:]
    q = camera.project(R @ aspects.centre + t)
    one, other = camera.unproject(q), camera.unproject(q + shift)
    axis = np.cross(one, other)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    turn = so3.exp(axis * (np.arcsin(np.minimum(sine, 1.0)) / np.maximum(sine, 1e-300)))
    return np.concatenate([(turn @ R).reshape(-1, 9), np.einsum("nij,nj->ni", turn, t)], axis=1)


def _composed(a: Rigid, poses: Array) -> Array:
    """Return a @ each of poses (N, 12)."""
    R = a.rotation @ poses[:, :9].reshape(-1, 3, 3)
    return np.concatenate([R.reshape(-1, 9), poses[:, 9:] @ a.rotation.T + a.translation], axis=1)


def views_of(aspects: Aspects, stage: Stage, poses: Array, samples: int) -> Views:
    """Return what the eyes of a stage see of poses (N, 12) world_from_part: each the first samples of its aspect."""
    R, t = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]
    first = np.zeros((len(poses), len(stage.fields)), np.int64)
    count = np.zeros(first.shape, np.int32)
    runs, used = {}, 0
    for e, camera_from_world in enumerate(stage.cameras_from_world):
        eye = np.einsum("nji,nj->ni", R, camera_from_world.origin - t)  # in the part frame
        net, step = aspects.nearest(eye)
        key, number = np.unique(np.stack([net, step]), axis=1, return_inverse=True)
        at, n = np.zeros(key.shape[1], np.int64), np.zeros(key.shape[1], np.int32)
        for k, (direction, distance) in enumerate(key.T.tolist()):
            if (direction, distance) not in runs:
                places = aspects.aspect(direction, distance).places[:samples]
                runs[direction, distance] = (used, places)
                used += len(places)
            at[k], n[k] = runs[direction, distance][0], len(runs[direction, distance][1])
        first[:, e], count[:, e] = at[number.ravel()], n[number.ravel()]
    places = np.concatenate([np.zeros(0, PLACE), *(p for _, p in runs.values())])
    return Views(stage.eyes, places, first, count)


def climbed(
    aspects: Aspects, stage: Stage, poses: Array, freedom: Array, blur: Sequence[float], samples: int = _CLIMBED
) -> tuple[Array, Array, Array]:
    """Return poses (N, 12) after climbing on a stage, their scores (N,) and agreements (N,)."""
    poses, raw = views_of(aspects, stage, poses, samples).climb(poses, freedom, blur)
    total = raw.sum(axis=1)
    score = (total[:, 0] - total[:, 1]) / np.sqrt(np.maximum(total[:, 2], 1e-9))
    return poses, score, total[:, 0] / np.maximum(total[:, 3], 1e-9)


def distinct(aspects: Aspects, poses: Array, score: Array, most: int) -> tuple[Array, Array]:
    """Return at most so many of the best poses, no two of which are the same."""
    left = np.argsort(-score, kind="stable")
    kept: list[int] = []
    corners = _corners(aspects, poses)
    while len(left) and len(kept) < most:
        kept.append(int(left[0]))
        apart = np.linalg.norm(corners[left] - corners[left[0]], axis=2).max(axis=1)
        left = left[apart > _SAME * aspects.radius]
    return poses[kept], score[kept]


def _corners(aspects: Aspects, poses: Array) -> Array:
    """Return where four points of the part's ball lie for each pose: (N, 4, 3) mm."""
    points = aspects.centre + aspects.radius * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    return points @ np.swapaxes(poses[:, :9].reshape(-1, 3, 3), 1, 2) + poses[:, None, 9:]


def _without_twins(aspects: Aspects, found: list[Hypothesis]) -> list[Hypothesis]:
    if not found:
        return []
    corners = _corners(aspects, np.array([_row(h.world_from_part) for h in found]))
    kept: list[int] = []
    for k in range(len(found)):
        if all(np.linalg.norm(corners[k] - corners[j], axis=1).max() > _SAME * aspects.radius for j in kept):
            kept.append(k)
    return [found[k] for k in kept]


def _row(pose: Rigid) -> Array:
    return np.concatenate([pose.rotation.ravel(), pose.translation])


def _rigid(row: Array) -> Rigid:
    return Rigid(so3.nearest(row[:9].reshape(3, 3)), row[9:])
