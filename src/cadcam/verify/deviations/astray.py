"""Edges that something else than their body moved: a shadow's border beside them, a reflection, dirt.

The errors of edges are taken to be Gaussian, and in an even light they are. A shadow leads single edges astray, by many
sigmas: then a body of which one edge tells is called displaced, surely and wrongly. So edges are taken from a
contaminated distribution (J. W. Tukey, 1960): each may be astray, and then tells nothing, with a probability that is
counted in the picture itself, over the other bodies; that goes by what lies beside it
(`cadcam.verify.deviations.ground`), by whether it shows wholly, and by how far off it surely is, as few are led far.
Where all edges lie on even ground there is nothing that could lead them astray. A body in place whose edges
e = 1 ... n are astray with chances c_e shows a displacement as improbable as this one with the probability

    p + sum_e c_e p_e + c_f sum_e c_e p_ef + ...,

where p_e is that of its edges without e, 1 where these tell nothing, and f is the edge that matters most. One edge
alone is never sure, two that are off by much are if edges are rarely astray, and more soon are. Edges that are led
astray together count as one, as far as they are off by little: parallel ones side by side, as the two of a plate's rim
(what is beside both cannot be taken for both of them), and a body's feet, along which its own shadow lies: where one of
two is astray the other is in a quarter of cases. The few edges of other bodies that a body's place hangs on are doubted
with its own: they may have led the pose astray.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.verify.adjustment.alarms import AS_IN_PLACE
from cadcam.verify.deviations.measured import Displacement, MeasuredEdges
from cadcam.verify.edges.sightlines import REACH_PX, Sightlines, pieces
from cadcam.verify.edges.survey import Survey

# Share of edges that are astray in light with shadows before any are counted, and how many edges that is worth; how
# many times as often as these all together those are that show wholly, beside even ground; how many times as often as
# those, again, such beside uneven ground, and such that show in part; and how far off an edge may be for it. Twice as
# far off are four times as few of those that show wholly, and half as many of those that show in part, until it is
# rather another line of the photo (2872 edges in photographs of a block under a lamp; docs/benchmarks/verify.md).
_USUAL, _BELIEVED = 0.02, 50
_SELDOM, _OFTEN, _IN_PART = 0.3, 10.0, 2.0
_WHOLLY = 0.9  # share of the places that an edge can be told at, where it shows wholly
_FAR_PX, _ANOTHER_PX = 0.25, 1.0
_SURELY = 2.0  # sigmas
_UNEVEN = 0.2  # share of edges beside uneven ground from which all of that is believed
_DOUBTED = 0.01  # probability, of a body in place, below which it is asked whether edges are astray
_MOST = 4  # edges of a body that may be astray at once
_PARALLEL, _MOST_OF_IT = np.cos(np.radians(20.0)), 0.5  # edges side by side: about parallel, over half of their length
_DRAWN_PX = 1.0  # up to which both of them may be off by one cause
_LOOKED_AT = 6  # edges of a body that may be one of them, those that are farthest off
_HELD_BY = 3  # edges of other bodies that are doubted, as its place hangs on them


@dataclass(frozen=True, slots=True, eq=False)
class EdgeGroup:
    """Edges of a body that are led astray together: their numbers, and how far off they surely are (px)."""

    edges: tuple[int, ...]
    off_px: float = 0.0

    def chance(self, usual: float, uneven: Mapping[int, bool], broken: Collection[int] = ()) -> float:
        """Return how probable it is that they are astray, and so far, if that `usual` share of edges is.

        uneven: edges beside uneven ground; broken: those that show in part.
        """
        often = _SELDOM * (_OFTEN if any(uneven.get(e, False) for e in self.edges) else 1.0)
        in_part = any(e in broken for e in self.edges)
        rare = _FAR_PX / min(max(self.off_px, _FAR_PX), _ANOTHER_PX)
        often *= _IN_PART * rare if in_part else rare**2
        return min(1.0, usual * often)


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """What a body's edges say if some of them are astray.

    groups: the edges that are measured, those side by side together: as many as `own` are the feature's, then come
    those others that its place hangs on, as the pose is fitted to them; tried (k, groups): for each k the probabilities
    without the first k - 1 that matter most and each of the others, 0 where that is not asked; kept (n,): the feature's
    places without all that matter; rest: what these say.
    """

    groups: tuple[EdgeGroup, ...]
    own: int
    tried: tuple[Array, ...] = ()
    kept: Mask = field(default_factory=lambda: np.zeros(0, bool))
    rest: Displacement | None = None

    @classmethod
    def of(cls, measured: MeasuredEdges, number: int, *, doubted: bool = True) -> Doubt:
        """Return the doubt about a feature: none where it is not `doubted`, or its edges say that it is in place."""
        moved, rows = measured.moved(number), measured.members[number]
        places = side_by_side(measured, rows)
        own = len(places)
        if not doubted or moved is None or moved.p_value >= _DOUBTED:
            return cls(tuple(EdgeGroup(_edges(measured, place)) for place in places), own)
        far, off_px = _off(measured, rows, places)
        left = np.argsort(far)[::-1][:_LOOKED_AT].tolist()
        for place in _holding(measured, rows):  # how far off these are is not known: the pose hangs on them
            left.append(len(places))
            places, off_px = [*places, place], np.append(off_px, 0.0)
        groups = [EdgeGroup(_edges(measured, place), float(px)) for place, px in zip(places, off_px, strict=True)]
        kept, apart, tried = rows, rows, list[Array]()
        rest: Displacement | None = moved
        p = moved.p_value
        while left and len(tried) < _MOST and p < AS_IN_PLACE:
            says = [measured.displacement(kept & ~places[i], apart=apart | places[i]) for i in left]
            ps = np.zeros(len(groups))
            ps[left] = [1.0 if s is None else s.p_value for s in says]
            tried.append(ps)
            worst = int(np.argmax(ps))
            rest, p = says[left.index(worst)], float(ps[worst])
            kept, apart = kept & ~places[worst], apart | places[worst]
            left.remove(worst)
        return cls(tuple(groups), own, tuple(tried), kept, rest)

    @property
    def gone(self) -> int:
        """Return how many of the edges matter: without them the others say in place, or nothing."""
        return len(self.tried)

    @property
    def astray(self) -> int:
        """Return how many of its edges, and no others, are rather astray than displaced: hardly more than half."""
        own = all(int(np.argmax(ps)) < self.own for ps in self.tried)
        return self.gone if own and self.gone <= max(1, self.own // 2) else 0

    def in_place(self, moved: Displacement) -> bool:
        """Return whether the edges that are not astray say in place, in all directions in which all of them tell."""
        rest = self.rest
        if not self.astray or rest is None or not rest.known or rest.p_value < AS_IN_PLACE:
            return False
        return bool(rest.basis.shape[1] >= moved.basis.shape[1])

    @property
    def rest_p(self) -> float:
        """Return how probable what the other edges show is of a body in place; nan where they tell nothing."""
        return float("nan") if self.rest is None else self.rest.p_value

    def p_value(self, p: float, chance: Array) -> float:
        """Return how probable what the edges show is of a body in place, p if none is astray; chance (groups,)."""
        together = 1.0
        for ps in self.tried:
            p += together * float(chance @ ps)
            together *= float(chance[int(np.argmax(ps))])
        return min(1.0, p)


def broken_edges(survey: Survey) -> set[int]:
    """Return the edges that are measured at some of the places only at which they can be told from others.

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
    """Return for each feature how probable it is of its groups of edges that they are astray, by those of the others.

    uneven: which edges lie beside uneven ground, asked for only where there is a doubt; broken: see `broken_edges`.
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
    """Return in how far edges can be astray: not where all ground is even, the own edges' and that of the others."""
    if any(uneven[e] for e in own if e in uneven):
        return 1.0
    others = [theirs for e, theirs in uneven.items() if e not in own]
    return min(1.0, sum(others) / (_UNEVEN * max(len(others), 1)))


def side_by_side(measured: MeasuredEdges, rows: Mask) -> list[Mask]:
    """Return the places (n,) of each of a feature's edges, parallel edges side by side together, and so its feet.

    An edge that is bent counts as several: what lies beside one side of a hole's rim does not move the others with it.
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
    """Return whether most of the shorter of two edges lies within reach of the other, and along it."""
    if one.photo[0] != other.photo[0]:
        return False
    short, long = (one, other) if len(one) < len(other) else (other, one)
    apart = np.linalg.norm(short.q[:, None] - long.q, axis=2)
    near = np.argmin(apart, axis=1)
    along = np.abs(np.einsum("ni,ni->n", short.normal, long.normal[near])) > _PARALLEL
    return bool(np.mean((apart.min(axis=1) < 2 * REACH_PX) & along) > _MOST_OF_IT)


def _off(measured: MeasuredEdges, rows: Mask, places: Sequence[Mask]) -> tuple[Array, Array]:
    """Return how far off groups of edges are against the pose without the feature: in their sigmas, surely in px."""
    pose = measured.pose_without(rows) if len(places) else None
    if pose is None:
        return np.zeros(len(places)), np.zeros(len(places))
    worst = []
    for place in places:
        its = [place & (measured.lines.edge == e) for e in np.unique(measured.lines.edge[place])]
        offsets = [np.abs(measured.across_px(edge, pose)) for edge in its]
        worst.append(max(offsets, key=lambda t: t[0] / t[1]))
    off, sigma = np.array(worst).T
    return off / sigma, np.maximum(off - _SURELY * sigma, 0.0)


def _edges(measured: MeasuredEdges, rows: Mask) -> tuple[int, ...]:
    return tuple(np.unique(measured.lines.edge[rows]).tolist())


def _holding(measured: MeasuredEdges, rows: Mask) -> list[Mask]:
    """Return the edges, of other bodies, that a feature's place hangs on most.

    Those without which the pose that is fitted to all others moves the feature's lines by most.
    """
    whole, lines = measured.pose_without(rows), measured.lines
    edges = np.unique(lines.edge[measured.adjustment.datum & ~np.isin(lines.edge, lines.edge[rows])])
    leverages: list[tuple[float, Mask]] = []
    for e in edges:
        its = lines.edge == e
        without = measured.pose_without(rows | its)
        if whole is None or without is None:
            leverages.append((np.inf, its))
            continue
        leverages.append((float(np.abs(lines.by_pose[rows] @ (without.xi - whole.xi)).max(initial=0.0)), its))
    return [its for _, its in sorted(leverages, key=lambda t: -t[0])[:_HELD_BY]]
