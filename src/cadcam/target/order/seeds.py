"""Initial assignments of marks: small groups of marks whose shape fits the plan's, the best first."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import combinations, permutations

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.target.order.plan import NEIGHBOURS, MarkPlan, NearestMark, areas

DEEPEST = 4.0  # ratio of largest to smallest depth over the marks
_FEW = 12  # marks of a plan up to which all groups of four are tried
_CROWD = 2  # times as many found marks are too many for that
_NEAR = 0.25  # of the spacing
_SLANT = 5.0  # largest ratio of the two scales of an affine map: 70 degrees of tilt, with a margin
_AROUND = 9  # marks around a triangle that vote
_TOGETHER = 8  # triangles processed at a time
_BEST = 8
_ALIKE = 48  # starts from a plan nearly all of whose marks are hit: it may have so many symmetries
_QUADS = 40
_SOME = 40  # marks up to which all triangles of neighbours are tried, not only those of a triangulation
_GOLDEN = 0.6180339887498949
_THIN = 0.05  # area of a sliver over the square of its longest side
_LEAST_AREA = 0.02  # of the marks' box: a triangle large enough to determine a perspective


def by_quads(q: Array, plan: MarkPlan) -> bool:
    """Return whether marks and plan are few enough to try all groups of four."""
    return len(plan) <= _FEW and len(q) <= _CROWD * len(plan)


def seeds(q: Array, plan: MarkPlan, signs: tuple[int, ...]) -> Iterator[list[Ids]]:
    """Yield lists of starts (N,), -1 where still unknown, until all groups of marks have been tried.

    signs: 1 for a plan as drawn, -1 for its mirror image.
    """
    return _from_quads(q, plan, signs) if by_quads(q, plan) else _from_triangles(q, plan, signs)


def _from_triangles(q: Array, plan: MarkPlan, signs: tuple[int, ...]) -> Iterator[list[Ids]]:
    """Pairs of triangles make affine maps: those that map the surrounding marks onto marks of the plan are kept."""
    triangles = _neighbouring(q)
    around = _around(q, triangles)
    corners = _all_turns(_neighbouring(plan.p), signs)
    nearest = NearestMark(plan)
    order = np.argsort((np.arange(len(triangles)) * _GOLDEN) % 1.0)  # well mixed, and deterministic
    for first in range(0, len(order), _TOGETHER):
        block = order[first : first + _TOGETHER]
        yield _voted(q, plan, triangles[block], around[block], corners, nearest)


def _neighbouring(x: Array) -> Ids:
    """Return triangles (T, 3) of neighbours, counter-clockwise, without slivers: of a triangulation, or all if few."""
    found = _among_neighbours(x) if len(x) <= _SOME else _triangulated(x)
    area = areas(x[found])
    found[area < 0] = found[area < 0][:, ::-1]
    sides = np.sum((np.roll(x[found], 1, axis=1) - x[found]) ** 2, axis=2)
    return np.asarray(found[np.abs(area) > _THIN * sides.max(axis=1)])


def _triangulated(x: Array) -> Ids:
    from scipy.spatial import Delaunay, QhullError

    try:
        return np.asarray(Delaunay(x).simplices, dtype=np.int32)
    except QhullError:  # all on a line
        return np.zeros((0, 3), np.int32)


def _among_neighbours(x: Array) -> Ids:
    from scipy.spatial import cKDTree

    near = np.asarray(cKDTree(x).query(x, min(NEIGHBOURS, len(x)))[1])
    groups = np.concatenate([near[:, [0, i, j]] for i, j in combinations(range(1, near.shape[1]), 2)])
    return np.unique(np.sort(groups, axis=1), axis=0).astype(np.int32)


def _all_turns(triangles: Ids, signs: tuple[int, ...]) -> Ids:
    turned = np.concatenate([np.roll(triangles, k, axis=1) for k in range(3)])
    return np.concatenate([turned if sign > 0 else turned[:, ::-1] for sign in signs])


def _around(q: Array, triangles: Ids) -> Ids:
    """Return the marks (T, k) around each triangle."""
    from scipy.spatial import cKDTree

    k = min(_AROUND, len(q) - 3)
    near = np.asarray(cKDTree(q).query(q[triangles].mean(axis=1), k + 3)[1], np.int32).reshape(len(triangles), -1)
    own = (near[:, :, None] == triangles[:, None, :]).any(axis=2)
    order = np.argsort(own, axis=1, kind="stable")
    return np.take_along_axis(near, order, axis=1)[:, :k]


def _voted(q: Array, plan: MarkPlan, triangles: Ids, around: Ids, corners: Ids, nearest: NearestMark) -> list[Ids]:
    Q = np.swapaxes(q[triangles[:, 1:]] - q[triangles[:, :1]], 1, 2)  # columns: two sides
    inverse = np.asarray(np.linalg.inv(Q), np.float64)
    P = np.swapaxes(plan.p[corners[:, 1:]] - plan.p[corners[:, :1]], 1, 2)
    t, s = np.nonzero(_upright_enough(P, inverse))
    there = np.einsum("tij,tkj->tki", inverse, q[around] - q[triangles[:, :1]])  # in units of the sides
    places = plan.p[corners[s, 0], None] + there[t] @ np.swapaxes(P[s], 1, 2)
    mark, distance = nearest(places)
    score = np.maximum(1.0 - distance / _NEAR**2, 0.0).sum(axis=1)
    best = np.argsort(-score, kind="stable")[:_BEST]
    starts = []
    for i in best:
        start = np.full(len(q), -1, dtype=np.int32)
        hit = distance[i] < _NEAR**2
        start[around[t[i]][hit]] = mark[i][hit]
        twice = np.isin(start, corners[s[i]])
        start[twice] = -1
        start[triangles[t[i]]] = corners[s[i]]
        starts.append(start)
    return starts


def _upright_enough(P: Array, inverse: Array) -> Array:
    """Return whether P inverse (T, S), an affine map, compresses the plane no more than a tilted view does."""
    squares = np.einsum("sij,sik->sjk", P, P)
    size = np.einsum("tjk,sjk->ts", inverse @ np.swapaxes(inverse, 1, 2), squares)  # sum of squared singular values
    area = np.abs(np.linalg.det(P))[None, :] * np.abs(np.linalg.det(inverse))[:, None]
    return np.asarray(size < (_SLANT + 1 / _SLANT) * area)


def _from_quads(q: Array, plan: MarkPlan, signs: tuple[int, ...]) -> Iterator[list[Ids]]:
    """Four marks against all groups of four of the plan in every order: exact under any perspective.

    The fourth is sum(l_i p_i) of the other three in the plan, sum(m_i q_i) in the picture; the perspective between them
    is then p = sum(a_i d_i p_i) / sum(a_i d_i) for sum(a_i q_i), with d_i = l_i/m_i the depth of the fourth relative to
    that of each. A camera sees no point behind it, and rarely one many times as far away as another.
    """
    fours = _fours(len(plan))
    area, shares = _shares(plan.p[fours])
    for quad in _spread_quads(q):
        own, own_shares = _shares(q[quad][None])
        with np.errstate(divide="ignore", invalid="ignore"):
            nearer = shares / own_shares
        near, far = np.maximum(nearer.max(axis=1), 1.0), np.minimum(nearer.min(axis=1), 1.0)
        fitting = (far > 0) & (near <= DEEPEST * far) & np.isin(np.sign(area * own), signs)
        yield _tried(q, plan, quad, fours[fitting], nearer[fitting])


@cache
def _fours(count: int) -> Ids:
    fours = np.array(list(permutations(range(count), 4)), dtype=np.int32)
    fours.setflags(write=False)
    return fours


def _shares(quads: Array) -> tuple[Array, Array]:
    """Return the area (K,) of the first three of quads (K, 4, 2), and the fourth (K, 3) as their combination."""
    whole, *parts = (areas(quads[:, t]) for t in ((0, 1, 2), (3, 1, 2), (0, 3, 2), (0, 1, 3)))
    with np.errstate(divide="ignore", invalid="ignore"):
        return whole, np.stack(parts, axis=-1) / whole[:, None]


def _spread_quads(q: Array) -> Ids:
    """Return groups of four marks (K, 4) whose thinnest triangles are largest; for many marks, neighbours in turn.

    Wide groups determine a perspective better; narrow ones lie on one plate where two are in view. Each shares as few
    marks as possible with those before it: a false one spoils all its groups.
    """
    wide = np.array(list(combinations(range(min(len(q), _FEW)), 4)), dtype=np.int32)
    if len(q) <= _FEW:
        return _in_turn(_widest(q, wide)[:_QUADS])
    near, wide = (_widest(q, groups)[:_QUADS] for groups in (_local_quads(q), wide))
    count = min(len(near), len(wide))
    turns = np.stack([near[:count], wide[:count]], axis=1).reshape(-1, 4)
    return np.concatenate([turns, near[count:], wide[count:]])[:_QUADS]


def _in_turn(groups: Ids) -> Ids:
    used, rest = np.zeros(groups.max(initial=0) + 1), np.arange(len(groups))
    order = []
    while rest.size:
        k = int(np.argmin(used[groups[rest]].sum(axis=1)))
        used[groups[rest[k]]] += 1.0
        order.append(rest[k])
        rest = np.delete(rest, k)
    return groups[order]


def _widest(q: Array, groups: Ids) -> Ids:
    triples = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
    least = np.asarray(np.min([np.abs(areas(q[groups[:, t]])) for t in triples], axis=0), np.float64)
    order = np.argsort(-least, kind="stable")
    useful = least[order] > _LEAST_AREA * np.prod(np.ptp(q, axis=0)) / len(q)
    return np.asarray(groups[order][useful])


def _local_quads(q: Array) -> Ids:
    from scipy.spatial import cKDTree

    near = np.asarray(cKDTree(q).query(q, 5)[1], np.int32)
    groups = np.concatenate([near[:, list(c)] for c in combinations(range(5), 4)])
    return np.unique(np.sort(groups, axis=1), axis=0)


def _tried(q: Array, plan: MarkPlan, quad: Ids, fours: Ids, nearer: Array) -> list[Ids]:
    if not len(fours):
        return []
    corners = np.concatenate([q[quad[:3]].T, np.ones((1, 3))])
    of_corners = np.linalg.solve(corners, np.concatenate([q.T, np.ones((1, len(q)))])).T  # (N, 3), rows sum to 1
    weights = of_corners * nearer[:, None]
    depth = weights.sum(axis=2, keepdims=True)
    u = weights @ plan.p[fours[:, :3]] / np.where(depth > 0, depth, np.nan)
    distance = np.hypot(*np.moveaxis(u[:, :, None] - plan.p, 3, 0)) / plan.spacing
    distance = np.where(np.isfinite(distance), distance, np.inf)
    mark, distance = distance.argmin(axis=2), distance.min(axis=2)
    score = np.maximum(1.0 - (distance / _NEAR) ** 2, 0.0).sum(axis=1)
    best = np.argsort(-score, kind="stable")[: _ALIKE if score.max() > 0.6 * min(len(q), len(plan)) else _BEST]
    best = best[score[best] > score.max() - 2.0]
    starts = np.where(distance[best] < _NEAR, mark[best], -1).astype(np.int32)
    starts[:, quad] = fours[best]
    return [_once(start, quad) for start in starts]


def _once(start: Ids, quad: Ids) -> Ids:
    """Return the start where marks of the plan claimed by several found marks keep only the group's own, or none."""
    marks, count = np.unique(start[start >= 0], return_counts=True)
    kept = start[quad].copy()
    start[np.isin(start, marks[count > 1])] = -1
    start[quad] = kept
    return start
