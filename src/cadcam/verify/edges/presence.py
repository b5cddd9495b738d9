"""Is a feature there at all? Edges seen, compared with edges that ought to be seen in this very picture.

The edges of a feature that should be visible are seen or not. Edges between the same two surfaces have contrast, or
lack it, together (`cadcam.verify.edges.surroundings`), so such a group is one piece of evidence. With contrast each of
its edges is seen, apart from lapses; without contrast, or where the feature is absent, an edge appears seen where
clutter lies. All three probabilities are estimated from the picture itself: contrast and lapse from the edges of the
other features, clutter from decoys, lines shifted to where the model has nothing. The log likelihood ratio L of
"present" against "absent" is a sum over groups. The places of an edge lie on one line, while those of texture lie
anywhere near it: that is evidence, too, and estimated likewise (`cadcam.verify.edges.straightness`). By Wald's
inequality (Sequential Analysis, 1947) a feature that is present gives L <= -T with probability of at most exp(-T), and
one that is absent gives L >= T as rarely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.verify.edges.association import Association, nearest
from cadcam.verify.edges.shifts import CAPTURE_PX, best_shift
from cadcam.verify.edges.sightlines import Sightlines, pieces
from cadcam.verify.edges.straightness import on_one_line, scatter_of, straightness_ratio
from cadcam.verify.edges.surroundings import EdgeSurroundings, alike

LEAST_PLACES = 4  # fewest places of an edge that are evidence
_DECOY_SHARE = 0.65  # distance of decoys as a share of the reach
_CLEAR_PX = 3.5  # distance from its own place from which a decoy counts
_DECOYS = 6
_MERGED_PX, _APART_PX = 4.0, 1e6  # distance within which two edges may look like one; of photos from each other
_SURE, _LEAST_STEP = 4.0, 0.008  # a faint edge: sigmas, and brightness (two steps of eight bits)
_AVERAGED = 5  # places over which steps were averaged
_STEEP = 4.0  # steepness of the curve from unseen to seen, over the logarithm of the contrast
_MIDDLES, _USUAL_MIDDLE = np.geomspace(0.004, 0.12, 33), 0.015  # contrasts seen half the time: tried, usual
_SUREST = 0.998  # probability up to which a group is believed to have contrast
_IN_PLACE, _LEAST_SIGMA_PX = 0.9, 0.05  # prior share of bodies' edges in place; least uncertainty of places
_SIZES_PX = 16.0  # range of a rim's difference in size
_LAPSE = 0.01  # prior share of edges with ample contrast that are not seen


@dataclass(frozen=True, slots=True, eq=False)
class Presence:
    """The evidence of a feature's edges: how many should be visible, how many are seen, and L (natural logarithm)."""

    expected: int
    seen: int
    log_ratio: float
    # L if nothing is known of the light: each group has contrast as likely as not, for which no faint edge speaks
    in_any_light: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class EdgeEvidence:
    """The edges (E,) with enough places to judge: number, group, expected contrast, and whether the edge is seen.

    faint: whether it is seen only by a step too faint to be certain at each place; scatter: of its places about a line
    (px), nan where they are too few or it is not clearly seen; place: the number of its first place. Edges of one group
    lie between the same two surfaces. The pieces of a bent edge that face different ways count separately: what hides
    one side of a rim does not hide the others. So do, of an edge that a feature cuts, its part and the rest. Of two
    that may look like one, as the rims of a hole in a sheet, the one that is not seen is no evidence.
    """

    edge: Longs
    group: Longs
    contrast: Array
    seen: Mask
    faint: Mask
    scatter: Array
    place: Longs

    @classmethod
    def of(
        cls,
        lines: Sightlines,
        rows: Mask,
        matched: Association,
        beside: EdgeSurroundings,
        *,
        member: Mask | None = None,
    ) -> EdgeEvidence:
        """Return the evidence of places `rows` (N,): edges seen at half of their places, or faintly along all of it.

        member (N,): places of a feature that may hold a part of an edge. Places in glare are none.
        """
        support, rows = matched.support, rows & ~beside.glare
        part = lines.edge if member is None else 2 * lines.edge + member
        at = pieces(part[rows], lines.normal[rows])
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
        first = np.array([p[0] for p in places], np.int64)
        every = cls(edge, alike(normal, color), contrast, plain | faint, faint & ~plain, told, first)
        return every.select(~_merged(lines, places, every.seen))

    def select(self, chosen: Mask) -> EdgeEvidence:
        """Return the chosen edges."""
        return EdgeEvidence(*(getattr(self, f.name)[chosen] for f in fields(self)))


def _merged(lines: Sightlines, places: Sequence[Longs], seen: Mask) -> Mask:
    """Return which edges (E,), not seen, run so close to one of the same part that is seen that both look like one."""
    from scipy.spatial import cKDTree

    out = np.zeros(len(places), bool)
    if seen.all() or not seen.any():
        return out
    at = np.column_stack([lines.q, _APART_PX * lines.photo])
    shown = np.concatenate([p for p, s in zip(places, seen, strict=True) if s])
    tree = cKDTree(at[shown])
    for i in np.flatnonzero(~seen):
        mine = places[int(i)]
        near = tree.query_ball_point(at[mine], _MERGED_PX)
        others = [np.asarray(shown[n]) for n in near]
        beside = [
            bool(((lines.part[o] == lines.part[m]) & (lines.edge[o] != lines.edge[m])).any())
            for o, m in zip(others, mine, strict=True)
        ]
        out[i] = np.mean(beside) >= 0.5
    return out


def _steps_somewhat(step: Array) -> bool:
    """Return whether the brightness changes across an edge in the median of its places, even if each is too faint."""
    known = step[np.isfinite(step)]
    if len(known) < LEAST_PLACES:
        return False
    middle = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - middle)))
    sigma = 1.25 * spread / np.sqrt(max(len(known) / _AVERAGED, 1.0))
    return bool(abs(middle) > max(_SURE * sigma, _LEAST_STEP))


def presence(evidence: EdgeEvidence, mine: Mask, *, clutter: Clutter, elsewhere: float) -> Presence:
    """Return the evidence for the feature with the edges `mine` (E,).

    elsewhere: logarithm of the number of other places searched for the feature, if it was found at one of these.
    """
    others = edge_visibility(evidence, ~mine)
    total = log_ratio(evidence, mine, others, clutter.share)
    any_light = log_ratio(evidence, mine & ~evidence.faint, others, clutter.share, contrast=0.5)
    seen = int(evidence.seen[mine].sum())
    less = elsewhere if seen else 0.0
    less -= straightness_ratio(evidence.scatter[mine], evidence.scatter[~mine], clutter.on_one_line)
    return Presence(int(mine.sum()), seen, total - less, any_light - less)


def log_ratio(
    evidence: EdgeEvidence, mine: Mask, seen: EdgeVisibility, clutter: float, *, contrast: float | None = None
) -> float:
    """Return L of the edges `mine` (E,), group by group; contrast: probability of it, by default from the light."""
    total = 0.0
    for group in np.unique(evidence.group[mine]):
        of = (evidence.group == group) & mine
        n, k = int(of.sum()), int(evidence.seen[of].sum())
        by_light = min(seen.has_contrast(float(np.median(evidence.contrast[of]))), _SUREST)
        there = by_light if contrast is None else contrast
        hit = max(1 - seen.lapse, clutter + _LAPSE)
        # Logarithms throughout: probabilities of some hundred edges are less than the least number.
        with_contrast = k * np.log(hit / clutter) + (n - k) * np.log((1 - hit) / (1 - clutter))
        total += np.logaddexp(np.log(there) + with_contrast, np.log1p(-there))
    return float(total)


@dataclass(frozen=True, slots=True)
class EdgeVisibility:
    """Which edges are seen: half of those of contrast `middle`, and of ample contrast all but a `lapse`."""

    middle: float
    lapse: float

    def has_contrast(self, contrast: float) -> float:
        """Return the probability that an edge of this expected contrast has enough of it."""
        return float(1.0 / (1.0 + (self.middle / max(contrast, 1e-4)) ** _STEEP))


def edge_visibility(evidence: EdgeEvidence, others: Mask) -> EdgeVisibility:
    """Return how well edges are seen, estimated from the others (E,).

    A logistic curve in the logarithm of the contrast, with a lapse: even an edge of ample contrast is sometimes not
    seen, because of shadows, dirt or an occluder. `middle` is the most probable one.
    """
    c, seen = np.maximum(evidence.contrast[others], 1e-4), evidence.seen[others]

    def curve(value: Array, middle: float) -> Array:
        return np.asarray(1.0 / (1.0 + (middle / value) ** _STEEP))

    fits = [np.log(np.where(seen, curve(c, m), 1 - curve(c, m)) * (1 - _LAPSE) + _LAPSE / 2).sum() for m in _MIDDLES]
    middle = float(_MIDDLES[int(np.argmax(fits - 0.5 * (np.log(_MIDDLES / _USUAL_MIDDLE)) ** 2))])
    ample = c > 2 * middle
    return EdgeVisibility(middle, (float((ample & ~seen).sum()) + 0.5) / (float(ample.sum()) + 0.5 / _LAPSE))


def in_place_ratio(offset: Array, sigma: Array, clutter: float, *, rim: Mask | None = None) -> float:
    """Return what the places (n,) px of seen edges add to L: those of clutter lie anywhere, those of a body in place.

    Clutter that is seen at a share of places within `CAPTURE_PX` has the density -log(1 - clutter) / (2 CAPTURE_PX)
    there; the nearest one of those seen, divided by that share. A body may also be displaced, and then this is no
    evidence, except for the pieces of a rim (n,) that is larger than drawn, whose offsets agree.
    """
    density = -np.log1p(-clutter) / (2 * CAPTURE_PX * clutter)
    s = np.maximum(sigma, _LEAST_SIGMA_PX)
    there = np.exp(-0.5 * (offset / s) ** 2) / (np.sqrt(2 * np.pi) * s)
    in_place = np.log(_IN_PLACE * there / density + 1 - _IN_PLACE).sum()
    as_likely = [in_place, 0.0]  # in place, or displaced
    if rim is not None and rim.any():
        as_likely.append(_as_one(offset[rim], s[rim], density))
    return float(np.logaddexp.reduce(as_likely) - np.log(len(as_likely)))


def _as_one(offset: Array, sigma: Array, density: float) -> float:
    """Return the log likelihood ratio of pieces (n,) px having one common offset, of any size, against clutter."""
    weight = sigma**-2.0
    mean = float(offset @ weight / weight.sum())
    agree = -0.5 * float((weight * (offset - mean) ** 2).sum()) - float(np.log(np.sqrt(2 * np.pi) * sigma).sum())
    anywhere = np.log(_SIZES_PX) + len(offset) * np.log(density)
    return float(agree + 0.5 * np.log(2 * np.pi / weight.sum()) - anywhere)


@dataclass(frozen=True, slots=True)
class Clutter:
    """How often an edge is seen where there is none (share), and how many of those so seen lie on one line."""

    share: float
    on_one_line: float


def clutter_of(lines: Sightlines, found: Array, body: Longs, *, reach_px: float) -> Clutter:
    """Return what edges are seen where there is none: from decoys, each shifted slightly to where it fits best."""
    counts = np.zeros(4)
    radius = _DECOY_SHARE * reach_px
    angles = np.pi * (np.arange(_DECOYS) + 0.5) / _DECOYS * 2
    for number in np.unique(body[body >= 0]):
        for photo in np.unique(lines.photo[body == number]):
            rows = np.flatnonzero((body == number) & (lines.photo == photo))
            for a in angles:
                counts += _decoy(lines, found, rows, radius * np.array([np.cos(a), np.sin(a)]))
    tries, hits, told, straight = counts
    # prior: a share of 0.1, of which half lies on one line
    share = float(np.clip((hits + 1.0) / (tries + 10.0), 0.01, 0.6))
    return Clutter(share, float((straight + 1.0) / (told + 2.0)))


def _decoy(lines: Sightlines, found: Array, rows: Longs, s: Array) -> Array:
    """Return counts (4,) of a feature's edges shifted by about s: all, seen, with enough places, on one line."""
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
