"""Lines that the photo shows nowhere, and what excuses that they are not there.

What stands before a part, or shade, takes all that lies to one side of a border; a wrong pose misses lines among others
that it meets. A body of an assembly that is not there takes all of its own lines, and no others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask

LEAST = 12  # samples that can tell anything at all
_NOWHERE = 0.25  # share of a line's samples below which it is missed
_BORDERS, _BEHIND = 32, 0.15  # directions of borders that are tried; share of the samples behind one that may be shown
_GONE, _MOST_GONE = 0.05, 1 / 3  # share of a body that may be shown by chance, and of all samples that may be its own


def missed(shown: Mask, line: Longs) -> Array:
    """Return which samples (n,) lie on lines that are nowhere shown, 0 to 1; a few shown make a line count less."""
    share = np.bincount(line, shown) / np.bincount(line)
    return np.asarray(np.clip(1 - share / _NOWHERE, 0, None)[line])


def behind_border(q: Array, shown: Mask) -> Mask:
    """Return which samples (n,) at q (n, 2) px lie on a side of a straight border on which hardly any is shown.

    Of all borders that have such a side, the one with most samples there.
    """
    angle = 2 * np.pi * np.arange(_BORDERS // 2) / _BORDERS
    order = np.argsort(np.stack([np.cos(angle), np.sin(angle)], axis=1) @ q.T, axis=1)
    order = np.concatenate([order[:, ::-1], order])  # each border from either side
    count = np.arange(1, len(q) + 1)
    bare = np.cumsum(shown[order], axis=1) <= _BEHIND * count
    behind = np.where(bare, count, 0).max(axis=1)
    best = int(np.argmax(behind))
    out = np.zeros(len(q), bool)
    out[order[best, : behind[best]]] = True
    return out


def body_gone(bodies: Sequence[tuple[Ids, Mask]]) -> tuple[int, float]:
    """Return the body of which nothing is shown in any photo, the one with most samples, and its share; -1 for none.

    bodies: for each photo the body of each sample (n,), and whether it shows an edge.
    """
    part, shown = np.concatenate([p for p, _ in bodies]), np.concatenate([s for _, s in bodies])
    if not len(part):
        return -1, 0.0
    its = np.bincount(part)
    may_be = (np.bincount(part, shown) <= _GONE * its) & (its >= LEAST) & (its <= _MOST_GONE * len(part))
    most = int(np.argmax(np.where(may_be, its, 0)))
    return (most, float(its[most] / len(part))) if may_be[most] else (-1, 0.0)
