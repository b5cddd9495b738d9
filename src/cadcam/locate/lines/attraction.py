"""Pulling a part's lines onto the photo's steps from some pixels away.

Samples on the visible lines search along their normals for brightness steps, several each. Every step attracts the
line, the nearer the more strongly: a sample's weight is shared among its steps and "none of them", as in a mixture of
normal distributions of one width, which shrinks from round to round. All lines move as one rigid part, so the others
resolve which of a plate's twin edges a step belongs to, and the first, wide rounds are guided by the whole. (Soft
assignment with annealing: S. Granger, X. Pennec, "Multi-scale EM-ICP", ECCV 2002.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, quantile
from cadcam.fit.optimal_design import design
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import hat
from cadcam.locate.freedom import Freedom, aligned, carried
from cadcam.locate.lines.sight import Sight
from cadcam.native.profiles import pulled

_SEARCHED = 400  # samples used, of all photos together
_SOFTNESS, _REACH = 0.6, 1.5  # width of the kernel and search range, relative to the possible error of the lines
_SHRINKS = 0.5  # ratio from one round to the next
_LAST = (3, 0.7)  # search range and width of the last round, px: the width of an edge
_NOTHING = 0.3  # weight of "none of them": a strong step at this height of its kernel pulls as much
_STRONG = 0.75  # quantile of the strongest slopes from which a step has full weight
_HELD = 1e-3  # least damping of every motion, relative to its own weight
_PULLS = 4  # Gauss-Newton steps on one set of candidates


def attracted(sights: Sequence[Sight], start: Rigid, freedom: Freedom, *, search_px: float) -> Rigid:
    """Return the pose whose lines lie on the photos' steps, from a start up to `search_px` off."""
    few = [telling_samples(s, start, max(_SEARCHED // len(sights), 60)) for s in sights]
    p = np.concatenate([s.samples.p for s in few])
    if not len(p):
        return start
    pose, middle = start, p.mean(axis=0)
    lines = sum(len(np.unique(s.samples.arc)) for s in few)
    for reach, soft in schedule(search_px):
        B = aligned(freedom.at(pose), middle, few[0].towards(middle, pose))
        # The start determines the lines to search_px. One line, whose samples err alike, determines them to `soft`.
        held = max(_HELD, (soft / search_px) ** 2 / lines)
        pose = _pulled(few, pose, B, middle, reach=reach, soft=soft, held=held)
    return pose


def telling_samples(sight: Sight, pose: Rigid, most: int) -> Sight:
    """Return the sight with about `most` of its samples: as many evenly as determine the pose, else where they do best.

    Of a long bar three fifths are at its ends. pose: world_from_part near which the samples are used.
    """
    n, p = len(sight.samples), sight.samples.p
    if n <= most:
        return sight
    middle = p.mean(axis=0)
    away = p - middle
    radius = np.sqrt(np.einsum("ij,ij->", away, away) / n)
    row = np.nan_to_num(sight.project(pose).row)
    turned = (row[:, 3:] + row[:, :3] @ hat(middle)) / radius  # about the middle
    share = most * design(np.concatenate([row[:, :3], turned], axis=1), np.ones(n))
    before = np.cumsum(np.minimum(share, 1.0))
    return sight.select(np.diff(np.floor(before + 0.5), prepend=0.0) > 0)


def schedule(search_px: float) -> list[tuple[int, float]]:
    """Return (reach px, softness px) of each round, the last one at the width of an edge."""
    rounds, far = [], search_px
    while far > _LAST[0] / 2:
        rounds.append((int(np.ceil(_REACH * far)) + 1, _SOFTNESS * far))
        far *= _SHRINKS
    return [*rounds, _LAST]


def _pulled(
    sights: Sequence[Sight], pose: Rigid, B: Array, middle: Array, *, reach: int, soft: float, held: float
) -> Rigid:
    """Return the pose after one round: candidates once, then a few steps among them."""
    rows, offsets, slopes = [], [], []
    for sight in sights:
        at = sight.project(pose)
        found = sight.candidates(at.q, at.normal, half_length=2.0, reach=reach)
        some = np.isfinite(found.offset[:, 0])
        rows.append(at.row[some] @ B)
        offsets.append(found.offset[some])
        slopes.append(found.slope[some])
    J, offset, slope = (np.concatenate(a) for a in (rows, offsets, slopes))
    if len(J) < 2 * J.shape[1]:
        return pose
    return carried(pose, B, pulled_onto(J, offset, slope, soft=soft, held=held), middle)


def pulled_onto(
    J: Array,
    offset: Array,
    slope: Array,
    *,
    soft: float,
    held: float = _HELD,
    stiff: tuple[Array, Array] | None = None,
) -> Array:
    """Return the step x (k,) that pulls N lines onto their candidate steps (N, M).

    J (N, k): derivative of the lines by x; offset, slope (N, M): places of the steps along the normals (px) and how
    steep they are, the steepest first, nan for none. held: damping of every motion, relative to its own weight. stiff:
    weights (k, k) and a vector `before` (k,), which hold before + x near zero, in units of a sample's pull.
    """
    size = np.abs(slope)
    strength = np.minimum(size / max(quantile(np.fmax(size[:, 0], 0.0), _STRONG), 1e-30), 1.0)
    # motions that no line determines stay 0
    return pulled(J, offset, strength, soft=soft, nothing=_NOTHING, held=held, pulls=_PULLS, stiff=stiff)
