"""Poses of one known target in many views of one known camera, all views at once and without a guess.

A flat target may look nearly the same in two poses; both are returned, for what else is known (a robot's motions) to
choose. For a single view where only the picture counts, `cadcam.calibrate.points.camera.locate_camera` searches harder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.camera.camera import Camera
from cadcam.fit.extents import COPLANAR, extents, spread_subset, triples
from cadcam.fit.p3p import p3p
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid, by_twist

_TRIPLES, _KEPT, _ITERATIONS = 6, 3, 30
_SCREEN = 12  # points until the minima are known
_SETTLED = 1e-10  # share of the cost
_APART = 0.01  # Frobenius distance of two minima that count as two: 0.4 deg


@dataclass(frozen=True, slots=True, eq=False)
class PaddedViews:
    """Points p (n, N, 3) mm and pixels q (n, N, 2) of n views, padded to the longest; seen (n, N): 1, padded 0."""

    p: Array
    q: Array
    seen: Array

    @classmethod
    def of(cls, points: Sequence[tuple[Array, Array]]) -> PaddedViews:
        """Return the views of lists of points (N_i, 3) and pixels (N_i, 2), padded with their first ones."""
        longest = max(len(p) for p, _ in points)
        index = [np.where(np.arange(longest) < len(p), np.arange(longest), 0) for p, _ in points]
        p = np.stack([p[i] for (p, _), i in zip(points, index, strict=True)])
        q = np.stack([q[i] for (_, q), i in zip(points, index, strict=True)])
        seen = np.stack([np.arange(longest) < len(p) for p, _ in points]).astype(np.float64)
        return cls(p, q, seen)

    def thinned(self, count: int) -> PaddedViews:
        """Return the same views with at most `count` points each, far from each other."""
        if self.p.shape[1] <= count:
            return self
        index = np.stack([_spread(p, s, count) for p, s in zip(self.p, self.seen, strict=True)])
        rows = np.arange(len(self))[:, None]
        return PaddedViews(self.p[rows, index], self.q[rows, index], self.seen[rows, index])

    def __len__(self) -> int:
        return len(self.p)


@dataclass(frozen=True, slots=True, eq=False)
class TwoPoses:
    """The best camera_from_target of every view and the second best minimum, (n, 2), with their sums of squares px^2.

    A view without a second minimum repeats its first with the sum inf; one without any pose has both inf.
    """

    rotation: Array
    translation: Array
    sum_of_squares: Array

    def chosen(self, which: Longs) -> Rigid:
        """Return camera_from_target (n) with pose 0 or 1 of each view by `which` (n,)."""
        rows = np.arange(len(which))
        return Rigid(self.rotation[rows, which], self.translation[rows, which])


def poses_of_views(camera: Camera, views: PaddedViews) -> TwoPoses:
    """Return camera_from_target of every view: three-point poses on spread triples and their flips, refined."""
    starts = [_starts(camera, p[s > 0], q[s > 0]) for p, q, s in zip(views.p, views.q, views.seen, strict=True)]
    owner = np.repeat(np.arange(len(views)), [len(R) for R, _ in starts])
    R, t = np.concatenate([R for R, _ in starts]), np.concatenate([t for _, t in starts])
    if not len(R):
        none = np.zeros((len(views), 2, 3))
        return TwoPoses(np.tile(np.eye(3), (len(views), 2, 1, 1)), none, np.full((len(views), 2), np.inf))
    R, t, cost = _descended(camera, views.thinned(_SCREEN), owner, R, t)
    first, second = _two_lowest(owner, len(views), R, cost)
    lost = first < 0
    pick = np.stack([np.where(lost, 0, first), np.where(second < 0, np.where(lost, 0, first), second)], axis=1).ravel()
    every = np.repeat(np.arange(len(views)), 2)
    R, t, cost = _descended(camera, views, every, R[pick], t[pick])
    cost = cost.reshape(-1, 2)
    cost[second < 0, 1] = np.inf
    cost[lost] = np.inf
    return _ordered(R.reshape(-1, 2, 3, 3), t.reshape(-1, 2, 3), cost)


def pose_jacobian(camera: Camera, R: Array, t: Array, p: Array) -> tuple[Array, Array]:
    """Return pixels q (B, N, 2) and dq/dxi (B, N, 2, 6) of camera_from_target @ exp(xi) for points p (B, N, 3)."""
    q, J = camera.project_with_jacobian(p @ np.swapaxes(R, -1, -2) + t[:, None])
    return q, by_twist(p[..., None, :], J @ R[:, None])


def _starts(camera: Camera, p: Array, q: Array) -> tuple[Array, Array]:
    """Return the best three-point poses of one view and the flips of a flat target's."""
    rays = camera.unproject(q)
    pick = triples(p, q, _TRIPLES)
    pick = pick[np.isfinite(rays[pick]).all(axis=(1, 2))]
    F, R = p3p(p[pick], rays[pick])
    t = -(R @ F[..., None])[..., 0]
    r = camera.project(p @ np.swapaxes(R, -1, -2) + t[:, None]) - q
    cost = np.sum(r * r, axis=(1, 2))
    best = [i for i in np.argsort(cost, kind="stable")[:_KEPT] if np.isfinite(cost[i])]
    R, t = R[best], t[best]
    e = extents(p)
    if len(best) and e[2] <= COPLANAR * e[0]:
        flipped = _flipped(p, R, t)
        R, t = np.concatenate([R, flipped[0]]), np.concatenate([t, flipped[1]])
    return R, t


def _spread(p: Array, seen: Array, count: int) -> Longs:
    """Return `count` indices of spread points; views of fewer points give padding instead of the rest."""
    chosen = np.flatnonzero(seen > 0)[spread_subset(p[seen > 0], count)]
    padding = np.flatnonzero(seen == 0)[: count - len(chosen)]
    return np.concatenate([chosen, padding])


def _flipped(p: Array, R: Array, t: Array) -> tuple[Array, Array]:
    """Return the poses in which a flat target, seen from afar, looks the same: its depth profile reversed.

    With H the reflection that reverses the line of sight and P that of the target's plane, R' = H R P.
    """
    centre = p.mean(axis=0)
    normal = np.linalg.svd(p - centre)[2][2]
    c = R @ centre + t
    sight = c / np.linalg.norm(c, axis=1, keepdims=True)
    H = np.eye(3) - 2 * sight[:, :, None] * sight[:, None, :]
    turned = H @ R @ (np.eye(3) - 2 * np.outer(normal, normal))
    return turned, c - turned @ centre


def _descended(camera: Camera, views: PaddedViews, owner: Longs, R: Array, t: Array) -> tuple[Array, Array, Array]:
    """Levenberg-Marquardt on each pose by itself, all unconverged ones as one batch."""
    R, t, damping = R.copy(), t.copy(), np.full(len(R), 1e-4)
    cost, A, g = _normal_equations(camera, R, t, views, owner)
    moving = np.flatnonzero(np.isfinite(cost))
    for _ in range(_ITERATIONS):
        if not moving.size:
            break
        d = np.sqrt(np.einsum("nii->ni", A[moving]))
        d = np.where(d > 0, d, 1.0)
        S = A[moving] / (d[:, :, None] * d[:, None, :]) + damping[moving, None, None] * np.eye(6)
        step = -np.linalg.solve(S, (g[moving] / d)[..., None])[..., 0] / d
        R_new, t_new = R[moving] @ so3.exp(step[:, 3:]), t[moving] + (R[moving] @ step[:, :3, None])[..., 0]
        cost_new, A_new, g_new = _normal_equations(camera, R_new, t_new, views, owner[moving])
        better = cost_new < cost[moving]
        settled = better & (cost[moving] - cost_new <= _SETTLED * cost[moving])
        up = moving[better]
        for old, new in ((R, R_new), (t, t_new), (cost, cost_new), (A, A_new), (g, g_new)):
            old[up] = new[better]
        damping[moving] *= np.where(better, 0.1, 10.0)
        moving = moving[~settled & (damping[moving] < 1e6)]
    return so3.nearest(R), t, cost


def _normal_equations(
    camera: Camera, R: Array, t: Array, views: PaddedViews, owner: Longs
) -> tuple[Array, Array, Array]:
    seen = views.seen[owner]
    q, J = pose_jacobian(camera, R, t, views.p[owner])
    r = (q - views.q[owner]) * seen[..., None]
    cost = np.sum(r * r, axis=(1, 2))
    J = np.nan_to_num(J * seen[..., None, None]).reshape(len(R), -1, 6)
    g = (np.swapaxes(J, 1, 2) @ np.nan_to_num(r).reshape(len(R), -1, 1))[..., 0]
    return np.where(np.isfinite(cost), cost, np.inf), np.swapaxes(J, 1, 2) @ J, g


def _two_lowest(owner: Longs, n: int, R: Array, cost: Array) -> tuple[Longs, Longs]:
    """Return for each view the lowest minimum and the lowest distinct one, -1 where there is none."""
    first, second = np.full(n, -1), np.full(n, -1)
    for i in np.argsort(cost, kind="stable")[: np.count_nonzero(np.isfinite(cost))]:
        view = owner[i]
        if first[view] < 0:
            first[view] = i
        elif second[view] < 0 and np.linalg.norm(R[first[view]] - R[i]) > _APART:
            second[view] = i
    return first, second


def _ordered(R: Array, t: Array, cost: Array) -> TwoPoses:
    """Return both poses of every view, the lower first; two that converged to one count once."""
    same = np.linalg.norm(R[:, 0] - R[:, 1], axis=(1, 2)) <= _APART
    cost[same, 1] = np.inf
    order = np.argsort(cost, axis=1, kind="stable")
    rows = np.arange(len(R))[:, None]
    R, t, cost = R[rows, order], t[rows, order], cost[rows, order]
    alone = ~np.isfinite(cost[:, 1])
    R[alone, 1], t[alone, 1] = R[alone, 0], t[alone, 0]
    return TwoPoses(R, t, cost)
