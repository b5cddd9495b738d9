"""The pose of a part to the limit of the pixels: visible CAD edges against the photo's own.

Lines are drawn with hidden ones removed, pulled onto the photo's steps (`locate.attraction`), the pose is solved from
the steps near it (`locate.solution`), and believed only where the photo shows far more of the part's edges than chance
would (`locate.quality`). Where that is in doubt, lines are looked for again: wider, beside the pose, by colour.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.fit.grouped import GroupedFit
from cadcam.geometry.rigid import Rigid
from cadcam.locate.agreement import SCATTERED_PX, agreed
from cadcam.locate.attraction import attracted
from cadcam.locate.color import in_color
from cadcam.locate.contrast import showing
from cadcam.locate.evidence import Evidence, pose_jacobian
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import FOUND, Location
from cadcam.locate.matches import EdgeMatches
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality import Seen, judged, seen
from cadcam.locate.sight import Sight
from cadcam.locate.solution import CLOSE_PX, EDGES, LOOSE_PX, EdgeOptions, Solution, solved
from cadcam.locate.uncertainty import calibration_covariance, weakest_direction

_TOGETHER_PX = 0.005  # by which all edges of a photo are off together: light from one side bends alike beside them
_REDRAW_PX = 1.5  # lines that moved this far may hide otherwise
_CLEARLY = 0.1  # quality by which an answer that is not found must be better to take the place of another one
_DOUBT = (0.25, 0.62)  # quality of a pose that half of the lines agree with: worth a second, wider search
_FREE = 0.4  # share of the lines that any pose could be fitted to, more than of a box: little else speaks for a pose
_FARTHEST_PX = 3.0  # an edge farther off is another one
_LOOSER = 3.0  # times as much, that a fit is looser than another one
_WIDER, _WIDER_PX = 1.5, 14.0  # times the first search, at least
_WEAKEST, _BESIDE_PX = 3, 4.0  # motions along which a loose pose may be another one, and how far lines move by them
_ABOUT = 0.25  # share of the lines that colour speaks for, from which on a pose is about right
_AROUND_PX = (3.0, 5.0, 8.0)  # searches there
_BANDED = 0.15  # share of a photo's lines that lie beside bands, from which on these are told
_SAME_PX = 0.5  # a search that ends this near to where it began, at a pose that was found, finds the same again
_Answer = tuple[Location, Solution | None, Sequence[Sight]]  # what was found, measured, and drawn for it
_ANY_TURN = np.pi**2 / 3  # rad^2: variance of a turn that may be any
_UNKNOWN = np.diag([1e6] * 3 + [10.0] * 3)  # mm^2, rad^2: covariance of a pose that nothing was measured of


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
    wrong pose often half agree. Where edges still fit only loosely, and the start was the best of many or the answer is
    in doubt, poses beside it are tried too, narrowly. Where edges scatter, and most of them agree closely on another
    pose, that one is looked at (`locate.agreement`). None of it where the start is known to be good: farther off there
    are only other lines. Where colour speaks for a doubtful answer it is about right: lines are looked for once more
    from there, narrowly first.
    """

    def found_in(photos: Sequence[Photo]) -> Location:
        return refined(
            part, photos, start, freedom=freedom, evidence=evidence, options=options, chosen=chosen, wider=wider
        )[0]

    return in_spite_of_noise(photos, found_in) if wider else found_in(photos)


def in_spite_of_noise(photos: Sequence[Photo], found_in: Callable[[Sequence[Photo]], Location]) -> Location:
    """Return what is found in photos; where that is nothing and noise hides lines, what is found in calmer ones."""
    first = found_in(photos)
    if first.found:
        return first
    calm = [photo.calmed() for photo in photos]
    if all(photo.calm is None for photo in calm):
        return first
    second = found_in(calm)
    return second if second.found or second.quality > first.quality + _CLEARLY else first


def refined(
    part: Part,
    photos: Sequence[Photo],
    start: Rigid,
    *,
    freedom: Freedom = FREE,
    evidence: Sequence[Evidence] = (),
    options: EdgeOptions = EDGES,
    chosen: int = 0,
    wider: bool = True,
) -> tuple[Location, Sequence[Sight]]:
    """Return what `refine` does, and the photos with the part's lines as drawn within a pixel or two of that pose."""
    if not photos:
        raise BadValue("photos", "none", "at least one photo")
    given, freedom = freedom, freedom.without(part.spin, start)
    best, drawn = _refined(part, photos, start, freedom, evidence, options, chosen, wider)
    for search_px in _AROUND_PX if wider else ():
        if best.quality >= _DOUBT[1] or all(photo.chroma is None for photo in photos):
            break
        share, pose, sights = max(
            (_colored(part, photos, pose, options) for pose in (best.pose.world_from_part, start)), key=lambda s: s[0]
        )
        if share < _ABOUT:
            break
        around = replace(options, search_px=search_px)
        sights, pose = _attracted(part, photos, sights, pose, freedom, around)
        second, _ = _measured(part, sights, pose, freedom, evidence, options, chosen, wider)
        if second.quality > best.quality:
            best, drawn = second, sights
    return best if freedom is given or part.spin is None else _turned_anyhow(best, part.spin), drawn


def _turned_anyhow(location: Location, spin: Array) -> Location:
    """Return the answer of a turned part, whose turn about its axis, a twist (6,), no photo tells."""
    pose = location.pose
    told = replace(
        pose,
        from_noise=pose.from_noise + _ANY_TURN * np.outer(spin, spin),
        freedom=np.linalg.qr(np.column_stack([pose.freedom, spin]))[0],
    )
    return replace(location, pose=told, reason=f"{location.reason}; turned about its axis the part looks the same")


def _colored(
    part: Part, photos: Sequence[Photo], pose: Rigid, options: EdgeOptions
) -> tuple[float, Rigid, Sequence[Sight]]:
    """Return the share of the lines' samples that colour speaks for at a pose, the pose, and its sights."""
    sights: Sequence[Sight] = _sights(part, photos, pose, options)
    return in_color(part, sights, pose)[1], pose, sights


def _refined(
    part: Part,
    photos: Sequence[Photo],
    start: Rigid,
    freedom: Freedom,
    evidence: Sequence[Evidence],
    options: EdgeOptions,
    chosen: int,
    wider: bool,
) -> tuple[Location, Sequence[Sight]]:
    """Return what `refined` does, but for what colour has it look at again."""

    def once(sights: Sequence[Sight], pose: Rigid) -> _Answer:
        return *_measured(part, sights, pose, freedom, evidence, options, chosen, wider), sights

    def measured(sights: Sequence[Sight], pose: Rigid) -> _Answer:
        """Return the answer at a pose, its lines as seen from there, or at the one that most edges agree on."""
        found, fitted, _ = answer = once(sights, pose)
        if fitted is not None and _away(sights, fitted.pose):
            sights = _sights(part, photos, fitted.pose, options, sights)
            found, fitted, _ = answer = once(sights, fitted.pose)
        closer = agreed(fitted) if wider and fitted is not None else None
        if closer is None:
            return answer
        other = once(_sights(part, photos, closer, options, sights), closer)
        return other if _better(*other[:2], found, fitted) else answer

    best, fitted, sights = measured(
        *_attracted(part, photos, _sights(part, photos, start, options), start, freedom, options)
    )
    if not wider or best.quality <= _DOUBT[0] or (best.quality >= _DOUBT[1] and not _loose(fitted)):
        return best, sights
    ended = best.pose.world_from_part
    wide = replace(options, search_px=max(_WIDER * options.search_px, _WIDER_PX))
    again, pose = _attracted(part, photos, sights, ended, freedom, wide)
    if not best.found or max(s.moved_px(ended, pose) for s in again) >= _SAME_PX:
        second, other, again = measured(again, pose)
        if _better(second, other, best, fitted):
            best, fitted, sights = second, other, again
    narrow = replace(options, search_px=CLOSE_PX)
    for beside in _beside(fitted) if chosen or best.quality < _DOUBT[1] else ():
        second, other, again = measured(*_attracted(part, photos, sights, beside, freedom, narrow))
        if not _loose(other) and _better(second, other, best, fitted):
            return second, again
    return best, sights


def _attracted(
    part: Part, photos: Sequence[Photo], sights: Sequence[Sight], start: Rigid, freedom: Freedom, options: EdgeOptions
) -> tuple[Sequence[Sight], Rigid]:
    """Return the pose whose lines lie on steps of the photos near those at the start, and its sights."""
    pose = attracted(sights, start, freedom, search_px=options.search_px)
    return _sights(part, photos, pose, options, sights) if _away(sights, pose) else sights, pose


def _away(sights: Sequence[Sight], pose: Rigid) -> bool:
    """Return whether a pose is so far from where lines were drawn that others may be seen."""
    return max(s.moved_px(s.drawn, pose) for s in sights) > _REDRAW_PX


def _measured(
    part: Part,
    sights: Sequence[Sight],
    pose: Rigid,
    freedom: Freedom,
    evidence: Sequence[Evidence],
    options: EdgeOptions,
    chosen: int,
    wider: bool,
) -> tuple[Location, Solution | None]:
    """Return what the measurement of a pose close by finds, and what was measured, if anything.

    Bands beside the lines are told only if edges then agree more closely, and closely where the part is not found
    without them: with a step more at every line anything fits, if loosely. Not where starts are known to be good, nor
    for the many poses of a search that hold nothing.
    """
    try:
        fitted = solved(sights, pose, freedom, evidence, options)
    except DegenerateGeometry as error:
        return _lost(sights, pose, freedom, str(error)), None
    location = _location(part, fitted, freedom, chosen, wider)
    hopeless = chosen > 0 and not location.found
    if not wider or hopeless or fitted.beside_bands < _BANDED:
        return location, fitted
    try:
        told = solved(sights, pose, freedom, evidence, options, bands=True)
    except DegenerateGeometry:
        return location, fitted
    second = _location(part, told, freedom, chosen, wider)
    closer = told.fit.between < fitted.fit.between and (location.found or not _loose(told))
    return (second, told) if second.found and closer else (location, fitted)


def _loose(fitted: Solution | None) -> bool:
    """Return whether edges fit a pose only loosely."""
    return fitted is not None and fitted.fit.between > LOOSE_PX


def _better(one: Location, its: Solution | None, other: Location, others: Solution | None) -> bool:
    """Return whether one answer is better than another.

    Edges of a loose fit count as met from farther off. Where one of the two is much looser, both are held to what the
    other meets.
    """
    if its is None or others is None:
        return one.quality > other.quality
    apart = its.fit.between, others.fit.between
    if max(apart) <= max(SCATTERED_PX, _LOOSER * min(apart)):
        return one.quality > other.quality
    closely = [seen(s.sights, s.pose, constraints=s.B.shape[1], scatter=0.0).quality for s in (its, others)]
    return closely[0] > closely[1]


def _beside(fitted: Solution | None) -> list[Rigid]:
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


def _location(part: Part, fitted: Solution, freedom: Freedom, chosen: int, wider: bool) -> Location:
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
    evidence, doubted = _evidence(part, fitted, B, chosen, wider)
    reason = _reason(part, estimate, evidence, fit, photos)
    return Location(estimate, _matches(fitted), evidence.quality, reason, doubted=doubted)


def _evidence(part: Part, fitted: Solution, B: Array, chosen: int, wider: bool) -> tuple[Seen, bool]:
    """Return what the photos show of the part where it was fitted along B (6, k), and whether that is doubted.

    Of a pose that would just not be found, lines that the light gives no contrast are left out; not where the model
    fits better stretched, nor where starts are known to be good (not `wider`).
    """
    pose, fit = fitted.pose, fitted.fit
    scatter = _scatter(fit, sum(int(m.usable.sum()) for m in fitted.measured))
    told, color = in_color(part, fitted.sights, pose)
    evidence = judged(told, pose, B, chosen=chosen, scatter=scatter, color=color)
    doubted = evidence.quality < FOUND or evidence.without > 0 or evidence.fitted > _FREE or fit.between > LOOSE_PX
    in_noise = any(s.photo.calm is not None for s in fitted.sights)  # there missing lines pass for faint ones
    if not wider or in_noise or evidence.gain or not _DOUBT[0] < evidence.quality < FOUND:
        return evidence, doubted
    lit = showing(part, told, pose)
    faint = 1 - sum(len(s.samples) for s in lit) / sum(len(s.samples) for s in told)
    if faint > 0:
        evidence = replace(judged(lit, pose, B, chosen=chosen, scatter=scatter, color=color), faint=faint)
    return evidence, doubted


def _scatter(fit: GroupedFit, n: int) -> float:
    """Return by how much (px, root mean square) edges, the first n data, are off as a whole, whatever they count."""
    samples = np.bincount(fit.group[:n], minlength=len(fit.offset))
    return float(np.sqrt(samples @ np.minimum(np.abs(fit.offset), _FARTHEST_PX) ** 2 / max(samples.sum(), 1)))


def _reason(part: Part, estimate: PoseEstimate, evidence: Seen, fit: GroupedFit, photos: Sequence[Photo]) -> str:
    if evidence.quality < FOUND:
        return f"not found: {evidence}"
    weakest = weakest_direction(estimate, part.aspects.centre, photos)
    return f"{evidence}; edges are off by {fit.between:.2f} px as a whole; {weakest}"


def _matches(fitted: Solution) -> EdgeMatches:
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
