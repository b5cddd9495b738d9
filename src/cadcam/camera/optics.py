"""Choosing a lens: the lens formula, field of view, depth of field, blur, and the lens that a task needs.

All of it is for the thin lens (thesis, chapter 2, EQ 2.1-2.4, and section 5.2): D is the distance from the lens (its
front principal plane) to the object in focus, c that of the sensor behind it, f the focal length, N the f-number, w the
sensor's width, W that of the field of view.

    1/D + 1/c = 1/f      W/D = w/c      W = w (D/f - 1)      f = D w/(W + w)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, degrees, inf, isfinite

from cadcam.camera.camera import Camera
from cadcam.camera.sensor_format import SensorFormat
from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_numbers, expect_positive

WAVELENGTH_UM = 0.55  # green, the middle of a monochrome sensor's range
AIRY_SIGMA = 0.42  # of wavelength times f-number: the Gaussian nearest to the Airy disc's core
_AIRY_RING = 2.44  # in the same unit: the diameter of the Airy disc's first dark ring
PIXEL_PX2 = 1 / 12  # second moment of a pixel's own area
_WIDEST_DEG = 170.0  # a limit for rectilinear lenses; the widest made have about 130
TELE_DEG, WIDE_DEG = 15.0, 60.0  # thesis 5.2, with its two names corrected (they are interchanged)
# focal lengths offered by makers of C-mount lenses, mm
STANDARD_MM = (3.5, 4.0, 5.0, 6.0, 8.0, 9.0, 12.0, 16.0, 25.0, 35.0, 50.0, 75.0, 100.0)


@dataclass(frozen=True, slots=True)
class Optics:
    """A lens of focal_mm on a sensor, focused at distance_mm; f_number where depth of field or exposure matter.

    image_circle_mm: the diameter of the lens' image circle; a sensor with a longer diagonal is refused.
    """

    sensor: SensorFormat
    focal_mm: float
    distance_mm: float
    f_number: float | None = None
    image_circle_mm: float | None = None

    def __post_init__(self) -> None:
        expect(self.sensor, "sensor", SensorFormat)
        expect_numbers(self)
        _positive("focal length", self.focal_mm, "mm")
        self._refuse_impossibly_wide()
        if not self.distance_mm > self.focal_mm:
            raise BadValue(
                "distance",
                f"{self.distance_mm:g} mm",
                f"more than the focal length of {self.focal_mm:g} mm: nothing nearer has a real picture",
            )
        if self.f_number is not None:
            _positive("f-number", self.f_number, "such as 8: focal length by diameter")
        if self.image_circle_mm is not None and not self.image_circle_mm >= self.sensor.diagonal_mm:
            raise BadValue(
                "the lens' image circle",
                f"{self.image_circle_mm:g} mm",
                f"at least the diagonal of the sensor ({self.sensor.name}), {self.sensor.diagonal_mm:.4g} mm: its "
                "corners would be dark; take a lens for a larger format or a smaller sensor",
            )

    def _refuse_impossibly_wide(self) -> None:
        """Refuse a focal length that is not a plausible length in mm."""
        across = viewing_angle_deg(self.sensor.size_mm[0], self.focal_mm)
        if across > _WIDEST_DEG:
            raise BadValue(
                "focal length",
                f"{self.focal_mm:g} mm, which would look over {across:.1f} degrees of width",
                f"mm: {self.focal_mm:g} m are {1000 * self.focal_mm:g} mm",
            )

    @property
    def camera_constant_mm(self) -> float:
        """Return c = f D/(D - f) (EQ 2.2): the distance of the sensor at which the object distance D is in focus."""
        if not isfinite(self.distance_mm):
            return self.focal_mm
        return self.focal_mm * self.distance_mm / (self.distance_mm - self.focal_mm)

    @property
    def magnification(self) -> float:
        """Return m = c/D = w/W."""
        return self.camera_constant_mm / self.distance_mm

    @property
    def field_mm(self) -> tuple[float, float]:
        """Return width and height of the field of view at the distance: W = w (D/f - 1) (EQ 2.3)."""
        times = self.distance_mm / self.focal_mm - 1
        return self.sensor.size_mm[0] * times, self.sensor.size_mm[1] * times

    @property
    def mm_per_pixel(self) -> tuple[float, float]:
        """Return the size of a pixel on the object, across and down; infinite at an infinite distance."""
        across, down = self.sensor.pitch_mm
        times = self.distance_mm / self.camera_constant_mm
        return across * times, down * times

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Return the viewing angles across, down and over the diagonal, 2 atan(w/(2 c)), in degrees."""
        c, (width, height) = self.camera_constant_mm, self.sensor.size_mm
        across, down, diagonal = (viewing_angle_deg(side, c) for side in (width, height, self.sensor.diagonal_mm))
        return across, down, diagonal

    @property
    def lens_class(self) -> str:
        """Return "tele" below 15 degrees across, "wide angle" above 60, else "normal"."""
        return lens_class(self.angles_deg[0])

    @property
    def aperture_mm(self) -> float:
        """Return the diameter of the lens' aperture, f/N."""
        return self.focal_mm / self._f_number

    def depth_of_field(self, blur_mm: float | None = None) -> tuple[float, float]:
        """Return the nearest and farthest distance, mm, whose blur stays within a diameter on the sensor.

        blur_mm: by default the width of a pixel. With the hyperfocal distance H: near = D (H - f)/(H + D - 2f), far =
        D (H - f)/(H - D), infinite from D = H on (Merklinger, "The INs and OUTs of Focus"; the usual tables).
        """
        H, D, f = self.hyperfocal_mm(blur_mm), self.distance_mm, self.focal_mm
        if not isfinite(D):
            return H - f, inf
        return D * (H - f) / (H + D - 2 * f), D * (H - f) / (H - D) if D < H else inf

    def hyperfocal_mm(self, blur_mm: float | None = None) -> float:
        """Return H = f^2/(N b) + f: focused there, all from H/2 to infinity blurs by b = blur_mm at most."""
        b = self.sensor.pitch_mm[0] if blur_mm is None else blur_mm
        _positive("blur", b, "mm")
        return self.focal_mm**2 / (self._f_number * b) + self.focal_mm

    def defocus_px(self, z_mm: float) -> float:
        """Return the diameter in px of the blur disc of a point at distance z: (f/N) c |1/D - 1/z|."""
        _positive("distance of the point", z_mm, "mm")
        blur_mm = self.aperture_mm * self.camera_constant_mm * abs(1 / self.distance_mm - 1 / z_mm)
        return blur_mm / self.sensor.pitch_mm[0]

    def diffraction_px(self, wavelength_um: float = WAVELENGTH_UM) -> float:
        """Return the diameter in px of the Airy disc to its first dark ring, 2.44 lambda N (1 + m)."""
        return _AIRY_RING * self._diffraction_px(wavelength_um)

    def airy_sigma_px(self, wavelength_um: float = WAVELENGTH_UM) -> float:
        """Return the sigma in px of the Gaussian nearest to the Airy disc's core, 0.42 lambda N (1 + m)."""
        return AIRY_SIGMA * self._diffraction_px(wavelength_um)

    def motion_px(self, speed_mm_s: float, exposure_s: float) -> float:
        """Return the motion blur in px of an object moving across the view at the distance: v t m over the pitch."""
        if not (isfinite(speed_mm_s) and speed_mm_s >= 0):
            raise BadValue("speed", f"{speed_mm_s} mm/s", "a number of at least 0")
        _positive("exposure", exposure_s, "s, such as 1/125")
        return speed_mm_s * exposure_s / self.mm_per_pixel[0]

    def longest_exposure_s(self, speed_mm_s: float, blur_px: float) -> float:
        """Return the exposure at which the motion blur is blur_px; infinite for a still object."""
        _positive("blur", blur_px, "px")
        smeared = self.motion_px(speed_mm_s, 1.0)
        return blur_px / smeared if smeared else inf

    def camera(self) -> Camera:
        """Return the ideal camera with these optics: focal lengths c over the pixel pitch, central principal point."""
        pitch = self.sensor.pitch_mm
        assert self.sensor.pixels is not None  # pitch_mm has checked it
        c = self.camera_constant_mm
        return Camera.from_focal(self.sensor.pixels, c / pitch[0], fy=c / pitch[1])

    def _diffraction_px(self, wavelength_um: float) -> float:
        """Return wavelength times effective f-number, lambda N (1 + m), in px."""
        _positive("wavelength", wavelength_um, "um")
        return wavelength_um / 1000 * self._f_number * (1 + self.magnification) / self.sensor.pitch_mm[0]

    @property
    def _f_number(self) -> float:
        if self.f_number is None:
            raise BadValue("f-number", "not given", "one: it decides depth of field, blur and light")
        return self.f_number


def solve_optics(
    sensor: SensorFormat,
    *,
    focal_mm: float | None = None,
    distance_mm: float | None = None,
    width_mm: float | None = None,
    f_number: float | None = None,
    image_circle_mm: float | None = None,
) -> Optics:
    """Return the optics from two of focal length, distance and width of the field; EQ 2.3 gives the third.

    Raises `BadValue` for another number of them, and for values impossible for a lens.
    """
    expect(sensor, "sensor", SensorFormat)
    given = {"focal_mm": focal_mm, "distance_mm": distance_mm, "width_mm": width_mm}
    known = [name for name, value in given.items() if value is not None]
    if len(known) != 2:
        raise BadValue("what is known", ", ".join(known) or "nothing", "two of focal_mm, distance_mm, width_mm")
    for name in known:
        _positive(name, given[name], "mm")
    w = sensor.size_mm[0]
    if focal_mm is None:
        assert distance_mm is not None
        assert width_mm is not None
        focal_mm = distance_mm * w / (width_mm + w)
    if distance_mm is None:
        assert width_mm is not None
        distance_mm = focal_mm * (width_mm / w + 1)
    return Optics(sensor, focal_mm, distance_mm, f_number, image_circle_mm)


def standard_lenses(optics: Optics) -> tuple[Optics, ...]:
    """Return the next shorter and the next longer lens on the market, at the same distance; one if it is exact.

    The shorter sees more than the field, the longer has finer pixels and misses part of it.
    """
    f = optics.focal_mm
    shorter = [s for s in STANDARD_MM if s <= f * (1 + 1e-9)][-1:]
    longer = [s for s in STANDARD_MM if s > f * (1 + 1e-9)][:1]
    chosen = shorter if shorter and abs(shorter[0] - f) <= 1e-9 * f else shorter + longer
    return tuple(
        Optics(optics.sensor, s, optics.distance_mm, optics.f_number) for s in chosen if s < optics.distance_mm
    )


def viewing_angle_deg(side_mm: float, camera_constant_mm: float) -> float:
    """Return alpha = 2 atan(l/(2 c)) in degrees (thesis 5.2)."""
    _positive("side of the sensor", side_mm, "mm")
    _positive("camera constant", camera_constant_mm, "mm")
    return degrees(2 * atan(side_mm / (2 * camera_constant_mm)))


def lens_class(angle_deg: float) -> str:
    """Return the name for a lens with this viewing angle: the thesis (5.2) has the two outer names interchanged."""
    if angle_deg < TELE_DEG:
        return "tele"
    return "wide angle" if angle_deg > WIDE_DEG else "normal"


def _positive(what: str, value: object, unit: str) -> None:
    expect_positive(value, what, f"a positive number, {unit}")
