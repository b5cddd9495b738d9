"""A located part judged by its tolerances: for each limit what was measured, and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.adjustment.alarms import AS_IN_PLACE
from cadcam.verify.deviations.deviation import FeatureDeviation, State
from cadcam.verify.deviations.measured import DISAGREE
from cadcam.verify.inspection import PLAIN_OPTIONS, Inspection, InspectionOptions, inspect
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict, decided, overall, towards

_NAN = float("nan")
_NAMED = 3  # most failing features named in the summary
_AXIS = 1e-9  # largest deviation of a direction from an axis by rounding
_NEAR_AXIS = np.cos(np.radians(15.0))
_ANOTHER_VIEW, _IN_VIEW = "take another view", "take a photo that shows it"
_ALONG = "judge a direction, or add a photo from another side"
_LESS_OF = {
    "noise": "more light, or go closer",
    "edges": "go closer, or take another view",
    "pose": "take more of the part into the picture",
    "calibration": "calibrate the camera better",
}


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """The verdict on a part, what it follows from, and all that was measured; reason: one line of text."""

    verdict: Verdict
    reason: str
    judgements: tuple[Judgement, ...]
    inspection: Inspection | None
    tolerances: Tolerances
    located: Location


def verify_part(
    part: Part,
    photos: Sequence[Photo],
    located: Location,
    tolerances: Tolerances,
    *,
    options: InspectionOptions = PLAIN_OPTIONS,
    freedom: Freedom = FREE,
) -> Verification:
    """Return the verdict on the part that `located` has in the photos.

    The pose is fitted again, to the datum that the tolerances name, and every feature is judged relative to a pose
    fitted without it. A part that was not found gets no verdict but NOT FOUND, and why. Photos that `located` left out
    are not used; where it rests on photos that disagree, no place is judged, because a wrong camera displaces bodies of
    a good part. How far cameras are off that disagree by less is part of U. Raises as `inspect`.
    """
    tolerances.check(part.scene)
    if not located.found:
        return _nothing(f"the part was not found: {located.reason or 'no pose fits'}", tolerances, located, None)
    pose: Rigid = located.pose.world_from_part
    kept = [k for k in range(len(photos)) if k not in located.left_out]
    few = [_as_sure(photos[k], part, located) for k in kept]
    seen = inspect(part, few, pose, tolerances=tolerances, options=options, freedom=freedom.at(pose))
    if not seen.found:
        return _nothing(seen.reason, tolerances, located, seen)
    seen = _in_agreement(seen, kept, disputed=located.disputed)
    judgements = tuple(j for f in tolerances.features for j in judged(f, seen))
    verdict = overall(j.verdict for j in judgements)
    reason = "; ".join([_why(verdict, judgements), *map(str, located.disagreements)])
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
    return [_judgement(feature.name, limit, found, seen) for limit in feature.limits]


def _judgement(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    if limit.quantity is Quantity.PRESENCE:
        return _presence(name, limit, found, seen)
    unclear = (found.why.value, found.why.remedy) if found.why else ("its edges do not tell where it is", _ANOTHER_VIEW)
    without = {
        State.MISSING: (Verdict.NOT_FOUND, "it is missing: nothing of it to measure", ""),
        State.OUT_OF_VIEW: (Verdict.UNDECIDED, "not in view", _IN_VIEW),
        State.UNCLEAR: (Verdict.UNDECIDED, *unclear),
    }
    if found.state in without:
        verdict, reason, remedy = without[found.state]
        return Judgement(name, limit, _NAN, _NAN, verdict, reason, remedy)
    out = _QUANTITIES[limit.quantity](name, limit, found, seen)
    if out.verdict is Verdict.UNDECIDED and not out.remedy:
        return replace(out, remedy=_closer(found))
    return out


def _closer(found: FeatureDeviation) -> str:
    """Return how to improve a deviation too near to its limit: reduce the cause of most of its uncertainty."""
    shares = found.shares
    return "measure it more surely: " + _LESS_OF.get(
        max(shares, key=lambda c: shares[c]) if shares else "", _ANOTHER_VIEW
    )


def _presence(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge whether a required feature is there."""
    p = found.presence
    said = f"{p.seen} of {p.expected} edges that should show are seen"
    if found.state is State.MISSING:
        return Judgement(name, limit, _NAN, _NAN, Verdict.FAIL, f"missing: {said}")
    if p.log_ratio >= seen.passable:
        return Judgement(name, limit, _NAN, _NAN, Verdict.PASS, said)
    if p.expected == 0:
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, "not in view", _IN_VIEW)
    remedy = found.why.remedy if found.why else _ANOTHER_VIEW
    why = f"{said}: too few to be sure that these are its own: {remedy}"
    return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, why, remedy)


def _position(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge a feature's displacement in all directions that the photos show, or in the one that the limit names."""
    if limit.direction is not None:
        return _along(name, limit, seen)
    assert found.displacement is not None  # else the feature is unclear
    sigma = towards(found.displacement.value, found.displacement.covariance, limit)
    judgement = partial(Judgement, name, limit, found.size, sigma)
    if found.displacement.misfit > DISAGREE:
        return judgement(Verdict.UNDECIDED, "its edges do not agree on one place")
    verdict = decided(found.size, sigma, limit)
    reason = f"displaced by {_vector(found.vector)} mm"
    if verdict is Verdict.FAIL and found.p_value > AS_IN_PLACE:  # by a few pixels, or hardly visible there
        as_likely = f"but its edges are as likely (p {found.p_value:.2g}) of a feature in place"
        return judgement(Verdict.UNDECIDED, f"{reason}, {as_likely}")
    unseen = _unseen(found, seen)
    if verdict is Verdict.PASS and unseen is not None:
        hidden = f"but a displacement {_towards(unseen)} would not show: {_ALONG}"
        return judgement(Verdict.UNDECIDED, f"{reason}, {hidden}", _ALONG)
    return judgement(verdict, reason)


def _unseen(found: FeatureDeviation, seen: Inspection) -> Array | None:
    """Return a direction (3,) in which a displacement would not show; None if it shows in all that are judged.

    By one photo nothing is judged along the line of sight. Zeros: it shows in no direction.
    """
    one_photo = seen.measured is not None and seen.measured.eye is not None
    shown = found.seen.shape[1]
    if shown >= (2 if one_photo else 3):
        return None
    if not shown:
        return np.zeros(3)
    return np.cross(found.axis, found.seen[:, 0]) if one_photo else np.linalg.svd(found.seen)[0][:, -1]


def _along(name: str, limit: Limit, seen: Inspection) -> Judgement:
    """Judge the displacement in the direction that a limit names."""
    assert seen.measured is not None  # only of inspections that found the part
    rows = seen.measured.members[seen.survey.names.index(name)]
    moved = seen.measured.displacement(rows, along=limit.direction)
    if moved is None:
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, "the photos do not show this direction")
    value, sigma = float(moved.estimate.value[0]), float(np.sqrt(moved.estimate.covariance[0, 0]))
    said = f"measured along {direction_words(moved.basis[:, 0])}, as if it were in place across it"
    return Judgement(name, limit, value, sigma, decided(value, sigma, limit), said)


def _angle(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge the turn of a feature about the line of sight."""
    if not np.isfinite(found.turn_sigma):
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, "its edges do not show a turn")
    verdict = decided(found.turn, found.turn_sigma, limit)
    return Judgement(name, limit, found.turn, found.turn_sigma, verdict, f"turned about {_vector(found.axis)}")


def _profile(name: str, limit: Limit, found: FeatureDeviation, seen: Inspection) -> Judgement:
    """Judge the pieces of all edges, with k raised so that any of them errs as rarely as a single one would."""
    pieces = [(s, e) for e in seen.edges if name in e.features for s in e.station if np.isfinite(s[2])]
    if not pieces:
        return Judgement(name, limit, _NAN, _NAN, Verdict.UNDECIDED, "none of its edges is seen")
    each = replace(limit, k=together(limit.k, len(pieces)))
    verdicts = [decided(s[1], s[2], each) for s, _ in pieces]
    verdict = overall(verdicts)
    of = [i for i, v in enumerate(verdicts) if v is verdict]
    worst = max(of, key=lambda i: abs(pieces[i][0][1]) + (each.k * pieces[i][0][2] if verdict is Verdict.PASS else 0))
    station, edge = pieces[worst]
    where = f"{edge.kind} {edge.chain} of {edge.part}"
    reason = f"worst of {len(pieces)} pieces, on {where}; k {each.k:.2f} for all together"
    return Judgement(name, each, float(station[1]), float(station[2]), verdict, reason)


_QUANTITIES: dict[Quantity, Callable[[str, Limit, FeatureDeviation, Inspection], Judgement]] = {
    Quantity.POSITION: _position,
    Quantity.ANGLE: _angle,
    Quantity.PROFILE: _profile,
}


def together(k: float, n: int) -> float:
    """Return the coverage factor at which any of n independent values errs as rarely as one does at k."""
    from scipy.special import ndtr, ndtri

    return float(-ndtri(-np.expm1(np.log1p(-ndtr(-k)) / n)))


def _why(verdict: Verdict, judgements: Sequence[Judgement]) -> str:
    """Return the verdict's reason in one line: what fails, or what cannot be decided."""
    if not judgements:
        return "no limits given: nothing was judged"
    if verdict is Verdict.PASS:
        return f"all {len(judgements)} limits are kept, uncertainty included"
    if verdict is Verdict.FAIL:
        said = [_failed(j) for j in judgements if j.verdict is Verdict.FAIL]
    else:
        of = [j for j in judgements if j.verdict in (Verdict.UNDECIDED, Verdict.NOT_FOUND)]
        said = [f"{j.feature}: {j.limit.quantity.name.lower()} cannot be decided ({j.reason})" for j in of[:1]]
        said += [""] * (len(of) - 1)
    named = [text for text in said[:_NAMED] if text]
    more = len(said) - len(named)
    return "; ".join([*named, *([f"and {more} more"] if more else [])])


def _failed(j: Judgement) -> str:
    """Return in words what is wrong with a feature that failed."""
    quantity, name = j.limit.quantity, j.feature
    if quantity is Quantity.PRESENCE:
        return f"{name} is missing"
    if quantity is Quantity.ANGLE:
        turn, U, limit = (np.degrees(x) for x in (j.deviation, j.U, j.limit.value))
        return f"{name} is turned by {turn:.2f} +- {U:.2f} deg, limit {limit:.3g} deg"
    what = "has a piece of edge" if quantity is Quantity.PROFILE else "is"
    along = "" if j.limit.direction is None else f" along {direction_words(j.limit.direction)}"
    return f"{name} {what} {j.deviation:.2f} +- {j.U:.2f} mm off its place{along}, limit {j.limit.value:.3g} mm"


def _nothing(reason: str, tolerances: Tolerances, located: Location, seen: Inspection | None) -> Verification:
    judgements = tuple(
        Judgement(f.name, limit, _NAN, _NAN, Verdict.NOT_FOUND, "the part was not found")
        for f in tolerances.features
        for limit in f.limits
    )
    return Verification(Verdict.NOT_FOUND, reason, judgements, seen, tolerances, located)


def direction_words(v: Sequence[float] | Array) -> str:
    """Return a direction in the part's axes: the axis' name if it is one, else its components."""
    d = np.asarray(v, np.float64)
    axis = int(np.argmax(np.abs(d)))
    if np.abs(d).sum() - abs(d[axis]) < _AXIS * abs(d[axis]):
        return f"{'-' if d[axis] < 0 else ''}{'xyz'[axis]}"
    return _vector(d)


def _towards(v: Array) -> str:
    """Return a direction (3,) of unknown sign, for people: by the axis near it, or its components."""
    axis = int(np.argmax(np.abs(v)))
    d = v * (np.sign(v[axis]) or 1.0)
    return f"nearly along {'xyz'[axis]}" if d[axis] >= _NEAR_AXIS * np.linalg.norm(d) else f"along {_vector(d)}"


def _vector(v: Array) -> str:
    return "(" + ", ".join(f"{0.0 if abs(x) < 5e-4 else x:.2f}" for x in v) + ")"
