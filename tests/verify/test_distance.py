"""Distances between two features: both are measured against one pose, and what they have of its errors cancels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import BadValue, CadcamError, UnknownName, UnreadableFile
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.report.verify.json import VerificationOrigin, record_of
from cadcam.report.verify.overlay import overlay_svg
from cadcam.report.verify.words import assumptions, judgement_table, role
from cadcam.verify.deviations.deviation import Unclear
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.reasons import failed_words
from cadcam.verify.tolerances.file import read_tolerances
from cadcam.verify.tolerances.spacing import Spacing
from cadcam.verify.tolerances.tolerance import Distance, Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict

from .drilled import ABOVE, CAMERA, HIGH, HOLES, OBLIQUE, PINS, SIDE, drilled, part, selected
from .scene import photographed

X, Y, Z = np.eye(3)
LEFT = Feature("left edge", Selection("plate", box=np.array([[-101, -71, HIGH - 1], [-99, 71, HIGH + 1]])))
FRONT = Feature("front edge", Selection("plate", box=np.array([[-101, -71, HIGH - 1], [101, -69, HIGH + 1]])))

BACK = Feature("back edge", Selection("plate", box=np.array([[-101, 69, HIGH - 1], [101, 71, HIGH + 1]])))


def apart(one: str, other: str, mm: float = 0.2, *, along: np.ndarray | None = None) -> Distance:
    return Distance(f"{one} to {other}", (one, other), Limit(Quantity.DISTANCE, mm, direction=along))


def judged(
    place: Rigid, distances: Sequence[Distance], datum: Sequence[Selection] = (), seed: int = 1, **wrong: tuple
) -> tuple[Verification, dict[str, Judgement]]:
    """Return the verdict on the drilled plate with these distances, its holes and pins without limits of their own."""
    rng = np.random.default_rng(seed)
    shot = Photo.of(photographed(drilled(**wrong), rng, place, CAMERA), CAMERA, place)
    ends = {end for d in distances for end in d.between}
    features = [Feature(name, selected(name)) for name in (*HOLES, *PINS) if name in ends]
    features += [edge for edge in (LEFT, FRONT) if edge.name in ends]
    asked = Tolerances(tuple(features), tuple(datum), distances=tuple(distances))
    found = verify_part(part(), [shot], refine_pose(part(), [shot], Rigid()), asked)
    return found, {j.feature: j for j in found.judgements}


@pytest.mark.parametrize("place", [pytest.param(ABOVE, marks=pytest.mark.slow), OBLIQUE, SIDE])
def test_holes_that_are_off_are_as_much_nearer_or_farther(place: Rigid) -> None:
    """A is 0.4 mm off away from C, which is 0.4 mm too large; D is 0.5 mm off across its line to C."""
    wrong = {"A": (-0.4, 0.0, 0.0), "C": (0.0, 0.0, 0.2), "D": (0.5, 0.0, 0.0)}
    distances = [apart("A", "C"), apart("C", "D"), apart("A", "left edge", along=X), apart("D", "C", along=-X)]
    _, found = judged(place, distances, **wrong)
    true = {"A to C": 0.4, "C to D": np.hypot(70, 0.5) - 70, "A to left edge": -0.4}
    for name, off in true.items():
        assert abs(found[name].deviation - off) < 1.5 * found[name].U < 0.15
        assert found[name].verdict is (Verdict.FAIL if abs(off) > 0.2 else Verdict.PASS)
    assert found["A to C"].reason.startswith("120.4")
    assert (
        "mm measured by the size of the datum, 119.8 to 120.2 mm allowed, along x; beyond the limit by "
        in found["A to C"].reason
    )
    assert failed_words(found["A to left edge"]).endswith("mm smaller than in the CAD, limit 0.2 mm")


def test_of_the_pose_s_error_what_both_ends_have_cancels() -> None:
    """The datum is what the distance is from: without its left edge, nothing holds the part along x, within 10 mm."""
    datum = [LEFT.selection, FRONT.selection, BACK.selection]
    verdict, found = judged(SIDE, [apart("B", "left edge", along=X)], datum, B=(0.5, 0.0, 0.0))
    assert verdict.inspection is not None
    assert verdict.inspection.feature("left edge").why is Unclear.POSE
    (j,) = found.values()
    assert j.verdict is Verdict.FAIL
    assert abs(j.deviation - 0.5) < 1.5 * j.U < 0.15
    assert verdict.reason.startswith("B to left edge is 0.5")


def test_of_what_is_missing_or_not_in_view_no_distance_is_judged() -> None:
    _, found = judged(ABOVE, [apart("A", "C"), apart("pin", "peg")], pin=(0.0, 0.0, -7.9))
    assert found["A to C"].verdict is Verdict.PASS
    assert found["pin to peg"].verdict in (Verdict.NOT_FOUND, Verdict.UNDECIDED)
    assert found["pin to peg"].reason.startswith("pin: ")


def test_across_its_line_a_displacement_lengthens_it_by_its_square() -> None:
    """Of 70 mm, 4 mm across make 0.114 mm more: three times U at least."""
    _, found = judged(OBLIQUE, [apart("C", "D")], C=(2.0, 0.0, 0.0), D=(-2.0, 0.0, 0.0))
    (j,) = found.values()
    assert abs(j.deviation - (np.hypot(70, 4.0) - 70)) < 1.5 * j.U < 0.06


def test_of_what_extends_along_its_direction_the_change_alone_is_told() -> None:
    """The plate's left edge has no single place along y: by how much A is nearer to it, or farther, is known."""
    _, found = judged(ABOVE, [apart("A", "left edge", along=X + Y)], A=(-0.5, 0.0, 0.0))
    (j,) = found.values()
    assert abs(j.deviation + 0.5 * np.sqrt(0.5)) < 1.5 * j.U < 0.1
    assert re.match(r"0\.3\d+ mm shorter than in the CAD, along \(0\.71, 0\.71, 0\.00\)", j.reason)


def test_pins_and_their_sizes_do_not_mislead_it() -> None:
    _, found = judged(OBLIQUE, [apart("pin", "peg", 0.3)], pin=(0.0, 0.0, 0.3), peg=(0.6, 0.0, 0.0))
    (j,) = found.values()
    assert abs(j.deviation - (np.hypot(60.6, 5) - np.hypot(60, 5))) < 1.5 * j.U


def test_without_a_direction_it_is_straight_from_axis_to_axis() -> None:
    t = np.linspace(0, 2 * np.pi, 33)
    ring = np.stack([5 * np.cos(t), 5 * np.sin(t), 0 * t], axis=1)
    other = ring / 2 + np.array([30.0, 40.0, 12.0])
    edge = np.array([[-20.0, -9.0, 0.0], [-20.0, 9.0, 0.0]])
    found = Spacing.between([ring], [other], None)
    assert found.mm == pytest.approx(50, rel=1e-12)
    np.testing.assert_allclose(found.way, [-0.6, -0.8, 0], atol=1e-12)
    assert [basis.shape for basis in found.bases] == [(3, 2), (3, 2)]
    found = Spacing.between([ring], [edge], -X)
    assert found.mm == pytest.approx(20)
    np.testing.assert_allclose(found.way, X)  # from the second to the first
    assert [basis.shape for basis in found.bases] == [(3, 2), (3, 1)]
    assert np.isnan(Spacing.between([ring], [edge], Y).mm)  # the edge extends along it
    for pair in (([ring], [edge]), ([ring], [ring + 3 * Z]), ([ring], [ring[:, [2, 0, 1]] + 50])):
        with pytest.raises(BadValue, match=r"direction"):
            Spacing.between(*pair, None)


def test_distances_that_make_no_sense_are_refused() -> None:
    limit = Limit(Quantity.DISTANCE, 0.1)
    a, c = (Feature(name, selected(name)) for name in "AC")
    refused: list[tuple[str, type[CadcamError], object]] = [
        ("the names of two features", BadValue, lambda: Distance("d", ("A", "A"), limit)),
        ("distance_mm", BadValue, lambda: Distance("d", ("A", "C"), Limit(Quantity.POSITION, 0.1))),
        ("unknown feature 'D'", UnknownName, lambda: Tolerances((a, c), distances=(Distance("d", ("A", "D"), limit),))),
        ("named twice: 'A'", BadValue, lambda: Tolerances((a, c), distances=(Distance("A", ("A", "C"), limit),))),
        ("a Distance", BadValue, lambda: Feature("A", selected("A"), (limit,))),
        ("axis is that of distance_mm", BadValue, lambda: Limit(Quantity.DISTANCE, 0.1, axis=Z)),
    ]
    for said, kind, make in refused:
        with pytest.raises(kind, match=said):
            make()  # type: ignore[operator]
    whole = Feature("plate", Selection("plate"))
    shared = Tolerances((a, c, whole), distances=(Distance("d", ("A", "plate"), limit),))
    with pytest.raises(BadValue, match=r"distance 'd': between is two features that share edges"):
        shared.check(part().scene)


def test_tables_and_records_hold_it_under_its_own_name() -> None:
    verdict, found = judged(ABOVE, [apart("A", "C")], A=(-0.4, 0.0, 0.0))
    (row,) = judgement_table(verdict).rows
    assert row[:2] == ("A to C", "distance")
    assert verdict.inspection is not None
    assert [role(verdict, verdict.inspection.feature(name)) for name in ("A", "C", "pin")] == ["judged"] * 2 + ["datum"]
    (kept,) = (d for d in record_of(verdict, VerificationOrigin("plate")).deviations if d.feature == "A to C")
    assert (kept.kind, kept.unit, kept.lower, kept.upper) == ("distance", "mm", -0.2, 0.2)
    assert kept.deviation == pytest.approx(found["A to C"].deviation)


def test_one_that_fails_is_a_line_in_the_photo() -> None:
    """From hole to hole, and across from a hole to the edge, with what it is off by."""
    shot = Photo.of(photographed(drilled(A=(-0.4, 0.0, 0.0)), np.random.default_rng(1), ABOVE, CAMERA), CAMERA, ABOVE)
    verdict, _ = judged(ABOVE, [apart("A", "C"), apart("A", "left edge", along=X), apart("C", "D")], A=(-0.4, 0.0, 0.0))
    assert verdict.inspection is not None
    drawn = overlay_svg(shot, 0, verdict.inspection, judgements=verdict.judgements)
    said = re.findall(r"<text [^>]*>([^<]*)</text>", drawn)
    assert [re.sub(r"0\.(4|39)\d* ± 0.0\d*", "0.4", text) for text in said[1:3]] == [
        "A to C: 0.4 mm more",
        "A to left edge: 0.4 mm less",
    ]
    assert not any(text.startswith("C to D") for text in said)
    _, y, r = HOLES["A"]
    foot = CAMERA.project(ABOVE @ np.array([[-100.0, y, HIGH / 2]]))[0] + 0.5
    heads = np.array([tuple(map(float, place)) for place in re.findall(r"L(\S+) ([\d.]+)", drawn)])
    assert np.hypot(*(heads - foot).T).min() < 0.1 * r * CAMERA.fx / 560


FILE = """
features:
  A: {part: plate, chains: [3]}
  C: {part: plate, chains: [5], diameter_mm: 0.3}
distances:
  pitch:
    between: [A, C]
    distance_mm: [-0.1, 0.3]
    k: 3
"""


def test_a_file_states_distances_between_its_features(tmp_path: Path) -> None:
    (tmp_path / "t.yaml").write_text(FILE)
    found = read_tolerances(tmp_path / "t.yaml")
    assert [f.limits == () for f in found.features] == [True, False]
    (pitch,) = found.distances
    assert pitch.between == ("A", "C")
    assert pitch.limit.bounds == pytest.approx((-0.1, 0.3))
    assert (pitch.limit.k, pitch.limit.direction) == (3, None)
    assert [f.name for f in found.judged] == ["A", "C"]


@pytest.mark.parametrize(
    ("instead", "said"),
    [
        ("between: [A, B]", r"distances.pitch.between names an unknown feature 'B' \(known: A, C\)"),
        ("between: A", r"distances.pitch.between is not a list; the names of two features"),
        ("between: [A]", r"between of distance 'pitch' is \['A'\]; expected the names of two features"),
        ("between: [A, C]\n    axis: [0, 0, 1]", r"distances.pitch has an unknown key 'axis'"),
        ("between: [A, C]\n    direction: [0, 0, 0]", r"a vector that is not zero"),
    ],
)
def test_a_file_s_mistakes_are_told(tmp_path: Path, instead: str, said: str) -> None:
    (tmp_path / "t.yaml").write_text(FILE.replace("between: [A, C]", instead))
    with pytest.raises(UnreadableFile, match=said):
        read_tolerances(tmp_path / "t.yaml")


def test_a_distance_stands_beside_its_features_is_the_remedy_for_one_that_does_not(tmp_path: Path) -> None:
    (tmp_path / "t.yaml").write_text(FILE.replace("diameter_mm", "distance_mm"))
    with pytest.raises(UnreadableFile, match=r"features.C.distance_mm is between two features; under distances, write"):
        read_tolerances(tmp_path / "t.yaml")
    (tmp_path / "t.yaml").write_text("features:\n  A: {part: plate}\n")
    with pytest.raises(UnreadableFile, match=r"features.A has no limit; give .*, presence, or name it in `distances`"):
        read_tolerances(tmp_path / "t.yaml")


def test_by_one_photo_lengths_are_those_by_the_size_of_the_datum() -> None:
    """A part that is larger as a whole looks nearer; where its distance is given, it does not."""
    mesh, rng = drilled(), np.random.default_rng(1)
    larger = replace(mesh, vertices=1.005 * mesh.vertices)
    shot = Photo.of(photographed(larger, rng, OBLIQUE, CAMERA), CAMERA, OBLIQUE)
    asked = Tolerances(tuple(Feature(n, selected(n)) for n in "AC"), distances=(apart("A", "C"),))
    located = refine_pose(part(), [shot], Rigid())
    found = verify_part(part(), [shot], located, asked)
    (judgement,) = found.judgements
    assert abs(judgement.deviation) < 2 * judgement.U < 0.1  # 0.6 mm longer in truth
    assert "120 mm measured by the size of the datum" in judgement.reason.replace("120.0", "120")
    assert any("larger as a whole" in said for said in assumptions(found))
    from_above = Photo.of(photographed(mesh, rng, ABOVE, CAMERA), CAMERA, ABOVE)
    flat = Freedom.planar([0, 0, 1], frame="part")
    lying = verify_part(part(), [from_above], refine_pose(part(), [from_above], Rigid()), asked, freedom=flat)
    assert "120 mm measured, 119.8" in lying.judgements[0].reason.replace("120.0", "120")
    assert not any("larger as a whole" in said for said in assumptions(lying))
