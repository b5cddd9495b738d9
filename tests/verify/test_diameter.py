"""Limits of a diameter: of holes and pins in place, off their places, of another size, or both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.parts.shape import circle
from cadcam.errors import BadValue, CadcamError
from cadcam.geometry.rigid import Rigid
from cadcam.verify.adjustment.datum_fit import Estimate
from cadcam.verify.deviations.deviation import State
from cadcam.verify.edges.rims import Rims
from cadcam.verify.judge import Verification
from cadcam.verify.reasons import failed_words
from cadcam.verify.tolerances.circles import Circles
from cadcam.verify.tolerances.file import read_tolerances
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict

from .drilled import ABOVE, OBLIQUE, SIDE, drilled, part, verified, within

SIZE = Limit(Quantity.DIAMETER, 0.2)
WRONG = {"A": (0.0, 0.6, 0.0), "B": (0.0, 0.0, 0.25), "C": (0.4, -0.4, 0.25)}
Z = np.array([0.0, 0.0, 1.0])


def told(found: Verification) -> dict[str, list[Judgement]]:
    return {f.name: [j for j in found.judgements if j.feature == f.name] for f in found.tolerances.features}


@pytest.mark.parametrize(
    "wrong",
    [
        (0.0, 0.0, 0.4),
        *(pytest.param(wrong, marks=pytest.mark.slow) for wrong in ((0.1, -0.35, 0.38), (0.4, 0.3, 0.35))),
        (-0.3, 0.2, -0.4),
    ],
)
def test_a_hole_s_two_rims_in_view_are_not_taken_for_each_other(wrong: tuple[float, float, float]) -> None:
    """Half of C's far rim shows some 6 px inside its near one: 0.4 mm too large it was found 0.47 mm off its place."""
    position, size = verified(drilled(C=wrong), [within(0.3), SIZE], ABOVE, names=["C"]).judgements
    true = float(np.hypot(*wrong[:2])), 2 * wrong[2]
    for j, mm in zip((position, size), true, strict=True):
        assert abs(j.deviation - mm) < 1.5 * j.U < 0.15
    assert position.verdict is (Verdict.FAIL if true[0] > 0.3 else Verdict.PASS)
    assert size.verdict is Verdict.FAIL


@pytest.mark.parametrize("place", [pytest.param(OBLIQUE, marks=pytest.mark.slow), SIDE])
def test_holes_off_their_places_or_too_large_are_told_apart(place: Rigid) -> None:
    """A is 0.6 mm off, B 0.5 mm too large, C both, D right: each value within U (k 3), which is small."""
    found = verified(drilled(**WRONG), [within(0.3), SIZE], place, names=["A", "B", "C", "D"])
    P, F = Verdict.PASS, Verdict.FAIL
    expected = {"A": [F, P], "B": [P, F], "C": [F, F], "D": [P, P]}
    for name, (position, size) in told(found).items():
        assert [position.verdict, size.verdict] == expected[name]
        x, y, larger = WRONG.get(name, (0.0, 0.0, 0.0))
        assert abs(size.deviation - 2 * larger) < 1.5 * size.U
        assert abs(position.deviation - np.hypot(x, y)) < 1.5 * position.U
        assert max(position.U, size.U) < 0.15
    assert found.inspection is not None
    assert found.inspection.feature("B").state is State.IN_PLACE  # of another size, it is not displaced


def test_a_hole_far_off_its_place_has_its_size() -> None:
    """2 mm: its rim runs up to 0.9 px inside the tangents that it is compared with."""
    found = verified(drilled(D=(-1.2, 1.6, 0.0)), [within(1.0), SIZE], OBLIQUE, names=["D"])
    position, size = found.judgements
    assert position.verdict is Verdict.FAIL
    assert size.verdict is Verdict.PASS
    assert abs(position.deviation - 2.0) < 1.5 * position.U < 0.05
    assert abs(size.deviation) < 1.5 * size.U < 0.1


@pytest.mark.parametrize(
    ("place", "larger"),
    [
        (SIDE, 1.8),
        (OBLIQUE, -1.8),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in ((SIDE, 1.4), (OBLIQUE, 1.0))),
    ],
)
def test_an_oblique_hole_that_is_much_too_large_is_so_and_not_missing(place: Rigid, larger: float) -> None:
    """By 4 to 8 px along its ellipse and 2 to 5 px across it: it was called missing, or nothing was said of it."""
    found = verified(drilled(D=(0.0, 0.0, larger)), [within(0.3), SIZE], place, names=["D"])
    position, size = found.judgements
    assert found.inspection is not None
    assert found.inspection.feature("D").state is State.IN_PLACE
    assert position.verdict is Verdict.PASS
    assert abs(size.deviation - 2 * larger) < 1.5 * size.U < 0.12


def test_circles_that_are_displaced_and_larger_leave_their_tangents() -> None:
    """Of a circle seen at 60 degrees: where its edges' normals meet the ellipse that it is seen as then."""
    angle = np.radians(np.arange(0, 360, 15.0))
    radial, along = (
        np.column_stack([*v, 0 * angle]) for v in ((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle)))
    )
    flat, r, larger, moved = np.diag([4.0, 2.0]), 12.0, 1.5, np.array([0.7, -0.4, 0.0])  # px/mm
    normal = radial[:, :2] @ np.linalg.inv(flat)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    across = normal @ np.linalg.inv(flat)  # in the circle's plane, of what is seen along the normal
    lean = np.einsum("ni,ni->n", across, along[:, :2]) / np.einsum("ni,ni->n", across, radial[:, :2])
    by_point = np.column_stack([normal @ flat, 0 * angle])
    none = np.zeros(len(angle))
    rims = Rims(radial, along, none + r, none, lean)
    beyond = rims.beyond_tangents(by_point, moved, larger)
    seen = np.einsum("ni,ni->n", by_point, radial * larger + moved) + beyond
    on_it = r * radial[:, :2] + seen[:, None] * across
    np.testing.assert_allclose(np.linalg.norm(on_it - moved[:2], axis=1), r + larger, rtol=1e-12)
    assert np.abs(beyond).max() > 0.2


def test_a_pin_too_thick_that_is_off_its_place_is_told_from_above() -> None:
    """It is drawn elsewhere to be measured, and its circles with it."""
    found = verified(drilled(pin=(0.3, 0.4, 0.25)), [within(0.3), SIZE], ABOVE, names=["pin"])
    position, size = found.judgements
    assert position.verdict is size.verdict is Verdict.FAIL
    assert abs(position.deviation - 0.5) < 1.5 * position.U
    assert abs(size.deviation - 0.5) < 1.5 * size.U
    assert size.reason.startswith(
        f"{16 + size.deviation:.2f} mm measured, 15.8 to 16.2 mm allowed; beyond the limit by"
    )


def test_a_diameter_is_that_of_the_circle_whatever_the_chords_of_the_cad() -> None:
    """Chords of a CAD of 24 sides lie within the true circle, by 0.14 mm of the diameter on the average."""
    for coarse in (192, 24):
        (j,) = verified(drilled(), [SIZE], ABOVE, names=["D"], sides=coarse).judgements
        assert abs(j.deviation) < 1.5 * j.U < 0.12


def test_the_zone_of_a_diameter_need_not_be_symmetric() -> None:
    """0.5 mm too large: within -0.1 to 0.7 mm, beyond 0.7 to 0.9 mm; deviations are from the middle."""
    for low, high, verdict in ((-0.1, 0.7, Verdict.PASS), (0.7, 0.9, Verdict.FAIL)):
        limit = Limit(Quantity.DIAMETER, (high - low) / 2, middle=(high + low) / 2)
        (j,) = verified(drilled(B=(0.0, 0.0, 0.25)), [limit], ABOVE, names=["B"]).judgements
        assert j.verdict is verdict
        assert abs(j.deviation + limit.middle - 0.5) < 1.5 * j.U
        assert f"{12 + low:g} to {12 + high:g} mm allowed" in j.reason
    assert "B's diameter is 0.50 +- 0.0" in failed_words(j)
    assert "larger than in the CAD, limits 0.7 to 0.9 mm" in failed_words(j)


def test_edges_that_are_no_circles_about_one_axis_are_refused_before_anything_is_measured() -> None:
    for selection in (Selection("plate"), Selection("plate", box=np.array([[-101.0, -71, 11], [101, -69, 13]]))):
        asked = Tolerances((Feature("it", selection, (SIZE,)),))
        with pytest.raises(
            CadcamError, match=r"feature 'it': diameter_mm is asked of edges \d.*; expected arcs of circ"
        ):
            asked.check(part().scene)
    with pytest.raises(BadValue, match="middle of a zone is that of position_mm; expected 0"):
        Limit(Quantity.POSITION, 1.0, middle=0.1)


def test_circles_are_found_in_arcs_of_several_radii_and_a_nut_is_none() -> None:
    def ring(radius: float, z: float, sides: int, *, upto: int | None = None) -> np.ndarray:
        flat = np.vstack([p := circle((3.0, -2.0), radius, sides), p[:1]])[:upto]
        return np.column_stack([flat, np.full(len(flat), z)])

    turned = Rigid.exp(np.array([10.0, 20.0, 30.0, 0.3, -0.5, 0.2]))
    found = Circles.through([turned @ ring(5.0, 0.0, 48), turned @ ring(7.0, 4.0, 48, upto=20)])
    assert found is not None
    np.testing.assert_allclose(found.radii, [5, 7], rtol=1e-9)
    np.testing.assert_allclose(np.abs(found.axis @ (turned.rotation @ Z)), 1, rtol=1e-12)
    p = turned @ ring(7.0, 9.0, 48)
    middle = (p[1:] + p[:-1]) / 2
    np.testing.assert_allclose(found.inside(p), 0, atol=1e-9)
    np.testing.assert_allclose(found.inside(middle), found.sagitta[1], rtol=1e-2)
    np.testing.assert_allclose(np.linalg.norm(found.outward(p), axis=1), 1)
    assert Circles.through([ring(5.0, 0.0, 6)]) is None
    assert Circles.through([ring(5.0, 0.0, 48), ring(5.0, 0.0, 48) + 0.1 * np.eye(3)[0]]) is None
    assert Circles.through([]) is None


def test_a_file_gives_a_diameter_to_either_side_or_a_zone(tmp_path: Path) -> None:
    def read(zone: str) -> Limit:
        path = tmp_path / "tolerances.yaml"
        path.write_text(f"features:\n  hole:\n    part: plate\n    diameter_mm: {zone}\n")
        return read_tolerances(path).features[0].limits[0]

    assert read("0.1").bounds == (-0.1, 0.1)
    np.testing.assert_allclose(read("[-0.1, 0.05]").bounds, [-0.1, 0.05])
    with pytest.raises(CadcamError, match=r"features.hole.diameter_mm is \[0.05, -0.1\]; the least and the greatest"):
        read("[0.05, -0.1]")


def test_what_does_not_show_its_size_is_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a view in which it is as good as any displacement, and where its edges scatter as no circle's do."""
    from cadcam.verify.deviations.measured import MeasuredEdges

    none = np.zeros((1, 1))
    for sigma, scatter, said in ((0.5, 1.0, "do not tell its size"), (0.01, 9.0, "do not agree on one size")):
        estimate = Estimate(np.array([0.0]), np.array([[sigma**2]]), none, none, none)
        monkeypatch.setattr(MeasuredEdges, "grown", lambda *_, e=estimate, s=scatter: (e, s))
        (j,) = verified(drilled(), [SIZE], ABOVE, names=["D"]).judgements
        assert j.verdict is Verdict.UNDECIDED
        assert said in j.reason
        assert j.remedy
