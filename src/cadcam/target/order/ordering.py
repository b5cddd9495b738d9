"""Identification of marks: found marks put into the order of a plan (the thesis' program `permute`, appendix A).

The thesis tried permutations, n! of them, and sorted by distances beforehand; that requires marks that are all present
and a camera that looks straight down. Here small groups of marks are compared with the plan's (three in every order, in
a map that is nearly affine over such small distances; for plans of up to a dozen marks four in every order, exact under
perspective), the best are grown outward with the plane's own homography, and the result must beat chance by a hundred
to one. The cost is quadratic in the marks. Then all other places where the plan fits as well are searched for:
symmetric plans, and partly visible grids, have several, and all of them are returned.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from cadcam.arrays import Array, Brief, Floats, Ids, frozen
from cadcam.errors import BadValue, NoOrder, TooFewPoints
from cadcam.fit.plane_maps import mapped
from cadcam.kinds import expect_known, expect_number, expect_positive
from cadcam.target.order.grow import grown, without_strays
from cadcam.target.order.judge import Judged, costs, judged, log_chance
from cadcam.target.order.plan import FEWEST, MarkPlan
from cadcam.target.order.rivals import rivals
from cadcam.target.order.seeds import by_quads, seeds

Side = Literal["any", "kept", "mirrored"]
SIDES: dict[str, tuple[int, ...]] = {"any": (1, -1), "kept": (1,), "mirrored": (-1,)}
_LOG_CHANCE = -2.0  # log10: one order by chance in a hundred plans
_UNDECIDABLE = 5  # marks: under perspective so few fit by chance, and prove nothing
_ENOUGH = {True: 0.7, False: 0.5}  # of the marks explained, few or many: no more starts are tried
_TRIES, _MORE = 16, 4  # lists of starts from triangles without an order; and after the last improvement of one
_ODDS = 1000.0
_SECOND = 0.7  # of the marks of the first plate: a second one with so many makes the order ambiguous
_FEWER = 7  # marks fewer than the best that an equally good order may explain, at most a quarter of them


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Ordering(Brief):
    """Which mark of a plan each of N found marks is, and the confidence in it.

    plan_index: (N,) the plan's marks, -1 for false ones. pixel_from_plan: (3, 3), (q, 1) ~ H (p, 1), the simplest of
    similarity, affine map and perspective (`map_kind`) that explains them. residuals: (N, 2) px found minus mapped, NaN
    for false marks: noise and lens distortion. chance: the number of orders as good expected by chance; at most 0.01,
    except for four or five marks, all of the plan, which prove nothing by themselves. alternatives: other orders (N,)
    about as likely, the best first; the order of a second plate of the same plan, if the marks left over show one, is
    last.
    """

    plan_index: Ids
    pixel_from_plan: Array
    map_kind: str
    residuals: Array
    chance: float
    alternatives: tuple[Ids, ...] = field(default=())

    def __post_init__(self) -> None:
        n = len(self.plan_index)
        object.__setattr__(self, "plan_index", frozen(self.plan_index, "plan_index", (n,), np.int32))
        object.__setattr__(self, "pixel_from_plan", frozen(self.pixel_from_plan, "pixel_from_plan", (3, 3)))
        object.__setattr__(self, "residuals", frozen(self.residuals, "residuals", (n, 2), finite=False))
        others = tuple(frozen(a, "alternative", (n,), np.int32) for a in self.alternatives)
        object.__setattr__(self, "alternatives", others)

    @property
    def ambiguous(self) -> bool:
        """Whether another order is about as likely."""
        return bool(self.alternatives)

    @property
    def found(self) -> Ids:
        """Return the numbers of the found marks that belong to the plan."""
        return np.flatnonzero(self.plan_index >= 0).astype(np.int32)

    def __len__(self) -> int:
        return len(self.found)


def order_marks(
    pixels: Floats, plan: Floats, *, side: Side = "any", sigma_px: float = 0.5, odds: float = _ODDS
) -> Ordering:
    """Return for each found mark, pixels (N, 2), which of the plan's marks (M, 2) it is.

    The plan is a plane seen by a camera from anywhere: scaled, rotated, shifted, foreshortened up to about 65 degrees
    of tilt, mildly distorted; some of its marks may be missing, others false, in any order. side: "kept" if the plan's
    axes have the picture's handedness (x right, y down), "mirrored" if not (y up, as in drawings and for robots), "any"
    if it is unknown: a plan that is its own mirror image is then ambiguous. sigma_px: the noise of the marks about a
    plane's perspective. odds: an order that is this many times less likely is ruled out.

    Raises `TooFewPoints` below four marks or places, `NoOrder` where nothing fits better than chance does: another
    plan, or too few of its marks.
    """
    expect_known(side, "side", SIDES)
    expect_positive(sigma_px, "sigma_px", "a positive number of px")
    expect_number(odds, "odds")
    if not (np.isfinite(odds) and odds >= 1):
        raise BadValue("odds", odds, "a number of at least 1")
    q, places = frozen(pixels, "pixels", (None, 2)), MarkPlan.of(plan)
    if len(q) < FEWEST:
        raise TooFewPoints("the order of marks", len(q), FEWEST)
    search = _Search(q, places, SIDES[side], sigma_px)
    first = search.ordering(odds)
    return replace(first, alternatives=(*first.alternatives, *_among_the_rest(search, first)))


def _among_the_rest(search: _Search, first: Ordering) -> tuple[Ids, ...]:
    """Return the order of a second plate like the first among the marks left over, if there is one."""
    rest = np.flatnonzero(first.plan_index < 0)
    if len(rest) < max(_UNDECIDABLE + 1, _SECOND * len(first)):
        return ()
    try:
        second = replace(search, q=search.q[rest]).ordering(1.0)
    except NoOrder:
        return ()
    if len(second) < _SECOND * len(first):
        return ()
    order = np.full(len(search.q), -1, dtype=np.int32)
    order[rest] = second.plan_index
    return (order,)


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """The search for the order of marks q (N, 2) px, known to sigma_px, on a plan; signs: its possible handedness."""

    q: Array
    plan: MarkPlan
    signs: tuple[int, ...]
    sigma_px: float

    def ordering(self, odds: float) -> Ordering:
        """Return the best order, and those less likely by at most `odds`. Raises `NoOrder` if it may be chance."""
        q, plan, orders = self.q, self.plan, self._orders()
        found = judged(q, plan, orders)
        cost, kinds = costs(found, q, plan, self.sigma_px)
        ranked = np.argsort(cost, kind="stable")
        first = int(ranked[0])
        order, H = orders[first], found.maps[kinds[first]][first]
        log = log_chance(found, first, q, plan, self.sigma_px)
        known = order >= 0
        residuals = np.full((len(q), 2), np.nan)
        residuals[known] = q[known] - mapped(H, plan.p[order[known]])
        few = known.all() and known.sum() == len(plan) <= _UNDECIDABLE and np.isfinite(cost[first])
        if not (log < _LOG_CHANCE or few):
            raise _no_order(q, plan, int(known.sum()), log, _rms(residuals[known]))
        near = [int(b) for b in ranked[1:] if cost[b] < cost[first] + np.log(odds)]
        return Ordering(order, H, kinds[first], residuals, float(10.0**log), _different(found, [first, *near]))

    def _orders(self) -> Ids:
        """Return the first orders (B, N) that explain enough marks, or the best of all tried, with their rivals.

        128 triangles are tried: if one in twenty has true marks only, as with as many false marks as true ones, all
        fail in one case of 700. rank: beats chance, then the number of marks, then by how far it beats chance.
        """
        q, plan = self.q, self.plan
        few = by_quads(q, plan)
        enough = max(FEWEST, _ENOUGH[few] * min(len(q), len(plan)))
        best: Ids = np.zeros((0, len(q)), np.int32)
        best_rank, last = (False, 0.0), 0
        for tried, starts in enumerate(seeds(q, plan, self.signs)):
            if not few and tried >= (last + 1 + _MORE if best_rank[0] else _TRIES):
                break
            orders = self._grown(starts, until=np.inf if few else enough)
            if not len(orders):
                continue
            first, log = self._first(orders)
            if log < _LOG_CHANCE:  # it has the perspective, perhaps not yet the place: a grid may be matched shifted
                orders = self._with_rivals(orders, first)
                first, log = self._first(orders)
            marks = int((first >= 0).sum())
            rank = (log < _LOG_CHANCE, marks - 0.01 * log)
            if rank > best_rank:
                best, best_rank, last = orders, rank, tried
            if rank[0] and marks >= enough:
                break
        if not len(best):
            raise _no_order(q, plan, 0, np.inf, 0.0)
        return best

    def _with_rivals(self, orders: Ids, first: Ids) -> Ids:
        """Return the orders with those at other places of the plan that explain hardly fewer marks than the first."""
        fewer = min(_FEWER, int((first >= 0).sum()) // 4)
        others = [self._cleaned(other) for other in rivals(self.q, self.plan, first, self.signs, fewer=fewer)]
        return np.unique([*orders, *(o for o in others if (o >= 0).sum() >= FEWEST)], axis=0)

    def _first(self, orders: Ids) -> tuple[Ids, float]:
        """Return the best of some orders and log10 of its chance."""
        found = judged(self.q, self.plan, orders)
        b = int(np.argmin(costs(found, self.q, self.plan, self.sigma_px)[0]))
        return orders[b], log_chance(found, b, self.q, self.plan, self.sigma_px)

    def _grown(self, starts: list[Ids], *, until: float) -> Ids:
        """Return the orders that grow from starts, up to one of so many marks."""
        orders = []
        for start in starts:
            order = grown(self.q, self.plan, start, sigma_px=self.sigma_px)
            # a few in strong perspective do not grow
            orders += [o for o in (self._cleaned(start), order) if (o >= 0).sum() >= FEWEST]
            if (order >= 0).sum() >= until:
                break
        return np.unique(orders, axis=0) if orders else np.zeros((0, len(self.q)), np.int32)

    def _cleaned(self, order: Ids) -> Ids:
        return without_strays(self.q, self.plan, order, self.sigma_px)


def _different(found: Judged, ranked: list[int]) -> tuple[Ids, ...]:
    """Return the orders after the first that do not equal an earlier one up to a mark more or less."""
    kept: list[Ids] = []
    for b in ranked:
        order = found.orders[b]
        if not any(_alike(order, other) for other in kept):
            kept.append(order)
    return tuple(kept[1:])


def _alike(a: Ids, b: Ids) -> bool:
    both = (a >= 0) & (b >= 0)
    same = int((a[both] == b[both]).sum())
    return same == int(both.sum()) or bool(same > _UNDECIDABLE and 2 * same > min((a >= 0).sum(), (b >= 0).sum()))


def _rms(residuals: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def _no_order(q: Array, plan: MarkPlan, explained: int, log: float, rms: float) -> NoOrder:
    tried = f"{len(q)} marks and a plan of {len(plan)}: no order fits"
    if explained < FEWEST:
        return NoOrder(f"{tried}; is it the right plan, in view with at least half of its marks?", explained, np.inf)
    expected = f"{10.0**log:.2g}" if log < 6 else f"1e{log:.0f}"
    return NoOrder(
        f"{tried}: the best explains {explained} marks within {rms:.2g} px rms, and chance alone makes {expected} "
        "orders as good; is it the right plan, and are enough of its marks in view?",
        explained,
        float(10.0 ** min(log, 300)),
    )
