"""A hypothesis: a pose that the photos may show, before it is refined."""

from __future__ import annotations

from dataclasses import dataclass

from cadcam.geometry.rigid import Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A pose that the photos may show, and the evidence for it.

    score: mean edge certainty under the visible lines minus that under lines at random places, in standard deviations
    of the latter. within_px: bound of the lines' error.
    """

    world_from_part: Rigid
    score: float
    within_px: float
