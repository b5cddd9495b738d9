"""Crossings found with the grid are those that brute force finds, on segments laid along the grid's own lines too."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.render.lines.clip import FlatSegments
from cadcam.render.lines.crossing import crossings


def segments(ends: np.ndarray, depth: float) -> FlatSegments:
    n = len(ends)
    return FlatSegments(ends[:, 0], ends[:, 1], np.full(n, 1 / depth), np.full(n, 1 / depth), np.zeros(n), np.ones(n))


def by_brute_force(lines: np.ndarray, borders: np.ndarray) -> set[tuple[int, float]]:
    """Return (line, fraction) of all proper crossings and of lines through an end of a border."""
    found = set()
    for i, (a, b) in enumerate(lines):
        for c, d in borders:
            M = np.column_stack([b - a, c - d])
            if abs(np.linalg.det(M)) > 1e-12:
                s, t = np.linalg.solve(M, c - a)
                if 1e-9 < s < 1 - 1e-9 and -1e-9 <= t <= 1 + 1e-9:
                    found.add((i, round(float(s), 9)))
    return found


@pytest.mark.parametrize("lattice", [False, True])
def test_crossings_are_those_of_brute_force(lattice: bool, rng: np.random.Generator) -> None:
    for count in (1, 7, 60):
        ends = [rng.integers(0, 9, (count, 2, 2)).astype(float) if lattice else rng.random((count, 2, 2)) for _ in "ab"]
        lines, borders = (e[(e[:, 0] != e[:, 1]).any(axis=1)] / 3 for e in ends)
        if not (len(lines) and len(borders)):
            continue
        line, s = crossings(segments(lines, 2.0), segments(borders, 1.0), slack=np.full(len(borders), 1e-9))
        inner = (s > 1e-9) & (s < 1 - 1e-9)
        found = {(int(i), round(float(v), 9)) for i, v in zip(line[inner], s[inner], strict=True)}
        assert found == by_brute_force(lines, borders)


def test_borders_behind_a_line_do_not_cut_it(rng: np.random.Generator) -> None:
    lines, borders = rng.random((40, 2, 2)), rng.random((40, 2, 2))
    slack = np.zeros(40)
    assert len(crossings(segments(lines, 2.0), segments(borders, 1.0), slack=slack)[0])
    assert not len(crossings(segments(lines, 1.0), segments(borders, 2.0), slack=slack)[0])
