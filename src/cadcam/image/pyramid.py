"""A picture at every pixel size that a search uses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Picture
from cadcam.errors import BadValue
from cadcam.image.picture import to_gray
from cadcam.native.correlate import shrunken


class Pyramid:
    """A picture and its means over blocks of pixels, computed on first use."""

    def __init__(self, gray: npt.ArrayLike) -> None:
        picture = to_gray(gray)
        if picture.ndim != 2:
            raise BadValue("picture", f"of shape {picture.shape}", "a grey picture (H, W)")
        self._levels: dict[int, Picture] = {1: np.ascontiguousarray(picture, np.float32)}

    @property
    def size(self) -> tuple[int, int]:
        """Return (width, height) in px."""
        return self._levels[1].shape[1], self._levels[1].shape[0]

    def level(self, factor: int) -> Picture:
        """Return the means over blocks of factor x factor px."""
        if factor not in self._levels:
            self._levels[factor] = shrunken(self._levels[1], factor)
        return self._levels[factor]
