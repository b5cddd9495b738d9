"""Where segments cross in the image plane, found with a grid: exact, vectorised, no sampling."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.render.clip import FlatSegments

Longs = npt.NDArray[np.int64]
_PAIRS = 1 << 19  # candidate pairs at a time: their temporaries stay near the cache
_SLACK = 1e-6  # of a cell: a segment along a cell's border is in both cells


def crossings(lines: FlatSegments, borders: FlatSegments, *, slack: Array) -> tuple[Longs, Array]:
    """Return (line index, fraction s of its image) of every crossing with a border that is not behind the line there.

    `slack` (M,) lengthens each border at both ends by that distance in u, so that a line through the common end of two
    borders is cut by at least one of them. Parallel segments do not cross. A crossing may be listed more than once.
    """
    if not len(lines) or not len(borders):
        return np.zeros(0, np.int64), np.zeros(0)
    grid = _Grid(lines, borders)
    line, line_cell = grid.cells(lines)
    border, border_cell = grid.cells(borders)
    order = np.argsort(border_cell, kind="stable")
    border = border[order]
    count = np.bincount(border_cell, minlength=grid.n * grid.n)
    start = np.cumsum(count) - count
    found = [_in_cells(lines, borders, slack, *pairs) for pairs in _pairs(line, line_cell, border, start, count)]
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])


class _Grid:
    """n x n cells over all lines, about one cell a segment."""

    def __init__(self, lines: FlatSegments, borders: FlatSegments) -> None:
        ends = np.concatenate([lines.a, lines.b])
        self.low = ends.min(axis=0)
        self.n = int(np.clip(np.sqrt(len(lines) + len(borders)), 8, 1024))
        self.per_u = self.n / np.maximum(ends.max(axis=0) - self.low, 1e-12)

    def cells(self, segments: FlatSegments) -> tuple[Longs, Longs]:
        """Return (segment, cell number) for each cell that a segment touches."""
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
        picked = []
        for k in range(3):  # a slope of at most 1 touches two rows in a column, three with the slack
            row = bottom + k
            ok = (row <= top) & (row >= 0) & (row < self.n)
            x, y = column[ok], row[ok]
            x, y = np.where(steep[segment[ok]], y, x), np.where(steep[segment[ok]], x, y)
            picked.append((segment[ok], y * self.n + x))
        return np.concatenate([p[0] for p in picked]), np.concatenate([p[1] for p in picked])


def _rows(left: Array, right: Array, column: Longs) -> tuple[Longs, Longs]:
    """Return the lowest and highest row that segments touch in a column of the grid."""
    run = right[:, 0] - left[:, 0]
    slope = np.divide(right[:, 1] - left[:, 1], run, out=np.zeros_like(run), where=run > 0)
    x0, x1 = np.maximum(column, left[:, 0]), np.minimum(column + 1, right[:, 0])
    y0, y1 = left[:, 1] + slope * (x0 - left[:, 0]), left[:, 1] + slope * (x1 - left[:, 0])
    bottom, top = np.minimum(y0, y1) - _SLACK, np.maximum(y0, y1) + _SLACK
    return np.floor(bottom).astype(np.int64), np.floor(top).astype(np.int64)


def _pairs(line: Longs, cell: Longs, border: Longs, start: Longs, count: Longs) -> list[tuple[Longs, Longs]]:
    """Return blocks of (line, border) index pairs that share a cell."""
    n = count[cell]
    line, cell, n = line[n > 0], cell[n > 0], n[n > 0]
    total = np.cumsum(n)
    cuts = np.searchsorted(total, np.arange(_PAIRS, int(total[-1]) if len(n) else 0, _PAIRS))
    blocks = []
    for piece in np.split(np.arange(len(n)), np.unique(cuts)):
        m = n[piece]
        offset = np.arange(int(m.sum())) - np.repeat(np.cumsum(m) - m, m)
        blocks.append((np.repeat(line[piece], m), border[np.repeat(start[cell[piece]], m) + offset]))
    return blocks


def _in_cells(
    lines: FlatSegments, borders: FlatSegments, slack: Array, i: Longs, j: Longs
) -> tuple[Longs, Array]:
    """Return the crossings among index pairs (i, j)."""
    nearer = np.maximum(borders.wa[j], borders.wb[j]) >= np.minimum(lines.wa[i], lines.wb[i]) * (1 - 1e-6)
    i, j = i[nearer], j[nearer]
    p, q = lines.a[i], borders.a[j]
    r, v, e = lines.b[i] - p, borders.b[j] - q, q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        across = r[:, 0] * v[:, 1] - r[:, 1] * v[:, 0]
        s = (e[:, 0] * v[:, 1] - e[:, 1] * v[:, 0]) / across
        k = (e[:, 0] * r[:, 1] - e[:, 1] * r[:, 0]) / across
        reach = slack[j] / np.hypot(v[:, 0], v[:, 1])
        hit = (s > 0) & (s < 1) & (k >= -reach) & (k <= 1 + reach)
        depth_ok = borders.wa[j] + k * (borders.wb[j] - borders.wa[j]) >= (1 - 1e-6) * (
            lines.wa[i] + s * (lines.wb[i] - lines.wa[i])
        )
    hit &= depth_ok
    return i[hit], s[hit]
