"""The displacement of a body whose feet follow it only to one side of their ground: up from it, not down into it.

A foot is where a side of the body meets the ground, of normal b. The displacement d of a body that is lifted, or slides
(b . d >= 0), takes the line along, by G d in the photo. A body that sinks moves relative to the line by the lever l per
mm, so that the line moves by (G - l b) d. Its motion is thus a continuous function of d, linear on each side of the
ground. The sides are weighted by Bayes' rule: with the probability of the offsets on each side, times the probability
that the displacement estimated there lies on that side. The estimate is the mean over sides, and the differences
between sides add to its covariance.

A body that turns moves by d + w x a at a place a from the middle of its places; its feet rise or sink together. Where
its turn is judged, one that tilts and sinks as well is taken for it only if it is so much the more probable: what a
tilt does to the lines of feet, sinking by as much takes back. One that stays upright may well sink: as far as that
explains more than that its feet follow. By one photo a rib that tips looks like one that sinks. A body that tips may
also sink by some of its feet alone, which rise to one side and sink to the other: again linear in each part.

Where a shift alone leaves the edges in disagreement, the body may have turned as well. Both are weighed, each with the
probability of the offsets if motions are as large as they are usually; both sides of the ground are as probable
beforehand, and so are turns about the upright alone. d is that of the middle of the places, where it depends least on
the turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.verify.adjustment.datum_fit import CAUSES, Adjustment, Estimate, FittedPose

_ALIKE = 10.0  # quantisation of unit normals within which grounds are one, steps per unit
_DIRECTIONS = 200  # of displacements that are sampled to find the possible sides
_NEGLIGIBLE = 1e-3  # weight below which a side is ignored
# Odds, before the measurement, that a body whose turn is judged sinks into its ground, if it stays upright: one in ten
# is displaced, and half of these sink. For bodies that may tilt as well even odds make sigma of those that do not sink
# larger by 44 % in the mean.
_SINKS, _TILTS_AND_SINKS = 0.05, 0.01
# Misfit of a shift alone, in variances of what edges do, from which the body may have turned: less shows no turn.
# If one is weighed always, U of bodies in place is a fifth larger.
_TURNS = 4.0
# Rounds in which it is found which feet sink, most often two or three; beyond, the part that sinks goes to and fro.
_ROUNDS = 10
_ALL_ALIKE = 1e-6  # of the largest: a difference between feet's rises that is rounding

_Weighed: TypeAlias = tuple[float, Estimate]  # with the logarithm of its weight


@dataclass(frozen=True, slots=True, eq=False)
class BodyLines:
    """How n places on a body's lines move in the photo with the body.

    by_point (n, 3) px/mm: motion across the line by a displacement of the body; lever (n,) px/mm: by how much less the
    line of a foot moves per mm that the body sinks, 0 for other places; ground (n, 3): unit normal of a foot's ground;
    p (n, 3) mm: the places; growth (n, g) px/mm: motion by each way in which the body may be larger than drawn. Motions
    of a body are columns of shift (mm), turn (rad) about its middle, and growth (mm).
    """

    by_point: Array
    lever: Array
    ground: Array
    p: Array
    growth: Array | None = None

    @property
    def arms(self) -> Array:
        """Return the places (n, 3) mm from their middle, about which the body turns."""
        return np.asarray(self.p - self.p.mean(axis=0))

    def grounds(self) -> tuple[Array, Longs]:
        """Return the distinct grounds (g, 3) of feet, and the number (n,) of each place's; 0 where it is no foot."""
        number = np.zeros(len(self.lever), np.int64)
        feet = self.lever != 0
        if not feet.any():
            return np.zeros((0, 3)), number
        ground = self.ground[feet]
        _, at = np.unique(np.rint(_ALIKE * ground), axis=0, return_inverse=True)
        number[feet] = at.reshape(-1)
        normals = np.array([ground[number[feet] == g].mean(axis=0) for g in range(int(number.max()) + 1)])
        return normals, number

    @property
    def grows(self) -> Array:
        """Return its growth (n, g), g = 0 where it has its size."""
        return np.zeros((len(self.p), 0)) if self.growth is None else self.growth

    def motions(self, shifts: Array, turns: Array, growth: float) -> Array:
        """Return motions (6 + g, m): shifts (3, s) mm, turns (3, t) rad, and growth (mm), each apart."""
        s, t, g = shifts.shape[1], turns.shape[1], self.grows.shape[1]
        out = np.zeros((6 + g, s + t + g))
        out[:3, :s], out[3:6, s : s + t], out[6:, s + t :] = shifts, turns, growth * np.eye(g)
        return out

    def moved_by(self, motions: Array, sunk: Mask) -> Array:
        """Return the motion (n, m) px of the lines by unit motions (6 + g, m).

        sunk (n,): which places belong to a ground that the body sinks into, where it leaves the line of a foot behind.
        """
        G = self._followed(sunk)
        return np.asarray(np.column_stack([G, np.cross(self.arms, G), self.grows]) @ motions)

    def upright(self, motions: Array) -> Array | None:
        """Return motions (6 + g, k): `motions` (6 + g, m) but for turns, and one about the ground's normal as large.

        None without feet, or where that turn moves no line.
        """
        feet, turns = self.lever != 0, motions[3:6].any(axis=0)
        if not feet.any() or not turns.any():
            return None
        turn = self.motions(np.zeros((3, 0)), self.ground[feet].mean(axis=0)[:, None], 0.0)[:, :1]
        most, own = (np.abs(self.moved_by(m, feet & ~feet)).max() for m in (motions[:, turns], turn))
        return np.column_stack([motions[:, ~turns], turn * most / own]) if own > 0 else None

    def rise(self, motions: Array) -> Array:
        """Return by how much (1, m) mm feet rise on the average by unit motions (6 + g, m); (0, m) without feet."""
        feet = self.lever != 0
        up = self.rises(motions)[feet]
        return np.asarray(up.mean(axis=0, keepdims=True) if feet.any() else up)

    def rises(self, motions: Array) -> Array:
        """Return by how much (n, m) mm each place rises from its ground by unit motions (6 + g, m)."""
        return np.asarray(np.column_stack([self.ground, np.cross(self.arms, self.ground)]) @ motions[:6])

    def parts(self, motions: Array) -> list[Mask]:
        """Return parts (n,) of the feet that may sink while the others rise: to either side of where these differ."""
        feet = self.lever != 0
        if not feet.any():
            return []
        rises = self.rises(motions)[feet]
        differ = rises - rises.mean(axis=0)
        _, S, Vt = np.linalg.svd(differ, full_matrices=False)
        rounding = _ALL_ALIKE * np.abs(rises).max()
        ways = np.zeros((np.count_nonzero(rounding < S), len(feet)))
        ways[:, feet] = Vt[: len(ways)] @ differ.T
        return [part for way in ways for part in (way < 0, way > 0)]

    def _followed(self, sunk: Mask) -> Array:
        behind = np.where(sunk & (self.lever != 0), self.lever, 0.0)
        return np.asarray(self.by_point - behind[:, None] * self.ground)


def following(
    adjustment: Adjustment,
    rows: Mask,
    body: BodyLines,
    pose: FittedPose,
    *,
    basis: Array,
    prior_mm: float,
    turns: Array,
) -> tuple[Estimate, float]:
    """Return the displacement (m,) mm along a basis (3, m) of the body with the offsets of `rows` (N,), and a misfit.

    After it its growth (g,) mm. It is that of the middle of its places; the misfit is that of a shift alone. body: the
    lines of these rows.
    prior_mm: standard deviation of a displacement along each vector of the basis before the measurement; along others
    there is none; of its growth, too. turns (3, n) rad: by which the body may be turned as well, 1 sigma.
    """
    normals, number = body.grounds()
    found: list[_Weighed] = []
    still = body.motions(basis, np.zeros((3, 0)), 1.0)
    for sunk in _sides(normals, basis):
        design = body.moved_by(still, sunk[number] if len(normals) else np.zeros(len(number), bool))
        estimate = adjustment.estimate(rows, design, pose, prior=prior_mm, enlarged=True)
        on_side = _log_probability(estimate, normals @ still[:3], sunk)
        found.append((on_side - 0.5 * adjustment.unlikeliness(rows, design, pose, prior=prior_mm), estimate))
    misfit = max(found, key=_weight)[1].misfit
    if turns.shape[1] and misfit > _TURNS:
        motions = body.motions(prior_mm * basis, turns, prior_mm)
        shift = prior_mm * np.delete(np.eye(motions.shape[1]), np.flatnonzero(motions[3:6].any(axis=0)), axis=0)
        turned = _turned(adjustment, rows, body, pose, motions, enlarged=True)
        turned = _or_upright(turned, adjustment, rows, body, pose, motions, odds=1.0)
        turned += _tipped(adjustment, rows, body, pose, motions, enlarged=True)
        found += [(log_weight, estimate.along(shift)) for log_weight, estimate in turned]
    return _mixed(found), misfit


def turning(
    adjustment: Adjustment,
    rows: Mask,
    body: BodyLines,
    pose: FittedPose,
    *,
    motions: Array,
    upright: bool,
    enlarged: bool = False,
) -> Estimate:
    """Return a body's motion (m,) in units of `motions` (6 + g, m), its feet following or sinking with it.

    motions: shifts (mm) with turns (rad) about the middle of the places, as large as they are usually, 1 sigma.
    upright: whether one that stays upright is weighed as well. Not where tilts are wholly unknown before, as by several
    photos: among motions that may be of any size any tilt is improbable. enlarged: as of `Adjustment.estimate`.
    """
    sides = _turned(adjustment, rows, body, pose, motions, odds=_TILTS_AND_SINKS, enlarged=enlarged)
    if upright:
        sides = _or_upright(sides, adjustment, rows, body, pose, motions, odds=_SINKS)
    tipped = _tipped(adjustment, rows, body, pose, motions, odds=_TILTS_AND_SINKS, enlarged=enlarged)
    return _mixed(sides + tipped)


def _or_upright(
    sides: list[_Weighed],
    adjustment: Adjustment,
    rows: Mask,
    body: BodyLines,
    pose: FittedPose,
    motions: Array,
    *,
    odds: float,
) -> list[_Weighed]:
    """Return what a body that turns may have done, each side as probable as by any turn or one about the upright.

    odds: before the measurement, that one which stays upright sinks; as far as that explains more than that its feet
    follow.
    """
    upright = body.upright(motions)
    if upright is None:
        return sides
    follows, sinks = (log_weight for log_weight, _ in _turned(adjustment, rows, body, pose, upright))
    by_sinking = np.log(odds) + sinks + np.log1p(-np.exp(follows - sinks)) if sinks > follows else -np.inf
    return [(float(np.logaddexp(w, v)), e) for (w, e), v in zip(sides, (follows, by_sinking), strict=True)]


def _turned(
    adjustment: Adjustment,
    rows: Mask,
    body: BodyLines,
    pose: FittedPose,
    motions: Array,
    *,
    odds: float = 1.0,
    enlarged: bool = False,
) -> list[_Weighed]:
    """Return the motions (m,) that a body, which turns, may have made, in units of `motions`, and their weights.

    odds: before the measurement, that it sinks.
    """
    feet, up = body.lever != 0, body.rise(motions)
    found: list[_Weighed] = []
    for sunk in (~feet & feet, feet)[: 1 + feet.any()]:
        design = body.moved_by(motions, sunk)
        estimate = adjustment.estimate(rows, design, pose, prior=1.0, enlarged=enlarged)
        on_side = _log_probability(estimate, up, sunk[feet][:1])
        rarely = np.log(odds) if sunk.any() else 0.0
        found.append((rarely + on_side - 0.5 * adjustment.unlikeliness(rows, design, pose, prior=1.0), estimate))
    return found


def _tipped(
    adjustment: Adjustment,
    rows: Mask,
    body: BodyLines,
    pose: FittedPose,
    motions: Array,
    *,
    odds: float = 1.0,
    enlarged: bool = False,
) -> list[_Weighed]:
    """Return the motions (m,) of a body of which some feet sink while others rise, and their weights; see `_turned`.

    Each is one by whose estimate those feet sink that were taken to.
    """
    feet, rises = body.lever != 0, body.rises(motions)
    found: list[_Weighed] = []
    tried = {(feet & ~feet).tobytes(), feet.tobytes()}  # not in part
    for sunk in body.parts(motions):
        for _ in range(_ROUNDS):
            if sunk.tobytes() in tried:
                break
            tried.add(sunk.tobytes())
            design = body.moved_by(motions, sunk)
            estimate = adjustment.estimate(rows, design, pose, prior=1.0, enlarged=enlarged)
            up = rises @ estimate.value
            if (sunk == (feet & (up < 0))).all():
                ends = np.flatnonzero(feet)[[np.argmin(up[feet]), np.argmax(up[feet])]]
                on_side = _log_probability(estimate, rises[ends], np.array([True, False]))
                unlikely = adjustment.unlikeliness(rows, design, pose, prior=1.0)
                found.append((float(np.log(odds)) + on_side - 0.5 * unlikely, estimate))
                break
            sunk = feet & (up < 0)
    return found


def _sides(normals: Array, basis: Array) -> list[Mask]:
    """Return the combinations of grounds (g,) that a body may have sunk into: the possible signs of displacements."""
    m = basis.shape[1]
    way = np.random.default_rng(0).normal(size=(_DIRECTIONS, m)) if m > 1 else np.array([[1.0], [-1.0]])
    return list(np.unique(way @ (normals @ basis).T < 0, axis=0))


def _log_probability(estimate: Estimate, normals: Array, sunk: Mask) -> float:
    """Return the log probability that the estimated displacement lies on that side of the grounds (g, m)."""
    from scipy.special import log_ndtr

    up = normals @ estimate.value
    sigma = np.sqrt(np.einsum("gi,ij,gj->g", normals, estimate.covariance, normals))
    return float(log_ndtr(np.where(sunk, -up, up) / np.maximum(sigma, 1e-12)).sum())


def _weight(found: _Weighed) -> float:
    return found[0]


def _mixed(weighed: Sequence[_Weighed]) -> Estimate:
    """Return the weighted mean of estimates and, by the law of total variance, the covariance due to each cause."""
    found, log_weight = [e for _, e in weighed], np.array([w for w, _ in weighed])
    weight = np.exp(log_weight - log_weight.max())
    weight = np.where(weight < _NEGLIGIBLE, 0.0, weight)
    weight /= weight.sum()
    value = np.asarray(weight @ np.array([e.value for e in found]))
    noise, edges, pose, calibration = (
        np.einsum("s,sij->ij", weight, np.array([getattr(e, cause) for e in found])) for cause in CAUSES
    )
    between = sum(w * np.outer(e.value - value, e.value - value) for w, e in zip(weight, found, strict=True))
    likeliest = found[int(np.argmax(weight))]
    return Estimate(value, noise, edges + between, pose, calibration, likeliest.misfit, likeliest.dof)
