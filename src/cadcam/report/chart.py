"""Charts as inline SVG, for pages: round ticks, a frame with lines at them, the colours of verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

VERDICT_COLORS = {"PASS": "#00785a", "FAIL": "#c23b00", "UNDECIDED": "#946200"}
PLAIN = "#555555"  # of what was not judged, or not found
INK = "#222222"
WIDTH = 380.0  # about a phone's width, so that letters keep their size there
LINE = 14.0  # height of a line of text
_FAINT, _ZERO = "#cfcfcf", "#666666"


@dataclass(frozen=True, slots=True)
class Frame:
    """The plot area over a range of values: from the lowest of the ticks at the bottom to the highest at the top."""

    height: float
    ticks: Sequence[float]
    left: float = 46.0
    right: float = WIDTH - 8

    def y(self, value: float) -> float:
        """Return how far down a value is."""
        top, bottom = 8.0, self.height - 24
        return bottom - (value - self.ticks[0]) / (self.ticks[-1] - self.ticks[0]) * (bottom - top)

    def level_lines(self, unit: str) -> list[str]:
        """Return a line and a number at every tick, and the unit."""
        out = []
        for tick in self.ticks:
            y, zero = self.y(tick), tick == 0
            out.append(stroke(self.left, y, self.right, y, _ZERO if zero else _FAINT, 1.2 if zero else 0.8))
            place = f'x="{self.left - 5:.0f}" y="{y + 4:.1f}"'
            out.append(f'<text {place} text-anchor="end" font-size="11">{tick:g}</text>')
        out.append(text(2, self.y(self.ticks[-1]) + 18, unit))
        return out

    def caption(self, said: str, *, line: int = 0) -> str:
        """Return a line of text below; from the second line on, `LINE` each, it is beyond the height."""
        return text(self.left, self.height - 6 + LINE * line, said) if said else ""


def round_ticks(low: float, high: float) -> list[float]:
    """Return four to seven round numbers from below `low` to above `high`."""
    span = max(high - low, 1e-6)
    raw = span / 4
    size = 10.0 ** np.floor(np.log10(raw))
    step = float(next(m * size for m in (1, 2, 5, 10) if m * size >= raw))
    first, last = int(np.floor(low / step)), int(np.ceil(high / step))
    return [round(step * i, 9) for i in range(first, max(last, first + 1) + 1)]


def stroke(x0: float, y0: float, x1: float, y1: float, color: str, width: float) -> str:
    """Return a straight line."""
    return f'<path d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" stroke="{color}" stroke-width="{width:g}"/>'


def text(x: float, y: float, said: str) -> str:
    """Return a text that begins at a place."""
    return f'<text x="{x:.0f}" y="{y:.0f}" font-size="12" fill="{INK}">{escape(said)}</text>'


def svg(height: float, body: Sequence[str], label: str) -> str:
    """Return a chart of what is in it; label: what it shows, for those who do not see it."""
    head = f'<svg class="plot" viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" aria-label="{escape(label)}">'
    return head + "".join(body) + "</svg>"
