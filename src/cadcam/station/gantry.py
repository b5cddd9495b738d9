"""A camera on a gantry, calibrated at a grid of positions over its work area (6.4.3.4 to 6.4.3.6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints
from cadcam.kinds import expect, expect_each, expect_positive
from cadcam.station.cross_prediction import DeviationMap, deviation_map, view_covariance
from cadcam.station.field import DeviationField, fit_field
from cadcam.station.plane import PlaneCalibration

_MECHANICS_MM = 100.0  # rms deviation from which a gantry is asked whether its positions are the floor's
_AS_MOVED = 0.5  # of how far the view moves: what no gantry deviates by that goes where its controller says


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Repeatability(Brief):
    """How well the camera returns to a position: covariance (2, 2) mm^2 of the view on the floor, for one visit.

    Backlash, vibration, and whatever else differs from visit to visit. dof: its degrees of freedom, inf if stated.
    """

    covariance: Array = field(default_factory=lambda: np.zeros((2, 2)))
    dof: float = np.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", frozen(self.covariance, "repeatability", (2, 2)))

    @classmethod
    def stated(cls, sigma_x: float, sigma_y: float) -> Repeatability:
        """Return the repeatability with these standard deviations, mm."""
        for name, value in (("sigma_x", sigma_x), ("sigma_y", sigma_y)):
            expect_positive(value, f"{name} of the repeatability", "mm, from 0 on", zero=True)
        return cls(np.diag([sigma_x**2, sigma_y**2]))

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (2,) mm."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sighting(Brief):
    """A mark seen once: by which camera, at which position (2,) of its controller, at which pixel q (2,).

    name: of the mark. covariance (2, 2) px^2: of the pixel. picture: in which it was seen.
    """

    name: str
    camera: str
    position: Array
    q: Array
    covariance: Array
    picture: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", frozen(self.position, f"position of {self.name!r}", (2,)))
        object.__setattr__(self, "q", frozen(self.q, f"pixel of {self.name!r}", (2,)))
        object.__setattr__(self, "covariance", frozen(self.covariance, f"pixel covariance of {self.name!r}", (2, 2)))

    @classmethod
    def of(cls, name: str, camera: str, position: Floats, q: Floats, *, sigma_px: float, picture: str = "") -> Sighting:
        """Return a sighting whose pixel coordinates each have this standard deviation."""
        expect_positive(sigma_px, f"sigma_px of {name!r}", "a positive number of px")
        return cls(name, camera, np.asarray(position), np.asarray(q), sigma_px**2 * np.eye(2), picture)


@dataclass(frozen=True, slots=True, eq=False)
class Recalibration:
    """A mark of known place (2,) mm, seen after the calibration: its error is subtracted everywhere (6.4.3.6)."""

    sighting: Sighting
    known: Array
    sigma_mm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "known", frozen(self.known, "known place of the mark", (2,)))
        expect_positive(self.sigma_mm, "sigma_mm of the known mark", "mm, from 0 on", zero=True)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GantryCalibration(Brief):
    """All calibrated positions of a camera, and the field of its mechanics' deviation inferred from them."""

    camera: str
    positions: tuple[PlaneCalibration, ...]
    repeatability: Repeatability
    field: DeviationField
    recalibration: Recalibration | None = None

    @property
    def grid(self) -> Array:
        """Return the calibrated positions (N, 2) mm."""
        return np.stack([one.position for one in self.positions])

    @property
    def lens(self) -> Camera | None:
        """Return the camera whose distortion is removed from all pixels, None for none."""
        return self.positions[0].lens

    @property
    def sigma_px(self) -> float:
        """Return the noise of one coordinate of the pixels as found, pooled over all calibrations; inf if unknown."""
        known = [one.noise_px for one in self.positions if np.isfinite(one.noise_px)]
        return float(np.sqrt(np.mean(np.square(known)))) if known else np.inf

    def radius_px(self, radius_mm: float) -> float:
        """Return the radius in px of a circle of the floor in a picture, the mean of both axes."""
        scale = self.positions[0].scale
        return radius_mm / float(np.sqrt(scale.scale_x * scale.scale_y))

    def check_pixel(self, sighting: Sighting, *, extrapolate: bool = False) -> None:
        """Raise `BadValue` for a pixel outside of the picture, or far from where the plate's marks were seen.

        A picture's size is known only of a lens. Without it, or far from the plate in a larger picture, where errors
        grow with the square of the distance, a pixel counts as far beyond the marks by more than they extend.
        """
        x, y = sighting.q
        right, below = (np.inf, np.inf) if self.lens is None else np.array(self.lens.size) - 0.5
        what, given = f"pixel of {sighting.name!r}", f"({x:.1f}, {y:.1f})"
        if not (-0.5 <= x <= right and -0.5 <= y <= below):
            size = "" if self.lens is None else f", which is {self.lens.width} x {self.lens.height} px"
            raise BadValue(what, given, f"one in the picture{size}; (0, 0) is its top left")
        q = np.concatenate([one.pixels for one in self.positions])
        low, high = q.min(axis=0), q.max(axis=0)
        beyond = np.maximum(low - sighting.q, sighting.q - high)
        if not extrapolate and np.any(beyond > high - low):
            seen = f"x {low[0]:.0f} to {high[0]:.0f}, y {low[1]:.0f} to {high[1]:.0f} px"
            raise BadValue(what, given, f"one near those of the plate ({seen}); extrapolation has to be asked for")

    def map(self, *, reference: int | None = None) -> DeviationMap:
        """Return how the mechanics deviate at the calibrated positions (Tables 6.9 to 6.11, Fig 6-17, 6-18)."""
        return deviation_map(self.positions, reference=reference)

    def recalibrated(self, sighting: Sighting, known: Floats, *, sigma_mm: float) -> GantryCalibration:
        """Return the calibration with the error at one mark of known place (2,) mm subtracted everywhere.

        sigma_mm: of each coordinate of the known place. It replaces an earlier re-calibration.
        """
        if sighting.camera != self.camera:
            raise BadValue("camera of the sighting", repr(sighting.camera), f"{self.camera!r}, which is re-calibrated")
        return replace(self, recalibration=Recalibration(sighting, np.asarray(known, dtype=np.float64), sigma_mm))


def calibrate_gantry(
    camera: str, positions: Sequence[PlaneCalibration], *, repeatability: Repeatability | None = None
) -> GantryCalibration:
    """Return the calibration of a camera from those of its positions, one or more, no two of them the same.

    Raises `DegenerateGeometry` where the view moves over the floor quite otherwise than the positions: another unit,
    other axes.
    """
    positions = expect_each(positions, "positions", PlaneCalibration)
    expect(repeatability, "repeatability", Repeatability, optional=True)
    if not positions:
        raise TooFewPoints(f"the calibration of camera {camera!r}", 0, 1, of="positions")
    again = repeatability or Repeatability()
    grid = np.stack([one.position for one in positions])
    for i, one in enumerate(positions):
        for other in positions[:i]:
            if np.linalg.norm(one.position - other.position) < 1.0:
                raise BadValue(f"position of {one.name}", one.position.tolist(), f"another than that of {other.name}")
        if one.placement.plate is not positions[0].placement.plate:
            raise BadValue(f"plate of {one.name}", "another one", f"the plate of {positions[0].name}, at all positions")
        if one.lens is not positions[0].lens:
            raise BadValue(f"lens of {one.name}", "another one", f"the lens of {positions[0].name}, at all positions")
    deviations = deviation_map(positions).deviation if len(positions) > 1 else np.zeros((1, 2))
    _refuse_other_axes(camera, grid, deviations)
    return GantryCalibration(camera, positions, again, fit_field(grid, deviations, _noise(positions, again)))


def _refuse_other_axes(camera: str, grid: Array, deviations: Array) -> None:
    """Raise `DegenerateGeometry` where what would be mechanics is half of all motion."""
    stated = grid - grid.mean(axis=0)
    off, seen, told = (float(np.sqrt(np.mean(np.sum(a**2, axis=1)))) for a in (deviations, stated + deviations, stated))
    if off > max(_MECHANICS_MM, _AS_MOVED * seen):
        raise DegenerateGeometry(
            f"the view of camera {camera!r} moves over the floor by {seen:.0f} mm rms, its controller's positions by "
            f"{told:.4g}, and they differ by {off:.0f} mm; give the positions in mm, along the axes of the survey"
        )


def _noise(positions: Sequence[PlaneCalibration], again: Repeatability) -> Array:
    """Return the covariance (2, N, N) of the views by axis: vision, survey, and the visit of each position."""
    whole = view_covariance(positions) + np.kron(np.eye(len(positions)), again.covariance)
    return np.stack([whole[0::2, 0::2], whole[1::2, 1::2]])
