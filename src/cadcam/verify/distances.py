"""Distances between features of a located part, judged by their limits."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cadcam.render.view import Scene
from cadcam.verify.deviations.deviation import Unclear
from cadcam.verify.deviations.measured import DISAGREE, SEEN_PX
from cadcam.verify.deviations.spaced import spaced
from cadcam.verify.inspection import Inspection
from cadcam.verify.reasons import ANOTHER_VIEW, direction_words, explained, length_words, unmeasured, with_remedy
from cadcam.verify.tolerances.spacing import Spacing
from cadcam.verify.tolerances.tolerance import Distance, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict, decided

# Why the place of a feature is not known, which is there and measured: a distance may be known all the same.
_OF_THE_PLACE = (Unclear.POSE, Unclear.CALIBRATION, Unclear.LITTLE, Unclear.CONTRADICTS, Unclear.ALONE_IN_MODEL)


def judged_distance(distance: Distance, asked: Tolerances, scene: Scene, seen: Inspection) -> Judgement:
    """Return the judgement of a distance between two features, in the scene of the CAD, by what photos show."""
    found = _judgement(distance, asked.spacing(distance, scene), seen)
    return replace(with_remedy(found), between=tuple(distance.between))


def _judgement(distance: Distance, spacing: Spacing, seen: Inspection) -> Judgement:
    assert seen.measured is not None  # only of inspections that found the part
    limit, judgement = distance.limit, partial(Judgement, distance.name, distance.limit)
    nothing = partial(judgement, float("nan"), float("nan"))
    for name in distance.between:
        found = seen.feature(name)
        without = unmeasured(found)
        if without is not None and found.why not in _OF_THE_PLACE:
            verdict, reason, remedy = without
            return nothing(verdict, f"{name}: {reason}", remedy)
    one, other = (seen.survey.names.index(name) for name in distance.between)
    told = spaced(seen.measured, (seen.measured.members[one], seen.measured.members[other]), spacing)
    shown = 2 * SEEN_PX * max(seen.survey.mm_per_px(one), seen.survey.mm_per_px(other))
    along = f"along {direction_words(spacing.way * np.sign(spacing.way[np.abs(spacing.way).argmax()]))}"
    if told is None or not np.sqrt(told.covariance[0, 0]) < shown:
        return nothing(Verdict.UNDECIDED, f"the photos do not show a distance {along}", ANOTHER_VIEW)
    off, sigma = float(told.value[0]), float(np.sqrt(told.covariance[0, 0]))
    said = f"{abs(off):.3f} mm {'longer' if off > 0 else 'shorter'} than in the CAD"
    by = " by the size of the datum" * seen.sized_by_datum
    reason = f"{length_words(spacing.mm, off, limit, of=by) if np.isfinite(spacing.mm) else said}, {along}"
    if told.misfit > DISAGREE:
        disagree = f"{reason}, but the edges do not agree on one place"
        return judgement(off - limit.middle, sigma, Verdict.UNDECIDED, disagree, ANOTHER_VIEW)
    verdict = decided(off - limit.middle, sigma, limit)
    return explained(judgement(off - limit.middle, sigma, verdict, reason), told.shares)
