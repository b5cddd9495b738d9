"""From segments to polylines: smooth runs of edges of one sort, each directed head to tail."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Longs, Mask

# A polyline continues where the direction turns by less than this: the sides of an octagonal hole still form one loop,
# the corner of a rectangle ends the line.
TURN_DEG = 50.0


def chained(
    ends: Array, points: Longs, group: npt.NDArray[np.integer], *, turn_deg: float = TURN_DEG
) -> tuple[Longs, Mask, Ids]:
    """Return the order of the segments chain by chain, which ones to reverse, and the chain of each, in that order.

    `ends` (S, 2, 3) positions; `points` (S, 2) indices of the end points; `group` (S,): only segments of equal numbers
    join, at points where exactly two of them meet and turn by less than `turn_deg`.
    """
    partner = _partners(ends, points, group, turn_deg)
    order, flipped, chain = _walk(partner.tolist())
    return np.array(order, np.int64), np.array(flipped, bool), np.array(chain, np.int32)


def chain_of_each(ends: Array, points: Longs, group: npt.NDArray[np.integer]) -> Ids:
    """Return the chain (S,) of each segment, joined as by `chained`, in no particular order."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    partner = _partners(ends, points, group, TURN_DEG)
    one = np.flatnonzero(partner >= 0)
    links = coo_array((np.ones(len(one), bool), (one // 2, partner[one] // 2)), (len(points), len(points)))
    return np.asarray(connected_components(links, directed=False)[1], np.int32)


def _partners(ends: Array, points: Longs, group: npt.NDArray[np.integer], turn_deg: float) -> Longs:
    """Return for each segment end (2 s + side) the end that continues it, -1 for none."""
    n = len(points)
    partner = np.full(2 * n, -1, np.int64)
    if not n:
        return partner
    key = np.repeat((group - group.min()).astype(np.int64), 2) * (int(points.max()) + 1) + points.ravel()
    order = np.argsort(key, kind="stable")
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    pairs = begins[np.diff(begins, append=2 * n) == 2]
    one, other = order[pairs], order[pairs + 1]
    away = ends[:, [1, 0]] - ends  # from each end into its segment
    away = away.reshape(-1, 3) / np.maximum(np.linalg.norm(away, axis=2).reshape(-1, 1), 1e-300)
    straight = np.einsum("ij,ij->i", away[one], away[other]) < -np.cos(np.radians(turn_deg))
    straight &= one // 2 != other // 2
    partner[one[straight]], partner[other[straight]] = other[straight], one[straight]
    return partner


def _walk(partner: list[int]) -> tuple[list[int], list[bool], list[int]]:
    """Follow the partners: open chains from their loose ends, then the loops."""
    n = len(partner) // 2
    done = [False] * n
    order: list[int] = []
    flipped: list[bool] = []
    chain: list[int] = []
    number = 0
    loose = [end for end in range(2 * n) if partner[end] < 0]
    for start in (*loose, *range(0, 2 * n, 2)):
        if done[start // 2]:
            continue
        end = start
        while end >= 0 and not done[end // 2]:
            done[end // 2] = True
            order.append(end // 2)
            flipped.append(bool(end % 2))
            chain.append(number)
            end = partner[end ^ 1]
        number += 1
    return order, flipped, chain
