"""What is not told is told why: every unclear feature has a reason that fits how the photo was taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cadcam.geometry.rigid import Rigid
from cadcam.report.verify.words import unclear_words
from cadcam.verify.adjustment.datum_fit import Estimate
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges
from cadcam.verify.deviations.unclear import _by_cause, why_doubtful
from cadcam.verify.edges.presence import Presence
from cadcam.verify.edges.survey import Survey
from cadcam.verify.inspection import Inspection, inspect

from .scene import part, photo, plate

EYES = {"near": (420.0, -620.0, 640.0), "far": (1100.0, -1700.0, 1700.0), "above": (60.0, -200.0, 1500.0)}


def seen_from(eye: tuple[float, float, float]) -> Inspection:
    taken = photo(plate(), np.random.default_rng(1), Rigid.look_at(eye, (10.0, 0.0, 10.0)))
    return inspect(part(), [taken], Rigid())


@pytest.mark.parametrize("where", EYES)
def test_a_feature_has_a_reason_where_it_is_unclear_and_nowhere_else(where: str) -> None:
    for f in seen_from(EYES[where]).features:
        assert (f.why is not None) == (f.state is State.UNCLEAR), f.name


def test_from_far_away_ribs_are_told_by_the_line_they_stand_on_alone() -> None:
    """At 2.6 m their upper edges are 3 px apart: what is left to measure is feet, and another view is asked for."""
    found = {f.name: f.why for f in seen_from(EYES["far"]).features}
    assert found["rib 1"] is found["rib 2"] is Unclear.FOOT
    assert found["plate"] is Unclear.POSE  # ribs alone do not hold the pose that it would be compared with


def test_a_block_as_bright_as_what_it_stands_on_wants_other_light() -> None:
    """From straight above its sides do not show, and its top is as bright as the plate: both look up."""
    found = seen_from(EYES["above"])
    assert found.feature("block").why is Unclear.UNSEEN
    assert any("block" in line and "light" in line for line in unclear_words(found))


def test_whether_a_feature_is_there_is_doubtful_for_three_reasons() -> None:
    assert why_doubtful(Presence(0, 0, 0.0)) is Unclear.SHORT_EDGES
    assert why_doubtful(Presence(4, 0, -1.0)) is Unclear.UNSEEN
    assert why_doubtful(Presence(4, 1, 0.5)) is Unclear.DOUBTFUL


@pytest.mark.parametrize(("log_ratio", "told"), [(20.0, True), (0.5, False)])
def test_what_may_not_be_there_has_no_size(monkeypatch: pytest.MonkeyPatch, log_ratio: float, told: bool) -> None:
    """A bar 1 mm off, doubtful itself, was printed as 8.2 mm off, by the edges of something else."""
    number = part().scene.mesh.part_names.index("block")

    def doubted(survey: Survey, presence: Sequence[Presence], measured: MeasuredEdges) -> list[Presence]:
        return [replace(p, log_ratio=log_ratio if i == number else p.log_ratio) for i, p in enumerate(presence)]

    monkeypatch.setattr("cadcam.verify.inspection._placed", doubted)
    found = seen_from(EYES["near"]).feature("block")
    assert (found.displacement is not None) is told
    assert (found.why is Unclear.DOUBTFUL) is not told


@pytest.mark.parametrize(
    ("variances", "reason"),
    [
        ((1.0, 1.0, 9.0, 0.0), Unclear.POSE),
        ((1.0, 1.0, 0.0, 9.0), Unclear.CALIBRATION),
        ((1.0, 9.0, 1.0, 0.0), Unclear.LITTLE),
        ((1.0, 1.0, 1.0, 1.0), Unclear.LITTLE),  # nothing by itself: then more of the feature helps against all
    ],
)
def test_what_makes_most_of_the_variance_is_what_is_to_be_improved(
    variances: tuple[float, ...], reason: Unclear
) -> None:
    told = Estimate(np.zeros(1), *(np.eye(1) * v for v in variances))
    assert _by_cause(Displacement(np.eye(3)[:, :1], told, 0.5, 3, known=False)) is reason
