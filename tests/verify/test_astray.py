"""Edges that a shadow leads astray: nobody is called displaced for one of them, and even light knows no shadow."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import chi2
from scipy.stats import f as fisher

from cadcam.arrays import Array
from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo
from cadcam.verify import inspection
from cadcam.verify.bodies.case import Case
from cadcam.verify.bodies.findings import elsewhere_by, findings_of, sure
from cadcam.verify.bodies.redrawn import redrawn
from cadcam.verify.bodies.states import state_of
from cadcam.verify.deviations import astray
from cadcam.verify.deviations.astray import Doubt, EdgeGroup, _possible, broken_edges
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.deviations.ground import _uneven, uneven_edges
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges
from cadcam.verify.edges.presence import in_place_ratio
from cadcam.verify.edges.shifts import CAPTURE_PX
from cadcam.verify.edges.sightlines import pieces
from cadcam.verify.edges.survey import surveyed
from cadcam.verify.inspection import Inspection, _doubted, inspect
from cadcam.verify.tolerances.tolerance import whole_parts

from .drilled import HOLES, OBLIQUE, PINS, drilled, verified, within
from .scene import CAMERA, POSE, displaced, part, photo, photographed, plate

BLOCK = (70, -70, 12), (120, -10, 45)


def strip(gray: Array, ends: tuple[Array, Array], width: float, share: float) -> Photo:
    """Return the photo with a shadow as wide as some mm along a line on the plate, which takes a share of the light."""
    a, b = (np.asarray(p, np.float64) for p in ends)
    side = np.cross(b - a, (0.0, 0.0, 1.0))
    side *= width / np.linalg.norm(side)
    corners = CAMERA.project(POSE @ np.stack([a, b, b + side, a + side]))
    y, x = np.indices(gray.shape)
    inside = np.ones(gray.shape, bool)
    edges = np.roll(corners, -1, axis=0) - corners
    turn = np.sign(edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0])
    for corner, edge in zip(corners, edges, strict=True):
        inside &= turn * (edge[0] * (y - corner[1]) - edge[1] * (x - corner[0])) >= 0
    return Photo.of(np.where(inside, (1 - share) * gray, gray).astype(np.float32), CAMERA, POSE)


def with_shadows(rng: np.random.Generator) -> Photo:
    """Return a photo in which shadows lie along a foot of the block, and across the plate elsewhere."""
    gray = photographed(plate(), rng)
    (x0, y0, z), (x1, _, _) = BLOCK
    along_foot = strip(gray, (np.array([x0, y0, z]), np.array([x1, y0, z])), 1.6, 0.35)
    across = strip(along_foot.gray, (np.array([-140.0, -95.0, z]), np.array([60.0, 85.0, z])), 9.0, 0.4)
    return strip(across.gray, (np.array([-20.0, -95.0, z]), np.array([140.0, 60.0, z])), 7.0, 0.3)


def off(seen: Inspection, name: str) -> list[float]:
    return [abs(e.value / e.sigma) for e in seen.edges if e.part == name and np.isfinite(e.value)]


def test_a_body_with_an_edge_beside_a_shadow_is_not_called_displaced(rng: np.random.Generator) -> None:
    """The edge is off by far more than its sigma: were edges' errors Gaussian, the block would be."""
    seen = inspect(part(), [with_shadows(rng)], Rigid())
    assert max(off(seen, "block")) > 6.0
    assert not [f.name for f in seen.features if f.state in (State.DISPLACED, State.MISSING)]
    block = seen.feature("block")
    assert block.state is State.IN_PLACE or block.why is Unclear.ASTRAY


def test_ground_is_even_in_even_light_and_uneven_where_shadows_cross_it(rng: np.random.Generator) -> None:
    for shot, uneven in ((photo(plate(), rng), False), (with_shadows(rng), True)):
        told = uneven_edges(inspect(part(), [shot], Rigid()).survey, [shot])
        assert len(told) > 8
        assert any(told.values()) is uneven


def test_a_texture_that_steps_along_no_edge_is_no_uneven_ground(rng: np.random.Generator) -> None:
    """Blotches of 7 % everywhere average out along most edges, and what is left is little beside their steps."""
    even, edges = 0, 0
    for _ in range(2):
        gray = photographed(plate(), rng)
        blotches = gaussian_filter(rng.normal(size=gray.shape), 2.0)
        gray = np.clip(gray * (1 + 0.07 * blotches / blotches.std()), 0, 1)
        shot = Photo.of(gray.astype(np.float32), CAMERA, POSE)
        told = uneven_edges(inspect(part(), [shot], Rigid()).survey, [shot])
        even, edges = even + sum(not uneven for uneven in told.values()), edges + len(told)
    assert edges > 40
    assert even > edges * 2 / 3


def test_how_far_ground_is_uneven_is_asked_beside_the_step_of_the_edge() -> None:
    """A change that runs along an edge leads a strong one astray by little; one that differs by place leads none."""
    along = np.broadcast_to(0.5 + 0.05 * (np.arange(7) > 2)[:, None], (7, 12))
    by_place = 0.5 + 0.05 * (np.arange(7)[:, None] > 2) * np.where(np.arange(12) % 2, 1, -1)
    everywhere = np.ones((7, 12), bool)
    assert _uneven(along, everywhere, 0.1, 0.002) is True
    assert _uneven(along, everywhere, 0.4, 0.002) is False
    assert _uneven(by_place, everywhere, 0.1, 0.002) is False
    assert _uneven(along, everywhere, 0.1, 0.03) is False  # not told from noise
    assert _uneven(along, np.zeros((7, 12), bool), 0.1, 0.002) is None


@pytest.mark.parametrize("by", [(1.5, 0.0, 0.0), (0.0, 1.5, 0.5)])
def test_a_body_that_is_displaced_is_so_beside_shadows_too(rng: np.random.Generator, by: tuple[float, ...]) -> None:
    """Several of its edges say so."""
    gray = photographed(displaced("block", np.array(by)), rng)
    shot = strip(gray, (np.array([-140.0, -95.0, 12.0]), np.array([40.0, 85.0, 12.0])), 9.0, 0.4)
    assert inspect(part(), [shot], Rigid()).feature("block").state is State.DISPLACED


def test_doubt_adds_what_edges_astray_explain() -> None:
    """Of two of three edges: p + sum c_e p_e + c_f sum c_e p_ef, f being the one that matters more."""
    tried = np.array([0.1, 0.4, 0.0]), np.array([0.7, 0.0, 0.5])
    chance = np.array([0.01, 0.02, 0.05])
    doubt = Doubt(tuple(EdgeGroup((e,)) for e in range(3)), 3, tried)
    expected = 1e-6 + (0.01 * 0.1 + 0.02 * 0.4) + 0.02 * (0.01 * 0.7 + 0.05 * 0.5)
    assert doubt.p_value(1e-6, chance) == pytest.approx(expected)
    assert doubt.p_value(1e-6, np.zeros(3)) == 1e-6
    assert doubt.p_value(0.5, np.full(3, 1.0)) == 1.0
    assert doubt.astray == 0  # two of three are off: it is rather displaced
    assert Doubt(tuple(EdgeGroup((e,)) for e in range(4)), 4, tried[:1]).astray == 1
    others = Doubt(tuple(EdgeGroup((e,)) for e in range(4)), 1, tried[:1])
    assert others.astray == 0  # the one that matters is not its own


def test_edges_so_far_off_that_no_chance_is_left_are_doubted_like_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of eight edges six are looked at, not the first: without any of them the probability underflows, as with all."""
    places = [np.arange(8) == i for i in range(8)]
    far = np.arange(8.0)
    monkeypatch.setattr(astray, "side_by_side", lambda *_: places)
    monkeypatch.setattr(astray, "_off", lambda *_: (far, far))
    monkeypatch.setattr(astray, "_holding", lambda *_: [])
    moved = SimpleNamespace(p_value=0.0)
    measured = SimpleNamespace(
        moved=lambda _: moved,
        members=(np.ones(8, bool),),
        displacement=lambda *_, **__: moved,
        lines=SimpleNamespace(edge=np.arange(8)),
    )
    doubt = Doubt.of(cast("MeasuredEdges", measured), 0)
    assert {int(np.argmax(ps)) for ps in doubt.tried} < {2, 3, 4, 5, 6, 7}
    assert doubt.gone == 4
    assert doubt.p_value(0.0, np.full(8, 0.1)) < 1e-300


def test_edges_are_led_far_astray_more_rarely_and_oftenest_beside_uneven_ground() -> None:
    uneven = {1: True, 2: False}
    near = [EdgeGroup((e,), 0.1).chance(0.02, uneven) for e in (1, 2, 3)]
    assert near[0] > near[1] == near[2] > 0
    assert EdgeGroup((1, 2), 0.1).chance(0.02, uneven) == near[0]
    far = [EdgeGroup((2,), off).chance(0.02, uneven) for off in (0.4, 0.8, 1.0, 3.0)]
    assert near[1] > far[0] == pytest.approx(4 * far[1])
    assert far[1] > far[2] == far[3]  # that far off it is rather another line, wherever that is


def test_edges_that_show_in_part_are_astray_the_more_often_and_farther() -> None:
    for uneven in ({}, {1: True}):
        near, far = ([EdgeGroup((1, 2), off).chance(0.02, uneven, those) for those in ((), {2})] for off in (0.4, 0.8))
        assert 0 < near[0] < near[1]
        assert far[1] / far[0] > near[1] / near[0]
    assert EdgeGroup((1,), 0.4).chance(1.0, {1: True}, {1}) <= 1.0


def test_an_edge_that_is_hidden_along_much_of_it_is_broken(rng: np.random.Generator) -> None:
    gray = photographed(plate(), rng)
    seen = inspect(part(), [Photo.of(gray, CAMERA, POSE)], Rigid()).survey
    edge = np.bincount(seen.lines.edge[seen.matched.measured]).argmax()
    q = seen.lines.q[seen.lines.edge == edge]
    y, x = np.indices(gray.shape)
    near = np.hypot(x - q[len(q) // 2, 0], y - q[len(q) // 2, 1]) < 0.2 * np.linalg.norm(q[-1] - q[0])
    dirty = Photo.of(np.where(near, rng.uniform(size=gray.shape), gray).astype(np.float32), CAMERA, POSE)
    assert edge not in broken_edges(seen)
    assert edge in broken_edges(inspect(part(), [dirty], Rigid()).survey)


def test_drawn_elsewhere_a_body_is_beyond_doubt_only_where_its_pixels_say_so(rng: np.random.Generator) -> None:
    """A foot's shadow alone may not: the block stands in its place, and most of what it covers looks like that."""
    mesh = part().scene.mesh
    body, by = mesh.part_names.index("block"), np.zeros((len(mesh.part_names), 3))
    by[body] = (6.0, 0.0, 0.0)
    drawn = redrawn(part(), by)
    assert drawn is not None
    for shot, there in ((photo(displaced("block", by[body]), rng), True), (with_shadows(rng), False)):
        asked = whole_parts(part().scene)
        case = Case(part(), [shot], Rigid(), asked, np.eye(6), 8.0, 0.01)
        look = findings_of(case, drawn, surveyed(drawn, [shot], Rigid(), asked, reach_px=8.0, by=by))
        assert (elsewhere_by(case, look, body) > sure(look.presence, 0.01)) is there


def test_edges_that_are_off_by_no_displacement_of_all_of_it_displace_nothing(rng: np.random.Generator) -> None:
    """However improbable that is of a body in place: they contradict each other.

    What they say together has to be as sure as an alarm: one of 400, where a body in place says as much one time in 30.
    How much they disagree is known by their number: a bolt was called displaced, 1.6 px from where it was, by two edges
    of its own and two feet.
    """
    moved = inspect(part(), [photo(displaced("block", np.array([1.5, 0.0, 0.0])), rng)], Rigid()).feature("block")
    assert moved.displacement is not None
    value, covariance = moved.displacement.value, moved.displacement.covariance
    sigmas = np.sqrt(value @ np.linalg.solve(covariance, value))
    alike, little, apart, rare = 1.0, 5.0, 50.0, 1 / 400  # misfits, share of false alarms
    every, few = np.inf, 3.0  # degrees of freedom
    for chance, misfit, dof in product((1e-12, rare / 2, 2 * rare, 1 / 30, 0.9), (alike, little, apart), (every, few)):
        m = len(value)
        size2 = chi2.isf(chance, m) if dof == every or misfit < apart else m * fisher.isf(chance, m, dof)
        share = np.sqrt(size2) / sigmas
        state = State.UNCLEAR if chance > rare and misfit > alike else State.DISPLACED
        told = replace(moved.displacement, value=share * value, misfit=misfit, dof=dof)
        found = Displacement(moved.seen, told, 1e-12, edges=4, misfit=misfit)
        assert state_of(moved.presence, found, True, 6.5, near=True, rare=rare)[0] is state


def test_the_rim_of_a_hole_is_several_pieces_and_a_straight_edge_one() -> None:
    way = np.arange(48) * 2 * np.pi / 48
    normal, edge = np.stack([np.cos(way), np.sin(way)], axis=1), np.zeros(48, np.int64)
    rim = pieces(edge, normal)
    assert np.bincount(rim).tolist() == [12] * 4
    assert all((normal[rim == i] @ normal[rim == i].T).min() > -1e-9 for i in range(4))  # none faces two ways
    assert not pieces(edge, np.tile([[-1.0, 1e-9], [-1.0, -1e-9]], (24, 1))).any()
    assert not pieces(edge[:12], normal[:12]).any()  # less than a right angle
    assert pieces(np.arange(48) // 24, np.tile([[0.6, 0.8]], (48, 1))).tolist() == [0] * 24 + [1] * 24


def test_edges_go_astray_as_far_as_there_is_uneven_ground() -> None:
    even, some = dict.fromkeys(range(20), False), {e: e < 1 for e in range(20)}
    assert _possible(even, {5}) == 0.0
    assert _possible({}, {5}) == 0.0
    assert _possible(some, {0}) == 1.0  # its own
    assert 0.0 < _possible(some, {5}) < 1.0
    assert _possible({e: e < 8 for e in range(20)}, {9}) == 1.0


@pytest.mark.parametrize("clutter", [0.05, 0.3, 0.6])
def test_where_clutter_lies_says_nothing_for_a_body(rng: np.random.Generator, clutter: float) -> None:
    """A likelihood ratio is 1 on the mean where its denominator is true, so at most 1 here; to four standard errors."""
    rate = -np.log1p(-clutter)
    ratios = []
    for _ in range(4000):
        nearest = []
        while len(nearest) < 3:
            places = rng.uniform(-CAPTURE_PX, CAPTURE_PX, rng.poisson(rate))
            if len(places):
                nearest.append(places[np.argmin(np.abs(places))])
        ratios.append(np.exp(in_place_ratio(np.array(nearest), np.full(3, 0.08), clutter)))
    assert np.mean(ratios) <= 1 + 4 * np.std(ratios) / np.sqrt(len(ratios))
    assert in_place_ratio(np.zeros(3), np.full(3, 0.08), clutter) > 3.0


@pytest.mark.parametrize("apart", [1.0, 3.0])
def test_a_rim_whose_pieces_disagree_is_one_of_three_cases_however_far_they_do(apart: float) -> None:
    """Of another size it is not, then; nor in place: what is left is that it is displaced, a case out of three."""
    offset = apart * np.array([-1.0, 0.0, 1.0, 0.5])
    told = in_place_ratio(offset, np.full(4, 0.08), 0.3, rim=np.ones(4, bool))
    in_place, displaced = in_place_ratio(offset, np.full(4, 0.08), 0.3), np.log(1 / 2)
    assert in_place >= displaced
    assert told == pytest.approx(in_place + np.log(2 / 3), abs=1e-6)


def test_edges_that_hold_a_hole_s_place_are_rarely_so_far_astray_that_it_would_be_in_place() -> None:
    """C is 0.75 mm off, 3 px: were it in place, one of three other edges would be off by 0.2 to 1.4 px for sure."""
    seen = verified(drilled(C=(0.0, -0.75, 0.0)), [within(0.3)], OBLIQUE, names=[*HOLES, *PINS]).inspection
    assert seen is not None
    assert seen.measured is not None
    doubt = Doubt.of(seen.measured, seen.survey.names.index("C"))
    off_px = [group.off_px for group in doubt.groups[doubt.own :]]
    assert min(off_px) > 0.1
    assert max(off_px) > 1.0


def test_the_pose_is_not_fitted_to_edges_that_are_astray(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A body in place was measured without an edge astray, from a pose fitted to it as well: 0.2 px off, 5.8 sigma."""
    asked = whole_parts(part().scene)
    case = Case(part(), [photo(plate(), rng)], Rigid(), asked, np.eye(6), 8.0, 0.01)
    survey = surveyed(part(), case.photos, Rigid(), asked, reach_px=8.0)
    look = findings_of(case, part(), survey)
    lines, fit, block = look.measured.lines, look.measured.adjustment, survey.names.index("block")
    edges = np.unique(lines.edge[look.measured.members[block]])
    one = lines.edge == max(edges, key=lambda e: int((lines.edge == e).sum()))
    led = replace(fit, offset=fit.offset + 0.6 * one, known=None)
    monkeypatch.setattr(inspection, "uneven_edges", lambda *_: dict.fromkeys(edges.tolist(), True))
    told, _, p_values = _doubted(case, replace(look, measured=replace(look.measured, adjustment=led, found={})))
    assert not (told.members[block] & one).any()
    assert p_values[block] > 0.05
    astray_ones = look.measured.members[block] & ~told.members[block]
    np.testing.assert_array_equal(told.adjustment.datum, fit.datum & ~astray_ones)
