"""What is unclear because the photos are white beside it: less light helps there, where more would seem to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cadcam.arrays import Mask
from cadcam.locate.lines.edges import Projected
from cadcam.verify.deviations.deviation import FeatureDeviation, Unclear
from cadcam.verify.edges.survey import Survey

_MOST = 0.5  # share of a feature's places beside white, above which that is why it is not seen
_FOR_WANT_OF_LIGHT = {Unclear.UNSEEN, Unclear.DOUBTFUL, Unclear.FAINT, Unclear.SHORT_EDGES}


def overexposed(survey: Survey, features: Sequence[FeatureDeviation]) -> tuple[FeatureDeviation, ...]:
    """Return the features; of those that seem to want light, the ones beside white say so instead."""
    if not any(f.why in _FOR_WANT_OF_LIGHT for f in features):
        return tuple(features)
    white = _white(survey)
    rows = [survey.rows(i) for i in range(len(features))]
    bright = [bool(its.any()) and float(white[its].mean()) > _MOST for its in rows]
    return tuple(
        replace(f, why=Unclear.WHITE) if b and f.why in _FOR_WANT_OF_LIGHT else f
        for f, b in zip(features, bright, strict=True)
    )


def _white(survey: Survey) -> Mask:
    """Return beside which places (N,) the photos are white."""
    lines, out = survey.lines, np.zeros(len(survey.lines), bool)
    for i, sight in enumerate(survey.sights):
        rows = lines.photo == i
        out[rows] = sight.white_beside(Projected(lines.q[rows], lines.normal[rows], np.zeros((int(rows.sum()), 6))))
    return out
