"""Lattices: grown through marks that perspective bends, laid on boards in one way or refused."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.target.boards.lattice import grown, placed, straightened
from cadcam.target.boards.pattern import parse_pattern

NOTHING = np.zeros(1000, dtype=np.int32)


def bent(cells: np.ndarray) -> np.ndarray:
    """A view of a plane with perspective and a barrel's distortion, px."""
    x = np.column_stack([cells * 22.0 + 90.0, np.ones(len(cells))]) @ np.array(
        [[0.9, 0.1, 0.0004], [-0.12, 0.8, 0.0007], [10.0, 5.0, 1.0]]
    )
    q = x[:, :2] / x[:, 2:]
    r2 = ((q - 150) ** 2).sum(axis=1, keepdims=True)
    return np.asarray(150 + (q - 150) * (1 - 4e-6 * r2))


@pytest.mark.parametrize("text", ["circles:7x6:10mm", "staggered-circles:5x9:10mm"])
def test_a_lattice_grows_through_most_marks_past_missing_and_false_ones(text: str, rng: np.random.Generator) -> None:
    pattern = parse_pattern(text)
    keep = np.sort(rng.permutation(len(pattern.cells))[: len(pattern.cells) * 9 // 10])
    q = np.concatenate([bent(pattern.cells[keep]), rng.uniform(300, 600, (12, 2))])
    start = len(keep) // 2
    away = q - q[start]
    order = np.argsort(np.hypot(*away.T))[1:]
    second = next(i for i in order[1:] if abs(np.linalg.det([away[order[0]], away[i]])) > 0.5 * (away[i] @ away[i]))
    found = grown(q, [(start, away[[order[0], second]])], enough=1000, sizes=np.ones(len(q)))
    assert found is not None
    assert len(found) >= 0.9 * len(keep)
    assert (found.marks < len(keep)).all()
    cells = straightened(found.cells, staggered=text.startswith("st"))
    place = placed(cells, q[found.marks], np.zeros(len(cells), dtype=np.int32), pattern)
    same = found.marks[place.marks] == np.searchsorted(keep, place.points)
    turned = len(pattern.cells) - 1 - place.points  # a half turn may look the same
    assert same.all() or (pattern.turns == 2 and (keep[found.marks[place.marks]] == turned).all())


def test_a_lattice_never_lies_mirrored_on_its_board() -> None:
    pattern = parse_pattern("circles:7x5:10mm")
    q = pattern.cells.astype(float) * 20.0
    q[:, 0] *= -1
    place = placed(pattern.cells, q, NOTHING[:35], pattern)
    at = {point: q[mark] for point, mark in zip(place.points.tolist(), place.marks.tolist(), strict=True)}
    corner = next(n for n in at if n + 1 in at and n + 7 in at and n % 7 < 6)
    step = np.array([at[corner + 1] - at[corner], at[corner + 7] - at[corner]])
    assert np.linalg.det(step) > 0


def test_part_of_a_plain_board_has_no_certain_place() -> None:
    pattern = parse_pattern("circles:7x5:10mm")
    part = pattern.cells[:, 0] < 6
    cells = pattern.cells[part]
    place = placed(cells, cells * 20.0, NOTHING[: len(cells)], pattern)
    assert len(place.points) == 30
    assert not place.fixed
    whole = placed(pattern.cells, pattern.cells * 20.0, NOTHING[:35], pattern)
    assert whole.fixed


def test_colours_fix_a_chessboard_s_turn_but_not_its_part() -> None:
    """A column missing on either side shows the same colours half a turn apart: two places, one of them wrong."""
    pattern = parse_pattern("chessboard:8x5:10mm")
    color = 1 - 2 * (pattern.cells.sum(axis=1) % 2)
    turned = pattern.cells.max(axis=0) - pattern.cells
    place = placed(turned, turned * 20.0, color, pattern)
    assert place.fixed
    assert np.array_equal(place.points, np.arange(40)[np.lexsort((pattern.cells[:, 0], pattern.cells[:, 1]))])
    part = pattern.cells[:, 0] > 0
    cells = pattern.cells[part]
    assert not placed(cells, cells * 20.0, color[part], pattern).fixed


def test_colours_go_along_with_a_quarter_turn() -> None:
    """Counted along the board's other axes, the dark quadrants are those between steps of unlike sign."""
    pattern = parse_pattern("chessboard:8x5:10mm")
    color = 1 - 2 * (pattern.cells.sum(axis=1) % 2)
    quarter = np.column_stack([pattern.cells[:, 1], -pattern.cells[:, 0]])
    place = placed(quarter, pattern.cells * 20.0, -color, pattern)
    assert place.fixed
    assert np.array_equal(place.points[np.argsort(place.marks)], np.arange(40))
    other = placed(quarter, pattern.cells * 20.0, color, pattern)
    assert not np.array_equal(other.points[np.argsort(other.marks)], np.arange(40))
