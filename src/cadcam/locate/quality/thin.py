"""Plates that are thin in the picture: their two borders, too near to be told apart, are asked for as one line.

A photo shows a plate less than some 1.5 px thick as one step, or as a bright or dark thread; which of its borders a
step belongs to cannot be seen. So neither border has room to be measured. But that something steps there, between one
border and the other, is evidence all the same, and of large structures seen from afar it is most of what there is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.locate.lines.edges import EdgeSamples

_THIN_PX = 1.5  # between the borders of a plate: the filter that looks for steps sees them as one


@dataclass(frozen=True, slots=True, eq=False)
class Strips:
    """What samples (n,) lie on, px: the thin plate whose border they are, or a line by itself, without thickness.

    middle: how far along the normal the middle of the plate lies; half: of its thickness; room: how far from that
    middle, beyond the plate, the next line is.
    """

    middle: Array
    half: Array
    room: Array

    @classmethod
    def of(cls, samples: EdgeSamples) -> Strips:
        """Return the strips of samples, as far apart as where these were drawn."""
        to_twin = np.abs(samples.twins[:, :, 0])
        thin = to_twin <= _THIN_PX
        side = np.where(thin[:, 0] != thin[:, 1], np.where(thin[:, 1], 1.0, -1.0), 0.0)  # of one plate, not of two
        half = 0.5 * np.where(side, np.where(thin, to_twin, 0.0).sum(axis=1), 0.0)
        across = np.where(side > 0, samples.beyond[:, 1], samples.beyond[:, 0]) - half
        back = np.where(side > 0, samples.below, samples.above) + half
        alone = np.minimum(samples.below, samples.above)
        return cls(side * half, half, np.where(side, np.minimum(across, back), alone))
