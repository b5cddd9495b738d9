"""Edges behind a body that is not there: sought among the bodies around it alone, with the same result."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.verify.bodies import findings
from cadcam.verify.bodies.case import Case
from cadcam.verify.bodies.findings import findings_of, findings_redrawn
from cadcam.verify.bodies.redrawn import redrawn
from cadcam.verify.bodies.uncovered import around, uncovered_ratio
from cadcam.verify.edges.presence import EdgeEvidence, EdgeVisibility, log_ratio
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.survey import surveyed
from cadcam.verify.tolerances.tolerance import whole_parts

from .scene import displaced, part, photo, plate

ACROSS = np.array([0.0, 1.5, 0.0])


@cache
def crowded() -> Part:
    """Return a screen on a plate, a bar behind it that it hides in part, and posts far from both."""
    bodies = [box((-150, -100, 0), (150, 100, 12), name="plate")]
    bodies += [box((-60, -60, 12), (-10, -50, 60), name="screen"), box((-55, -30, 12), (-15, -22, 30), name="bar")]
    bodies += [box((x, y, 12), (x + 14, y + 14, 30), name=f"post {x} {y}") for x in (60, 90, 120) for y in (-80, 0, 60)]
    return Part.of(merge(bodies))


def case_of(model: Part, mesh: Mesh, rng: np.random.Generator) -> Case:
    return Case(model, [photo(mesh, rng)], Rigid(), whole_parts(model.scene), np.eye(6), 8.0, 0.01)


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("by", [0.0, 3.0])
def test_the_bodies_around_tell_what_all_others_tell(missing: bool, by: float, rng: np.random.Generator) -> None:
    """To rounding: what is far away draws no line, and hides none, where the body is.

    by: mm along x by which the bar behind it is drawn displaced.
    """
    mesh = crowded().scene.mesh
    body, bar = (mesh.part_names.index(name) for name in ("screen", "bar"))
    shift = np.zeros((len(mesh.part_names), 3))
    shift[bar, 0] = by
    stands = displaced("bar", shift[bar], mesh)
    case = case_of(crowded(), displaced("screen", None, stands) if missing else stands, rng)
    drawn = redrawn(crowded(), shift) if by else crowded()
    assert drawn is not None
    survey = surveyed(drawn, case.photos, Rigid(), case.asked, reach_px=8.0, by=shift)
    near = around(drawn, case.photos, Rigid(), body, survey)
    assert near[[0, bar]].all()
    assert near.sum() == 2
    every = np.arange(len(near)) != body
    told, whole = (
        uncovered_ratio(drawn, case.alone(parts, shift), case.photos, Rigid(), body, survey) for parts in (near, every)
    )
    assert told == pytest.approx(whole, rel=1e-9)
    assert told < -1 or not missing  # the bar's edges are there to be seen


def test_bodies_apart_from_the_others_are_drawn_once_in_the_same_places(rng: np.random.Generator) -> None:
    """Their lines take long in large models, and are asked for again each time that another body is redrawn."""
    mesh = crowded().scene.mesh
    case, far = case_of(crowded(), mesh, rng), mesh.part_names.index("post 60 60")
    parts, shift = np.isin(np.arange(len(mesh.part_names)), (0, 2)), np.zeros((len(mesh.part_names), 3))
    first = case.alone(parts, shift)
    shift[far, 0] = 3.0
    assert case.alone(parts, shift) is first
    shift[2, 0] = 3.0
    assert case.alone(parts, shift).scene.mesh.bounds[1][0] == first.scene.mesh.bounds[1][0]  # that of the plate
    assert case.alone(parts, shift) is not first


def test_what_a_part_shows_without_a_body_is_drawn_where_that_is_alone(rng: np.random.Generator) -> None:
    shot = photo(plate(), rng)
    every = ShownFaces.of(part(), shot, Rigid())
    for body in range(len(plate().part_names)):
        left, whole = every.uncovered(part(), shot, Rigid(), body), ShownFaces.of(part(), shot, Rigid(), without=body)
        np.testing.assert_array_equal(left.part[left.face], whole.part[whole.face])
        np.testing.assert_array_equal(left.normal[left.face], whole.normal[whole.face])
        np.testing.assert_array_equal(left.surface[left.face], whole.surface[whole.face])


def test_edges_without_number_do_not_underflow() -> None:
    """Thousands of edges between the same two surfaces: 0.01^5000 is no number, the ratio of two such is one."""
    n = 5000
    edge = np.arange(n)
    evidence = EdgeEvidence(edge, 0 * edge, np.full(n, 0.5), edge % 50 > 0, edge < 0, np.full(n, np.nan), edge)
    told = log_ratio(evidence, np.ones(n, bool), EdgeVisibility(0.015, 0.02), 0.01)
    seen = int(evidence.seen.sum())
    assert told == pytest.approx(seen * np.log(0.98 / 0.01) + (n - seen) * np.log(0.02 / 0.99), rel=1e-4)


def test_a_drawing_that_explains_no_more_is_dropped_before_its_bodies_are_looked_for(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Looking for them one by one takes long where there are many."""
    case = case_of(part(), displaced("block", ACROSS, plate()), rng)
    look = findings_of(case, part(), surveyed(part(), case.photos, Rigid(), case.asked, reach_px=8.0))
    asked: list[object] = []
    monkeypatch.setattr(findings, "_likelier", lambda *_, **__: False)
    monkeypatch.setattr(findings, "findings_of", lambda *them: asked.append(them))
    drawn: list[object] = []
    monkeypatch.setattr(findings, "surveyed", lambda *a, **k: drawn.append(a) or surveyed(*a, **k))
    monkeypatch.setattr(findings, "_likeliest", lambda *_: (ACROSS, 1.0))
    assert findings_redrawn(case, look).survey is look.survey
    assert drawn
    assert not asked
