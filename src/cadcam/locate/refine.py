"""The pose of a part to the limit of the pixels: visible CAD edges against the photo's own.

Lines are drawn with hidden ones removed, pulled onto the photo's steps (`locate.attraction`), each step is fitted to
the pixels (`image.profile`), and the pose solved for by a regression that knows that edges err as a whole
(`fit.grouped`): a chamfer, a shadow or paint shifts all samples of an edge together. What comes out is believed only
where the photo shows far more of the part's edges than chance would (`locate.quality`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, quantile
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.fit.grouped import GroupedFit, grouped_fit
from cadcam.geometry.rigid import Rigid
from cadcam.locate.attraction import attracted
from cadcam.locate.edges import Projected
from cadcam.locate.evidence import Evidence, pose_jacobian, rows_of
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import FOUND, Location
from cadcam.locate.matches import EdgeMatches
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality import Seen, judged
from cadcam.locate.sight import Cells, Measured, Sight, measure, nearest_steps
from cadcam.locate.uncertainty import calibration_covariance, weakest_direction

Longs = npt.NDArray[np.int64]
_CLOSE = 3  # px: how far from the lines their steps may be after the search
_ON_LINE = 0.7  # px: steps this near are fitted on the line itself
_USUAL_PX = 0.05  # by which edges are off as a whole
_LIGHT_PX = 0.03  # by which light shifts an edge of usual contrast
_LIMB_PX = 0.2  # by which the border of a round surface is off: it darkens ever faster towards it, or brightens
_TOGETHER_PX = 0.004  # by which all edges of a photo are off together: pixels do not collect light to less
_UNEVEN = 0.4  # of what edges are off by as a whole: they are off by that beside, they turn and bend too
_REDRAW_PX = 1.5  # lines that moved this far may hide otherwise
_ROUNDS = (3, 8, 8, 8)  # reweightings in the first measurement, the second, and more where it is not settled
_SETTLED_PX = 0.2  # by which nine tenths of the lines may move in the last step
_PIECES = 30  # groups that the edges are cut into at least
_DOUBT = (0.25, 0.62)  # quality of a pose that half of the lines agree with: worth a second, wider search
_FARTHEST_PX = 3.0  # an edge farther off is another one
_LOOSE_PX = 0.25  # by which edges of a good pose are seldom off as a whole
_WIDER, _WIDER_PX = 1.5, 14.0  # times the first search, at least
_WEAKEST, _BESIDE_PX = 3, 4.0  # motions along which a loose pose may be another one, and how far lines move by them
_SAME_PX = 0.5  # a search that ends this near to where it began, at a pose that was found, finds the same again
_UNKNOWN = np.diag([1e6] * 3 + [10.0] * 3)  # mm^2, rad^2: covariance of a pose that nothing was measured of


@dataclass(frozen=True, slots=True)
class EdgeOptions:
    """How edges are looked for.

    search_px: how far from the start's lines the photo's may lie. step_px: length of the cell that a sample stands for.
    reach_px: how far to each side of a line its pixels are used; room_px: the least of that, nearer to another line a
    sample is left out. group_px: length of edge that is taken to err as one.
    """

    search_px: float = 8.0
    step_px: float = 4.0
    reach_px: float = 4.5
    room_px: float = 2.5
    group_px: float = 150.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise BadValue(name, value, "a positive number of px")


EDGES = EdgeOptions()


def refine(
    part: Part,
    photos: Sequence[Photo],
    start: Rigid,
    *,
    freedom: Freedom = FREE,
    evidence: Sequence[Evidence] = (),
    options: EdgeOptions = EDGES,
    chosen: int = 0,
    wider: bool = True,
) -> Location:
    """Return where the part stands, from a start world_from_part whose lines are off by no more than `search_px`.

    photos: of one camera, of a rig, or of a moved camera, each with its viewpoint in the world. evidence: points and
    lines of the part that are known otherwise. chosen: how many constraints the start met by being the best of many
    poses in these photos; they prove nothing (`locate.quality`). Where too little is seen to tell the pose the answer
    has quality 0. wider: whether a doubtful answer is searched for once more, wider, from where it ended; lines of a
    wrong pose often half agree. Where the start was the best of many and edges still fit only loosely, poses beside it
    are tried too, narrowly. Not where the start is known to be good: farther off there are only other lines.
    """
    if not photos:
        raise BadValue("photos", "none", "at least one photo")

    def measured(sights: Sequence[Sight], pose: Rigid) -> tuple[Location, _Fitted | None]:
        return _measured(part, sights, pose, freedom, evidence, options, chosen)

    sights, pose = _attracted(part, photos, _sights(part, photos, start, options), start, freedom, options)
    best, fitted = measured(sights, pose)
    if not wider or best.quality <= _DOUBT[0] or (best.quality >= _DOUBT[1] and not _loose(fitted)):
        return best
    ended = best.pose.world_from_part
    wide = replace(options, search_px=max(_WIDER * options.search_px, _WIDER_PX))
    sights, pose = _attracted(part, photos, sights, ended, freedom, wide)
    if not best.found or max(s.moved_px(ended, pose) for s in sights) >= _SAME_PX:
        second, other = measured(sights, pose)
        if second.quality > best.quality or (_loose(fitted) and not _loose(other) and second.found):
            best, fitted = second, other
    narrow = replace(options, search_px=_CLOSE)
    for beside in _beside(fitted) if chosen else ():
        second, other = measured(*_attracted(part, photos, sights, beside, freedom, narrow))
        if second.quality > best.quality and not _loose(other):
            return second
    return best


def _attracted(
    part: Part, photos: Sequence[Photo], sights: Sequence[Sight], start: Rigid, freedom: Freedom, options: EdgeOptions
) -> tuple[Sequence[Sight], Rigid]:
    """Return the pose whose lines lie on steps of the photos near those at the start, and its sights."""
    pose = attracted(sights, start, freedom, search_px=options.search_px)
    moved = max(s.moved_px(s.drawn, pose) for s in sights) > _REDRAW_PX
    return _sights(part, photos, pose, options, sights) if moved else sights, pose


def _measured(
    part: Part,
    sights: Sequence[Sight],
    pose: Rigid,
    freedom: Freedom,
    evidence: Sequence[Evidence],
    options: EdgeOptions,
    chosen: int,
) -> tuple[Location, _Fitted | None]:
    """Return what the measurement of a pose close by finds, and what was measured, if anything."""
    try:
        fitted = _fitted(sights, pose, freedom, evidence, options)
    except DegenerateGeometry as error:
        return _lost(sights, pose, freedom, str(error)), None
    return _location(part, fitted, freedom, chosen), fitted


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """The refined pose, and what was measured for its last step from `before`: x in the basis B there."""

    sights: Sequence[Sight]
    before: Rigid
    pose: Rigid
    B: Array
    places: Sequence[Projected]
    measured: Sequence[Measured]
    fit: GroupedFit

    @property
    def moved(self) -> list[Array]:
        """Return by how much (n,) px the last step moved the samples of each photo along their normals."""
        return [at.row @ (self.B @ self.fit.x) for at in self.places]


def _loose(fitted: _Fitted | None) -> bool:
    """Return whether edges fit a pose only loosely."""
    return fitted is not None and fitted.fit.between > _LOOSE_PX


def _beside(fitted: _Fitted | None) -> list[Rigid]:
    """Return poses beside that of a loose fit, along the motions of the lines in the photos that it tells least.

    Lines of thin plates seen edge-on may be taken for each other, all in the same sense: that too is a fit, if a loose
    one. Between it and the right pose lies a hill that no search from either climbs.
    """
    if fitted is None or not _loose(fitted):
        return []
    moved = []
    for sight in fitted.sights:
        camera_from_part = sight.photo.viewpoint.camera_from_world @ fitted.pose
        q, J = sight.photo.camera.project_with_jacobian(camera_from_part @ sight.samples.p)
        by_twist = pose_jacobian(sight.samples.p, J @ camera_from_part.rotation)
        moved.append(by_twist[np.isfinite(q).all(axis=1)])
    every = np.concatenate(moved) @ fitted.B
    r = np.linalg.qr(every.reshape(-1, every.shape[2]) / np.sqrt(len(every)))[1]  # |r x|: px, root mean square
    axes = np.linalg.eigh(r @ fitted.fit.covariance @ r.T)[1][:, -_WEAKEST:]
    steps = fitted.B @ np.linalg.solve(r, _BESIDE_PX * axes)
    return [fitted.pose @ Rigid.exp(sign * step) for step in steps.T for sign in (1, -1)]


def _sights(
    part: Part, photos: Sequence[Photo], pose: Rigid, options: EdgeOptions, before: Sequence[Sight] = ()
) -> list[Sight]:
    noise = [s.noise for s in before] or [np.nan] * len(photos)
    return [
        Sight.of(part, photo, pose, step_px=options.step_px, reach_px=2 * options.reach_px, noise=n)
        for photo, n in zip(photos, noise, strict=True)
    ]


def _fitted(
    sights: Sequence[Sight], pose: Rigid, freedom: Freedom, evidence: Sequence[Evidence], options: EdgeOptions
) -> _Fitted:
    """Return the pose after measuring steps where they are first seen, then on the lines themselves."""
    half = 0.5 * options.step_px
    places = [s.project(pose) for s in sights]
    room = {"half_length": half, "reach_px": options.reach_px, "room_px": options.room_px}
    where = [nearest_steps(s, at, half_length=half, reach=_CLOSE) for s, at in zip(sights, places, strict=True)]
    cells = [Cells.of(s, at, where=w, **room) for s, at, w in zip(sights, places, where, strict=True)]
    for number, iterations in enumerate(_ROUNDS):
        measured = [
            measure(s, at, c, w, sums=None if number else c.first)
            for s, at, c, w in zip(sights, places, cells, where, strict=True)
        ]
        B = freedom.at(pose)
        fit = _solved(
            sights, places, measured, rows_of(evidence, [s.photo for s in sights], pose), B, iterations, options
        )
        last = _Fitted(sights, pose, pose @ Rigid.exp(B @ fit.x), B, places, measured, fit)
        pose = last.pose
        where = [_left(m, moved) for m, moved in zip(measured, last.moved, strict=True)]
        if number and quantile(np.abs(np.concatenate(last.moved)), 0.9) < _SETTLED_PX:
            break
        places = [s.project(pose) for s in sights]
    return last


def _left(measured: Measured, moved: Array) -> Array:
    """Return where to fit the steps after the lines moved: on the lines, but for edges that stay away from them."""
    left = np.where(measured.usable, measured.offset, 0.0) - moved
    return np.where(np.abs(left) < _ON_LINE, 0.0, left) * measured.usable


def _solved(
    sights: Sequence[Sight],
    places: Sequence[Projected],
    measured: Sequence[Measured],
    evidence: tuple[Array, Array, Array],
    B: Array,
    iterations: int,
    options: EdgeOptions,
) -> GroupedFit:
    """Return the step in the basis B that the offsets and the other evidence ask for."""
    other, rows, other_variance = evidence
    if not np.isfinite(rows).all():
        raise DegenerateGeometry("points or lines given as evidence are not in front of their camera")
    y = np.concatenate([*(m.offset[m.usable] for m in measured), other])
    variance = np.concatenate([*(m.sigma[m.usable] ** 2 for m in measured), other_variance])
    J = np.concatenate([*(at.row[m.usable] for at, m in zip(places, measured, strict=True)), rows]) @ B
    group = _groups(sights, measured, options)
    edges = int(group[-1]) + 1 if len(group) else 0
    group = np.concatenate([group, edges + np.arange(len(other))])
    exact = np.arange(edges + len(other)) >= edges
    expected = np.concatenate([_by_light(sights, measured, group[: len(group) - len(other)]), np.zeros(len(other))])
    return grouped_fit(
        y,
        J,
        variance,
        group,
        usual=_USUAL_PX,
        uneven=_UNEVEN,
        expected=expected,
        exact=exact,
        iterations=iterations,
    )


def _by_light(sights: Sequence[Sight], measured: Sequence[Measured], group: Longs) -> Array:
    """Return by how much groups are off because of the light (G,), px^2.

    Shadows, reflections and texture add to a step of brightness: they shift it the less the higher it is. Towards the
    border of a round surface brightness changes with the root of the distance, which no slope of the ground describes.
    """
    if not len(group):
        return np.zeros(0)
    contrast = np.concatenate([np.abs(m.contrast[m.usable]) for m in measured])
    round_off = np.concatenate([s.samples.chain[m.usable] < 0 for s, m in zip(sights, measured, strict=True)])
    count = np.bincount(group)
    of_contrast = _LIGHT_PX**2 * np.mean(contrast**2) / (np.bincount(group, contrast) / count) ** 2
    return np.asarray(of_contrast + _LIMB_PX**2 * np.bincount(group, round_off) / count)


def _groups(sights: Sequence[Sight], measured: Sequence[Measured], options: EdgeOptions) -> Longs:
    """Return the number of the piece of edge that each usable sample lies on, ascending.

    Parts that are small in the picture have shorter pieces: a few groups would not tell how they scatter.
    """
    most = min(options.group_px / options.step_px, sum(len(s.samples) for s in sights) / _PIECES)
    most = max(int(most), 5)
    keys, before = [np.zeros(0, np.int64)], 0
    for sight, m in zip(sights, measured, strict=True):
        run = sight.samples.run.astype(np.int64)
        count = np.bincount(run)
        place = np.arange(len(run)) - (np.cumsum(count) - count)[run]
        pieces = np.maximum(np.round(count / most), 1)[run].astype(np.int64)
        key = before + run * len(run) + place * pieces // np.maximum(count, 1)[run]
        keys.append(key[m.usable])
        before += (int(run.max(initial=-1)) + 1) * len(run)
    key = np.concatenate(keys)
    return np.cumsum(np.diff(key, prepend=key[:1]) > 0)


def _location(part: Part, fitted: _Fitted, freedom: Freedom, chosen: int) -> Location:
    sights, pose, fit = fitted.sights, fitted.pose, fitted.fit
    B = freedom.at(pose)
    n = [int(m.usable.sum()) for m in fitted.measured]
    gains = np.split(B @ fit.gain[:, : sum(n)], np.cumsum(n)[:-1], axis=1)
    points = [s.samples.p[m.usable] for s, m in zip(sights, fitted.measured, strict=True)]
    normals = [at.normal[m.usable] for at, m in zip(fitted.places, fitted.measured, strict=True)]
    photos = [s.photo for s in sights]
    from_calibration = calibration_covariance(photos, points, normals, gains, pose)
    together = sum(
        (_TOGETHER_PX**2 * (G @ n) @ (G @ n).T for G, n in zip(gains, normals, strict=True)), np.zeros((6, 6))
    )
    estimate = PoseEstimate(pose, B @ fit.covariance @ B.T + together, from_calibration, B, fit.dof)
    evidence = judged(sights, pose, B, chosen=chosen, scatter=_scatter(fit, sum(n)))
    return Location(estimate, _matches(fitted), evidence.quality, _reason(part, estimate, evidence, fit, photos))


def _scatter(fit: GroupedFit, n: int) -> float:
    """Return by how much (px, root mean square) edges, the first n data, are off as a whole, whatever they count."""
    samples = np.bincount(fit.group[:n], minlength=len(fit.offset))
    return float(np.sqrt(samples @ np.minimum(np.abs(fit.offset), _FARTHEST_PX) ** 2 / max(samples.sum(), 1)))


def _reason(part: Part, estimate: PoseEstimate, evidence: Seen, fit: GroupedFit, photos: Sequence[Photo]) -> str:
    if evidence.quality < FOUND:
        return f"not found: {evidence}"
    weakest = weakest_direction(estimate, part.aspects.centre, photos)
    return f"{evidence}; edges are off by {fit.between:.2f} px as a whole; {weakest}"


def _matches(fitted: _Fitted) -> EdgeMatches:
    """Return the samples as the refined pose projects them, offsets and weights as measured for it."""
    weights, offsets, done = [], [], 0
    each = fitted.fit.weight * fitted.fit.of_group[fitted.fit.group]
    for m, moved in zip(fitted.measured, fitted.moved, strict=True):
        n = int(m.usable.sum())
        weight = np.zeros(len(m.offset))
        weight[m.usable] = each[done : done + n]
        done += n
        weights.append(weight)
        offsets.append(np.where(m.usable, m.offset - moved, np.nan))
    sigma = [np.where(m.usable, m.sigma, np.nan) for m in fitted.measured]
    return _as_matches(fitted.sights, fitted.pose, offsets, sigma, weights)


def _lost(sights: Sequence[Sight], pose: Rigid, freedom: Freedom, why: str) -> Location:
    """Return the answer where nothing could be measured."""
    none = [np.full(len(s.samples), np.nan) for s in sights]
    matches = _as_matches(sights, pose, none, none, [np.zeros(len(a)) for a in none])
    B = freedom.at(pose)
    return Location(
        PoseEstimate(pose, B @ (B.T @ _UNKNOWN @ B) @ B.T, freedom=B, dof=1.0), matches, 0.0, f"not found: {why}"
    )


def _as_matches(
    sights: Sequence[Sight], pose: Rigid, offset: Sequence[Array], sigma: Sequence[Array], weight: Sequence[Array]
) -> EdgeMatches:
    places = [s.project(pose) for s in sights]
    kept = [np.isfinite(at.q).all(axis=1) for at in places]

    def joined(parts: Sequence[Array]) -> Array:
        return np.concatenate([a[k] for a, k in zip(parts, kept, strict=True)])

    numbers = [
        np.column_stack([s.samples.chain, np.full(len(s.samples), i)])[k]
        for i, (s, k) in enumerate(zip(sights, kept, strict=True))
    ]
    chain, photo = np.concatenate(numbers).astype(np.int32).T
    q, normal = joined([at.q for at in places]), joined([at.normal for at in places])
    p = joined([s.samples.p for s in sights])
    return EdgeMatches(q, normal, joined(offset), joined(sigma), joined(weight), p, chain, photo)
