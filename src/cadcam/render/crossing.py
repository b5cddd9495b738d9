"""Where segments cross in the image plane, found with a grid: exact, vectorised, no sampling."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.render.clip import FlatSegments
from cadcam.render.cores import on_all_cores

Longs = npt.NDArray[np.int64]
_PAIRS = 1 << 16  # candidate pairs at a time: their temporaries stay near the cache
_SLACK = 1e-6  # of a cell: a segment along a cell's side is in the cells on both sides
_BEHIND = 1e-6  # relative: a border this little behind a line still cuts it


def crossings(lines: FlatSegments, borders: FlatSegments, *, slack: Array) -> tuple[Longs, Array]:
    """Return (line index, fraction s of its image) of every crossing with a border that is not behind the line there.

    `slack` (M,) lengthens each border at both ends by that distance in u, so that a line through the common end of two
    borders is cut by at least one of them. Parallel segments do not cross. A crossing may be listed more than once.
    """
    if not len(lines) or not len(borders):
        return np.zeros(0, np.int64), np.zeros(0)
    pairs = _Pairs(lines, borders, slack)
    found = on_all_cores(pairs.crossings, pairs.blocks())
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])


class _Pairs:
    """Pairs of a line and a border that share a cell of a grid.

    What the first, rejecting test reads lies in the order of reading: entries (segment in cell) sorted by cell.
    """

    def __init__(self, lines: FlatSegments, borders: FlatSegments, slack: Array) -> None:
        self._lines, self._borders = lines, borders
        self._reach = slack / np.maximum(np.linalg.norm(borders.b - borders.a, axis=1), 1e-300)
        grid = _Grid(lines, borders)
        line, cell = grid.entries(lines)
        self._border, border_cell = grid.entries(borders)
        count = np.bincount(border_cell, minlength=grid.n * grid.n)
        some = count[cell] > 0
        self._line, cell = line[some], cell[some]
        self._count, self._start = count[cell], (np.cumsum(count) - count)[cell]
        along = borders.b - borders.a
        normal = np.stack([-along[:, 1], along[:, 0]])
        offset = np.einsum("ki,ik->i", normal, borders.a)
        nearest = np.maximum(borders.wa, borders.wb) * (1 + _BEHIND)
        self._border_data = np.stack([*normal, offset, nearest])[:, self._border]
        self._line_data = np.stack([*lines.a.T, *lines.b.T, np.minimum(lines.wa, lines.wb)])[:, self._line]

    def blocks(self) -> list[slice]:
        """Return ranges of line entries with about `_PAIRS` pairs each."""
        total = np.cumsum(self._count)
        cuts = np.searchsorted(total, np.arange(_PAIRS, int(total[-1]) if len(total) else 0, _PAIRS))
        return [slice(i, j) for i, j in pairwise([0, *np.unique(cuts[cuts > 0]).tolist(), len(total)])]

    def crossings(self, entries: slice) -> tuple[Longs, Array]:
        """Return the crossings (line, s) among the pairs of some line entries."""
        m = self._count[entries]
        own = np.repeat(np.arange(entries.start, entries.stop), m)
        other = np.arange(len(own)) + np.repeat(self._start[entries] - (np.cumsum(m) - m), m)
        nx, ny, offset, nearest = (row[other] for row in self._border_data)
        ax, ay, bx, by, w = (row[own] for row in self._line_data)
        before, after = nx * ax + ny * ay - offset, nx * bx + ny * by - offset
        kept = np.flatnonzero((before * after < 0) & (nearest >= w))
        before = before[kept]
        return self._on_border(self._line[own[kept]], self._border[other[kept]], before / (before - after[kept]))

    def _on_border(self, i: Longs, j: Longs, s: Array) -> tuple[Longs, Array]:
        """Return those of the points s of lines i, where they meet the straight line of border j, that lie on j."""
        lines, borders = self._lines, self._borders
        v = borders.b[j] - borders.a[j]
        d = lines.a[i] + s[:, None] * (lines.b[i] - lines.a[i]) - borders.a[j]
        k = np.einsum("ij,ij->i", d, v) / np.maximum(np.einsum("ij,ij->i", v, v), 1e-300)
        reach = self._reach[j]
        w = lines.wa[i] + s * (lines.wb[i] - lines.wa[i])
        in_front = borders.wa[j] + k * (borders.wb[j] - borders.wa[j]) >= w * (1 - _BEHIND)
        on = (k >= -reach) & (k <= 1 + reach) & in_front
        return i[on], s[on]


class _Grid:
    """n x n cells over all lines, about one cell a segment."""

    def __init__(self, lines: FlatSegments, borders: FlatSegments) -> None:
        ends = np.concatenate([lines.a, lines.b])
        self.low = ends.min(axis=0)
        self.n = int(np.clip(0.7 * np.sqrt(len(lines) + len(borders)), 8, 1024))
        self.per_u = self.n / np.maximum(ends.max(axis=0) - self.low, 1e-12)

    def entries(self, segments: FlatSegments) -> tuple[Longs, Longs]:
        """Return (segment, cell number) for each cell that a segment touches, sorted by cell."""
        a, b = ((end - self.low) * self.per_u for end in (segments.a, segments.b))
        steep = np.abs(b - a)[:, 1] > np.abs(b - a)[:, 0]
        a[steep], b[steep] = a[steep][:, ::-1], b[steep][:, ::-1]
        left = np.where((a[:, 0] <= b[:, 0])[:, None], a, b)
        right = np.where((a[:, 0] <= b[:, 0])[:, None], b, a)
        first = np.clip(np.floor(left[:, 0] - _SLACK), 0, self.n).astype(np.int64)
        last = np.clip(np.floor(right[:, 0] + _SLACK), -1, self.n - 1).astype(np.int64)
        columns = np.maximum(last - first + 1, 0)
        segment = np.repeat(np.arange(len(columns)), columns)
        column = first[segment] + np.arange(len(segment)) - np.repeat(np.cumsum(columns) - columns, columns)
        bottom, top = _rows(left[segment], right[segment], column)
        found: list[tuple[Longs, Longs]] = []
        for k in range(3):  # a slope of at most 1 touches two rows in a column, three with the slack
            row = bottom + k
            ok = (row <= top) & (row >= 0) & (row < self.n)
            swap = steep[segment[ok]]
            x, y = np.where(swap, row[ok], column[ok]), np.where(swap, column[ok], row[ok])
            found.append((segment[ok], y * self.n + x))
        segment, cell = (np.concatenate([f[k] for f in found]) for k in range(2))
        order = np.argsort(cell, kind="stable")
        return segment[order], cell[order]


def _rows(left: Array, right: Array, column: Longs) -> tuple[Longs, Longs]:
    """Return the lowest and highest row that segments touch in a column of the grid."""
    run = right[:, 0] - left[:, 0]
    slope = np.divide(right[:, 1] - left[:, 1], run, out=np.zeros_like(run), where=run > 0)
    x0, x1 = np.maximum(column, left[:, 0]), np.minimum(column + 1, right[:, 0])
    y0, y1 = left[:, 1] + slope * (x0 - left[:, 0]), left[:, 1] + slope * (x1 - left[:, 0])
    bottom, top = np.minimum(y0, y1) - _SLACK, np.maximum(y0, y1) + _SLACK
    return np.floor(bottom).astype(np.int64), np.floor(top).astype(np.int64)
