"""Positions across an axis: the cylindrical zone of a hole or a pin, which is in place along it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.locate.refine.refinement import refine_pose
from cadcam.report.verify.overlay import displacement_words
from cadcam.report.verify.words import to_do
from cadcam.verify import judge
from cadcam.verify.judge import verify_part
from cadcam.verify.reasons import failed_words
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Verdict

from .drilled import ABOVE, OBLIQUE, SIDE, drilled, verified, within
from .scene import part, photo, plate

Z = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("place", [ABOVE, pytest.param(OBLIQUE, marks=pytest.mark.slow), SIDE])
def test_one_photo_shows_the_whole_displacement_across_an_axis(place: Rigid) -> None:
    """A hole 0.6 mm off; without the axis an oblique photo shows 0.47 to 0.5 mm of it."""
    across, anyhow = within(0.3), Limit(Quantity.POSITION, 0.3)
    verdict = verified(drilled(A=(0.0, 0.6, 0.0)), [across, anyhow], place, names=["A", "C", "D"])
    found = verdict.judgements
    assert to_do(verdict)[0] == ("Have it decided whether it can stay where it was made", ["A"])  # no hole is put back
    assert [j.verdict for j in found] == [Verdict.FAIL] * 2 + [Verdict.PASS] * 4
    assert abs(found[0].deviation - 0.6) < found[0].U < 0.15
    assert "mm across z, as if it were in place along it" in found[0].reason
    if place is not ABOVE:
        assert found[1].deviation < 0.52


@pytest.mark.parametrize(
    "off",
    [
        (0.0, 0.0, 0.0),
        (0.5, 0.0, 0.0),
        *(pytest.param(off, marks=pytest.mark.slow) for off in ((-0.5, 0.0, 0.0), (0.3, 0.3, 0.0))),
    ],
)
def test_rims_a_few_pixels_apart_are_both_followed(off: tuple[float, float, float]) -> None:
    """Half of B's rim shows 2 to 3 px beside its other one: 0.5 mm off it was found 0.38 +- 0.01 mm off."""
    (j,) = verified(drilled(B=off), [within(0.2)], ABOVE, names=["B"], seed=3).judgements
    true = float(np.hypot(*off[:2]))
    assert abs(j.deviation - true) < 1.5 * j.U < 0.04
    assert j.verdict is (Verdict.FAIL if true else Verdict.PASS)


def test_along_a_direction_a_zone_need_not_lie_about_the_place() -> None:
    """A hole 0.6 mm off along y: within 0.4 to 0.8 mm, beyond -0.1 to 0.4 mm; against y the signs are others."""
    y = np.array([0.0, 1.0, 0.0])
    zones = [(0.4, 0.8, y, Verdict.PASS), (-0.1, 0.4, y, Verdict.FAIL), (-0.8, -0.4, -y, Verdict.PASS)]
    limits = [
        Limit(Quantity.POSITION, (high - low) / 2, direction=way, middle=(high + low) / 2)
        for low, high, way, _ in zones
    ]
    verdict = verified(drilled(A=(0.0, 0.6, 0.0)), limits, ABOVE, names=["A"])
    found = verdict.judgements
    assert [j.verdict for j in found] == [verdict for *_, verdict in zones]
    for j, (low, high, way, _) in zip(found, zones, strict=True):
        assert j.limit.bounds == pytest.approx((low, high))
        assert abs(j.deviation + j.limit.middle - 0.6 * way[1]) < 1.5 * j.U
    assert failed_words(found[1]).startswith("A is 0.6")
    assert "limits -0.1 to 0.4 mm: FAIL" in str(found[1])
    assert str(found[1]).startswith("A, position: 0.6")
    assert verdict.inspection is not None
    for one in (found[0], found[1]):  # from the place in the CAD, whatever the zone's middle
        assert displacement_words(verdict.inspection.feature("A"), [one]).startswith("0.6")
    assert "off its place along y, limits -0.1 to 0.4 mm" in failed_words(found[1])


def test_what_is_not_seen_of_the_plane_across_an_axis_does_not_pass() -> None:
    """One straight edge does not show a displacement along itself; beyond its limit across itself it fails anyhow."""
    seen = photo(plate(), np.random.default_rng(2))
    edge = Selection("block", box=np.array([[69, -71, 44], [121, -69, 46]]))  # along x
    for limit, verdict in ((0.5, Verdict.UNDECIDED), (100.0, Verdict.UNDECIDED)):
        asked = Tolerances((Feature("edge", edge, (Limit(Quantity.POSITION, limit, axis=Z),)),))
        (j,) = verify_part(part(), [seen], refine_pose(part(), [seen], Rigid()), asked).judgements
        assert j.verdict is verdict
        assert "a displacement nearly along x would not show" in j.reason
        assert j.remedy == "add a photo from another side"


def test_an_axis_is_that_of_a_position_and_excludes_a_direction() -> None:
    assert Limit(Quantity.POSITION, 0.1).basis is None
    basis = Limit(Quantity.POSITION, 0.1, axis=3 * Z).basis
    assert basis is not None
    np.testing.assert_allclose(basis.T @ np.column_stack([basis, Z]), np.eye(2, 3), atol=1e-15)
    with pytest.raises(BadValue, match="axis is that of angle_deg; expected none: it is that of position_mm"):
        Limit(Quantity.ANGLE, 0.1, axis=Z)
    with pytest.raises(BadValue, match="direction is given beside an axis; expected one of them"):
        Limit(Quantity.POSITION, 0.1, axis=Z, direction=Z)
    with pytest.raises(BadValue, match="a vector that is not zero"):
        Limit(Quantity.POSITION, 0.1, axis=np.zeros(3))


def test_what_steps_err_by_where_small_rims_bend_is_in_the_uncertainty_of_their_place() -> None:
    """They look too large; of one that shows in part that looks like a displacement, here by a sixth of a px."""
    limit = within(0.3)
    found = verified(drilled(), [limit], SIDE, names=["A", "C", "D"], camera=Camera.from_focal((1200, 900), 1100.0))
    assert found.inspection is not None
    measured = found.inspection.measured
    assert measured is not None
    rows = measured.members[0]
    bent = replace(measured, adjustment=measured.bent(measured.adjustment, rows), found={})
    one, other = (m.displacement(rows, along=limit.basis) for m in (measured, bent))
    assert one is not None
    assert other is not None
    off = one.basis.T @ (other.vector - one.vector)
    assert np.hypot(*off) > 0.05
    assert off @ np.linalg.solve(one.estimate.covariance, off) < 1.1  # 1 sigma at most, but for what is not linear


def test_a_hole_whose_edges_agree_on_no_size_has_no_place_either(monkeypatch: pytest.MonkeyPatch) -> None:
    """A piece of a rim was taken for the other rim, 2 px away: 0.232 +- 0.017 mm off, in truth 0.151."""
    (sure,) = verified(drilled(), [within(0.3)], ABOVE, names=["A"]).judgements
    monkeypatch.setattr(judge, "_MISTAKEN", 0.0)  # as if they scattered as no circle's do
    (j,) = verified(drilled(), [within(0.3)], ABOVE, names=["A"]).judgements
    assert (sure.verdict, j.verdict) == (Verdict.PASS, Verdict.UNDECIDED)
    assert "but its edges do not agree on one place and size: take another view" in j.reason
    assert (j.deviation, j.sigma) == (sure.deviation, sure.sigma)


def test_a_direction_along_which_edges_do_not_agree_is_not_judged(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot = [photo(plate(), rng)]
    along = Limit(Quantity.POSITION, 5.0, direction=np.array([0.0, 1.0, 0.0]))
    asked = Tolerances((Feature("rib", Selection("rib 1"), (along,)),))
    for most, verdict in ((judge.DISAGREE, Verdict.PASS), (-1.0, Verdict.UNDECIDED)):
        monkeypatch.setattr(judge, "DISAGREE", most)
        (found,) = verify_part(part(), shot, refine_pose(part(), shot, Rigid()), asked).judgements
        assert found.verdict is verdict
    assert "its edges do not agree on one place" in found.reason
