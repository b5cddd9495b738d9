"""Features that something before the part hides: not their absence, nor the light, keeps them from being seen.

What hides them shows in the photos by its own straight borders (`cadcam.locate.quality.occluder`). It is looked for
only where a feature is missing, or unclear for want of edges.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Mask
from cadcam.locate.location import Covered
from cadcam.locate.quality.occluder import covered, side_words
from cadcam.verify.deviations.deviation import FeatureDeviation, State, Unclear
from cadcam.verify.edges.survey import Survey

_MOST = 0.5  # share of a feature's places that are hidden, above which that is why it is not seen
_FOR_WANT_OF_EDGES = {Unclear.UNSEEN, Unclear.DOUBTFUL, Unclear.FAINT, Unclear.WHITE, Unclear.ALONE}
_FOR_WANT_OF_EDGES |= {Unclear.FOOT, Unclear.LITTLE}


def hidden_apart(
    survey: Survey, features: Sequence[FeatureDeviation], scatter: float
) -> tuple[tuple[FeatureDeviation, ...], Covered | None]:
    """Return the features, those hidden by something before the part unclear for that reason, and what it hides.

    scatter: sd (px) of the common error of each edge. None where nothing is hidden, or nothing for want of which a
    feature is missing or unclear.
    """
    asked = [f.state is State.MISSING or f.why in _FOR_WANT_OF_EDGES for f in features]
    if not any(asked):
        return tuple(features), None
    behind, found = covered_places(survey, scatter)
    hidden = [ask and found is not None and _share(behind, survey.rows(i)) > _MOST for i, ask in enumerate(asked)]
    told = tuple(f.behind() if h else f for f, h in zip(features, hidden, strict=True))
    return told, found if any(hidden) else None


def covered_places(survey: Survey, scatter: float) -> tuple[Mask, Covered | None]:
    """Return which places (N,) of a survey are behind something before the part, and what that hides."""
    if not len(survey.lines):
        return np.zeros(0, bool), None
    pose = survey.sights[0].drawn
    each, borders = covered(survey.sights, pose, scatter)
    behind = np.concatenate(each)
    return behind, Covered(float(behind.mean()), side_words(survey.sights, pose, each)) if borders else None


def _share(behind: Mask, rows: Mask) -> float:
    return float(behind[rows].mean()) if rows.any() else 0.0
