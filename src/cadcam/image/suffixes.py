"""What picture files are called: for those who look through folders, or check a name before any work is done."""

from __future__ import annotations

READABLE = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".webp")
FORMS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}  # of what can be written
WRITABLE = tuple(FORMS)
