"""Features whose box cuts edges: what lies in the box is theirs, of each edge, and what lies outside is not."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.locate.refine.refinement import refine_pose
from cadcam.plan.scene.feature import LayoutFeature
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Verdict

from .scene import POSE, displaced, part, photo, plate

DATUM = tuple(Selection(name) for name in ("plate", "rib 2", "block", "bracket"))
TOP = 21  # the rib's upper edge in front, of 160 mm
BESIDE = (POSE, *(Rigid.look_at(eye, (10.0, 0.0, 10.0)) for eye in ((200.0, -700.0, 640.0), (-50.0, -720.0, 620.0))))


def with_rib(change: Callable[[Array], Array]) -> Mesh:
    """Return the plate with a change (n, 3) mm of its first rib's vertices (n, 3)."""
    mesh = plate()
    vertices, own = mesh.vertices.copy(), np.unique(mesh.faces[mesh.part == mesh.part_names.index("rib 1")])
    vertices[own] += change(vertices[own])
    return replace(mesh, vertices=vertices)


def sloping(p: Array) -> Array:
    """Return the change of a rib that is 4 mm lower at the end of large x, and as in the CAD at the other."""
    return np.where(p[:, 2:] > 50, -4.0 * (p[:, :1] + 120) / 160, 0.0) * [0, 0, 1]


def broken(p: Array) -> Array:
    """Return the change of a rib whose last 32 mm have broken off."""
    return np.where(p[:, :1] > 0, 8.0 - p[:, :1], 0.0) * [1, 0, 0]


def end_of_rib(
    low: float, high: float, limit: Limit, *, above: float = 45.0, chains: tuple[int, ...] = ()
) -> Tolerances:
    box = np.array([[low, -70.0, above], [high, -40.0, 60.0]])
    return Tolerances((Feature("end", Selection("rib 1", chains, box), (limit,)),), DATUM)


def verified(mesh: Mesh, asked: Tolerances, *, photos: int = 1) -> Verification:
    taken = [photo(mesh, np.random.default_rng(i), BESIDE[i], name=f"{i}") for i in range(photos)]
    return verify_part(part(), taken, refine_pose(part(), taken, Rigid()), asked)


@pytest.mark.parametrize(
    ("low", "high", "chains", "verdict"), [(-125, -35, (TOP,), Verdict.PASS), (5, 45, (), Verdict.FAIL)]
)
def test_a_profile_is_that_of_the_places_in_the_box(
    low: float, high: float, chains: tuple[int, ...], verdict: Verdict
) -> None:
    """An edge that slopes away by 4 mm, to be within 1.5 mm across the line of sight: half of it is, its end is not.

    That passed, for the middle of the edge lies outside of the box.
    """
    asked = end_of_rib(low, high, Limit(Quantity.PROFILE, 1.5), above=15.0, chains=chains)
    found = verified(with_rib(sloping), asked)
    (judgement,) = found.judgements
    assert judgement.verdict is verdict
    assert found.inspection is not None
    (edge,) = (e for e in found.inspection.edges if e.chain == TOP and "rib 1" in e.part)
    assert set(edge.features) == {"end", "rib 1"}
    seen = abs(edge.direction[2]) * 4.0 * (min(high, 40) + 120) / 160  # at the end of the box
    assert 0.7 * seen - judgement.U < abs(judgement.deviation) < seen + judgement.U  # the last piece's middle is before


def test_a_broken_off_end_is_not_there_because_the_rest_of_its_edges_is() -> None:
    """By each photo more it seemed to be there more surely; a whole rib's end is, in the same photos."""
    asked = end_of_rib(10, 45, Limit(Quantity.PRESENCE, 0.0))
    for mesh, verdict in ((with_rib(broken), {Verdict.UNDECIDED, Verdict.FAIL}), (plate(), {Verdict.PASS})):
        (judgement,) = verified(mesh, asked, photos=3).judgements
        assert judgement.verdict in verdict


def test_what_is_asked_of_other_features_changes_no_presence() -> None:
    """Ten boxes across a rib: its edges seemed to be many, or none long enough to be evidence."""
    rib = Feature("rib", Selection("rib 1"), (Limit(Quantity.PRESENCE, 0.0),))
    boxes = [np.array([[x, -70.0, 10.0], [x + 8.0, -40.0, 60.0]]) for x in range(-120, 40, 16)]
    others = [Feature(f"box {k}", Selection("rib 1", box=box)) for k, box in enumerate(boxes)]
    told = []
    for asked in (Tolerances((rib,), DATUM), Tolerances((rib, *others), DATUM)):
        inspection = verified(plate(), asked).inspection
        assert inspection is not None
        presence = inspection.feature("rib").presence
        told.append((presence.expected, presence.seen))
    assert told[0] == told[1]


def test_a_box_within_an_edge_is_a_choice_and_one_beside_it_is_not() -> None:
    """Of 28 mm of an edge of 160 mm."""
    within = Selection("rib 1", box=np.array([[10.0, -70.0, 45.0], [38.0, -55.0, 60.0]]))
    within.check(part().scene)
    chosen, ends = within.segments(part().scene)
    np.testing.assert_allclose(ends[chosen][:, :, 0].min(), 10.0)
    np.testing.assert_allclose(ends[chosen][:, :, 0].max(), 38.0)
    planned = LayoutFeature.selected("end", within, part().scene, ())
    np.testing.assert_allclose(planned.p, [24.0, -60.0, 52.0])
    beside = replace(within, box=np.array([[10.0, -70.0, 65.0], [38.0, -55.0, 80.0]]))
    said = "empty; expected a box_mm within [-120.0, -60.0, 12.0] to [40.0, -48.0, 52.0]"
    with pytest.raises(BadValue, match=re.escape(said)):
        beside.check(part().scene)


def test_a_photo_that_shows_nothing_of_the_part_changes_nothing() -> None:
    """What one photo does not show is not shown by another that looks away, either; a good part was undecided."""
    away = Rigid.look_at((420.0, -620.0, 640.0), (900.0, -1400.0, 1300.0))
    limits = Limit(Quantity.POSITION, 1.0), Limit(Quantity.ANGLE, 0.05)
    asked = Tolerances((Feature("rib 1", Selection("rib 1"), limits), Feature("rib 2", Selection("rib 2"))))
    one = photo(plate(), np.random.default_rng(1))
    other = photo(displaced("plate", np.array([0.0, 0.0, -1e5])), np.random.default_rng(5), away, name="away")
    found = [verify_part(part(), taken, refine_pose(part(), taken, Rigid()), asked) for taken in ([one], [one, other])]
    for alone, both in zip(*(each.judgements for each in found), strict=True):
        assert alone.verdict is both.verdict is Verdict.PASS
        assert pytest.approx(alone.U, rel=0.01) == both.U
    assert [each.inspection is not None and each.inspection.sized_by_datum for each in found] == [True, True]
