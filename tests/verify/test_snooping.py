"""Of parts that are all judged, each is measured from those that agree: what is displaced pulls nobody away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.geometry.rigid import Rigid
from cadcam.verify.adjustment.datum_fit import CAUSES
from cadcam.verify.bodies.case import Case
from cadcam.verify.bodies.redrawn import redrawn
from cadcam.verify.bodies.snooping import snooped
from cadcam.verify.deviations.deviation import State
from cadcam.verify.edges.survey import surveyed
from cadcam.verify.inspection import inspect
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances, whole_parts

from .scene import displaced, part, photo

LIMIT = Limit(Quantity.POSITION, 0.8)
EVERY = Tolerances(tuple(replace(f, limits=(LIMIT,)) for f in whole_parts(part().scene).features))


def test_where_every_part_is_judged_the_datum_is_those_that_agree(rng: np.random.Generator) -> None:
    """Its error is that of a datum stated to be right; of one stated to be all, the displaced rib pulls at the pose."""
    by = np.array([0.0, 3.0, 0.0])
    shot = photo(displaced("rib 1", by), rng)
    rest = tuple(Selection(f.selection.part) for f in EVERY.features if f.name != "rib 1")
    asked = {"none": EVERY, "right": replace(EVERY, datum=rest), "all": replace(EVERY, datum=(Selection("*"),))}
    seen = {which: inspect(part(), [shot], Rigid(), tolerances=tolerances) for which, tolerances in asked.items()}
    assert (seen["none"].left_out, seen["all"].left_out) == (("rib 1",), ())
    assert "rib 1" in seen["all"].contradictions
    off = {which: float(np.linalg.norm(one.pose.world_from_part.translation)) for which, one in seen.items()}
    assert off["none"] == off["right"]
    assert off["all"] > 2 * off["right"]
    for f in seen["none"].features:
        assert f.state is (State.DISPLACED if f.name == "rib 1" else State.IN_PLACE)
    rib = seen["none"].feature("rib 1")
    assert rib.displacement is not None
    V = np.sum([getattr(rib.displacement, cause) for cause in CAUSES], axis=0)
    missed = rib.seen.T @ by - rib.displacement.value
    assert float(missed @ np.linalg.solve(V, missed)) < 16  # four sigmas


def test_a_part_of_which_only_some_edges_are_judged_is_measured_from_the_rest(rng: np.random.Generator) -> None:
    """The control: then something is left of which nothing is asked, and that alone is the datum."""
    shot = photo(part().scene.mesh, rng)
    some = Feature("plate", Selection("plate", box=np.array([[-200, -200, -1], [0, 200, 20.0]])), (LIMIT,))
    asked = Tolerances((*(f for f in EVERY.features if f.name != "plate"), some))
    seen = inspect(part(), [shot], Rigid(), tolerances=asked)
    assert set(seen.datum) == {"rest of plate"}


def test_a_body_that_is_drawn_elsewhere_is_no_datum(rng: np.random.Generator) -> None:
    """Not even where it agrees with the others: they were left out for its sake, and called displaced."""
    shift = np.zeros((len(part().scene.mesh.part_names), 3))
    rib = part().scene.mesh.part_names.index("rib 1")
    shift[rib, 1] = 1.5
    case = Case(part(), [photo(part().scene.mesh, rng)], Rigid(), whole_parts(part().scene), np.eye(6), 8.0, 0.01)
    for by, without in ((0 * shift, []), (shift, ["rib 1"])):
        drawn = redrawn(part(), by)
        assert drawn is not None
        survey = surveyed(drawn, case.photos, Rigid(), case.asked, reach_px=8.0, by=by)
        measured, left_out = snooped(survey, np.ones(len(survey.names), bool), case)
        assert [survey.names[i] for i in left_out] == without
        assert not measured.adjustment.datum[np.isin(measured.body, left_out)].any()
        stated, _ = snooped(replace(survey, stated=True), np.ones(len(survey.names), bool), case)
        assert stated.adjustment.datum[measured.body == survey.names.index("rib 1")].any()
