"""The station's marks in its pictures: a whole plate in the order of its plan, or the single mark of daily work.

Large marks are searched for in a reduced picture: this costs no accuracy that a station could notice (0.02 px), and a
picture takes a tenth of the time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cadcam.arrays import Array, Brief, Ids, Picture, frozen
from cadcam.errors import BadValue, DegenerateGeometry, TooFewMarks
from cadcam.station.plate import Plate

if TYPE_CHECKING:
    from cadcam.camera.camera import Camera
    from cadcam.target.marks.find import FoundMark
    from cadcam.target.marks.mark import Mark

_ENOUGH = 12.0  # px: radius of a mark in the picture that it is searched for in
_FEWEST = 4
_LONGEST = 1.5  # largest stretch of a plate seen nearly head-on, for pixels that are not quite square
_ORDER_PX = 0.3  # px: residual of a plate's marks due to noise and lens
_TWO_PLATES = 0.6  # share of the plate's marks that, found a second time, make a second plate


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlatePicture(Brief):
    """Pixels q (K, 2) of the plate's marks in its order, NaN where one was not found, and covariances (K, 2, 2) px^2.

    radius_px: of a mark's outermost border, the mean of both axes. false: how many detections are not marks of the
    plate.
    """

    q: Array
    covariance: Array
    radius_px: float
    false: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen(self.q, "pixels of the plate", (None, 2), finite=False))
        object.__setattr__(self, "covariance", frozen(self.covariance, "covariances", (None, 2, 2), finite=False))

    @property
    def sigma_px(self) -> float:
        """Return the typical noise of one pixel coordinate, the median over the marks."""
        return float(np.sqrt(np.nanmedian(np.einsum("kii->k", self.covariance)) / 2))


@dataclass(frozen=True, slots=True)
class MarkLook:
    """The marks' appearance: their pattern, and their radius in the picture, px, or its range; None: any."""

    mark: Mark
    radius_px: float | tuple[float, float] | None = None


def find_plate(gray: Picture, plate: Plate, look: MarkLook, *, lens: Camera | None = None) -> PlatePicture:
    """Return where a picture (H, W) shows the plate's marks. lens: the camera, whose distortion is modelled.

    Raises `TooFewMarks` below four, `NoOrder` where the marks are not those of this plate, `DegenerateGeometry` for two
    plates in view or an ambiguous order, `BadValue` for overexposed marks.
    """
    found = _found(gray, look, lens)
    if len(found) < _FEWEST:
        raise TooFewMarks(str(look.mark), len(found), len(plate.marks))
    _refuse_saturated(found)
    q = np.stack([one.pixel for one in found])
    mark_of = _only_order(plate, q if lens is None else lens.undistorted(q))
    ordered = np.flatnonzero(mark_of >= 0)
    pixels, covariance = np.full((len(plate.marks), 2), np.nan), np.full((len(plate.marks), 2, 2), np.nan)
    for i in ordered:
        pixels[mark_of[i]], covariance[mark_of[i]] = q[i], found[i].covariance
    area = [abs(float(np.linalg.det(found[i].image_from_mark))) for i in ordered]
    size = look.mark.radius * float(np.sqrt(np.median(area)))
    return PlatePicture(pixels, covariance, size, len(found) - len(ordered))


def _only_order(plate: Plate, straight: Array) -> Ids:
    """Return which of the plate's marks each undistorted detection (N, 2) px is; -1 for none of them.

    Raises `DegenerateGeometry` where so many detections are left over that there are two plates, and unless exactly one
    order fits with the camera looking straight at the plate.
    """
    from cadcam.target.order.ordering import order_marks

    order = order_marks(straight, plate.marks, side="mirrored", sigma_px=_ORDER_PX)
    orders = [one for one in (order.plan_index, *order.alternatives) if _long_by_wide(plate, straight, one) < _LONGEST]
    mark_of = orders[0] if orders else order.plan_index
    over = int((mark_of < 0).sum())
    if over >= max(_FEWEST, _TWO_PLATES * len(plate.marks)):
        raise DegenerateGeometry(
            f"two plates in view, it seems: {len(straight)} marks are found, {over} more than belong to one "
            f"plate of {len(plate.marks)}; cover one of them"
        )
    if len(orders) != 1:
        raise DegenerateGeometry(
            f"which mark is which cannot be told from the {len(order)} found of {len(plate.marks)}: "
            + ("another order fits as well" if orders else "seen straight on, no order fits")
        )
    return mark_of


def _long_by_wide(plate: Plate, q: Array, index: Ids) -> float:
    """Return the plate's stretch in one direction relative to the other if this were the marks' order."""
    known = index >= 0
    p = plate.marks[index[known]]
    linear = np.linalg.lstsq(p - p.mean(axis=0), q[known] - q[known].mean(axis=0), rcond=None)[0]
    s = np.linalg.svd(linear, compute_uv=False)
    return float(s[0] / s[1]) if s[1] > 0 else np.inf


def find_mark(gray: Picture, look: MarkLook, *, lens: Camera | None = None) -> tuple[Array, Array]:
    """Return pixel (2,) and covariance (2, 2) px^2 of the one mark in a picture (H, W). lens: as in `find_plate`.

    Raises `TooFewMarks` for none, `BadValue` for several, or for an overexposed one.
    """
    found = _found(gray, look, lens)
    if not found:
        raise TooFewMarks(str(look.mark), 0, 1)
    if len(found) > 1:
        places = ", ".join(f"({one.pixel[0]:.0f}, {one.pixel[1]:.0f})" for one in found[:4])
        raise BadValue("number of marks in the picture", f"{len(found)}, at {places}", "one: cover the others")
    _refuse_saturated(found)
    return found[0].pixel, found[0].covariance


def _found(gray: Picture, look: MarkLook, lens: Camera | None) -> list[FoundMark]:
    from cadcam.target.marks.find import find_marks

    radius = look.radius_px
    by = 1 if radius is None else max(1, int(np.min(radius) / _ENOUGH))
    if radius is None or by == 1:
        return find_marks(gray, look.mark, radius_px=radius, camera=lens)
    sought = (radius[0] / by, radius[1] / by) if isinstance(radius, tuple) else radius / by
    reduced = _reduced(gray, by)
    camera = None if lens is None else _camera_of(reduced, lens, by)
    found = find_marks(reduced, look.mark, radius_px=sought, camera=camera)
    return [
        replace(
            f,
            pixel=f.pixel * by + (by - 1) / 2,
            covariance=f.covariance * by**2,
            image_from_mark=f.image_from_mark * by,
        )
        for f in found
    ]


def _reduced(gray: Picture, by: int) -> Picture:
    """Return the picture reduced by averaging blocks of `by` x `by` pixels."""
    height, width = (n // by for n in gray.shape)
    if min(height, width) == 0:
        raise BadValue(
            "picture", f"of {gray.shape[1]} x {gray.shape[0]} px", f"one that holds a mark of {by * _ENOUGH:.0f} px"
        )
    out = np.zeros((height, width), dtype=np.float32)
    for dy in range(by):
        for dx in range(by):
            out += gray[dy : height * by : by, dx : width * by : by]
    return np.asarray(out / np.float32(by * by))


def _camera_of(reduced: Picture, camera: Camera, by: int) -> Camera:
    """Return the camera of a reduced picture, from which incomplete blocks are cut off."""
    height, width = reduced.shape
    return camera.crop(0, 0, (width * by, height * by)).resize((width, height))


def _refuse_saturated(found: list[FoundMark]) -> None:
    burnt = [one for one in found if "saturated" in one.flags]
    if burnt:
        x, y = burnt[0].pixel
        raise BadValue(
            f"{len(burnt)} of {len(found)} marks",
            f"burnt out or black (saturated), the first at ({x:.0f}, {y:.0f})",
            "grey values between black and white: shorten the exposure or dim the light",
        )
