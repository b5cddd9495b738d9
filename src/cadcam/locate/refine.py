"""The pose of a part to the limit of the pixels: visible CAD edges against the photo's own.

Search: samples on the visible lines look along their normals for steps of brightness, several each; every step attracts
the line, the nearer the more (a soft assignment over a shrinking distance), and all lines move as one rigid part. So
twin edges of a plate are told apart by all the others.

Measurement: each sample's step is fitted to the pixels (`image.profile`), and the pose solved for by a regression that
knows that edges err as a whole (`fit.grouped`): a chamfer, a shadow or paint shifts all samples of an edge together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.camera.sensitivity import project_with_sensitivity
from cadcam.errors import BadValue
from cadcam.fit.grouped import GroupedFit, grouped_fit
from cadcam.geometry.rigid import Rigid
from cadcam.locate.edges import Projected
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import Location
from cadcam.locate.matches import EdgeMatches
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.sight import Measured, Sight, measure


@dataclass(frozen=True, slots=True)
class EdgeOptions:
    """How edges are looked for.

    search_px: how far from the start's lines the photo's may lie. step_px: length of the cell that a sample stands for.
    reach_px: how far to each side of a line its pixels are used; room_px: the least of that, nearer to another line a
    sample is left out. group_px: length of edge that is taken to err as one.
    """

    search_px: float = 8.0
    step_px: float = 4.0
    reach_px: float = 7.0
    room_px: float = 2.5
    group_px: float = 120.0


EDGES = EdgeOptions()


def refine(
    part: Part, photos: Sequence[Photo], start: Rigid, *, freedom: Freedom = FREE, options: EdgeOptions = EDGES
) -> Location:
    """Return where the part stands, from world_from_part `start` that is off by no more than `search_px` in the photos."""
    if not photos:
        raise BadValue("photos", "none", "at least one photo")
    pose = start
    sights = _sights(part, photos, pose, options)
    for reach, soft in _schedule(options.search_px):
        pose = _attracted(sights, pose, freedom, reach=reach, soft=soft, options=options)
    sights = _sights(part, photos, pose, options, sights)
    for farthest in (2.0, 1.0, 1.0):
        fit, measured, places = _fitted(sights, pose, freedom, options, farthest)
        pose = pose @ Rigid.exp(freedom.at(pose) @ fit.x)
    return _location(sights, pose, freedom, fit, measured, places)


def _sights(
    part: Part, photos: Sequence[Photo], pose: Rigid, options: EdgeOptions, before: Sequence[Sight] = ()
) -> list[Sight]:
    noise = [s.noise for s in before] or [None] * len(photos)
    reach = 2 * options.reach_px
    return [
        Sight.of(part, photo, pose, step_px=options.step_px, reach_px=reach, noise=n)
        for photo, n in zip(photos, noise, strict=True)
    ]


def _schedule(search_px: float) -> list[tuple[int, float]]:
    """Return (reach px, softness px) of each round of the search, the last one at the width of an edge."""
    rounds, reach = [], search_px
    while reach > 1.5:
        rounds.append((int(np.ceil(reach)) + 1, 0.4 * reach))
        reach *= 0.55
    return [*rounds, (3, 0.7)]


def _attracted(
    sights: Sequence[Sight], pose: Rigid, freedom: Freedom, *, reach: int, soft: float, options: EdgeOptions
) -> Rigid:
    """Return the pose after one round of search."""
    B = freedom.at(pose)
    rows, offset, strength = [], [], []
    for sight in sights:
        at = sight.project(pose)
        found = sight.candidates(at, reach=reach, half_length=0.5 * options.step_px)
        seen = np.isfinite(found.offset[:, 0])
        rows.append(at.row[seen] @ B)
        offset.append(found.offset[seen])
        strength.append(np.nan_to_num(np.abs(found.slope[seen])))
    J, o, a = np.concatenate(rows), np.nan_to_num(np.concatenate(offset)), np.concatenate(strength)
    if len(J) < 2 * J.shape[1]:
        return pose
    a = np.minimum(a / np.quantile(a[:, 0], 0.75), 1.0)
    x = np.zeros(J.shape[1])
    for _ in range(6):
        r = o - (J @ x)[:, None]
        near = a * np.exp(-0.5 * (r / soft) ** 2)
        share = near / (near.sum(axis=1, keepdims=True) + 0.05)
        w = share.sum(axis=1)
        A = (J * w[:, None]).T @ J
        A[np.diag_indices(len(x))] *= 1.001
        x = x + np.linalg.solve(A, J.T @ (share * r).sum(axis=1))
    return pose @ Rigid.exp(B @ x)


def _fitted(
    sights: Sequence[Sight], pose: Rigid, freedom: Freedom, options: EdgeOptions, farthest: float
) -> tuple[GroupedFit, list[Measured], list[Projected]]:
    places = [s.project(pose) for s in sights]
    measured = []
    for s, at in zip(sights, places, strict=True):
        blur = s.blur(at, half_length=0.5 * options.step_px, reach_px=options.reach_px)
        measured.append(
            measure(
                s,
                at,
                half_length=0.5 * options.step_px,
                reach_px=options.reach_px,
                room_px=options.room_px,
                blur=blur,
                farthest=farthest,
            )
        )
    B = freedom.at(pose)
    use = [m.usable for m in measured]
    y = np.concatenate([m.offset[u] for m, u in zip(measured, use, strict=True)])
    v = np.concatenate([m.sigma[u] ** 2 for m, u in zip(measured, use, strict=True)])
    J = np.concatenate([at.row[u] @ B for at, u in zip(places, use, strict=True)])
    group = _groups(sights, use, options)
    return grouped_fit(y, J, v, group), measured, places


def _groups(sights: Sequence[Sight], use: Sequence[Array], options: EdgeOptions) -> Array:
    """Return the number of the piece of edge that each usable sample lies on."""
    most = max(int(options.group_px / options.step_px), 1)
    keys, before = [], 0
    for sight, usable in zip(sights, use, strict=True):
        run = sight.samples.run
        count = np.bincount(run)
        place = np.arange(len(run)) - (np.cumsum(count) - count)[run]
        pieces = np.maximum(np.round(count / most), 1)
        key = run * 1000 + np.minimum(place * pieces[run] / np.maximum(count[run], 1), 999).astype(np.int64)
        keys.append(before + key[usable])
        before += (int(run.max(initial=-1)) + 1) * 1000
    return np.unique(np.concatenate(keys), return_inverse=True)[1]


def _location(
    sights: Sequence[Sight],
    pose: Rigid,
    freedom: Freedom,
    fit: GroupedFit,
    measured: Sequence[Measured],
    places: Sequence[Projected],
) -> Location:
    B = freedom.at(pose)
    estimate = PoseEstimate(pose, B @ fit.covariance @ B.T, np.zeros((6, 6)), B, fit.dof)
    weight = [np.zeros(len(m.offset)) for m in measured]
    done = 0
    for w, m in zip(weight, measured, strict=True):
        n = int(m.usable.sum())
        w[m.usable] = fit.weight[done : done + n]
        done += n
    matches = EdgeMatches(
        np.concatenate([p.q for p in places]),
        np.concatenate([p.normal for p in places]),
        np.concatenate([np.where(m.usable, m.offset, np.nan) for m in measured]),
        np.concatenate([np.where(m.usable, m.sigma, np.nan) for m in measured]),
        np.concatenate(weight),
        np.concatenate([s.samples.p for s in sights]),
        np.concatenate([s.samples.chain for s in sights]),
        np.repeat(np.arange(len(sights)), [len(s.samples) for s in sights]),
    )
    return Location(estimate, matches, float(np.concatenate(weight).mean()), "")
