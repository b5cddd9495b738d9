"""The global minimum of a reprojection problem without a guess: many deterministic starts, descended together.

Starts are the solutions of the perspective three-point problem on well-spread triples, rotations spread evenly over
all of SO(3), and whatever the caller adds (the direct linear transform). benchmarks/pose_global.py compares the
outcome with hundreds of random starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.extended_pinhole import EXTERNALS, camera_of
from cadcam.errors import NotConverged
from cadcam.fit.camera_model import CameraModel, angles, rotations_of
from cadcam.fit.extents import spread_subset, triples
from cadcam.fit.least_squares import Options, Solution, minimise
from cadcam.fit.multistart import descend
from cadcam.fit.p3p import p3p
from cadcam.geometry import rotation as so3

_OTHERS = 50  # most iterations of a state that is descended after one that has reached its minimum


@dataclass(frozen=True, slots=True)
class Effort:
    """The effort of the search. The defaults find all optima of benchmarks/pose_global.py with a margin; see its table.

    triples, keep: three-point problems solved, and how many of their poses are minimised (those of least residual).
    spread: evenly spread rotations. screen: points used until the basins are known. survivors: basins refined.
    """

    triples: int = 20
    keep: int = 12
    spread: int = 24
    screen: int = 40
    survivors: int = 6
    iterations: int = 30


def minima(
    model: CameraModel,
    internals: Array,
    *,
    fixed: Mapping[str, float] | None = None,
    extra: Array | None = None,
    effort: Effort | None = None,
) -> list[Solution[Array]]:
    """Return the different local minima found, the lowest first, each converged to rounding.

    internals (M, 5): the internals to start from, all of them in turn; fixed: the fixed among the externals, mm and
    rad; extra (S, k): further starts. Raises `NotConverged` if no start images all points.
    """
    effort = Effort() if effort is None else effort
    small = model.with_points(spread_subset(np.column_stack([model.p_world, model.q]), effort.screen))
    states = _starts(small, internals, fixed or {}, effort)
    if extra is not None and len(extra):
        states = np.concatenate([states, extra])
    states, costs = descend(small, states[np.isfinite(small.costs(states))], effort.iterations)
    if len(small.q) < len(model.q):
        states = states[_apart(states, costs)[: effort.survivors]]
        states, costs = descend(model, states, effort.iterations)
    return polished(model, states[_apart(states, costs)[: effort.survivors]])


def polished(model: CameraModel, states: Array) -> list[Solution[Array]]:
    """Return the different minima that states (S, k) lead to, the lowest first; `NotConverged` if there is none.

    After the first, those that creep are left: nearly all of them end at the first one, at several times its cost.
    """
    floor = Options(floor=1e-15 * float(np.abs(model.q).max(initial=0.0) + 1))
    found: list[Solution[Array]] = []
    failure = NotConverged("no pose found from which every point is imaged; are points and pixels in the same order?")
    for state in states:
        try:
            found.append(minimise(model, state, replace(floor, max_iterations=_OTHERS) if found else floor))
        except NotConverged as error:  # no loss while another start converges
            failure = error
    if not found:
        raise failure
    costs = np.array([s.sum_of_squares for s in found])
    return [found[i] for i in _apart(np.stack([s.state for s in found]), costs)]


def _starts(model: CameraModel, internals: Array, fixed: Mapping[str, float], effort: Effort) -> Array:
    """Poses for each row of internals; where internals are free too, the pose alone descends first."""
    externals = {n: v for n, v in fixed.items() if n in EXTERNALS}
    states = np.concatenate([_pose_starts(model, i, externals, effort) for i in internals])
    pose_only = tuple(n for n in model.free if n in EXTERNALS)
    if pose_only and pose_only != model.free:
        states = states[np.isfinite(model.costs(states))]
        states, _ = descend(replace(model, free=pose_only), states, effort.iterations // 2)
    return states


def _pose_starts(model: CameraModel, internals: Array, externals: Mapping[str, float], effort: Effort) -> Array:
    camera = camera_of(internals, (1, 1), model.lens)
    rays = camera.unproject(model.q)
    spread = _spread_starts(model, internals, rays, externals, effort.spread * (8 if externals else 1))
    if externals:
        return spread
    seen = np.flatnonzero(np.isfinite(rays).all(axis=1))
    pick = (
        seen[triples(model.p_world[seen], model.q[seen], effort.triples)] if len(seen) >= 3 else np.zeros((0, 3), int)
    )
    F, R = p3p(model.p_world[pick], rays[pick])
    exact = model.states(F, R, internals)
    exact = exact[np.argsort(model.costs(exact), kind="stable")[: effort.keep]]
    return np.concatenate([exact, spread])


def _spread_starts(
    model: CameraModel, internals: Array, rays: Array, externals: Mapping[str, float], count: int
) -> Array:
    """Return views of the points' centre from all sides, at distances where they have their observed size."""
    seen = rays[np.isfinite(rays).all(axis=1)]
    aim = seen.mean(axis=0) if len(seen) else np.array([0.0, 0.0, 1.0])
    aim = aim / np.linalg.norm(aim)
    centre = model.p_world.mean(axis=0)
    radius = np.linalg.norm(model.p_world - centre, axis=1)
    angle = np.sqrt(np.mean(np.sum((seen - aim) ** 2, axis=1))) if len(seen) else 0.3
    distance = max(np.sqrt(np.mean(radius**2)) / max(angle, 1e-9), 1.2 * radius.max())
    R = spread_rotations(count)
    F = centre - distance * (np.swapaxes(R, -1, -2) @ aim)
    F, R = _imposed(F, R, centre, aim, externals)
    return model.states(F, R, internals)


def _imposed(F: Array, R: Array, centre: Array, aim: Array, externals: Mapping[str, float]) -> tuple[Array, Array]:
    """Set fixed coordinates and angles; where only some are fixed, turn the camera to look at the points again."""
    for i, name in enumerate(("X", "Y", "Z")):
        if name in externals:
            F[:, i] = externals[name]
    if any(name in externals for name in ("X", "Y", "Z")):
        R = _turn_to(R @ ((centre - F) / np.linalg.norm(centre - F, axis=1, keepdims=True))[..., None], aim) @ R
    held = [i for i, name in enumerate(("a", "b", "c")) if name in externals]
    if held:
        abc = angles(R)
        abc[:, held] = [externals["abc"[i]] for i in held]
        R = rotations_of(abc)
        if not any(name in externals for name in ("X", "Y", "Z")):
            F = centre - np.linalg.norm(F - centre, axis=1, keepdims=True) * (np.swapaxes(R, -1, -2) @ aim)
    return F, R


def _turn_to(u: Array, aim: Array) -> Array:
    """Rotations (B, 3, 3) that take unit vectors u (B, 3, 1) to `aim` by the shortest way."""
    u = u[..., 0]
    axis = np.cross(u, aim)
    sine, cosine = np.linalg.norm(axis, axis=-1, keepdims=True), (u @ aim)[:, None]
    unit = np.where(
        sine > 1e-12, axis / np.where(sine > 1e-12, sine, 1.0), np.cross(aim, np.eye(3)[np.argmin(np.abs(aim))])
    )
    return so3.exp(unit / np.linalg.norm(unit, axis=-1, keepdims=True) * np.arctan2(sine, cosine))


def spread_rotations(count: int) -> Array:
    """Return rotations (count, 3, 3) spread evenly over SO(3): the super-Fibonacci spiral (Alexa, CVPR 2022)."""
    i = np.arange(count) + 0.5
    inner, outer = np.sqrt(i / count), np.sqrt(1 - i / count)
    alpha, beta = 2 * np.pi * i / np.sqrt(2.0), 2 * np.pi * i / 1.533751168755204288118041
    q = np.stack([inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)], axis=-1)
    return so3.from_quaternion(q)


def _apart(states: Array, costs: Array) -> list[int]:
    """Return the indices of distinct states of finite cost, by cost; one near a better one is the same."""
    order = [int(i) for i in np.argsort(costs, kind="stable") if np.isfinite(costs[i])]
    kept: list[int] = []
    for i in order:
        if not any(_same(states[i], states[j]) for j in kept):
            kept.append(i)
        if len(kept) >= 64:
            break
    return kept


def _same(s: Array, t: Array) -> bool:
    return bool(
        np.linalg.norm(s[3:12] - t[3:12]) < 1e-3
        and np.linalg.norm(s[:3] - t[:3]) <= 1e-3 * (np.linalg.norm(t[:3]) + 1)
        and (np.abs(s[12:17] - t[12:17]) <= 1e-3 * (np.abs(t[12:17]) + 1)).all()
    )
