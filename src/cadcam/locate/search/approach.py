"""From a rough start to poses that edge refinement can take up: many hypotheses, then fewer and finer ones.

1. Rotations around the start (tilts of the view, rolls in the picture) and depths on a grid; for each, the edges of
   the aspect seen from there are slid over a coarse direction field to find where in the picture they fit best. A
   shift in the picture is a rotation of the camera about its centre, which changes nothing of what is visible.
2. The best climb on finer and finer fields, in all photos together; those that reach the same pose are merged.
The result is ranked by how far the mean edge certainty under the lines exceeds that under lines at random places, in
standard deviations of the latter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cadcam.arrays import Array, significant
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect_numbers
from cadcam.locate.freedom import FREE, Freedom, aligned
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.search.climb import Climb, FieldLevel, climbed, composed, distinct, pose_edges, rigids_of, turned
from cadcam.locate.search.hypothesis import Hypothesis
from cadcam.locate.views.aspects import Aspects, Views
from cadcam.locate.views.outlook import Outlook

_FINE_PX = 360.0  # largest size of the part in the finest field: enough to tell poses apart at low cost
_SHORTEST = 0.1  # widths of the picture: a focal length below it sees more than 157 degrees
_FEW_PX = 12.0  # a part that is smaller in a photo has hardly any edges there
_COARSE_PX, _LEVELS = 33.0, 3  # least size of the part in the coarsest field, px; the most fields
_TILT_DEG, _ROLL_DEG, _DEPTH = 9.0, 6.0, 0.07  # steps of the grid: half a step is within the basin of the climb
_SLID = 56  # samples of an aspect that are slid over the field
_TAKEN = 32  # hypotheses that start to climb
_WITHIN_PX, _WITHIN = 4.0, 2.0  # error of lines after the climb: px of the photo, at least; px of the finest field
_FLIPPED, _MOST_FLIPPED = 1, 2  # the climb before which mirror poses are added, and for how many of the best
_FLAT, _TILTED = 0.3, 0.002  # mirror poses: most thickness over breadth; least 1 - cosine of the tilt that they change
_SPREAD, _MOST_SPREAD = 0.12, 1500  # step of restricted motions, in radii at the part's border; most poses of those
_AT_CAMERA_MM = 1e-9  # a part's middle so near to the camera's is at it: there is no line of sight to it
_HELD = 2.0  # times as far off as said: what a start still holds, as that is a guess
_CLIMBS = (  # from the coarsest field on: level, samples, blurs, poses kept
    Climb(0, 96, (2.5, 2.0, 1.5, 1.0, 1.0), 16, near=True),
    Climb(1, 128, (2.0, 1.5, 1.0, 1.0), 6, near=True),
    Climb(2, 160, (1.5, 1.0, 1.0, 0.7), 6, near=True),
)


@dataclass(frozen=True, slots=True)
class Reach:
    """How far off a start may be: rotation (deg), position in the picture (px of the photo), share of the depth."""

    rotation_deg: float = 20.0
    shift_px: float = 40.0
    depth: float = 0.10

    def __post_init__(self) -> None:
        expect_numbers(self)
        for name, value, most in (("rotation_deg", self.rotation_deg, 60.0), ("depth", self.depth, 0.5)):
            if not 0 <= value <= most:
                raise BadValue(f"reach {name}", value, f"0 to {most:g}")
        if not 0 <= self.shift_px < math.inf:
            raise BadValue("reach shift_px", self.shift_px, "a number of px, at least 0")

    def holds(self, middle: Array, photos: Sequence[Photo], start: Rigid, pose: Rigid) -> bool:
        """Return whether a pose (world_from_part) is no more than twice as far from the start as that may be off.

        middle (3,): of what the photos show of the part, mm in the part frame.
        """
        before, after = start @ middle, pose @ middle
        distance, near = _nearest(photos, before)
        sight = (before - near.camera_from_world.origin) / max(distance, _AT_CAMERA_MM)
        deeper = float((after - before) @ sight)
        aside = float(np.linalg.norm(after - before - deeper * sight))
        turned_deg = math.degrees(float(np.linalg.norm((start.inv @ pose).log()[3:])))
        off = (turned_deg, near.camera.fx * aside, abs(deeper))
        most = (self.rotation_deg, self.shift_px * distance, self.depth * distance)
        return all(one <= _HELD * limit for one, limit in zip(off, most, strict=True))


def _nearest(photos: Sequence[Photo], middle: Array) -> tuple[float, Photo]:
    """Return how far (mm) from the nearest camera a place (3,) in the world is, and that camera's photo."""
    away = [float(np.linalg.norm(middle - photo.camera_from_world.origin)) for photo in photos]
    return min(away), photos[int(np.argmin(away))]


REACH = Reach()


def approach(
    part: Part, photos: Sequence[Photo], start: Rigid, *, reach: Reach = REACH, freedom: Freedom = FREE
) -> list[Hypothesis]:
    """Return poses (world_from_part) within reach of a rough start that the photos may show, best first.

    Accurate to about a pixel of the photo, for `refine_pose` to take up. Empty where nothing is in reach. Raises
    `NothingInView` where the start puts the part outside every photo.
    """
    aspects, seeing = _views(part, photos, start, reach)
    stages = _stages(aspects, seeing, start, reach)
    if not stages:
        raise NothingInView(_outside(part.aspects, photos[0], start))
    centre = aspects.centre
    camera = (stages[0].cameras_from_world[0] @ start).origin
    free = aligned(freedom.at(start), centre, centre - camera)
    if free.shape[1] == 6:
        poses = _slid(aspects, stages[-1], start, reach)
    else:
        poses = _spread(aspects, seeing, start, free, reach)
    for number, climb in enumerate(_CLIMBS):
        if number == _FLIPPED and free.shape[1] == 6:
            poses = np.concatenate([poses, _flips(aspects, stages[0], poses[:_MOST_FLIPPED])])
        stage = stages[max(len(stages) - 1 - climb.level, 0)]
        poses, score = climbed(aspects, stage, poses, free, climb)
        kept = distinct(aspects, poses, score, climb.kept)
        poses, score = poses[kept], score[kept]
    within = max(_WITHIN_PX, *(_WITHIN * field.reduction for field in stages[0].fields))
    return [Hypothesis(*each, within) for each in zip(rigids_of(poses), score.tolist(), strict=True)]


def _views(part: Part, photos: Sequence[Photo], start: Rigid, reach: Reach) -> tuple[Views, Sequence[Photo]]:
    """Return what the photos show of the part about its start, and the photos that may show any of it."""
    views = [(photo.camera, photo.camera_from_world @ start) for photo in photos]
    inside = any(part.aspects.hold(pose.origin) for _, pose in views)
    if not inside and any(part.aspects.span(*view) is not None for view in views):
        return part.aspects, photos
    outlook = Outlook.of(part.lines, views, reach.shift_px)
    if outlook is None:
        return part.aspects, photos
    return outlook, [photos[k] for k in outlook.seeing]


def middle_in_view(part: Part, photos: Sequence[Photo], start: Rigid, reach: Reach) -> Array:
    """Return the middle (3,) mm, in the part frame, of what the photos may show of the part about its start."""
    return _views(part, photos, start, reach)[0].centre


def _stages(aspects: Views, photos: Sequence[Photo], start: Rigid, reach: Reach) -> list[FieldLevel]:
    """Return the field levels of all photos that see the part at its start, finest first; none where none does."""
    fields, places = [], []
    for photo in photos:
        pose = photo.camera_from_world
        span = aspects.span(photo.camera, pose @ start)
        if span is None or (region := _region(span, photo.camera, reach)) is None:
            continue
        size = float(np.max(span[1] - span[0]))
        k = max(1, math.ceil(size / _FINE_PX))
        levels = min(1 + max(int(math.log2(size / k / _COARSE_PX)), 0), _LEVELS) if size else _LEVELS
        fields.append(photo.fields(reduction=k, levels=levels, region=region))
        places.append(pose)
    levels = min((len(f) for f in fields), default=0)
    return [FieldLevel(tuple(f[k] for f in fields), tuple(places)) for k in range(levels)]


def _outside(aspects: Aspects, photo: Photo, start: Rigid) -> str:
    """Return where a start puts a part that no photo shows, or no edge of, and what may be wrong with it."""
    x, y, z = middle = photo.camera_from_world @ start @ aspects.centre
    r = aspects.radius
    place = f"its middle at ({x:.4g}, {y:.4g}, {z:.4g}) mm of camera {photo.viewpoint.name!r}"
    seen = bool(photo.camera.sees(photo.camera.project(middle[None]))[0])
    what = "none of the part's edges into a photo" if seen else "the part outside of every photo"
    if math.hypot(x, y, z) < r:
        why = f"nearer than the part is large ({2 * r:.4g} mm): are start and part in one unit, mm?"
    elif z <= 0:
        why = "behind it: cameras look along +z here; is the pose inverted, or of a camera that looks along -z?"
    elif seen:
        why = "in view, but one face fills the picture: is the part larger than that?"
    else:
        why = "beside its picture: is the pose inverted, or in another unit?"
    return f"the start puts {what}, {place}, {why}"


def focal_as_in_mm(photos: Sequence[Photo]) -> str:
    """Return that a camera's focal length is so short that it may be in mm, not px; "" if none is."""
    for photo in photos:
        short = photo.camera.fx / photo.camera.width
        if short < _SHORTEST:
            px = significant(photo.camera.fx)
            return f"the focal length of camera {photo.viewpoint.name!r} is {px} px: is it in mm instead?"
    return ""


def as_in_another_unit(part: Part, photos: Sequence[Photo], start: Rigid) -> str:
    """Return that a start puts a camera into the part, or makes it too small for its edges to tell much; "" if not."""
    middle, diameter = part.aspects.centre, 2 * part.aspects.radius
    spans = [part.aspects.span(photo.camera, photo.camera_from_world @ start) for photo in photos]
    size = max((float(np.max(span[1] - span[0])) for span in spans if span is not None), default=np.inf)
    mm, photo = _nearest(photos, start @ middle)
    away = f"{mm:.4g} mm from camera {photo.viewpoint.name!r}"
    if size < _FEW_PX:
        return f"the start makes the part {significant(size)} px large, {away}, as if in another unit"
    if part.aspects.hold((photo.camera_from_world @ start).origin):
        return f"the start puts the middle of the part, {diameter:.4g} mm large, {away}: are both in one unit, mm?"
    return ""


def _region(span: tuple[Array, Array], camera: Camera, reach: Reach) -> tuple[int, int, int, int] | None:
    grow = reach.shift_px + (reach.depth + 0.02) * (span[1] - span[0])
    low = np.clip(np.floor(span[0] - grow), 0, camera.size).astype(int)
    high = np.clip(np.ceil(span[1] + grow) + 1, 0, camera.size).astype(int)
    return None if (high - low).min() < 16 else (int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def _slid(aspects: Views, stage: FieldLevel, start: Rigid, reach: Reach) -> Array:
    """Return the best poses (N, 12), world_from_part, of a grid around the start, each shifted to its best fit."""
    poses, scores = [], []
    for eye, (field, camera_from_world) in enumerate(zip(stage.fields, stage.cameras_from_world, strict=True)):
        if (camera_from_world @ start @ aspects.centre)[2] <= 0:  # it looks away from what another camera sees
            continue
        seen = _grid(aspects, camera_from_world @ start, reach)
        world = composed(camera_from_world.inv, seen)
        shift_px = math.ceil(reach.shift_px / field.reduction) + 1
        edges = pose_edges(aspects, stage, world, _SLID, telling=True)
        shift, score = edges.slide(eye, world, centre=(0, 0), reach=(shift_px, shift_px), keep=1, apart=2)
        best = np.argsort(-score[:, 0])[:_TAKEN]
        moved = turned(aspects, field.camera, seen[best], shift[best, 0].astype(float))
        poses.append(composed(camera_from_world.inv, moved))
        scores.append(score[best, 0])
    order = np.argsort(-np.concatenate(scores), kind="stable")[:_TAKEN]
    return np.concatenate(poses)[order]


def _spread(aspects: Views, photos: Sequence[Photo], start: Rigid, free: Array, reach: Reach) -> Array:
    """Return poses (N, 12) on a grid within reach of the start along the free motions, twists as columns (6, k).

    A step of the grid moves the part's border by `_SPREAD` radii, or more where that would take too many poses.
    """
    radius, (distance, near) = aspects.radius, _nearest(photos, start @ aspects.centre)
    far = reach.shift_px * distance / near.camera.fx + reach.depth * distance  # mm that the middle may be off
    # What a unit of each motion moves, in mm: the middle, and by rotation the border.
    middle_by = np.linalg.norm(np.concatenate([np.eye(3), -so3.hat(aspects.centre)], axis=1) @ free, axis=0)
    border_by = np.linalg.norm(free[3:], axis=0) * radius
    most = np.minimum(
        far / np.maximum(middle_by, 1e-12),
        math.radians(reach.rotation_deg) * radius / np.maximum(border_by, 1e-12),
    )
    steps = np.maximum(np.ceil(most * np.maximum(middle_by, border_by) / (_SPREAD * radius)), 1)
    steps = np.maximum(np.minimum(steps, _MOST_SPREAD ** (1 / len(steps)) / 2), 1).astype(int)
    axes = [np.linspace(-m, m, 2 * k + 1) for m, k in zip(most, steps, strict=True)]
    twists = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1) @ free.T
    moved = start @ Rigid.exp(twists)
    return np.concatenate([moved.rotation.reshape(-1, 9), moved.translation], axis=1)


def _flips(aspects: Views, stage: FieldLevel, poses: Array) -> Array:
    """Return the mirror poses (M, 12) of those of poses (N, 12) whose visible edges lie near a plane.

    From far away a plane of normal a looks the same at R and at D R A, with the mirrors D = I - 2 v v' across the line
    of sight v and A = I - 2 a a' across the plane (Necker reversal).
    """
    camera_from_world = stage.cameras_from_world[0]
    seen, out = composed(camera_from_world, poses), []
    for row in seen:
        R, t = row[:9].reshape(3, 3), row[9:]
        direction, step = (int(index[0]) for index in aspects.nearest(-(t @ R)[None], R[2:]))
        aspects.make([(direction, step)])
        places = aspects.made[direction, step].places["p"].astype(float)
        if len(places) < 3:
            continue
        middle = places.mean(axis=0)
        variance, axes = np.linalg.eigh((places - middle).T @ (places - middle))
        sight = R @ middle + t
        a, v = axes[:, 0], sight / np.linalg.norm(sight)
        if variance[0] < _FLAT**2 * variance[1] and 1 - abs(v @ R @ a) > _TILTED:
            mirrored = (np.eye(3) - 2 * np.outer(v, v)) @ R @ (np.eye(3) - 2 * np.outer(a, a))
            out.append(np.concatenate([mirrored.ravel(), sight - mirrored @ middle]))
    return composed(camera_from_world.inv, np.array(out).reshape(-1, 12))


def _grid(aspects: Views, camera_from_part: Rigid, reach: Reach) -> Array:
    """Return poses (N, 12) camera_from_part around one: rotated about the part's centre, nearer and farther."""
    centre = camera_from_part @ aspects.centre
    axis = centre / np.linalg.norm(centre)
    side = so3.hat(axis) @ np.eye(3)[np.argmin(np.abs(axis))]
    side /= np.linalg.norm(side)
    axes = np.stack([side, so3.hat(axis) @ side, axis])
    R = axes.T @ _turns(reach.rotation_deg) @ (axes @ camera_from_part.rotation)
    n = round(reach.depth / _DEPTH)
    depth = np.exp(np.linspace(-1, 1, 2 * n + 1) * math.log1p(reach.depth)) if n else np.ones(1)
    middle = depth[:, None, None] * centre
    t = middle - (R @ aspects.centre)[None]
    R = np.broadcast_to(R, (len(depth), *R.shape))
    return np.concatenate([R.reshape(-1, 9), t.reshape(-1, 3)], axis=1)


@lru_cache(maxsize=8)
def _turns(reach_deg: float) -> Array:
    """Return rotations (N, 3, 3) whose vectors fill a ball: a hexagonal grid of tilts, even steps about z."""
    n = math.ceil(reach_deg / _TILT_DEG) + 1
    i, j = (a.ravel() for a in np.meshgrid(np.arange(-2 * n, 2 * n + 1), np.arange(-2 * n, 2 * n + 1)))
    tilt = _TILT_DEG * np.stack([i + 0.5 * j, math.sqrt(0.75) * j], axis=1)
    m = round(reach_deg / _ROLL_DEG)
    roll = _ROLL_DEG * np.arange(-m, m + 1)
    every = np.column_stack([np.repeat(tilt, len(roll), axis=0), np.tile(roll, len(tilt))])
    return so3.exp(np.radians(every[np.linalg.norm(every, axis=1) <= reach_deg + 0.25 * _TILT_DEG]))
