"""A few identified marks grown to all: the map of the plane, and each mark where its neighbours predict it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.fit.plane_maps import affinities, mapped, perspectives
from cadcam.target.order.plan import MarkPlan, matched_once

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_NEAR = 0.35  # of the plan's spacing: a mark within it is accepted while the map grows
_ROUNDS = 30
_ENOUGH = 7  # marks from which a perspective is fitted
_MANY = 24  # marks from which a polynomial separates lens distortion from outliers
_REWEIGHTED = 5  # iterations
_STRAY = 4.0  # robust sigmas at the end


def grown(q: Array, plan: MarkPlan, start: Ids, *, sigma_px: float) -> Ids:
    """Return the mark of the plan for each found mark q (N, 2), -1 for none, grown from `start` (N,) with three known.

    Alternating: a map from pixels to plan through the known marks (affine, then perspective); then neighbours of known
    marks are accepted where they fall within a third of the spacing of a place of the plan, after subtracting the
    residuals of known neighbours (lens distortion moves neighbours alike). At the end outliers are dropped: beyond four
    robust sigmas, or three of sigma_px if that is more.
    """
    from scipy.spatial import cKDTree

    tree, index = cKDTree(plan.p), start.copy()
    seen: list[Ids] = [index]
    for _ in range(_ROUNDS):
        u = _in_plan(q, plan, index)
        index = _taken(u, plan, index, tree)
        if (index >= 0).sum() < 3 or any(np.array_equal(index, old) for old in seen[-3:]):
            break
        seen.append(index)
    return without_strays(q, plan, index, sigma_px)


def _in_plan(q: Array, plan: MarkPlan, index: Ids) -> Array:
    known = np.flatnonzero(index >= 0)
    fit = perspectives if len(known) >= _ENOUGH else affinities
    H = fit(q[None, known], plan.p[None, index[known]], np.ones((1, len(known))))[0]
    return mapped(H, q)


def _taken(u: Array, plan: MarkPlan, index: Ids, tree: cKDTree) -> Ids:
    """Return the assignment of marks that fall on u (N, 2) in the plan."""
    ahead = np.asarray(np.isfinite(u).all(axis=1))
    place = np.where(ahead[:, None], u, plan.p.min(axis=0) - 1e6 * np.ptp(plan.p, axis=0).max())
    off = _off(place, plan, index)
    mark = np.asarray(tree.query(place)[1])
    place = place - off[mark]
    distance, mark = (np.asarray(a) for a in tree.query(place))
    known = np.zeros(len(plan))
    known[index[index >= 0]] = 1.0
    reached: Mask = np.asarray(known + plan.joined @ known > 0, np.bool_)
    near = ahead & reached[mark] & (distance < _NEAR * plan.spacing[mark])
    return matched_once(mark.astype(np.int32), distance, near)


def _off(u: Array, plan: MarkPlan, index: Ids) -> Array:
    """Return the median residual (M, 2) of the known neighbours of each mark of the plan."""
    known = np.flatnonzero(index >= 0)
    off = np.full((len(plan), 2), np.nan)
    off[index[known]] = u[known] - plan.p[index[known]]
    return _medians(off[plan.near])


def _medians(values: Array) -> Array:
    """Return the lower medians (M, 2) of the rows of values (M, k, 2), without NaN; 0 where fewer than three remain."""
    count = np.isfinite(values[..., 0]).sum(axis=1)
    middle = np.sort(values, axis=1)[np.arange(len(values)), np.maximum(count - 1, 0) // 2]  # NaN is sorted last
    return np.where(count[:, None] > 2, middle, 0.0)


def without_strays(q: Array, plan: MarkPlan, index: Ids, sigma_px: float) -> Ids:
    """Return the assignment (N,) without outliers; unchanged where too few marks determine the residuals."""
    if (index >= 0).sum() < _ENOUGH:
        return index
    out = index
    for _ in range(2):  # the second time with a map that the outliers no longer distort
        known, fitted = np.flatnonzero(index >= 0), np.flatnonzero(out >= 0)
        if len(fitted) < _ENOUGH:
            return out
        H = perspectives(plan.p[None, out[fitted]], q[None, fitted], np.ones((1, len(fitted))))[0]
        off = q[known] - mapped(H, plan.p[index[known]])
        smooth = _bent if len(fitted) >= _MANY else _like_neighbours
        rest = off - smooth(off, plan, index[known], np.isin(known, fitted))
        length = np.hypot(rest[:, 0], rest[:, 1])
        limit = max(3 * sigma_px, _STRAY * float(np.median(length)) / 1.18)
        out = index.copy()
        out[known[~(length <= limit)]] = -1
    return out


def _like_neighbours(off: Array, plan: MarkPlan, marks: Ids, trusted: Mask) -> Array:
    """Return the residuals predicted by the residuals off (K, 2) px of the marks' neighbours."""
    at = np.full((len(plan), 2), np.nan)
    at[marks[trusted]] = off[trusted]
    return _medians(at[plan.near])[marks]


def _bent(off: Array, plan: MarkPlan, marks: Ids, trusted: Mask) -> Array:
    """Return residuals (K, 2) as a cubic polynomial of position: what a first term of radial distortion leaves.

    Reweighted by 1/(1 + (r/2s)^2), so that outliers do not distort it.
    """
    x, y = ((plan.p[marks] - plan.p[marks].mean(axis=0)) / np.ptp(plan.p, axis=0).max()).T
    A = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)
    weight, bent = trusted.astype(np.float64), np.zeros_like(off)
    for _ in range(_REWEIGHTED):
        root = np.sqrt(weight)[:, None]
        bent = np.asarray(A @ np.linalg.lstsq(A * root, off * root, rcond=1e-9)[0])
        r = np.hypot(*(off - bent).T)
        weight = trusted / (1 + (r / max(2 * float(np.median(r[trusted])), 1e-9)) ** 2)
    return bent
