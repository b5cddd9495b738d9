"""Direction fields of a photo: at each pixel and for each of a few directions, the certainty of a line there.

The gradient by Sobel's operator is compared with the picture's noise (the median of its magnitude, which is Rayleigh
distributed where there is only noise) and with the mean around it, so that neither contrast nor exposure matters and no
texture outweighs an isolated edge; pixels beside the crest of an edge count less. Its direction is spread over the
sectors by a cosine's fourth power. Like the response maps of S. Hinterstoisser et al., Gradient response maps for
real-time detection of textureless objects, PAMI 34 (2012), the fields are made to be summed along the edges of a model;
unlike those they keep lines sharp, and coarser fields are pooled from finer ones, so that the two sides of a thin plate
do not cancel.

Fields are those of an ideal camera: lens distortion, and pixels far from square, are removed first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from cadcam.arrays import Array, Mask, Picture
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.native.fields import SECTORS, Planes, directions, halve, reduce, straighten

__all__ = ["SECTORS", "DirectionField", "direction_fields"]

_FLOOR = 0.5 / 255  # grey value per pixel: smaller gradients are quantisation
_WIDEST = 1.5  # largest size of an undistorted picture relative to the photo
_LEAST = 4  # px, least shorter side of a field
_SQUARE = 0.1  # pixels whose sides differ by this share, or whose axes do by this angle (rad), still count as square
_STEP = 8  # px between nodes at which the lens is evaluated; linear interpolation is good to hundredths of a pixel


@dataclass(frozen=True, slots=True, eq=False)
class DirectionField:
    """A field and its ideal camera, whose pixels are those of the field.

    planes: values (SECTORS, H, W) uint8, 255 = sure; plane s is for lines whose normal has the direction
    s pi / SECTORS, up to sign; mean and variance (SECTORS,) over the picture. reduction: photo pixels to one of the
    field.
    """

    camera: Camera
    planes: Planes
    reduction: int


def direction_fields(
    gray: Picture,
    camera: Camera,
    *,
    reduction: int = 1,
    levels: int,
    region: tuple[int, int, int, int] | None = None,
    explained: Mask | None = None,
) -> tuple[DirectionField, ...]:
    """Return the fields of a photo (H, W) taken by `camera`, the finest (`reduction` photo pixels per pixel) first.

    Each next one has half the size; fewer than `levels` are returned if a side would fall below 4 px. region: only this
    part of the photo, (left, top, right, bottom) px, right and bottom excluded; cameras are cropped accordingly, with a
    margin if they have a lens. Pixels far from square become square ones of the same area. explained (H, W): pixels of
    the photo where the certainty of lines is set to 0.
    """
    box = (0, 0, *camera.size) if region is None else region
    known = None if explained is None else np.asarray(explained, np.float32)
    if isinstance(camera.lens, Ideal) and _has_square_pixels(camera):
        left, top, right, bottom = box
        camera = _reduced(camera.crop(left, top, (right - left, bottom - top)), reduction)
        planes = directions(_even(gray[top:bottom, left:right], reduction), _FLOOR)
        open_ = None if known is None else _even(known[top:bottom, left:right], reduction) == 0
    else:
        picture, open_, ideal = _straightened(gray, camera, reduction, box)
        planes = directions(picture, _FLOOR)
        if known is not None:
            open_ &= _straightened(known, camera, reduction, box)[0] == 0
        camera = ideal
    if open_ is not None and not open_.all():
        _close(planes, open_)
    fields = [DirectionField(camera, planes, reduction)]
    while len(fields) < levels and min(fields[-1].camera.size) >= 2 * _LEAST:
        last = fields[-1]
        fields.append(DirectionField(_reduced(last.camera, 2), halve(last.planes), 2 * last.reduction))
    return tuple(fields)


def _close(planes: Planes, open_: Mask) -> None:
    """Set all directions to 0 where a picture is not open (H, W), and mean and variance to those of what is left."""
    gone = planes.values[:, ~open_].astype(np.float64)
    mean, n = planes.mean.astype(np.float64), open_.size
    squares = planes.variance + mean**2 - (gone**2).sum(axis=1) / n
    mean = mean - gone.sum(axis=1) / n
    planes.mean[:], planes.variance[:] = mean, np.maximum(squares - mean**2, 0.0)
    np.multiply(planes.values, open_.view(np.uint8), out=planes.values)


def _even(gray: Picture, k: int) -> Picture:
    return reduce(gray, k) if k > 1 else np.asarray(gray, np.float32)


def _reduced(camera: Camera, k: int) -> Camera:
    """Return the camera of blocks of k x k pixels; incomplete ones at the right and bottom are cut off."""
    width, height = camera.width // k, camera.height // k
    return camera.crop(0, 0, (width * k, height * k)).resize((width, height)) if k > 1 else camera


def _straightened(
    gray: Picture, camera: Camera, k: int, region: tuple[int, int, int, int]
) -> tuple[Picture, Mask, Camera]:
    """Return a region of a photo, reduced by k, as an ideal camera sees it, which pixels are valid, and that camera."""
    ideal, nodes = _straight(camera, k)
    left, top, right, bottom = (side / k for side in region)
    x, y = nodes[..., 0], nodes[..., 1]
    inside = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    (first, down), (column, across) = (_steps(np.asarray(inside.any(axis=axis))) for axis in (1, 0))
    nodes = nodes[first : first + down + 1, column : column + across + 1]
    x0, y0 = _STEP * column, _STEP * first
    ideal = ideal.crop(x0, y0, (min(_STEP * across, ideal.width - x0), min(_STEP * down, ideal.height - y0)))
    rows = np.clip(nodes[..., 1], 0, camera.height // k)  # the rows of the photo that are needed
    low, high = int(np.fmin.reduce(rows, axis=None)), int(np.fmax.reduce(rows, axis=None)) + 2
    return (
        *straighten(_even(gray[low * k : high * k], k), nodes - np.array([0, low], np.float32), _STEP, ideal.size),
        ideal,
    )


def _steps(inside: Mask) -> tuple[int, int]:
    """Return the first interval between nodes, and their number, that cover all nodes inside; all if none is."""
    found = np.flatnonzero(inside)
    first, last = (max(int(found[0]) - 1, 0), int(found[-1]) + 1) if len(found) else (0, len(inside))
    return first, min(last, len(inside) - 1) - first


@lru_cache(maxsize=8)
def _straight(camera: Camera, k: int) -> tuple[Camera, Picture]:
    """Return the ideal camera that sees a photo, reduced by k, without distortion, and its nodes' places in the photo.

    Its pixels are square unless the photo's nearly are.

    Nodes (rows, columns, 2) px: every `_STEP`-th pixel of every `_STEP`-th row, from the first to beyond the last.
    Cached, as one camera takes photo after photo.
    """
    camera = _reduced(camera, k)
    ideal = replace(camera if _has_square_pixels(camera) else _with_square_pixels(camera), lens=Ideal())
    low, high = _bounds(camera, ideal)
    ideal = ideal.crop(int(low[0]), int(low[1]), (int(high[0] - low[0]), int(high[1] - low[1])))
    columns, rows = (_STEP * np.arange((n - 1) // _STEP + 2.0) for n in ideal.size)
    nodes = camera.project(ideal.unproject(np.stack(np.meshgrid(columns, rows), axis=-1)))
    return ideal, nodes.astype(np.float32)


def _has_square_pixels(camera: Camera) -> bool:
    return abs(math.log(camera.fx / camera.fy)) <= _SQUARE and abs(camera.skew / camera.fy) <= _SQUARE


def _with_square_pixels(camera: Camera) -> Camera:
    """Return a camera that sees about the same with square pixels of the same area."""
    f = math.sqrt(camera.fx * camera.fy)
    resized = camera.resize((max(1, round(camera.width * f / camera.fx)), max(1, round(camera.height * f / camera.fy))))
    return replace(resized, K=np.array([[f, 0.0, resized.K[0, 2]], [0.0, f, resized.K[1, 2]], [0.0, 0.0, 1.0]]))


def _bounds(camera: Camera, ideal: Camera) -> tuple[Array, Array]:
    """Return the corners (2,), (2,) px of the ideal camera's picture: what the border sees, within limits."""
    w, h = camera.size
    t = np.linspace(0.0, 1.0, 65)
    border = [(t * (w - 1), 0 * t), (t * (w - 1), 0 * t + h - 1), (0 * t, t * (h - 1)), (0 * t + w - 1, t * (h - 1))]
    ray = camera.unproject(np.concatenate([np.stack(side, axis=-1) for side in border]))
    ray = ray[np.isfinite(ray).all(axis=1) & (ray[:, 2] > 0)]
    size, slack = np.array(ideal.size, float), (_WIDEST - 1) / 2 * np.array(ideal.size)
    if not len(ray):
        return np.zeros(2), size
    q = ideal.project(ray)
    low, high = np.floor(q.min(axis=0)), np.ceil(q.max(axis=0)) + 1
    return np.maximum(low, -np.floor(slack)), np.minimum(high, size + np.floor(slack))
