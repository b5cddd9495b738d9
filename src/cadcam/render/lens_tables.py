"""The direction of each pixel of a distorting camera, computed once for all renderers of that camera.

A table takes longer to make than a picture to draw. Verification, for example, views many scenes with one camera and
opens a renderer for each; the tables used last are kept between them, within a memory limit that is never missed.
"""

from __future__ import annotations

import threading
from collections import OrderedDict

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Lens
from cadcam.camera.perspective import direction
from cadcam.native.core import NativeLens

TABLE_BYTES = 32  # per pixel of a table: the points in tiles, the inverse, patches
MAKING_BYTES = TABLE_BYTES + 16  # while it is made, of the points in rows
KEPT_BYTES = 1 << 29  # of tables kept although no renderer may need them any more
_LARGEST = 2  # of a table, by that, which is kept alone until another is made: 24 megapixels
_CACHED = 1 << 14  # pixels unprojected at a time
_STEEP = 1 / 32  # change from pixel to pixel of a plane point, of its distance from the eye

Key = tuple[tuple[int, int], bytes, Lens, int]


class LensTables:
    """The tables used last, of any cameras; in total at most `kept_bytes`, or one of twice that."""

    def __init__(self, kept_bytes: int = KEPT_BYTES) -> None:
        self._kept_bytes = kept_bytes
        self._tables: OrderedDict[Key, NativeLens] = OrderedDict()
        self._lock = threading.Lock()

    def table(self, camera: Camera, n: int) -> NativeLens:
        """Return the table of a camera for n x n samples per pixel."""
        key = (camera.size, camera.K.tobytes(), camera.lens, n)
        with self._lock:
            if key in self._tables:
                self._tables.move_to_end(key)
                return self._tables[key]
        made = NativeLens(table_points(camera, n))
        if not may_return(camera.lens):
            return made
        with self._lock:
            self._tables[key] = made
            while sum(map(_bytes, self._tables)) > self._limit:
                self._tables.popitem(last=False)
        return made

    @property
    def _limit(self) -> int:
        """Return how many bytes may be kept: of one table alone, the newest, more than of several."""
        return self._kept_bytes * (_LARGEST if len(self._tables) == 1 else 1)


TABLES = LensTables()


def may_return(lens: Lens) -> bool:
    """Return whether the tables of a lens may be requested again: not where it equals no other."""
    return type(lens).__eq__ is not object.__eq__


def table_points(camera: Camera, n: int, rows: slice = slice(None)) -> Array:
    """Return the plane points (n R, n W, 2) of n x n samples per pixel, of some rows of pixels or all.

    Those of some rows are bit by bit the same as among all.
    """
    if n == 1:
        return plane_points(camera, rows)
    top, end, _ = rows.indices(camera.height)
    above, below = max(top - 1, 0), min(end + 1, camera.height)  # the slopes of a row need its neighbours
    return subdivided(plane_points(camera, slice(above, below)), n)[(top - above) * n : (end - above) * n]


def plane_points(camera: Camera, rows: slice = slice(None)) -> Array:
    """Return the point (x/z, y/z) of the undistorted plane (R, W, 2) for each pixel centre of the rows; NaN if none."""
    first, end, _ = rows.indices(camera.height)
    points = np.full((end - first, camera.width, 2), np.nan)
    x = np.arange(camera.width, dtype=np.float64)
    block = max(1, _CACHED // camera.width)  # rows, few at a time, to stay in the cache
    for top in range(first // block * block, end, block):  # whole blocks: lenses iterate until all pixels of one agree
        y = np.arange(top, min(top + block, camera.height), dtype=np.float64)
        ray = camera.unproject(np.stack(np.meshgrid(x, y), axis=-1))[max(first - top, 0) : end - top]
        at = max(top - first, 0)
        points[at : at + len(ray)] = ray[..., :2] / np.where(ray[..., 2:] > 0, ray[..., 2:], np.nan)
    return points


def slopes(field: Array) -> tuple[Array, Array]:
    """Return the change of a field (H, W, C) per px along x and along y, each (H, W, C); 0 along a single px.

    At the rim of a lens, where a neighbour is NaN, it is the change towards the other one.
    """
    return _slope(field, 1), _slope(field, 0)


def _slope(field: Array, axis: int) -> Array:
    if field.shape[axis] == 1:
        return np.zeros_like(field)
    slope = np.asarray(np.gradient(field, axis=axis))
    rim = np.isnan(slope) & np.isfinite(field)
    if rim.any():
        step = np.diff(field, axis=axis)
        behind, ahead = (np.insert(step, k, np.nan, axis=axis)[rim] for k in (0, field.shape[axis] - 1))
        slope[rim] = np.nan_to_num(np.where(np.isnan(ahead), behind, ahead))
    return slope


class Around:
    """What is looked at beside the pixels' centres: points of the plane, extrapolated linearly from the centres' own.

    The error is an eighth of the lens' second difference: below 2e-3 px for a strong lens on 320 px, less on more
    pixels. Towards 90 degrees the plane runs away to infinity: where a pixel takes more than `_STEEP` of the way there,
    unit rays are extrapolated, which stay as smooth as the lens. Elsewhere they would save less than 2e-2 px.
    """

    def __init__(self, centres: Array) -> None:
        self._centres, (self._per_x, self._per_y) = centres, slopes(centres)
        change = _larger(np.maximum(np.abs(self._per_x), np.abs(self._per_y)))
        self._steep = change > _STEEP * (1 + _larger(np.abs(centres)))
        if self._steep.any():
            rays = direction(centres)
            self._ray, (self._ray_x, self._ray_y) = rays[self._steep], (d[self._steep] for d in slopes(rays))

    def at(self, x: float, y: float) -> Array:
        """Return the points (H, W, 2) seen (x, y) px beside the centres; NaN where that is 90 degrees or more away."""
        points = self._centres + x * self._per_x + y * self._per_y
        if self._steep.any():
            ray = self._ray + x * self._ray_x + y * self._ray_y
            points[self._steep] = ray[:, :2] / np.where(ray[:, 2:] > 0, ray[:, 2:], np.nan)
        return np.asarray(points)


def _larger(pairs: Array) -> Array:
    """Return the larger (...) of each two numbers (..., 2); `max` along so short an axis takes forty times as long."""
    return np.asarray(np.maximum(pairs[..., 0], pairs[..., 1]))


def subdivided(points: Array, n: int) -> Array:
    """Return plane points (nH, nW, 2) of n x n samples per pixel from those of the centres (H, W, 2); see `Around`."""
    height, width = points.shape[:2]
    around = Around(points)
    out = np.zeros((n * height, n * width, 2))
    for j, i in np.ndindex(n, n):
        out[j::n, i::n] = around.at((i + 0.5) / n - 0.5, (j + 0.5) / n - 0.5)
    return out


def _bytes(key: Key) -> int:
    (width, height), _, _, n = key
    return TABLE_BYTES * width * height * n * n
