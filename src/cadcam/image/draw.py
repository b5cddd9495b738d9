"""Anti-aliased lines, marks and labels on pictures, at sub-pixel positions, without a drawing library.

A pixel's coverage by a line is the line's profile (1 within width/2 of it) smoothed by a tent of half-width 1 px, at
the pixel's distance from the line. The tent's spectrum has double zeros at whole frequencies, so that neither ink nor
centre of a level or upright line depends on where it lies between the pixels (Mitchell and Netravali, SIGGRAPH 1988,
on such filters); the usual clamp(width/2 + 1/2 - d, 0, 1) shifts a 1.5 px line by up to 0.08 px. At other angles the
centre keeps to 0.01 px (at 45 degrees; the worst). Coverages of one call are joined by their maximum before they are
blended in, so corners, crossings and lines drawn twice are no darker than the rest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Picture, frozen
from cadcam.errors import BadValue
from cadcam.image.picture import checked
from cadcam.image.stroke import Color, check_stroke, paint_of
from cadcam.kinds import expect_known

_BATCH = 400_000  # candidate pixels examined at a time: bounds the memory and stays in the cache
_MARKS = ("plus", "cross", "circle")


def draw_polylines(
    picture: npt.ArrayLike,
    polylines: Iterable[npt.ArrayLike],
    *,
    color: Color,
    width: float = 1.5,
    opacity: float = 1.0,
    dash: tuple[float, float] | None = None,
) -> Picture:
    """Return a colour copy (H, W, 3) of the picture with the polylines on it, with round joints and ends.

    Each polyline is (N, 2) pixel positions (x, y), pixel centres at integers; a NaN row interrupts it. `width` and
    `dash` = (on, off) are in px; dashes run on through the vertices. Points may lie any distance outside the picture.
    A line thinner than a pixel is paler. Raises `BadValue`.
    """
    paint = paint_of(color)
    check_stroke(width, opacity, dash)
    rgb = _rgb_copy(picture)
    lines = _segments(polylines)
    lines = _clipped(lines, (rgb.shape[1], rgb.shape[0]), width / 2 + 2.0)
    if dash is not None:
        lines = _dashed(lines, dash, width)
    _blend(rgb, _coverage(lines, rgb.shape[:2], width), paint, opacity)
    return rgb


def draw_points(
    picture: npt.ArrayLike,
    q: npt.ArrayLike,
    *,
    color: Color,
    mark: str = "cross",
    size: float = 9.0,
    width: float = 1.5,
) -> Picture:
    """Return a colour copy of the picture with a mark ("plus", "cross" or "circle") of `size` px at each q (N, 2).

    NaN points are left out. Raises `UnknownName` for another mark, `BadValue`.
    """
    expect_known(mark, "mark", _MARKS)
    if not 0 < size < 1e5:
        raise BadValue("size", size, "a mark size above 0 px")
    points = frozen(q, "q", (None, 2), finite=False)
    strokes = [points[:, None] + size / 2 * stroke for stroke in _strokes(mark, size)]
    return draw_polylines(picture, [line for stroke in strokes for line in stroke], color=color, width=width)


def draw_text(picture: npt.ArrayLike, q: npt.ArrayLike, text: str, *, color: Color, height: float = 14.0) -> Picture:
    """Return a colour copy of the picture with a line of text whose left end's middle is at q = (x, y), whole pixels.

    `height` is the font's size in px. Parts outside the picture are cut off.
    """
    paint, at = paint_of(color), frozen(q, "q", (2,))
    if not 4 <= height <= 1000:
        raise BadValue("height", height, "4 to 1000 px")
    rgb = _rgb_copy(picture)
    glyphs = _glyphs(text, height)
    x, y = (int(i) for i in np.clip(np.rint(at), -1e6, 1e6))
    y -= glyphs.shape[0] // 2
    coverage = np.zeros(rgb.shape[:2], np.float32)
    target = coverage[max(y, 0) : max(y + glyphs.shape[0], 0), max(x, 0) : max(x + glyphs.shape[1], 0)]
    target[:] = glyphs[max(-y, 0) :, max(-x, 0) :][: target.shape[0], : target.shape[1]]
    _blend(rgb, coverage, paint, 1.0)
    return rgb


class _Segments(NamedTuple):
    """Straight pieces from a to b (N, 2) and the lengths of polyline at their ends, start and stop (N,)."""

    a: Array
    b: Array
    start: Array
    stop: Array


def _rgb_copy(picture: npt.ArrayLike) -> Picture:
    values = checked(picture)
    return values.copy() if values.ndim == 3 else np.repeat(values[..., None], 3, axis=2)


def _strokes(mark: str, size: float) -> list[Array]:
    """Return the polylines of a mark that spans -1 to 1."""
    if mark == "circle":
        turn = np.linspace(0, 2 * math.pi, max(16, math.ceil(4 * math.sqrt(size)) * 4) + 1)
        return [np.column_stack([np.cos(turn), np.sin(turn)])]
    plus = np.array([[[-1.0, 0.0], [1.0, 0.0]], [[0.0, -1.0], [0.0, 1.0]]])
    return list(plus if mark == "plus" else plus @ np.array([[1.0, 1.0], [-1.0, 1.0]]) * math.sqrt(0.5))


def _glyphs(text: str, height: float) -> Picture:
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(height)
    _, top, right, bottom = (math.ceil(v) for v in ImageDraw.Draw(Image.new("L", (1, 1))).textbbox((0, 0), text, font))
    image = Image.new("L", (max(right, 1), max(bottom - top, 1)))
    ImageDraw.Draw(image).text((0, -top), text, 255, font)
    return np.asarray(image, np.float32) / np.float32(255)


def _segments(polylines: Iterable[npt.ArrayLike]) -> _Segments:
    """Return the pieces of all polylines, each polyline's length counted from its start or its last gap."""
    gap = np.full((1, 2), np.nan)
    parts = [part for line in polylines for part in (frozen(line, "polyline", (None, 2), finite=False), gap)]
    q = np.concatenate(parts) if parts else gap
    length = _lengths(q)
    there = np.isfinite(length)
    total = np.concatenate([[0.0], np.cumsum(np.where(there, length, 0.0))])
    # the length at the last gap before each piece; gaps come in order, so their running maximum is the last one
    origin = np.maximum.accumulate(np.where(there, 0.0, total[1:]))
    start, stop = total[:-1] - origin, total[1:] - origin
    return _Segments(q[:-1][there], q[1:][there], start[there], stop[there])


def _lengths(q: Array) -> Array:
    with np.errstate(invalid="ignore"):  # inf - inf: an infinite point is a gap too
        step = q[1:] - q[:-1]
        length: Array = np.hypot(step[:, 0], step[:, 1])
    return length


def _clipped(lines: _Segments, size: tuple[int, int], margin: float) -> _Segments:
    """Return the parts inside the picture widened by `margin` (Liang and Barsky, ACM TOG 3, 1984)."""
    low = np.full(2, -margin)
    high = np.array(size) - 1.0 + margin
    along = lines.b - lines.a
    enter, leave = np.zeros(len(along)), np.ones(len(along))
    for axis in (0, 1):
        flat = along[:, axis] == 0
        slope = np.where(flat, 1.0, along[:, axis])
        first = (low[axis] - lines.a[:, axis]) / slope
        second = (high[axis] - lines.a[:, axis]) / slope
        within = (lines.a[:, axis] >= low[axis]) & (lines.a[:, axis] <= high[axis])
        miss = np.where(within, -np.inf, np.inf)  # parallel to this side: wholly in or wholly out
        enter = np.maximum(enter, np.where(flat, miss, np.minimum(first, second)))
        leave = np.minimum(leave, np.where(flat, np.inf, np.maximum(first, second)))
    keep = enter <= leave
    return _cut(_Segments(*(part[keep] for part in lines)), enter[keep], leave[keep])


def _cut(lines: _Segments, enter: Array, leave: Array) -> _Segments:
    """Return each piece from share `enter` to share `leave` of it."""
    along, length = lines.b - lines.a, lines.stop - lines.start
    return _Segments(
        lines.a + enter[:, None] * along,
        np.where(leave[:, None] == 1, lines.b, lines.a + leave[:, None] * along),
        lines.start + enter * length,
        lines.start + leave * length,
    )


def _dashed(lines: _Segments, dash: tuple[float, float], width: float) -> _Segments:
    """Return the pieces under the dashes; round ends add half a width each, so the dashes are that much shorter."""
    on, off = dash
    cap = min(width, on) / 2
    first = np.floor(lines.start / (on + off)).astype(np.int64)
    count = np.floor(lines.stop / (on + off)).astype(np.int64) - first + 1
    which = np.repeat(np.arange(len(count)), count)
    begin = (first[which] + _counted(count)) * (on + off)
    pieces = _Segments(*(part[which] for part in lines))
    length = pieces.stop - pieces.start
    safe = np.where(length > 0, length, 1.0)
    enter = np.maximum((begin + cap - pieces.start) / safe, 0.0)
    leave = np.minimum((begin + on - cap - pieces.start) / safe, 1.0)
    keep = enter <= leave
    return _cut(_Segments(*(part[keep] for part in pieces)), enter[keep], leave[keep])


def _counted(count: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return 0, 1, ... count[0]-1, 0, 1, ... count[1]-1, ..."""
    return np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)


def _coverage(lines: _Segments, shape: tuple[int, ...], width: float) -> Picture:
    """Return each pixel's coverage (H, W) by the nearest piece."""
    reach = width / 2 + 1
    nearest = np.full(shape[0] * shape[1], reach, np.float32)
    for index, distance in _pixels_near(lines, shape, reach):
        np.minimum.at(nearest, index, distance)
    coverage = np.zeros(shape, np.float32)
    touched = nearest < reach
    coverage.reshape(-1)[touched] = _profile(nearest[touched], width)
    return coverage


def _profile(distance: Picture, width: float) -> Picture:
    """Return the coverage at a distance from a line: its box of `width` smoothed by a tent."""
    return _ramp(distance + width / 2) - _ramp(distance - width / 2)


def _ramp(t: Picture) -> Picture:
    """Return a step at 0 smoothed by a tent from -1 to 1: the tent's integral."""
    t = t.clip(-1, 1)
    return 0.5 + t - 0.5 * t * np.abs(t)


def _pixels_near(
    lines: _Segments, shape: tuple[int, ...], reach: float
) -> Iterator[tuple[npt.NDArray[np.int64], Picture]]:
    """Yield flat indices of the pixels within `reach` of each segment, and their distances from it, in batches."""
    height, width = shape
    along = np.abs(lines.b - lines.a)
    flat = along[:, 0] >= along[:, 1]
    yield from _pixels_near_flat(lines.a[flat], lines.b[flat], (width, height), (1, width), reach)
    # steep segments are flat ones with x and y exchanged
    yield from _pixels_near_flat(lines.a[~flat, ::-1], lines.b[~flat, ::-1], (height, width), (width, 1), reach)


def _pixels_near_flat(
    a: Array, b: Array, extent: tuple[int, int], stride: tuple[int, int], reach: float
) -> Iterator[tuple[npt.NDArray[np.int64], Picture]]:
    """Yield the same for segments a to b (N, 2) that rise by at most 45 degrees.

    extent, stride: of x and y in the flat picture. In every column that a segment touches the same number of rows is
    examined, centred on the line: at such slopes all pixels within `reach` lie within sqrt(2) reach along the column.
    """
    half = math.floor(math.sqrt(2) * reach + 0.5)
    rows = np.arange(-half, half + 1)
    first = np.ceil(np.minimum(a, b)[:, 0] - reach).astype(np.int64).clip(0)
    last = np.floor(np.maximum(a, b)[:, 0] + reach).astype(np.int64).clip(max=extent[0] - 1)
    columns = np.maximum(last - first + 1, 0)
    run, rise = (b - a).T
    slope = rise / np.where(run == 0, 1.0, run)
    for batch in _batches(columns * len(rows)):
        which = np.repeat(np.arange(batch.start, batch.stop), columns[batch])
        x = first[which] + _counted(columns[batch])
        on_line = np.rint(a[which, 1] + slope[which] * (x - a[which, 0])).astype(np.int64)
        y = on_line[:, None] + rows
        distance = _distances(x[:, None], y, a[which, :, None], b[which, :, None])
        near = (distance < reach) & (y >= 0) & (y < extent[1])
        yield (x[:, None] * stride[0] + y * stride[1])[near], distance[near].astype(np.float32)


def _batches(sizes: npt.NDArray[np.int64]) -> Iterator[slice]:
    """Yield slices of consecutive items whose sizes add up to about `_BATCH`."""
    total = int(sizes.sum())
    stops = np.searchsorted(np.cumsum(sizes), np.arange(_BATCH, total + _BATCH, _BATCH))
    for start, stop in itertools.pairwise([0, *stops.tolist(), len(sizes)]):
        yield slice(start, stop)


def _distances(x: npt.NDArray[np.int64], y: npt.NDArray[np.int64], a: Array, b: Array) -> Array:
    """Return the distances (M, K) of points x, y from the segments a to b (M, 2, 1)."""
    u, v = x - a[:, 0], y - a[:, 1]
    du, dv = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    square = np.maximum(du**2 + dv**2, np.finfo(float).tiny)
    t = ((u * du + v * dv) / square).clip(0, 1)
    return np.hypot(u - t * du, v - t * dv)


def _blend(rgb: Picture, coverage: Picture, paint: npt.NDArray[np.float32], opacity: float) -> None:
    index = np.flatnonzero(coverage)
    share = (coverage.reshape(-1)[index] * np.float32(opacity))[:, None]
    pixels = rgb.reshape(-1, 3)
    under = pixels[index]
    pixels[index] = under + share * (paint - under)
