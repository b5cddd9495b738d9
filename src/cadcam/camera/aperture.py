"""The aperture of a thin lens: its diameter and focus distance. With a camera, it determines all blur.

A point of the aperture at (u, v) from its centre images the scene as a pinhole there would, on a sensor shifted so that
what lies at the focus distance D keeps its place. The image of a point at depth z is shifted by

    dq = K (u, v) (1/D - 1/z),

so the whole aperture of diameter A spreads it to a disc of diameter A f |1/D - 1/z| px with the camera's f in px (thin
lens; Potmesil and Chakravarty, "A lens and aperture camera model", 1981).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np

from cadcam.arrays import Array, Floats
from cadcam.camera.camera import Camera
from cadcam.camera.optics import AIRY_SIGMA, WAVELENGTH_UM, Optics
from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_number


@dataclass(frozen=True, slots=True)
class Aperture:
    """A round aperture of diameter_mm, of a lens focused at focus_mm (z-depth from the lens; inf: far away)."""

    diameter_mm: float
    focus_mm: float

    def __post_init__(self) -> None:
        expect_number(self.diameter_mm, "diameter of the aperture")
        expect_number(self.focus_mm, "focus distance")
        if not (isfinite(self.diameter_mm) and self.diameter_mm > 0):
            raise BadValue("diameter of the aperture", f"{self.diameter_mm:g} mm", "a positive number of mm")
        if not self.focus_mm > 0:
            raise BadValue("focus distance", f"{self.focus_mm:g} mm", "a positive number of mm, from the lens")

    @classmethod
    def of(cls, optics: Optics) -> Aperture:
        """Return the aperture at the f-number of some optics at their distance; `BadValue` without an f-number."""
        expect(optics, "optics", Optics)
        return cls(optics.aperture_mm, optics.distance_mm)

    def defocus_px(self, camera: Camera, z_mm: Floats) -> Array:
        """Return the diameter along x, in px, of the blur discs of points at depths z_mm (...)."""
        z = np.asarray(z_mm, dtype=np.float64)
        return np.asarray(self.diameter_mm * camera.fx * np.abs(1 / self.focus_mm - 1 / z))

    def diffraction_px(self, camera: Camera, wavelength_um: float = WAVELENGTH_UM) -> float:
        """Return the sigma in px of the Gaussian like the Airy disc's core: 0.42 lambda N (1 + m) = 0.42 lambda f/A."""
        return AIRY_SIGMA * wavelength_um / 1000 * camera.fx / self.diameter_mm
