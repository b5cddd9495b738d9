"""Would the model fit better if it were longer or shorter along an axis? Then it is another part, or in other units.

A pose fitted to a model of wrong proportions leaves most lines on edges of the photo; those at one end are off, and a
robust fit leaves them out. Lengths enter beside the pose, x' = c + diag(f) (x - c) with c the middle of what is seen.

1. Lines that the photo shows from end to end hold the pose: whatever f, it goes where those stay in place,
   J x = -K (f - 1) by least squares. So an axis has one number, and a range of it is tried on the steps that samples
   see far along their normals, like a Hough transform; a line counts by a power of its share that meets steps of one
   sign, for pieces of it meet print. Lengths that move the lines less than the first pull reaches are one trial.
2. The best are pulled onto the steps, as in `locate.lines.attraction`, all three lengths free but for their product:
   one photo does not tell a size from a distance.

On a model of right proportions nothing fits better than f = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, quantile
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import aligned
from cadcam.locate.lines.attraction import pulled_onto
from cadcam.locate.lines.sight import Sight
from cadcam.native.profiles import met

_ASKED = 300  # samples, of all photos together
_FAR, _FAR_PX = 0.16, (12.0, 48.0)  # how far lines are looked for: of the size of what is seen, within these px
_STEPS = 8  # steps of a profile that are kept
_ON_PX, _FAINT, _AROUND_PX = 2.0, 0.4, 6.0  # a sample meets a step so near, of those around nearly the strongest
_HOLDS, _COUNTS = 8, 3  # powers of a line's share: by which it holds the pose, and counts
_TRIED = np.exp(np.linspace(-0.25, 0.25, 25)) - 1  # f - 1
# What is looked at closer: f - 1 so large, and so much of the lines that meet steps now.
_NONE, _WORTH = 0.05, 0.9
_LOOKED_AT, _APART = 4, 0.06  # how many such, and how far apart
_PULLS = ((8, 3.5), (5, 1.5), (3, 0.7))  # reach and softness, px
_CLOSE = 3  # px: how far from a line its steps may be after it
_BACK = 0.03  # lengths that differ by less after the first pull are on their way back to those that were given
_USUAL, _OF_PULL, _SUM = 0.15, 0.25, 100.0  # sd of log f, what it weighs in samples, how much stiffer their sum is held


@dataclass(frozen=True, slots=True, eq=False)
class Stretched:
    """The samples of a model whose lengths (3,) are so many times those that were given, and the pose that fits it."""

    sights: Sequence[Sight]
    world_from_part: Rigid
    lengths: Array

    @property
    def by(self) -> float:
        """Return by how much the lengths differ from each other: 0.1 is a tenth."""
        return float(self.lengths.max() / self.lengths.min() - 1)

    def moved_px(self, sights: Sequence[Sight], pose: Rigid) -> float:
        """Return how far the lines, drawn in photos at a pose as the model was given, moved: nine tenths at most so."""
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
    """Return which lengths of the model fit the photos best near a pose free to move along B (6, k), columns of twists.

    Good to about a pixel; sights come back whole, with their samples moved. Where nothing fits better than the model
    as it is, they come back as they are.
    """
    few, k = [s.thinned(max(_ASKED // len(sights), 60)) for s in sights], B.shape[1]
    middle = _middle(sights)
    B = aligned(B, middle, sights[0].towards(middle, pose))
    far = _Seen(few, pose, np.zeros(3), B, middle, _far(few, pose))
    as_it_is, trials = _tried(far, k)
    pulled = [
        _pulled(few, pose @ Rigid.exp(B @ x), np.log1p(f), B, middle, None if f.any() else far) for x, f in trials
    ]
    away = any(np.ptp(s) >= _BACK for _, s in pulled)
    on = [_Seen(few, *pose_and_s, B, middle).met_now for pose_and_s in pulled] if away else []
    if max(on, default=0.0) <= as_it_is:
        return Stretched(sights, pose, np.ones(3))
    best, s = pulled[int(np.argmax(on))]
    return Stretched(_scaled(sights, middle, s), best, np.exp(s - s.mean()))


def _pulled(
    sights: Sequence[Sight], pose: Rigid, s: Array, B: Array, middle: Array, seen: _Seen | None
) -> tuple[Rigid, Array]:
    """Return the pose and logarithms of lengths after pulling the lines onto steps close by, first onto those seen."""
    k = B.shape[1]
    for reach, soft in _PULLS:
        seen = seen or _Seen(sights, pose, s, B, middle, reach)
        if not len(seen.J):
            break  # out of all photos
        stiff = np.zeros((k + 3, k + 3))
        stiff[k:, k:] = _OF_PULL * (soft / _USUAL) ** 2 * (np.eye(3) + _SUM * np.full((3, 3), 1 / 3))
        before = np.append(np.zeros(k), s - s.mean())
        step = pulled_onto(seen.J, seen.offset, seen.slope, soft=soft, stiff=(stiff, before))
        pose, s, seen = pose @ Rigid.exp(B @ step[:k]), s + step[k:], None
        if float(np.ptp(s)) < _BACK:
            break
    return pose, s


class _Seen:
    """How motions and lengths move the lines, J (N, k + 3), and where (N, M) steps are along them and how steep."""

    def __init__(
        self, sights: Sequence[Sight], pose: Rigid, s: Array, B: Array, middle: Array, reach: int = _CLOSE
    ) -> None:
        rows, offsets, slopes, runs, before = [], [], [], [], 0
        for sight in _scaled(sights, middle, s):
            at = sight.project(pose)
            found = sight.candidates(at.q, at.normal, half_length=2.0, reach=reach, most=_STEPS)
            by_place = at.row[:, :3]  # a twist's translation moves a point as the point itself
            row = np.concatenate([at.row @ B, by_place * (sight.samples.p - middle)], axis=1)
            some = np.isfinite(row).all(axis=1)
            rows.append(row[some])
            offsets.append(found.offset[some])
            slopes.append(found.slope[some])
            runs.append(before + sight.samples.run[some])
            before += int(sight.samples.run.max(initial=0)) + 1
        self.J, run = np.concatenate(rows), np.concatenate(runs)
        self.offset, self.slope = np.concatenate(offsets), np.concatenate(slopes)
        self.first = np.flatnonzero(np.diff(run, prepend=-1))
        self.of_run = np.diff(self.first, append=len(run))  # samples

    def shares(self, moved: Array) -> Array:
        """Return the share (T, R) of each line's samples that meet a step, all of one sign, moved by px (T, N)."""
        return met(self.offset, self.slope, self.first, moved, on=_ON_PX, faint=_FAINT, around=_AROUND_PX)

    def met(self, shares: Array) -> Array:
        """Return for how many samples (...) there are lines that meet steps, by their shares (..., R)."""
        return np.asarray(shares**_COUNTS @ self.of_run)

    @property
    def shares_now(self) -> Array:
        """Return the shares (R,) where the lines are."""
        return np.asarray(self.shares(np.zeros((1, len(self.J))))[0])

    @property
    def met_now(self) -> float:
        """Return for how many samples lines meet steps where they are."""
        return float(self.met(self.shares_now))


def _tried(seen: _Seen, k: int) -> tuple[float, list[tuple[Array, Array]]]:
    """Return how much of the lines meets steps as they are; motions (k,) and f - 1 (3,) of one axis that do better."""
    J, K = seen.J[:, :k], seen.J[:, k:]
    shares = seen.shares_now
    held = J * np.repeat(shares**_HOLDS, seen.of_run)[:, None]
    A = held.T @ J
    A[np.diag_indices(k)] += 1e-3 * np.diag(A) + 1e-300
    follows = -np.linalg.solve(A, held.T @ K)  # (k, 3)
    by_length = (K + J @ follows).T  # (3, N): how each line moves, px
    on = seen.met(seen.shares((_TRIED[:, None] * by_length[:, None]).reshape(-1, len(J)))).reshape(3, -1)
    as_it_is = float(seen.met(shares))
    far = np.array([quantile(np.abs(of_axis), 0.9) for of_axis in by_length])
    on[:, np.abs(_TRIED) < _NONE] = 0
    here = np.abs(_TRIED) * far[:, None] < _PULLS[0][1]  # the first pull reaches them from where the lines are
    better = [(np.zeros(k), np.zeros(3))] if on[here].max(initial=0) > _WORTH * as_it_is else []
    on[here] = 0
    while len(better) < _LOOKED_AT and on.max() > _WORTH * as_it_is:
        axis, best = np.unravel_index(int(np.argmax(on)), on.shape)
        better.append((follows[:, axis] * _TRIED[best], _TRIED[best] * np.eye(3)[axis]))
        on[axis, np.abs(_TRIED - _TRIED[best]) < _APART] = 0
    return as_it_is, better


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
    """Return how far (px) lines of a model of wrong proportions may be off, by the size of what is seen."""
    every = (s.project(pose).q for s in sights)
    inside = [q[some] for q in every if (some := np.isfinite(q).all(axis=1)).any()]
    size = max((float(np.hypot(*np.ptp(q, axis=0))) for q in inside), default=0.0)
    return int(np.clip(_FAR * size, *_FAR_PX))
