"""Sizes of sensors: the classic formats in inches, and common machine-vision chips by name.

An inch format names the outer diameter of a camera tube with a picture of that size; the picture's diagonal is about
two thirds of it. The thesis uses nine tenths of the size (section 5.1), `effective`; today's chips use all of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

from cadcam.errors import BadValue, UnknownName
from cadcam.kinds import expect, expect_numbers

EFFECTIVE = 0.9  # thesis 5.1


@dataclass(frozen=True, slots=True)
class SensorFormat:
    """A sensor's active area: size (width, height) in mm, and its pixels (columns, rows) where they are known."""

    name: str
    size_mm: tuple[float, float]
    pixels: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        expect_numbers(self)
        if not all(0 < side < 1000 for side in self.size_mm):
            raise BadValue(f"size of sensor {self.name}", f"{self.size_mm} mm", "two positive numbers, mm")
        if self.pixels is not None and not all(n == int(n) and n > 0 for n in self.pixels):
            raise BadValue(f"pixels of sensor {self.name}", self.pixels, "two positive whole numbers")

    @property
    def diagonal_mm(self) -> float:
        """Return the diameter of the image circle that a lens must have."""
        return hypot(*self.size_mm)

    @property
    def pitch_mm(self) -> tuple[float, float]:
        """Return a pixel's width and height in mm; `BadValue` where the pixels are not known."""
        if self.pixels is None:
            raise BadValue(f"pixels of sensor {self.name}", "not known", "columns and rows")
        return self.size_mm[0] / self.pixels[0], self.size_mm[1] / self.pixels[1]

    def effective(self, share: float = EFFECTIVE) -> SensorFormat:
        """Return the part of the sensor that is used, by default nine tenths of its width and height (thesis 5.1)."""
        if not 0 < share <= 1:
            raise BadValue("share of the sensor", share, "a number above 0 and at most 1")
        width, height = self.size_mm
        return SensorFormat(f"{self.name}, {share:.0%}", (share * width, share * height), self.pixels)

    def with_pixels(self, pixels: tuple[int, int]) -> SensorFormat:
        """Return the sensor with this number of pixels (columns, rows) over its size."""
        return SensorFormat(self.name, self.size_mm, pixels)


# width x height in mm as stated by makers of lenses and cameras; CCTV formats are 4:3
FORMATS: dict[str, SensorFormat] = {
    name: SensorFormat(name, size)
    for name, size in (
        ("1/4", (3.2, 2.4)),
        ("1/3", (4.8, 3.6)),
        ("1/2.5", (5.76, 4.29)),
        ("1/2", (6.4, 4.8)),
        ("1/1.8", (7.2, 5.4)),
        ("2/3", (8.8, 6.6)),
        ("1", (12.8, 9.6)),
        ("4/3", (17.3, 13.0)),
        ("aps-c", (23.5, 15.6)),
        ("full-frame", (36.0, 24.0)),
    )
}


def _chip(name: str, columns: int, rows: int, pitch_um: float) -> SensorFormat:
    return SensorFormat(name, (columns * pitch_um / 1000, rows * pitch_um / 1000), (columns, rows))


# Effective pixels and pixel size as in the makers' lists (Sony Semiconductor Solutions, "Image sensors for industry";
# onsemi's data sheets of PYTHON and AR0134)
CHIPS: dict[str, SensorFormat] = {
    chip.name: chip
    for chip in (
        _chip("AR0134", 1280, 960, 3.75),  # 1/3 inch
        _chip("IMX287", 720, 540, 6.9),  # 1/2.9
        _chip("IMX273", 1440, 1080, 3.45),  # 1/2.9
        _chip("IMX392", 1920, 1200, 3.45),  # 1/2.3
        _chip("PYTHON1300", 1280, 1024, 4.8),  # 1/2
        _chip("IMX265", 2048, 1536, 3.45),  # 1/1.8
        _chip("IMX178", 3072, 2048, 2.4),  # 1/1.8
        _chip("IMX226", 4000, 3000, 1.85),  # 1/1.7
        _chip("IMX174", 1920, 1200, 5.86),  # 1/1.2
        _chip("IMX264", 2448, 2048, 3.45),  # 2/3
        _chip("IMX250", 2448, 2048, 3.45),  # 2/3
        _chip("IMX183", 5472, 3648, 2.4),  # 1
        _chip("IMX304", 4096, 3000, 3.45),  # 1.1
        _chip("IMX253", 4096, 3000, 3.45),  # 1.1
    )
}


def sensor_format(name: str) -> SensorFormat:
    """Return a sensor by its format ("1/2"), its chip ("IMX264"), or its size in mm ("5.94x3.96")."""
    expect(name, "sensor", str)
    key = name.strip().removesuffix('"').lower()
    known = {k.lower(): s for k, s in {**FORMATS, **CHIPS}.items()}
    if key in known:
        return known[key]
    width, cross, height = key.removesuffix("mm").partition("x")
    try:
        if cross:
            return SensorFormat(f"{width} x {height} mm", (float(width), float(height)))
    except ValueError:
        pass
    raise UnknownName("sensor", name, [*FORMATS, *CHIPS])
