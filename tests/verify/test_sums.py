"""Sums over edges, from which poses fitted to any of them follow: known once, they tell what all places do."""

from __future__ import annotations

import numpy as np

from cadcam.geometry.rigid import Rigid
from cadcam.verify.deviations.measured import MeasuredEdges
from cadcam.verify.edges.survey import surveyed
from cadcam.verify.tolerances.tolerance import whole_parts

from .scene import part, photo, plate


def test_a_fit_to_some_places_is_that_of_a_measurement_of_these(rng: np.random.Generator) -> None:
    """All edges but a body's, or every other place on them: sums known before are those of the places, to rounding."""
    survey = surveyed(part(), [photo(plate(), rng)], Rigid(), whole_parts(part().scene), reach_px=8.0)
    every = np.ones(len(survey.lines), bool)
    measured = MeasuredEdges.of(survey, every, every, np.zeros(3), np.eye(6))
    n = len(measured.body)
    for datum in (measured.body != 3, (measured.body != 3) & (np.arange(n) % 2 > 0)):
        fitted = measured.fitted_to(datum)
        anew = fitted.adjustment.sums_of(datum)
        known = fitted.adjustment.sums
        assert known is not None
        for name in ("plain", "crossed", "of_lines", "log_noise"):
            one, other = getattr(known, name), getattr(anew, name)
            np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10 * np.abs(other).max())
        assert fitted.tau_px > 0
