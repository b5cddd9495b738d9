"""Would the model fit better if it were longer or shorter along an axis? Then it is another part, or in other units.

A pose fitted to a model of wrong proportions leaves most lines on edges of the photo; those at one end are off, and a
robust fit ignores them. Here scales are estimated beside the pose, x' = c + diag(f) (x - c), c the centre of what is
visible.

1. Lines that the photo shows from end to end hold the pose: for any f it is the one that keeps these in place,
   J x = -K (f - 1) by least squares. So each axis has one parameter. A range of it is tried on the steps found far
   along the samples' normals, as in a Hough transform. A line is weighted by a power of its share of samples that meet
   steps of one sign, because pieces of any line meet print. Scales that move the lines by less than the reach of the
   first pull are one trial.
2. The best are pulled onto the steps as in `locate.lines.attraction`, with all three scales free except for their
   product, as one photo does not distinguish size from distance.

On a model of right proportions nothing fits better than f = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cadcam.arrays import Array, quantile
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import aligned, carried
from cadcam.locate.lines.attraction import pulled_onto
from cadcam.locate.lines.sight import Sight
from cadcam.native.profiles import met

_ASKED = 300  # samples in all photos together
_FAR, _FAR_PX = 0.16, (12.0, 48.0)  # search range: share of the size of what is visible, limits
_STEPS = 8  # steps kept per profile
_ON_PX, _FAINT, _AROUND_PX = 2.0, 0.4, 6.0  # a sample meets a step: within px, of this share of the strongest within px
_HOLDS, _COUNTS = 8, 3  # powers of a line's share: its weight in holding the pose, and in the count
_TRIED = np.exp(np.linspace(-0.25, 0.25, 25)) - 1  # values of f - 1
# Trials looked at closer: least |f - 1|, and least share of lines that meet steps now.
_NONE, _WORTH = 0.05, 0.9
_LOOKED_AT, _APART = 4, 0.06  # most such trials, and least difference between them
_PULLS = ((8, 3.5), (5, 1.5), (3, 0.7))  # reach and softness of successive pulls, px
_CLOSE = 3  # px: largest distance between a line and its steps afterwards
_BACK = 0.03  # scales that differ by less after the first pull are returning to the given ones
_USUAL, _OF_PULL, _SUM = 0.15, 0.25, 100.0  # sd of log f; its weight in samples; stiffness of their sum


@dataclass(frozen=True, slots=True, eq=False)
class Stretched:
    """The samples of a model scaled by lengths (3,) along its axes, and the pose that fits it."""

    sights: Sequence[Sight]
    world_from_part: Rigid
    lengths: Array

    @property
    def by(self) -> float:
        """Return the largest difference between the scales: 0.1 is a tenth."""
        return float(self.lengths.max() / self.lengths.min() - 1)

    def moved_px(self, sights: Sequence[Sight], pose: Rigid) -> float:
        """Return how far the lines of the model as given, drawn at a pose, moved: the 90th percentile, px."""
        moved = []
        for before, now in zip(sights, self.sights, strict=True):
            was, at = before.project(pose), now.project(self.world_from_part)
            moved.append(np.abs(((at.q - was.q) * was.normal).sum(axis=1)))
        every = np.concatenate(moved)
        every = every[np.isfinite(every)]
        return quantile(every, 0.9) if len(every) else 0.0

    def __str__(self) -> str:
        s = np.log(self.lengths)
        odd = int(np.argmax(np.abs(s - np.median(s))))
        ratio = float(np.exp(s[odd] - np.delete(s, odd).mean()))
        return f"{abs(ratio - 1):.0%} {'longer' if ratio > 1 else 'shorter'} along its {'xyz'[odd]} axis"


def stretched(sights: Sequence[Sight], pose: Rigid, B: Array) -> Stretched:
    """Return the scales with which the model fits the photos best near a pose free along B (6, k), columns of twists.

    Accurate to about a pixel; sights are returned whole, with their samples moved. Where nothing fits better than the
    model as it is, they are returned unchanged.
    """
    few, middle = [s.thinned(max(_ASKED // len(sights), 60)) for s in sights], _middle(sights)
    model = _Stretchable(few, aligned(B, middle, sights[0].towards(middle, pose)), middle)
    far = model.steps(pose, np.zeros(3), _far(few, pose))
    pulled = [
        model.pulled(model.carried(pose, x), np.log1p(f), None if f.any() else far)
        for x, f in _promising(far, B.shape[1])
    ]
    away = any(np.ptp(s) >= _BACK for _, s in pulled)
    on = [model.steps(*pose_and_s).met_now for pose_and_s in pulled] if away else []
    if max(on, default=0.0) <= far.met_now:
        return Stretched(sights, pose, np.ones(3))
    best, s = pulled[int(np.argmax(on))]
    return Stretched(_scaled(sights, middle, s), best, np.exp(s - s.mean()))


@dataclass(frozen=True, slots=True, eq=False)
class _Stretchable:
    """A part's lines that are scaled about a point `middle` (3,), at poses free along B (6, k).

    s (3,) is everywhere the logarithm of the scales along the axes.
    """

    sights: Sequence[Sight]
    B: Array
    middle: Array

    def steps(self, pose: Rigid, s: Array, reach: int = _CLOSE) -> _LineSteps:
        """Return the steps within `reach` px of the scaled lines."""
        return _LineSteps(_scaled(self.sights, self.middle, s), pose, self.B, self.middle, reach)

    def carried(self, pose: Rigid, x: Array) -> Rigid:
        """Return the pose moved by x (k,)."""
        return carried(pose, self.B, x, self.middle)

    def pulled(self, pose: Rigid, s: Array, seen: _LineSteps | None = None) -> tuple[Rigid, Array]:
        """Return the pose and scales after pulling the lines onto steps nearby, those already seen there first."""
        k = self.B.shape[1]
        for reach, soft in _PULLS:
            seen = seen or self.steps(pose, s, reach)
            if not len(seen.J):
                break  # out of all photos
            stiff = np.zeros((k + 3, k + 3))
            stiff[k:, k:] = _OF_PULL * (soft / _USUAL) ** 2 * (np.eye(3) + _SUM * np.full((3, 3), 1 / 3))
            before = np.append(np.zeros(k), s - s.mean())
            step = pulled_onto(seen.J, seen.offset, seen.slope, soft=soft, stiff=(stiff, before))
            pose, s, seen = self.carried(pose, step[:k]), s + step[k:], None
            if float(np.ptp(s)) < _BACK:
                break
        return pose, s


class _LineSteps:
    """Derivative J (N, k + 3) of the lines by motions and scales, and steps (N, M): places along normals, slopes."""

    def __init__(self, sights: Sequence[Sight], pose: Rigid, B: Array, middle: Array, reach: int) -> None:
        rows, offsets, slopes, runs, before = [], [], [], [], 0
        for sight in sights:
            at = sight.project(pose)
            found = sight.candidates(at.q, at.normal, half_length=2.0, reach=reach, most=_STEPS)
            by_place = at.row[:, :3]  # a twist's translation moves a point as the point itself
            row = np.concatenate([at.row @ B, by_place * (sight.samples.p - middle)], axis=1)
            some = np.isfinite(row).all(axis=1)
            rows.append(row[some])
            offsets.append(found.offset[some])
            slopes.append(found.slope[some])
            runs.append(before + sight.samples.arc[some])
            before += int(sight.samples.arc.max(initial=0)) + 1
        self.J, run = np.concatenate(rows), np.concatenate(runs)
        self.offset, self.slope = np.concatenate(offsets), np.concatenate(slopes)
        self.first = np.flatnonzero(np.diff(run, prepend=-1))
        self.of_run = np.diff(self.first, append=len(run))  # samples

    def shares(self, moved: Array) -> Array:
        """Return the share (T, R) of each line's samples that meet steps of one sign when moved by px (T, N)."""
        return met(self.offset, self.slope, self.first, moved, on=_ON_PX, faint=_FAINT, around=_AROUND_PX)

    def met(self, shares: Array) -> Array:
        """Return the number of samples on lines that meet steps, given the lines' shares (..., R)."""
        return np.asarray(shares**_COUNTS @ self.of_run)

    @cached_property
    def shares_now(self) -> Array:
        """Return the shares (R,) at the lines' present places."""
        return np.asarray(self.shares(np.zeros((1, len(self.J))))[0])

    @cached_property
    def met_now(self) -> float:
        """Return the number of samples on lines that meet steps at their present places."""
        return float(self.met(self.shares_now))


def _promising(seen: _LineSteps, k: int) -> list[tuple[Array, Array]]:
    """Return motions (k,) and f - 1 (3,) along one axis with which the lines meet steps about as now or better.

    All scales that the first pull reaches from the present places are one trial: no motion and f = 1.
    """
    motions, by_length = _kept_in_place(seen, k, seen.shares_now)
    moved = _TRIED[:, None] * by_length[:, None]  # (axes, values tried, N)
    met = seen.met(seen.shares(moved.reshape(-1, moved.shape[2]))).reshape(3, -1)
    enough = _WORTH * seen.met_now
    met[:, np.abs(_TRIED) < _NONE] = 0
    far = np.array([quantile(np.abs(of_axis), 0.9) for of_axis in by_length])
    in_reach = np.abs(_TRIED) * far[:, None] < _PULLS[0][1]
    trials = [(np.zeros(k), np.zeros(3))] if met[in_reach].max(initial=0) > enough else []
    met[in_reach] = 0
    while len(trials) < _LOOKED_AT and met.max() > enough:
        axis, best = np.unravel_index(int(np.argmax(met)), met.shape)
        trials.append((motions[:, axis] * _TRIED[best], _TRIED[best] * np.eye(3)[axis]))
        met[axis, np.abs(_TRIED - _TRIED[best]) < _APART] = 0
    return trials


def _kept_in_place(seen: _LineSteps, k: int, shares: Array) -> tuple[Array, Array]:
    """Return the motions (k, 3) per f - 1 that keep lines in place which the photo shows, by their shares (R,).

    And the movement (3, N) px of each line then.
    """
    J, K = seen.J[:, :k], seen.J[:, k:]
    weighted = J * np.repeat(shares**_HOLDS, seen.of_run)[:, None]
    A = weighted.T @ J
    A[np.diag_indices(k)] += 1e-3 * np.diag(A) + 1e-300
    motions = -np.linalg.solve(A, weighted.T @ K)
    return motions, (K + J @ motions).T


def _scaled(sights: Sequence[Sight], middle: Array, s: Array) -> list[Sight]:
    if not s.any():
        return list(sights)
    lengths, out = np.exp(s), []
    for sight in sights:
        samples = sight.samples
        tangent = samples.tangent * lengths
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
        moved = replace(samples, p=middle + (samples.p - middle) * lengths, tangent=tangent)
        out.append(replace(sight, samples=moved))
    return out


def _middle(sights: Sequence[Sight]) -> Array:
    p = np.concatenate([s.samples.p for s in sights])
    return np.asarray((p.min(axis=0) + p.max(axis=0)) / 2)


def _far(sights: Sequence[Sight], pose: Rigid) -> int:
    """Return how far (px) lines of a model of wrong proportions may be off, given the size of what is visible."""
    every = (s.project(pose).q for s in sights)
    inside = [q[some] for q in every if (some := np.isfinite(q).all(axis=1)).any()]
    size = max((float(np.hypot(*np.ptp(q, axis=0))) for q in inside), default=0.0)
    return int(np.clip(_FAR * size, *_FAR_PX))
