"""Where is the part? From a rough start or from none to a refined pose, its evidence, and what else it could be."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from cadcam.arrays import quantile
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import FOUND, Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.support import SEARCHED
from cadcam.locate.refine.answer import DOUBT
from cadcam.locate.refine.basins import Basins
from cadcam.locate.refine.options import EDGES, EdgeOptions
from cadcam.locate.refine.refinement import Refinement, in_spite_of_noise
from cadcam.locate.rivals import Rivals
from cadcam.locate.search.approach import REACH, Reach, approach
from cadcam.locate.search.hypothesis import Hypothesis
from cadcam.locate.search.without_start import search_once
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange

_RIVAL = 0.85  # share of the best hypothesis' score that makes another one as good
_TRIED = (4, 10)  # hypotheses that are refined: with a start, without one
_AS_GOOD = 0.15  # quality that an alternative may lack
_BY_SCORE = 0.3  # quality that the best hypothesis' score is worth
_EQUAL, _ELSEWHERE = 0.9, 0.5  # share of its score, and distance in radii, that make another place a rival
# Times the score of anything elsewhere: right poses have 1.14 to 1.8, mostly above 1.3, wrong ones 1.0 to 1.18. The
# second is for poses with a quality of at least _CLEAR.
_STANDS_OUT, _CLEAR = (1.25, 1.1), 0.75
# In clutter wrong poses score as well as the right one, or better. Refined they do not come near: right ones have a
# quality of 0.6 to 0.85 there, the best of eight elsewhere 0.3, and 0.0 where the part is absent.
_ABOVE, _SURE = 0.3, 0.6  # quality beyond that of all others refined, and quality, that make a pose stand out
_PROMISING = 0.25  # quality, before the fit, of a start that could be better than what was found
_UNCERTAIN = 0.45  # quality of a pose that may as well be at another place
_SAME, _BASIN = 0.02, 0.1  # radii: refined poses nearer to each other are one; starts nearer to a pose end in it
_LOOKED_AT = 5_000  # pixels of a photo that tell whether anything can be seen in it
_FLAT, _CLIPPED = 2.0 / 255.0, 0.98  # contrast below which a photo is empty; share of pixels at black or white


def locate_part(
    part: Part,
    photos: Sequence[Photo],
    start: Rigid | None = None,
    *,
    views: ViewRange = WHOLE_SPHERE,
    reach: Reach = REACH,
    freedom: Freedom = FREE,
    options: EdgeOptions = EDGES,
) -> Location:
    """Return where the part stands (world_from_part, mm), or the best that was there with `found` false and the reason.

    start: a pose off by no more than `reach`; without one the part is searched for from all `views`. photos: of one
    camera, of a rig, or of a moved camera. freedom: the motions from the start that are possible. Other poses that the
    photos allow nearly as well (symmetry, a flip of a flat part) come in `alternatives`. Raises `BadValue` on photos
    without contrast and `NothingInView` where the start puts the part outside of all photos.
    """
    _check(photos)
    if start is None and freedom is not FREE:
        raise BadValue("freedom", "given without a start", "a start to move from, or no freedom")
    searched = search_once(part, photos, views) if start is None else []

    def found_in(photos: Sequence[Photo]) -> Location:
        around = (searched, None) if start is None else _near(part, photos, start, reach, freedom)
        return _located(part, photos, start, *around, reach, freedom, options)

    return in_spite_of_noise(photos, found_in)


def _located(
    part: Part,
    photos: Sequence[Photo],
    start: Rigid | None,
    hypotheses: Sequence[Hypothesis],
    outside: NothingInView | None,
    reach: Reach,
    freedom: Freedom,
    options: EdgeOptions,
) -> Location:
    """Return what `locate_part` finds in the photos as given, from hypotheses around a start or all over the photos."""
    most = _TRIED[start is None]
    if not hypotheses:
        hypotheses = [Hypothesis(Rigid() if start is None else start, 0.0, 0.0, options.search_px)]
    chosen = SEARCHED if start is None else 0
    basins = Basins(freedom)

    def clear(score: float, location: Location) -> bool:
        ahead = _STANDS_OUT[location.quality >= _CLEAR]
        return start is not None or _stands_out(part, location.pose.world_from_part, score, ahead, hypotheses)

    tried = _refined(part, photos, hypotheses[:most], freedom, options, chosen, basins, clear)
    every = not any(clear(*t) for t in tried if t[1].found)
    quality = max((location.quality for _, location in tried if location.found and not location.doubted), default=0.0)
    if start is not None and quality < _SURE:
        score = max(h.score for h in hypotheses)  # nothing is likelier than a good start
        # In a lattice of like bays a pose one bay off may be found, too; then the start is near enough.
        far = max(options.search_px, reach.shift_px) if quality == 0 else None
        tried += [(score, o) for o in _as_it_is(part, photos, start, far, freedom, options, basins)]
    rivals = Rivals(part, photos, freedom, options, chosen)
    ranked = _told_apart(_ranked(tried), rivals)
    score, best = ranked[0]
    alike = _alike(part, best) if start is None else []
    if not best.found and outside is not None:
        raise outside
    if not best.found:
        why = best.reason.removeprefix("not found: ")
        why = f"not found: the best of {len(hypotheses)} hypotheses does not hold: {why}"
        return replace(best, reason=why, alternatives=tuple(alike))
    if not (clear(score, best) or (every and _alone(part, best, tried))):
        return _uncertain(best, "lines elsewhere in the photos look nearly as much like the part", alike)
    if start is None or best.quality < DOUBT[1]:
        asked = rivals.beside(best, basins.sights(best.pose.world_from_part))
        alike = _alike(part, asked) if start is None and asked.pose is not best.pose else alike
        ranked[0] = score, asked
    return _beside_rivals(part, ranked, alike) if ranked[0][1].found else ranked[0][1]


def _near(
    part: Part, photos: Sequence[Photo], start: Rigid, reach: Reach, freedom: Freedom
) -> tuple[list[Hypothesis], NothingInView | None]:
    """Return the hypotheses around a start; none, with the approach's error, where the part is larger than the photos.

    An approach moves the part as a whole about its middle. Where the camera stands within it, that is no small motion
    of the few lines in view; the start as it is may be near enough all the same.
    """
    try:
        return approach(part, photos, start, reach=reach, freedom=freedom), None
    except NothingInView as error:
        poses = [(photo.camera, photo.viewpoint.camera_from_world @ start) for photo in photos]
        if not any(len(part.lines.draw(*pose).visible.q) for pose in poses):
            raise
        return [], error


def _as_it_is(
    part: Part,
    photos: Sequence[Photo],
    start: Rigid,
    far: float | None,
    freedom: Freedom,
    options: EdgeOptions,
    basins: Basins,
) -> list[Location]:
    """Return what refining the start itself finds: lines looked for nearby and, if that fails, up to `far` px away.

    far: None where there is an answer already, and only a start that is nearly right could have a better one.
    """
    done: list[Location] = []
    for search_px in (options.search_px,) if far is None else (options.search_px, far):
        if not any(location.found for location in done) and not basins.hold(start, search_px):
            searching = replace(options, search_px=search_px)
            least = _PROMISING if far is None else 0.0
            asked = Refinement(part, photos, freedom, options=searching, wider=far is not None, least=least)
            location, sights = asked.around(start)
            done.append(location)
            basins.add(location, sights)
    return done


def _ranked(tried: Sequence[tuple[float, Location]]) -> list[tuple[float, Location]]:
    """Return score and location, best first: by quality, and by the score of the hypothesis that it came from.

    A doubted one, which needs a body to be absent, gives way to one that is as good and needs no such thing.
    """
    most = max(max(score for score, _ in tried), 1e-9)
    ranked = sorted(tried, key=lambda t: -(t[1].quality + _BY_SCORE * t[0] / most))
    least = max(FOUND, ranked[0][1].quality - _AS_GOOD)
    return _first(ranked, lambda t: t[1].quality >= least and not t[1].doubted)


def _told_apart(ranked: Sequence[tuple[float, Location]], rivals: Rivals) -> list[tuple[float, Location]]:
    """Return them led by one as good as the first whose own lines show, where the first one's own lines do not."""
    best = ranked[0][1]
    least = max(FOUND, best.quality - _AS_GOOD)
    return _first(ranked, lambda t: t[1].quality >= least and rivals.rather(t[1], best))


def _first(
    ranked: Sequence[tuple[float, Location]], better: Callable[[tuple[float, Location]], bool]
) -> list[tuple[float, Location]]:
    """Return them with the first one that is `better` moved to the front, if there is any."""
    first = next(filter(better, ranked), ranked[0])
    return [first, *(t for t in ranked if t is not first)]


def _beside_rivals(part: Part, ranked: Sequence[tuple[float, Location]], alike: Sequence[Location]) -> Location:
    """Return the best pose with the others that look as good; uncertain where equal ones put the part elsewhere."""
    (score, best), *others = ranked
    as_good = [(s, o) for s, o in others if o.quality >= max(FOUND, best.quality - _AS_GOOD)]
    here, equal = best.pose.world_from_part, [o for s, o in as_good if s >= _EQUAL * score]
    places = _distinct(part, best, [o for o in equal if _elsewhere(part, here, o.pose.world_from_part)])
    rivals = _distinct(part, best, [*alike, *(o for _, o in as_good)])
    if places:
        return _uncertain(best, f"{len(places)} other places in the photos look as much like the part", rivals)
    others_note = f"; {len(rivals)} other poses look as good" if rivals else ""
    return replace(best, reason=best.reason + others_note, alternatives=tuple(rivals))


def _uncertain(best: Location, why: str, rivals: Sequence[Location]) -> Location:
    """Return a pose as one that may as well be another."""
    reason = f"not certain: {why} ({best.reason})"
    return replace(best, quality=min(best.quality, _UNCERTAIN), reason=reason, alternatives=tuple(rivals))


def _elsewhere(part: Part, one: Rigid, other: Rigid) -> bool:
    """Return whether two poses put the part at different places, not just differently at one."""
    middle, radius = part.aspects.centre, part.aspects.radius
    return bool(np.linalg.norm(one @ middle - other @ middle) > _ELSEWHERE * radius)


def _alone(part: Part, best: Location, tried: Sequence[tuple[float, Location]]) -> bool:
    """Return whether a pose is clearly better than everything that was refined at other places."""
    here = best.pose.world_from_part
    away = [o.quality for _, o in tried if _elsewhere(part, here, o.pose.world_from_part)]
    return best.quality >= max(_SURE, _ABOVE + max(away, default=1.0))


def _stands_out(part: Part, pose: Rigid, score: float, ahead: float, hypotheses: Sequence[Hypothesis]) -> bool:
    """Return whether a pose that a search found scores `ahead` times what it found elsewhere, or more.

    The best of very many wrong poses fits some lines of any cluttered photo; it does so hardly better than the next
    best ones do.
    """
    away = [h.score for h in hypotheses if _elsewhere(part, pose, h.world_from_part)]
    return score >= ahead * max(away, default=0.0)


def _check(photos: Sequence[Photo]) -> None:
    if not photos:
        raise BadValue("photos", "none", "at least one photo")
    for photo in photos:
        every = max(1, math.isqrt(photo.gray.size // _LOOKED_AT))
        name, gray = f"photo {photo.viewpoint.name!r}", photo.gray[::every, ::every].copy()
        low, high = quantile(gray, 0.01), quantile(gray, 0.99)
        if high - low < _FLAT:
            raise BadValue(name, f"empty: 98 % of it lies within {low:.3f} to {high:.3f}", "a picture with contrast")
        clipped = float(np.mean((gray <= 0.001) | (gray >= 0.999)))
        if clipped > _CLIPPED:
            raise BadValue(name, f"{clipped:.0%} black or white", "a picture exposed so that edges show")


def _refined(
    part: Part,
    photos: Sequence[Photo],
    hypotheses: Sequence[Hypothesis],
    freedom: Freedom,
    options: EdgeOptions,
    chosen: int,
    basins: Basins,
    clear: Callable[[float, Location], bool],
) -> list[tuple[float, Location]]:
    """Return score and location of the hypotheses refined: until one is found, and then those that are as good.

    While none that is found is `clear`, all of them, but for those that would end where others did.
    """
    done: list[tuple[float, Location]] = []
    for h in hypotheses:
        found = [o for _, o in done if o.found]
        if h.score < _RIVAL * hypotheses[0].score and any(clear(*d) for d in done if d[1].found):
            break
        if any(_apart(part, h.world_from_part, o.pose.world_from_part) < _BASIN for o in found):
            continue  # it would end there too
        if basins.hold(h.world_from_part, h.within_px):
            continue
        near = replace(options, search_px=h.within_px)
        asked = Refinement(part, photos, freedom, options=near, chosen=chosen)
        location, sights = asked.around(h.world_from_part)
        done.append((h.score, location))
        basins.add(location, sights)
    return done


def _apart(part: Part, one: Rigid, other: Rigid) -> float:
    """Return the largest distance of the part's corners between two poses, in its radii."""
    radius = part.aspects.radius
    corners = part.aspects.centre + radius * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    return float(np.linalg.norm(one @ corners - other @ corners, axis=1).max() / radius)


def _alike(part: Part, best: Location) -> list[Location]:
    """Return the other poses in which a symmetric part looks the same."""
    out = []
    for part_from_part in part.symmetries[1:]:
        pose = best.pose
        Ad = part_from_part.inv.adjoint()
        moved = replace(
            pose,
            world_from_part=pose.world_from_part @ part_from_part,
            from_noise=Ad @ pose.from_noise @ Ad.T,
            from_calibration=Ad @ pose.from_calibration @ Ad.T,
            freedom=np.linalg.qr(Ad @ pose.freedom)[0],
        )
        out.append(replace(best, pose=moved, reason="the part looks the same in this pose"))
    return out


def _distinct(part: Part, best: Location, others: Sequence[Location]) -> list[Location]:
    """Return the others, best first, that are neither the best pose nor each other."""
    kept = [best]
    for other in sorted(others, key=lambda location: -location.quality):
        if min(_apart(part, other.pose.world_from_part, o.pose.world_from_part) for o in kept) > _SAME:
            kept.append(other)
    return kept[1:]
