"""Where candidates say that a feature is: displaced as one, or larger all round."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.verify.edges.shifts import _grid, all_round, best_shift, grown, support
from cadcam.verify.edges.sightlines import pieces

NORMALS = np.stack([np.cos(t := np.arange(24) * 2 * np.pi / 24), np.sin(t)], axis=1)
ROUND = np.ones(24)
REACH = 8.0


def candidates(offset: Array, rng: np.random.Generator) -> Array:
    """Return candidates (n, 3): the rim's own among others that lie anywhere."""
    other = rng.uniform(-REACH, REACH, (len(offset), 2))
    return np.column_stack([other[:, 0], offset + rng.normal(0, 0.1, len(offset)), other[:, 1]])


@pytest.mark.parametrize("size", [-5.0, -2.5, 2.5, 6.0])
@pytest.mark.parametrize("shown", [slice(None), slice(0, 15)])
def test_a_rim_that_is_larger_is_found_so(rng: np.random.Generator, size: float, shown: slice) -> None:
    """To the grid's step, of which half a shift's may be a part; a little more than half of it is enough."""
    n = NORMALS[shown]
    found = candidates(np.full(len(n), size), rng)
    growth, by = grown(found, found, n, ROUND[shown], np.zeros(2), reach_px=REACH)
    assert np.abs(growth + n @ by - size).max() < 1.0


@pytest.mark.parametrize("size", [-7.0, 5.0, 7.5])
def test_an_oblique_rim_that_is_larger_is_so_most_along_its_length(rng: np.random.Generator, size: float) -> None:
    """Half as much at its flat sides: by one value all round no more than a third of it would agree."""
    widening = np.hypot(NORMALS[:, 0], 0.5 * NORMALS[:, 1])
    found = candidates(size * widening, rng)
    growth, by = grown(found, found, NORMALS, widening, np.zeros(2), reach_px=REACH)
    assert np.abs((growth - size) * widening + NORMALS @ by).max() < 1.0


def test_a_rim_that_is_displaced_is_not_larger(rng: np.random.Generator) -> None:
    found = candidates(NORMALS @ [3.0, -2.0], rng)
    by = best_shift(found, NORMALS, reach_px=REACH)
    assert np.hypot(*(by - [3.0, -2.0])) < 1.1
    assert grown(found, found, NORMALS, ROUND, by, reach_px=REACH)[0] == 0.0


def test_neither_is_one_of_which_a_side_alone_is_off(rng: np.random.Generator) -> None:
    """A shadow's border beside it: the other side is in its place."""
    found = candidates(np.where(NORMALS[:, 0] > 0.3, 3.0, 0.0), rng)
    assert grown(found, found, NORMALS, ROUND, np.zeros(2), reach_px=REACH)[0] == 0.0


def test_a_larger_rim_is_found_whose_body_is_taken_for_displaced(rng: np.random.Generator) -> None:
    """Half of its places agree with a shift by as much as it is larger."""
    found = candidates(np.full(24, 5.0), rng)
    growth, by = grown(found, found, NORMALS, ROUND, np.array([0.0, 5.0]), reach_px=REACH)
    assert np.abs(growth + NORMALS @ by - 5.0).max() < 1.0


def test_what_other_lines_explain_makes_no_rim_larger(rng: np.random.Generator) -> None:
    found = candidates(np.full(24, 3.0), rng)
    free = np.where(np.abs(found - 3.0) < 0.6, np.nan, found)
    assert grown(found, free, NORMALS, ROUND, np.zeros(2), reach_px=REACH)[0] == 0.0


def test_only_what_faces_several_ways_tells_its_size() -> None:
    straight = np.tile([[0.6, 0.8]], (24, 1))
    edges = NORMALS, NORMALS[:14], NORMALS[:8], straight
    number = np.repeat([7, 2, 5, 3], [len(normal) for normal in edges])
    assert all_round(number, np.concatenate(edges)).tolist() == [2, 7]
    assert all_round(np.full(24, 1), straight).tolist() == []


def test_amid_its_nodes_the_grid_keeps_seven_eighths_of_the_support(rng: np.random.Generator) -> None:
    """The least support of a shift that all places agree on, at the node nearest to it: its step is chosen so."""
    way = rng.uniform(0, 2 * np.pi, 400)
    normal = np.stack([np.cos(way), np.sin(way)], axis=1)
    grid = _grid(8.0)
    shares = []
    for shift in rng.uniform(-4, 4, (60, 2)):
        found = (normal @ shift)[:, None]
        shares.append(support(found, normal, grid).max() / len(normal))
    assert min(shares) >= 7 / 8


def test_each_edge_is_split_by_itself(rng: np.random.Generator) -> None:
    """Places in any order: pieces of one edge are those it has alone, numbered after those of edges before it."""
    edge = rng.permutation(np.repeat([4, 0, 9], [24, 14, 5]))
    normal = np.zeros((len(edge), 2))
    for e, own in ((4, NORMALS), (0, NORMALS[:14]), (9, NORMALS[:5])):
        normal[edge == e] = own
    first, together = 0, pieces(edge, normal)
    for e in (0, 4, 9):
        alone = pieces(edge[edge == e], normal[edge == e])
        assert np.array_equal(together[edge == e], first + alone)
        first += int(alone.max()) + 1
    assert first == len(np.unique(together)) > 3


def test_a_smaller_rim_may_lie_where_another_line_is_drawn() -> None:
    """A hole's rim that shrinks to where its other one was: there its edge is no evidence, but nor is it missing."""
    angle = np.radians(np.arange(0, 360, 8.0))
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    offset = np.full((len(angle), 1), -4.5)
    quarter = angle > np.radians(282)
    free, unseen = np.where(quarter[:, None], np.nan, offset), offset.copy()
    free[-1], unseen[quarter] = -4.5, np.nan
    found = [grown(seen, free, normal, np.ones(len(angle)), np.zeros(2), reach_px=8.0) for seen in (offset, unseen)]
    assert [size for size, _ in found] == [-4.5, 0.0]
    np.testing.assert_array_equal(found[0][1], [0, 0])


def test_the_side_of_a_rim_without_contrast_does_not_hold_it_in_place() -> None:
    """Displaced by 3.2 px, its bright side shows between the two lines drawn, 1.1 px from the one without contrast."""
    normal = np.repeat([[0.0, 1.0], [0.0, -1.0], [-1.0, 0.0]], [40, 40, 12], axis=0)
    offset = np.repeat([3.2, np.nan, 1.1, np.nan, 1.8], [30, 10, 28, 12, 12])[:, None]
    worth = np.repeat([1.0, 0.5, 1.0], [40, 40, 12])
    s = best_shift(offset, normal, worth=worth, reach_px=REACH)
    assert np.abs(s - [-1.8, 3.2]).max() < 0.75
    assert np.hypot(*best_shift(offset, normal, reach_px=REACH)) < 2.0
