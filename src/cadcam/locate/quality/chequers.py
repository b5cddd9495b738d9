"""Lines of a pattern that are taken for those of the part: both sides swap their brightness at one place.

Along the part's border the ground may change, or the part's own paint; that both do so at the same place, each to what
the other was, is the corner of a chequer. Tiles, boards and cloth are full of straight lines and fit much that is
straight; a part does not lie so that its border runs through a row of their corners. Print and clutter have such places
too, here and there; only where lines have them again and again, and most of the lines do, is it a pattern that is met.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Ids, Mask, Picture
from cadcam.native.profiles import values_at

_BESIDE_PX = (1.8, 2.6)  # from a line, where its sides' brightness is taken
_LEAST = 0.08  # change of brightness that counts
_MOST = 0.45  # of the samples: from there on it is a pattern
_UNEQUAL = 0.3  # share by which the two changes may differ in size
_CORNERS, _APART = 2, 16  # corners that make a row, at least, and samples from one to the next, on average at most


def along_chequers(gray: Picture, q: Array, normal: Array, run: Ids) -> Mask:
    """Return which samples (n,) at q (n, 2) px, in their order along runs (n,), lie on a run whose sides swap.

    None where that is less than about half of them.
    """
    aside = np.array([[-far, far] for far in _BESIDE_PX])
    sides = values_at(gray[..., None], q[:, None, None] + aside[..., None] * normal[:, None, None])[..., 0].mean(axis=1)
    if len(q) < 6:  # too few for the corners of a row
        return np.zeros(len(q), bool)
    pairs = 0.5 * (sides[1:] + sides[:-1])
    change = pairs[3:] - pairs[:-3]  # from two samples to two, with one between
    size, even = np.abs(change), np.abs(change.sum(axis=1))
    swapped = (size.min(axis=1) > _LEAST) & (even < _UNEQUAL * size.max(axis=1)) & (run[4:] == run[:-4])
    begins = swapped & ~np.r_[False, swapped[:-1]] & ~np.r_[False, False, swapped[:-2]]
    runs = int(run.max()) + 1
    corners, length = np.bincount(run[2:-2][begins], minlength=runs), np.bincount(run, minlength=runs)
    crossed = (corners >= _CORNERS) & (length <= _APART * corners)
    along = crossed[run]
    return along if along.mean() > _MOST else np.zeros(len(q), bool)
