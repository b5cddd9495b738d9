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
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue
from cadcam.fit.grouped import GroupedFit, grouped_fit
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import candidates
from cadcam.locate.edges import Projected
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import Location
from cadcam.locate.matches import EdgeMatches
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.sight import Cells, Measured, Sight, measure, nearest_steps

Longs = npt.NDArray[np.int64]
_SEARCHED = 600  # samples that search for their edges, of all photos together
_NOTHING = 0.3  # a strong edge this far down its bell pulls as much as not
_PULLS = 5  # Gauss-Newton steps on one set of candidates
_CLOSE = 3  # px: how far from the lines their steps may be after the search
_ON_LINE = 0.7  # px: steps this near are fitted on the line itself
_USUAL_PX = 0.05  # by which edges are off as a whole
_REDRAW_PX = 1.5  # lines that moved this far may hide otherwise


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
    pose, sights = start, _sights(part, photos, start, options)
    few = [s.thinned(_SEARCHED // len(photos)) for s in sights]
    for reach, soft in _schedule(options.search_px):
        pose = _attracted(few, pose, freedom, reach=reach, soft=soft, options=options)
    if max(s.moved_px(pose) for s in sights) > _REDRAW_PX:
        sights = _sights(part, photos, pose, options, sights)
    cells: list[Cells] = []
    where: list[Array] = []
    for iterations in (6, 12):
        places = [s.project(pose) for s in sights]
        cells = cells or [_cells(s, at, options) for s, at in zip(sights, places, strict=True)]
        where = where or [
            nearest_steps(s, at, half_length=0.5 * options.step_px, reach=_CLOSE) for s, at in zip(sights, places, strict=True)
        ]
        measured = [measure(*all_of) for all_of in zip(sights, places, cells, where, strict=True)]
        B = freedom.at(pose)
        fit = _fitted(sights, places, measured, B, options, iterations)
        pose = pose @ Rigid.exp(B @ fit.x)
        where = [_places(m, at.row @ (B @ fit.x)) for m, at in zip(measured, places, strict=True)]
    return _location(sights, pose, freedom, fit, measured, places)


def _sights(
    part: Part, photos: Sequence[Photo], pose: Rigid, options: EdgeOptions, before: Sequence[Sight] = ()
) -> list[Sight]:
    noise = [s.noise for s in before] or [np.nan] * len(photos)
    return [
        Sight.of(part, photo, pose, step_px=options.step_px, reach_px=2 * options.reach_px, noise=n)
        for photo, n in zip(photos, noise, strict=True)
    ]


def _cells(sight: Sight, at: Projected, options: EdgeOptions) -> Cells:
    return Cells.of(
        sight, at, half_length=0.5 * options.step_px, reach_px=options.reach_px, room_px=options.room_px
    )


def _places(measured: Measured, moved: Array) -> Array:
    """Return where to fit the steps after the lines moved: on the lines, but for edges that stay away from them."""
    left = np.nan_to_num(measured.offset) - moved
    return np.where(np.abs(left) < _ON_LINE, 0.0, left) * measured.usable


def _schedule(search_px: float) -> list[tuple[int, float]]:
    """Return (reach px, softness px) of each round of the search, the last one at the width of an edge."""
    rounds, far = [], search_px
    while far > 1.5:
        rounds.append((int(np.ceil(1.5 * far)) + 1, 0.6 * far))
        far *= 0.59
    return [*rounds, (3, 0.7)]


def _attracted(
    sights: Sequence[Sight], pose: Rigid, freedom: Freedom, *, reach: int, soft: float, options: EdgeOptions
) -> Rigid:
    """Return the pose after one round of search."""
    B = freedom.at(pose)
    rows, offset, strength = [], [], []
    for sight in sights:
        at = sight.project(pose)
        half_length = 0.5 * options.step_px
        found = candidates(
            sight.photo.gray, at.q, at.normal, half_length=half_length, reach=reach, noise=sight.noise
        )
        seen = np.isfinite(found.offset[:, 0])
        rows.append(at.row[seen] @ B)
        offset.append(found.offset[seen])
        strength.append(np.nan_to_num(np.abs(found.slope[seen])))
    J, o, a = np.concatenate(rows), np.nan_to_num(np.concatenate(offset)), np.concatenate(strength)
    if len(J) < 2 * J.shape[1]:
        return pose
    a = np.minimum(a / np.quantile(a[:, 0], 0.75), 1.0)
    x = np.zeros(J.shape[1])
    for _ in range(_PULLS):
        r = o - (J @ x)[:, None]
        near = a * np.exp(-0.5 * (r / soft) ** 2)
        share = near / (near.sum(axis=1, keepdims=True) + _NOTHING)
        w = share.sum(axis=1)
        A = (J * w[:, None]).T @ J
        A[np.diag_indices(len(x))] *= 1.001
        x = x + np.linalg.solve(A, J.T @ (share * r).sum(axis=1))
    return pose @ Rigid.exp(B @ x)


def _fitted(
    sights: Sequence[Sight],
    places: Sequence[Projected],
    measured: Sequence[Measured],
    B: Array,
    options: EdgeOptions,
    iterations: int,
) -> GroupedFit:
    y = np.concatenate([m.offset[m.usable] for m in measured])
    variance = np.concatenate([m.sigma[m.usable] ** 2 for m in measured])
    J = np.concatenate([at.row[m.usable] for at, m in zip(places, measured, strict=True)]) @ B
    return grouped_fit(y, J, variance, _groups(sights, measured, options), usual=_USUAL_PX, iterations=iterations)


def _groups(sights: Sequence[Sight], measured: Sequence[Measured], options: EdgeOptions) -> Longs:
    """Return the number of the piece of edge that each usable sample lies on, ascending."""
    most = max(int(options.group_px / options.step_px), 1)
    keys, before = [], 0
    for sight, m in zip(sights, measured, strict=True):
        run = sight.samples.run
        count = np.bincount(run)
        place = np.arange(len(run)) - (np.cumsum(count) - count)[run]
        pieces = np.maximum(np.round(count / most), 1)
        key = run * 1000 + np.minimum(place * pieces[run] / np.maximum(count[run], 1), 999).astype(np.int64)
        keys.append(before + key[m.usable])
        before += (int(run.max(initial=-1)) + 1) * 1000
    key = np.concatenate(keys)
    return np.cumsum(np.diff(key, prepend=key[:1]) > 0)


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
