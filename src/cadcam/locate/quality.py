"""Is the part really there? How much of its visible edges the photo shows, against how much it would show of any lines.

An edge counts as shown where brightness steps very near it, about as strongly as anywhere around, and where the next
sample on the line finds it at the same distance and of the same sign: a line, not a speckle. The same is asked of the
same lines shifted to where the part is not; what they find is chance.

    share = (shown - by chance) / (1 - by chance)

is 1 for a part seen whole and about 0 for a pose anywhere; a wrong pose that a search has fitted to whatever lines
there are seldom reaches a half. So one threshold serves all parts and photos: quality 0.5 stands for a share of 0.55.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import candidates
from cadcam.locate.sight import Sight

_ASKED = 400  # samples, of all photos together
_TOGETHER = 4  # of these in a row: neighbours must be neighbours
_NEAR_PX, _REACH = 2.0, 6  # px: how near a line its step must be, how far around it is compared
_ROOM_PX = 2.5  # a sample nearer than this to another line says nothing
_AGREE_PX = 0.5  # by which neighbours on a line may differ
_FAINT = 0.4  # of the strongest slope nearby
_SHIFTS = [(14.0, 0.3), (22.0, 1.9), (14.0, 3.4), (22.0, 5.0)]  # px, rad
_SHARES = (0.0, 0.55, 0.95)  # shares that make quality 0, 1/2 and 1
_LEAST = 12  # samples that can tell anything at all


@dataclass(frozen=True, slots=True)
class Seen:
    """How many samples could tell, the share of them where the photo shows the edge, and the share by chance."""

    samples: int
    shown: float
    by_chance: float

    @property
    def quality(self) -> float:
        """Return how sure it is that the pose is right, 0 to 1."""
        if self.samples < _LEAST:
            return 0.0
        share = (self.shown - self.by_chance) / (1 - min(self.by_chance, 0.9))
        return float(np.interp(share, _SHARES, (0.0, 0.5, 1.0)))

    def __str__(self) -> str:
        if self.samples < _LEAST:
            return "hardly any edge of the part would be in the picture"
        return f"{self.shown:.0%} of the visible edges are there, {self.by_chance:.0%} would be by chance"


def seen(sights: Sequence[Sight], world_from_part: Rigid) -> Seen:
    """Return how much of the part's visible edges the photos show at a pose."""
    told = shown = by_chance = 0.0
    for sight in (s.thinned(_ASKED // len(sights), together=_TOGETHER) for s in sights):
        at, samples = sight.project(world_from_part), sight.samples
        room = np.minimum(np.minimum(samples.below, samples.above) - 1.0, _REACH)
        which = np.flatnonzero((room >= _ROOM_PX) & np.isfinite(at.q).all(axis=1))
        if not len(which):
            continue
        q, normal, run, room = at.q[which], at.normal[which], samples.run[which], room[which]
        told += len(which)
        shown += len(which) * _share(sight, q, normal, run, room)
        shifted = [_share(sight, q + r * np.array([np.cos(a), np.sin(a)]), normal, run, room) for r, a in _SHIFTS]
        by_chance += len(which) * float(np.mean(shifted))
    return Seen(int(told), shown / max(told, 1), by_chance / max(told, 1))


def _share(sight: Sight, q: Array, normal: Array, run: Ids, room: Array) -> float:
    """Return the share of samples that show an edge; those near which there is none at all count half."""
    found = candidates(sight.photo.gray, q, normal, half_length=2.0, reach=_REACH, noise=sight.noise)
    offset = np.where(np.abs(found.offset) <= room[:, None], found.offset, np.nan)
    slope = np.where(np.isfinite(offset), np.abs(found.slope), 0.0)
    strongest = slope.max(axis=1)
    near = (np.abs(offset) < _NEAR_PX) & (slope > _FAINT * strongest[:, None])
    best = np.argmax(np.where(near, slope, 0.0), axis=1)
    here = np.arange(len(q)), best
    lines = _continued(near[here], np.nan_to_num(offset[here]), np.nan_to_num(np.sign(found.slope[here])), run)
    return float(2 * lines.sum() / ((strongest > 0).sum() + len(q)))


def _continued(good: Mask, offset: Array, sign: Array, run: Ids) -> Mask:
    """Return which good samples have a neighbour on their run that is good, of the same sign and distance."""
    same = (run[1:] == run[:-1]) & (sign[1:] == sign[:-1])
    pair = good[1:] & good[:-1] & same & (np.abs(np.diff(offset)) < _AGREE_PX)
    out = np.zeros(len(good), bool)
    out[1:] |= pair
    out[:-1] |= pair
    return out
