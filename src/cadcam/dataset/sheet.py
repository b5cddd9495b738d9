"""A contact sheet: views from the whole data set with their labels drawn on them, for inspection."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Picture
from cadcam.dataset.assembly import read_record
from cadcam.dataset.layout import DatasetFiles
from cadcam.dataset.view_renderer import VISIBLE
from cadcam.image.draw import draw_points, draw_polylines, draw_text
from cadcam.image.picture import read_picture, to_rgb
from cadcam.image.png import packed

COLUMNS, ROWS = 4, 3
_TILE_PX = 320  # of the longer side
_GREEN, _YELLOW, _RED, _BLUE = (0.0, 0.85, 0.35), (1.0, 0.85, 0.0), (1.0, 0.25, 0.2), (0.1, 0.6, 1.0)
_GAP = 4


def contact_sheet(folder: Path, layout: DatasetFiles, views: int) -> bytes:
    """Return a PNG of up to twelve views, evenly out of all.

    Edges green, hidden shares of the part blue, the visible box yellow, key points red: discs seen, crosses hidden.
    """
    chosen = np.unique(np.linspace(0, views - 1, min(views, COLUMNS * ROWS)).astype(int)).tolist()
    tiles = [_tile(folder, layout, index) for index in chosen]
    height, width = tiles[0].shape[:2]
    rows, columns = -(-len(tiles) // COLUMNS), min(len(tiles), COLUMNS)
    sheet = np.ones((rows * (height + _GAP) - _GAP, columns * (width + _GAP) - _GAP, 3), np.float32)
    for i, tile in enumerate(tiles):
        y, x = (i // COLUMNS) * (height + _GAP), (i % COLUMNS) * (width + _GAP)
        sheet[y : y + height, x : x + width] = tile
    return packed((sheet.clip(0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8))


def _tile(folder: Path, layout: DatasetFiles, index: int) -> Picture:
    record = read_record(folder, layout, index)
    picture = to_rgb(read_picture(folder / layout.path(layout.picture, index)))
    if record["made"]["occluders"]:
        picture = picture.copy()
        whole, seen = (read_picture(folder / layout.path(kind, index)) > 0.5 for kind in ("mask", "mask_visib"))
        picture[whole & ~seen] = 0.6 * picture[whole & ~seen] + 0.4 * np.array(_BLUE, np.float32)
    sides = picture.shape[:2]
    by = max(1, min(round(max(sides) / _TILE_PX), *sides))
    tile = _smaller(picture, by)
    with np.load(folder / layout.path("edges", index)) as edges:
        lines = np.insert(_moved(edges["q"], by), edges["start"][1:-1], np.nan, axis=0)
    tile = draw_polylines(tile, [lines], color=_GREEN, width=1.0, opacity=0.9)
    if record["coco"] is not None:
        tile = draw_polylines(tile, [_moved(_outline(record["coco"]["bbox"]), by)], color=_YELLOW, width=1.0)
    tile = _with_points(tile, record, by)
    return draw_text(tile, (6.0, 16.0), str(index), color=_YELLOW, height=13.0)


def _with_points(tile: Picture, record: dict[str, Any], by: int) -> Picture:
    points, seen = record["key_points"]["q"], record["key_points"]["seen"]
    for mark, wanted in (("circle", True), ("cross", False)):
        q = [p for p, s in zip(points, seen, strict=True) if p is not None and s and (s == VISIBLE) == wanted]
        if q:
            tile = draw_points(tile, _moved(np.array(q), by), color=_RED, mark=mark, size=5.0, width=1.2)
    return tile


def _outline(box: list[int]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the corners, closed, of a COCO box along the outer borders of its pixels."""
    x, y, w, h = (float(v) for v in box)
    return np.array([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]) - 0.5


def _moved(q: np.ndarray[Any, Any], by: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return pixels of a picture in one `by` times smaller (docs/conventions.md: resize)."""
    return np.asarray((q.astype(np.float64) + 0.5) / by - 0.5)


def _smaller(picture: Picture, by: int) -> Picture:
    height, width = picture.shape[0] // by * by, picture.shape[1] // by * by
    total = sum(picture[y:height:by, x:width:by] for y in range(by) for x in range(by))
    return np.asarray(total / np.float32(by * by), np.float32)
