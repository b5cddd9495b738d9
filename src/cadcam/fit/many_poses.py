"""Poses of one known target in many views of one known camera, all views at once and without a guess.

A flat target may look nearly the same in two poses; both are returned, for what else is known (a robot's motions) to
choose. For a single view where only the picture counts, `cadcam.calibrate.points.locate_camera` searches harder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.fit.layout import COPLANAR, Indices, extents, triples
from cadcam.fit.p3p import p3p
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_TRIPLES, _KEPT, _ITERATIONS = 6, 3, 25
_APART = 0.01  # rad between two minima that count as two


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Points p (n, N, 3) mm and pixels q (n, N, 2) of n views, padded to the longest; seen (n, N): 1, padded 0."""

    p: Array
    q: Array
    seen: Array

    @classmethod
    def of(cls, points: Sequence[tuple[Array, Array]]) -> Views:
        """Return the views of lists of points (N_i, 3) and pixels (N_i, 2), padded with their first ones."""
        longest = max(len(p) for p, _ in points)
        index = [np.where(np.arange(longest) < len(p), np.arange(longest), 0) for p, _ in points]
        p = np.stack([p[i] for (p, _), i in zip(points, index, strict=True)])
        q = np.stack([q[i] for (_, q), i in zip(points, index, strict=True)])
        seen = np.stack([np.arange(longest) < len(p) for p, _ in points]).astype(np.float64)
        return cls(p, q, seen)

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

    def chosen(self, which: Array) -> Rigid:
        """Return camera_from_target (n) with pose 0 or 1 of each view by `which` (n,)."""
        rows = np.arange(len(which))
        return Rigid(self.rotation[rows, which], self.translation[rows, which])


def poses_of_views(camera: Camera, views: Views) -> TwoPoses:
    """Return camera_from_target of every view: three-point poses on spread triples and their flips, refined."""
    starts = [_starts(camera, p[s > 0], q[s > 0]) for p, q, s in zip(views.p, views.q, views.seen, strict=True)]
    owner = np.repeat(np.arange(len(views)), [len(R) for R, _ in starts])
    R, t = np.concatenate([R for R, _ in starts]), np.concatenate([t for _, t in starts])
    R, t, cost = _descended(camera, views, owner, R, t)
    out = TwoPoses(
        np.tile(np.eye(3), (len(views), 2, 1, 1)), np.zeros((len(views), 2, 3)), np.full((len(views), 2), np.inf)
    )
    for view in range(len(views)):
        mine = np.flatnonzero(owner == view)
        _fill(out, view, R[mine], t[mine], cost[mine])
    return out


def pose_jacobian(camera: Camera, R: Array, t: Array, p: Array) -> tuple[Array, Array]:
    """Return pixels q (B, N, 2) and dq/dxi (B, N, 2, 6) of camera_from_target @ exp(xi) for points p (B, N, 3)."""
    q, J = camera.project_with_jacobian(p @ np.swapaxes(R, -1, -2) + t[:, None])
    J = J @ R[:, None]
    return q, np.concatenate([J, np.cross(p[..., None, :], J)], axis=-1)


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


def _descended(camera: Camera, views: Views, owner: Indices, R: Array, t: Array) -> tuple[Array, Array, Array]:
    """Levenberg-Marquardt on each pose by itself, all as one batch."""
    p, target, seen = views.p[owner], views.q[owner], views.seen[owner]
    damping = np.full(len(R), 1e-4)
    cost, A, g = _normal_equations(camera, R, t, p, target, seen)
    for _ in range(_ITERATIONS):
        d = np.sqrt(np.einsum("nii->ni", A)) + 1e-300
        S = A / (d[:, :, None] * d[:, None, :]) + damping[:, None, None] * np.eye(6)
        step = -np.linalg.solve(S, (g / d)[..., None])[..., 0] / d
        R_new, t_new = R @ so3.exp(step[:, 3:]), t + (R @ step[:, :3, None])[..., 0]
        cost_new, A_new, g_new = _normal_equations(camera, R_new, t_new, p, target, seen)
        better = cost_new < cost
        gained = np.where(better & np.isfinite(cost), cost - cost_new, 0.0)
        for old, new in ((R, R_new), (t, t_new), (cost, cost_new), (A, A_new), (g, g_new)):
            old[better] = new[better]
        damping = np.where(better, damping / 10, damping * 10)
        if not (gained > 1e-9 * cost).any():
            break
    return so3.nearest(R), t, cost


def _normal_equations(
    camera: Camera, R: Array, t: Array, p: Array, target: Array, seen: Array
) -> tuple[Array, Array, Array]:
    q, J = pose_jacobian(camera, R, t, p)
    r = (q - target) * seen[..., None]
    cost = np.sum(r * r, axis=(1, 2))
    J = np.nan_to_num(J * seen[..., None, None]).reshape(len(R), -1, 6)
    g = (np.swapaxes(J, 1, 2) @ np.nan_to_num(r).reshape(len(R), -1, 1))[..., 0]
    return np.where(np.isfinite(cost), cost, np.inf), np.swapaxes(J, 1, 2) @ J, g


def _fill(out: TwoPoses, view: int, R: Array, t: Array, cost: Array) -> None:
    """Put the lowest minimum of one view and the lowest that is another one into their places."""
    order = [i for i in np.argsort(cost, kind="stable") if np.isfinite(cost[i])]
    if not order:
        return
    first = order[0]
    apart = [i for i in order if np.linalg.norm(so3.log(R[first].T @ R[i])) > _APART]
    for place, i in enumerate([first, *apart[:1]]):
        out.rotation[view, place], out.translation[view, place] = R[i], t[i]
        out.sum_of_squares[view, place] = cost[i]
    if not apart:
        out.rotation[view, 1], out.translation[view, 1] = R[first], t[first]
