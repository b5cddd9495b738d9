"""Is a feature there at all? Edges seen against edges that ought to be, weighed by what this very picture shows.

Edges of a feature that should be visible are seen or not. Those between the same two surfaces have contrast, or lack
it, together (`cadcam.verify.edges.surroundings`): such a group is one piece of evidence. With contrast each of its
edges is seen but for a lapse; without, and where the feature is not there, it seems seen where clutter lies. All three
probabilities are counted in the picture itself: contrast and lapse over the edges of the other features, clutter over
decoys, lines shifted to where the model has nothing. The log likelihood ratio L of "there" against "not there" is a sum
over groups. The places of an edge lie on one line, those of texture lie anywhere near it: that is evidence, too, and
counted alike (`cadcam.verify.edges.closeness`). By Wald's inequality (Sequential Analysis, 1947) a feature that is
there gives L <= -T with probability of at most exp(-T), and one that is not gives L >= T as rarely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.verify.edges.association import Association, nearest
from cadcam.verify.edges.closeness import as_close, on_one_line, scatter_of
from cadcam.verify.edges.shifts import CAPTURE_PX, best_shift
from cadcam.verify.edges.sightlines import Sightlines, pieces
from cadcam.verify.edges.surroundings import EdgeSurroundings, alike

LEAST_PLACES = 4  # of an edge that can say anything
_DECOY_SHARE = 0.65  # of the reach at which decoys stand
_CLEAR_PX = 3.5  # from its own place before a decoy counts
_DECOYS = 6
_SURE, _LEAST_STEP = 4.0, 0.008  # sigmas and brightness (two steps of eight bits) of a faint edge
_AVERAGED = 5  # places whose steps were averaged
_STEEP = 4.0  # of the curve from unseen to seen, by the logarithm of the contrast
_MIDDLES, _USUAL_MIDDLE = np.geomspace(0.004, 0.12, 33), 0.015  # contrasts that are seen half the time
_SUREST = 0.998  # probability up to which a group is believed to have contrast
_IN_PLACE, _LEAST_SIGMA_PX = 0.9, 0.05  # share of bodies' edges that are where they should be, as well as is believed
_SIZES_PX = 16.0  # range of what a rim may be larger or smaller by
_LAPSE = 0.01  # share of edges with ample contrast that are not seen, before any are counted


@dataclass(frozen=True, slots=True, eq=False)
class Presence:
    """What a feature's edges say: how many should be visible, how many are seen, and L (natural logarithm)."""

    expected: int
    seen: int
    log_ratio: float
    # L where nothing is known of the light: each group has contrast as likely as not, which no faint edge speaks for
    in_any_light: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class EdgeEvidence:
    """The edges (E,) with enough places to tell: number, group, expected contrast, and whether the edge is seen.

    faint: whether it is so by a step only that is too faint to tell at each place; scatter: of its places about a line
    (px), nan where they are too few or it is not plainly seen. Edges of one group lie between the same two surfaces.
    The pieces of a bent one that face different ways are several: what hides one side of a rim does not hide the
    others.
    """

    edge: Longs
    group: Longs
    contrast: Array
    seen: Mask
    faint: Mask
    scatter: Array

    @classmethod
    def of(cls, lines: Sightlines, rows: Mask, matched: Association, beside: EdgeSurroundings) -> EdgeEvidence:
        """Return the evidence of places `rows` (N,): edges seen at half of their places, or faintly along all of it."""
        support = matched.support
        at = pieces(lines.edge[rows], lines.normal[rows])
        n = np.bincount(at)
        share = np.bincount(at, support[rows]) / np.maximum(n, 1)
        scatter = scatter_of(matched.coarse[rows], lines.along[rows], at)
        long = np.flatnonzero(n >= LEAST_PLACES)
        index = np.flatnonzero(rows)
        places = [index[at == i] for i in long]
        edge = np.array([lines.edge[p[0]] for p in places], np.int64)
        normal = np.array([np.median(beside.normal[p], axis=0) for p in places]).reshape(-1, 2, 3)
        color = np.array([np.median(beside.color[p], axis=0) for p in places]).reshape(-1, 2).astype(np.int32)
        contrast = np.array([abs(np.median(beside.contrast[p])) for p in places])
        faint = np.array([_steps_somewhat(matched.step[p]) for p in places], bool)
        plain = share[long] >= 0.5
        told = np.where(plain, scatter[long], np.nan)
        return cls(edge, alike(normal, color), contrast, plain | faint, faint & ~plain, told)


def _steps_somewhat(step: Array) -> bool:
    """Return whether the brightness changes across an edge, by the median of its places: fainter than each can tell."""
    known = step[np.isfinite(step)]
    if len(known) < LEAST_PLACES:
        return False
    middle = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - middle)))
    sigma = 1.25 * spread / np.sqrt(max(len(known) / _AVERAGED, 1.0))
    return bool(abs(middle) > max(_SURE * sigma, _LEAST_STEP))


def presence(evidence: EdgeEvidence, mine: Mask, *, clutter: Clutter, elsewhere: float = 0.0) -> Presence:
    """Return the evidence for the feature with the edges `mine` (E,).

    elsewhere: logarithm of the number of places where it was looked for, if it was found at another than its own.
    """
    others = edge_visibility(evidence, ~mine)
    total = log_ratio(evidence, mine, others, clutter.share)
    any_light = log_ratio(evidence, mine & ~evidence.faint, others, clutter.share, contrast=0.5)
    seen = int(evidence.seen[mine].sum())
    less = elsewhere if seen else 0.0
    less -= as_close(evidence.scatter[mine], evidence.scatter[~mine], clutter.on_one_line)
    return Presence(int(mine.sum()), seen, total - less, any_light - less)


def log_ratio(
    evidence: EdgeEvidence, mine: Mask, seen: EdgeVisibility, clutter: float, *, contrast: float | None = None
) -> float:
    """Return L of the edges `mine` (E,), group by group; contrast: probability that it has it, default by the light."""
    total = 0.0
    for group in np.unique(evidence.group[mine]):
        of = (evidence.group == group) & mine
        n, k = int(of.sum()), int(evidence.seen[of].sum())
        by_light = min(seen.has_contrast(float(np.median(evidence.contrast[of]))), _SUREST)
        there = by_light if contrast is None else contrast
        without = clutter**k * (1 - clutter) ** (n - k)
        hit = max(1 - seen.lapse, clutter + _LAPSE)
        total += np.log(there * hit**k * (1 - hit) ** (n - k) + (1 - there) * without) - np.log(without)
    return float(total)


@dataclass(frozen=True, slots=True)
class EdgeVisibility:
    """Whether edges are seen, by their contrast: half of those of contrast `middle`, and all but a `lapse` of ample."""

    middle: float
    lapse: float

    def has_contrast(self, contrast: float) -> float:
        """Return the probability that an edge of this expected contrast has enough of it."""
        return float(1.0 / (1.0 + (self.middle / max(contrast, 1e-4)) ** _STEEP))


def edge_visibility(evidence: EdgeEvidence, others: Mask) -> EdgeVisibility:
    """Return how well edges are seen, as the others (E,) are.

    A logistic curve in the logarithm of the contrast, with a lapse: even ample contrast is now and then not seen, for
    shadows, dirt or something in front. Its middle is the most probable one.
    """
    c, seen = np.maximum(evidence.contrast[others], 1e-4), evidence.seen[others]

    def curve(value: Array, middle: float) -> Array:
        return np.asarray(1.0 / (1.0 + (middle / value) ** _STEEP))

    fits = [np.log(np.where(seen, curve(c, m), 1 - curve(c, m)) * (1 - _LAPSE) + _LAPSE / 2).sum() for m in _MIDDLES]
    middle = float(_MIDDLES[int(np.argmax(fits - 0.5 * (np.log(_MIDDLES / _USUAL_MIDDLE)) ** 2))])
    ample = c > 2 * middle
    return EdgeVisibility(middle, (float((ample & ~seen).sum()) + 0.5) / (float(ample.sum()) + 0.5 / _LAPSE))


def in_place_ratio(offset: Array, sigma: Array, clutter: float, *, rim: Mask | None = None) -> float:
    """Return what the places (n,) px of edges that are seen add to L: those of clutter lie anywhere, a body's in place.

    Clutter that is seen in a share of places within `CAPTURE_PX` has the density -log(1 - clutter) / (2 CAPTURE_PX)
    there; of what is seen, the nearest one, divided by that share. A body may as well be displaced: then this tells
    nothing, but for the pieces of a rim (n,) that is larger than drawn: what they are off agrees.
    """
    density = -np.log1p(-clutter) / (2 * CAPTURE_PX * clutter)
    s = np.maximum(sigma, _LEAST_SIGMA_PX)
    there = np.exp(-0.5 * (offset / s) ** 2) / (np.sqrt(2 * np.pi) * s)
    in_place = np.log(_IN_PLACE * there / density + 1 - _IN_PLACE).sum()
    displaced = 0.0 if rim is None or not rim.any() else np.logaddexp(0.0, _as_one(offset[rim], s[rim], density))
    return float(np.logaddexp(in_place, displaced) - np.log(2.0 if displaced == 0.0 else 3.0))


def _as_one(offset: Array, sigma: Array, density: float) -> float:
    """Return the logarithm of how much likelier pieces (n,) px all off by one value, any, are than those of clutter."""
    weight = sigma**-2.0
    mean = float(offset @ weight / weight.sum())
    agree = -0.5 * float((weight * (offset - mean) ** 2).sum()) - float(np.log(np.sqrt(2 * np.pi) * sigma).sum())
    anywhere = np.log(_SIZES_PX) + len(offset) * np.log(density)
    return float(agree + 0.5 * np.log(2 * np.pi / weight.sum()) - anywhere)


@dataclass(frozen=True, slots=True)
class Clutter:
    """How often an edge is seen where there is none (share), and of those so seen, how many lie on one line."""

    share: float
    on_one_line: float


def clutter_of(lines: Sightlines, found: Array, body: Longs, *, reach_px: float) -> Clutter:
    """Return what edges are seen where there is none: over decoys, each shifted about to where it fits best."""
    counts = np.zeros(4)
    radius = _DECOY_SHARE * reach_px
    angles = np.pi * (np.arange(_DECOYS) + 0.5) / _DECOYS * 2
    for number in np.unique(body[body >= 0]):
        for photo in np.unique(lines.photo[body == number]):
            rows = np.flatnonzero((body == number) & (lines.photo == photo))
            for a in angles:
                counts += _decoy(lines, found, rows, radius * np.array([np.cos(a), np.sin(a)]))
    tries, hits, told, straight = counts
    # a share of 0.1 is believed until counted otherwise, and of them a half
    share = float(np.clip((hits + 1.0) / (tries + 10.0), 0.01, 0.6))
    return Clutter(share, float((straight + 1.0) / (told + 2.0)))


def _decoy(lines: Sightlines, found: Array, rows: Longs, s: Array) -> Array:
    """Return of the edges of a feature shifted by about s: how many there are, seen, told, and on one line (4,)."""
    normal, offset = lines.normal[rows], found[rows]
    clear = np.abs(normal @ s) > _CLEAR_PX
    if not clear.any():
        return np.zeros(4)
    rows, normal, offset = rows[clear], normal[clear], offset[clear] - (normal[clear] @ s)[:, None]
    at = pieces(lines.edge[rows], normal)
    near = nearest(offset, normal @ best_shift(offset, normal, reach_px=1.5))
    n = np.bincount(at)
    seen = np.bincount(at, np.isfinite(near)) >= np.maximum(n, 1) / 2
    scatter = scatter_of(near, lines.along[rows], at)[seen & (n >= LEAST_PLACES)]
    told = np.isfinite(scatter)
    return np.array([(n >= LEAST_PLACES).sum(), len(scatter), told.sum(), on_one_line(scatter[told]).sum()], float)
