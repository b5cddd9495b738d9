"""Marks are put into the order of their plan from any view, and ambiguous orders are reported as such."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.errors import BadValue, DegenerateGeometry, NoOrder, TooFewPoints, UnknownName
from cadcam.fit.plane_maps import mapped
from cadcam.geometry.rigid import Rigid
from cadcam.target.order.ordering import order_marks
from cadcam.target.order.seeds import seeds

NOISE = 0.3  # px
CAMERA = Camera.from_focal((768, 576), 900.0)


def scattered(rng, count):
    """Return a plan in a square of side 1 whose marks keep some distance, as plates are drawn."""
    plan = []
    while len(plan) < count:
        p = rng.uniform(-0.5, 0.5, 2)
        if all(np.hypot(*(p - other)) > 0.6 / np.sqrt(count) for other in plan):
            plan.append(p)
    return np.array(plan)


def lattice(columns, rows):
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    plan = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    return (plan - plan.mean(axis=0)) / np.ptp(plan, axis=0).max()


def seen(rng, plan, *, tilt=0.0, turn=0.0, missing=0, false=0, camera=CAMERA):
    """Return pixels in a random order and the plan's mark of each, -1 for false ones."""
    at = Rigid(translation=[0, 0, 1.6]) @ Rigid.exp([0, 0, 0, np.radians(tilt), 0, 0])
    at = at @ Rigid.exp([0, 0, 0, 0, 0, np.radians(turn)])
    q = camera.project(at @ np.column_stack([plan, np.zeros(len(plan))]))
    kept = rng.permutation(len(plan))[missing:]
    q = q[kept] + rng.normal(0, NOISE, (len(kept), 2))
    q = np.concatenate([q, rng.uniform(q.min(axis=0), q.max(axis=0), (false, 2))])
    truth = np.concatenate([kept, np.full(false, -1)])
    shuffled = rng.permutation(len(q))
    return q[shuffled], truth[shuffled]


def share_right(order, truth):
    return np.mean((order == truth)[truth >= 0])


def taken_for_another(order, truth):
    """Return how many true marks got a wrong number; a false mark that lies on a missing one's place is none."""
    return int(((order >= 0) & (truth >= 0) & (order != truth)).sum())


@pytest.mark.parametrize("tilt", [0, 30, 60])
@pytest.mark.parametrize("seed", range(4))
def test_eight_marks_are_ordered_from_any_permutation(seed, tilt):
    rng = np.random.default_rng(seed)
    plan = scattered(rng, 8)
    q, truth = seen(rng, plan, tilt=tilt, turn=rng.uniform(0, 360))
    found = order_marks(q, plan)
    assert np.array_equal(found.plan_index, truth)
    assert not found.ambiguous
    assert found.chance < 0.01


@pytest.mark.parametrize("tilt", [0, 30, 45, 60])
@pytest.mark.parametrize("count", [20, 60, 200])
def test_a_fifth_missing_and_a_fifth_false_do_not_matter(rng, count, tilt):
    plan = scattered(rng, count)
    q, truth = seen(rng, plan, tilt=tilt, turn=rng.uniform(0, 360), missing=count // 5, false=count // 5)
    found = order_marks(q, plan)
    assert share_right(found.plan_index, truth) == 1.0
    assert not found.ambiguous
    false = found.plan_index[truth < 0]  # one within 3 robust sigmas of a missing mark's place cannot be told
    assert (false >= 0).sum() <= 2


@pytest.mark.parametrize("tilt", [0, 50])
def test_a_lens_that_bends_marks_by_a_third_of_their_spacing_is_followed(rng, tilt):
    plan = scattered(rng, 200)
    bent = Camera.from_focal((768, 576), 900.0, lens=BrownConrady(k1=-0.2))
    q, truth = seen(rng, plan, tilt=tilt, turn=20, missing=40, false=40, camera=bent)
    found = order_marks(q, plan)
    assert share_right(found.plan_index, truth) > 0.97
    assert taken_for_another(found.plan_index, truth) == 0


@pytest.mark.parametrize(("columns", "rows", "ways"), [(3, 3, 8), (4, 3, 4), (5, 4, 4), (14, 14, 8), (20, 10, 4)])
@pytest.mark.parametrize("tilt", [0, 50])
def test_every_symmetry_of_a_grid_is_named(rng, columns, rows, ways, tilt):
    plan = lattice(columns, rows)
    q, truth = seen(rng, plan, tilt=tilt, turn=20)
    found = order_marks(q, plan)
    orders = [found.plan_index, *found.alternatives]
    assert len(orders) == ways
    assert any(np.array_equal(order, truth) for order in orders)


@pytest.mark.parametrize(("columns", "rows"), [(14, 14), (20, 10)])
def test_a_grid_with_marks_missing_and_false_has_its_symmetries_and_no_shift(rng, columns, rows):
    plan = lattice(columns, rows)
    q, truth = seen(rng, plan, tilt=40, turn=20, missing=len(plan) // 5, false=len(plan) // 5)
    found = order_marks(q, plan)
    orders = [found.plan_index, *found.alternatives]
    assert len(orders) == (8 if columns == rows else 4)
    assert max(share_right(order, truth) for order in orders) == 1.0


def test_a_window_of_a_grid_is_ambiguous_by_every_shift_that_keeps_it_on_the_plan(rng):
    plan = lattice(7, 6)
    x, y = np.meshgrid(np.arange(7), np.arange(6))
    window = ((x < 5) & (y < 5)).ravel()
    q, truth = seen(rng, plan[window])
    found = order_marks(q, plan, side="kept")
    exact = {tuple(order) for order in (found.plan_index, *found.alternatives)}
    numbers = np.flatnonzero(window)
    for shift in (0, 1, 2):  # to the right; each also a row down, by one
        for down in (0, 1):
            assert tuple(numbers[truth] + shift + 7 * down) in exact
    assert found.ambiguous


def test_one_mark_off_the_grid_makes_its_order_certain(rng):
    plan = np.concatenate([lattice(5, 5), [[0.125, 0.375]], [[-0.375, 0.125]]])
    q, truth = seen(rng, plan, tilt=30, turn=200)
    found = order_marks(q, plan)
    assert np.array_equal(found.plan_index, truth)
    assert not found.ambiguous


def test_a_ring_of_marks_can_be_turned_by_every_step_and_mirrored():
    angle = np.arange(7) * 2 * np.pi / 7
    plan = np.column_stack([np.cos(angle), np.sin(angle)])
    q = 100 * plan + 300
    assert len(order_marks(q, plan, side="kept").alternatives) == 6
    assert len(order_marks(q, plan).alternatives) == 13


def test_four_marks_fit_in_four_ways_under_perspective_but_in_one_from_the_front(rng):
    plan = np.array([[-0.5, -0.4], [0.5, -0.5], [0.35, 0.4], [-0.4, 0.35]])
    front, truth = seen(rng, plan)
    straight = order_marks(front, plan)
    assert np.array_equal(straight.plan_index, truth)
    assert not straight.ambiguous
    assert straight.map_kind == "similarity"
    oblique, truth = seen(rng, plan, tilt=55, turn=30)
    found = order_marks(oblique, plan, side="kept")
    assert any(np.array_equal(order, truth) for order in (found.plan_index, *found.alternatives))
    assert len(found.alternatives) >= 2
    assert found.chance > 0.01


def test_an_order_that_no_camera_could_see_is_not_named(rng):
    """Four marks of a rectangle of 6:1 fit turned by a quarter as well, but squeezed by 36: that is no view of them."""
    plan = np.array([[-0.5, -1 / 12], [0.5, -1 / 12], [0.5, 1 / 12], [-0.5, 1 / 12]])
    q, truth = seen(rng, plan, tilt=30, turn=15)
    found = order_marks(q, plan, side="kept")
    assert len(found.alternatives) == 1  # turned by half
    assert any(np.array_equal(order, truth) for order in (found.plan_index, *found.alternatives))


def test_a_false_mark_a_few_pixels_from_where_one_is_missing_is_not_taken_for_it(rng):
    plan = scattered(rng, 60)
    q, truth = seen(rng, plan, tilt=30)
    spoilt = rng.permutation(60)[:10]
    q[spoilt] += 5.0 * np.array([0.6, 0.8])  # 17 sigma, an eighth of the spacing
    found = order_marks(q, plan)
    assert (found.plan_index[spoilt] == -1).all()
    assert np.array_equal(np.delete(found.plan_index, spoilt), np.delete(truth, spoilt))


def test_the_side_from_which_a_plan_is_seen_decides_between_it_and_its_mirror_image(shared):
    lines = shared("thesis/tables/prog4_points.csv").read_text().splitlines()
    rows = [r for r in csv.reader(lines) if r[0][:1].isdigit()]
    X, Y, U, V = np.array(rows, float)[:, :4].T
    plan, q = np.column_stack([X, Y]), np.column_stack([V, U])
    unsure = order_marks(q[::-1], plan)
    assert sorted(map(tuple, [unsure.plan_index, *unsure.alternatives]))[-1] == (7, 6, 5, 4, 3, 2, 1, 0)
    sure = order_marks(q[::-1], plan, side="mirrored")  # the plan's X runs up the picture, its Y to the right
    assert sure.plan_index.tolist() == [7, 6, 5, 4, 3, 2, 1, 0]
    assert not sure.ambiguous


def test_the_map_and_its_residuals_are_those_of_the_order(rng):
    plan = scattered(rng, 30)
    q, _ = seen(rng, plan, tilt=50, turn=10, missing=4, false=4)
    found = order_marks(q, plan)
    known = found.found
    assert len(found) == len(known)
    expected = q[known] - mapped(found.pixel_from_plan, plan[found.plan_index[known]])
    assert np.array_equal(found.residuals[known], expected)
    assert np.isnan(found.residuals[found.plan_index < 0]).all()
    dof = 2 * len(known) - 8
    sigma = np.sqrt(np.sum(expected**2) / dof)
    assert abs(sigma - NOISE) < 5 * NOISE / np.sqrt(2 * dof)


@pytest.mark.parametrize("count", [8, 30])
def test_a_second_plate_in_view_is_an_alternative_and_two_views_of_one_are_not_mixed(rng, count):
    plan = scattered(rng, count)
    one, truth_one = seen(rng, plan, tilt=20, turn=30)
    two, truth_two = seen(rng, plan, tilt=30, turn=160)
    q = np.concatenate([one * 0.5, two * 0.5 + [400.0, 20.0]])
    found = order_marks(q, plan)
    expected = {
        (*truth_one, *[-1] * count),
        (*[-1] * count, *truth_two),
    }
    assert {tuple(found.plan_index), *map(tuple, found.alternatives)} == expected


@pytest.mark.parametrize("count", [6, pytest.param(8, marks=pytest.mark.slow), 80])
def test_a_wrong_plan_is_refused_with_how_near_the_best_order_came(count):
    rng = np.random.default_rng(count)
    q, _ = seen(rng, scattered(rng, count), tilt=20)
    with pytest.raises(NoOrder, match="no order fits") as refused:
        order_marks(q, scattered(rng, count))
    assert refused.value.explained < count
    assert refused.value.chance > 0.01


def test_the_search_in_a_wrong_plan_ends(rng, monkeypatch):
    """Of 300 marks there are some 600 triangles; it gives up after 128, which are 16 lists of starts."""
    tried = []

    def counted(*given):
        for starts in seeds(*given):
            tried.append(1)
            yield starts

    monkeypatch.setattr("cadcam.target.order.ordering.seeds", counted)
    q, _ = seen(rng, scattered(rng, 300), tilt=20)
    with pytest.raises(NoOrder):
        order_marks(q, scattered(rng, 300))
    assert 16 <= len(tried) <= 17


def test_random_points_are_not_ordered(rng):
    with pytest.raises(NoOrder):
        order_marks(rng.uniform(0, 500, (20, 2)), scattered(rng, 20))


def test_what_is_no_plan_and_what_are_no_marks_is_refused(rng):
    plan = scattered(rng, 6)
    with pytest.raises(TooFewPoints, match="order of marks"):
        order_marks(plan[:3], plan)
    with pytest.raises(TooFewPoints, match="plan"):
        order_marks(plan, plan[:3])
    with pytest.raises(BadValue, match="plan marks 1 and 4"):
        order_marks(plan, plan[[0, 1, 2, 3, 1]])
    with pytest.raises(DegenerateGeometry, match="one line"):
        order_marks(plan, np.column_stack([np.arange(6), 2 * np.arange(6)]))
    with pytest.raises(UnknownName, match="did you mean 'mirrored'"):
        order_marks(plan, plan, side="miror")
    with pytest.raises(BadValue, match="sigma_px"):
        order_marks(plan, plan, sigma_px=0)
    with pytest.raises(NoOrder):
        order_marks(np.column_stack([np.arange(6), 2 * np.arange(6)]), plan)
