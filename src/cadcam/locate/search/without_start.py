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
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Ids, Longs
from cadcam.camera.camera import Camera
from cadcam.cores import on_cores
from cadcam.errors import NothingInView
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.direction_field import DirectionField
from cadcam.locate.freedom import FREE
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
from cadcam.locate.search.lying import Lying
from cadcam.locate.search.on_plane import lying_poses
from cadcam.locate.search.quota import ONCE, Quota, places_of
from cadcam.locate.search.scales import SWEPT_PX, Scales, size_px
from cadcam.locate.views.aspects import Aspects
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange
from cadcam.native.fields import PoseEdges

# Size of the part, px, in the fields in which evidence is judged, and tolerance of its lines, px. A fine field averages
# noise and separates lines, but there a right pose seems wrong that its climb left off by some hundredths of the size.
_FINELY, _ROUGHLY = (180.0, 0.8), (90.0, 2.0)
_SMALLEST, _LARGEST = 0.2, 1.2  # size of the part over the photo's shorter side, where no distance is declared
_SCALE, _ROLL_DEG = 1.2, 10.0  # steps of the sweep: ratio of distances, roll in the picture
_SWEPT = 42  # samples of an aspect that are swept
_PLACES = 2  # places in the photo that each view keeps of a sweep
_PLACE = 0.5  # radii: size of a place, where places share what is kept
_TAKEN, _TAKEN_LYING = 1000, 400  # hypotheses per distance that climb; of parts on a plane, per size in the photo
_CLIMBS = (
    Climb(0, 64, (2.5, 1.5, 1.0, 1.0), 250),
    Climb(1, 96, (2.5, 1.5, 1.0, 1.0), 70),
    Climb(2, 128, (2.5, 1.5, 1.0, 1.0), 20),
)
_BESIDE = Climb(2, 64, (1.0,), 0)  # how displaced poses are judged: without climbing
_EVERY = 4  # in the sweep's climbs, by every so many-th of _ASIDE: 0.12 of its size to four sides
_APPROACHED, _NEIGHBOURS = (16, 8), 0.25  # poses approached by either judgement; radii between them
_NEAR = Reach(rotation_deg=12.0, shift_px=0.06, depth=0.12)  # of such approaches; shift_px by the part's size
_RETURNED = 20  # twice as many as are refined (`in_photos`): the others tell how much speaks for places elsewhere
_AMONG_EQUALS = np.array([0.6123, 0.3871, 0.6894])  # a direction in no symmetry plane: picks one of equivalent poses


def search(
    part: Part, photos: Sequence[Photo], views: ViewRange = WHOLE_SPHERE, *, quota: Quota = ONCE
) -> list[Hypothesis]:
    """Return poses (world_from_part) that the photos may show, from anywhere within `views`, best first.

    Accurate to about a pixel of the photo, for `refine_pose` to take up. score: log-likelihood ratio, in nats, of the
    part there and a little displaced, from the fine and the rough judgement together. Of the equivalent poses of a
    symmetric part only one is returned. quota: how many are kept; `MANY` for a part that may be there several times.
    The part's aspects are computed on first use, which takes some seconds once.
    """
    scales = Scales(part.aspects, photos)
    lying = Lying.of(part, photos, views)
    begun = _everywhere(part, photos, scales, views, quota) if lying is None else _laid(lying, scales, views, quota)
    rows = [_promising(scales, eye, chosen, poses, quota, lying) for eye, chosen, poses in begun]
    eye = photos[0].camera_from_world.origin
    found = _of_one_side(part, eye, np.concatenate([np.zeros((0, 12)), *rows]))
    starts = _to_approach(scales, found, quota)
    around = _approached(part, photos, scales, rigids_of(found[starts]), lying)
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


def _to_approach(scales: Scales, found: Array, quota: Quota) -> list[int]:
    """Return which of poses (N, 12) are approached: the best of all, and the best by rough judgement."""
    aspects = scales.aspects
    finely, roughly = (_peaks(scales, found, *way) for way in (_FINELY, _ROUGHLY))
    best = zip((finely + roughly, roughly), _APPROACHED, strict=True)
    every = [k for score, most in best for k in distinct(aspects, found, score, quota.of(most), within=_NEIGHBOURS)]
    first = distinct(aspects, found[every], -np.arange(len(every), dtype=np.float64), len(every), within=_NEIGHBOURS)
    return [every[k] for k in first]


def unmade(part: Part, cameras: Sequence[Camera], views: ViewRange = WHOLE_SPHERE) -> list[tuple[int, int]]:
    """Return the aspects that a search in their photos would have to compute first, as indices for `Aspects.aspect`."""
    if views.on is not None:  # those that show the part lying are few, and depend on the cameras' places
        return []
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


def _distances(aspects: Aspects, camera: Camera, views: ViewRange) -> list[float]:
    """Return the distances (mm) to try: a geometric series."""
    r, focal = aspects.radius, math.sqrt(camera.fx * camera.fy)
    side = min(camera.width * focal / camera.fx, camera.height * focal / camera.fy)  # px, were they square
    least, most = (math.hypot(r, 2 * focal * r / (share * side)) for share in (_LARGEST, _SMALLEST))
    near, far = (least, most) if views.distance_mm is None else views.distance_mm
    n = max(1, math.ceil(math.log(far / near) / math.log(_SCALE)))
    return [near * (far / near) ** ((k + 0.5) / n) for k in range(n)]


def too_near_to_search(part: Part, views: ViewRange) -> str:
    """Return that views are declared so near that the part is not in view as a whole, as it is searched for; or ""."""
    if views.distance_mm is None or not part.aspects.hold(part.aspects.centre + views.distance_mm[1] * np.eye(3)[0]):
        return ""
    large = f"the part, {2 * part.aspects.radius:.4g} mm large,"
    return f"up to {views.distance_mm[1]:.4g} mm from the middle of {large} pieces are in view, not all: give a start"


def _everywhere(
    part: Part, photos: Sequence[Photo], scales: Scales, views: ViewRange, quota: Quota
) -> Iterator[tuple[int, list[int], Array]]:
    """Yield photos, reductions at which to climb, and the poses (N, 12) of a sweep at each distance."""
    looks = _rotations(part, views)
    for eye, photo in enumerate(photos):
        for distance in _distances(part.aspects, photo.camera, views):
            chosen = scales.chosen(eye, float(size_px(scales.aspects, scales.focal[eye], np.array(distance))))
            field = scales.swept(eye, chosen[0])
            yield eye, chosen, _swept(scales.aspects, field, scales.places[eye], distance, looks, quota)


def _laid(lying: Lying, scales: Scales, views: ViewRange, quota: Quota) -> Iterator[tuple[int, list[int], Array]]:
    """Yield the same of poses that lie on a plane."""
    for eye in range(len(scales.places)):
        for chosen, poses, score, at in lying_poses(scales, eye, lying, views, quota.of(_PLACES)):
            yield eye, chosen, poses[quota.best(score, _cells(at), _TAKEN_LYING)]


def _promising(
    scales: Scales, eye: int, chosen: Sequence[int], poses: Array, quota: Quota, lying: Lying | None
) -> Array:
    """Return those of poses (N, 12) found in one photo that survive on finer fields, of these reductions."""
    aspects = scales.aspects
    for climb in _CLIMBS:
        stage = scales.alike(eye, chosen[min(climb.level, len(chosen) - 1)], poses)
        if lying is None:
            poses, score = climbed(aspects, stage, poses, np.eye(6), climb)
        else:
            poses, score = lying.climbed(stage, poses, climb)
        moved = scales.beside(poses, _EVERY)
        beside = climbed(aspects, stage, np.concatenate(moved), np.eye(6), _BESIDE)[1]
        score = score - beside.reshape(len(moved), len(poses)).max(axis=0)
        poses = poses[_kept(scales, eye, poses, score, climb.kept, quota)]
    return poses


def _kept(scales: Scales, eye: int, poses: Array, score: Array, usual: int, quota: Quota) -> Longs:
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
    best = quota.best(score.ravel(), _cells(every), _TAKEN)
    to = every[best] - field.camera.principal_point
    moved = turned(aspects, field.camera, seen[best // quota.of(_PLACES)], to)
    return composed(camera_from_world.inv, moved)


def _cells(q: Array | Ids) -> Longs:
    """Return a number (N,) for each of places (N, 2) px in a swept field, the same for those in one cell of it."""
    return np.asarray((q // (_PLACE * SWEPT_PX / 2)).astype(np.int64) @ np.array([1, 1 << 20]))


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


def _judged(scales: Scales, poses: Array, size_px: float, blur: float) -> Array:
    """Return the evidence (N,) for poses (N, 12), each judged where the part is about size_px large in each photo."""
    if not len(poses):
        return np.zeros(0)
    wanted = np.rint(2 * np.log2(np.maximum(scales.sizes(poses) / size_px, 1.0)))
    out, (steps, which) = np.zeros(len(poses)), np.unique(wanted, axis=1, return_inverse=True)
    for k, step in enumerate(steps.T):
        own = which.ravel() == k
        out[own] = evidence(scales.aspects, scales.stage(2 ** (step / 2)), poses[own], blur)
    return out


def _peaks(scales: Scales, poses: Array, size_px: float, blur: float) -> Array:
    """Return the evidence (N,) for poses (N, 12) minus the largest evidence for the part displaced a little.

    Where the lines are the part's own, a displaced part has less evidence.
    """
    every = [poses, *scales.beside(poses)]
    here, *beside = _judged(scales, np.concatenate(every), size_px, blur).reshape(len(every), len(poses))
    return np.asarray(here - np.maximum.reduce(beside))


def _approached(
    part: Part, photos: Sequence[Photo], scales: Scales, starts: list[Rigid], lying: Lying | None
) -> list[Hypothesis]:
    """Return the hypotheses found around each of the starts."""
    reach, freedom = (_NEAR, FREE) if lying is None else (replace(_NEAR, depth=0.0), lying.freedom)

    def around(start: Rigid) -> list[Hypothesis]:
        within = replace(reach, shift_px=reach.shift_px * float(scales.sizes(row_of(start)[None]).min()))
        try:
            return approach(part, photos, start, reach=within, freedom=freedom)[:3]
        except NothingInView:
            return []

    return [h for some in on_cores(around, starts) for h in some]
