"""A board as imaged by a camera: each pixel's mean over its area, through any lens, at any pose.

Within a pixel the map from picture to board is taken as linear; its curvature there is below 1e-4 px for any lens in
use. Pixels that an ink border may cross are averaged over a lattice of `_SAMPLES` points (a Fibonacci lattice: its
projections on both axes are evenly spaced, so that axis-parallel borders are as exact as slanted ones, and it is
symmetric about the pixel's centre, so that its errors cancel across a mark); all others take the ink at their centre.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.target.marks.mark import Mark, MarkSheet

Kinds: TypeAlias = npt.NDArray[np.int8]  # of what is seen: 0 paper, 1 ink, 2 the ground beside the sheet
KindAt: TypeAlias = Callable[[Array], Kinds]

_GROUND = 2
_SAMPLES, _GENERATOR = 377, 233  # consecutive Fibonacci numbers, odd ones
_TOGETHER = 500  # pixels averaged at a time


class Printed(Protocol):
    """What can be drawn: a calibration board, a plate with marks."""

    @property
    def outline(self) -> tuple[float, float, float, float]:
        """Return (left, top, right, bottom) of all ink in mm."""

    @property
    def cell_mm(self) -> float:
        """Return the default white margin around the ink, mm."""

    def black(self, p: Array) -> Mask:
        """Return whether there is ink at p (..., 2) mm."""


def board_picture(
    pattern: Printed,
    camera: Camera,
    camera_from_board: Rigid,
    *,
    paper: float = 0.9,
    ink: float = 0.1,
    background: float = 0.5,
    margin_mm: float | None = None,
    blur_px: float = 0.0,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Picture:
    """Return the grey picture (H, W) of a board printed on paper with `margin_mm` of white around it (default a cell).

    blur_px: sigma of a Gaussian point spread; noise: sigma of a grey value, with `rng`. Values are not clipped.
    """
    (picture,) = _sharp(pattern, camera, camera_from_board, (paper, ink), margin_mm, grounds=(background,))
    return _exposed(picture, blur_px, noise, rng)


def marks_picture(
    marks: Sequence[Mark],
    camera: Camera,
    camera_from_marks: Sequence[Rigid],
    *,
    paper: float = 0.9,
    ink: float = 0.1,
    background: float = 0.5,
    margin_mm: float | None = None,
    blur_px: float = 0.0,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Picture:
    """Return the grey picture (H, W) of marks at any poses, each on a square of paper; near ones occlude far ones.

    margin_mm: white around each mark (default half its radius). Marks behind the camera are rejected, those outside the
    picture left out. blur_px, noise: as for `board_picture`.
    """
    if len(marks) != len(camera_from_marks):
        raise BadValue("poses", len(camera_from_marks), f"one for each of the {len(marks)} marks")
    picture = np.full((camera.height, camera.width), float(background))
    for k in np.argsort([-pose.translation[2] for pose in camera_from_marks]):
        _paint(picture, marks[k], camera, camera_from_marks[k], (paper, ink), margin_mm)
    return _exposed(picture, blur_px, noise, rng)


def _paint(
    picture: Array, mark: Mark, camera: Camera, pose: Rigid, levels: tuple[float, float], margin_mm: float | None
) -> None:
    """Paint one mark and its paper onto a picture."""
    margin = mark.radius / 2 if margin_mm is None else margin_mm
    reach = mark.radius + margin + (mark.radius if mark.light else 0.0)
    corners = pose @ np.array([[x, y, 0.0] for x in (-reach, reach) for y in (-reach, reach)])
    if (corners[:, 2] <= 0).any():
        raise BadValue(f"pose of {mark}", f"z from {corners[:, 2].min():.4g} mm", "in front of the camera")
    q = camera.project(corners)
    low = np.floor(np.nan_to_num(q.min(axis=0), nan=0)).astype(int) - 2
    high = np.ceil(np.nan_to_num(q.max(axis=0), nan=0)).astype(int) + 3
    (left, top), (right, bottom) = low.clip(0), np.minimum(high, camera.size)
    if right <= left or bottom <= top:
        return
    window, part = camera.crop(left, top, (right - left, bottom - top)), picture[top:bottom, left:right]
    plate = MarkSheet((mark,), np.zeros((1, 2)))
    on_black, on_white = _sharp(plate, window, pose, levels, margin, grounds=(0.0, 1.0))
    part[...] = on_black + (on_white - on_black) * part


def _sharp(
    pattern: Printed,
    camera: Camera,
    camera_from_board: Rigid,
    levels: tuple[float, float],
    margin_mm: float | None,
    *,
    grounds: tuple[float, ...],
) -> list[Array]:
    """Return the picture (H, W) before each of some grounds; levels: of paper and ink."""
    corners = _hit(camera, camera_from_board, _pixel_corners(camera))
    place = _hit(camera, camera_from_board, camera.pixel_grid())
    left, top, right, bottom = pattern.outline
    margin = pattern.cell_mm if margin_mm is None else margin_mm
    left, top, right, bottom = left - margin, top - margin, right + margin, bottom + margin

    def kind(p: Array) -> Kinds:
        x, y = p[..., 0], p[..., 1]
        sheet: Mask = np.asarray((x >= left) & (x <= right) & (y >= top) & (y <= bottom))  # not where NaN
        if not sheet.all():
            p = np.where(sheet[..., None], p, [left - 1.0, top - 1.0])
        return np.where(sheet, pattern.black(p), np.int8(_GROUND))

    of_kind = [np.array([*levels, ground]) for ground in grounds]
    middle, around = kind(place), _around(kind, corners)
    pictures = [level[middle] for level in of_kind]
    mixed = [_mixed(level, around, picture) for level, picture in zip(of_kind, pictures, strict=True)]
    any_mixed = np.logical_or.reduce(mixed)
    averages = _averaged(kind, of_kind, place[any_mixed], _slope(corners)[any_mixed])
    for picture, average, which in zip(pictures, averages, mixed, strict=True):
        picture[which] = average[which[any_mixed]]
    return pictures


def _exposed(picture: Array, blur_px: float, noise: float, rng: np.random.Generator | None) -> Picture:
    if blur_px:
        from scipy.ndimage import gaussian_filter

        picture = gaussian_filter(picture, blur_px, mode="nearest", truncate=6.0)
    if noise and rng is not None:
        picture = picture + rng.normal(0.0, noise, picture.shape)
    return np.asarray(picture, dtype=np.float32)


def _pixel_corners(camera: Camera) -> Array:
    """Return the corners of all pixels (H + 1, W + 1, 2)."""
    x, y = np.meshgrid(np.arange(camera.width + 1) - 0.5, np.arange(camera.height + 1) - 0.5)
    return np.stack([x, y], axis=-1)


def _slope(corners: Array) -> Array:
    """Return the derivative of the place on the board by q at each pixel (H, W, 2, 2), from its corners."""
    along = np.diff((corners[1:] + corners[:-1]) / 2, axis=1)
    down = np.diff((corners[:, 1:] + corners[:, :-1]) / 2, axis=0)
    return np.stack([along, down], axis=-1)


def _hit(camera: Camera, camera_from_board: Rigid, q: Array) -> Array:
    board_from_camera = camera_from_board.inv
    ray = camera.unproject(q) @ board_from_camera.rotation.T
    origin = board_from_camera.translation
    with np.errstate(all="ignore"):
        t = -origin[2] / ray[..., 2]
        return np.where((t > 0)[..., None], origin[:2] + t[..., None] * ray[..., :2], np.nan)


def _around(kind: KindAt, corners: Array) -> list[Kinds]:
    """Return the kinds (H, W) at each pixel's corners, and halfway between those."""
    level, upright = (corners[:, 1:] + corners[:, :-1]) / 2, (corners[1:] + corners[:-1]) / 2
    c, h, v = kind(corners), kind(level), kind(upright)
    return [c[:-1, :-1], c[:-1, 1:], c[1:, :-1], c[1:, 1:], h[:-1], h[1:], v[:, :-1], v[:, 1:]]


def _mixed(level: Array, around: list[Kinds], middle: Array) -> Mask:
    """Return the pixels whose middle is not as bright as all around it; level (3,): of each kind."""
    mixed = np.zeros(middle.shape, dtype=bool)
    for other in around:
        mixed |= level[other] != middle
    return mixed


def _averaged(kind: KindAt, of_kind: list[Array], place: Array, slope: Array) -> list[Array]:
    """Return the mean brightness of pixels (N,) by each of some levels of the kinds."""
    index = np.arange(_SAMPLES) + 0.5  # with the half, the points are symmetric about the pixel's centre
    within = np.column_stack([index / _SAMPLES, index * _GENERATOR % _SAMPLES / _SAMPLES]) - 0.5
    out = [np.zeros(len(place)) for _ in of_kind]
    for first in range(0, len(place), _TOGETHER):
        block = slice(first, first + _TOGETHER)
        points = place[block, None] + np.einsum("nij,sj->nsi", slope[block], within)
        seen = kind(points)
        for means, level in zip(out, of_kind, strict=True):
            means[block] = level[seen].mean(axis=1)
    return out
