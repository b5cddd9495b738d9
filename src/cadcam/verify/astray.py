"""Edges that something else than their body moved: a shadow's border beside them, a reflection, dirt.

The errors of edges are taken to be Gaussian, and in an even light they are. A shadow leads single edges astray, by many
sigmas: then a body of which one edge tells is called displaced, surely and wrongly. So edges are taken from a
contaminated distribution (J. W. Tukey, 1960): each may be astray, and then tells nothing, with a probability that is
counted in the picture itself, over the other bodies; but where all edges lie on even ground (`cadcam.verify.ground`)
there is nothing that could lead them astray. A body in place whose edges e = 1 ... n may be astray shows a displacement
as improbable as this one with the probability

    p + share * sum_e p_e + share^2 * sum_f p_ef + ...,

where p_e is that of its edges without e, 1 where these tell nothing, and e in the second sum is the edge that matters
most. One edge alone is never sure, two that agree are if edges are rarely astray, and more soon are. Edges that are led
astray together count as one, as far as they are off by little: parallel ones side by side, as the two of a plate's rim
(what is beside both cannot be taken for both of them), and a body's feet, along which its own shadow lies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from cadcam.arrays import Mask
from cadcam.verify.alarms import AS_IN_PLACE
from cadcam.verify.measured import Displacement, Measured
from cadcam.verify.sightlines import REACH_PX, Sightlines

# Share of edges that are astray in light with shadows before any are counted (24 of 1035 measured in photographs of a
# block under a lamp), and how many edges that is worth.
_USUAL, _BELIEVED = 0.02, 50
_UNEVEN = 0.2  # share of edges beside uneven ground from which all of that is believed
_DOUBTED = 0.01  # probability, of a body in place, below which it is asked whether edges are astray
_MOST = 4  # edges of a body that may be astray at once
_PARALLEL, _MOST_OF_IT = np.cos(np.radians(20.0)), 0.5  # edges side by side: about parallel, over half of their length
_DRAWN_PX = 1.0  # up to which both of them may be off by one cause
_LOOKED_AT = 6  # edges of a body that may be one of them, those that are farthest off


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """What a body's edges say if some of them are astray.

    edges: how many are measured, those side by side being one; gone: those that matter most, one after the other; sums:
    of the probabilities without the first k - 1 of them and any other one, for each k; kept (n,): the feature's places
    without all of them; rest: what these say.
    """

    edges: int
    gone: int = 0
    sums: tuple[float, ...] = ()
    kept: Mask = field(default_factory=lambda: np.zeros(0, bool))
    rest: Displacement | None = None

    @classmethod
    def of(cls, measured: Measured, number: int, *, doubted: bool = True) -> Doubt:
        """Return the doubt about a feature: none where it is not `doubted`, or its edges say that it is in place."""
        moved, rows = measured.moved(number), measured.members[number]
        groups = side_by_side(measured, rows)
        if not doubted or moved is None or moved.p_value >= _DOUBTED:
            return cls(len(groups))
        left, kept = _farthest(measured, rows, groups), rows
        sums: list[float] = []
        rest: Displacement | None = moved
        p = moved.p_value
        while left and len(sums) < _MOST and p < AS_IN_PLACE:
            tried = [kept & ~group for group in left]
            says = [measured.displacement(mask) for mask in tried]
            ps = [1.0 if s is None else s.p_value for s in says]
            worst = int(np.argmax(ps))
            sums.append(float(np.sum(ps)))
            kept, rest, p = tried[worst], says[worst], ps[worst]
            left.pop(worst)
        return cls(len(groups), len(sums), tuple(sums), kept, rest)

    @property
    def astray(self) -> int:
        """Return how many of the edges are rather astray than displaced: hardly more than half of them."""
        return self.gone if self.gone <= max(1, self.edges // 2) else 0

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

    def p_value(self, p: float, share: float) -> float:
        """Return how probable what the edges show is of a body in place, p if none and `share` of all are astray."""
        return min(1.0, p + float(np.sum([share ** (k + 1) * s for k, s in enumerate(self.sums)])))


def shares(doubts: Sequence[Doubt], measured: Measured, uneven: Callable[[], Mapping[int, bool]]) -> list[float]:
    """Return for each feature how often edges like its own are astray, by those of the others.

    uneven: which edges lie beside uneven ground, asked for only where there is a doubt.
    """
    if not any(d.gone for d in doubts):
        return [0.0] * len(doubts)
    beside = uneven()
    edges, astray = sum(d.edges for d in doubts), sum(d.astray for d in doubts)
    out = []
    for d, rows in zip(doubts, measured.members, strict=True):
        counted = (_USUAL * _BELIEVED + astray - d.astray) / (_BELIEVED + edges - d.edges)
        out.append(counted * _possible(beside, set(measured.lines.edge[rows].tolist())))
    return out


def _possible(uneven: Mapping[int, bool], own: set[int]) -> float:
    """Return in how far edges can be astray: not where all ground is even, the own edges' and that of the others."""
    if any(uneven[e] for e in own if e in uneven):
        return 1.0
    others = [told for e, told in uneven.items() if e not in own]
    return min(1.0, sum(others) / (_UNEVEN * max(len(others), 1)))


def side_by_side(measured: Measured, rows: Mask) -> list[Mask]:
    """Return the places (n,) of each of a feature's edges, parallel edges side by side together, and so its feet."""
    lines, offset = measured.lines, np.abs(measured.adjustment.offset)
    edges = np.unique(lines.edge[rows])
    places = [rows & (lines.edge == e) for e in edges]
    group = list(range(len(edges)))
    for i, j in combinations(range(len(edges)), 2):
        little = max(np.median(offset[places[i]]), np.median(offset[places[j]])) < _DRAWN_PX
        feet = (measured.mate[places[i] | places[j]] >= 0).all()
        if little and (feet or _beside(lines.select(places[i]), lines.select(places[j]))):
            group = [group[i] if g == group[j] else g for g in group]
    return [np.any([places[i] for i in range(len(edges)) if group[i] == g], axis=0) for g in sorted(set(group))]


def _beside(one: Sightlines, other: Sightlines) -> bool:
    """Return whether most of the shorter of two edges lies within reach of the other, and along it."""
    if one.photo[0] != other.photo[0]:
        return False
    short, long = (one, other) if len(one) < len(other) else (other, one)
    apart = np.linalg.norm(short.q[:, None] - long.q, axis=2)
    near = np.argmin(apart, axis=1)
    along = np.abs(np.einsum("ni,ni->n", short.normal, long.normal[near])) > _PARALLEL
    return bool(np.mean((apart.min(axis=1) < 2 * REACH_PX) & along) > _MOST_OF_IT)


def _farthest(measured: Measured, rows: Mask, groups: Sequence[Mask]) -> list[Mask]:
    """Return the groups of edges that are farthest off in their sigmas, against the pose without the feature."""
    pose = measured.pose_without(rows)
    assert pose is not None  # else no displacement is told
    told = [measured.across(group, pose=pose) for group in groups]
    far = [abs(value) / sigma for value, sigma, _ in told]
    return [groups[i] for i in np.argsort(far)[::-1][:_LOOKED_AT]]
