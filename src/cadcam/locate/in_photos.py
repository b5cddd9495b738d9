"""Where is the part? From a rough start or from none to a refined pose, with its quality and the alternatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.geometry.rotation import hat
from cadcam.kinds import expect, expect_each
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import FOUND, Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.reason import Reason, Refusal
from cadcam.locate.refine.answer import DOUBT
from cadcam.locate.refine.basins import Basins
from cadcam.locate.refine.options import EDGES, EdgeOptions
from cadcam.locate.refine.refinement import Refinement
from cadcam.locate.refine.retaken import at_their_sharpness
from cadcam.locate.rivals import Rivals, far_looser
from cadcam.locate.search.approach import REACH, Reach, approach, as_in_another_unit, focal_as_in_mm, middle_in_view
from cadcam.locate.search.hypothesis import Hypothesis
from cadcam.locate.search.lying import Lying, met_by_search
from cadcam.locate.search.without_start import search, too_near_to_search
from cadcam.locate.usable import check_photos
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange

ALIKE = Reason("the part looks the same in this pose")  # of one that is equivalent by the part's symmetry
_RIVAL = 0.85  # share of the best hypothesis' score from which another one is refined as well
_TRIED = (4, 10)  # most hypotheses that are refined: with a start, without one
_AS_GOOD = 0.15  # difference of quality up to which an alternative is as good
_BY_SCORE = 0.3  # weight of the hypothesis' score, relative to the best, beside the quality
_EQUAL, _ELSEWHERE = 0.9, 0.5  # a rival place: least share of the best score, least distance in radii
# Least ratio of a pose's score to the best elsewhere: right poses have 1.14 to 1.8, mostly above 1.3, wrong ones 1.0 to
# 1.18. The second is for poses with a quality of at least _CLEAR.
_STANDS_OUT, _CLEAR = (1.25, 1.1), 0.75
# In clutter wrong poses score as high as the right one, or higher, but do not refine as well: there right ones have a
# quality of 0.6 to 0.85, the best of eight elsewhere 0.3, and 0.0 where the part is absent.
_ABOVE, _SURE = 0.3, 0.6  # a pose stands out by its quality: least lead over those elsewhere, least quality
_PROMISING = 0.25  # least quality, before the fit, of a start that might still beat what was found
_SAME, _BASIN = 0.02, 0.1  # radii: closer refined poses are one; closer starts lie in a refined pose's basin


class Trial(NamedTuple):
    """A hypothesis' score, and what refining it gave."""

    score: float
    location: Location


@dataclass(frozen=True, slots=True, eq=False)
class _LocateTask:
    """What is asked of `locate_part`, of its photos or of smoothed ones."""

    part: Part
    photos: Sequence[Photo]
    start: Rigid | None
    views: ViewRange
    reach: Reach
    freedom: Freedom
    options: EdgeOptions
    lying: Lying | None = None
    middle: Array | None = None  # of what the photos show from the start

    @property
    def chosen(self) -> int:
        """How many constraints a hypothesis meets by being the best of many."""
        return met_by_search(self.lying) if self.start is None else 0

    def checked(self, location: Location) -> Location:
        """Return a location as not found where it does not lie on a plane that is known."""
        return location if self.lying is None else self.lying.checked(location)

    def holds(self, location: Location) -> bool:
        """Return whether a location is about as near the start as it should be; any is where there is no start."""
        if self.start is None or self.middle is None:
            return True
        return self.reach.holds(self.middle, self.photos, self.start, location.pose.world_from_part)

    def alike(self, best: Location) -> list[Location]:
        """Return the other poses of a symmetric part; none from a start, which chooses among them."""
        return equivalent(self.part, best, self.lying) if self.start is None else []


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
    """Return where the part is (world_from_part, mm), or the best pose tried with `found` false and the reason.

    start: a pose off by no more than `reach`; without one the part is searched for from all `views`. photos: of one
    camera, of a rig, or of a moved camera. freedom: the motions that are possible from the start. Other poses that the
    photos allow nearly as well (symmetry, a flip of a flat part) are in `alternatives`. Raises `UnusablePhoto` on
    photos without contrast and `NothingInView` where the start puts the part outside of all photos.
    """
    expect(reach, "reach", Reach)
    expect(options, "options", EdgeOptions)
    expect(part, "part", Part)
    photos = expect_each(photos, "photos", Photo)
    expect_motion(start, "start", optional=True)
    expect(views, "views", ViewRange)
    expect(freedom, "freedom", Freedom)
    check_photos(photos)
    if start is None and not freedom.full:
        raise BadValue("freedom", "given without a start", "a start to move from, or no freedom")
    searched = search(part, photos, views) if start is None else []
    middle = None if start is None else middle_in_view(part, photos, start, reach)

    def found_in(photos: Sequence[Photo], times: Sequence[int]) -> list[Location]:
        lying = Lying.of(part, photos, views) if start is None else None
        task = _LocateTask(part, photos, start, views, reach, freedom, options, lying, middle)
        near = searched if start is None else approach(part, photos, start, reach=reach, freedom=freedom)
        location = _located(task, near)
        return [location if lying is None else lying.counted(location, photos)]

    return at_their_sharpness(photos, found_in)[0]


def _located(task: _LocateTask, hypotheses: Sequence[Hypothesis]) -> Location:
    """Return the best pose that refining hypotheses, and the start, finds, checked against its rivals."""
    if not hypotheses:
        pose = Rigid() if task.start is None else task.start
        hypotheses = [Hypothesis(pose, 0.0, task.options.search_px)]
    basins = Basins(task.freedom)

    def clear(trial: Trial) -> bool:
        return task.start is not None or stands_out(task.part, trial, hypotheses)

    trials = _refined(task, hypotheses, basins, clear)
    # If nothing stands out among the hypotheses by its score, a pose may still do so by its quality (`_alone`).
    none_clear = not any(clear(trial) for trial in trials if trial.location.found)
    trials += _start_refined(task, hypotheses, trials, basins)
    rivals = Rivals(task.part, task.photos, task.freedom, task.options, task.chosen)
    near, beyond = _within_reach(task, trials)
    ranked = [*_led_by_own_lines(_ranked(near), rivals), *beyond]
    best = ranked[0].location
    alike = task.alike(best)
    if not best.found:
        return _not_found(task, best, len(hypotheses), alike)
    if not (clear(ranked[0]) or (none_clear and _alone(task.part, best, trials))):
        return _uncertain(best, "lines elsewhere in the photos look nearly as much like the part", alike)
    if task.start is None or best.quality < DOUBT[1] or rivals.contested(best).any():
        checked = task.checked(rivals.checked(best, basins.sights(best.pose.world_from_part)))
        if checked.pose is not best.pose:
            alike = task.alike(checked)
        if not checked.found:
            return checked
        ranked[0] = ranked[0]._replace(location=checked)
    return _with_alternatives(task.part, ranked, alike)


def _refined(
    task: _LocateTask, hypotheses: Sequence[Hypothesis], basins: Basins, clear: Callable[[Trial], bool]
) -> list[Trial]:
    """Return the hypotheses refined: until a clear one is found, and then only those that score nearly as high.

    Hypotheses that lie in the basin of an earlier one are left out.
    """
    trials: list[Trial] = []
    for h in hypotheses[: _TRIED[task.start is None]]:
        found = [trial for trial in trials if trial.location.found]
        if h.score < _RIVAL * hypotheses[0].score and any(clear(trial) for trial in found):
            break
        poses = [trial.location.pose.world_from_part for trial in found]
        if any(_apart(task.part, h.world_from_part, pose) < _BASIN for pose in poses):
            continue
        if basins.hold(h.world_from_part, h.within_px):
            continue
        nearby = replace(task.options, search_px=h.within_px)
        refinement = Refinement(task.part, task.photos, task.freedom, options=nearby, chosen=task.chosen)
        location, sights = refinement.around(h.world_from_part)
        trials.append(Trial(h.score, task.checked(location)))
        basins.add(location, sights)
    return trials


def _start_refined(
    task: _LocateTask, hypotheses: Sequence[Hypothesis], trials: Sequence[Trial], basins: Basins
) -> list[Trial]:
    """Return what refining the start itself finds, unless hypotheses around it have led to a sure pose already.

    Lines are searched for nearby and, only while nothing at all is found, as far away as the start may be off: a pose
    found in a lattice of equal bays may be one bay off, but then the start is near enough.
    """
    if task.start is None:
        return []
    certain = [trial.location for trial in trials if trial.location.found and not trial.location.doubted]
    quality = max((location.quality for location in certain), default=0.0)
    if any(location.quality >= _SURE and task.holds(location) for location in certain):
        return []
    score = max(h.score for h in hypotheses)  # nothing is likelier than a good start
    near = task.options.search_px
    nothing_yet = quality == 0
    ranges, least = ((near, max(near, task.reach.shift_px)), 0.0) if nothing_yet else ((near,), _PROMISING)
    done: list[Location] = []
    for search_px in ranges:
        if any(location.found for location in done) or basins.hold(task.start, search_px):
            continue
        options = replace(task.options, search_px=search_px)
        refinement = Refinement(task.part, task.photos, task.freedom, options=options, wider=nothing_yet, least=least)
        location, sights = refinement.around(task.start)
        done.append(location)
        basins.add(location, sights)
    return [Trial(score, location) for location in done]


def _within_reach(task: _LocateTask, trials: Sequence[Trial]) -> tuple[list[Trial], list[Trial]]:
    """Return the trials within reach of the start, if one of them is as good as any, and the others without a score.

    Of equal bays refining may lead one bay on, where a part whose bodies are not all in place fits no worse.
    """
    near = [trial for trial in trials if task.holds(trial.location)]
    least = max(FOUND, max(trial.location.quality for trial in trials) - _AS_GOOD)
    if all(trial.location.quality < least for trial in near):
        return list(trials), []
    return near, [trial._replace(score=0.0) for trial in trials if not task.holds(trial.location)]


def _ranked(trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials, best first: by quality, and by the score of the hypothesis that each came from.

    A doubted one, which needs a body to be absent, gives way to one that is as good and not doubted. A loose one gives
    way to one that is as good and fits far closer: of a part that nearly equals itself turned over, the turned one has
    about as many lines met, but beside the photos' steps. One whose edges are off by more than light explains gives way
    to any that is found and fits so: grain along a part looks like its lines, a few px beside them.
    """
    most = max(max(trial.score for trial in trials), 1e-9)
    ranked = sorted(trials, key=lambda trial: -(trial.location.quality + _BY_SCORE * trial.score / most))
    least = max(FOUND, ranked[0].location.quality - _AS_GOOD)
    good = [trial.location for trial in ranked if trial.location.quality >= least]
    good = [location for location in good if not location.doubted] or good or [ranked[0].location]
    closest = min(good, key=lambda location: location.matches.scatter_px)
    first = closest if far_looser(good[0], closest) else good[0]
    fitting = [trial.location for trial in ranked if trial.location.found and not trial.location.amiss]
    if first.amiss and fitting:
        closest = min(fitting, key=lambda location: location.matches.scatter_px)
        first = closest if far_looser(first, closest) else first
    return _led_by(ranked, lambda location: location is first)


def _led_by_own_lines(ranked: Sequence[Trial], rivals: Rivals) -> list[Trial]:
    """Return the trials, led by one that is as good as the first but shows lines that only it has.

    The first stays in front where the photos show the lines that it alone has.
    """
    best = ranked[0].location
    least = max(FOUND, best.quality - _AS_GOOD)
    return _led_by(ranked, lambda location: location.quality >= least and rivals.prefers(location, best))


def _led_by(ranked: Sequence[Trial], preferred: Callable[[Location], bool]) -> list[Trial]:
    """Return the trials with the first preferred one moved to the front, if there is any."""
    first = next((trial for trial in ranked if preferred(trial.location)), ranked[0])
    return [first, *(trial for trial in ranked if trial is not first)]


def _not_found(task: _LocateTask, best: Location, tried: int, equivalent: Sequence[Location]) -> Location:
    started = task.start is not None
    around = " around the start" if started else ""
    said = f"the best of {tried} hypotheses{around} does not hold: {best.why.why}"
    why = replace(best.why, why=said, refusal=Refusal.NOT_FOUND, around_start=started)
    odd = focal_as_in_mm(task.photos) or too_near_to_search(task.part, task.views)
    if task.start is not None and not odd:
        odd = as_in_another_unit(task.part, task.photos, task.start)
    return replace(best, why=why.noting(odd) if odd else why, alternatives=tuple(equivalent))


def _uncertain(best: Location, why: str, alternatives: Sequence[Location]) -> Location:
    return replace(best.uncertain(why), alternatives=tuple(alternatives))


def _with_alternatives(part: Part, ranked: Sequence[Trial], equivalent: Sequence[Location]) -> Location:
    """Return the best pose with the others that look as good; uncertain if equal ones put the part elsewhere."""
    best, here = ranked[0].location, ranked[0].location.pose.world_from_part
    as_good = [trial for trial in ranked[1:] if trial.location.quality >= max(FOUND, best.quality - _AS_GOOD)]
    equal = [trial.location for trial in as_good if trial.score >= _EQUAL * ranked[0].score]
    places = distinct_poses(part, best, [o for o in equal if elsewhere(part, here, o.pose.world_from_part)])
    others = distinct_poses(part, best, [*best.alternatives, *(trial.location for trial in as_good)], equivalent)
    if places:
        said = "another place in the photos looks" if len(places) == 1 else f"{len(places)} other places look"
        return _uncertain(best, f"{said} as much like the part", others)
    n = len(distinct_poses(part, best, others))
    told = best.noting(f"{n} other pose{'s look' if n > 1 else ' looks'} as good") if n else best
    return replace(told, alternatives=tuple(others))


def stands_out(part: Part, trial: Trial, hypotheses: Sequence[Hypothesis]) -> bool:
    """Return whether a pose that a search found scores clearly more than what the search found elsewhere.

    The best of very many wrong poses fits some lines of any cluttered photo, but hardly better than the next best ones.
    """
    here = trial.location.pose.world_from_part
    away = [h.score for h in hypotheses if elsewhere(part, here, h.world_from_part)]
    return trial.score >= _STANDS_OUT[trial.location.quality >= _CLEAR] * max(away, default=0.0)


def _alone(part: Part, best: Location, trials: Sequence[Trial]) -> bool:
    """Return whether a pose is clearly better than everything that was refined at other places.

    Its edges have to be where the part's are: of patterns, such as tiles and boards, some lines nearly fit any box.
    """
    here, locations = best.pose.world_from_part, [trial.location for trial in trials]
    away = [o.quality for o in locations if elsewhere(part, here, o.pose.world_from_part)]
    return not best.amiss and best.quality >= max(_SURE, _ABOVE + max(away, default=1.0))


def elsewhere(part: Part, one: Rigid, other: Rigid) -> bool:
    """Return whether two poses put the part at different places, not just differently at one."""
    middle, radius = part.aspects.centre, part.aspects.radius
    return bool(np.linalg.norm(one @ middle - other @ middle) > _ELSEWHERE * radius)


def _apart(part: Part, one: Rigid, other: Rigid) -> float:
    """Return the largest distance of the part's corners between two poses, in its radii."""
    radius = part.aspects.radius
    corners = part.aspects.centre + radius * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    return float(np.linalg.norm(one @ corners - other @ corners, axis=1).max() / radius)


def _apart_to_see(part: Part, one: Rigid, other: Rigid) -> float:
    """Return the same of what no turn moves that photos cannot show: points of an axis, or the middle of a ball."""
    if not part.spins.size:
        return _apart(part, one, other)
    v, w = part.spins[:3].T, part.spins[3:].T
    middle, radius = part.aspects.centre, part.aspects.radius
    still = middle - np.linalg.lstsq(np.vstack([hat(k) for k in w]), (v + np.cross(w, middle)).ravel(), rcond=None)[0]
    points = still + radius * np.stack([0 * w[0], w[0], -w[0]])[: 3 if len(w) == 1 else 1]
    return float(np.linalg.norm(one @ points - other @ points, axis=1).max() / radius)


def equivalent(part: Part, best: Location, lying: Lying | None = None) -> list[Location]:
    """Return the other poses in which a symmetric part looks the same as in the best, of those that may lie so."""
    out = []
    pose = best.pose
    for number, part_from_part in enumerate(part.symmetries[1:], 1):
        Ad = part_from_part.inv.adjoint()
        moved = replace(
            pose,
            world_from_part=pose.world_from_part @ part_from_part,
            from_noise=Ad @ pose.from_noise @ Ad.T,
            from_calibration=Ad @ pose.from_calibration @ Ad.T,
            freedom=np.linalg.qr(Ad @ pose.freedom)[0],
            undetermined=Ad @ pose.undetermined,
        )
        if lying is None or not lying.off(moved):
            matches = best.matches.among(part_from_part, part.chain_images[number])
            judged = replace(best.judged, p=part_from_part.inv @ best.judged.p)
            out.append(replace(best, pose=moved, matches=matches, judged=judged, why=ALIKE))
    return out


def with_equivalents(part: Part, location: Location) -> Location:
    """Return a location, found from a start, with all poses in which the part looks the same among its alternatives.

    As a search has them, where nobody has said by a start which of them is meant.
    """
    others = distinct_poses(part, location, location.alternatives, equivalent(part, location))
    more = len(others) - len(location.alternatives)
    if not more:
        return location
    told = location.noting(f"{more} other pose{'s look' if more > 1 else ' looks'} the same")
    return replace(told, alternatives=tuple(others))


def distinct_poses(
    part: Part, best: Location, others: Sequence[Location], equivalent: Sequence[Location] = ()
) -> list[Location]:
    """Return the others, best first, that are neither the best pose nor each other, and the equivalent ones.

    Others that differ from these by no more than a turn that no photo shows are none.
    """
    kept, ways = [best], [(other, _apart) for other in equivalent] + [(other, _apart_to_see) for other in others]
    for other, apart in sorted(ways, key=lambda way: -way[0].quality):
        if min(apart(part, other.pose.world_from_part, o.pose.world_from_part) for o in kept) > _SAME:
            kept.append(other)
    return kept[1:]
