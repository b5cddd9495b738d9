"""A located part judged by its tolerances: for each limit what was measured, and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.cad.edges import EdgeKind
from cadcam.errors import BadValue, listed
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_callable, expect_each
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.adjustment.alarms import AS_IN_PLACE
from cadcam.verify.adjustment.datum_fit import Estimate, shares_of
from cadcam.verify.bodies.stages import Stages, untold
from cadcam.verify.deviations.deviation import FeatureDeviation, State, Unclear
from cadcam.verify.deviations.measured import DISAGREE, SEEN_PX, STATION_PX, MeasuredEdges
from cadcam.verify.distances import judged_distance
from cadcam.verify.edges.sightlines import STEP_PX
from cadcam.verify.inspection import PLAIN_OPTIONS, Inspection, InspectionOptions, inspect
from cadcam.verify.reasons import (
    ANOTHER_VIEW,
    IN_VIEW,
    contradicting,
    diameter_words,
    direction_words,
    explained,
    not_found,
    summary,
    unjudged,
    unmeasured,
    vector_words,
    with_remedy,
)
from cadcam.verify.tolerances.tolerance import LARGEST_K, Feature, Limit, Quantity, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict, decided, overall, towards

_NAN = float("nan")
_NEAR_AXIS = np.cos(np.radians(15.0))
_MISTAKEN = 4.0  # scatter along edges, over what is expected (variances), that no noise of a circle's edges makes
_SHOWN = 0.5  # share of an edge that has to be measured before its worst place is known
_NAMED = 3  # most edges named in a reason
_LIGHT = "give more light, or take another view"
_OTHER_SIDE = "add a photo from another side"
_ALONG = f"judge a direction, or {_OTHER_SIDE}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Verification:
    """The verdict on a part, what it follows from, and all that was measured; reason: one line of text."""

    verdict: Verdict
    reason: str
    judgements: tuple[Judgement, ...]
    inspection: Inspection | None
    tolerances: Tolerances
    located: Location

    def __repr__(self) -> str:
        return f"Verification({self.verdict.value}, {len(self.judgements)} judgements, {self.reason!r})"


def verify_part(
    part: Part,
    photos: Sequence[Photo],
    located: Location,
    tolerances: Tolerances,
    *,
    options: InspectionOptions = PLAIN_OPTIONS,
    freedom: Freedom = FREE,
    tell: Stages | None = None,
) -> Verification:
    """Return the verdict on the part that `located` has in the photos.

    The pose is fitted again, to the datum that the tolerances name, and every feature is judged relative to a pose
    fitted without it. A part that was not found gets no verdict but NOT FOUND, and why. Photos that `located` left out
    are not used; where it rests on photos that disagree, no place is judged, because a wrong camera displaces bodies of
    a good part. How far cameras are off that disagree by less is part of U. Of a part without limits the reason says
    what is displaced or missing; of one that does not fail, whether its edges are off as a whole, as by a wrong camera.
    tell: called with how far it has come: a stage's name, pieces done, pieces. Raises as `inspect`.
    """
    expect(part, "part", Part)
    photos = expect_each(photos, "photos", Photo)
    if not photos:
        raise BadValue("photos", "none", "at least one photo")
    expect(located, "located", Location)
    expect(tolerances, "tolerances", Tolerances)
    expect(options, "options", InspectionOptions)
    expect(freedom, "freedom", Freedom)
    expect_callable(tell, "tell", optional=True)
    tell = tell or untold
    tolerances.check(part.scene)
    if not located.found:
        return _nothing(not_found(located, photos, freedom), tolerances, located, None)
    pose: Rigid = located.pose.world_from_part
    kept = [k for k in range(len(photos)) if k not in located.left_out]
    few = [_as_sure(photos[k], part, located) for k in kept]
    seen = inspect(part, few, pose, tolerances=tolerances, options=options, freedom=freedom.at(pose), tell=tell)
    if not seen.found:
        return _nothing(seen.reason, tolerances, located, seen)
    seen = _in_agreement(seen, kept, disputed=located.disputed)
    judgements = tuple(j for f in tolerances.features for j in judged(f, seen))
    judgements += tuple(judged_distance(d, tolerances, part.scene, seen) for d in tolerances.distances)
    verdict = overall(j.verdict for j in judgements)
    beside = [] if judgements else [said for said in [unjudged(seen.features)] if said]
    open_ = verdict is Verdict.UNDECIDED or not judgements
    before = [str(seen.covered)] if seen.covered and open_ else []
    datum = [contradicting(seen.contradictions)] if seen.contradictions else []
    amiss = [located.amiss] if located.amiss and verdict is not Verdict.FAIL else []  # of a bad part no wonder
    reason = "; ".join(
        [
            summary(verdict, judgements, one_photo=_one_photo(seen)),
            *beside,
            *datum,
            *before,
            *amiss,
            *map(str, located.disagreements),
        ]
    )
    return Verification(verdict, reason, judgements, seen, tolerances, located)


def _as_sure(photo: Photo, part: Part, located: Location) -> Photo:
    """Return a photo whose camera is as unsure of its place and direction as all photos together show it to be."""
    mm = located.cameras_off_mm
    if mm == 0:
        return photo
    view = photo.viewpoint
    away = float(np.linalg.norm(located.pose.world_from_part @ part.aspects.centre - view.camera_from_world.origin))
    return replace(photo, viewpoint=view.less_sure(mm, mm / away, why="photos that disagree"))


def _in_agreement(seen: Inspection, kept: Sequence[int], *, disputed: bool) -> Inspection:
    """Return what was seen in the photos kept, numbered as all; no displacements where they disagree."""
    features = tuple(f.disputed() for f in seen.features) if disputed else seen.features
    edges = tuple(replace(e, photo=kept[e.photo], off=e.off and not disputed) for e in seen.edges)
    extra = tuple(replace(e, photo=kept[e.photo]) for e in seen.extra)
    return replace(seen, features=features, edges=edges, extra=extra)


def judged(feature: Feature, seen: Inspection) -> list[Judgement]:
    """Return a judgement for each limit of a feature."""
    found = seen.feature(feature.name)
    return [with_remedy(_judgement(feature.name, limit, found, seen)) for limit in feature.limits]


def _judgement(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    if limit.quantity is Quantity.PRESENCE:
        return _presence(name, limit, found, seen)
    without = unmeasured(found)
    if without is not None:
        verdict, reason, remedy = without
        return Judgement(name, limit, _NAN, _NAN, verdict, reason, remedy)
    return _QUANTITIES[limit.quantity](name, limit, found, seen)


def _presence(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge whether a required feature is there."""
    p = found.presence
    said = f"{p.seen} of {p.expected} edges that should show are seen"
    if not p.expected:
        said = "its surfaces are seen" if p.log_ratio > 0 else "what is behind it is seen"
    if found.state is State.MISSING:
        return Judgement(name, limit, _NAN, _NAN, Verdict.FAIL, f"missing: {said}")
    if p.log_ratio >= seen.passable:
        return Judgement(name, limit, _NAN, _NAN, Verdict.PASS, said)
    if p.expected == 0:
        reason, remedy = (found.why.value, found.why.remedy) if found.why else ("not in view", IN_VIEW)
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, reason, remedy)
    remedy = found.why.remedy if found.why else ANOTHER_VIEW
    too_few = f"too few to be sure that these are its own: {remedy}" if p.seen else remedy
    why = f"{said}: {Unclear.BEHIND.value if found.why is Unclear.BEHIND else too_few}"
    return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, why, remedy)


def _position(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge a feature's displacement in all directions that the photos show, or in those that the limit names."""
    if limit.direction is not None:
        return _along(name, limit, seen)
    if limit.axis is not None:
        return _across(name, limit, seen)
    assert found.displacement is not None  # else the feature is unclear
    reason = f"displaced by {vector_words(found.vector)} mm{' across the line of sight' if _one_photo(seen) else ''}"
    return _length(name, limit, found.displacement, found.p_value, reason, (_unseen(found, seen), _ALONG))


def _length(
    name: str, limit: Limit, moved: Estimate, p_value: float, reason: str, unseen: tuple[Array | None, str]
) -> Judgement:
    """Judge the length of a displacement; unseen: a direction (3,) in which it would not show, and what shows it."""
    size, sigma = float(np.linalg.norm(moved.value)), towards(moved.value, moved.covariance, limit)
    judgement = partial(Judgement, name, limit, size, sigma)
    if moved.misfit > DISAGREE:
        return judgement(Verdict.UNDECIDED, f"{reason}, but its edges do not agree on one place", ANOTHER_VIEW)
    verdict = decided(size, sigma, limit)
    if verdict is Verdict.FAIL and p_value > AS_IN_PLACE:  # by a few pixels, or hardly visible there
        as_likely = f"but its edges are as likely (p {p_value:.2g}) of a feature in place"
        return judgement(Verdict.UNDECIDED, f"{reason}, {as_likely}", ANOTHER_VIEW)
    hidden, remedy = unseen
    if verdict is Verdict.PASS and hidden is not None:
        but = f"but a displacement {_towards(hidden)} would not show: {remedy}"
        return judgement(Verdict.UNDECIDED, f"{reason}, {but}", remedy)
    return explained(judgement(verdict, reason), moved.shares)


def _unseen(found: FeatureDeviation, seen: Inspection) -> Array | None:
    """Return a direction (3,) in which a displacement would not show; None if it shows in all that are judged.

    By one photo nothing is judged along the line of sight. Zeros: it shows in no direction.
    """
    one_photo, shown = _one_photo(seen), found.seen.shape[1]
    if shown >= (2 if one_photo else 3):
        return None
    if not shown:
        return np.zeros(3)
    return np.cross(found.axis, found.seen[:, 0]) if one_photo else np.linalg.svd(found.seen)[0][:, -1]


def _one_photo(seen: Inspection) -> bool:
    return seen.measured is not None and seen.measured.eye is not None


def _along(name: str, limit: Limit, seen: Inspection) -> Judgement:
    """Judge the displacement in the direction that a limit names."""
    assert seen.measured is not None  # only of inspections that found the part
    rows = seen.measured.members[seen.survey.names.index(name)]
    moved = seen.measured.displacement(rows, along=limit.basis)
    if moved is None:
        unseen = "the photos do not show this direction"
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, unseen, _OTHER_SIDE)
    value, sigma = float(moved.estimate.value[0]) - limit.middle, float(np.sqrt(moved.estimate.covariance[0, 0]))
    said = f"measured along {direction_words(moved.basis[:, 0])}, as if it were in place across it"
    if moved.estimate.misfit > DISAGREE:
        but = f"{said}, but its edges do not agree on one place"
        return Judgement(name, limit, value, sigma, Verdict.UNDECIDED, but, ANOTHER_VIEW)
    return explained(Judgement(name, limit, value, sigma, decided(value, sigma, limit), said), moved.estimate.shares)


def _across(name: str, limit: Limit, seen: Inspection) -> Judgement:
    """Judge the displacement across the axis that a limit names, of a feature in place along it."""
    assert seen.measured is not None  # only of inspections that found the part
    assert limit.axis is not None
    number = seen.survey.names.index(name)
    rows, circles = seen.measured.members[number], seen.survey.circles[number]
    moved = seen.measured.displacement(rows, along=limit.basis)
    if moved is None:
        unseen = "the photos do not show a displacement across its axis"
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, unseen, _OTHER_SIDE)
    across = f"displaced by {vector_words(moved.vector)} mm across {direction_words(limit.axis)}"
    reason = f"{across}, as if it were in place along it"
    told = None if circles is None else seen.measured.grown(rows, circles.axis)
    if told is not None and _mistaken(*told):
        size, sigma = moved.estimate.value, towards(moved.estimate.value, moved.estimate.covariance, limit)
        but = f"{reason}, but its edges do not agree on one place and size"
        return Judgement(name, limit, float(np.linalg.norm(size)), sigma, Verdict.UNDECIDED, but, ANOTHER_VIEW)
    hidden = np.cross(limit.axis, moved.basis[:, 0]) if moved.basis.shape[1] < 2 or not moved.known else None
    return _length(name, limit, moved.estimate, moved.p_value, reason, (hidden, _OTHER_SIDE))


def _angle(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge the turn of a feature: by one photo that about the line of sight, by several that about any axis."""
    if not np.isfinite(found.turn_sigma):
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, "its edges do not show a turn", ANOTHER_VIEW)
    assert seen.measured is not None  # only of inspections that found the part
    rows = seen.measured.members[seen.survey.names.index(name)]
    if seen.measured.eye is None:
        return _about_any_axis(name, limit, seen.measured, rows)
    verdict, shown = decided(found.turn, found.turn_sigma, limit), seen.measured.turns(rows, found.axis[:, None])
    about = f"turned about the line of sight, {vector_words(found.axis)}; one photo judges no other turn"
    judgement = Judgement(name, limit, found.turn, found.turn_sigma, verdict, about)
    return judgement if shown is None else _if_agreed(judgement, shown[1])


def _if_agreed(judgement: Judgement, turned: Estimate) -> Judgement:
    """Return a judgement of a turn with what it says of its uncertainty; undecided where the edges show no one turn."""
    if turned.misfit > DISAGREE:
        reason = f"{judgement.reason}, but its edges do not agree on one turn"
        return replace(judgement, verdict=Verdict.UNDECIDED, reason=reason, remedy=ANOTHER_VIEW)
    return explained(judgement, turned.shares)


def _about_any_axis(name: str, limit: Limit, measured: MeasuredEdges, rows: Mask) -> Judgement:
    """Judge the turn about the axes that photos show well enough; it only passes if those are all there are."""
    shown = measured.turns(rows, np.eye(3))
    if shown is None:
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, "its edges do not show a turn", ANOTHER_VIEW)
    axes, turned = shown
    w, V = np.linalg.eigh(turned.covariance)
    V = V[:, : max(1, int((limit.k * np.sqrt(np.maximum(w, 0.0)) < limit.value).sum()))]
    axes, turned = axes @ V, turned.along(V.T)
    size, sigma = float(np.linalg.norm(turned.value)), towards(turned.value, turned.covariance, limit)
    verdict = decided(size, sigma, limit)
    reason = f"turned about {vector_words(axes @ turned.value / size)}" if size > 0 else "not turned"
    judgement = Judgement(name, limit, size, sigma, verdict, reason)
    if verdict is Verdict.PASS and axes.shape[1] < 3:
        unsure = _towards(np.linalg.svd(axes)[0][:, -1]).replace("along", "about")
        hidden = f"{reason}, but a turn {unsure} is not known well enough: {_OTHER_SIDE}"
        return replace(judgement, verdict=Verdict.UNDECIDED, reason=hidden, remedy=_OTHER_SIDE)
    return _if_agreed(judgement, turned)


def _diameter(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge by how much circles about one axis are larger than the CAD's, wherever they are."""
    assert seen.measured is not None  # only of inspections that found the part
    number = seen.survey.names.index(name)
    rows, circles = seen.measured.members[number], seen.survey.circles[number]
    assert circles is not None  # of what a diameter is asked
    told = seen.measured.grown(rows, circles.axis)
    if told is None or not np.sqrt(told[0].covariance[0, 0]) < 2 * SEEN_PX * seen.survey.mm_per_px(number):
        unsure = "the photos do not tell its size from a displacement"
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, unsure, _OTHER_SIDE)
    grown, scatter = told
    value, sigma = float(grown.value[0]) - limit.middle, float(np.sqrt(grown.covariance[0, 0]))
    said = diameter_words(float(grown.value[0]), limit, circles.radii)
    if _mistaken(grown, scatter):
        reason = f"{said}, but its edges do not agree on one size"
        return Judgement(name, limit, value, sigma, Verdict.UNDECIDED, reason, ANOTHER_VIEW)
    return explained(Judgement(name, limit, value, sigma, decided(value, sigma, limit), said), grown.shares)


def _mistaken(grown: Estimate, scatter: float) -> bool:
    """Return whether the edges of circles show no one place and size: some of them are taken for others."""
    return grown.misfit > DISAGREE or scatter > _MISTAKEN


def _profile(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge the pieces of all edges, with k raised so that any of them errs as rarely as a single one would."""
    pieces = [(s, e) for e in seen.edges for s in e.stations_of(name) if np.isfinite(s[2])]
    if not pieces:
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, "none of its edges is seen", Unclear.UNSEEN.remedy)
    _, value, sigma, *variances = np.array([s for s, _ in pieces]).T
    each = replace(limit, k=together(limit.k, len(pieces)))
    verdicts = [decided(v, s, each) for v, s in zip(value.tolist(), sigma.tolist(), strict=True)]
    verdict = overall(verdicts)
    bad = np.abs(value) + (each.k * sigma if verdict is Verdict.PASS else 0.0)
    worst = int(np.argmax(np.where([v is verdict for v in verdicts], bad, -np.inf)))
    reason = f"worst of {len(pieces)} pieces, on {pieces[worst][1].name}; k {each.k:.2f} for all together"
    found_there = Judgement(name, each, float(value[worst]), float(sigma[worst]), verdict, reason)
    if verdict is Verdict.PASS and (unseen := _unseen_edges(name, seen)):
        but = f"but {listed(unseen, _NAMED)} {'is' if len(unseen) == 1 else 'are'} not seen, or only in part"
        return replace(found_there, verdict=Verdict.UNDECIDED, reason=f"{reason}, {but}", remedy=_LIGHT)
    return explained(found_there, shares_of([by[worst] for by in variances]))


def _unseen_edges(name: str, seen: Inspection) -> list[str]:
    """Return which edges of a feature, in view for longer than two pieces, are not measured by half: they may be off.

    One that is off by more than edges are searched for, or has no contrast, says nothing of how far it is off. A place
    is known where some photo shows the edge within half a piece of it: near its ends other lines come near.
    """
    from scipy.spatial import cKDTree

    assert seen.measured is not None  # only of inspections that found the part
    number = seen.survey.names.index(name)
    in_view, measured = seen.survey.lines.select(seen.survey.members[number]), seen.measured.lines
    measured = measured.select(seen.measured.members[number])
    out = []
    for chain in np.unique(in_view.chain):
        asked, shown = in_view.select(in_view.chain == chain), measured.p[measured.chain == chain]
        if STEP_PX * np.bincount(asked.photo).max() <= 2 * STATION_PX:
            continue
        away = np.asarray(cKDTree(shown).query(asked.p)[0]) if len(shown) else np.full(len(asked), np.inf)
        if np.mean(away <= STATION_PX / 2 * asked.mm_per_px) < _SHOWN:
            kind = EdgeKind(int(asked.kind[0])).name.lower()
            out.append(f"{kind} {chain}" if chain >= 0 else kind)
    return out


_QUANTITIES: dict[Quantity, Callable[[str, Limit, FeatureDeviation, Inspection], Judgement]] = {
    Quantity.POSITION: _position,
    Quantity.ANGLE: _angle,
    Quantity.PROFILE: _profile,
    Quantity.DIAMETER: _diameter,
}


def together(k: float, n: int) -> float:
    """Return the coverage factor at which any of n independent values errs as rarely as one does at k.

    No more than a limit may have: there one value errs in 1e197, and whether several do is no question.
    """
    from scipy.special import ndtr, ndtri

    return min(float(-ndtri(-np.expm1(np.log1p(-ndtr(-k)) / n))), LARGEST_K)


def _nothing(reason: str, tolerances: Tolerances, located: Location, seen: Inspection | None) -> Verification:
    limits = [(f.name, limit) for f in tolerances.features for limit in f.limits]
    limits += [(d.name, d.limit) for d in tolerances.distances]
    judgements = tuple(
        Judgement(name, limit, _NAN, _NAN, Verdict.NOT_FOUND, "the part was not found") for name, limit in limits
    )
    return Verification(Verdict.NOT_FOUND, reason, judgements, seen, tolerances, located)


def _towards(v: Array) -> str:
    """Return a direction (3,) of unknown sign, for people: by the axis near it, or its components."""
    axis = int(np.argmax(np.abs(v)))
    d = v * (np.sign(v[axis]) or 1.0)
    return f"nearly along {'xyz'[axis]}" if d[axis] >= _NEAR_AXIS * np.linalg.norm(d) else f"along {vector_words(d)}"
