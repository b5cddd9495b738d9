"""Other places that a plan's marks could have: maps of the plan onto itself, whole or in part (a grid's shifts)."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.fit.plane_maps import mapped, perspectives
from cadcam.target.order.plan import MarkPlan, NearestMark, areas, matched_once

_NEAR = 0.3  # of the spacing
_LOST = 1  # neighbours of the base that need not fall on a mark
_SLANT = 5.0
_LEAST_SINE = 0.3
_SPREAD = 24  # marks from all over the plan that are tried before the rest


def rivals(q: Array, plan: MarkPlan, index: Ids, signs: tuple[int, ...], *, fewer: int) -> Ids:
    """Return orders (B, N) that explain at most `fewer` marks fewer than the best of them, `index` among them.

    An affine map of the plan onto itself, as far as its marks were found, makes another order of a given one.
    """
    base, around = _base(plan, index)
    if base is None:
        return index[None]
    A, shift = _self_maps(plan, base, signs)
    nearest = NearestMark(plan)
    known = index[index >= 0]
    for sample, beside in ((around, _LOST), (known[:: -(-len(known) // _SPREAD)], fewer)):
        hits = nearest(plan.p[sample] @ np.swapaxes(A, 1, 2) + shift[:, None])[1] < _NEAR**2
        kept = hits.sum(axis=1) >= len(sample) - beside
        A, shift = A[kept], shift[kept]
    places = _places(q, plan, index)
    mark, distance = nearest(places @ np.swapaxes(A, 1, 2) + shift[:, None])
    near = distance < _NEAR**2
    count = near.sum(axis=1)
    good = np.flatnonzero(count >= max(int(count.max(initial=0)), len(known)) - fewer)
    orders = [matched_once(mark[b], np.where(index >= 0, distance[b] - 1.0, distance[b]), near[b]) for b in good]
    return np.unique([index, *orders], axis=0)


def _base(plan: MarkPlan, index: Ids) -> tuple[Ids | None, Ids]:
    """Return three known marks of the plan in the midst of the known ones, and their known neighbours."""
    known = index[index >= 0]
    middle = plan.p[known].mean(axis=0)
    for first in known[np.argsort(np.sum((plan.p[known] - middle) ** 2, axis=1))]:
        near = known[np.argsort(np.sum((plan.p[known] - plan.p[first]) ** 2, axis=1))][1:9]
        sides = plan.p[near] - plan.p[first]
        sine = np.abs(areas(np.stack([np.zeros_like(sides), np.broadcast_to(sides[0], sides.shape), sides], axis=1)))
        second = np.flatnonzero(sine > _LEAST_SINE * np.linalg.norm(sides, axis=1) * np.linalg.norm(sides[0]))
        if len(second):
            return np.array([first, near[0], near[second[0]]]), near
    return None, known


def _self_maps(plan: MarkPlan, base: Ids, signs: tuple[int, ...]) -> tuple[Array, Array]:
    """Return the affine maps (A, shift) of the base on all triples of neighbours."""
    k = plan.near.shape[1]
    pairs = np.array(list(permutations(range(k), 2)))
    first = np.repeat(np.arange(len(plan)), len(pairs))
    other = plan.near[:, pairs].reshape(-1, 2)
    B = (plan.p[base[1:]] - plan.p[base[0]]).T
    T = np.swapaxes(plan.p[other] - plan.p[first][:, None], 1, 2)
    A = T @ np.linalg.inv(B)
    det = np.linalg.det(A)
    upright = np.sum(A**2, axis=(1, 2)) < (_SLANT + 1 / _SLANT) * np.abs(det)
    if len(signs) == 1:
        upright &= det > 0
    A, first = A[upright], first[upright]
    return A, plan.p[first] - A @ plan.p[base[0]]


def _places(q: Array, plan: MarkPlan, index: Ids) -> Array:
    """Return each found mark's place on the plan (N, 2): its own, or that by the map of the known ones."""
    known = np.flatnonzero(index >= 0)
    H = perspectives(q[None, known], plan.p[None, index[known]], np.ones((1, len(known))))[0]
    places = np.nan_to_num(mapped(H, q), nan=1e30)
    places[known] = plan.p[index[known]]
    return places
