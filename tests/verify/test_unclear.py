"""What is not told is told why: every unclear feature has a reason that fits how the photo was taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.report.verify.words import feature_notes, unclear_words
from cadcam.verify.adjustment.datum_fit import Estimate
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges
from cadcam.verify.deviations.unclear import _by_cause, why_doubtful
from cadcam.verify.edges.presence import Presence
from cadcam.verify.edges.survey import Survey
from cadcam.verify.inspection import Inspection, inspect
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances

from .drilled import ABOVE, around, drilled
from .drilled import CAMERA as WIDE
from .scene import part, photo, photographed, plate

EYES = {"near": (420.0, -620.0, 640.0), "far": (1100.0, -1700.0, 1700.0), "above": (60.0, -200.0, 1500.0)}


def seen_from(eye: tuple[float, float, float], asked: Tolerances | None = None) -> Inspection:
    taken = photo(plate(), np.random.default_rng(1), Rigid.look_at(eye, (10.0, 0.0, 10.0)))
    return inspect(part(), [taken], Rigid(), tolerances=asked)


@pytest.mark.parametrize("where", EYES)
def test_a_feature_has_a_reason_where_it_is_unclear_and_nowhere_else(where: str) -> None:
    for f in seen_from(EYES[where]).features:
        assert (f.why is not None) == (f.state is State.UNCLEAR), f.name


def test_from_far_away_ribs_are_told_by_the_line_they_stand_on_alone() -> None:
    """At 2.6 m their upper edges are 3 px apart: what is left to measure is feet, and another view is asked for."""
    found = {f.name: f.why for f in seen_from(EYES["far"]).features}
    assert found["rib 1"] is found["rib 2"] is Unclear.FOOT


@pytest.mark.parametrize("where", ["far", "above"])
def test_what_alone_holds_the_pose_is_the_datum_and_not_unclear(where: str) -> None:
    """Ribs do not hold the pose that the plate would be compared with, or only by far; unless it is to be judged."""
    eye = EYES[where]
    assert seen_from(eye).feature("plate").state is State.DATUM
    limits = (Limit(Quantity.POSITION, 0.5),)
    ribs = Tolerances((Feature("rib", Selection("rib 1"), limits),), (Selection("plate"),))
    measured = seen_from(EYES["near"], ribs)
    assert measured.feature("plate").state is State.DATUM
    (note,) = [line for line in feature_notes(measured) if "plate" in line]
    assert note == "datum, plate: what the others are measured from, so that there is nothing else to compare it with"
    judged = Tolerances((Feature("plate", Selection("plate"), limits),), (Selection("*"),))
    assert seen_from(eye, judged).feature("plate").why is Unclear.POSE


def test_what_is_left_of_the_only_part_is_the_datum_of_what_is_judged_in_it() -> None:
    every = drilled()
    plain = every.select(every.part == every.part_names.index("plate"))
    mesh = replace(plain, part_names=("plate",), part_colors=plain.part_colors[:1])
    taken = Photo.of(photographed(mesh, np.random.default_rng(1), ABOVE, WIDE), WIDE, ABOVE, name="photo")
    limits = (Limit(Quantity.POSITION, 0.5),)
    for asked, state in ((Tolerances((Feature("A", around("A"), limits),)), State.DATUM), (None, State.UNCLEAR)):
        found = inspect(Part.of(mesh), [taken], Rigid(), tolerances=asked).feature("plate")
        assert found.state is state
        assert found.why is (None if asked else Unclear.ALONE_IN_MODEL)


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
