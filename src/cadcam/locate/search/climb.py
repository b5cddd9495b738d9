"""Poses of a part climbing on direction fields: what `approach` and `search` have in common.

Inside this module poses are rows of 12 numbers: the rotation's rows, then the translation (mm).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Longs
from cadcam.camera.camera import Camera
from cadcam.cores import on_cores
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.direction_field import DirectionField
from cadcam.locate.views.aspects import Aspect, Views
from cadcam.locate.views.pieces import PLACES
from cadcam.native.fields import PLACE, Belief, Eye, PoseEdges, firsts

_SAME = 0.02  # radii: poses whose corners differ by less are merged
_TOGETHER = 64  # poses that climb in one batch
# even: certainty that is no evidence; nats per sample; most: of one edge; seen: share of edges that lighting shows.
_BELIEF = Belief(even=0.15, nats=4.0, most=4.0, seen=0.9)
_APART_PX = 3.0  # px: distance between independent samples
_HELD = 0.01  # share of the pull that holds motions along lines, from a pose known roughly
_STEPS = 64  # more than the number of distances of aspects


class Climb(NamedTuple):
    """One climb: field level, samples of an aspect, successive blurs (px), and how many poses are kept.

    near: whether poses are known roughly, so that motions which few lines tell are small, and samples lie where they
    tell the pose best; otherwise these lie evenly.
    """

    level: int
    samples: int
    blur: tuple[float, ...]
    kept: int
    near: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FieldLevel:
    """The direction fields of all photos at one level, and the poses of their cameras."""

    fields: tuple[DirectionField, ...]
    cameras_from_world: tuple[Rigid, ...]

    @property
    def eyes(self) -> list[Eye]:
        """Return them in the form that the C core takes."""
        pairs = zip(self.fields, self.cameras_from_world, strict=True)
        return [Eye(f.planes, f.camera.K, T.rotation, T.translation) for f, T in pairs]


def turned(aspects: Views, camera: Camera, seen: Array, shift: Array) -> Array:
    """Return camera_from_part (N, 12) of cameras rotated so that the part's centre moves by shift (N, 2) px."""
    R, t = seen[:, :9].reshape(-1, 3, 3), seen[:, 9:]
    q = camera.project(R @ aspects.centre + t)
    one, other = camera.unproject(q), camera.unproject(q + shift)
    axis = (so3.hat(one) @ other[..., None])[..., 0]
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    turn = so3.exp(axis * (np.arcsin(np.minimum(sine, 1.0)) / np.maximum(sine, 1e-300)))
    return np.concatenate([(turn @ R).reshape(-1, 9), np.einsum("nij,nj->ni", turn, t)], axis=1)


def composed(a: Rigid, poses: Array) -> Array:
    """Return a @ pose for each of poses (N, 12)."""
    R = a.rotation @ poses[:, :9].reshape(-1, 3, 3)
    return np.concatenate([R.reshape(-1, 9), poses[:, 9:] @ a.rotation.T + a.translation], axis=1)


def pose_edges(aspects: Views, stage: FieldLevel, poses: Array, samples: int, *, telling: bool) -> PoseEdges:
    """Return what the cameras of a level see of poses (N, 12) world_from_part: the first samples of their aspects.

    telling: whether of those that lie where they tell the pose best.
    """
    shown, which = _shown(aspects, stage, poses)
    return edges_of(stage, [a.telling if telling else a.places for a in shown], which, samples)


def edges_of(stage: FieldLevel, shown: Sequence[npt.NDArray[np.void]], which: Longs, samples: int) -> PoseEdges:
    """Return the edges of poses, given the samples per camera (N, eyes) of each pose's aspect: the first of them."""
    runs = [places[:samples] for places in shown]
    count = np.array([len(run) for run in runs], np.int32)
    first = np.cumsum(count) - count
    places = np.concatenate([np.zeros(0, np.float32), *(run.view(np.float32) for run in runs)]).view(PLACE)
    return PoseEdges(stage.eyes, places, first[which], count[which])


def _shown(aspects: Views, stage: FieldLevel, poses: Array) -> tuple[list[Aspect], Longs]:
    """Return aspects, and the index of the one that each camera sees of each pose: (N, eyes)."""
    R, t = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]
    eyes = np.stack([T.origin for T in stage.cameras_from_world]) - t[:, None]
    axes = np.broadcast_to([T.rotation[2] for T in stage.cameras_from_world], eyes.shape)
    in_part = (np.einsum("nji,nej->nei", R, of_world).reshape(-1, 3) for of_world in (eyes, axes))
    net, step = aspects.nearest(*in_part)
    numbers, which = np.unique(net * _STEPS + step, return_inverse=True)
    keys = [divmod(number, _STEPS) for number in numbers.tolist()]
    aspects.make(keys)
    return [aspects.made[key] for key in keys], which.reshape(len(poses), len(stage.fields))


def climbed(aspects: Views, stage: FieldLevel, poses: Array, freedom: Array, climb: Climb) -> tuple[Array, Array]:
    """Return poses (N, 12) after climbing at one level, and their scores (N,)."""
    edges, held = pose_edges(aspects, stage, poses, climb.samples, telling=climb.near), _HELD if climb.near else 0.0
    done = on_cores(lambda s: edges.part(s).climb(poses[s], freedom, climb.blur, held=held), _slices(len(poses)))
    poses, raw = (np.concatenate([d[k] for d in done]) for k in range(2))
    total = raw.sum(axis=1)
    return poses, (total[:, 0] - total[:, 1]) / np.sqrt(np.maximum(total[:, 2], 1e-9))


def evidence(aspects: Views, stage: FieldLevel, poses: Array, blur: float) -> Array:
    """Return the log-likelihood ratio (N,), in nats, of the photos with the part at each pose and without it.

    Pictures are full of straight lines: that one of them runs along an edge by chance does not become less likely as
    both get longer. So each edge is judged as one event: it is visible with some probability, and then lines run along
    most of it. Its evidence for a pose is bounded, as is that against it where no line is found.
    """
    shown, which = _shown(aspects, stage, poses)
    edges = edges_of(stage, [aspect.places for aspect in shown], which, PLACES)
    line = np.concatenate([np.zeros(0, np.int32), *(aspect.line for aspect in shown)])
    apart = np.array([aspect.length / max(len(aspect.places), 1) for aspect in shown])
    total = np.zeros(len(poses))
    for e, (field, camera_from_world) in enumerate(zip(stage.fields, stage.cameras_from_world, strict=True)):
        seen = composed(camera_from_world, poses)
        distance = np.linalg.norm(seen[:, :9].reshape(-1, 3, 3) @ aspects.centre + seen[:, 9:], axis=1)
        size = 2 * aspects.radius / distance * field.camera.fx
        total += _in_eye(edges, e, poses, blur, line, np.minimum(apart[which[:, e]] * size / _APART_PX, 1.0))
    return total


def _in_eye(edges: PoseEdges, eye: int, poses: Array, blur: float, line: Ids, share: Array) -> Array:
    """Return one camera's term of `evidence` (N,), nats; share (N,): weight of its samples by their independence."""

    def of(some: slice) -> Array:
        return edges.part(some).evidence(eye, poses[some], blur, line, share[some], _BELIEF)

    return np.concatenate(on_cores(of, _slices(len(poses))))


def _slices(n: int) -> list[slice]:
    """Return the batches that threads share out."""
    return [slice(k, k + _TOGETHER) for k in range(0, max(n, 1), _TOGETHER)]


def distinct(aspects: Views, poses: Array, score: Array, most: int, within: float = _SAME) -> list[int]:
    """Return at most `most` of the best poses, best first, no two within `within` radii of each other."""
    order = np.argsort(-score, kind="stable")
    kept = firsts(_corners(aspects, poses[order]), most, within * aspects.radius)
    return [int(k) for k in order[kept]]


def near(aspects: Views, poses: Array, one: int, within: float) -> Longs:
    """Return which poses (N, 12) are within so many radii of one of them, itself included."""
    corners = _corners(aspects, poses)
    away = corners - corners[one]
    return np.flatnonzero(np.einsum("nij,nij->ni", away, away).max(axis=1) <= (within * aspects.radius) ** 2)


def _corners(aspects: Views, poses: Array) -> Array:
    """Return where four points of the part's sphere lie at each pose: (N, 4, 3) mm."""
    points = aspects.centre + aspects.radius * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    return points @ np.swapaxes(poses[:, :9].reshape(-1, 3, 3), 1, 2) + poses[:, None, 9:]


def row_of(pose: Rigid) -> Array:
    """Return a pose as a row (12,)."""
    return np.concatenate([pose.rotation.ravel(), pose.translation])


def rigids_of(rows: Array) -> list[Rigid]:
    """Return the poses of rows (N, 12)."""
    return Rigid(so3.nearest(rows[:, :9].reshape(-1, 3, 3)), rows[:, 9:]).each
