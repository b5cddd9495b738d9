"""Is the part really there? How much of its edges the photo shows beyond chance and beyond what a fit achieves.

The photo shows some of the part's lines where they are drawn, and would show some anywhere (`locate.quality.shown`):

    share = (shown - by chance) / (1 - by chance)

But the pose is not a random one. It was fitted, and k degrees of freedom satisfy k constraints whatever the photo
shows; a start that was the best of very many poses has used up some more. Evidence is what agrees beyond these (an
event counts by how rarely it would occur anywhere in the search: Desolneux, Moisan and Morel, From Gestalt Theory to
Image Analysis, 2008, ch. 3). With C constraints that the visible lines are worth (`locate.quality.worth`)

    free = (k + those of the search) / C        net = (share - free) / (1 - free) - 0.6 absent - 20 scatter / extent

A box has nine lines, so a third is free; a part seen edge-on, or cut off by the picture's border, has hardly anything
left as evidence. absent: share of the visible length on lines shown nowhere; scatter: common error of each edge (px);
extent: size of what is visible (px). Edges that scatter little must also be met closely. Lines absent behind a straight
border count neither against the pose nor for it; where the answer is in doubt, one body of which nothing is shown is
left out, as if the model did not have it (`locate.quality.absent`).

A model of wrong proportions is the hardest case: most lines fit, and the others may lie to one side. So where the
answer is in doubt other proportions are tried (`locate.quality.proportions`), and what they gain counts twice against
the model as it is: net - 2 (net' - net), with nothing excused. Lines through the corners of a chequered background
belong to the background (`locate.quality.chequers`) and do not count as shown. In a colour photo, the colours on both
sides of the lines support a share c of them (`locate.quality.color`), which is independent of there being steps; two
constraints are lost for estimating the colours, the rest count as further constraints that are met: c' = c (1 - 2 / C),

    share' = (share + c') / (1 + c')        free' = free / (1 + c')

Quality 0.5, one threshold for all parts and photos, is a net share of 0.43.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.bands import FARTHEST_PX
from cadcam.locate.lines.sight import Sight, in_noise
from cadcam.locate.matches import JudgedSamples
from cadcam.locate.quality.absent import LEAST, behind_border, body_gone, missed
from cadcam.locate.quality.chequers import along_chequers
from cadcam.locate.quality.proportions import stretched
from cadcam.locate.quality.shown import ROOM_PX, near_px, shown
from cadcam.locate.quality.thin import Strips
from cadcam.locate.quality.worth import distinct_lines, further_arcs, worth_of_lines, worth_of_stretches

SEARCHED = 3  # constraints met in any photo by the best of all poses of a part
ASKED = 450  # samples in all photos together
_TOGETHER = 4  # samples in a row: a sample is shown only if its neighbour on the line agrees
_MUCH = 0.2  # free share above which straight stretches of bent lines are counted, too
_ABSENT, _SCATTER, _GAIN = 0.6, 20.0, 2.0  # weights of these terms
_TOLD_AT_ALL = 1e-6  # of what the lines tell best: a motion they tell less of is told by none
_IN_DOUBT, _OTHER = (0.3, 0.75), 0.04  # quality at which other proportions are tried; least difference
_ALWAYS = 1.1  # more than any quality
_TOLD = 0.05  # gain that is mentioned in the reason
_SHARES = (0.0, 0.43, 0.95)  # net shares that give quality 0, 1/2 and 1
_COLOR = 2  # constraints spent on estimating the colours
_WITHOUT = (0.1, 0.5)  # quality at which a body is left out
# Least share of what tells a motion that is shown. Right poses have 0.19 to 1, mostly 0.6; long bars slid along
# themselves, all of whose lines show but for their ends, have 0 to 0.02.
_DETERMINED = 0.08
_DETERMINED_AT_ALL = 0.02  # the same where the other lines are hidden by something that the photo shows
_CROWDED = 0.5  # share of edges without room that is named as the reason where too few can be judged
_MOST_FITTED, _UNPROVEN = 0.8, 0.45  # share of constraints fitted that still allows a proof; quality without one


@dataclass(frozen=True, slots=True)
class Support:
    """The evidence of the photos for the part's visible edges.

    samples: how many can be judged; shown, by_chance: the share of them where the photo shows the edge, and the share
    expected by chance; free: the share of their constraints that any pose could be fitted to; absent: the share of
    samples on lines shown nowhere, hidden: the part of it behind a border; scatter: of edges, relative to the size of
    what is visible; gain: increase of the net share for a model of other proportions, and which those are; color: share
    of constraints added by the colours beside the lines. gone: the body of which nothing is shown, -1: none; without:
    its share of the samples, where it was left out of all this; faint: the share of samples left out because the light
    gives them no contrast, covered: because something before the part hides them, side: on which side of the part;
    determined: the least share, over the motions that were fitted, of what all lines tell of a motion that those shown
    tell; crowded: the share of the samples in view that are too close to other lines to be judged; judged: the samples
    on feature edges, with those of a body left out: of a wrong pose just that may be missing which tells it.
    """

    samples: int
    shown: float
    by_chance: float
    free: float
    absent: float
    hidden: float
    scatter: float
    gain: float = 0.0
    proportions: str = ""
    color: float = 0.0
    gone: int = -1
    without: float = 0.0
    faint: float = 0.0
    covered: float = 0.0
    side: str = ""
    determined: float = 1.0
    crowded: float = 0.0
    judged: JudgedSamples = field(default_factory=JudgedSamples.none, repr=False)

    @property
    def fitted(self) -> float:
        """Return the share of all constraints, of lines and of colour, that any pose could be fitted to."""
        return self.free / (1 + self.color)

    @property
    def net(self) -> float:
        """Return the share of the edges that is evidence for the pose, less the evidence against it."""
        share = (self.shown - self.by_chance) / (1 - min(self.by_chance, 0.9))
        share, free = (share + self.color) / (1 + self.color), self.fitted
        net = (share - free) / (1 - free) - _ABSENT * (self.absent - self.hidden)
        return net - _SCATTER * self.scatter - _GAIN * self.gain

    @property
    def quality(self) -> float:
        """Return how certain it is that the pose is right, 0 to 1."""
        if self.samples < LEAST or self.fitted >= 1:
            return 0.0
        quality = float(np.interp(self.net, _SHARES, (0.0, 0.5, 1.0)))
        unproven = self.fitted > _MOST_FITTED or self.determined < _DETERMINED
        return min(quality, _UNPROVEN) if unproven else quality

    def uncovered(self, whole: Support, share: float, side: str) -> Support:
        """Return the support by the lines that nothing hides; whole: by all, of which it hides that share on that side.

        Of lines that cannot be seen it is not asked that they tell the pose, but that those in front tell it at all.
        """
        told = whole.determined >= _DETERMINED_AT_ALL
        return replace(self, covered=share, side=side, determined=self.determined if told else whole.determined)

    def __str__(self) -> str:
        if self.samples < LEAST or self.fitted > _MOST_FITTED:
            if self.crowded > _CROWDED:
                few = (
                    f"{self.crowded:.0%} of the part's edges in view lie too close to others to be told apart, and any"
                )
                return few + " place would fit the rest; nearer or by a longer lens more of them would stand apart"
            few = "so few edges of the part would be in the picture that any place would fit"
            return few + "; nearer, from another side or by a second camera more of them would be"
        free = f", {self.fitted:.0%} could be fitted anywhere" if self.fitted > 0.2 else ""
        other = f"; more were it {self.proportions} (other part, unit or scale?)" if self.gain > _TOLD else ""
        color = f", colours beside them count like {self.color:.0%} more" if self.color > 0 else ""
        edges = f"{self.shown:.0%} of the visible edges are there, {self.by_chance:.0%} would be by chance"
        body = f", those of a body with {self.without:.0%} of them left out: nothing of it is there" * (
            self.without > 0
        )
        faint = f", {self.faint:.0%} left out: the light gives them no contrast" * (self.faint > 0)
        at = f", at its {self.side}" if self.side else ""
        covered = f", {self.covered:.0%} left out: they are behind something before the part{at}" * (self.covered > 0)
        slid = ", those that tell along which it may slide or turn are not" * (self.determined < _DETERMINED)
        return edges + slid + covered + faint + body + color + free + other


def judged_support(
    sights: Sequence[Sight],
    world_from_part: Rigid,
    B: Array,
    *,
    chosen: int,
    scatter: float,
    color: float = 0.0,
    bands: bool = False,
) -> Support:
    """Return the support of a pose fitted along B (6, k); in doubt, a model of other proportions is tried, too.

    chosen: how many constraints the start met by being the best of many poses; less than 0, how many it need not have
    met anywhere, as it was known before. One is counted at least. color: the share of samples supported by
    the colours on both sides (`locate.quality.color`). bands: whether bands lie beside the lines; then proportions that
    would only move lines to the bands' other sides are no evidence.
    """
    constraints = max(B.shape[1] + chosen, 1)
    ask = partial(support_at, constraints=constraints, scatter=scatter)
    support = ask(sights, world_from_part, B=B)
    if support.gone >= 0 and _WITHOUT[0] < support.quality < _WITHOUT[1]:
        sights = [s.select(s.samples.part != support.gone) for s in sights]
        support = replace(ask(sights, world_from_part, B=B), without=support.without, judged=support.judged)
    else:
        support = replace(support, without=0.0)
    support = replace(support, color=color * max(1 - support.free * _COLOR / constraints, 0.0))
    most = _ALWAYS if in_noise(sights) else _IN_DOUBT[1]  # in noise a few missing lines hardly show
    if not _IN_DOUBT[0] < support.quality < most:
        return support
    other = stretched(sights, world_from_part, B)
    if other.by < _OTHER or (bands and other.moved_px(sights, world_from_part) < FARTHEST_PX):
        return support
    alike = partial(replace, free=support.free, scatter=support.scatter, hidden=0.0, color=support.color)
    as_it_is = alike(ask(_alone(sights), world_from_part))
    as_other = alike(ask(_alone(other.sights), other.world_from_part))
    gain = as_other.net - as_it_is.net
    return replace(support, hidden=0.0, gain=gain, proportions=str(other)) if gain > 0 else support


def _alone(sights: Sequence[Sight]) -> list[Sight]:
    """Return sights with only the lines that have room: beside thin plates a scaled line may meet the other border."""
    rooms = [np.minimum(s.samples.below, s.samples.above) for s in sights]
    return [s.select(room >= ROOM_PX) for s, room in zip(sights, rooms, strict=True)]


def support_at(
    sights: Sequence[Sight], world_from_part: Rigid, *, constraints: int, scatter: float, B: Array | None = None
) -> Support:
    """Return how much of the part's visible edges the photos show at a pose.

    constraints: how many its fit, and the search before it, could meet anywhere. scatter: sd (px) of the common error
    of each edge. B (6, k): the motions that were fitted; None leaves it open how those shown determine them.
    """
    near = near_px(sights, scatter)
    most = ASKED // len(sights)
    roomy = [has_room(s) for s in sights]
    apart = [_thinned(s, most, room) for s, room in zip(sights, roomy, strict=True)]
    photos = [_in_photo(s, world_from_part, near, constraints) for s in apart]
    n = max(sum(p.samples for p in photos), 1)
    extent = max((p.extent for p in photos), default=0.0)
    gone, of_gone = body_gone([(p.body, p.here) for p in photos])
    number = np.repeat(np.arange(len(photos), dtype=np.int32), [len(p.place) for p in photos])
    place, seen = (np.concatenate(parts) for parts in zip(*((p.place, p.seen) for p in photos), strict=True))
    return Support(
        samples=sum(p.samples for p in photos),
        shown=sum(p.shown for p in photos) / n,
        by_chance=sum(p.by_chance for p in photos) / n,
        free=constraints / max(sum(p.worth for p in photos), 1e-9),
        absent=sum(p.absent for p in photos) / n,
        hidden=sum(p.hidden for p in photos) / n,
        scatter=scatter / max(extent, 1.0),
        gone=gone,
        without=of_gone,
        determined=1.0 if B is None else _determined([(p.row @ B, p.here) for p in photos]),
        crowded=1.0 - float(np.concatenate(roomy).mean()) if any(map(len, roomy)) else 0.0,
        judged=JudgedSamples(place, number, seen),
    )


def _determined(told: Sequence[tuple[Array, Mask]]) -> float:
    """Return the least share of what lines tell of a motion that those shown tell.

    told: of each photo the rows (n, k) of the samples by k motions, and which of them are shown. Motions that none of
    the lines tell do not count.
    """
    rows, here = (np.concatenate(parts) for parts in zip(*told, strict=True))
    if not len(rows):
        return 0.0
    rows /= np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    size2, motions = np.linalg.eigh(rows.T @ rows)
    told_at_all = size2 > _TOLD_AT_ALL**2 * size2[-1]
    shown = rows[here] @ (motions[:, told_at_all] / np.sqrt(size2[told_at_all]))
    return float(np.linalg.eigvalsh(shown.T @ shown)[0]) if shown.size else 0.0


def with_room(sight: Sight, most: int) -> Sight:
    """Return a sight with about `most` of those of its samples that are far enough from the next line to be judged."""
    return _thinned(sight, most, has_room(sight))


def has_room(sight: Sight) -> Mask:
    """Return which samples of a sight (n,) are far enough from the next line to be judged."""
    return Strips.of(sight.samples).room >= ROOM_PX


def _thinned(sight: Sight, most: int, roomy: Mask) -> Sight:
    return sight.thinned(most, together=_TOGETHER, among=roomy)


@dataclass(frozen=True, slots=True, eq=False)
class _InPhoto:
    """The samples of one photo that can be judged: body, whether shown (n,), row (n, 6) as of `Projected`, and sums.

    place (m, 3), seen (m,): of those on feature edges, where on the part they are and whether they are shown.
    """

    body: Ids
    here: Mask
    shown: float = 0.0
    by_chance: float = 0.0
    worth: float = 0.0
    extent: float = 0.0
    absent: float = 0.0
    hidden: float = 0.0
    row: Array = field(default_factory=lambda: np.zeros((0, 6)))
    place: Array = field(default_factory=lambda: np.zeros((0, 3)))
    seen: Mask = field(default_factory=lambda: np.zeros(0, bool))

    @property
    def samples(self) -> int:
        return len(self.here)


@dataclass(frozen=True, slots=True, eq=False)
class ShownLines:
    """Samples (n,) of a part's lines in a photo: their numbers, places, normals, runs, rows, and which are shown.

    row (n, 6): as of `Projected`. share (1 + shifts,): of samples shown in place and after each shift
    (`locate.quality.shown`).
    """

    which: Longs
    q: Array
    normal: Array
    run: Ids
    row: Array
    here: Mask
    share: Array

    @classmethod
    def of(cls, sight: Sight, world_from_part: Rigid, near: float) -> ShownLines:
        """Return those of a sight at a pose; near: largest distance (px) between a line and its step."""
        at, samples = sight.project(world_from_part), sight.samples
        which = np.flatnonzero(at.imaged)
        strips, normal, run = Strips.of(samples.select(which)), at.normal[which], samples.run[which]
        q, row = at.q[which] + strips.middle[:, None] * normal, at.row[which]
        if not len(which):
            return cls(which, q, normal, run, row, np.zeros(0, bool), np.zeros(1))
        here, share = shown(sight, q, normal, run, strips.room, near + strips.half)
        crossed = here & along_chequers(sight.photo.gray, q, normal, run)
        share[0] *= 1 - crossed.sum() / max(int(here.sum()), 1)
        here = here & ~crossed
        return cls(which, q, normal, run, row, here, share)


def _in_photo(sight: Sight, world_from_part: Rigid, near: float, constraints: int) -> _InPhoto:
    there = ShownLines.of(sight, world_from_part, near)
    n, body, q = len(there.which), sight.samples.part[there.which], there.q
    if not n:
        return _InPhoto(body, there.here)
    arc = sight.samples.arc[there.which]
    lines, length = distinct_lines(q, arc)
    further = further_arcs(lines, arc, there.run)
    worth = worth_of_lines(length, further)
    if constraints >= _MUCH * worth:
        worth = worth_of_stretches(q, there.normal, arc, lines, length, further)
    absent, edge = missed(there.here, lines), sight.samples.chain[there.which] >= 0
    return _InPhoto(
        body,
        there.here,
        shown=n * float(there.share[0]),
        by_chance=n * float(there.share[1:].mean()),
        worth=worth,
        extent=float(np.hypot(*np.ptp(q, axis=0))),
        absent=float(absent.sum()),
        hidden=float(absent[behind_border(q, there.here) & ~further[lines]].sum()) if absent.any() else 0.0,
        row=there.row,
        place=sight.samples.p[there.which[edge]],
        seen=there.here[edge],
    )
