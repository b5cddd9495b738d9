"""Plates that are thin in the picture: two borders too close to be resolved are tested as one line.

A photo shows a plate less than some 1.5 px thick as a single step, or as a bright or dark thread; a step there cannot
be assigned to one of the borders. So neither border has room to be measured. But a step anywhere between the borders is
evidence all the same, and for large structures seen from afar it is most of the evidence there is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.locate.lines.edges import EdgeSamples

_THIN_PX = 1.5  # between the borders of a plate: the step filter does not resolve them


@dataclass(frozen=True, slots=True, eq=False)
class Strips:
    """What samples (n,) lie on, px: the thin plate whose border they are, or a single line, of thickness 0.

    middle: distance along the normal to the plate's middle; half: its half thickness; room: from the middle to the
    next line beyond the plate.
    """

    middle: Array
    half: Array
    room: Array

    @classmethod
    def of(cls, samples: EdgeSamples) -> Strips:
        """Return the strips of samples, with distances as at the pose where these were drawn."""
        to_twin = np.abs(samples.twins[:, :, 0])
        thin = to_twin <= _THIN_PX
        side = np.where(thin[:, 0] != thin[:, 1], np.where(thin[:, 1], 1.0, -1.0), 0.0)  # on one side alone
        half = 0.5 * np.where(side, np.where(thin, to_twin, 0.0).sum(axis=1), 0.0)
        across = np.where(side > 0, samples.beyond[:, 1], samples.beyond[:, 0]) - half
        back = np.where(side > 0, samples.below, samples.above) + half
        alone = np.minimum(samples.below, samples.above)
        return cls(side * half, half, np.where(side, np.minimum(across, back), alone))
