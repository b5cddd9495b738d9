"""Finding a part without any start: in every view, everywhere in the photo, at every distance that is declared.

1. For each distance, the aspects of the part at every roll are slid over a field so coarse that the part is some 30 px
   large; the best fits, wherever they are, become hypotheses.
2. The best climb on finer and finer fields; the evidence for each is judged edge by edge (`climb.evidence`).
3. Those that stand out are approached (`approach`) as from a user's rough start, and judged again.

In clutter there are lines near any line, so the evidence for a pose means little by itself. From the first climb on it
is compared with the evidence for the part displaced by about a fifth of its size to any side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.camera.camera import Camera
from cadcam.cores import on_cores
from cadcam.errors import NothingInView
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.direction_field import DirectionField
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.search.approach import Reach, approach
from cadcam.locate.search.climb import (
    Climb,
    FieldLevel,
    climbed,
    composed,
    distinct,
    edges_of,
    evidence,
    near,
    rigids_of,
    row_of,
    turned,
)
from cadcam.locate.search.hypothesis import Hypothesis
from cadcam.locate.search.quota import ONCE, Quota, places_of
from cadcam.locate.views.aspects import Aspects
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange
from cadcam.native.fields import PoseEdges

_SWEPT_PX = 33.0  # size of the part in the field that it is swept over
# Size of the part, px, in the fields in which evidence is judged, and tolerance of its lines, px. A fine field averages
# noise and separates lines, but there a right pose seems wrong that its climb left off by some hundredths of the size.
_FINELY, _ROUGHLY = (180.0, 0.8), (90.0, 2.0)
_SMALLEST, _LARGEST = 0.2, 1.2  # size of the part over the photo's shorter side, where no distance is declared
_SCALE, _ROLL_DEG = 1.2, 10.0  # steps of the sweep: ratio of distances, roll in the picture
_SWEPT = 42  # samples of an aspect that are swept
_PLACES = 2  # places in the photo that each view keeps of a sweep
_PLACE = 0.5  # radii: size of a place, where places share what is kept
_TAKEN = 1000  # hypotheses per distance that climb
_CLIMBS = (
    Climb(0, 64, (2.5, 1.5, 1.0, 1.0), 250),
    Climb(1, 96, (2.5, 1.5, 1.0, 1.0), 70),
    Climb(2, 128, (2.5, 1.5, 1.0, 1.0), 20),
)
_BESIDE = Climb(2, 64, (1.0,), 0)  # how displaced poses are judged: without climbing
_EVERY = 4  # in the sweep's climbs, by every so many-th of _ASIDE: 0.12 of its size to four sides
_APPROACHED, _NEIGHBOURS = (16, 8), 0.25  # poses approached by either judgement; radii between them
_NEAR = Reach(rotation_deg=12.0, shift_px=0.06, depth=0.12)  # of such approaches; shift_px by the part's size
# Displacements at which lines are compared, as shares of the part's size in the picture.
_ASIDE = np.array([[(0.12, 0.22)[k % 2] * f((k + 0.3) * math.pi / 8) for f in (np.cos, np.sin)] for k in range(16)])
_RETURNED = 20  # twice as many as are refined (`in_photos`): the others tell how much speaks for places elsewhere
_AMONG_EQUALS = np.array([0.6123, 0.3871, 0.6894])  # a direction in no symmetry plane: picks one of equivalent poses
_BASES = ((1, 1), (2, 6), (3, 6))  # fields are reduced by the first number times up to so many powers of two
_WIDEST_PX = 1100  # larger photos are reduced first
_NARROWEST_PX = 12  # fields are at least this large


def search(
    part: Part, photos: Sequence[Photo], views: ViewRange = WHOLE_SPHERE, *, quota: Quota = ONCE
) -> list[Hypothesis]:
    """Return poses (world_from_part) that the photos may show, from anywhere within `views`, best first.

    Accurate to about a pixel of the photo, for `refine_pose` to take up. score: log-likelihood ratio, in nats, of the
    part there and a little displaced, from the fine and the rough judgement together. Of the equivalent poses of a
    symmetric part only one is returned. quota: how many are kept; `MANY` for a part that may be there several times.
    The part's aspects are computed on first use, which takes some seconds once.
    """
    scales = _Scales(part.aspects, photos)
    looks = _rotations(part, views)
    rows = [
        _promising(scales, eye, distance, looks, quota)
        for eye, photo in enumerate(photos)
        for distance in _distances(part.aspects, photo.camera, views)
    ]
    eye = photos[0].camera_from_world.origin
    found = _of_one_side(part, eye, np.concatenate([np.zeros((0, 12)), *rows]))
    starts = _to_approach(scales, found, quota)
    around = _approached(part, photos, scales, rigids_of(found[starts]))
    found = _of_one_side(part, eye, np.array([row_of(h.world_from_part) for h in around]).reshape(-1, 12))
    around = [replace(h, world_from_part=T) for h, T in zip(around, rigids_of(found), strict=True)]
    finely, roughly = (_peaks(scales, found, *way) for way in (_FINELY, _ROUGHLY))
    return _ranked(part.aspects, around, found, finely + roughly, quota.of(_RETURNED))


def _of_one_side(part: Part, eye: Array, poses: Array) -> Array:
    """Return poses (N, 12), those of a part of revolution rotated about its axis to be seen most along _AMONG_EQUALS.

    Otherwise one pose would be approached and refined at many equivalent rotations.
    """
    if not part.spins.size:
        return poses
    R, t = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]
    seen = np.einsum("nji,nj->ni", R, eye - t)  # the eye (3,) in the part frame
    along = [(S.inv @ seen - part.aspects.centre) @ _AMONG_EQUALS for S in part.symmetries]
    turn = np.stack([S.rotation for S in part.symmetries])[np.argmax(along, axis=0)]
    shift = np.stack([S.translation for S in part.symmetries])[np.argmax(along, axis=0)]
    return np.concatenate([(R @ turn).reshape(-1, 9), (R @ shift[..., None])[..., 0] + t], axis=1)


def _to_approach(scales: _Scales, found: Array, quota: Quota) -> list[int]:
    """Return which of poses (N, 12) are approached: the best of all, and the best by rough judgement."""
    aspects = scales.aspects
    finely, roughly = (_peaks(scales, found, *way) for way in (_FINELY, _ROUGHLY))
    best = zip((finely + roughly, roughly), _APPROACHED, strict=True)
    every = [k for score, most in best for k in distinct(aspects, found, score, quota.of(most), within=_NEIGHBOURS)]
    first = distinct(aspects, found[every], -np.arange(len(every), dtype=np.float64), len(every), within=_NEIGHBOURS)
    return [every[k] for k in first]


def unmade(part: Part, cameras: Sequence[Camera], views: ViewRange = WHOLE_SPHERE) -> list[tuple[int, int]]:
    """Return the aspects that a search in their photos would have to compute first, as indices for `Aspects.aspect`."""
    aspects = part.aspects
    numbers = np.unique(_rotations(part, views)[0]).tolist()
    far = np.array([d for camera in cameras for d in _distances(aspects, camera, views)])
    steps = np.unique(aspects.step_of(far)).tolist()
    return [key for step in steps for key in ((number, step) for number in numbers) if key not in aspects.made]


def _ranked(aspects: Aspects, found: list[Hypothesis], poses: Array, score: Array, most: int) -> list[Hypothesis]:
    """Return each pose once, most evidence first; of poses close to each other the one that fits the fine field best.

    Evidence is bounded per edge, so it distinguishes places but not poses that are some pixels apart.
    """
    leaders = distinct(aspects, poses, score, most, within=_NEIGHBOURS)
    fit = np.array([h.score for h in found])
    best = [members[np.argmax(fit[members])] for members in (near(aspects, poses, k, _NEIGHBOURS) for k in leaders)]
    return [replace(found[k], score=float(score[j])) for k, j in zip(best, leaders, strict=True)]


class _Scales:
    """The fields of all photos at reductions 1, 2, 3, 4, 6, 8, 12 ..., and how large a part is in them."""

    def __init__(self, aspects: Aspects, photos: Sequence[Photo]) -> None:
        self.aspects = aspects
        self._fields = [_fields(photo) for photo in photos]
        self.places = tuple(photo.camera_from_world for photo in photos)
        self.focal = [math.sqrt(photo.camera.fx * photo.camera.fy) for photo in photos]

    def stage(self, reductions: Array) -> FieldLevel:
        """Return the field of each photo that is nearest to its given reduction (photos,)."""
        both = zip(self._fields, reductions, strict=True)
        fields = (min(own, key=lambda f: abs(math.log(f.reduction / k))) for own, k in both)
        return FieldLevel(tuple(fields), self.places)

    def chosen(self, eye: int, size: float) -> list[int]:
        """Return reductions at which a part of `size` px in one photo is about _SWEPT_PX large, then twice that ..."""
        known = [f.reduction for f in self._fields[eye]]
        chosen = [min(known, key=lambda k: abs(math.log(size / k / _SWEPT_PX)))]
        while chosen[-1] % 2 == 0 and chosen[-1] // 2 in known:
            chosen.append(chosen[-1] // 2)
        return chosen

    def swept(self, eye: int, reduction: int) -> DirectionField:
        """Return the field of one photo at one of its reductions."""
        return next(f for f in self._fields[eye] if f.reduction == reduction)

    def alike(self, eye: int, reduction: int, poses: Array) -> FieldLevel:
        """Return fields in which the part at poses (N, 12) is about as large as in one photo's reduced field."""
        sizes = self.sizes(poses)
        return self.stage(reduction * np.median(sizes / sizes[eye], axis=1))

    def beside(self, poses: Array, every: int = 1) -> list[Array]:
        """Return poses (N, 12) displaced by every `every`-th vector of _ASIDE in the photo where the part is largest.

        Poses behind all cameras, and displaced ones that no camera sees, are returned unchanged.
        """
        middle = self.middles(poses)
        depth = np.stack([(T @ middle)[:, 2] for T in self.places])
        eye = np.argmax(np.where(depth > 0, self.sizes(poses), 0.0), axis=0)
        out = [poses.copy() for _ in _ASIDE[::every]]
        for e, (T, fields) in enumerate(zip(self.places, self._fields, strict=True)):
            own = np.flatnonzero(eye == e)
            seen, camera = composed(T, poses[own]), fields[0].camera
            size = self.sizes(poses[own])[e] / fields[0].reduction
            for moved, aside in zip(out, _ASIDE[::every], strict=True):
                there = composed(T.inv, turned(self.aspects, camera, seen, size[:, None] * aside))
                seen_there = np.isfinite(there).all(axis=1)
                moved[own[seen_there]] = there[seen_there]
        return out

    def sizes(self, poses: Array) -> Array:
        """Return the size (photos, N) px of the part in each photo at poses (N, 12)."""
        middle = self.middles(poses)
        away = [np.linalg.norm(middle - T.origin, axis=1) for T in self.places]
        return np.stack([_size(self.aspects, f, d) for f, d in zip(self.focal, away, strict=True)])

    def middles(self, poses: Array) -> Array:
        """Return the part's centre (N, 3) at poses (N, 12)."""
        return np.asarray(poses[:, :9].reshape(-1, 3, 3) @ self.aspects.centre + poses[:, 9:])


def _fields(photo: Photo) -> list[DirectionField]:
    k = max(1, math.ceil(max(photo.camera.size) / _WIDEST_PX))
    every = [f for b, n in _BASES for f in photo.fields(reduction=b * k, levels=n)]
    return sorted((f for f in every if min(f.camera.size) >= _NARROWEST_PX), key=lambda f: f.reduction)


def _size(aspects: Aspects, focal: float, distance: Array) -> Array:
    """Return the size (px) of the part's sphere at distances (mm) of its centre."""
    r = aspects.radius
    return np.asarray(2 * focal * r / np.sqrt(np.maximum(distance**2 - r**2, (0.2 * r) ** 2)))


def _distances(aspects: Aspects, camera: Camera, views: ViewRange) -> list[float]:
    """Return the distances (mm) to try: a geometric series."""
    r, focal = aspects.radius, math.sqrt(camera.fx * camera.fy)
    side = min(camera.width * focal / camera.fx, camera.height * focal / camera.fy)  # px, were they square
    least, most = (math.hypot(r, 2 * focal * r / (share * side)) for share in (_LARGEST, _SMALLEST))
    near, far = (least, most) if views.distance_mm is None else views.distance_mm
    n = max(1, math.ceil(math.log(far / near) / math.log(_SCALE)))
    return [near * (far / near) ** ((k + 0.5) / n) for k in range(n)]


def _promising(scales: _Scales, eye: int, distance: float, looks: tuple[Longs, Array], quota: Quota) -> Array:
    """Return the poses (N, 12) of a sweep over one photo at one distance that survive on finer fields."""
    aspects = scales.aspects
    chosen = scales.chosen(eye, float(_size(aspects, scales.focal[eye], np.array(distance))))
    poses = _swept(aspects, scales.swept(eye, chosen[0]), scales.places[eye], distance, looks, quota)
    for climb in _CLIMBS:
        stage = scales.alike(eye, chosen[min(climb.level, len(chosen) - 1)], poses)
        poses, score = climbed(aspects, stage, poses, np.eye(6), climb)
        moved = scales.beside(poses, _EVERY)
        beside = climbed(aspects, stage, np.concatenate(moved), np.eye(6), _BESIDE)[1]
        score = score - beside.reshape(len(moved), len(poses)).max(axis=0)
        poses = poses[_kept(scales, eye, poses, score, climb.kept, quota)]
    return poses


def _kept(scales: _Scales, eye: int, poses: Array, score: Array, usual: int, quota: Quota) -> Longs:
    """Return which of poses (N, 12) at one distance of a photo are kept, where usually so many are."""
    aspects = scales.aspects
    if not quota.shared:
        return np.array(distinct(aspects, poses, score, quota.of(usual)), np.int64)
    every = np.array(distinct(aspects, poses, score, len(poses)), np.int64)
    middle = scales.places[eye] @ scales.middles(poses[every])
    place = places_of(middle, _PLACE * aspects.radius / float(np.median(middle[:, 2])))
    return every[quota.best(score[every], place, usual)]


def _swept(
    aspects: Aspects,
    field: DirectionField,
    camera_from_world: Rigid,
    distance: float,
    looks: tuple[Longs, Array],
    quota: Quota,
) -> Array:
    """Return the best poses (N, 12) at one distance, each where it fits one photo best."""
    numbers, R = looks
    seen = np.concatenate([R.reshape(-1, 9), np.array([0, 0, distance]) - R @ aspects.centre], axis=1)
    world = composed(camera_from_world.inv, seen)
    edges = _edges(aspects, FieldLevel((field,), (camera_from_world,)), numbers, distance)
    some = [slice(k, k + 2048) for k in range(0, len(world), 2048)]
    done = on_cores(lambda s: edges.part(s).sweep(0, world[s], keep=quota.of(_PLACES), apart=2), some)
    shift, score = (np.concatenate([d[k] for d in done]) for k in range(2))
    every = shift.reshape(-1, 2)
    place = (every // (_PLACE * _SWEPT_PX / 2)).astype(np.int64) @ np.array([1, 1 << 20])  # one number for each cell
    best = quota.best(score.ravel(), place, _TAKEN)
    to = every[best] - field.camera.principal_point
    moved = turned(aspects, field.camera, seen[best // quota.of(_PLACES)], to)
    return composed(camera_from_world.inv, moved)


def _edges(aspects: Aspects, stage: FieldLevel, numbers: Longs, distance: float) -> PoseEdges:
    """Return the edges to slide: of the net's directions `numbers` (N,) at a distance."""
    step = int(aspects.step_of(np.array([distance]))[0])
    used, which = np.unique(numbers, return_inverse=True)
    aspects.make((int(k), step) for k in used)
    return edges_of(stage, [aspects.aspect(int(k), step).places for k in used], which.reshape(-1, 1), _SWEPT)


def _rotations(part: Part, views: ViewRange) -> tuple[Longs, Array]:
    """Return net directions (N,) and rotations camera_from_part (N, 3, 3) looking along them, at every roll.

    Of directions from which a symmetric part looks the same, only the one nearest to _AMONG_EQUALS is returned.
    """
    net = part.aspects.net
    equal = np.stack([net @ S.rotation.T @ _AMONG_EQUALS for S in part.symmetries])
    chosen = np.flatnonzero(views.allows(net) & (equal[0] >= equal.max(axis=0) - 1e-9))
    if not len(chosen):
        chosen = np.array([np.argmax(net @ views.axis)])
    z = -net[chosen]
    up = views.up - (z @ views.up)[:, None] * z
    lying = np.linalg.norm(up, axis=1) < 1e-6
    aside = np.eye(3)[np.argmin(np.abs(z), axis=1)]
    up = np.where(lying[:, None], aside - (aside * z).sum(axis=1, keepdims=True) * z, up)
    y = -up / np.linalg.norm(up, axis=1, keepdims=True)
    upright = np.stack([np.cross(y, z), y, z], axis=1)
    n = max(1, round(2 * views.roll_deg / _ROLL_DEG))
    roll = np.radians(views.roll_deg * ((2 * np.arange(n) + 1) / n - 1))
    turn = so3.exp(np.stack([0 * roll, 0 * roll, roll], axis=1))
    return np.repeat(chosen, n), (turn[None] @ upright[:, None]).reshape(-1, 3, 3)


def _judged(scales: _Scales, poses: Array, size_px: float, blur: float) -> Array:
    """Return the evidence (N,) for poses (N, 12), each judged where the part is about size_px large in each photo."""
    if not len(poses):
        return np.zeros(0)
    wanted = np.rint(2 * np.log2(np.maximum(scales.sizes(poses) / size_px, 1.0)))
    out, (steps, which) = np.zeros(len(poses)), np.unique(wanted, axis=1, return_inverse=True)
    for k, step in enumerate(steps.T):
        own = which.ravel() == k
        out[own] = evidence(scales.aspects, scales.stage(2 ** (step / 2)), poses[own], blur)
    return out


def _peaks(scales: _Scales, poses: Array, size_px: float, blur: float) -> Array:
    """Return the evidence (N,) for poses (N, 12) minus the largest evidence for the part displaced a little.

    Where the lines are the part's own, a displaced part has less evidence.
    """
    every = [poses, *scales.beside(poses)]
    here, *beside = _judged(scales, np.concatenate(every), size_px, blur).reshape(len(every), len(poses))
    return np.asarray(here - np.maximum.reduce(beside))


def _approached(part: Part, photos: Sequence[Photo], scales: _Scales, starts: list[Rigid]) -> list[Hypothesis]:
    """Return the hypotheses found around each of the starts."""

    def around(start: Rigid) -> list[Hypothesis]:
        size = float(scales.sizes(row_of(start)[None]).min())
        try:
            return approach(part, photos, start, reach=replace(_NEAR, shift_px=_NEAR.shift_px * size))[:3]
        except NothingInView:
            return []

    return [h for some in on_cores(around, starts) for h in some]
