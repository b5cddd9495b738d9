"""Optics as tables, JSON and the lens-selection diagram (thesis, Fig 5-3)."""

from __future__ import annotations

import os
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from cadcam.camera.optics import Optics
from cadcam.camera.sensor_format import CHIPS, FORMATS, SensorFormat
from cadcam.files.jsontext import or_null
from cadcam.report.figures import BLUE, INK, ORANGE, figure, write_figure
from cadcam.report.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FARTHEST_MM = 20000.0
_DRAWN_MM = (4.0, 6.0, 8.0, 12.0, 16.0, 25.0, 35.0, 50.0, 75.0, 100.0)


def lens_table(optics: Optics) -> Table:
    """Return the field of view of the optics, and with an f-number and pixels their sharpness."""
    width, height = optics.field_mm
    across, down, diagonal = optics.angles_deg
    sensor = optics.sensor
    rows = [
        ("sensor", f"{sensor.name}: {sensor.size_mm[0]:.4g} x {sensor.size_mm[1]:.4g} mm"),
        ("focal length", f"{optics.focal_mm:.4g} mm"),
        ("distance", f"{optics.distance_mm:.5g} mm"),
        ("field of view", f"{width:.5g} x {height:.5g} mm = {width * height / 1e6:.3g} m^2"),
        ("viewing angle", f"{across:.4g} x {down:.4g} deg, diagonal {diagonal:.4g} deg: {optics.lens_class}"),
        ("camera constant", f"{optics.camera_constant_mm:.5g} mm"),
    ]
    if sensor.pixels is not None:
        mm = optics.mm_per_pixel
        rows.append(("pixel on the object", f"{mm[0]:.4g} x {mm[1]:.4g} mm"))
    if optics.f_number is not None:
        rows.append(("opening", f"f/{optics.f_number:g}, {optics.aperture_mm:.3g} mm wide"))
        if sensor.pixels is None:
            rows.append(("sharp to a pixel", "not known without the sensor's pixels"))
        else:
            near, far = optics.depth_of_field()
            rows.append(("sharp to a pixel", f"from {near:.5g} mm to {_distance(far)}"))
            rows.append(("diffraction", f"Airy disc of {optics.diffraction_px():.3g} px"))
    return Table(
        f"{optics.focal_mm:.4g} mm lens at {optics.distance_mm:.5g} mm",
        ("what", "value"),
        tuple(rows),
        left=("what", "value"),
    )


def lens_as_json(optics: Optics) -> dict[str, Any]:
    """Return the same numbers; infinity as null."""
    sensor = optics.sensor
    out: dict[str, Any] = {
        "sensor": sensor.name,
        "sensor_mm": list(sensor.size_mm),
        "focal_mm": optics.focal_mm,
        "distance_mm": optics.distance_mm,
        "field_mm": list(optics.field_mm),
        "angles_deg": list(optics.angles_deg),
        "lens_class": optics.lens_class,
        "camera_constant_mm": optics.camera_constant_mm,
    }
    if sensor.pixels is not None:
        out["pixels"], out["mm_per_pixel"] = list(sensor.pixels), list(optics.mm_per_pixel)
    if optics.f_number is not None:
        out["f_number"] = optics.f_number
        if sensor.pixels is not None:
            near, far = optics.depth_of_field()
            out["sharp_mm"], out["airy_disc_px"] = [near, or_null(far)], optics.diffraction_px()
    return out


def formats_table() -> Table:
    """Return the table of sensors known by name."""
    rows = []
    for sensor in _known_sensors():
        size, used = sensor.size_mm, sensor.effective().size_mm
        pixels = "" if sensor.pixels is None else f"{sensor.pixels[0]} x {sensor.pixels[1]}"
        rows.append(
            (
                sensor.name,
                f"{size[0]:.2f} x {size[1]:.2f}",
                f"{sensor.diagonal_mm:.2f}",
                f"{used[0]:.2f} x {used[1]:.2f}",
                pixels,
            )
        )
    return Table("sensors", ("name", "size mm", "diagonal mm", "nine tenths mm", "pixels"), tuple(rows), left=("name",))


def formats_as_json() -> dict[str, Any]:
    """Return the sensors known by name: mm, pixels null where the name does not determine them."""
    return {
        "sensors": [
            {
                "name": sensor.name,
                "sensor_mm": list(sensor.size_mm),
                "nine_tenths_mm": list(sensor.effective().size_mm),
                "pixels": None if sensor.pixels is None else list(sensor.pixels),
            }
            for sensor in _known_sensors()
        ]
    }


def _known_sensors() -> tuple[SensorFormat, ...]:
    return (*FORMATS.values(), *CHIPS.values())


def write_lens_diagram(path: str | os.PathLike[str], sensor: SensorFormat, *, chosen: Optics | None = None) -> None:
    """Draw the dissertation's Fig 5-3 for a sensor: width of the field over the distance, a line for each focal length.

    `chosen` is marked; lines end at 20 m, or beyond the chosen one. Raises `MissingExtra` without matplotlib.
    """
    farthest = max(_FARTHEST_MM, 1.2 * chosen.distance_mm if chosen else 0.0)
    with figure(7.2, 5.0) as drawn:
        axes = drawn.subplots()
        for focal in _DRAWN_MM:
            _draw_line(axes, sensor.size_mm[0], focal, farthest)
        if chosen is not None:
            _mark(axes, chosen)
        axes.set(xscale="log", yscale="log", xlabel="distance, m", ylabel="width of the field, m")
        size = sensor.size_mm
        axes.set_title(f"focal length in mm, sensor {sensor.name} ({size[0]:.4g} x {size[1]:.4g} mm)", color=INK)
        axes.grid(True, which="both", lw=0.3, alpha=0.6)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.margins(x=0)
        write_figure(path, drawn)


def _draw_line(axes: Axes, sensor_width_mm: float, focal_mm: float, farthest_mm: float) -> None:
    """Draw a lens' field of view over the distance, from one and a half focal lengths on, named at the end."""
    distance = np.geomspace(200.0, farthest_mm, 60)
    distance = distance[distance > 1.5 * focal_mm]
    axes.plot(distance / 1000, sensor_width_mm * (distance / focal_mm - 1) / 1000, color=BLUE, lw=1.1)
    axes.annotate(
        f"{focal_mm:g}",
        (farthest_mm / 1000, sensor_width_mm * (farthest_mm / focal_mm - 1) / 1000),
        xytext=(3, 0),
        textcoords="offset points",
        va="center",
        fontsize=8,
        color=BLUE,
    )


def _mark(axes: Axes, chosen: Optics) -> None:
    """Mark a lens at its distance and field, both labelled."""
    at = chosen.distance_mm / 1000, chosen.field_mm[0] / 1000
    axes.plot(*at, "o", color=ORANGE, ms=7)
    axes.annotate(
        f"{chosen.focal_mm:.3g} mm: {at[1]:.3g} m at {at[0]:.3g} m",
        at,
        xytext=(8, -12),
        textcoords="offset points",
        color=ORANGE,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )


def _distance(mm: float) -> str:
    return f"{mm:.5g} mm" if isfinite(mm) else "infinity"
