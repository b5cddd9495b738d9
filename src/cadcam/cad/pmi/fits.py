"""Limits of tolerance classes that start at the nominal size, or lie evenly about it (ISO 286-1:2010)."""

from __future__ import annotations

import re

import numpy as np

_UP_TO = (3, 6, 10, 18, 30, 50, 80, 120, 180, 250, 315, 400, 500)  # mm
_FIRST = 5  # grade of the first row below
_GRADES = np.array(  # um, Table 1: a row for each grade, a column for each range of sizes
    [
        (4, 5, 6, 8, 9, 11, 13, 15, 18, 20, 23, 25, 27),
        (6, 8, 9, 11, 13, 16, 19, 22, 25, 29, 32, 36, 40),
        (10, 12, 15, 18, 21, 25, 30, 35, 40, 46, 52, 57, 63),
        (14, 18, 22, 27, 33, 39, 46, 54, 63, 72, 81, 89, 97),
        (25, 30, 36, 43, 52, 62, 74, 87, 100, 115, 130, 140, 155),
        (40, 48, 58, 70, 84, 100, 120, 140, 160, 185, 210, 230, 250),
        (60, 75, 90, 110, 130, 160, 190, 220, 250, 290, 320, 360, 400),
        (100, 120, 150, 180, 210, 250, 300, 350, 400, 460, 520, 570, 630),
        (140, 180, 220, 270, 330, 390, 460, 540, 630, 720, 810, 890, 970),
        (250, 300, 360, 430, 520, 620, 740, 870, 1000, 1150, 1300, 1400, 1550),
    ],
    float,
)


def fit_limits_mm(fit: str, nominal_mm: float) -> tuple[float, float] | None:
    """Return the limits in mm of a size with a tolerance class such as H7; None for others than these of ISO 286-1.

    Grades 5 to 14, sizes up to 500 mm.
    """
    known = re.fullmatch(r"(H|h|JS|js)(\d+)", fit)
    if known is None or not 0 < nominal_mm <= _UP_TO[-1] or not 0 <= int(known[2]) - _FIRST < len(_GRADES):
        return None
    width = float(_GRADES[int(known[2]) - _FIRST, np.searchsorted(_UP_TO, round(nominal_mm, 6))]) / 1000
    low = {"H": 0.0, "h": -width}.get(known[1], -width / 2)
    return nominal_mm + low, nominal_mm + low + width
