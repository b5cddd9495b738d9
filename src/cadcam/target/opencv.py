"""The one door to OpenCV: its absence named, what differs between its versions 4 and 5 evened out.

OpenCV's pixel (0, 0) is the centre of the top-left pixel, as ours; corners come as (N, 1, 2) from version 4 and as
(N, 2) from version 5.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture
from cadcam.errors import MissingExtra, UnknownName

_OLDEST = (4, 7)  # the first with CharucoDetector and legacy boards


def opencv(what: str) -> Any:
    """Return the module cv2; raise `MissingExtra` naming `what` needs it where it is missing or too old."""
    try:
        import cv2
    except ImportError:
        raise MissingExtra(what, "boards", "opencv-python-headless") from None
    version = tuple(int(part) for part in cv2.__version__.split(".")[:2])
    if version < _OLDEST:
        raise MissingExtra(f"{what} (OpenCV is {cv2.__version__} here, 4.7 is the oldest that will do)", "boards",
                           "opencv-python-headless")
    return cv2


def has_opencv() -> bool:
    """Return whether OpenCV is installed, new enough."""
    try:
        opencv("this")
    except MissingExtra:
        return False
    return True


def dictionaries() -> list[str]:
    """Return the names of OpenCV's marker dictionaries, such as 5X5_100."""
    aruco = opencv("a ChArUco board").aruco
    return sorted(name.removeprefix("DICT_") for name in dir(aruco) if name.startswith("DICT_"))


def dictionary(name: str) -> Any:
    """Return a marker dictionary by name; raise `UnknownName`."""
    aruco = opencv("a ChArUco board").aruco
    number = getattr(aruco, f"DICT_{name}", None)
    if number is None:
        raise UnknownName("marker dictionary", name, dictionaries())
    return aruco.getPredefinedDictionary(number)


def marker_bits(name: str, count: int) -> Mask:
    """Return the black modules (count, n, n) of a dictionary's first markers, their black frame included."""
    markers = dictionary(name)
    have = len(markers.bytesList)
    if count > have:
        raise UnknownName("marker", f"number {count - 1}", [f"0 to {have - 1} of dictionary {name}"])
    side = markers.markerSize + 2
    return np.stack([markers.generateImageMarker(i, side) == 0 for i in range(count)])


def as_bytes(gray: Picture) -> npt.NDArray[np.uint8]:
    """Return a grey picture as OpenCV's detectors want it: 8 bits, its darkest 0.1 % black, its lightest white."""
    low, high = np.percentile(gray, [0.1, 99.9])
    span = max(float(high - low), 1e-6)
    return np.asarray(np.clip((gray - low) * (255 / span) + 0.5, 0, 255).astype(np.uint8))


def pixels(corners: Any) -> Array:
    """Return corners of any of OpenCV's shapes as (N, 2)."""
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)
