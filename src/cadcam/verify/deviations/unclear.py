"""Why the photos do not show where a feature is, so that a person knows what to change, not only that it failed."""

from __future__ import annotations

import numpy as np

from cadcam.verify.adjustment.datum_fit import CAUSES
from cadcam.verify.deviations.deviation import Unclear
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges
from cadcam.verify.edges.presence import Presence
from cadcam.verify.edges.survey import Survey

_MOST = 0.5  # share of the places, or of the variance, that a reason must account for
_OF_CAUSE = {"pose": Unclear.POSE, "calibration": Unclear.CALIBRATION}  # other causes: its own edges are too uncertain


def why_doubtful(presence: Presence) -> Unclear:
    """Return why it is uncertain whether a feature is there at all, or where, if its surfaces alone show it."""
    if presence.expected == 0:
        return Unclear.SHOWN if presence.log_ratio > 0 else Unclear.SHORT_EDGES
    return Unclear.UNSEEN if presence.seen == 0 else Unclear.DOUBTFUL


def why_untold(survey: Survey, measured: MeasuredEdges, number: int, moved: Displacement | None) -> Unclear:
    """Return why the place of a feature that is there could not be measured, or cannot be believed."""
    rows = measured.members[number]
    if not rows.any():
        return _why_unmeasured(survey, number)
    if measured.pose_without(rows) is None:
        only = len(survey.by) == 1 and survey.members[number].mean() > _MOST
        return Unclear.ALONE_IN_MODEL if only else Unclear.POSE
    if moved is not None and moved.known:
        return Unclear.CONTRADICTS
    if (measured.mate[rows] >= 0).all():
        return Unclear.FOOT
    return Unclear.LITTLE if moved is None else _by_cause(moved)


def holds_pose(measured: MeasuredEdges, number: int) -> bool:
    """Return whether a feature is what the pose is fitted to: all of the datum, or most of it."""
    datum, own = measured.adjustment.datum, measured.members[number]
    return bool((own & datum).any()) and (measured.pose_without(own) is None or own[datum].mean() > _MOST)


def _why_unmeasured(survey: Survey, number: int) -> Unclear:
    seen = survey.rows(number) & survey.matched.support
    if not seen.any():
        return Unclear.UNSEEN
    crowded = ~np.isfinite(survey.matched.step[seen])
    return Unclear.CROWDED if crowded.mean() > _MOST else Unclear.FAINT


def _by_cause(moved: Displacement) -> Unclear:
    """Return what to improve where a displacement is too uncertain: the cause of most of its variance."""
    variances = {cause: float(np.trace(getattr(moved.estimate, cause))) for cause in CAUSES}
    cause = max(variances, key=lambda c: variances[c])
    enough = variances[cause] > _MOST * sum(variances.values())
    return _OF_CAUSE.get(cause, Unclear.LITTLE) if enough else Unclear.LITTLE
