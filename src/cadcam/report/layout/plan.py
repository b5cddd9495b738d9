"""Drawings of a layout as inline SVG: from above and from the side, and a bar for each ratio."""

from __future__ import annotations

from collections.abc import Callable
from html import escape

import numpy as np

from cadcam.arrays import Array
from cadcam.plan.layout import Layout
from cadcam.plan.sight.candidate import Candidate
from cadcam.report.figures import BLUE, GREEN, ORANGE, PURPLE, SKY

Point = tuple[float, float]
ToPaper = Callable[[Array], Point]
_WIDTH, _MARGIN = 560.0, 34.0
_TALLEST = 520.0
HUES = (BLUE, ORANGE, GREEN, PURPLE, SKY, "#7a6500")
_MOST_LINES = 1500
NOTHING, WANTED = "#c23b00", "#111111"  # a bar's lines: at 1, below which nothing can pass, and at the required ratio


def full_bar(wanted: float) -> float:
    """Return the ratio at the end of a bar."""
    return max(2 * wanted, 1.5)


def ratio_bar(ratio: float, wanted: float, color: str) -> str:
    """Return a bar of a test uncertainty ratio, 0 to twice the required one, with lines at 1 and at that one."""
    full = full_bar(wanted)

    def x(value: float) -> float:
        return 4 + 142 * min(value / full, 1.0)

    marks = [(1.0, NOTHING), (wanted, WANTED)]
    body = ['<rect x="4" y="7" width="142" height="10" fill="#eee"/>']
    body.append(f'<rect x="4" y="7" width="{x(ratio) - 4:.1f}" height="10" fill="{color}"/>')
    body += [f'<path d="M{x(v):.1f} 3V21" stroke="{c}" stroke-width="2"/>' for v, c in marks]
    said = f"test uncertainty ratio {ratio:.2f}, wanted {wanted:g}"
    return f'<svg class="bar" viewBox="0 0 150 24" role="img" aria-label="{said}">{"".join(body)}</svg>'


def floor_plan(layout: Layout, axes: tuple[int, int]) -> str:
    """Return the part, the chosen cameras with their views, and the other candidates, along two axes of the world."""
    lines = _part_lines(layout, axes)
    eyes = np.array([c.eye for c in layout.survey.candidates])[:, axes]
    fields = [field_corners(c)[:, axes] for c in layout.cameras]
    every = np.concatenate([lines.reshape(-1, 2), eyes, *fields])
    low, high = every.min(axis=0), every.max(axis=0)
    extent = np.maximum(high - low, 1.0)
    scale = float(min((_WIDTH - 2 * _MARGIN) / extent[0], (_TALLEST - 2 * _MARGIN) / extent[1]))
    height = scale * float(extent[1]) + 2 * _MARGIN
    shift = (_WIDTH - 2 * _MARGIN - scale * float(extent[0])) / 2

    def at(p: Array) -> tuple[float, float]:
        x = _MARGIN + shift + scale * float(p[0] - low[0])
        return x, height - _MARGIN - scale * float(p[1] - low[1])

    body = [_path(lines, at)]
    body += ['<circle cx="{:.1f}" cy="{:.1f}" r="1.6" fill="#bbb"/>'.format(*at(e)) for e in np.unique(eyes, axis=0)]
    for i, camera in enumerate(layout.cameras):
        body.append(_camera(camera, fields[i], at(camera.eye[list(axes)]), at, HUES[i % len(HUES)], i + 1))
    body.append(_scale_bar(scale, height))
    head = f'<svg viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img" aria-label="where cameras stand">'
    return head + "".join(body) + "</svg>"


def _part_lines(layout: Layout, axes: tuple[int, int]) -> Array:
    """Return the part's longest lines (n, 2, 2) in its first pose."""
    from cadcam.render.view import Scene

    part = layout.survey.scene.part
    edges = Scene.of(part).edges
    ends = part.vertices[edges.vertices]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    longest = ends[np.argsort(-length)[:_MOST_LINES]]
    return np.asarray((layout.survey.poses[0] @ longest)[..., axes])


def _path(lines: Array, at: ToPaper) -> str:
    d = "".join("M{:.1f} {:.1f}L{:.1f} {:.1f}".format(*at(a), *at(b)) for a, b in lines)
    return f'<path d="{d}" stroke="#8a8a8a" stroke-width="0.6" fill="none"/>'


def field_corners(camera: Candidate) -> Array:
    """Return the corners (4, 3) of a camera's field of view at the distance of its aim, in the world."""
    w, h = camera.camera.size
    corners = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    rays = camera.viewpoint.rays(corners)
    distance = float(np.linalg.norm(camera.aim - camera.eye))
    axis = camera.viewpoint.camera_from_world.rotation[2]
    return np.asarray(rays.origin + rays.direction * (distance / (rays.direction @ axis))[:, None])


def _camera(camera: Candidate, far: Array, eye: Point, at: ToPaper, color: str, number: int) -> str:
    """Return a camera at `eye` in the drawing, with the outline of its field of view."""
    q, (x, y) = [at(p) for p in far], eye
    field = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in q) + "Z"
    rays_drawn = "".join(f"M{x:.1f} {y:.1f}L{a:.1f} {b:.1f}" for a, b in q)
    return (
        f"<g><title>{escape(camera.name)}</title>"
        f'<path d="{field}" fill="{color}" fill-opacity="0.10" stroke="{color}" stroke-width="0.9"/>'
        f'<path d="{rays_drawn}" stroke="{color}" stroke-width="0.7" stroke-opacity="0.7" fill="none"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="{color}"/>'
        f'<text x="{x:.1f}" y="{y + 4:.1f}" font-size="12" text-anchor="middle" fill="#fff">{number}</text></g>'
    )


def _scale_bar(scale: float, height: float) -> str:
    """Return a scale bar of a round length, about a fifth of the width."""
    wanted = 0.2 * _WIDTH / scale
    power = 10 ** np.floor(np.log10(wanted))
    length = float(max(m * power for m in (1, 2, 5) if m * power <= wanted))
    said = f"{length / 1000:g} m" if length >= 1000 else f"{length:g} mm"
    y = height - 12
    return (
        f'<path d="M{_MARGIN} {y:.1f}h{length * scale:.1f}" stroke="#222" stroke-width="2"/>'
        f'<text x="{_MARGIN}" y="{y - 5:.1f}" font-size="12" fill="#222">{said}</text>'
    )
