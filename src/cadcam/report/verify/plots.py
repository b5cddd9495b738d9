"""Plots of a verification as inline SVG: tolerance bars, deviations of all edges, contributions to the uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from cadcam.arrays import Array
from cadcam.report.chart import INK, PLAIN, VERDICT_COLORS, WIDTH, Frame, round_ticks, stroke, svg, text
from cadcam.verify.adjustment.datum_fit import CAUSE_WORDS
from cadcam.verify.deviations.deviation import FeatureDeviation
from cadcam.verify.inspection import Inspection
from cadcam.verify.tolerances.tolerance import Quantity
from cadcam.verify.tolerances.verdict import Judgement, Verdict

COLORS = {verdict: VERDICT_COLORS.get(verdict.value, PLAIN) for verdict in Verdict}
CAUSE_COLORS = {"noise": "#56b4e9", "edges": "#e69f00", "pose": "#009e73", "calibration": "#cc79a7"}


def tolerance_bar(j: Judgement) -> str:
    """Return a bar from -1.5 to 1.5 limits, of a displacement's length from 0: the limits, the deviation with its U."""
    if j.limit.quantity is Quantity.PRESENCE or not np.isfinite(j.deviation):
        return ""
    length = j.limit.of_length
    low = 0.0 if length else -1.5
    width, height = 180.0, 26.0

    def x(value: float) -> float:
        return float((np.clip(value / j.limit.value, low, 1.5) - low) / (1.5 - low) * (width - 14) + 7)

    color = COLORS[j.verdict]
    limits = [1.0] if length else [-1.0, 1.0]
    left = x(0.0) if length else x(-j.limit.value)
    body = [f'<rect x="{left:.1f}" y="8" width="{x(j.limit.value) - left:.1f}" height="10" fill="#dcefe6"/>']
    body += [stroke(x(s * j.limit.value), 3, x(s * j.limit.value), 23, INK, 1.5) for s in limits]
    body.append(stroke(x(0.0), 6, x(0.0), 20, "#888888", 1))
    body.append(stroke(x(j.deviation - j.U), 13, x(j.deviation + j.U), 13, color, 3))
    shown = abs(j.deviation) <= 1.5 * j.limit.value
    body.append(
        f'<circle cx="{x(j.deviation):.1f}" cy="13" r="4.5" fill="{color if shown else "#ffffff"}" stroke="{color}" '
        'stroke-width="2"/>'
    )
    said = f"deviation {j.deviation / j.limit.value:.2f} of the limit, U {j.U / j.limit.value:.2f} of it"
    return (
        f'<svg class="bar" viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{said}">{"".join(body)}</svg>'
    )


def edges_plot(seen: Inspection) -> str:
    """Return the deviations of all edges seen, sorted, with U (k 2)."""
    edges = sorted((e for e in seen.edges if np.isfinite(e.value)), key=lambda e: e.value)
    if not edges:
        return ""
    low = min(min(e.value - 2 * e.sigma for e in edges), 0.0)
    high = max(max(e.value + 2 * e.sigma for e in edges), 0.0)
    frame = Frame(220.0, round_ticks(low, high))
    y, body = frame.y, frame.level_lines("mm")
    for i, e in enumerate(edges):
        x = frame.left + (frame.right - frame.left) * (i + 0.5) / len(edges)
        color = COLORS[Verdict.FAIL] if e.off else "#0072b2"
        title = f"<title>{escape(f'{e.name}: {e.value:+.3f} mm, U {2 * e.sigma:.3f}')}</title>"
        bar = stroke(x, y(e.value - 2 * e.sigma), x, y(e.value + 2 * e.sigma), color, 1.5)
        body.append(f'<g>{bar}<circle cx="{x:.1f}" cy="{y(e.value):.1f}" r="2.6" fill="{color}"/>{title}</g>')
    body.append(frame.caption(f"{len(edges)} edges, from the most negative to the most positive"))
    return svg(frame.height, body, "deviations of all edges with their uncertainty")


def stations_plot(seen: Inspection, name: str) -> str:
    """Return the deviations along the edges of a feature, an edge after the other, with U (k 2)."""
    edges = [(e, s) for e in seen.edges if len(s := e.stations_of(name)) and np.isfinite(s[:, 1:]).all()]
    if not edges:
        return ""
    every = np.concatenate([station for _, station in edges])
    low = min(float((every[:, 1] - 2 * every[:, 2]).min()), 0.0)
    high = max(float((every[:, 1] + 2 * every[:, 2]).max()), 0.0)
    frame = Frame(190.0, round_ticks(low, high))
    body = frame.level_lines("mm")
    step, start = (frame.right - frame.left) / (len(every) + len(edges)), frame.left
    for k, (e, station) in enumerate(edges):
        x = start + step * (np.arange(len(station)) + 0.5)
        curve = _edge_curve(frame, np.asarray(x), station, "#0072b2" if k % 2 else "#00785a", f"{e.kind} {e.chain}")
        body.append(curve)
        start += step * (len(station) + 1)
    body.append(frame.caption(f"{len(edges)} edges, {len(every)} pieces; band: U (k 2)"))
    return svg(frame.height, body, f"deviations along the edges of {name}")


def _edge_curve(frame: Frame, x: Array, station: Array, color: str, name: str) -> str:
    """Return an edge's stations (s, 7) as dots at x (s,) joined by a line, in a band of U (k 2); name: the tool tip."""
    deviation, sigma = station[:, 1:3].T
    curve = _points(x, [frame.y(v) for v in deviation])
    upper, lower = ([frame.y(v) for v in deviation + sign * 2 * sigma] for sign in (1, -1))
    band = f"{_points(x, upper)} {_points(x[::-1], lower[::-1])}"
    dots = "".join(
        f'<circle cx="{px:.1f}" cy="{frame.y(v):.1f}" r="2.2" fill="{color}"/>'
        for px, v in zip(x, deviation, strict=True)
    )
    return (
        f'<g><polygon points="{band}" fill="{color}" fill-opacity="0.18"/>'
        f'<polyline points="{curve}" fill="none" stroke="{color}" stroke-width="2"/>'
        f"{dots}<title>{escape(name)}</title></g>"
    )


def _points(x: Array, y: Sequence[float]) -> str:
    """Return points as the attribute of an SVG line."""
    return " ".join(f"{px:.1f},{py:.1f}" for px, py in zip(x, y, strict=True))


def shares_plot(features: Sequence[FeatureDeviation]) -> str:
    """Return for each feature a bar of 2 sigma in mm, divided by the shares of its causes in the variance."""
    known = [f for f in features if f.displacement is not None]
    if not known:
        return ""
    most = max(2 * f.sigma for f in known)
    row, left = 34.0, 8.0
    height = row * len(known) + 44
    body = []
    for i, f in enumerate(known):
        y, x = row * i + 4, left
        body.append(text(left, y + 11, f"{f.name}: 2 sigma {2 * f.sigma:.3f} mm"))
        for cause, share in f.shares.items():
            w = (WIDTH - 2 * left) * share * 2 * f.sigma / most if most > 0 else 0.0
            title = f"<title>{CAUSE_WORDS[cause]}: {share:.0%} of the variance</title>"
            place = f'x="{x:.1f}" y="{y + 15:.1f}" width="{w:.1f}" height="12"'
            body.append(f'<rect {place} fill="{CAUSE_COLORS[cause]}">{title}</rect>')
            x += w
    for k, (cause, color) in enumerate(CAUSE_COLORS.items()):
        px, py = left + (k % 2) * WIDTH / 2, height - 34 + 18 * (k // 2)
        body.append(f'<rect x="{px:.0f}" y="{py:.0f}" width="11" height="11" fill="{color}"/>')
        body.append(text(px + 16, py + 10, CAUSE_WORDS[cause]))
    return svg(height + 6, body, "what makes the uncertainty of each feature")
