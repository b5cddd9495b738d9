"""Which bodies agree on a pose: the one that disagrees most is left out, then the next (data snooping)."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Mask
from cadcam.verify.bodies.case import Case
from cadcam.verify.bodies.stages import each
from cadcam.verify.deviations.measured import MeasuredEdges
from cadcam.verify.edges.survey import Survey

OF_DISPLACED = 0.25  # share of alarms for displacements, which are far beyond doubt if they matter; absences are not


def snooped(survey: Survey, there: Mask, case: Case) -> tuple[MeasuredEdges, list[int]]:
    """Return the measurement with the pose fitted to the bodies that agree, and the bodies that do not.

    Bodies between which the photos hardly decide are left out together: the rest then shows which of them is in place.
    Feet on a body that does not agree are not used: they move with it. A body that is drawn elsewhere than in the CAD
    does not agree with the others, which cannot be left out for its sake.
    """
    left_out = [] if survey.stated else _drawn_elsewhere(survey)
    while True:
        used = there[survey.body] & ~np.isin(survey.mate, left_out)
        datum = survey.datum & ~np.isin(survey.body, left_out)
        measured = MeasuredEdges.of(survey, used, datum, case.freedom)
        measured.adjustment.pose()  # an error here says which motion is free
        if survey.stated:
            return measured, left_out
        bodies = np.unique(measured.body[measured.adjustment.datum]).tolist()
        others = _Others(measured)
        every = [(i, others.p_in_place(i)) for i in each(bodies, "comparing bodies", case.tell)]
        tested = [(i, p) for i, p in every if np.isfinite(p)]
        off = [i for i, p in tested if p <= OF_DISPLACED * case.alarms / len(tested)]
        suspect = [(others.if_off(i), i) for i in off]
        if not suspect:
            return measured, left_out
        least = min(suspect)[0]
        worst = [i for loss, i in suspect if loss - least <= -2 * np.log(case.alarms)]
        if measured.pose_without(np.isin(measured.body, [*left_out, *worst])) is None:
            return measured, left_out  # the others would not determine the pose: they cannot outvote it
        left_out += worst


def _drawn_elsewhere(survey: Survey) -> list[int]:
    parts = [survey.whole_part(i) for i in range(len(survey.names))]
    return [i for i, part in enumerate(parts) if part is not None and survey.by[part].any()]


class _Others:
    """A body against the others: the measurement without it, fitted anew."""

    def __init__(self, measured: MeasuredEdges) -> None:
        self._measured, self._refits = measured, measured.refits()

    def p_in_place(self, body: int) -> float:
        """Return the probability of a body's offsets if it is in place; nan: undetermined.

        In place is relative to the rest of the datum, which also determines the errors of edges.
        """
        others = self._without(body)
        return others.p_value(others.body == body)

    def if_off(self, body: int) -> float:
        """Return how improbable the photos are if a body is off.

        If several are displaced relative to the others, the one whose displacement explains most is to blame: those
        from which it pulled the pose away are in place without it.
        """
        return self._without(body).improbability(body)

    def _without(self, body: int) -> MeasuredEdges:
        measured = self._measured
        its = (measured.body == body) | (measured.mate == body)
        return measured.fitted_to(measured.adjustment.datum & ~its, self._refits)
