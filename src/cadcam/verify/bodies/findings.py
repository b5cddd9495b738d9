"""What the photos show of a part's bodies: which are present, which agree on a pose, where the others are."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.errors import DegenerateGeometry
from cadcam.locate.part import Part
from cadcam.verify.adjustment.alarms import AS_IN_PLACE
from cadcam.verify.bodies.case import Case
from cadcam.verify.bodies.likelihood import log_likelihoods
from cadcam.verify.bodies.redrawn import AGREES_PX, displaced, off_px, redrawn
from cadcam.verify.bodies.snooping import OF_DISPLACED, snooped
from cadcam.verify.bodies.stages import each
from cadcam.verify.bodies.tones import Tones
from cadcam.verify.bodies.uncovered import around, taken_for_its_own, uncovered_ratio
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges, of_known_size
from cadcam.verify.edges.association import on_other_lines
from cadcam.verify.edges.presence import EdgeVisibility, Presence, edge_visibility, log_ratio
from cadcam.verify.edges.survey import Survey, surveyed

DOUBTFUL = 2.0  # log likelihood ratio, 7 to 1, below which a body may be missing
_RATHER_NOT = -1.0  # log likelihood ratio by edges or tones below which the edges behind a body are searched for
_LEAST_BORDER_PX = 24  # of a body that is told by its pixels alone: along so many it has to end in view
_THERE = 3.5  # most that pixels say for a body: wrongly, at worst, for one missing body in 33
_BY_CHANCE = 10.0  # log likelihood ratio of pixels that light and paint alone may make
_AS_MANY = 0.5  # log likelihood ratio by edges of places that show as many: one that is not seen costs 1.5 or more
_CELL_PX = 1.5  # distance of places at which a shifted feature is searched for
_ROUNDS = 4  # of redrawing displaced bodies where they were found


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """One drawing of the bodies in some places: whether each is present, the measurements, and who disagrees."""

    drawn: Part
    survey: Survey
    presence: Sequence[Presence]
    measured: MeasuredEdges
    left_out: Sequence[int]


def findings_of(case: Case, drawn: Part, survey: Survey) -> Findings:
    """Return what a survey of the part, drawn in any places, shows.

    Raises `DegenerateGeometry` where the visible part of the datum does not determine the pose.
    """
    presence = _presences(case, drawn, survey)
    measured, left_out = snooped(survey, _there(presence), case)
    return Findings(drawn, survey, presence, _by_own_edges(case, drawn, survey, measured), left_out)


def _by_own_edges(case: Case, drawn: Part, survey: Survey, measured: MeasuredEdges) -> MeasuredEdges:
    """Return the measurement with displaced bodies measured without edges that may be lines of what they hide.

    Unless the others do not tell how far they are displaced.
    """
    members = list(measured.members)
    for i, rows in enumerate(measured.members):
        part, moved = survey.whole_part(i), displaced(measured, i)
        if part is None or moved is None or moved.p_value > OF_DISPLACED * case.alarms / len(members):
            continue
        near = around(drawn, case.photos, case.world_from_part, part, survey)
        if not near.any():
            continue
        others = case.alone(near, survey.by)
        off = taken_for_its_own(others, case.photos, case.world_from_part, measured, rows, survey.by[part])
        if off.any() and of_known_size(measured.displacement(rows & ~off, apart=rows)) is not None:
            members[i] = rows & ~off
    kept = {i: found for i, found in measured.found.items() if members[i] is measured.members[i]}
    return replace(measured, members=tuple(members), found=kept)


def contradictions(case: Case, look: Findings) -> tuple[str, ...]:
    """Return which bodies of a stated datum do not agree with the rest of it.

    They stay in it, for it is stated. They pull the pose away, and so what is measured from it.
    """
    _, out = snooped(replace(look.survey, stated=False), _there(look.presence), case)
    return tuple(look.survey.names[i] for i in out)


def findings_redrawn(case: Case, look: Findings) -> Findings:
    """Return the look with displaced bodies drawn where they are, as far as that explains more of the photos.

    One body at a time, the farthest from where it is drawn first. Its place is measured, or guessed from the edges
    nearby; of several places the one that resembles the photos most is tried.
    """
    return _anywhere(look, _redrawn_one_by_one(case, look))


def _anywhere(first: Findings, last: Findings) -> Findings:
    """Return the last look, its bodies there as surely as where they were drawn first, as far as that is in doubt.

    A body is missing that is neither where it was guessed to be nor in its place: what speaks for a guess against its
    place may be little, and what it costs to have looked at many places speaks against the guess alone.
    """
    presence = list(last.presence)
    for i, (before, found) in enumerate(zip(first.presence, presence, strict=True)):
        part = last.survey.whole_part(i)
        if part is not None and last.survey.by[part].any():
            presence[i] = replace(found, log_ratio=max(found.log_ratio, min(before.log_ratio, 0.0)))
    return replace(last, presence=presence)


def _redrawn_one_by_one(case: Case, look: Findings) -> Findings:
    evidence, clutter = look.survey.evidence, look.survey.clutter.share
    seen = edge_visibility(evidence, np.ones(len(evidence.seen), bool))
    for _ in range(_ROUNDS):
        for suspect in each(_suspects(case, look), "trying other places", case.tell):
            to, gain = _likeliest(case, look, suspect)
            again = None if to is None else _resurveyed(case, look, suspect.part, to)
            if again is None:
                continue
            by_edges = _gain_by_edges(look.survey, again[1], suspect.part, seen, clutter)
            if not _likelier(by_edges, gain, least=_least_gain(case, look, suspect, by_edges)):
                continue  # before its bodies are looked for one by one, which takes long where there are many
            with suppress(DegenerateGeometry):
                look = findings_of(case, *again)
                break
        else:
            return look
    return look


@dataclass(frozen=True, slots=True, eq=False)
class _Suspect:
    """A feature that may be elsewhere than drawn: its number, the part that it is, its displacement where measured."""

    number: int
    part: int
    moved: Displacement | None


def _suspects(case: Case, look: Findings) -> list[_Suspect]:
    """Return the features, whole parts, that may be elsewhere: measured off the place where they are drawn, or unclear.

    The farthest first; last those displaced by less, those with an edge that is not seen in place but beside it, and
    those that may be absent.
    """
    out: list[tuple[float, _Suspect]] = []
    for i, found in enumerate(look.presence):
        part, moved = look.survey.whole_part(i), displaced(look.measured, i)
        if part is None or not found.expected:
            continue
        if look.survey.shows_beside(i) or (moved is None and found.log_ratio < DOUBTFUL):
            out.append((0.0, _Suspect(i, part, moved)))
        elif moved is not None:
            px = off_px(look.survey, look.survey.rows(i), moved.vector - look.survey.by[part])
            if px > AGREES_PX or moved.p_value <= OF_DISPLACED * case.alarms / len(look.presence):
                out.append((px, _Suspect(i, part, moved)))
    return [suspect for _, suspect in sorted(out, key=lambda one: (one[0], one[1].number), reverse=True)]


def _likeliest(case: Case, look: Findings, suspect: _Suspect) -> tuple[Array | None, float]:
    """Return the displacement (3,) mm of a body that makes the drawn part resemble the photos most, and by how much.

    The place is None for the body as drawn, or absent.
    """
    survey, number, part = look.survey, suspect.number, suspect.part
    measured = None if suspect.moved is None else suspect.moved.vector
    places = _places(case, survey, number, survey.by[part], measured)
    drawn = case.beside(look.drawn, part, [survey.by, *(_with(survey.by, part, p) for p in places)])
    if not drawn:
        return None, 0.0
    likelihood, without, _ = log_likelihoods(case.photos, case.world_from_part, drawn, part, survey.shown)
    best = int(np.argmax(likelihood))
    if best == 0 or likelihood[best] <= without:
        return None, 0.0
    return places[best - 1], float(likelihood[best] - likelihood[0])


def _places(case: Case, survey: Survey, number: int, now: Array, measured: Array | None) -> list[Array]:
    """Return displacements (3,) mm at which a body may be, within reach and other than the one drawn `now`."""
    places = [now + d for d in survey.guesses(number, reach_px=case.reach_px)]
    places += [] if measured is None else [measured]
    places = [_standing(survey, number, p) for p in places]
    places = [p for p in places if off_px(survey, survey.members[number], p - now) > AGREES_PX]
    return [p for p in places if np.linalg.norm(p) <= case.reach_px * survey.mm_per_px(number)]


def _standing(survey: Survey, number: int, by: Array) -> Array:
    """Return a displacement (3,) mm of a body, changed along the line of sight so that the body stands on its ground.

    One photo does not show that component; without it a body that slides would be drawn sunk, its feet hidden. As it is
    where the body would be drawn larger or smaller by that.
    """
    feet = survey.members[number] & (survey.lever != 0)
    eye = survey.eye(survey.members[number])
    if eye is None or not feet.any():
        return by
    sight = survey.lines.p[survey.members[number]].mean(axis=0) - eye
    sight, ground = sight / np.linalg.norm(sight), survey.ground[feet]
    steep = ground @ sight
    along = -float(steep @ (ground @ by)) / max(float(steep @ steep), 1e-12) * sight
    return by + along if off_px(survey, survey.members[number], along) <= AGREES_PX else by


def elsewhere_by(case: Case, look: Findings, part: int) -> float:
    """Return the log likelihood ratio of a body where it is drawn to its nominal place, over all its pixels."""
    by = look.survey.by
    guesses = case.beside(look.drawn, part, [by, _with(by, part, np.zeros(3))])
    if not guesses:
        return 0.0
    (drawn, in_place), *_ = log_likelihoods(case.photos, case.world_from_part, guesses, part, look.survey.shown)
    return float(drawn - in_place)


def _likelier(by_edges: float, by_pixels: float, *, least: float) -> bool:
    """Return whether a body drawn elsewhere explains more of the photos, by edges and pixels (log likelihood ratios).

    The edges are made of the same pixels: the `least` that it has to explain more, one of the two has to by itself.
    """
    return by_edges + by_pixels > 0 and max(by_edges, by_pixels) > least


def _least_gain(case: Case, look: Findings, suspect: _Suspect, by_edges: float) -> float:
    """Return how much more of the photos (log likelihood) a body drawn elsewhere has to explain.

    Of a body whose edges were measured, from where it is drawn, those that show elsewhere must say more: what tones say
    is only as good as the light that they are predicted by, which a patch of sun or mottled paint belies. As much as
    for an alarm, if those measured say that it is in place; or if they say that it is not, but as many show elsewhere
    as here. Then one may be taken for a line that the body hides where it is drawn.
    """
    if suspect.moved is None:
        return 0.0
    in_place = suspect.moved.p_value > AS_IN_PLACE
    if by_edges <= (0.0 if in_place else -_AS_MANY):
        return np.inf
    return surely_elsewhere(look.presence, case.alarms) if in_place or by_edges <= 0 else 0.0


def _with(by: Array, part: int, to: Array) -> Array:
    out = by.copy()
    out[part] = to
    return out


def _resurveyed(case: Case, look: Findings, part: int, to: Array) -> tuple[Part, Survey] | None:
    """Return the whole with a part drawn displaced `to` (3,) mm, and its survey; None where bodies are not apart."""
    by = _with(look.survey.by, part, to)
    drawn = redrawn(case.part, by)
    if drawn is None:
        return None
    before, pose = zip(look.survey.shown, case.photos, strict=True), case.world_from_part
    shown = [seen.moved(drawn, photo, pose, part) for seen, photo in before]
    survey = surveyed(drawn, case.photos, pose, case.asked, reach_px=case.reach_px, by=by, shown=shown)
    return (drawn, survey) if survey.names == look.survey.names else None


def _gain_by_edges(before: Survey, after: Survey, part: int, seen: EdgeVisibility, clutter: float) -> float:
    """Return the log likelihood ratio of the photos' edges with a part drawn as in one survey to as before.

    Both are compared with the same estimate of how well edges are seen. Edges are left out that were taken, before, for
    a line which is another body's now: as a body moves aside, what it hid shows beside its own edges. So are edges that
    lie too near to other lines now, and the part's feet, which stay where it sinks.
    """
    edge, chains = before.lines.edge, _chains(before)
    found = np.flatnonzero(before.matched.support & before.usable)
    places, offset = before.lines.select(found), before.matched.coarse[found]
    taken = on_other_lines(places, offset, before.lines.part[found], after.lines, after.lines.part)
    others = 2 * np.bincount(edge[found], taken, len(chains)) > np.bincount(edge[found], minlength=len(chains))
    crowded = ~np.isin(np.arange(len(_chains(after))), after.evidence.edge)
    apart = [chains[others], _chains(after)[crowded], *(_feet(survey, part) for survey in (before, after))]
    out = 0.0
    for sign, survey in ((-1.0, before), (1.0, after)):
        counted = ~np.isin(_chains(survey)[survey.evidence.edge], np.concatenate(apart))
        out += sign * log_ratio(survey.evidence, counted, seen, clutter)
    return out


def _feet(survey: Survey, part: int) -> Longs:
    """Return the feet of a part among a survey's edges, as numbers of `_chains`."""
    feet = (survey.lines.part == part) & (survey.lever != 0)
    return np.asarray(_chains(survey)[np.unique(survey.lines.edge[feet])], np.int64)


def _chains(survey: Survey) -> Longs:
    """Return a number of each edge (E,) that is the same in all surveys: of its chain in its photo."""
    first, lines = np.unique(survey.lines.edge, return_index=True)[1], survey.lines
    return np.asarray(lines.chain[first].astype(np.int64) * len(survey.shown) + lines.photo[first], np.int64)


def sure(presence: Sequence[Presence], alarms: float) -> float:
    """Return the log likelihood ratio beyond which a body is called missing (-) or present (+), none of all wrongly.

    Bonferroni over the visible bodies.
    """
    return float(
        np.log(max(sum(p.expected > 0 or p.log_ratio != 0 for p in presence), 1) / ((1 - OF_DISPLACED) * alarms))
    )


def surely_elsewhere(presence: Sequence[Presence], alarms: float) -> float:
    """Return the log likelihood ratio beyond which a body is called displaced, none of all wrongly (Bonferroni)."""
    return sure(presence, OF_DISPLACED * alarms / (1 - OF_DISPLACED))


def _presences(case: Case, drawn: Part, survey: Survey) -> list[Presence]:
    """Return the evidence for each feature, corrected for the number of places searched.

    For whole parts that are not clearly present, tones are evaluated too, and for those that then seem missing, the
    edges that they would hide; at last all pixels, which alone tell of those whose edges are too short.
    """
    out = [_by_its_edges(survey, i) for i in range(len(survey.names))]
    tones = Tones(drawn, case.photos, case.world_from_part, survey.shown)
    for i in each(range(len(out)), "looking for bodies", case.tell):
        found, body = out[i], survey.whole_part(i)
        if body is None or found.log_ratio >= DOUBTFUL:
            continue
        if not found.expected:
            asked = survey.in_view(i) and _ends_in_view(case, drawn, survey, body)
            told = _by_pixels(case, drawn, survey, body).beyond_chance if asked else 0.0
            out[i] = replace(found, log_ratio=told)
            continue
        by_tones = tones.log_ratio(body, edges=found.log_ratio, any_light=found.in_any_light)
        if min(found.log_ratio, by_tones) < _RATHER_NOT and by_tones < DOUBTFUL:
            by_tones += _uncovered(case, drawn, survey, body)
        told = _unless_seen(by_tones, found)
        if told < DOUBTFUL:
            told = _with_pixels(told, found.log_ratio, _by_pixels(case, drawn, survey, body))
        out[i] = replace(found, log_ratio=told)
    return out


def _ends_in_view(case: Case, drawn: Part, survey: Survey, body: int) -> bool:
    """Return whether a photo shows where a body ends.

    One that is seen through a hole, or past something, alone has there the border of what hides the rest: all else is
    of its tone, and that of what is behind it may be any in a shadow.
    """
    pose, photos = case.world_from_part, zip(survey.shown, case.photos, strict=True)
    return any(seen.own_border(drawn, photo, pose, body) >= _LEAST_BORDER_PX for seen, photo in photos)


def _unless_seen(by_tones: float, by_edges: Presence) -> float:
    """Return the log likelihood ratio by edges and tones: not clearly negative where the edges alone are for the body.

    Then one of the two is wrong, and tones are the rather: a bar in the open is twice as bright as the light says that
    is fitted to the corner below it. It is in doubt. Nor is it clearly positive where none of its edges is seen: a hole
    is as dark as a screw of some other paint.
    """
    if by_edges.seen == 0:
        return min(by_tones, DOUBTFUL)
    return max(by_tones, -DOUBTFUL) if by_edges.log_ratio > 0 else by_tones


@dataclass(frozen=True, slots=True)
class _Pixels:
    """Log likelihood ratios by all pixels: of a body in its place, and of what it would hide, to anything else."""

    there: float = 0.0
    gone: float = 0.0

    @property
    def beyond_chance(self) -> float:
        """The log likelihood ratio of "present" to "absent" beyond what light and paint alone may make."""
        return max(self.there - _BY_CHANCE, 0.0) - max(self.gone - _BY_CHANCE, 0.0)


def _by_pixels(case: Case, drawn: Part, survey: Survey, body: int) -> _Pixels:
    """Return what all pixels say of a body: in its place, gone, or hidden by something of any tone.

    Nothing is said of a body drawn elsewhere: that place was searched for until it resembled the photos.
    """
    if survey.by[body].any():
        return _Pixels()
    (there,), without, hidden = log_likelihoods(case.photos, case.world_from_part, [drawn], body, survey.shown)
    return _Pixels(float(there - max(without, hidden)), float(without - max(there, hidden)))


def _with_pixels(told: float, by_edges: float, by_pixels: _Pixels) -> float:
    """Return the log likelihood ratio of a doubtful body by edges and tones, and by all its pixels.

    Tones are as good as the light they are predicted by; where each surface may have a tone of its own, only their
    borders and gradients tell. These say too much, but seldom for a body that is not there: its shape would have to be
    in the photo all the same. So for a body they stand in for tones. And where they show neither it nor what it would
    hide, as of a screw that is blacker than in the CAD, it is in doubt.
    """
    if by_pixels.there > _BY_CHANCE:
        return max(told, by_edges + min(by_pixels.there - _BY_CHANCE, _THERE))
    return max(told, -DOUBTFUL) if by_pixels.gone < -_BY_CHANCE else told


def _uncovered(case: Case, drawn: Part, survey: Survey, body: int) -> float:
    """Return what the edges that a body would hide add to its log likelihood ratio; 0 if nothing is behind it."""
    others = around(drawn, case.photos, case.world_from_part, body, survey)
    if not others.any():
        return 0.0
    near = case.alone(others, survey.by)
    return uncovered_ratio(drawn, near, case.photos, case.world_from_part, body, survey)


def _by_its_edges(survey: Survey, number: int) -> Presence:
    rows = survey.rows(number)
    shift = np.hypot(*survey.matched.shift[rows].T).max(initial=0.0)
    cells = max(np.pi * (shift / _CELL_PX) ** 2, 1.0)  # searched before this one, the nearest first
    sizes = max(2 * np.abs(survey.matched.growth[rows]).max(initial=0.0) / _CELL_PX, 1.0)
    return survey.presence(number, elsewhere=float(np.log(cells * sizes)))


def _there(presence: Sequence[Presence]) -> Mask:
    """Return which bodies are rather present than not: those whose edges are measured."""
    return np.array([p.seen > 0 and p.log_ratio > 0 for p in presence], bool)
