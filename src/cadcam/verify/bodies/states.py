"""The state of each feature: in place, displaced, missing, out of view, the datum itself; or unclear, and why."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.verify.adjustment.alarms import AS_IN_PLACE, surely_below, tail_probability
from cadcam.verify.bodies.findings import DOUBTFUL, sure
from cadcam.verify.bodies.snooping import OF_DISPLACED
from cadcam.verify.deviations.astray import Doubt
from cadcam.verify.deviations.deviation import FeatureDeviation, State, Unclear
from cadcam.verify.deviations.measured import DISAGREE, Displacement, MeasuredEdges, of_known_size
from cadcam.verify.deviations.unclear import holds_pose, why_doubtful, why_untold
from cadcam.verify.edges.presence import Presence
from cadcam.verify.edges.shifts import CAPTURE_PX
from cadcam.verify.edges.survey import Survey

_CONTRADICTS = 0.01  # probability below which a displacement is not that of a feature in place
_DIFFER = 4.0  # misfit from which edges alarm only by what they say together
_MAY_BE_ABSENT = (Unclear.SHORT_EDGES, Unclear.UNSEEN, Unclear.DOUBTFUL)  # what is measured may be something else


@dataclass(frozen=True, slots=True, eq=False)
class FeatureEvidence:
    """All that is known of the features of a survey, from which their states follow.

    Of each feature, presence: the evidence that it is there; doubts: about its edges; p_values: the probability, for a
    feature in place, of what they show, nan where they show nothing. reach_px: how far beside their places features
    were searched for; alarms: accepted share of false alarms; judged: names of the features of which something is
    asked.
    """

    survey: Survey
    measured: MeasuredEdges
    presence: Sequence[Presence]
    doubts: Sequence[Doubt]
    p_values: Sequence[float]
    reach_px: float
    alarms: float
    judged: Collection[str] = ()

    def deviations(self) -> tuple[FeatureDeviation, ...]:
        """Return the state and displacement of each feature."""
        enough = sure(self.presence, self.alarms)
        displaced = surely_below(self.p_values, OF_DISPLACED * self.alarms)
        return tuple(self._deviation(i, bool(alarm), enough) for i, alarm in enumerate(displaced))

    def _deviation(self, number: int, alarm: bool, enough: float) -> FeatureDeviation:
        """Return the deviation of a feature; alarm: whether its p-value calls it displaced.

        enough: log likelihood ratio from which it is surely there, or surely missing.
        """
        moved = self.measured.moved(number)
        near, rare = displaced_px(self.survey, number, moved) <= CAPTURE_PX, OF_DISPLACED * self.alarms
        state, why = state_of(self.presence[number], moved, alarm, enough, near=near, rare=rare)
        if state is State.OUT_OF_VIEW and self.survey.in_view(number):
            state, why = State.UNCLEAR, why_doubtful(self.presence[number])
        if state in (State.DISPLACED, State.IN_PLACE) and self._beyond_reach(number, moved):
            state, why = State.UNCLEAR, Unclear.FAR
        if state is State.IN_PLACE and self.doubts[number].gone:
            state, why = State.UNCLEAR, Unclear.ASTRAY
        if state is State.UNCLEAR and why is None:
            why = why_untold(self.survey, self.measured, number, moved)
        if self._is_the_datum(number, why):
            state, why = State.DATUM, None
        told = moved if state is State.DISPLACED else None if why in _MAY_BE_ABSENT else believed(moved)
        return replace(self._feature(number, state, told), p_value=self.p_values[number], why=why)

    def _is_the_datum(self, number: int, why: Unclear | None) -> bool:
        """Return whether nothing is left to compare a feature with because what is judged is measured from it."""
        if self.survey.names[number] in self.judged or not holds_pose(self.measured, number):
            return False
        return why is Unclear.POSE or (why is Unclear.ALONE_IN_MODEL and bool(self.judged))

    def _beyond_reach(self, number: int, moved: Displacement | None) -> bool:
        """Return whether a displacement exceeds the search range: then its edges are not those assigned to it."""
        return displaced_px(self.survey, number, moved) > 2 * self.reach_px

    def _feature(self, number: int, state: State, moved: Displacement | None) -> FeatureDeviation:
        """Return a feature in a state, with its displacement as far as that is believed."""
        survey, measured = self.survey, self.measured
        rows, every = measured.members[number], survey.rows(number)
        found = FeatureDeviation(
            name=survey.names[number],
            state=state,
            presence=self.presence[number],
            seen=np.zeros((3, 0)),
            displacement=None,
            p=survey.lines.p[every].mean(axis=0) if every.any() else np.full(3, np.nan),
            datum=bool(measured.adjustment.datum[rows].any()),
        )
        if moved is None:
            return found
        turn, turn_sigma, axis = measured.turn(rows)
        return replace(
            found,
            seen=moved.basis,
            displacement=moved.estimate,
            turn=turn,
            turn_sigma=turn_sigma,
            axis=axis,
            p=measured.lines.p[rows].mean(axis=0),
        )


def state_of(
    presence: Presence, moved: Displacement | None, alarm: bool, enough: float, *, near: bool, rare: float
) -> tuple[State, Unclear | None]:
    """Return the state of a feature; of an unclear one also the reason, as far as it follows from this evidence.

    alarm: whether its p-value calls it displaced. enough: log likelihood ratio from which it is surely there, or
    missing. near: whether it is displaced by no more than edges are captured from. rare: accepted share of false alarms
    of displacements; where edges disagree, their joint evidence has to meet it.
    """
    if presence.log_ratio <= -enough:
        return State.MISSING, None
    if presence.expected == 0 and moved is None:
        return State.OUT_OF_VIEW, None
    if presence.log_ratio < (0.0 if alarm else DOUBTFUL):  # what is measured may be something else
        return State.UNCLEAR, why_doubtful(presence)
    if moved is None:
        return State.UNCLEAR, None
    alone = presence.seen < 2 and (not near or presence.expected > 2)
    if alarm and moved.edges < 2 and alone and presence.log_ratio < enough:
        return State.UNCLEAR, Unclear.ALONE  # others ought to be seen, or the body is far off
    if not alarm and believed(moved) is None:
        return State.UNCLEAR, None  # what cannot be measured is not known to be in place either
    if alarm and moved.misfit > _DIFFER and _if_none(moved, _dof(moved)) > rare:
        return State.UNCLEAR, Unclear.CONTRADICTS  # its edges are off, but by no common displacement
    return (State.DISPLACED if alarm else State.IN_PLACE), None


def displaced_px(survey: Survey, number: int, moved: Displacement | None) -> float:
    """Return how far (px) a displacement moves a feature in a photo, 0 where there is none."""
    return 0.0 if moved is None else float(np.linalg.norm(moved.estimate.value)) / survey.mm_per_px(number)


def believed(moved: Displacement | None) -> Displacement | None:
    """Return a displacement if its size is known and it does not contradict edges that agree with the body's place.

    It may do so where feet are no evidence of a body that sinks, and a bend of its one other edge suggests how far. One
    that turns is displaced although a shift alone of its edges does not show.
    """
    if of_known_size(moved) is None or moved is None or moved.p_value <= AS_IN_PLACE or moved.misfit > DISAGREE:
        return of_known_size(moved)
    return None if _if_none(moved) < _CONTRADICTS else moved


def _dof(moved: Displacement) -> float:
    """Return the degrees of freedom of a covariance: few where it follows from how edges contradict each other."""
    return moved.estimate.dof if moved.misfit > DISAGREE and moved.estimate.misfit > _DIFFER else np.inf


def _if_none(moved: Displacement, dof: float = np.inf) -> float:
    """Return the probability of a displacement as large as this where there is none, given its own uncertainty.

    dof: degrees of freedom by which that is known.
    """
    return tail_probability(moved.estimate.value, moved.estimate.covariance, dof)
