"""Optics agree with tables that others printed, to their rounding.

Tables of depth of field reckon with the f-numbers that the engraved ones stand for, powers of the root of 2: 5.6 is
5.657, 11 is 11.314, 22 is 22.627. With the engraved ones more than half of these rows would not come out.
"""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from cadcam.camera.optics import Optics
from cadcam.camera.sensor_format import FORMATS, sensor_format

FOOT = 304.8
APS = FORMATS["aps-c"]

# naturelyrics.com, "Subject Distance/Near Focus/Hyperfocal Distance Chart", circle of confusion 0.02 mm: focal length,
# f-number as engraved, focused at, near limit, far limit, hyperfocal distance, in feet, as printed
DEPTHS = [
    (11, 4, 5, "2.5", inf, "5"),
    (11, 5.6, 4, "1.88", inf, "3.54"),
    (11, 8, 3, "1.37", inf, "2.52"),
    (11, 11, 2, "0.94", inf, "1.79"),
    (12, 4, 6, "2.99", inf, "5.94"),
    (12, 5.6, 5, "2.29", inf, "4.22"),
    (12, 8, 3, "1.5", inf, "2.99"),
    (12, 11, 3, "1.24", inf, "2.13"),
    (12, 8, 2, "1.2", "5.95", "2.99"),
    (12, 11, 2, "1.03", "32.8", "2.13"),
    (12, 16, 1.5, "0.75", "140.6", "1.52"),
    (12, 22, 1, "0.52", "12.5", "1.08"),
    (13, 4, 7, "3.49", inf, "6.97"),
    (13, 5.6, 5, "2.49", inf, "4.94"),
    (13, 8, 4, "1.87", inf, "3.51"),
    (13, 11, 3, "1.36", inf, "2.49"),
    (13, 11, 2, "1.11", "9.94", "2.49"),
    (13, 11, 2.5, "1.25", inf, "2.49"),
    (14, 4, 9, "4.26", inf, "8.08"),
    (14, 5.6, 7, "3.15", inf, "5.73"),
]
# eBay guide 10000000178278094, "CCTV Camera Lens Guide": horizontal angle on 1/3 inch, whole degrees, mostly cut off
CCTV_THIRD = [(2.8, 81), (3.5, 68), (4, 62), (4.8, 53), (6, 43), (8, 33), (12.5, 21), (16, 17), (17, 16)]
# Navitar, "Optical Characteristics of Video Lenses": image circle, horizontal, vertical, mm; Fujifilm, "Machine Vision
# Lenses, Technical Terms", has the same for 1/2 to 1 inch and 35 mm film
FORMAT_SIZES = [
    ("1/4", 4.0, 3.2, 2.4),
    ("1/3", 6.0, 4.8, 3.6),
    ("1/2", 8.0, 6.4, 4.8),
    ("2/3", 11.0, 8.8, 6.6),
    ("1", 16.0, 12.8, 9.6),
    ("full-frame", 43.3, 36.0, 24.0),
]


def engraved(f_number):
    return 2 ** (round(2 * np.log2(f_number)) / 2)


def assert_printed(value, text):
    """Agrees with a decimal number as far as it is printed: to half a unit of its last digit."""
    unit = 10.0 ** -len(text.partition(".")[2])
    assert abs(value - float(text)) <= 0.505 * unit, f"{value:.4f}, printed {text}"


@pytest.mark.parametrize(("focal", "f_number", "feet", "near", "far", "hyperfocal"), DEPTHS)
def test_near_far_and_hyperfocal_distances_are_those_of_a_printed_chart(focal, f_number, feet, near, far, hyperfocal):
    optics = Optics(APS, focal, feet * FOOT, engraved(f_number))
    at = optics.depth_of_field(0.02)
    assert_printed(optics.hyperfocal_mm(0.02) / FOOT, hyperfocal)
    assert_printed(at[0] / FOOT, near)
    if far == inf:
        assert at[1] == inf
    else:
        assert_printed(at[1] / FOOT, far)


@pytest.mark.parametrize(("focal", "degrees"), CCTV_THIRD)
def test_a_cctv_guide_s_angles_of_view_are_ours_in_whole_degrees(focal, degrees):
    angle = Optics(FORMATS["1/3"], focal, inf).angles_deg[0]
    assert degrees in (int(angle), round(angle))


@pytest.mark.parametrize(("name", "circle", "width", "height"), FORMAT_SIZES)
def test_formats_are_as_lens_makers_state_them(name, circle, width, height):
    sensor = sensor_format(name)
    assert sensor.size_mm == (width, height)
    assert_printed(sensor.diagonal_mm, str(circle))


def test_a_printed_example_of_the_lens_formula_without_its_one_comes_out_as_an_approximation():
    """Vico Imaging: 1/3 inch, 305 mm away, 64 mm wide: 23 mm; they leave out the 1 of W = w (D/f - 1)."""
    assert pytest.approx(23, abs=0.5) == 4.8 * 305 / 64
    exact = 305 * 4.8 / (64 + 4.8)
    assert Optics(FORMATS["1/3"], exact, 305).field_mm[0] == pytest.approx(64)
    assert exact == pytest.approx(21.3, abs=0.05)
