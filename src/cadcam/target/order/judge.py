"""How good an order of marks is: against chance, and against other orders.

Against chance (a contrario, after Moisan and Stival, IJCV 2004): how many orders as good would be expected if the marks
had fallen anywhere. Against another: by what both leave unexplained and the simplest map of the plane that does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.fit.plane_maps import FITTERS, depths, mapped
from cadcam.target.order.plan import MarkPlan
from cadcam.target.order.seeds import DEEPEST

_VIEWS = {"similarity": 1.0, "affine": 0.3, "perspective": 0.03}  # share of random matches that a camera could see
_SLANT = 5.0  # ratio of the two scales: 70 degrees of tilt, with room
_TOGETHER = 400_000  # numbers of a design matrix held at a time
_LEAST_PRICE = 1.0
_SAMPLES = {"similarity": 2, "affine": 3, "perspective": 4}  # marks that fix each map


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """B orders (B, N): the squared residuals summed and the map (B, 3, 3) for each kind of map, inf where none fits."""

    orders: Ids
    squares: dict[str, Array]
    maps: dict[str, Array]

    @property
    def known(self) -> Ids:
        """Return how many marks each order explains (B,)."""
        return np.asarray((self.orders >= 0).sum(axis=1))


def judged(q: Array, plan: MarkPlan, orders: Ids) -> Judged:
    """Return how each of the orders (B, N) of marks q (N, 2) fits."""
    step = max(1, _TOGETHER // (18 * len(q)))
    parts = [_fitted(q, plan, orders[i : i + step]) for i in range(0, len(orders), step)]
    squares = {name: np.concatenate([s[name] for s, _ in parts]) for name in FITTERS}
    return Judged(orders, squares, {name: np.concatenate([m[name] for _, m in parts]) for name in FITTERS})


def _fitted(q: Array, plan: MarkPlan, orders: Ids) -> tuple[dict[str, Array], dict[str, Array]]:
    w = (orders >= 0).astype(np.float64)
    p = plan.p[np.where(orders >= 0, orders, 0)]
    seen = np.broadcast_to(q, (len(orders), *q.shape))
    squares, maps = {}, {}
    for name, (fit, _) in FITTERS.items():
        H = fit(p, seen, w)
        depth = np.where(w > 0, depths(H, p), 1.0)
        r2 = np.where(w > 0, np.sum((seen - mapped(H, p)) ** 2, axis=2), 0.0).sum(axis=1)
        seeable = (depth.min(axis=1) > 0) & (depth.max(axis=1) <= DEEPEST * depth.min(axis=1)) & _upright(H, p, w)
        squares[name] = np.where(seeable & np.isfinite(r2) & (w.sum(axis=1) >= _SAMPLES[name]), r2, np.inf)
        maps[name] = H
    return squares, maps


def _upright(H: Array, p: Array, w: Array) -> Mask:
    """Return whether the maps (B, 3, 3) squeeze the plane at the marks' middle no more than a tilted view does."""
    middle = (p * w[..., None]).sum(axis=1) / np.maximum(w.sum(axis=1), 1.0)[:, None]
    u = np.einsum("bij,bj->bi", H[:, :, :2], middle) + H[:, :, 2]
    J = H[:, :2, :2] - (u[:, :2] / u[:, 2:])[:, :, None] * H[:, 2:, :2]
    return np.asarray(np.sum(J**2, axis=(1, 2)) <= (_SLANT + 1 / _SLANT) * np.abs(np.linalg.det(J)))


def costs(found: Judged, q: Array, plan: MarkPlan, sigma_px: float) -> tuple[Array, list[str]]:
    """Return each order's cost (B,), minus its log likelihood up to a constant, and the map that explains it best.

    A residual costs r^2/(2 sigma^2), a parameter of the map log(extent/sigma) (a minimum description length, Rissanen
    1978), and a mark that another order explains, as it must be false here and one of the plan missing, the odds of
    both as the best order shows them. Where it lies does not count: false marks may well continue a pattern.
    """
    known = found.known
    best = int(np.argmax(known - 1e-6 * _capped(found.squares["perspective"])))
    dof = max(2 * int(known[best]) - 8, 1)
    rms2 = found.squares["perspective"][best] / dof
    sigma = float(np.sqrt(max(sigma_px**2, rms2 if np.isfinite(rms2) else 0.0)))
    extent = float(np.linalg.norm(np.ptp(q, axis=0)))
    names = list(FITTERS)
    each = np.stack(
        [found.squares[n] / (2 * sigma**2) + FITTERS[n][1] * np.log(max(extent / sigma, 2.0)) for n in names]
    )
    lost = known[best] - known
    return each.min(axis=0) + lost * _price(found, best, q, plan), [names[i] for i in each.argmin(axis=0)]


def _capped(x: Array) -> Array:
    return np.minimum(np.nan_to_num(x, posinf=1e5), 1e5)


def _price(found: Judged, best: int, q: Array, plan: MarkPlan) -> float:
    """Return what it costs that a mark is false and one of the plan missing, beyond what matching them does."""
    n, k = len(q), int(found.known[best])
    visible = max(_visible(found.maps["perspective"][best], q, plan), k)
    false, missing = (n - k + 1) / (n + 2), (visible - k + 1) / (visible + 2)
    odds = float(np.log((1 - false) / false) + np.log((1 - missing) / missing))
    return max(_LEAST_PRICE, odds) + 1.0  # what a residual costs on average


def _visible(H: Array, q: Array, plan: MarkPlan) -> int:
    """Return how many marks of the plan fall into the box of the found ones."""
    at = mapped(H, plan.p)
    with np.errstate(invalid="ignore"):
        return int(((at >= q.min(axis=0)) & (at <= q.max(axis=0))).all(axis=1).sum())


def log_chance(found: Judged, b: int, q: Array, plan: MarkPlan, sigma_px: float) -> float:
    """Return log10 of how many orders as good as number b chance would give: the least over the kinds of map.

    Tests: twice C(n, s) P(m, s) choices of the s marks that fix a map, as far as a camera could see them so, times
    three kinds. Each other mark falls within r of one of the plan's with p = visible pi r^2 / area; k of n do with the
    binomial's tail.
    """
    from scipy.special import betainc, gammaln

    order = found.orders[b]
    known = order >= 0
    n, m = len(q), len(plan)
    area = float(np.prod(np.ptp(q, axis=0)))
    out = np.inf
    for name, s in _SAMPLES.items():
        if not np.isfinite(found.squares[name][b]):
            continue
        H = found.maps[name][b]
        r = np.sort(np.linalg.norm(q[known] - mapped(H, plan.p[order[known]]), axis=1)).clip(sigma_px)
        k = np.arange(1, len(r) + 1)
        p = np.minimum(max(_visible(H, q, plan), 1) * np.pi * r**2 / max(area, 1e-9), 1.0)
        rest = k > s
        tail = np.zeros(len(k))
        tail[rest] = np.log10(betainc(k[rest] - s, n - k[rest] + 1, p[rest]).clip(1e-300))
        choices = gammaln(n + 1) - gammaln(s + 1) - gammaln(n - s + 1) + gammaln(m + 1) - gammaln(m - s + 1)
        out = min(out, float((np.log(6 * _VIEWS[name]) + choices) / np.log(10) + tail[k >= s].min(initial=0.0)))
    return out
