"""Which of two readings of the photos is the right one: told by the lines that only one of them has.

Two readings, poses of a part or of another one, may have most lines in common; these say nothing of which it is, and
a share of all lines hardly does. Of the right one the photos show the lines that the other lacks, of the wrong one they
do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.sight import Sight
from cadcam.locate.quality.absent import LEAST
from cadcam.locate.quality.quality import ASKED, Lines, with_room

_OWN_PX = 4.0  # a line farther than this from all of another reading's is its own
_CLEARLY = 0.4  # share of its own lines that more must be shown of the right one


@dataclass(frozen=True, slots=True)
class Apart:
    """How many samples lie on lines that only one reading has, or only the other, and the share of them shown."""

    own: int
    shown: float
    others: int
    others_shown: float

    def __str__(self) -> str:
        return f"{self.others_shown:.0%} of the lines that only it has are there, {self.shown:.0%} of the others"

    @property
    def against(self) -> bool:
        """Return whether the photos show the other reading, and clearly so."""
        enough = min(self.own, self.others) >= LEAST
        return enough and self.others_shown - self.shown > _CLEARLY

    @property
    def open(self) -> bool:
        """Return whether it cannot be told which of them the photos show."""
        enough = min(self.own, self.others) >= LEAST
        return not (enough and abs(self.others_shown - self.shown) > _CLEARLY)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """The lines of a part at a pose: in each photo those that can tell, and where (n, 2) px all, and contours, are."""

    lines: Sequence[Lines]
    every: Sequence[Array]
    contours: Sequence[Array]

    @classmethod
    def of(cls, sights: Sequence[Sight], pose: Rigid, *, near: float) -> Reading:
        """Return a reading; near: how near (px) to a line its step must be."""
        most = ASKED // len(sights)
        every = [s.project(pose).q for s in sights]
        contours = [q[s.samples.chain < 0] for s, q in zip(sights, every, strict=True)]
        return cls([Lines.of(with_room(s, most), pose, near) for s in sights], every, contours)

    def own_lines(self, others: Sequence[Array]) -> tuple[int, float]:
        """Return how many samples lie away from another reading's, in each photo at (m, 2) px, and how many show."""
        n, shown = 0, 0
        for lines, q in zip(self.lines, others, strict=True):
            own = _away(lines.q, q)
            n, shown = n + int(own.sum()), shown + int((lines.here & own).sum())
        return n, shown / max(n, 1)

    def holds_against(self, others: Sequence[Array]) -> bool:
        """Return whether so many of its own lines are there that no others can show clearly more."""
        n, shown = self.own_lines(others)
        return n >= LEAST and shown >= 1 - _CLEARLY


def told_apart(one: Reading, other: Reading) -> Apart:
    """Return what tells two readings of the same photos apart."""
    return Apart(*one.own_lines(other.every), *other.own_lines(one.every))


def _away(q: Array, others: Array) -> Mask:
    """Return which places q (n, 2) px lie away from all samples (m, 2) of another reading."""
    from scipy.spatial import cKDTree

    others = others[np.isfinite(others).all(axis=1)]
    if not len(others):
        return np.ones(len(q), bool)
    return np.asarray(cKDTree(others).query(q)[0] > _OWN_PX)
