"""What photos a result was measured in, and how they were read."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from cadcam.image.picture import PictureInfo


def photos_as_json(read: Iterable[PictureInfo]) -> list[dict[str, Any]]:
    """Return of each photo file, hash, EXIF orientation, the value taken as white and, if it fills some, how many bits.

    Of photos of 10, 12 or 14 bits in 16 the white is found or stated (`image.camera_picture`): with another one the
    same file gives another picture.
    """
    return [
        {
            "path": one.path,
            "sha256": one.sha256,
            "orientation": one.orientation,
            "white": one.white,
            "bits": one.used_bits,
        }
        for one in read
    ]
