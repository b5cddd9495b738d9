"""The quality of an assignment of marks: compared with chance, and with other assignments ("orders").

With chance (a contrario, after Moisan and Stival, IJCV 2004): the expected number of equally good orders if the marks
lay at random. With another order: by the residuals and the marks that each leaves unexplained, and by the simplest map
of the plane that explains the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.fit.plane_maps import FITTERS, depths, mapped
from cadcam.target.order.plan import MarkPlan
from cadcam.target.order.seeds import DEEPEST

_VIEWS = {"similarity": 1.0, "affine": 0.3, "perspective": 0.03}  # share of random matches that a camera could see
_SLANT = 5.0  # largest ratio of the two scales: 70 degrees of tilt, with a margin
_BATCH = 400_000  # elements of the design matrices in memory at a time
_LEAST_PRICE = 1.0  # see `_price`
_SAMPLES = {"similarity": 2, "affine": 3, "perspective": 4}  # marks that fix each map


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """B orders (B, N): the sum of squared residuals and the map (B, 3, 3) for each kind of map, inf where none fits."""

    orders: Ids
    squares: dict[str, Array]
    maps: dict[str, Array]

    @property
    def known(self) -> Ids:
        """Return how many marks each order explains (B,)."""
        return np.asarray((self.orders >= 0).sum(axis=1))


def judged(q: Array, plan: MarkPlan, orders: Ids) -> Judged:
    """Return how each of the orders (B, N) of marks q (N, 2) fits."""
    step = max(1, _BATCH // (18 * len(q)))
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
    """Return whether the maps (B, 3, 3) compress the plane at the marks' middle no more than a tilted view does."""
    middle = (p * w[..., None]).sum(axis=1) / np.maximum(w.sum(axis=1), 1.0)[:, None]
    u = np.einsum("bij,bj->bi", H[:, :, :2], middle) + H[:, :, 2]
    J = H[:, :2, :2] - (u[:, :2] / u[:, 2:])[:, :, None] * H[:, 2:, :2]
    return np.asarray(np.sum(J**2, axis=(1, 2)) <= (_SLANT + 1 / _SLANT) * np.abs(np.linalg.det(J)))


def costs(found: Judged, q: Array, plan: MarkPlan, sigma_px: float) -> tuple[Array, list[str]]:
    """Return each order's cost (B,), minus its log likelihood up to a constant, and the map that explains it best.

    A residual costs r^2/(2 sigma^2), and a parameter of the map log(extent/sigma) (minimum description length, Rissanen
    1978). A mark that only another order explains must be false in this one, and one of the plan missing: it costs the
    log odds of both, estimated from the best order. Its position does not count: false marks may well continue a
    pattern.
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
    """Return the cost of one false and one missing mark, less that of a match of the two."""
    n, k = len(q), int(found.known[best])
    visible = max(_visible(found.maps["perspective"][best], q, plan), k)
    false, missing = (n - k + 1) / (n + 2), (visible - k + 1) / (visible + 2)
    odds = float(np.log((1 - false) / false) + np.log((1 - missing) / missing))
    return max(_LEAST_PRICE, odds) + 1.0  # the mean cost of a residual


def _visible(H: Array, q: Array, plan: MarkPlan) -> int:
    """Return how many marks of the plan fall inside the bounding box of the found ones."""
    at = mapped(H, plan.p)
    with np.errstate(invalid="ignore"):
        return int(((at >= q.min(axis=0)) & (at <= q.max(axis=0))).all(axis=1).sum())


def log_chance(found: Judged, b: int, q: Array, plan: MarkPlan, sigma_px: float) -> float:
    """Return log10 of the number of orders as good as number b expected by chance: the least over the kinds of map.

    Tests: twice C(n, s) P(m, s) choices of the s marks that determine a map, times the share that a camera could see
    so, times three kinds. Each other mark falls within r of one of the plan's with p = visible pi r^2 / area; that k of
    n do has the binomial's tail probability.
    """
    fitting = [kind for kind in _SAMPLES if np.isfinite(found.squares[kind][b])]
    return min((_log_chance_of(kind, found, b, q, plan, sigma_px) for kind in fitting), default=np.inf)


def _log_chance_of(kind: str, found: Judged, b: int, q: Array, plan: MarkPlan, sigma_px: float) -> float:
    """Return the same for one kind of map, at the residual that makes it least likely to be chance."""
    from scipy.special import betainc

    order, H = found.orders[b], found.maps[kind][b]
    known = order >= 0
    n, samples = len(q), _SAMPLES[kind]
    r = np.sort(np.linalg.norm(q[known] - mapped(H, plan.p[order[known]]), axis=1)).clip(sigma_px)
    k = np.arange(1, len(r) + 1)  # marks within r
    area = max(float(np.prod(np.ptp(q, axis=0))), 1e-9)
    p = np.minimum(max(_visible(H, q, plan), 1) * np.pi * r**2 / area, 1.0)
    beyond = k > samples  # the marks that determine the map are no evidence for it
    tail = np.zeros(len(k))
    tail[beyond] = np.log10(betainc(k[beyond] - samples, n - k[beyond] + 1, p[beyond]).clip(1e-300))
    tests = np.log(6 * _VIEWS[kind]) + _log_choices(n, len(plan), samples)
    return float(tests / np.log(10) + tail[k >= samples].min(initial=0.0))


def _log_choices(n: int, m: int, s: int) -> float:
    """Return log(C(n, s) P(m, s)): the choices of s of n marks, and of s of m places for them in turn."""
    from scipy.special import gammaln

    return float(gammaln(n + 1) - gammaln(s + 1) - gammaln(n - s + 1) + gammaln(m + 1) - gammaln(m - s + 1))
