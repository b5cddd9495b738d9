"""A pose that photos may show, before it is refined."""

from __future__ import annotations

from dataclasses import dataclass

from cadcam.geometry.rigid import Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A pose that the photos may show, and how much speaks for it.

    score: certainty of lines under the visible edges above what edges put down anywhere meet, in standard deviations of
    that. agreement in [0, 1]: mean certainty under the edges in the picture. within_px: how far off its lines may be.
    """

    world_from_part: Rigid
    score: float
    agreement: float
    within_px: float = 8.0
