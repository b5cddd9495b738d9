"""From photos and a pose to deviations from the CAD: all edges and features, before anything is judged."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Brief, Mask, quantile
from cadcam.cad.edges import EdgeKind
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect_known, expect_numbers
from cadcam.locate.location import Covered, unmeasured
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.adjustment.alarms import false_discoveries_below
from cadcam.verify.bodies.behind import covered_places, hidden_apart
from cadcam.verify.bodies.case import Case
from cadcam.verify.bodies.findings import (
    Findings,
    contradictions,
    elsewhere_by,
    findings_of,
    findings_redrawn,
    surely_elsewhere,
)
from cadcam.verify.bodies.redrawn import off_px
from cadcam.verify.bodies.stages import Stages, each, untold
from cadcam.verify.bodies.states import FeatureEvidence, displaced_px
from cadcam.verify.bodies.whitened import overexposed
from cadcam.verify.deviations.astray import Doubt, broken_edges, chances, side_by_side
from cadcam.verify.deviations.deviation import EdgeDeviation, Extra, FeatureDeviation
from cadcam.verify.deviations.extra import unexplained
from cadcam.verify.deviations.ground import uneven_edges
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges
from cadcam.verify.edges.presence import Presence, in_place_ratio
from cadcam.verify.edges.shifts import CAPTURE_PX
from cadcam.verify.edges.survey import Survey, surveyed
from cadcam.verify.tolerances.tolerance import Tolerances, whole_parts

_SURVEYS, _REDRAW_PX = 3, 0.3  # the lines are redrawn, at most so often, while the datum moves any body's by more
_MOST = 0.9  # share of the lines, of all bodies or of one, that move by no more
_USUAL_PX = 0.1  # common error of an edge, before it is estimated
_LEAST_SEEN = 0.35  # least share of the datum's places that must show an edge for the pose to be believed
_ALONG_SIGHT = 0.5  # share of a motion along the line of sight that is free, from which depth is not known beforehand
_CARRIED = (
    "the datum edges seen do not hold the part: fitted to them it would move by {:.0f} px, and edges were looked for "
    "within {:.0f} px; take more features into the datum, or another photo"
)


@dataclass(frozen=True, slots=True)
class InspectionOptions:
    """reach_px: how far beside their places features are searched for. alarms: accepted share of false alarms.

    At most in that share of pictures any feature is wrongly called displaced (a quarter of it; Holm over features) or
    missing (the rest; Bonferroni over features). Of the edges marked as deviating at most that share does not deviate
    (Benjamini and Hochberg over edges).
    """

    reach_px: float = 8.0
    alarms: float = 0.01

    def __post_init__(self) -> None:
        expect_numbers(self)
        if not 2 <= self.reach_px <= 60:
            raise BadValue("reach_px", self.reach_px, "2 to 60 px")
        if not 0 < self.alarms < 1:
            raise BadValue("alarms", self.alarms, "a share between 0 and 1, such as 0.01")


PLAIN_OPTIONS = InspectionOptions()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Inspection(Brief):
    """What the photos show of a part at a pose.

    pose: fitted to the datum's edges; as unknown as can be where the part was not found. datum: names of the bodies it
    was fitted to; left_out: those that disagree with the others and were not used (never of a stated datum). tau_px:
    common error of an edge; noise_scale: scatter along edges over what the photos' noise predicts; clutter: see
    `cadcam.verify.edges.presence`; seen_share: share of the datum's places where the photos show an edge. found:
    whether the part is where the pose has it; if not, `reason` says why. covered: what something before the part hides,
    where features are unclear because of it. contradictions: names of bodies of a stated datum that do not agree with
    the rest of it.
    """

    pose: PoseEstimate
    features: tuple[FeatureDeviation, ...]
    edges: tuple[EdgeDeviation, ...]
    extra: tuple[Extra, ...]
    datum: tuple[str, ...]
    left_out: tuple[str, ...]
    tau_px: float
    noise_scale: float
    clutter: float
    seen_share: float
    found: bool
    reason: str
    measured: MeasuredEdges | None
    survey: Survey
    passable: float = float("nan")  # log likelihood ratio from which a required feature passes as present
    covered: Covered | None = None
    contradictions: tuple[str, ...] = ()

    @property
    def sized_by_datum(self) -> bool:
        """Return whether lengths are known relative to the datum's in the CAD alone.

        One photo shows a part that is larger as a whole as it shows one that is nearer, where it may be nearer.
        """
        if self.measured is None or self.measured.eye is None:
            return False
        sight = np.r_[self.measured.axis(np.ones(len(self.measured.lines), bool)), np.zeros(3)]
        return bool(np.linalg.norm(self.pose.freedom.T @ sight) > _ALONG_SIGHT)

    def feature(self, name: str) -> FeatureDeviation:
        """Return a feature by its name; raise `UnknownName`, listing them, where there is none."""
        expect_known(name, "feature", [f.name for f in self.features])
        return next(f for f in self.features if f.name == name)


def inspect(
    part: Part,
    photos: Sequence[Photo],
    world_from_part: Rigid,
    *,
    tolerances: Tolerances | None = None,
    options: InspectionOptions = PLAIN_OPTIONS,
    freedom: Array | None = None,
    tell: Stages = untold,
) -> Inspection:
    """Return what deviates from the CAD, given the pose `world_from_part` to a pixel or so.

    tolerances state the features and the datum; by default every body of the model is a feature, and the pose is fitted
    to those that agree: while the worst of them is significantly displaced relative to the others, it is left out (data
    snooping; W. Baarda, Netherlands Geodetic Commission 2/5, 1968). freedom (6, k): motions that are free
    (`PoseEstimate`), default all. tell: called with how far it has come (`cadcam.verify.bodies.stages`). The part is
    not found where the visible edges of the datum do not determine its pose, or hardly any are seen. Raises
    `UnknownName` or `BadValue` for names that the part does not have.
    """
    asked = whole_parts(part.scene) if tolerances is None else tolerances
    asked.check(part.scene)
    F = np.eye(6) if freedom is None else np.asarray(freedom, np.float64)
    pose, contradicting = world_from_part, None
    case = Case(part, photos, pose, asked, F, options.reach_px, options.alarms, tell)
    for _ in range(_SURVEYS):
        case = replace(case, world_from_part=pose)  # keeps what is drawn of bodies apart
        survey = surveyed(part, photos, pose, asked, reach_px=options.reach_px)
        reason = _why_not(survey)
        if reason:
            return _not_found(survey, pose, F, reason)
        try:
            look = findings_of(case, part, survey)
        except DegenerateGeometry as error:
            return _not_found(survey, pose, F, str(error))
        # At the first pose: a datum that contradicts itself leads the next ones astray.
        if survey.stated and contradicting is None:
            contradicting = contradictions(case, look)
        xi = look.measured.adjustment.pose().xi
        moved = np.abs(survey.lines.by_pose @ xi)
        if max(quantile(moved[survey.body == body], _MOST) for body in np.unique(survey.body)) < _REDRAW_PX:
            break
        moved_px = quantile(moved, _MOST)
        if moved_px > options.reach_px:  # farther than edges were searched for: few of them, too few to judge
            return _not_found(survey, pose, F, _CARRIED.format(moved_px, options.reach_px))
        pose = pose @ Rigid.exp(xi)  # there other lines are visible, and fewer mistaken for others
    return replace(_reported(case, findings_redrawn(case, look), options), contradictions=contradicting or ())


def _why_not(survey: Survey) -> str:
    """Return why a survey does not show the part, "" if it does."""
    if not len(survey.lines):
        return "none of the part's edges is in view: check the pose, the camera and the model's unit"
    if not (survey.datum & survey.usable).any():
        return "none of the datum's edges is in view: choose others, or take another photo"
    if survey.seen_share < _LEAST_SEEN:
        seen = (
            f"the photos show an edge at only {100 * survey.seen_share:.0f} % of the places where this pose has one "
            f"(at least {100 * _LEAST_SEEN:.0f} % are needed)"
        )
        behind, covered = covered_places(survey, _USUAL_PX)
        if covered and survey.seen_share_of(~behind) >= _LEAST_SEEN:
            return f"{seen}: {covered}; take it away, or take another view"
        return f"{seen}: the part is not there, or not this part"
    return ""


def _reported(case: Case, look: Findings, options: InspectionOptions) -> Inspection:
    """Return what the last drawing of the bodies shows: of features, of edges, and of what is no part of the model."""
    part, photos = look.drawn, case.photos
    survey, presence, measured = look.survey, look.presence, look.measured
    names = survey.names
    measured, doubts, p_values = _doubted(case, look)
    presence = _placed(survey, presence, measured)
    judged = {f.name for f in case.asked.judged}
    evidence = FeatureEvidence(survey, measured, presence, doubts, p_values, options.reach_px, options.alarms, judged)
    fitted = measured.adjustment.pose()
    by_calibration = fitted.by_cause @ fitted.by_cause.T
    moved = case.world_from_part @ Rigid.exp(fitted.xi)
    pose = PoseEstimate(moved, fitted.covariance, by_calibration, measured.adjustment.freedom, measured.dof)
    features, covered = hidden_apart(survey, overexposed(survey, evidence.deviations()), measured.tau_px)
    shifted = [_shifted(survey, i) for i in range(len(photos))]
    return Inspection(
        pose=pose,
        features=features,
        edges=_edges(case, part, survey, measured, look.measured.members),
        extra=tuple(unexplained(part, photos, pose.world_from_part, shifted=shifted)),
        datum=tuple(names[i] for i in np.unique(measured.body[measured.adjustment.datum])),
        left_out=tuple(names[i] for i in look.left_out),
        tau_px=measured.tau_px,
        noise_scale=measured.noise_scale,
        clutter=survey.clutter.share,
        seen_share=survey.seen_share,
        found=True,
        reason="",
        measured=measured,
        survey=survey,
        passable=float(-np.log(options.alarms)),
        covered=covered,
    )


def _doubted(case: Case, look: Findings) -> tuple[MeasuredEdges, list[Doubt], list[float]]:
    """Return the measurement, each feature's doubt, and its p-value, once edges astray are allowed for.

    Where a feature is in place but for edges astray, the measurement is without these, and no doubt is left: neither
    the feature is measured by them, nor the pose fitted to them, unless it is as stated.
    """
    survey, measured = look.survey, look.measured
    every = range(len(measured.members))
    moved = [measured.moved(i) for i in each(every, "measuring bodies", case.tell)]
    doubted = each(every, "doubting edges", case.tell)
    doubts = [Doubt.of(measured, i, doubted=not _elsewhere(case, look, i, moved[i])) for i in doubted]
    often = chances(doubts, measured, lambda: uneven_edges(survey, case.photos), broken_edges(survey))
    members, p_values, gone = list(measured.members), [], np.zeros(len(measured.lines), bool)
    for i, (found, doubt, chance) in enumerate(zip(moved, doubts, often, strict=True)):
        p_values.append(float("nan") if found is None else doubt.p_value(found.p_value, chance))
        if found is not None and chance.any() and doubt.in_place(found):
            gone |= members[i] & ~doubt.kept
            members[i], doubts[i], p_values[i] = doubt.kept, Doubt(doubt.groups, doubt.own), doubt.rest_p
        elif not chance.any():
            doubts[i] = Doubt(doubt.groups, doubt.own)
    told = replace(measured, members=tuple(members), found={})
    return told if survey.stated else _not_fitted_to(told, gone), doubts, p_values


def _not_fitted_to(measured: MeasuredEdges, places: Mask) -> MeasuredEdges:
    """Return the measurement with the pose not fitted to places (n,); the same where the rest does not hold it."""
    fitted = replace(measured.adjustment, datum=measured.adjustment.datum & ~places, known=None)
    with suppress(DegenerateGeometry):
        fitted.pose()
        return replace(measured, adjustment=fitted)
    return measured


def _elsewhere(case: Case, look: Findings, number: int, moved: Displacement | None) -> bool:
    """Return whether a feature was drawn, and then surely measured, farther off than its edges are searched for.

    Then all pixels that it covers, there or in its place, show that as surely as an alarm requires, not just a few
    edges.
    """
    survey = look.survey
    part = survey.whole_part(number)
    if part is None or not survey.by[part].any():
        return False
    drawn = off_px(survey, survey.members[number], survey.by[part])
    if min(drawn, displaced_px(survey, number, moved)) <= CAPTURE_PX:
        return False
    return elsewhere_by(case, look, part) >= surely_elsewhere(look.presence, case.alarms)


def _placed(survey: Survey, presence: Sequence[Presence], measured: MeasuredEdges) -> list[Presence]:
    """Return the evidence that features are there, including where their seen edges lie."""
    out = []
    larger, outward = np.unique(survey.lines.edge[survey.matched.growth != 0]), measured.lines.outward
    for found, rows in zip(presence, measured.members, strict=True):
        pose = measured.pose_without(rows) if rows.any() and found.log_ratio > 0 else None
        if pose is None:
            out.append(found)
            continue
        groups = side_by_side(measured, rows)
        rim = np.array([np.isin(measured.lines.edge[group], larger).all() for group in groups])
        offset, sigma = np.array([measured.farthest_px(group, pose) for group in groups]).T
        offset *= [outward[group][0] for group in groups]  # pieces of a larger rim are alike off, out of it
        more = in_place_ratio(offset, sigma, survey.clutter.share, rim=rim)
        out.append(replace(found, log_ratio=found.log_ratio + more))
    return out


def _edges(
    case: Case, part: Part, survey: Survey, measured: MeasuredEdges, members: Sequence[Mask]
) -> tuple[EdgeDeviation, ...]:
    """Return the deviation of every edge; `off` are those that deviate, hardly any of them wrongly (`case.alarms`).

    members: the measured places (n,) of each feature, edges astray among them.
    """
    from scipy.special import stdtr

    every = np.unique(survey.lines.edge[survey.usable]).tolist()
    held = np.stack(survey.members, axis=1) if every else np.zeros((0, 0), bool)
    edges = [_edge(part, survey, measured, (held, members), e) for e in each(every, "measuring edges", case.tell)]
    dof = measured.dof
    p_values = [2 * float(stdtr(dof, -abs(e.value) / e.sigma)) if np.isfinite(e.sigma) else np.nan for e in edges]
    off = false_discoveries_below(p_values, case.alarms)
    return tuple(replace(e, off=bool(alarm)) for e, alarm in zip(edges, off, strict=True))


def _edge(
    part: Part, survey: Survey, measured: MeasuredEdges, belonging: tuple[Mask, Sequence[Mask]], number: int
) -> EdgeDeviation:
    """Return the deviation of an edge, and of its pieces, from its place at a pose fitted without it.

    belonging: which places (N, F) each feature holds, and which of those measured (n,).
    """
    lines = survey.lines
    every = (lines.edge == number) & survey.usable
    rows = measured.lines.edge == number
    pose = measured.pose_without(rows) if rows.any() else None
    value, sigma, variances = measured.across(rows, pose=pose)
    own = np.flatnonzero(every)
    its = lines.select(own)  # few of many: no edge keeps the arrays of all
    middle = len(its) // 2
    held, members = belonging[0][own], belonging[1]
    holding = [(survey.names[f], members[f], held[:, f].all()) for f in np.flatnonzero(held.any(axis=0)).tolist()]
    return EdgeDeviation(
        part=part.scene.mesh.part_names[int(its.part[middle])],
        kind=EdgeKind(int(its.kind[middle])).name.lower(),
        chain=int(its.chain[middle]),
        photo=int(its.photo[middle]),
        features=tuple(name for name, _, _ in holding),
        value=value,
        sigma=sigma,
        variances=variances,
        direction=its.direction[middle],
        p=its.p[middle],
        q=its.q,
        mm_per_px=float(np.median(its.mm_per_px)),
        places=len(its),
        seen=int(rows.sum()),
        station=measured.stations(rows, pose=pose),
        held={name: measured.stations(rows & places, pose=pose) for name, places, whole in holding if not whole},
    )


def _shifted(survey: Survey, photo: int) -> Array:
    """Return the places (n, 2) px where the photo shows an edge of the model, wherever that is."""
    rows = (survey.lines.photo == photo) & survey.matched.support
    return np.asarray(survey.lines.q[rows] + survey.matched.coarse[rows, None] * survey.lines.normal[rows])


def _not_found(survey: Survey, world_from_part: Rigid, F: Array, reason: str) -> Inspection:
    """Return the inspection of a part that is not where the pose has it."""
    nan = float("nan")
    pose, share, clutter = unmeasured(world_from_part, F), survey.seen_share, survey.clutter.share
    return Inspection(pose, (), (), (), (), (), nan, nan, clutter, share, False, reason, None, survey)
