"""The difference of two cameras as a table, JSON and a picture."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.files.jsontext import or_null, or_nulls
from cadcam.fit.compare import Difference
from cadcam.image.draw import draw_polylines, draw_text
from cadcam.image.picture import write_picture
from cadcam.image.svg import SvgLayer, write_svg
from cadcam.report.table import Table

_WIDTH = 960  # px of the drawing: cameras may have many more
_STRIP = 44  # px below it for the scale and the sentence
# dark blue to yellow through green, even in lightness (after viridis, CC0)
_STOPS = np.array(
    [[0.267, 0.005, 0.329], [0.229, 0.322, 0.546], [0.128, 0.567, 0.551], [0.369, 0.789, 0.383], [0.993, 0.906, 0.144]]
)
_STROKES = ((0.0, 2.6), (1.0, 1.2))  # white on black: visible on any of the colours
_UNSEEN = (0.6, 0.6, 0.6)


def difference_table(difference: Difference, names: tuple[str, str]) -> Table:
    """Return largest, rms, centre and corners in px."""
    rows = [("largest", difference.max_px), ("rms", difference.rms_px), *difference.places().items()]
    return Table(
        f"{names[1]} minus {names[0]}, px",
        ("where", "distance px"),
        tuple((name, "not seen" if math.isnan(value) else f"{value:.4g}") for name, value in rows),
        left=("where",),
        notes=tuple(_notes(difference)),
    )


def difference_as_json(difference: Difference) -> dict[str, Any]:
    """Return the same numbers, and the field itself."""
    return {
        "max_px": difference.max_px,
        "rms_px": difference.rms_px,
        **{name.replace(" ", "_") + "_px": or_null(value) for name, value in difference.places().items()},
        "rotation_b_from_a": difference.b_from_a.tolist(),
        "rotation_deg": difference.rotation_deg,
        "pixels_not_seen": difference.unseen,
        "q_px": difference.q.tolist(),
        "delta_px": [[or_nulls(pixel) for pixel in row] for row in difference.delta.tolist()],
    }


def write_difference(path: str | os.PathLike[str], difference: Difference, size: tuple[int, int]) -> None:
    """Draw the field, PNG or SVG by the suffix: colour is the distance, arrows its direction, lengths magnified."""
    scale = _WIDTH / size[0]
    heat = _heat(difference, (_WIDTH, max(1, round(size[1] * scale))))
    arrows, factor = _arrows(difference, scale)
    line = f"{_notes(difference)[0]}; largest {difference.max_px:.3g} px, rms {difference.rms_px:.3g} px; "
    line += f"arrows x {factor:.3g}"
    picture = _with_scale(heat, difference, line)
    if Path(path).suffix.lower() == ".svg":
        layers = [SvgLayer("difference", arrows, (shade,) * 3, width=width) for shade, width in _STROKES]
        write_svg(path, (picture.shape[1], picture.shape[0]), layers, photo=picture, title=line)
        return
    for shade, width in _STROKES:
        picture = draw_polylines(picture, arrows, color=(shade,) * 3, width=width)
    write_picture(path, picture)


def _notes(difference: Difference) -> list[str]:
    turned = not np.array_equal(difference.b_from_a, np.eye(3))
    angle = difference.rotation_deg
    freedom = f"after the best rotation, {angle:.4g} deg" if turned else "as they are, no rotation taken off"
    unseen = f"{difference.unseen} of {difference.distance.size} pixels are not seen by both"
    return [freedom, unseen] if difference.unseen else [freedom]


def _heat(difference: Difference, size: tuple[int, int]) -> Picture:
    """Return the distance as colour over the whole picture, interpolated between the pixels compared."""
    from scipy.ndimage import map_coordinates

    d = difference.distance
    seen = ~np.isnan(d)
    rows = np.linspace(0, d.shape[0] - 1, size[1])
    columns = np.linspace(0, d.shape[1] - 1, size[0])
    at = np.meshgrid(rows, columns, indexing="ij")
    value = map_coordinates(np.where(seen, d, 0.0), at, order=1) / (difference.max_px or 1.0)
    rgb = _colors(np.clip(value, 0, 1))
    covered = map_coordinates(seen.astype(float), at, order=1) > 0.999
    return np.asarray(np.where(covered[..., None], rgb, _UNSEEN), np.float32)


def _colors(value: Array) -> Array:
    stops = np.linspace(0, 1, len(_STOPS))
    return np.stack([np.interp(value, stops, _STOPS[:, k]) for k in range(3)], axis=-1)


def _arrows(difference: Difference, scale: float) -> tuple[list[Array], float]:
    """Return arrows in the drawing's pixels, and the factor by which they are longer than the differences."""
    step = 3
    start = ((difference.q + 0.5) * scale - 0.5)[1::step, 1::step].reshape(-1, 2)
    delta = difference.delta[1::step, 1::step].reshape(-1, 2)
    keep = ~np.isnan(delta).any(axis=1)
    spacing = step * scale * float(difference.q[0, 1, 0] - difference.q[0, 0, 0])
    factor = 0.9 * spacing / (difference.max_px or 1.0) / scale
    return [_arrow(p, factor * scale * d) for p, d in zip(start[keep], delta[keep], strict=True)], factor


def _arrow(start: Array, along: Array) -> Array:
    tip = start + along
    barb = (
        0.3 * np.array([[-0.94, 0.34], [-0.34, -0.94]]) @ along,
        0.3 * np.array([[-0.94, -0.34], [0.34, -0.94]]) @ along,
    )
    return np.stack([start, tip, tip + barb[0], tip, tip + barb[1]])


def _with_scale(heat: Picture, difference: Difference, line: str) -> Picture:
    height, width = heat.shape[:2]
    out = np.ones((height + _STRIP, width, 3), np.float32)
    out[:height] = heat
    bar = np.linspace(0, 1, 200)
    out[height + 5 : height + 17, 50:250] = _colors(bar)[None]
    out = draw_text(out, (8, height + 11), "0 px", color=(0, 0, 0), height=12)
    out = draw_text(out, (258, height + 11), f"{difference.max_px:.3g} px", color=(0, 0, 0), height=12)
    return draw_text(out, (8, height + 31), line, color=(0, 0, 0), height=13)
