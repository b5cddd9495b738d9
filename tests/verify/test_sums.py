"""Sums over edges, from which poses fitted to any of them follow: known once, they tell what all places do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.geometry.rigid import Rigid
from cadcam.verify.deviations.measured import MeasuredEdges
from cadcam.verify.edges.survey import surveyed
from cadcam.verify.tolerances.tolerance import whole_parts

from .scene import part, photo, plate


def test_a_fit_to_some_places_is_that_of_a_measurement_of_these(rng: np.random.Generator) -> None:
    """All edges but a body's, every other place on them, or another body alone: fits that share what each edge adds.

    No edges have less than 0.01 px in common: by long straight ones they seemed to, and bolts' rims alarmed at 0.05 px.
    """
    survey = surveyed(part(), [photo(plate(), rng)], Rigid(), whole_parts(part().scene), reach_px=8.0)
    every = np.ones(len(survey.lines), bool)
    measured = MeasuredEdges.of(survey, every, every, np.eye(6))
    body, refits = measured.body, measured.refits()
    some = (body != 3, True), ((body != 3) & (np.arange(len(body)) % 2 > 0), True), (body == 1, False)
    for datum, less in some:
        fitted = measured.fitted_to(datum, refits)
        anew = fitted.adjustment.sums_of(datum)
        by_edges = anew.common_error(measured.own_noise.tau, usual=0.01)
        assert (0 < by_edges < 0.01) is less
        assert fitted.tau_px == max(by_edges, 0.01)
        alone = replace(fitted.adjustment, known=None)
        for without in (None, fitted.lines.edge == fitted.lines.edge[datum].min()):
            pose, again = fitted.adjustment.pose(without=without), alone.pose(without=without)
            for name in ("xi", "covariance", "by_cause"):
                one, other = getattr(pose, name), getattr(again, name)
                np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8 * np.abs(other).max(initial=0.0))
