"""Lines of a chequered pattern that are mistaken for the part's: both sides swap their brightness at one place.

Along the part's border the background may change, or the part's own paint; where both change at the same place, each to
the level of the other, there is a corner of a chequered pattern. Tiles, boards and cloth are full of straight lines and
fit much that is straight, but a part is unlikely to lie with its border through a row of their corners. Print and
clutter have single such places too: only where most lines have them repeatedly has the pose latched onto a pattern.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids, Mask, Picture
from cadcam.native.profiles import values_at

_BESIDE_PX = (1.8, 2.6)  # distances from a line at which the brightness of its sides is measured
_LEAST = 0.08  # least change of brightness
_MOST = 0.45  # share of the samples from which it is a pattern
_UNEQUAL = 0.3  # largest relative difference of the two changes
_CORNERS, _APART = 2, 16  # fewest corners in a row, and largest mean distance between them, in samples


def along_chequers(gray: Picture, q: Array, normal: Array, run: Ids) -> Mask:
    """Return which samples (n,) at q (n, 2) px, ordered along runs (n,), lie on a run whose sides swap brightness.

    None where that is less than about half of them.
    """
    aside = np.array([[-far, far] for far in _BESIDE_PX])
    sides = values_at(gray[..., None], q[:, None, None] + aside[..., None] * normal[:, None, None])[..., 0].mean(axis=1)
    if len(q) < 6:  # too few for a row of corners
        return np.zeros(len(q), bool)
    pairs = 0.5 * (sides[1:] + sides[:-1])
    change = pairs[3:] - pairs[:-3]  # between means of two samples, with one sample in between
    size, even = np.abs(change), np.abs(change.sum(axis=1))
    swapped = (size.min(axis=1) > _LEAST) & (even < _UNEQUAL * size.max(axis=1)) & (run[4:] == run[:-4])
    begins = swapped & ~np.r_[False, swapped[:-1]] & ~np.r_[False, False, swapped[:-2]]
    runs = int(run.max()) + 1
    corners, length = np.bincount(run[2:-2][begins], minlength=runs), np.bincount(run, minlength=runs)
    crossed = (corners >= _CORNERS) & (length <= _APART * corners)
    along = crossed[run]
    return along if along.mean() > _MOST else np.zeros(len(q), bool)
