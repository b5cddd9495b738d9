"""The field-of-view model (FOV) of Devernay and Faugeras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.lens.axial import AxialLens
from cadcam.errors import BadValue


@dataclass(frozen=True, repr=False)
class FieldOfView(AxialLens):
    """|m| = arctan(2 tan(t) tan(w/2)) / w for the angle t off the axis; w in rad, 0 is the ideal lens.

    Source: Devernay and Faugeras, "Straight lines have to be straight" (2001), EQ 13.
    """

    w: float = 0.0

    name: ClassVar[str] = "field-of-view"
    start: ClassVar[Mapping[str, float]] = {"w": 0.5}

    def __post_init__(self) -> None:
        super().__post_init__()
        if not abs(self.w) < np.pi:
            raise BadValue("lens coefficient w", self.w, "less than pi, rad; its sign means nothing")

    @property
    def max_angle(self) -> float:
        """Return pi/2: the curve is monotonic."""
        return np.pi / 2

    def _curve(self, t: Array) -> tuple[Array, Array]:
        s, c = np.sin(t), np.cos(t)
        if not self.w:
            return s / c, 1 / (c * c)
        a = 2 * np.tan(self.w / 2)
        return np.arctan2(a * s, c) / self.w, a / self.w / (c * c + (a * s) ** 2)

    def _coefficient_slopes(self, t: Array) -> Array:
        if not self.w:  # the curve is even in w
            return np.zeros((*t.shape, 1))
        s, c = np.sin(t), np.cos(t)
        a, da = 2 * np.tan(self.w / 2), 1 / np.cos(self.w / 2) ** 2
        angle = np.arctan2(a * s, c)
        return np.asarray(((da * s * c / (c * c + (a * s) ** 2) - angle / self.w) / self.w)[..., None])
