"""Lines that the photo shows nowhere, and what excuses their absence.

An occluder in front of the part, or a shadow, hides everything on one side of a border; a wrong pose misses lines among
others that happen to be met. A body missing from an assembly takes all of its own lines with it, and no others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask

LEAST = 12  # fewest samples that allow a judgement
_NOWHERE = 0.25  # share of a line's samples below which the line is missed
_BORDERS, _BEHIND = 32, 0.15  # directions of borders that are tried; largest share of shown samples behind a border
_GONE, _MOST_GONE = 0.05, 1 / 3  # shares: most of a missing body shown by chance; most of all samples in it


def missed(shown: Mask, line: Longs) -> Array:
    """Return which samples (n,) lie on lines shown nowhere, 0 to 1: a few shown samples make a line count less."""
    share = np.bincount(line, shown) / np.bincount(line)
    return np.asarray(np.clip(1 - share / _NOWHERE, 0, None)[line])


def behind_border(q: Array, shown: Mask) -> Mask:
    """Return which samples (n,) at q (n, 2) px lie on a side of a straight border on which hardly any is shown.

    If there are several such borders, the one with most samples behind it.
    """
    angle = 2 * np.pi * np.arange(_BORDERS // 2) / _BORDERS
    order = np.argsort(np.stack([np.cos(angle), np.sin(angle)], axis=1) @ q.T, axis=1)
    order = np.concatenate([order[:, ::-1], order])  # each border, from both sides
    count = np.arange(1, len(q) + 1)
    bare = np.cumsum(shown[order], axis=1) <= _BEHIND * count
    behind = np.where(bare, count, 0).max(axis=1)
    best = int(np.argmax(behind))
    out = np.zeros(len(q), bool)
    out[order[best, : behind[best]]] = True
    return out


def body_gone(bodies: Sequence[tuple[Ids, Mask]]) -> tuple[int, float]:
    """Return the body of which no photo shows anything, the one with most samples, and its share; -1 for none.

    bodies: for each photo the body of each sample (n,), and whether the sample shows an edge.
    """
    part, shown = np.concatenate([p for p, _ in bodies]), np.concatenate([s for _, s in bodies])
    if not len(part):
        return -1, 0.0
    its = np.bincount(part)
    may_be = (np.bincount(part, shown) <= _GONE * its) & (its >= LEAST) & (its <= _MOST_GONE * len(part))
    most = int(np.argmax(np.where(may_be, its, 0)))
    return (most, float(its[most] / len(part))) if may_be[most] else (-1, 0.0)
