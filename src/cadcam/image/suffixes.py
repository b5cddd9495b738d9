"""What picture files are called: for those who look through folders, or check a name before any work is done."""

from __future__ import annotations

import re

READABLE = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".webp")
FORMS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}  # of what can be written
WRITABLE = tuple(FORMS)


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a sort key that compares digits in names as numbers: 9.png comes before 10.png."""
    return [(int(text), "") if text.isdecimal() else (-1, text) for text in re.split(r"(\d+)", name)]
