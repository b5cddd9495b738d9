"""Edges moved by something else than their body: a shadow's border beside them, a reflection, dirt.

The errors of edges are modelled as Gaussian, and under even light they are. But a shadow moves single edges by many
sigmas, and then a body that is measured by one edge would be called displaced, confidently and wrongly. So edges have a
contaminated distribution (J. W. Tukey, 1960): each may be astray, and then is no evidence, with a probability that is
estimated from the picture itself, over the other bodies. It depends on what lies beside the edge
(`cadcam.verify.deviations.ground`), on whether all of the edge is seen, and on its offset, as few edges go far astray.
Where all edges lie on even ground nothing could lead them astray. A body in place whose edges e = 1 ... n are astray
with probabilities c_e shows a displacement as improbable as this one with the probability

    p + sum_e c_e p_e + c_f sum_e c_e p_ef + ...,

where p_e is that of its edges without e, 1 where these are no evidence, and f is the edge that matters most. A single
edge is never certain; two that are far off are if edges are rarely astray, and three sooner. Edges that go astray
together count as one as long as they are off by little: parallel edges side by side, as the two of a plate's rim (what
is beside both cannot be mistaken for both), and a body's feet, along which its own shadow lies: where one of two is
astray the other is as well in a quarter of the cases. The few edges of other bodies that a body's place depends on are
doubted along with its own: they may have led the pose astray.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.errors import DegenerateGeometry
from cadcam.verify.adjustment.alarms import AS_IN_PLACE
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges
from cadcam.verify.edges.sightlines import REACH_PX, Sightlines, pieces
from cadcam.verify.edges.survey import Survey

# Prior share of edges that are astray in light with shadows, and how many edges that is worth; how many times as often
# as all of these together an edge is astray that is seen wholly, beside even ground; how many times as often as that
# one beside uneven ground, and one seen in part; and the offset for which this holds. At twice the offset, edges seen
# wholly are astray a quarter as often and those seen in part half as often, until another line of the photo is likelier
# (2872 edges in photographs of a block under a lamp; docs/benchmarks/verify-tried.md).
_USUAL, _BELIEVED = 0.02, 50
_SELDOM, _OFTEN, _IN_PART = 0.3, 10.0, 2.0
_WHOLLY = 0.9  # share of the distinguishable places of an edge from which it is seen wholly
_FAR_PX, _ANOTHER_PX = 0.25, 1.0
_SURELY = 2.0  # sigmas
_UNEVEN = 0.08  # share of edges beside uneven ground from which all such ground is believed
_DOUBTED = 0.01  # probability, for a body in place, below which edges are suspected of being astray
_LEAST_P = float(np.finfo(np.float64).tiny)  # of what was computed: 0 says that it was not
_MOST = 4  # most edges of a body that may be astray at once
_PARALLEL, _MOST_OF_IT = np.cos(np.radians(20.0)), 0.5  # edges side by side: parallel, and over half of their length
_DRAWN_PX = 1.0  # largest offset of both from one cause
_LOOKED_AT = 6  # edges of a body that may be astray: those farthest off
_HELD_BY = 3  # edges of other bodies that are doubted, as its place depends on them


@dataclass(frozen=True, slots=True, eq=False)
class EdgeGroup:
    """Edges of a body that go astray together: their numbers, and the least offset that is certain (px)."""

    edges: tuple[int, ...]
    off_px: float = 0.0

    def chance(self, usual: float, uneven: Mapping[int, bool], broken: Collection[int] = ()) -> float:
        """Return the probability that they are astray, and so far, given the `usual` share of edges that is.

        uneven: edges beside uneven ground; broken: those seen in part.
        """
        often = _SELDOM * (_OFTEN if any(uneven.get(e, False) for e in self.edges) else 1.0)
        in_part = any(e in broken for e in self.edges)
        rare = _FAR_PX / min(max(self.off_px, _FAR_PX), _ANOTHER_PX)
        often *= _IN_PART * rare if in_part else rare**2
        return min(1.0, usual * often)


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """The evidence of a body's edges if some of them are astray.

    groups: the measured edges, those side by side together: the first `own` are the feature's, then those of others
    that its place depends on, as the pose is fitted to them; tried (k, groups): for each k the probabilities without
    the first k - 1 that matter most and each of the others, 0 where not computed; kept (n,): the feature's places
    without all that matter; rest: the evidence of these.
    """

    groups: tuple[EdgeGroup, ...]
    own: int
    tried: tuple[Array, ...] = ()
    kept: Mask = field(default_factory=lambda: np.zeros(0, bool))
    rest: Displacement | None = None

    @classmethod
    def of(cls, measured: MeasuredEdges, number: int, *, doubted: bool = True) -> Doubt:
        """Return the doubt about a feature: none where it is not `doubted`, or its edges agree with its place."""
        moved, rows = measured.moved(number), measured.members[number]
        places = side_by_side(measured, rows)
        own = len(places)
        if not doubted or moved is None or moved.p_value >= _DOUBTED:
            return cls(tuple(EdgeGroup(_edges(measured, place)) for place in places), own)
        far, off_px = _off(measured, rows, places)
        left = np.argsort(far)[::-1][:_LOOKED_AT].tolist()
        for place in _holding(measured, rows):
            left.append(len(places))
            places, off_px = [*places, place], np.append(off_px, _off_instead(measured, rows, place))
        groups = [EdgeGroup(_edges(measured, place), float(px)) for place, px in zip(places, off_px, strict=True)]
        kept, apart, tried = rows, rows, list[Array]()
        rest: Displacement | None = moved
        p = moved.p_value
        while left and len(tried) < _MOST and p < AS_IN_PLACE:  # leave out the group that most of it is due to
            without = [measured.displacement(kept & ~places[i], apart=apart | places[i]) for i in left]
            ps = np.zeros(len(groups))
            ps[left] = [1.0 if found is None else max(found.p_value, _LEAST_P) for found in without]
            tried.append(ps)
            worst = int(np.argmax(ps))
            rest, p = without[left.index(worst)], float(ps[worst])
            kept, apart = kept & ~places[worst], apart | places[worst]
            left.remove(worst)
        return cls(tuple(groups), own, tuple(tried), kept, rest)

    @property
    def gone(self) -> int:
        """Return how many of the edges matter: without them the others agree with its place, or are no evidence."""
        return len(self.tried)

    @property
    def astray(self) -> int:
        """Return the number of its edges if just these are rather astray than displaced: hardly more than half."""
        own = all(int(np.argmax(ps)) < self.own for ps in self.tried)
        return self.gone if own and self.gone <= max(1, self.own // 2) else 0

    def in_place(self, moved: Displacement) -> bool:
        """Return whether the edges not astray agree with its place, in all directions that all of them measure."""
        rest = self.rest
        if not self.astray or rest is None or not rest.known or rest.p_value < AS_IN_PLACE:
            return False
        return bool(rest.basis.shape[1] >= moved.basis.shape[1])

    @property
    def rest_p(self) -> float:
        """Return the probability of what the other edges show for a body in place; nan where they are no evidence."""
        return float("nan") if self.rest is None else self.rest.p_value

    def p_value(self, p: float, chance: Array) -> float:
        """Return the probability of what the edges show for a body in place, p if none is astray; chance (groups,)."""
        together = 1.0
        for ps in self.tried:
            p += together * float(chance @ ps)
            together *= float(chance[int(np.argmax(ps))])
        return min(1.0, p)


def broken_edges(survey: Survey) -> set[int]:
    """Return the edges measured at only some of the places at which they are distinguishable from others.

    A shadow's border that leads an edge astray hardly follows all of it.
    """
    edge, usable = survey.lines.edge, survey.usable
    measured = np.bincount(edge, survey.matched.measured & usable)
    return set(np.flatnonzero((measured > 0) & (measured < _WHOLLY * np.bincount(edge, usable))).tolist())


def chances(
    doubts: Sequence[Doubt],
    measured: MeasuredEdges,
    uneven: Callable[[], Mapping[int, bool]],
    broken: Collection[int] = (),
) -> list[Array]:
    """Return for each feature the probability of each group of its edges to be astray, estimated from the others'.

    uneven: which edges lie beside uneven ground, computed only where there is a doubt; broken: see `broken_edges`.
    """
    if not any(d.gone for d in doubts):
        return [np.zeros(len(d.groups)) for d in doubts]
    beside = uneven()
    edges, astray = sum(d.own for d in doubts), sum(d.astray for d in doubts)
    out = []
    for d, rows in zip(doubts, measured.members, strict=True):
        counted = (_USUAL * _BELIEVED + astray - d.astray) / (_BELIEVED + edges - d.own)
        usual = counted * _possible(beside, set(measured.lines.edge[rows].tolist()))
        out.append(np.array([group.chance(usual, beside, broken) for group in d.groups]))
    return out


def _possible(uneven: Mapping[int, bool], own: set[int]) -> float:
    """Return how far edges can be astray at all: not where all ground is even, their own and that of the others."""
    if any(uneven[e] for e in own if e in uneven):
        return 1.0
    others = [theirs for e, theirs in uneven.items() if e not in own]
    return min(1.0, sum(others) / (_UNEVEN * max(len(others), 1)))


def side_by_side(measured: MeasuredEdges, rows: Mask) -> list[Mask]:
    """Return the places (n,) of each of a feature's edges; parallel edges side by side are one, and so are its feet.

    A bent edge counts as several: what lies beside one side of a hole's rim does not move the others with it.
    """
    lines, offset = measured.lines, np.abs(measured.adjustment.offset)
    piece = pieces(lines.edge[rows], lines.normal[rows])
    places = [_only(rows, piece == i) for i in np.unique(piece)]
    group = list(range(len(places)))
    for i, j in combinations(range(len(places)), 2):
        if lines.edge[places[i]][0] == lines.edge[places[j]][0]:
            continue
        little = max(np.median(offset[places[i]]), np.median(offset[places[j]])) < _DRAWN_PX
        feet = (measured.mate[places[i] | places[j]] >= 0).all()
        if little and (feet or _beside(lines.select(places[i]), lines.select(places[j]))):
            group = [group[i] if g == group[j] else g for g in group]
    return [np.any([places[i] for i in range(len(places)) if group[i] == g], axis=0) for g in sorted(set(group))]


def _only(rows: Mask, some: Mask) -> Mask:
    """Return which places (n,) are some of those of `rows`."""
    out = np.zeros(len(rows), bool)
    out[np.flatnonzero(rows)[some]] = True
    return out


def _beside(one: Sightlines, other: Sightlines) -> bool:
    """Return whether most of the shorter of two edges runs along the other, within reach."""
    if one.photo[0] != other.photo[0]:
        return False
    short, long = (one, other) if len(one) < len(other) else (other, one)
    apart = np.linalg.norm(short.q[:, None] - long.q, axis=2)
    near = np.argmin(apart, axis=1)
    along = np.abs(np.einsum("ni,ni->n", short.normal, long.normal[near])) > _PARALLEL
    return bool(np.mean((apart.min(axis=1) < 2 * REACH_PX) & along) > _MOST_OF_IT)


def _off(measured: MeasuredEdges, rows: Mask, places: Sequence[Mask]) -> tuple[Array, Array]:
    """Return how far off groups of edges are from the pose without the feature: in sigmas, and surely in px."""
    pose = measured.pose_without(rows) if len(places) else None
    if pose is None:
        return np.zeros(len(places)), np.zeros(len(places))
    off, sigma = np.abs([measured.farthest_px(place, pose) for place in places]).T
    return off / sigma, np.maximum(off - _SURELY * sigma, 0.0)


def _off_instead(measured: MeasuredEdges, rows: Mask, place: Mask) -> float:
    """Return how far (px) an edge that holds a feature is surely off if not the feature is: by a pose fitted to that.

    0 where the rest does not determine this pose.
    """
    datum = (measured.adjustment.datum & ~place) | rows
    try:
        pose = replace(measured.adjustment, datum=datum, known=None).pose()
    except DegenerateGeometry:
        return 0.0
    off, sigma = measured.farthest_px(place, pose)
    return max(abs(off) - _SURELY * sigma, 0.0)


def _edges(measured: MeasuredEdges, rows: Mask) -> tuple[int, ...]:
    return tuple(np.unique(measured.lines.edge[rows]).tolist())


def _holding(measured: MeasuredEdges, rows: Mask) -> list[Mask]:
    """Return the edges, of other bodies, that a feature's place depends on most.

    Those without which the pose fitted to all others moves the feature's lines most.
    """
    whole, lines = measured.pose_without(rows), measured.lines
    moved_by = lines.by_pose[rows]
    edges = np.unique(lines.edge[measured.adjustment.datum & ~np.isin(lines.edge, lines.edge[rows])])
    leverages: list[tuple[float, Mask]] = []
    for e in edges:
        its = lines.edge == e
        without = measured.pose_without(rows | its)
        if whole is None or without is None:
            leverages.append((np.inf, its))
            continue
        leverages.append((float(np.abs(moved_by @ (without.xi - whole.xi)).max(initial=0.0)), its))
    return [its for _, its in sorted(leverages, key=lambda t: -t[0])[:_HELD_BY]]
