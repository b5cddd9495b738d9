"""The CAD model with what was found of it, to be turned: bodies coloured by state, edges by deviation."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from cadcam.arrays import Longs, Mask
from cadcam.locate.photo import Photo
from cadcam.render.view import Scene
from cadcam.report.solid.figure import CLEAR, HOW_TO_TURN, WHOLE, LineStyle, Look, Mark, Paint, SolidFigure
from cadcam.report.verify.overlay import MISSING, deviation_color, displacement_words, failing, full_scale
from cadcam.verify.deviations.deviation import FeatureDeviation, State
from cadcam.verify.inspection import Inspection
from cadcam.verify.judge import Verification

_COLORS = {  # from the state that is least worth telling to the one that is most
    State.OUT_OF_VIEW: "#e6e6e6",
    State.DATUM: "#c3ccd9",
    State.IN_PLACE: "#b8e0d1",
    State.UNCLEAR: "#faeba8",
    State.DISPLACED: "#faad80",
    State.MISSING: "#edb8e0",  # not filled
}
_STATES = tuple(_COLORS)
_HALF = 10  # shades of deviations to each side of none
_WIDE = 3.0  # px: lines with a deviation
_ARROW, _MOST_TIMES = 0.12, 100.0  # the longest arrow, as a share of the model's diagonal; greatest magnification


def model_figure(found: Verification, seen: Inspection, photos: Sequence[Photo], scene: Scene) -> str:
    """Return the model as HTML: at first as the first photo shows it, cut open where the camera stood."""
    mesh, edges = scene.mesh, scene.edges
    about = [_about(found, seen, scene, number) for number in range(len(mesh.part_names))]
    state = np.array([max((_STATES.index(f.state) for f in of), default=0) for of in about])
    paint = np.where(state == _STATES.index(State.MISSING), CLEAR, state)[mesh.part]
    styles, style = _lines(seen, scene, (state == _STATES.index(State.MISSING))[edges.part])
    said = [
        f"{name}: {', '.join(_words(f, found) for f in of) or State.OUT_OF_VIEW.value}"
        for name, of in zip(mesh.part_names, about, strict=True)
    ]
    marks, times = _marks(found, seen, float(np.linalg.norm(mesh.size_mm)))
    figure = SolidFigure(
        mesh,
        said,
        list(_COLORS.values()),
        [Paint("state", paint)],
        mesh.vertices[edges.vertices],
        styles,
        style,
        [*(_look(photo, i, seen) for i, photo in enumerate(photos)), WHOLE],
        marks,
    )
    return figure.html("the CAD model with its bodies' states and its edges' deviations in colour") + _legend(
        state, times
    )


def _about(found: Verification, seen: Inspection, scene: Scene, number: int) -> list[FeatureDeviation]:
    """Return the features that a part of the scene belongs to as a whole."""
    chosen = {f.name: f.selection for f in found.tolerances.features}
    name = scene.mesh.part_names[number]

    def holds(feature: str) -> bool:
        selection = chosen.get(feature)
        return feature == name if selection is None else selection.whole and bool(selection.bodies(scene)[number])

    return [f for f in seen.features if holds(f.name)]


def _words(f: FeatureDeviation, found: Verification) -> str:
    off = f.state is State.DISPLACED or (f.state is State.IN_PLACE and f.displacement is not None)
    return f"{f.state.value}, {displacement_words(f, found.judgements)}" if off else f.state.value


def _lines(seen: Inspection, scene: Scene, missing: Mask) -> tuple[list[LineStyle], Longs]:
    """Return styles of lines, and which each edge (E,) has: plain, missing, or the shade of its chain's deviation."""
    full = full_scale(seen)
    shades = [deviation_color(full * k / _HALF, full) for k in range(-_HALF, _HALF + 1)]
    styles = [LineStyle(), LineStyle(MISSING, 2.0, through=True), *(LineStyle(c, _WIDE) for c in shades)]
    style = missing.astype(np.int64)
    measured = (edge for edge in seen.edges if np.isfinite(edge.value))
    for edge in sorted(measured, key=lambda e: -e.sigma):  # of a chain in several photos the surest is the last
        shade = int(np.rint(np.clip(edge.value / full, -1, 1) * _HALF)) + _HALF + 2
        style[(scene.edges.chain == edge.chain) & ~missing] = shade
    return styles, style


def _look(photo: Photo, number: int, seen: Inspection) -> Look:
    """Return the model as a photo shows it, as far away as its edges are in the middle."""
    camera_from_part = photo.camera_from_world @ seen.pose.world_from_part
    of = [e.p for e in seen.edges if e.photo == number]
    depth = float(np.median((camera_from_part @ np.array(of))[:, 2])) if of else 0.0
    tall = photo.camera.height * depth / photo.camera.fy if depth > 0 else None
    return Look(f"as in {photo.viewpoint.name or f'photo {number + 1}'}", camera_from_part, tall, cut=True)


def _marks(found: Verification, seen: Inspection, diagonal: float) -> tuple[list[Mark], float]:
    """Return arrows of displaced features, magnified alike, and labels of these, the missing and the failing ones."""
    failed = failing(found.judgements)
    told = [f for f in seen.features if f.state in (State.DISPLACED, State.MISSING) or f.name in failed]
    told = [f for f in told if np.isfinite(f.p).all()]
    longest = max((f.size for f in told if f.state is State.DISPLACED), default=0.0)
    times = float(np.clip(_ARROW * diagonal / longest, 1.0, _MOST_TIMES)) if longest > 0 else 0.0
    marks = []
    for f in told:
        text = f"{f.name}: {displacement_words(f, found.judgements)}"
        tip = f.p + times * f.vector if f.state is State.DISPLACED else None
        marks.append(Mark(f.p, text, MISSING if f.state is State.MISSING else "#a33d00", tip))
    return marks, times


def _legend(state: Longs, times: float) -> str:
    keys = [
        f'<span><i style="width:16px;height:16px;border:1px solid #888;background:{color}"></i>{k.value}</span>'
        for number, (k, color) in enumerate(_COLORS.items())
        if k is not State.MISSING and (state == number).any()
    ]
    arrows = f" Arrows: displacements x {times:.0f}." if times else ""
    notes = f"{HOW_TO_TURN} Lines have the colours of the photo above.{arrows}"
    return f'<div class="legend">{"".join(keys)}</div><p class="soft">{escape(notes)}</p>'
