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

_OWN_PX, _CELL_PX = 4.0, 2.0  # a line farther than this from all of another reading's is its own, to a cell
_CLEARLY = 0.4  # share of its own lines that more must be shown of the right one
_ALIKE = 0.5  # times as often as the rest, that own lines show of a right one: there 0.8 to 1.3, of wrong ones 0.3


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
    """The lines of a part at a pose: in each photo those that can tell, and where (n, 2) px all are."""

    lines: Sequence[Lines]
    every: Sequence[Array]

    @classmethod
    def of(cls, sights: Sequence[Sight], pose: Rigid, *, near: float) -> Reading:
        """Return a reading; near: how near (px) to a line its step must be."""
        most = ASKED // len(sights)
        every = [s.project(pose).q for s in sights]
        return cls([Lines.of(with_room(s, most), pose, near) for s in sights], every)

    def own_lines(self, others: Sequence[Array]) -> tuple[int, float]:
        """Return how many samples lie away from another reading's, in each photo at (m, 2) px, and how many show."""
        n, shown = 0, 0
        for lines, q in zip(self.lines, others, strict=True):
            own = away(lines.q, q)
            n, shown = n + int(own.sum()), shown + int((lines.here & own).sum())
        return n, shown / max(n, 1)

    def holds_against(self, others: Sequence[Array]) -> bool:
        """Return whether so many of its own lines are there that no others can show clearly more."""
        n, shown = self.own_lines(others)
        return n >= LEAST and shown >= 1 - _CLEARLY


def told_apart(one: Reading, other: Reading) -> Apart:
    """Return what tells two readings of the same photos apart."""
    return Apart(*one.own_lines(other.every), *other.own_lines(one.every))


def shows_alike(own: Mask, shown: Mask) -> bool:
    """Return whether samples (n,) that only this reading has show about as often as those that another has, too."""
    enough = min(own.sum(), (~own).sum()) >= LEAST
    return bool(enough and shown[own].mean() >= _ALIKE * shown[~own].mean())


def away(q: Array, others: Array) -> Mask:
    """Return which places q (n, 2) px lie away from all samples (m, 2) of another reading, nan where it has none.

    By cells, of which a place's own and the two about it on each side count as near.
    """
    if not len(q):
        return np.zeros(0, bool)
    low, high = q.min(axis=0) - _OWN_PX, q.max(axis=0) + _OWN_PX
    others = others[((others >= low) & (others <= high)).all(axis=1)]
    near = np.zeros(1 + ((high - low) / _CELL_PX).astype(np.int64), bool)
    near[tuple(((others - low) / _CELL_PX).astype(np.int64).T)] = True
    for sideways in (near, near.T) * round(_OWN_PX / _CELL_PX):
        sideways[1:] |= sideways[:-1]
        sideways[:-1] |= sideways[1:]
    return np.asarray(~near[tuple(((q - low) / _CELL_PX).astype(np.int64).T)])
