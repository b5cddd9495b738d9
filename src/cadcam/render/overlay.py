"""A model over its photo: wireframe, shaded view, side by side, and the distance of lines from the photo's edges."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Picture
from cadcam.cad.edges import EdgeKind
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, SizeMismatch
from cadcam.image.draw import draw_polylines
from cadcam.image.edges import EdgePoints, canny, distance_to_edges
from cadcam.image.picture import checked, equalized, to_gray, to_rgb
from cadcam.image.stroke import check_stroke, paint_of
from cadcam.image.svg import SvgLayer, write_svg
from cadcam.kinds import FrozenMap, expect, expect_count, expect_number, expect_numbers, expect_path, expect_positive
from cadcam.render.lines.wireframe import Polylines, Wireframe
from cadcam.render.view import View

Color = tuple[float, float, float]

# Strong on grey metal, and distinct for people with any colour vision: hues of Okabe and Ito (2008), saturated.
KIND_COLORS: Mapping[EdgeKind, Color] = FrozenMap(
    {
        EdgeKind.CREASE: (0.00, 0.85, 0.35),
        EdgeKind.BREP: (0.00, 0.85, 0.35),
        EdgeKind.BOUNDARY: (1.00, 0.35, 0.00),
        EdgeKind.CONTACT: (1.00, 0.85, 0.00),
        EdgeKind.CONTOUR: (0.10, 0.70, 1.00),
    }
)
PART_COLORS: tuple[Color, ...] = (
    (0.00, 0.85, 0.35),
    (1.00, 0.35, 0.00),
    (0.10, 0.70, 1.00),
    (1.00, 0.85, 0.00),
    (0.95, 0.35, 0.75),
    (0.10, 0.90, 0.85),
    (0.75, 0.55, 1.00),
    (0.70, 0.95, 0.10),
)
BLACK: Color = (0.0, 0.0, 0.0)
_PARTS, _WIDEST_GAP = 5, 10_000


@dataclass(frozen=True, slots=True)
class LineStyle:
    """How lines are drawn: widths in px, opacities in [0, 1], colours RGB in [0, 1].

    `color_by` is "kind" (the colours of `kinds`), "part" (a cycle of distinct colours) or "one" (`color` for all).
    Hidden lines, where the wireframe has them, are `dash` = (on, off) px and fainter.
    """

    color_by: str = "kind"
    color: Color = PART_COLORS[0]
    kinds: Mapping[EdgeKind, Color] = field(default_factory=lambda: KIND_COLORS)
    width: float = 1.5
    opacity: float = 1.0
    hidden_width: float = 1.0
    hidden_opacity: float = 0.6
    dash: tuple[float, float] = (6.0, 4.0)

    def __post_init__(self) -> None:
        expect_numbers(self)
        expect(self.color_by, "color_by", str)
        if self.color_by not in ("kind", "part", "one"):
            raise BadValue("color_by", repr(self.color_by), "'kind', 'part' or 'one'")
        check_stroke(self.width, self.opacity, None)
        check_stroke(self.hidden_width, self.hidden_opacity, self.dash, of="hidden_")
        paint_of(self.color)
        expect(self.kinds, "kinds", Mapping)
        for kind, color in self.kinds.items():
            expect(kind, "one of the kinds", EdgeKind)
            paint_of(color, f"color of {kind.name}")
        object.__setattr__(self, "kinds", FrozenMap(self.kinds))


PLAIN_STYLE = LineStyle()


def overlay(photo: npt.ArrayLike, wireframe: Wireframe, *, style: LineStyle = PLAIN_STYLE) -> Picture:
    """Return the photo in colour (H, W, 3) with the wireframe on it, anti-aliased; hidden lines first, dashed.

    Raises `SizeMismatch` unless the photo has the camera's size.
    """
    expect(wireframe, "wireframe", Wireframe)
    expect(style, "style", LineStyle)
    picture = to_rgb(fitting(photo, wireframe.camera))
    for layer in _layers(wireframe, style):
        picture = draw_polylines(
            picture, layer.polylines, color=layer.color, width=layer.width, opacity=layer.opacity, dash=layer.dash
        )
    return picture


def write_overlay_svg(
    path: str | os.PathLike[str],
    wireframe: Wireframe,
    *,
    photo: npt.ArrayLike | None = None,
    style: LineStyle = PLAIN_STYLE,
    title: str = "",
) -> None:
    """Write the wireframe as SVG, one group per colour, over the embedded photo (of the camera's size) if given."""
    expect_path(path)
    expect(wireframe, "wireframe", Wireframe)
    expect(style, "style", LineStyle)
    expect(title, "title", str)
    embedded = None if photo is None else fitting(photo, wireframe.camera)
    write_svg(path, wireframe.camera.size, list(_layers(wireframe, style)), photo=embedded, title=title)


def blend_pictures(photo: npt.ArrayLike, view: View, *, opacity: float = 0.5) -> Picture:
    """Return the photo (H, W, 3) with the shaded model over it, the background unchanged."""
    expect(view, "view", View)
    expect_number(opacity, "opacity")
    if not 0 <= opacity <= 1:
        raise BadValue("opacity", opacity, "0 (nothing) to 1 (opaque)")
    picture = to_rgb(fitting(photo, view.camera))
    share = (opacity * view.coverage)[..., None]
    return np.asarray(picture * (1 - share) + np.float32(opacity) * model_alone(view), np.float32)


def add_pictures(photo: npt.ArrayLike, view: View) -> Picture:
    """Return photo and shaded model (on black) added and histogram-equalised, (H, W): the thesis' Fig. 3-4."""
    expect(view, "view", View)
    return equalized((to_gray(fitting(photo, view.camera)) + to_gray(model_alone(view))) / 2)


def overlay_on_edges(
    photo: npt.ArrayLike, wireframe: Wireframe, *, edges: EdgePoints | None = None, style: LineStyle | None = None
) -> Picture:
    """Return the photo's Canny edges in white on its dimmed self, the wireframe on top (H, W, 3): Fig. 3-16 and 3-17.

    `edges` default to `canny` of the photo; `style` to the thesis' black lines.
    """
    expect(wireframe, "wireframe", Wireframe)
    expect(edges, "edges", EdgePoints, optional=True)
    expect(style, "style", LineStyle, optional=True)
    gray = to_gray(fitting(photo, wireframe.camera))
    edges = canny(gray) if edges is None else edges
    picture = to_rgb(0.25 + 0.35 * gray)
    picture[edges.mask(wireframe.camera.size)] = 1.0
    return overlay(picture, wireframe, style=style or LineStyle(color_by="one", color=BLACK, width=1.2))


def side_by_side(*pictures: npt.ArrayLike, gap: int = 8) -> Picture:
    """Return pictures of one height next to each other, with a white gap of `gap` px; (H, W', 3)."""
    if not pictures:
        raise BadValue("number of pictures", 0, "at least one")
    expect_count(gap, "gap", least=0, most=_WIDEST_GAP)
    colour = [to_rgb(p) for p in pictures]
    height = colour[0].shape[0]
    for picture in colour:
        if picture.shape[0] != height:
            raise BadValue("picture height", picture.shape[0], f"{height} px, that of the first picture")
    bar = np.ones((height, int(gap), 3), np.float32)
    pieces = [piece for picture in colour for piece in (bar, picture)]
    return np.concatenate(pieces[1:], axis=1)


def edge_distances(
    photo: npt.ArrayLike,
    wireframe: Wireframe,
    *,
    edges: EdgePoints | None = None,
    step_px: float = 1.0,
    within: float = np.pi / 9,
) -> Array:
    """Return the distance (n,) in px of the visible lines from the photo's nearest sub-pixel edge, every `step_px`.

    Only edges within `within` rad of a line's direction count; inf where the photo has none. Image edges are points
    about 1 px apart: for each step the nearest of five samples counts, so that the distance is measured across the
    line and not along it. Only samples inside the picture are used. `edges` default to `canny` of the photo.
    """
    expect(wireframe, "wireframe", Wireframe)
    expect(edges, "edges", EdgePoints, optional=True)
    expect_positive(step_px, "step_px", "a positive number of px")
    expect_positive(within, "within", "an angle of at least 0 rad", zero=True)
    gray = to_gray(fitting(photo, wireframe.camera))
    edges = canny(gray) if edges is None else edges
    q, normal, line, _ = wireframe.visible.points_along(step_px / _PARTS)
    inside = wireframe.camera.sees(q)
    q, normal, line = q[inside], normal[inside], line[inside]
    if not len(q):
        return np.zeros(0)
    distance = distance_to_edges(edges, q, normal=normal, within=within)
    first = np.flatnonzero(np.diff(line, prepend=-1))
    rank = np.arange(len(line)) - np.repeat(first, np.diff(first, append=len(line)))
    return np.asarray(np.minimum.reduceat(distance, np.flatnonzero(rank % _PARTS == 0)))


def fitting(photo: npt.ArrayLike, camera: Camera, *, name: str = "the photo") -> Picture:
    """Return the photo in [0, 1]; raises `SizeMismatch`, with its name, unless it has the camera's size."""
    picture = checked(photo)
    size = picture.shape[1::-1]
    if size != camera.size:
        raise SizeMismatch(name, (int(size[0]), int(size[1])), camera.size)
    return picture


def model_alone(view: View) -> Picture:
    """Return the model's own contribution to each pixel (H, W, 3): the image on black.

    The background's colour is that of a pixel without the model; where there is none it is assumed black.
    """
    emptiest = np.unravel_index(np.argmin(view.coverage), view.coverage.shape)
    background = view.image[emptiest]
    if view.coverage[emptiest] > 0 or not background.any():
        return view.image  # of large pictures every copy counts
    behind = (1 - view.coverage)[..., None] * background
    return np.asarray(np.subtract(view.image, behind, out=behind), np.float32)


def _layers(wireframe: Wireframe, style: LineStyle) -> Iterator[SvgLayer]:
    """Yield the lines by colour, hidden ones first."""
    for name, color, lines in _by_color(wireframe.hidden, style):
        yield SvgLayer(f"hidden {name}", lines, color, style.hidden_width, style.hidden_opacity, style.dash)
    for name, color, lines in _by_color(wireframe.visible, style):
        yield SvgLayer(name, lines, color, style.width, style.opacity)


def _by_color(polylines: Polylines, style: LineStyle) -> Iterator[tuple[str, Color, list[Array]]]:
    lines = polylines.lines
    if not lines:
        return
    if style.color_by == "one":
        yield "lines", style.color, lines
        return
    keys = polylines.kind if style.color_by == "kind" else polylines.part % len(PART_COLORS)
    for key in np.unique(keys).tolist():
        chosen = [lines[i] for i in np.flatnonzero(keys == key)]
        if style.color_by == "kind":
            kind = EdgeKind(key)
            yield kind.name.lower(), style.kinds.get(kind, style.color), chosen
        else:
            yield f"parts-{key}", PART_COLORS[key], chosen
