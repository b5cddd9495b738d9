"""The worst piece of a feature's edges: it is known only of edges that are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.locate.refine.refinement import refine_pose
from cadcam.verify import judge
from cadcam.verify.judge import verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict

from .scene import part, photo, plate

BACK = 22  # the rib's upper edge at its back, beyond which the photo shows what is as bright as the rib


def thicker(by: float) -> Mesh:
    """Return the plate with a rib that is thicker at its back by so many mm."""
    mesh = plate()
    vertices, own = mesh.vertices.copy(), np.unique(mesh.faces[mesh.part == mesh.part_names.index("rib 1")])
    vertices[own[vertices[own, 1] > -50], 1] += by
    return replace(mesh, vertices=vertices)


def judged(mesh: Mesh, chains: tuple[int, ...] = ()) -> Judgement:
    """Return what is judged of the profile of the rib's edges, or some of them, to 1 mm."""
    taken = [photo(mesh, np.random.default_rng(1))]
    asked = Feature("rib", Selection("rib 1", chains), (Limit(Quantity.PROFILE, 1.0),))
    (judgement,) = verify_part(part(), taken, refine_pose(part(), taken, Rigid()), Tolerances((asked,))).judgements
    return judgement


@pytest.mark.parametrize("by", [0.0, 3.0, 4.0])
def test_edges_that_are_not_seen_may_be_anywhere(by: float) -> None:
    """All that is measured of a rib that is 4 mm too thick is in place: it passed."""
    found = judged(thicker(by))
    assert found.verdict is Verdict.UNDECIDED
    assert f"but brep {BACK} is not seen, or only in part: give more light" in found.reason
    assert abs(found.deviation) + found.U < 1.0


def test_edges_that_are_seen_pass() -> None:
    edges = part().scene.edges
    others = np.unique(edges.chain[edges.part == part().scene.mesh.part_names.index("rib 1")])
    assert judged(plate(), tuple(others[others != BACK].tolist())).verdict is Verdict.PASS


def test_an_edge_that_another_photo_measures_is_known() -> None:
    """Twice as far it is half as long: that the near photo, where most is asked, does not show it says nothing."""
    near = Rigid.look_at((227.5, -341.0, 346.5), (-20.0, -40.0, 20.0))
    beyond = Rigid.look_at((-500.0, 900.0, 800.0), (10.0, 0.0, 10.0))
    taken = [photo(plate(), np.random.default_rng(1), near, name="near")]
    taken.append(photo(plate(), np.random.default_rng(2), beyond, name="beyond"))
    asked = Tolerances((Feature("rib", Selection("rib 1"), (Limit(Quantity.PROFILE, 3.0),)),))
    for some, verdict in ((taken[:1], Verdict.UNDECIDED), (taken, Verdict.PASS)):
        (found,) = verify_part(part(), some, refine_pose(part(), some, Rigid()), asked).judgements
        assert found.verdict is verdict, found.reason


def test_what_makes_a_piece_uncertain_is_told_of_that_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not of its edge, whose noise averages out."""
    told: list[dict[str, float]] = []
    explained = judge.explained

    def spy(found: Judgement, shares: dict[str, float]) -> Judgement:
        told.append(shares)
        return explained(found, shares)

    monkeypatch.setattr(judge, "explained", spy)
    edges = part().scene.edges
    others = np.unique(edges.chain[edges.part == part().scene.mesh.part_names.index("rib 1")])
    taken = [photo(plate(), np.random.default_rng(1))]
    limits = (Limit(Quantity.PROFILE, 1.0),)
    asked = Tolerances((Feature("rib", Selection("rib 1", tuple(others[others != BACK].tolist())), limits),))
    found = verify_part(part(), taken, refine_pose(part(), taken, Rigid()), asked)
    (judgement,), (shares,) = found.judgements, told
    (worst,) = [
        s for e in found.inspection.edges for s in e.station if s[1] == judgement.deviation and s[2] == judgement.sigma
    ]
    assert worst[3:].sum() == pytest.approx(worst[2] ** 2)
    assert shares["noise"] == pytest.approx(worst[3] / worst[3:].sum())
