"""Overlays as SVG: polylines with colours, dashes and tooltips over an optional embedded photo.

SVG counts from the corner of the top-left pixel, pictures here from its centre: x_svg = x + 1/2, in `_path` only.
"""

from __future__ import annotations

import base64
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, frozen
from cadcam.errors import BadValue
from cadcam.image.picture import checked, encoded
from cadcam.image.stroke import Color, check_stroke, paint_of
from cadcam.whole import utf8, write_whole

_CORNER = 0.5  # from a pixel's centre to SVG's origin at its corner
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # XML 1.0, production 2


@dataclass(frozen=True, slots=True, eq=False)
class SvgLayer:
    """Polylines drawn alike: `name` becomes the group's class, `titles` (one a polyline, or none) their tooltips.

    Polylines are (N, 2) pixel positions (x, y), pixel centres at integers, interrupted by NaN rows; `color` is red,
    green, blue in [0, 1]; `width` and `dash` = (on, off) are in px, under the same rules as in `cadcam.image.draw`.
    """

    name: str
    polylines: Sequence[npt.ArrayLike]
    color: Color
    width: float = 1.5
    opacity: float = 1.0
    dash: tuple[float, float] | None = None
    titles: Sequence[str] = ()

    def __post_init__(self) -> None:
        lines = tuple(frozen(line, "polyline", (None, 2), finite=False) for line in self.polylines)
        object.__setattr__(self, "polylines", lines)
        paint_of(self.color)
        check_stroke(self.width, self.opacity, self.dash)
        if self.titles and len(self.titles) != len(lines):
            raise BadValue("titles", f"{len(self.titles)} texts", f"one for each of {len(lines)} polylines")


def svg_text(
    size: tuple[int, int], layers: Sequence[SvgLayer], *, photo: npt.ArrayLike | None = None, title: str = ""
) -> str:
    """Return an SVG document of `size` (width, height) px: the photo, then the layers in their order.

    The photo is embedded as JPEG. Raises `BadValue` if its size is another.
    """
    width, height = (int(n) for n in size)
    if width < 1 or height < 1:
        raise BadValue("size", size, "a width and a height of at least 1 px")
    head = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {head}>',
    ]
    if title:
        parts.append(f"<title>{_text(title)}</title>")
    if photo is not None:
        parts.append(_image(photo, (width, height)))
    for layer in layers:
        parts += _group(layer)
    return "\n".join([*parts, "</svg>", ""])


def write_svg(
    path: str | os.PathLike[str],
    size: tuple[int, int],
    layers: Sequence[SvgLayer],
    *,
    photo: npt.ArrayLike | None = None,
    title: str = "",
) -> None:
    """Write `svg_text` to a file, whole or not at all; missing folders are made. Raises `UnwritableFile`."""
    write_whole(path, utf8(svg_text(size, layers, photo=photo, title=title)))


def hex_color(color: Sequence[float]) -> str:
    """Return red, green, blue in [0, 1] as "#rrggbb"."""
    return "#" + "".join(f"{round(255 * min(max(c, 0.0), 1.0)):02x}" for c in color)


def _image(photo: npt.ArrayLike, size: tuple[int, int]) -> str:
    values = checked(photo)
    if values.shape[1::-1] != size:
        raise BadValue("photo", f"of {values.shape[1]} x {values.shape[0]} px", f"{size[0]} x {size[1]} px")
    data = base64.b64encode(encoded(values, "JPEG", quality=90)).decode()
    place = f'x="0" y="0" width="{size[0]}" height="{size[1]}" preserveAspectRatio="none"'
    # the prefixed link is old, but the one that every editor and browser reads
    return f'<image {place} xlink:href="data:image/jpeg;base64,{data}"/>'


def _group(layer: SvgLayer) -> Iterator[str]:
    style = (
        f'fill="none" stroke="{hex_color(layer.color)}" stroke-width="{layer.width:g}" '
        f'stroke-opacity="{layer.opacity:g}" stroke-linecap="round" stroke-linejoin="round"'
    )
    yield f"<g class={quoteattr(_clean(layer.name))} {style}{_dashes(layer)}>"
    titles = layer.titles or [""] * len(layer.polylines)
    for line, title in zip(layer.polylines, titles, strict=True):
        if path := _path(np.asarray(line)):
            yield f'<path d="{path}"><title>{_text(title)}</title></path>' if title else f'<path d="{path}"/>'
    yield "</g>"


def _dashes(layer: SvgLayer) -> str:
    """Return the dash attributes; round ends add half a width at each end, so the dashes are that much shorter."""
    if layer.dash is None:
        return ""
    on, off = layer.dash
    cap = min(layer.width, on) / 2
    return f' stroke-dasharray="{on - 2 * cap:.3f} {off + 2 * cap:.3f}" stroke-dashoffset="{-cap:.3f}"'


def _path(line: Array) -> str:
    """Return the path data of a polyline in SVG's corner-based pixels; "" if nothing of it is drawable."""
    finite = np.isfinite(line).all(axis=1)
    runs = np.split(line + _CORNER, np.flatnonzero(~finite))
    drawn = (run[np.isfinite(run).all(axis=1)] for run in runs)
    return "".join("M" + "L".join(f"{x:.3f} {y:.3f}" for x, y in run) for run in drawn if len(run) > 1)


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)


def _text(text: str) -> str:
    return escape(_clean(text))
