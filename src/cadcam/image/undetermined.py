"""What a match leaves open: along an edge its place, of what is round its angle, of a corner of two lines its scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.image.correlate import Peaks
from cadcam.image.template import Template

SHARE = 0.1  # of the template's smaller side: what may lie anywhere within so much is not called determined


@dataclass(frozen=True, slots=True)
class Undetermined:
    """Motions of which a peak says nothing. along: directions (dx, dy) in the picture; whether angle and scale are."""

    along: tuple[tuple[float, float], ...] = ()
    angle: bool = False
    scale: bool = False

    def __bool__(self) -> bool:
        return bool(self.along) or self.angle or self.scale


def undetermined(peaks: Peaks, template: Template) -> list[Undetermined]:
    """Return for each peak the motions that by 1 sigma move the template, or its rim, by over a tenth of its side."""
    side = min(template.size)
    return [
        Undetermined(
            _along(covariance[:2, :2], SHARE * side * scale),
            bool(np.sqrt(covariance[2, 2]) > 2 * SHARE),
            bool(np.sqrt(covariance[3, 3]) > 2 * SHARE * scale),
        )
        for covariance, scale in zip(peaks.covariance, peaks.scale, strict=True)
    ]


def _along(covariance: Array, most: float) -> tuple[tuple[float, float], ...]:
    variance, axis = np.linalg.eigh(covariance)
    directions = axis.T[np.sqrt(np.maximum(variance, 0)) > most]
    directions = directions * np.where(directions[:, :1] + 1e-9 * directions[:, 1:] < 0, -1, 1)  # rightwards, or down
    return tuple((float(x) + 0.0, float(y) + 0.0) for x, y in directions)
