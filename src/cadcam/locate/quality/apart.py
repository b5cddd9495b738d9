"""Which of two readings of the photos is right, judged by the lines that only one of them has.

A reading is a pose of the part, or of its mirror image. Two readings may have most lines in common, and common lines do
not tell which is right; nor, hence, does the share of all lines that is shown. But of the lines that only one reading
has, the photos show those of the right reading and not those of the wrong one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.sight import Sight
from cadcam.locate.quality.absent import LEAST
from cadcam.locate.quality.support import ASKED, ShownLines, with_room

OWN_PX, _CELL_PX = 4.0, 2.0  # least distance of a reading's own line from all others; cell of its raster
_CLEARLY = 0.4  # difference of the shares of own lines shown that decides
_FEWEST = LEAST // 2  # of the one or the other, from which a larger difference may decide
_ALIKE = 0.5  # least ratio of own to common lines shown, for a right pose: right ones have 0.8 to 1.3, wrong ones 0.3


@dataclass(frozen=True, slots=True)
class Apart:
    """The numbers of samples on lines that only one reading, or only the other, has, and the shares of them shown.

    by_chance: the share of the other reading's lines that would be shown anywhere; 1 where that is not known.
    """

    own: int
    shown: float
    others: int
    others_shown: float
    by_chance: float = 1.0

    def __str__(self) -> str:
        return f"{self.others_shown:.0%} of the lines that only it has are there, {self.shown:.0%} of the others"

    @property
    def few(self) -> bool:
        """Return whether there are so few samples that they decide nothing by themselves."""
        return self._enough < 1

    @property
    def against(self) -> bool:
        """Return whether the photos show the other reading: clearly, or, of few samples, all the more clearly."""
        return self.margin > self._clearly

    @property
    def open(self) -> bool:
        """Return whether the photos leave open which of the two they show."""
        return self.few or not abs(self.margin) > _CLEARLY

    @property
    def untold(self) -> bool:
        """Return whether both readings have the same lines but for so few samples that these tell nothing."""
        return max(self.own, self.others) < LEAST

    @property
    def margin(self) -> float:
        """Return by how much more of its own lines the other reading shows than this one.

        A part that lies on what tells its sides apart shows hardly a line that only it has, so that none is missing.
        But if it lies so, the lines of the other side are shown by chance alone.
        """
        return self.others_shown - (max(self.shown, self.by_chance) if self._hides else self.shown)

    @property
    def _hides(self) -> bool:
        return self.own < _FEWEST and self.others >= LEAST and self.by_chance < 1

    @property
    def _clearly(self) -> float:
        decide = self._hides or min(self.own, self.others) >= _FEWEST
        return _CLEARLY / min(1.0, self._enough) if decide else np.inf

    @property
    def _enough(self) -> float:
        """Return the samples, over those that are enough: of two shares the variances add, so their harmonic mean."""
        if self._hides:
            return self.others / LEAST
        return 2 * self.own * self.others / max(self.own + self.others, 1) / LEAST


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """The lines of a part at a pose: in each photo the samples that can be judged, and the places (n, 2) px of all."""

    lines: Sequence[ShownLines]
    every: Sequence[Array]

    @classmethod
    def of(cls, sights: Sequence[Sight], pose: Rigid, *, near: float) -> Reading:
        """Return a reading; near: largest distance (px) between a line and its step."""
        most = ASKED // len(sights)
        every = [s.project(pose).q for s in sights]
        return cls([ShownLines.of(with_room(s, most), pose, near) for s in sights], every)

    def own_lines(self, others: Sequence[Array]) -> tuple[int, float]:
        """Return how many samples lie far from another reading's, at (m, 2) px in each photo, and the share shown."""
        n, shown = 0, 0
        for lines, q in zip(self.lines, others, strict=True):
            own = away(lines.q, q)
            n, shown = n + int(own.sum()), shown + int((lines.here & own).sum())
        return n, shown / max(n, 1)

    @property
    def by_chance(self) -> float:
        """Return the share of its lines that the photos would show anywhere; 1 where there are none."""
        n = np.array([len(lines.which) for lines in self.lines])
        share = [float(lines.share[1:].mean()) if k else 0.0 for k, lines in zip(n, self.lines, strict=True)]
        return float(n @ share / n.sum()) if n.any() else 1.0

    def holds_against(self, others: Sequence[Array]) -> bool:
        """Return whether so many of its own lines are shown that no other reading can show clearly more."""
        n, shown = self.own_lines(others)
        return n >= LEAST and shown >= 1 - _CLEARLY


def told_apart(one: Reading, other: Reading) -> Apart:
    """Return how many lines only one of two readings of the same photos has, and the shares shown."""
    return Apart(*one.own_lines(other.every), *other.own_lines(one.every), other.by_chance)


def shows_alike(own: Mask, shown: Mask) -> bool:
    """Return whether samples (n,) that only this reading has are shown about as often as those that both have."""
    enough = min(own.sum(), (~own).sum()) >= LEAST
    return bool(enough and shown[own].mean() >= _ALIKE * shown[~own].mean())


def shown_less(own: Mask, shown: Mask, least: int = LEAST) -> Mask:
    """Return for each of K other readings whether the samples that it lacks, enough of them, are shown far less often.

    own (K, n): which samples only this reading has; shown (n,). Compared with the samples that both have; least: how
    many of either are enough.
    """
    n, common = own.sum(axis=1), (~own).sum(axis=1)
    of_own = own @ shown.astype(np.int64)
    enough = np.minimum(n, common) >= least
    return np.asarray(enough & (of_own * common < _ALIKE * n * (shown.sum() - of_own)))


def away(q: Array, others: Array) -> Mask:
    """Return which places q (n, 2) px lie far from all samples (m, 2) of another reading, nan where it has none.

    On a raster: a place is near if its own cell or one of the two next to it on each side holds a sample.
    """
    if not len(q):
        return np.zeros(0, bool)
    low, high = q.min(axis=0) - OWN_PX, q.max(axis=0) + OWN_PX
    others = others[((others >= low) & (others <= high)).all(axis=1)]
    near = np.zeros(1 + ((high - low) / _CELL_PX).astype(np.int64), bool)
    near[tuple(((others - low) / _CELL_PX).astype(np.int64).T)] = True
    for sideways in (near, near.T) * round(OWN_PX / _CELL_PX):
        sideways[1:] |= sideways[:-1]
        sideways[:-1] |= sideways[1:]
    return np.asarray(~near[tuple(((q - low) / _CELL_PX).astype(np.int64).T)])
