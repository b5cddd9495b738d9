"""The only access to OpenCV: names it when it is missing and hides the differences between its versions 4 and 5.

OpenCV's pixel (0, 0) is the centre of the top-left pixel, as ours; corners come as (N, 1, 2) from version 4 and as
(N, 2) from version 5.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask, Picture
from cadcam.errors import MissingExtra, UnknownName

_OLDEST = (4, 7)  # the first with CharucoDetector and legacy boards


def opencv(what: str) -> Any:
    """Return the module cv2; raise `MissingExtra`, naming `what` needs it, where it is missing or too old."""
    try:
        import cv2
    except ImportError:
        raise MissingExtra(what, "boards", "opencv-python-headless") from None
    version = tuple(int(part) for part in cv2.__version__.split(".")[:2])
    if version < _OLDEST:
        raise MissingExtra(
            f"{what} (OpenCV is {cv2.__version__} here, 4.7 is the oldest that will do)",
            "boards",
            "opencv-python-headless",
        )
    return cv2


def has_opencv() -> bool:
    """Return whether OpenCV is installed in a version that is recent enough."""
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
    """Return a grey picture as OpenCV's detectors expect it: 8 bits, its darkest 0.1 % black, its lightest white."""
    low, high = np.percentile(gray, [0.1, 99.9])
    span = max(float(high - low), 1e-6)
    return np.asarray(np.clip((gray - low) * (255 / span) + 0.5, 0, 255).astype(np.uint8))


def pixels(corners: Any) -> Array:
    """Return corners in any of OpenCV's shapes as (N, 2)."""
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def chessboard_candidates(gray: Picture, columns: int, rows: int) -> Iterator[tuple[str, Array]]:
    """Yield the name of each of OpenCV's chessboard finders that succeeds, and its corners (N, 2) row by row."""
    cv2 = opencv("OpenCV's chessboard finders")
    picture = as_bytes(gray)
    thorough = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(picture, (columns, rows), flags=thorough)
    if found:
        yield "cv2.findChessboardCornersSB", pixels(corners)
    usual = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(picture, (columns, rows), flags=usual)
    if found:
        yield "cv2.findChessboardCorners", pixels(corners)


def circle_candidates(gray: Picture, columns: int, rows: int, *, staggered: bool) -> Iterator[tuple[str, bool, Array]]:
    """Yield name, whether the discs are light, and centres (N, 2) of OpenCV's circle grid finder where it succeeds."""
    cv2 = opencv("OpenCV's circle grid finder")
    grid = cv2.CALIB_CB_ASYMMETRIC_GRID if staggered else cv2.CALIB_CB_SYMMETRIC_GRID
    for light in (False, True):
        picture = as_bytes(1 - gray if light else gray)
        for extra, name in ((0, ""), (cv2.CALIB_CB_CLUSTERING, " with clustering")):
            found, centres = cv2.findCirclesGrid(picture, (columns, rows), flags=grid | extra)
            if found:
                yield f"cv2.findCirclesGrid{name}", light, pixels(centres)


def find_markers(gray: Picture, name: str, *, thorough: bool = True) -> tuple[Ids, Array]:
    """Return numbers (M,) and corners (M, 4, 2) px of a dictionary's markers in a picture.

    Corners run clockwise from the marker's upper left. Each number is reported once, for its largest marker. thorough:
    small and badly lit markers too.
    """
    cv2 = opencv("a ChArUco board")
    parameters = cv2.aruco.DetectorParameters()
    if thorough:
        parameters.adaptiveThreshWinSizeMax = 53
        parameters.minMarkerPerimeterRate = 0.01
    detector = cv2.aruco.ArucoDetector(dictionary(name), parameters)
    corners, numbers, _ = detector.detectMarkers(as_bytes(gray))
    if numbers is None or not len(numbers):
        return np.zeros(0, dtype=np.int32), np.zeros((0, 4, 2))
    q = np.array([pixels(c) for c in corners])
    number = np.asarray(numbers, dtype=np.int32).ravel()
    order = np.argsort(-np.abs(areas(q)), kind="stable")
    _, first = np.unique(number[order], return_index=True)
    return number[order][first], q[order][first]


def areas(q: Array) -> Array:
    """Return the signed areas (M,) px^2 of quadrangles (M, 4, 2)."""
    x, y = q[..., 0], q[..., 1]
    return np.asarray(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1) / 2)
