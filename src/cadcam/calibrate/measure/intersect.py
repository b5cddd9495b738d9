"""Intersection of the rays of several pixels, with first-order propagation: the arithmetic behind `measure_points`.

For one point let r be its pixels minus the image of its estimate, J the derivative of these pixels by the point, D_s
that by the parameters of an error source s (a calibration, a motion) with covariance C_s. The pixels' covariance is
then S = sigma^2 I + sum D_s C_s D_s^T, and to first order the point moves by G (dq - sum D_s dtheta_s) with

    G = (J^T S^-1 J)^-1 J^T S^-1    for the optimum of reprojection, the estimate of least variance,
    G = A^-1 [P_v J_v^+]            for the point nearest to all rays, A = sum P_v, P_v across ray v.

The least r^T S^-1 r over the point is its misfit, chi-square with 2 V - 3 degrees of freedom for V cameras.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.camera.error_source import ErrorSource, distinct_sources, index_of
from cadcam.camera.viewpoint import Viewpoint
from cadcam.geometry.plane import Plane
from cadcam.geometry.ray import Ray, nearest_to_all
from cadcam.kinds import expect_positive

_USELESS = 1 / 3  # standard deviation over distance beyond which first-order propagation is meaningless
_ONE_PLACE = 1e-9  # distance of viewpoints over their distance from the world's origin: rounding
_SETTLED = 1e-10  # step over distance at convergence
_ROUNDING = 1e-14  # of the coordinates: how far rounding alone moves a point; far from the origin it decides
_ITERATIONS = 50
_FARTHEST = 1e6  # displacement over distance beyond which a point has diverged

Reason = Callable[[int], str]
Refuse = Callable[[Mask, Reason], None]


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The plane that the points lie on, with the error of its height as a source.

    An exact height leaves a point two directions; an uncertain one is one more equation, weighted with the pixels.
    """

    plane: Plane
    sigma_mm: float
    source: ErrorSource = field(init=False)

    def __post_init__(self) -> None:
        expect_positive(self.sigma_mm, "plane_sigma_mm", "a number of mm from 0 on", zero=True)
        source = ErrorSource("height of the plane", np.array([[self.sigma_mm**2]]), self.plane)
        object.__setattr__(self, "source", source)

    @property
    def basis(self) -> Array:
        """Return the directions (3, 2), or (3, 3) if the height is not exact, in which points may move."""
        return np.eye(3) if self.sigma_mm > 0 else self.plane.basis


@dataclass(frozen=True, slots=True, eq=False)
class SharedView:
    """n points seen from the same V viewpoints: their rows in the whole, and their pixels (V, n, 2)."""

    viewpoints: tuple[Viewpoint, ...]
    rows: Longs
    q: Array
    surface: Surface | None

    @property
    def sources(self) -> list[ErrorSource]:
        """Return the error sources of the viewpoints and of the plane, each once."""
        height = [] if self.surface is None or self.surface.sigma_mm == 0 else [self.surface.source]
        return distinct_sources([source for view in self.viewpoints for source, _ in view.errors] + height)

    @property
    def _height_row(self) -> bool:
        return self.surface is not None and self.surface.sigma_mm > 0

    @property
    def rays(self) -> Ray:
        """Return the rays (n, V)."""
        each = [view.rays(q) for view, q in zip(self.viewpoints, self.q, strict=True)]
        return Ray(np.stack([r.origin for r in each], axis=1), np.stack([r.direction for r in each], axis=1))

    @property
    def across(self) -> Array:
        """Return the projections (n, V, 3, 3) across the rays."""
        v = self.rays.direction
        return np.asarray(np.eye(3) - v[..., :, None] * v[..., None, :])

    def only(self, keep: Mask) -> SharedView:
        """Return the group with some of its points."""
        return replace(self, rows=self.rows[keep], q=self.q[:, keep])

    def start(self) -> Array:
        """Return the points (n, 3) nearest to all rays, or on the plane; NaN where there is none."""
        if len(self.viewpoints) == 1 and self.surface is not None:
            return self.surface.plane.meet(self.viewpoints[0].rays(self.q[0]))
        p = nearest_to_all(self.rays)
        return p if self.surface is None else self.surface.plane.foot(p)

    def seen(self, p: Array) -> LinearisedRays:
        """Return the images of points (n, 3) near the measured ones, linearised."""
        n, rows, sources = len(p), len(self.noise), self.sources
        r, J = np.zeros((n, rows)), np.zeros((n, rows, 3))
        by_source = [np.zeros((n, rows, len(s.covariance))) for s in sources]
        for i, (view, q) in enumerate(zip(self.viewpoints, self.q, strict=True)):
            at = slice(2 * i, 2 * i + 2)
            seen, J[:, at], effects = view.project(p)
            r[:, at] = q - seen
            for (source, _), D in zip(view.errors, effects, strict=True):
                by_source[index_of(sources, source)][:, at] += D
        if self.surface is not None and self._height_row:
            r[:, -1], J[:, -1] = -self.surface.plane.distance(p), self.surface.plane.normal
            by_source[index_of(sources, self.surface.source)][:, -1] = -1.0
        own = np.broadcast_to(np.diag(np.sqrt(self.noise)), (n, rows, rows))
        roots = [D @ source.root for source, D in zip(sources, by_source, strict=True)]
        return LinearisedRays(r, J, by_source, np.concatenate([own, *roots], axis=-1))

    def residuals(self, p: Array) -> Array:
        """Return the residuals of `seen` (n, m) alone."""
        views = zip(self.viewpoints, self.q, strict=True)
        parts = [q - view.camera.project(view.camera_from_world @ p) for view, q in views]
        if self.surface is not None and self._height_row:
            parts.append(-self.surface.plane.distance(p)[:, None])
        return np.concatenate(parts, axis=-1)

    @property
    def noise(self) -> Array:
        """Return the variances (rows,) of the equations' own noise: px^2, and 0 for the height of a plane."""
        pixels = np.repeat([view.sigma_px**2 for view in self.viewpoints], 2)
        return np.append(pixels, 0.0) if self._height_row else pixels


@dataclass(frozen=True, slots=True, eq=False)
class LinearisedRays:
    """At points (n, 3): residuals r (n, m), J (n, m, 3), by source (n, m, k), root B (n, m, ...) of S = B B^T.

    m = 2 V pixel coordinates, and the height (mm) over the plane where that is not exact.
    """

    r: Array
    J: Array
    by_source: list[Array]
    root: Array

    def whitened(self) -> tuple[Array, Array, Array]:
        """Return r and J in units of their standard deviation, and the triangular L with L L^T = S that scaled them.

        L comes from the root itself: S would lose the pixels' noise next to a camera that the point is very close to.
        """
        L = np.swapaxes(np.linalg.qr(np.swapaxes(self.root, -1, -2), mode="r"), -1, -2)
        r, J = np.linalg.solve(L, self.r[..., None])[..., 0], np.linalg.solve(L, self.J)
        return np.asarray(r), np.asarray(J), np.asarray(L)

    def back(self, view: int) -> Array:
        """Return J_v^+ (n, 3, 2): the displacement across its ray for a unit error of the pixel."""
        return np.asarray(np.linalg.pinv(self.J[:, 2 * view : 2 * view + 2]))


@dataclass(frozen=True, slots=True, eq=False)
class MeetingPoints:
    """Measured points of a group: points p (n, 3), gain G (n, 3, m), misfit (n,), and the linearised images."""

    p: Array
    gain: Array
    chi2: Array
    seen: LinearisedRays


def solve(group: SharedView, *, by_rays: bool, refuse: Refuse) -> MeetingPoints:
    """Return the points of a group that has a start for every point, by rays or by weighted reprojection.

    Points without a converged optimum, or with a useless one, are refused; their numbers are still in the result.
    """
    p = group.start()
    if not by_rays:
        p, stuck = _optimum(group, p)
        refuse(stuck, lambda _: "the search for its best place does not settle: its pixels contradict each other")
    seen = group.seen(p)
    r, J, L = seen.whitened()
    basis = _basis(group)
    Q, R = np.linalg.qr(J @ basis)
    Qt = np.swapaxes(Q, -1, -2)
    gain = _gain_of_rays(group, seen) if by_rays else basis @ np.linalg.solve(R, Qt @ np.linalg.inv(L))
    misfit = np.sum(r**2, axis=-1) - np.sum((Qt @ r[..., None])[..., 0] ** 2, axis=-1)
    found = MeetingPoints(p, gain, np.maximum(misfit, 0.0), seen)
    _refuse_useless(group, found, refuse)
    return found


def startless(group: SharedView, refuse: Refuse) -> Mask:
    """Refuse points (n,) without a start, behind a camera or where its lens images nothing; return which."""
    p, rays = group.start(), group.rays
    bad, why = _nowhere(group, p)
    refuse(bad, lambda _: why)
    p = np.where(bad[:, None], rays.at(np.ones(rays.origin.shape[:2]))[:, 0], p)
    for v, view in enumerate(group.viewpoints):
        along = np.sum((p - rays.origin[:, v]) * rays.direction[:, v], axis=-1)
        behind = np.asarray((along <= 0) & ~bad)
        refuse(behind, _behind(along, view.name))
        bad = bad | behind
        unseen = np.asarray(~np.isfinite(view.camera.project(view.camera_from_world @ p)).all(axis=1) & ~bad)
        refuse(unseen, _unseen(view.name))
        bad = bad | unseen
    return bad


def _behind(along: Array, name: str) -> Reason:
    return lambda i: f"its rays meet {-along[i]:.4g} mm behind {name!r}"


def _unseen(name: str) -> Reason:
    return lambda _: f"its rays meet where the lens of {name!r} images nothing"


def _nowhere(group: SharedView, p: Array) -> tuple[Mask, str]:
    """Return which points (n,) have no start p, and why."""
    centres = np.array([view.camera_from_world.origin for view in group.viewpoints])
    names = ", ".join(repr(view.name) for view in group.viewpoints)
    if len(centres) == 1:
        why = f"its ray from {names} does not meet the plane in front of the camera"
    elif group.surface is None and np.ptp(centres, axis=0).max() <= _ONE_PLACE * (1 + np.abs(centres).max()):
        why = f"its viewpoints {names} stand at one place: no base to see its distance from"
        return np.ones(len(p), dtype=bool), why
    else:
        why = "its rays are parallel: they meet nowhere"
    return np.asarray(~np.isfinite(p).all(axis=1)), why


def widest(group: SharedView, found: MeetingPoints) -> tuple[Array, Array, Array]:
    """Return for each point the gap (mm) and its sigma of the pair of rays farthest apart, and the largest angle."""
    rays, n = group.rays, len(group.rows)
    gap, sigma, angle = (np.full(n, np.nan) for _ in range(3))
    for i, j in combinations(range(len(group.viewpoints)), 2):
        near = Ray(rays.origin[:, i], rays.direction[:, i]).approach(Ray(rays.origin[:, j], rays.direction[:, j]))
        link = np.cross(rays.direction[:, i], rays.direction[:, j])
        with np.errstate(all="ignore"):
            link = link / np.linalg.norm(link, axis=-1, keepdims=True)
        rows = [2 * i, 2 * i + 1, 2 * j, 2 * j + 1]
        part = (link[:, None, :] @ np.concatenate([found.seen.back(i), -found.seen.back(j)], axis=-1))[:, 0]
        spread = np.linalg.norm((part[:, None, :] @ found.seen.root[:, rows])[:, 0], axis=-1)
        wider = ~(near.gap <= gap)
        gap, sigma = np.where(wider, near.gap, gap), np.where(wider, spread, sigma)
        angle = np.fmax(angle, np.minimum(near.angle, np.pi - near.angle))
    return gap, sigma, angle


def _optimum(group: SharedView, p: Array) -> tuple[Array, Mask]:
    """Return the weighted reprojection optima from points p (n, 3), and which did not converge: those stay at p.

    A point that leaves the scene has not converged either: its numbers overflow.
    """
    start = p
    reach = np.linalg.norm(p - group.viewpoints[0].camera_from_world.origin, axis=1)
    stuck, basis = np.ones(len(p), dtype=bool), _basis(group)
    for _ in range(_ITERATIONS):
        r, J, L = group.seen(p).whitened()
        Q, R = np.linalg.qr(J @ basis)
        step = (basis @ np.linalg.solve(R, np.swapaxes(Q, -1, -2) @ r[..., None]))[..., 0]
        rounding = _ROUNDING * np.linalg.norm(p, axis=1)
        cost = np.sum(r**2, axis=-1)
        with np.errstate(over="ignore", invalid="ignore"):  # next to a focal plane a step may overflow
            allowed = cost * (1 + 1e-9) + 1e-18 + 2 * np.sqrt(cost) * np.linalg.norm(J, axis=(1, 2)) * rounding
            p = p + _shortened(group, p, step, allowed, L)
            stuck = ~(np.linalg.norm(step, axis=1) <= _SETTLED * reach + rounding)
        if not stuck.any():
            break
    stuck |= ~(np.linalg.norm(p - start, axis=1) <= _FARTHEST * reach)
    return np.where(stuck[:, None], start, p), stuck


def _shortened(group: SharedView, p: Array, step: Array, allowed: Array, L: Array) -> Array:
    """Return the steps (n, 3), each quartered until the misfit is at most `allowed` and all cameras see the point."""
    share = np.ones((len(p), 1))
    for _ in range(12):
        r = np.linalg.solve(L, group.residuals(p + share * step)[..., None])[..., 0]
        worse = ~(np.sum(r**2, axis=-1) <= allowed)
        if not worse.any():
            break
        share = np.where(worse[:, None], share / 4, share)
    return np.where(worse[:, None], 0.0, share * step)


def _basis(group: SharedView) -> Array:
    """Return the directions (3, 3), or (3, 2) on a plane, in which the points may move."""
    return np.eye(3) if group.surface is None else group.surface.basis


def _gain_of_rays(group: SharedView, seen: LinearisedRays) -> Array:
    across = group.across
    each = [across[:, v] @ seen.back(v) for v in range(len(group.viewpoints))]
    return np.asarray(np.linalg.solve(across.sum(axis=1), np.concatenate(each, axis=-1)))


def _refuse_useless(group: SharedView, found: MeetingPoints, refuse: Refuse) -> None:
    """Refuse points of practically unknown distance: first-order sigmas would be meaningless."""
    sigma = np.linalg.norm(found.gain @ found.seen.root, ord=2, axis=(-2, -1))
    reach = np.linalg.norm(found.p - np.array([v.camera_from_world.origin for v in group.viewpoints])[:, None], axis=-1)
    near = reach.min(axis=0)
    angle = np.degrees(widest(group, found)[2])

    def reason(i: int) -> str:
        several = len(group.viewpoints) > 1
        what = f"its rays are nearly parallel ({angle[i]:.2g} deg)" if several else "its ray grazes the plane"
        return f"{what}: +- {sigma[i]:.3g} mm at a distance of {near[i]:.4g} mm is no measurement"

    refuse(sigma > _USELESS * near, reason)
