"""Is the part really there? How much of its edges the photo shows beyond what chance and the search give for nothing.

An edge counts as shown where brightness steps very near it, about as strongly as anywhere around, and where the next
sample on the line finds it at the same distance and of the same sign: a line, not a speckle. The same is asked of the
same lines shifted to where the part is not; what they find is chance:

    share = (shown - by chance) / (1 - by chance)

But the pose is not a random one. It was fitted, and k degrees of freedom lay that many constraints onto whatever the
photo has; a start that was the best of very many poses used up some more. Evidence is what agrees beyond these
(an event counts by how seldom it would come about anywhere in the search: Desolneux, Moisan and Morel, From Gestalt
Theory to Image Analysis, 2008, ch. 3). A line is worth two constraints, where it lies and how it turns, a short one
one, and so is each straight stretch of a line that bends: a corner that is rounded does not make one edge of two.
Lines that lie on one edge of the photo count once. With C constraints in sight

    free = (k + those of the search) / C        net = (share - free) / (1 - free) - 0.6 absent - 20 scatter / extent

A box has nine lines, so a third is free; a part seen edge-on, or cut by the picture's border, has hardly anything left
that could speak for it. absent: share of the visible length that lies on lines shown nowhere; scatter: by how much
edges are off as a whole (px), extent: size of what is seen (px). Edges that scatter little must also be met closely.
What stands before a part, or shade, takes all that lies to one side of a border; a wrong pose misses lines among others
that it meets. So lines absent behind a straight border do not count against the pose, nor do they count for it. A body
of an assembly that is not there takes all of its own lines, and no others: where the answer is in doubt, one body of
which nothing is shown is left out of what is asked, as if the model did not have it.

A model of wrong proportions is the hardest case: most lines fit, and the others may lie to one side. So where the
answer is in doubt other proportions are tried (`locate.proportions`), and what they gain counts twice against the model
as it is: net - 2 (net' - net), with nothing excused. Lines that run through the corners of a chequered ground are that
ground's (`locate.chequers`): they are not shown. In a photo in colour, the colours on both sides of the lines speak for
a share c of them (`locate.color`), which tells something else than that there are steps; two constraints are lost
on which colours these are, the rest count as further ones that are met: c' = c (1 - 2 / C),

    share' = (share + c') / (1 + c')        free' = free / (1 + c')

Quality 0.5, one threshold for all parts and photos, is a net share of 0.43.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import slope_noise
from cadcam.locate.chequers import along_chequers
from cadcam.locate.proportions import stretched
from cadcam.locate.sight import Sight
from cadcam.native.profiles import along_runs

Longs = npt.NDArray[np.int64]
SEARCHED = 3  # constraints that the best of all poses of a part in a photo meets without it
_ASKED = 450  # samples, of all photos together
_TOGETHER = 4  # of these in a row: neighbours must be neighbours
_NEAR_PX, _SCATTERS = (0.8, 2.0), 4.0  # px, and times the scatter of edges: how near a line its step must be
_REACH = 6  # px: how far around a line its step is compared
_ROOM_PX = 2.5  # a sample nearer than this to another line says nothing
_AGREE_PX = 0.5  # by which neighbours on a line may differ
_FAINT = 0.4  # of the strongest slope nearby
# Where noise hides lines: how far along a line steps are averaged to each side, px, and how clear they are, sd.
_IN_NOISE = 4.0, 3.0
_WIDE, _SURELY, _MOST_SHIFTED = 1.0, 1.5, 1.2  # px, blur of a step there; sd, and px, that noise may shift it by
_FAR, _AT = np.array([0.0, 14.0, 22.0, 14.0, 22.0]), np.array([0.0, 0.3, 1.9, 3.4, 5.0])  # px, rad
_SHIFTS = _FAR[:, None] * np.stack([np.cos(_AT), np.sin(_AT)], axis=1)  # px: in place, then elsewhere
_WORTH_PX = (10.0, 24.0)  # length from which a line is worth one constraint, and two
_CORNER, _CORNERS = np.radians(30.0), 16  # by which a line turns from one stretch to the next; most stretches of one
_MUCH = 0.2  # share of constraints that is free, from which on bends are looked at
_BENT, _AROUND = 1 / 170, 3  # rad a px, on the mean of so many samples to each side: from there on a line is bent
_ONE_EDGE = 8.0, np.cos(np.radians(4.0))  # px and turn within which lines lie on one edge of the photo
_STRAIGHT = 0.95  # chord over arc of a line that may lie on another
_NOWHERE = 0.25  # share of a line's samples below which it is missed
_BORDERS, _BEHIND = 32, 0.15  # directions of borders that are tried; share of the samples behind one that may be shown
_ABSENT, _SCATTER, _GAIN = 0.6, 20.0, 2.0  # what these cost
_IN_DOUBT, _OTHER = (0.3, 0.75), 0.04  # quality at which other proportions are tried; what makes them others
_ALWAYS = 1.1  # more than any quality
_TOLD = 0.05  # gain worth words
_SHARES = (0.0, 0.43, 0.95)  # net shares that make quality 0, 1/2 and 1
_COLOR = 2  # constraints that tell which colour the part has
_GONE, _MOST_GONE = 0.05, 1 / 3  # share of a body that may be shown by chance, and of all samples that may be its own
_WITHOUT = (0.1, 0.5)  # quality at which a body is left out
_LEAST = 12  # samples that can tell anything at all
_MOST_FITTED, _UNPROVEN = 0.8, 0.45  # share of constraints fitted that leaves enough for a proof; quality without one


@dataclass(frozen=True, slots=True)
class Seen:
    """What the photos show of the part's visible edges.

    samples: how many could tell; shown, by_chance: the share of them where the photo shows the edge, and where it would
    anyway; free: the share of their constraints that any pose could be fitted to; absent: the share of samples on lines
    shown nowhere, hidden: what of it lies behind a border; scatter: of edges, relative to the size of what is seen;
    gain: how much larger the net share would be with a model of other proportions, and which those are; color: share
    of constraints that the colours beside the lines add. gone: the body of which nothing is shown, -1: none; without:
    the share of samples that were its own, where it was left out of all this; faint: the share of samples that were
    left out because the light gives them no contrast.
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

    @property
    def fitted(self) -> float:
        """Return the share of all constraints, of lines and of colour, that any pose could be fitted to."""
        return self.free / (1 + self.color)

    @property
    def net(self) -> float:
        """Return the share of the edges that speaks for the pose, less what speaks against it."""
        share = (self.shown - self.by_chance) / (1 - min(self.by_chance, 0.9))
        share, free = (share + self.color) / (1 + self.color), self.fitted
        net = (share - free) / (1 - free) - _ABSENT * (self.absent - self.hidden)
        return net - _SCATTER * self.scatter - _GAIN * self.gain

    @property
    def quality(self) -> float:
        """Return how sure it is that the pose is right, 0 to 1."""
        if self.samples < _LEAST or self.fitted >= 1:
            return 0.0
        quality = float(np.interp(self.net, _SHARES, (0.0, 0.5, 1.0)))
        return min(quality, _UNPROVEN) if self.fitted > _MOST_FITTED else quality

    def __str__(self) -> str:
        if self.samples < _LEAST or self.fitted > _MOST_FITTED:
            return "so few edges of the part would be in the picture that any place would fit"
        free = f", {self.fitted:.0%} could be fitted anywhere" if self.fitted > 0.2 else ""
        other = f"; more were it {self.proportions} (other part, unit or scale?)" if self.gain > _TOLD else ""
        color = f", colours beside them count like {self.color:.0%} more" if self.color > 0 else ""
        edges = f"{self.shown:.0%} of the visible edges are there, {self.by_chance:.0%} would be by chance"
        body = f", those of a body with {self.without:.0%} of them left out: nothing of it is there" * (
            self.without > 0
        )
        faint = f", {self.faint:.0%} left out: the light gives them no contrast" * (self.faint > 0)
        return edges + faint + body + color + free + other


def judged(
    sights: Sequence[Sight], world_from_part: Rigid, B: Array, *, chosen: int, scatter: float, color: float = 0.0
) -> Seen:
    """Return what `seen` does for a pose fitted along B (6, k), and in doubt whether other proportions fit better.

    chosen: how many constraints the start met by being the best of many poses. color: the share of the samples for
    which the colour on both sides speaks (`locate.color`).
    """
    constraints = B.shape[1] + chosen
    first = seen(sights, world_from_part, constraints=constraints, scatter=scatter)
    if first.gone < 0 or not _WITHOUT[0] < first.quality < _WITHOUT[1]:
        first = replace(first, without=0.0)
    else:
        sights = [s.select(s.samples.part != first.gone) for s in sights]
        left = seen(sights, world_from_part, constraints=constraints, scatter=scatter)
        first = replace(left, without=first.without)
    first = replace(first, color=color * max(1 - first.free * _COLOR / constraints, 0.0))
    in_noise = any(s.photo.calm is not None for s in sights)  # a line or two that is missing hardly shows there
    if not _IN_DOUBT[0] < first.quality < (_ALWAYS if in_noise else _IN_DOUBT[1]):
        return first
    other = stretched(sights, world_from_part, B)
    if other.by < _OTHER:
        return first
    second = seen(other.sights, other.world_from_part, constraints=constraints, scatter=scatter)
    unexcused = replace(first, hidden=0.0)
    gain = replace(second, free=first.free, scatter=first.scatter, hidden=0.0, color=first.color).net - unexcused.net
    return replace(unexcused, gain=gain, proportions=str(other)) if gain > 0 else first


def seen(sights: Sequence[Sight], world_from_part: Rigid, *, constraints: int, scatter: float) -> Seen:
    """Return how much of the part's visible edges the photos show at a pose.

    constraints: how many of them its fit, and the search before it, could meet anywhere. scatter: sd (px) by which
    edges are off as a whole.
    """
    in_noise = any(s.photo.calm is not None for s in sights)  # the allowance there is for noise, not for another model
    near = _NEAR_PX[0] if in_noise else float(np.clip(_SCATTERS * scatter, *_NEAR_PX))
    told, shown, by_chance, worth, extent, absent, hidden = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    bodies: list[tuple[Ids, Mask]] = []
    most, room_px = _ASKED // len(sights), _ROOM_PX + 1.0
    for sight in (s.thinned(most, together=_TOGETHER, room_px=room_px) for s in sights):
        at, samples = sight.project(world_from_part), sight.samples
        room = np.minimum(np.minimum(samples.below, samples.above) - 1.0, _REACH)
        which = np.flatnonzero(np.isfinite(at.q).all(axis=1))
        if not len(which):
            continue
        q, normal, run, room = at.q[which], at.normal[which], samples.run[which], room[which]
        lines, length = distinct_lines(q, run)
        here, share = _shown(sight, q, normal, run, room, near)
        crossed = here & along_chequers(sight.photo.gray, q, normal, run)
        here, share[0] = here & ~crossed, max(share[0] - crossed.mean(), 0.0)
        bodies.append((samples.part[which], here))
        told += len(which)
        shown += len(which) * float(share[0])
        by_chance += len(which) * float(share[1:].mean())
        of_lines = float(np.searchsorted(_WORTH_PX, length, side="right").sum())
        worth += of_lines if constraints < _MUCH * of_lines else _worth(q, normal, run, lines, length)
        extent = max(extent, float(np.hypot(*np.ptp(q, axis=0))))
        missed = _missed(here, lines)
        absent += float(missed.sum())
        hidden += float(missed[behind_border(q, here)].sum()) if missed.any() else 0.0
    n = max(told, 1)
    free = constraints / max(worth, 1e-9)
    gone, of_gone = _gone(bodies)
    return Seen(
        told,
        shown / n,
        by_chance / n,
        free,
        absent / n,
        hidden / n,
        scatter / max(extent, 1.0),
        gone=gone,
        without=of_gone,
    )


def _gone(bodies: Sequence[tuple[Ids, Mask]]) -> tuple[int, float]:
    """Return the body of which nothing is shown in any photo, the one with most samples, and its share; -1 for none.

    bodies: for each photo the body of each sample (n,), and whether it shows an edge.
    """
    if not bodies:
        return -1, 0.0
    part, shown = np.concatenate([p for p, _ in bodies]), np.concatenate([s for _, s in bodies])
    its = np.bincount(part)
    may_be = (np.bincount(part, shown) <= _GONE * its) & (its >= _LEAST) & (its <= _MOST_GONE * len(part))
    most = int(np.argmax(np.where(may_be, its, 0)))
    return (most, float(its[most] / len(part))) if may_be[most] else (-1, 0.0)


def _shown(sight: Sight, q: Array, normal: Array, run: Ids, room: Array, near_px: float) -> tuple[Mask, Array]:
    """Return which samples (n,) show an edge, and the share that does in place and after each shift.

    Samples near which there is no step at all count half.
    """
    places = (q + _SHIFTS[:, None]).reshape(-1, 2)
    normals = np.tile(normal, (len(_SHIFTS), 1))
    half_length, clear = (2.0, 4.0) if sight.photo.calm is None else _IN_NOISE
    found = sight.candidates(places, normals, half_length=half_length, reach=_REACH, clear=clear)
    sd = _sd_place(sight, found.slope, half_length)
    offset = np.abs(found.offset).reshape(len(_SHIFTS), len(q), -1)
    slope = np.where(offset <= room[:, None], np.abs(found.slope).reshape(offset.shape), 0.0)
    strongest = slope.max(axis=2)
    near = (offset < np.hypot(near_px, sd).reshape(offset.shape)) & (slope > _FAINT * strongest[:, :, None])
    best = np.argmax(np.where(near, slope, 0.0), axis=2).ravel() + np.arange(len(places)) * offset.shape[2]
    at, sign, sd = found.offset.ravel()[best], np.sign(found.slope.ravel()[best]), sd.ravel()[best]
    good, at, sign, sd = (a.reshape(len(_SHIFTS), -1) for a in (near.ravel()[best], at, sign, sd))
    shown = _continued(good, at, sign, run, sd)
    return shown[0], 2 * shown.sum(axis=1) / ((strongest > 0).sum(axis=1) + len(q))


def _sd_place(sight: Sight, slope: Array, half_length: float) -> Array:
    """Return what noise may shift steps (N, M) of these slopes by, px: nil but where noise hides lines.

    A step of slope a, smoothed to a width s by a filter of width f, bends by a / s^2 at its top; noise n of the slope
    bends it by sqrt(3/2) n / f.
    """
    if sight.photo.calm is None:
        return np.zeros(slope.shape)
    filter2 = 1 + sight.photo.spread**2
    shift = slope_noise(sight.noise, half_length, sight.photo.spread) * np.sqrt(1.5 / filter2) * (filter2 + _WIDE**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.minimum(_SURELY * shift / np.abs(slope), _MOST_SHIFTED))


def _continued(good: Mask, offset: Array, sign: Array, run: Ids, sd: Array) -> Mask:
    """Return which good samples (..., n) have a neighbour on their run that is good, of the same sign and distance.

    sd (..., n) px: what noise may shift them by.
    """
    same = (run[1:] == run[:-1]) & (sign[..., 1:] == sign[..., :-1])
    apart = np.sqrt(_AGREE_PX**2 + sd[..., 1:] ** 2 + sd[..., :-1] ** 2)
    pair = good[..., 1:] & good[..., :-1] & same & (np.abs(np.diff(offset)) < apart)
    out = np.zeros(good.shape, bool)
    out[..., 1:] |= pair
    out[..., :-1] |= pair
    return out


def distinct_lines(q: Array, run: Ids) -> tuple[Longs, Array]:
    """Return the number of the distinct line of each sample (n,), and the length (L,) px of each of these lines.

    A straight run lies on another's line where both its ends are near that and its direction is about the same; it goes
    to the longest such.
    """
    first = np.flatnonzero(np.diff(run, prepend=-1))
    last = np.append(first[1:], len(run)) - 1
    a, b = q[first], q[last]
    step = np.hypot(*np.diff(q, axis=0, prepend=q[:1]).T)
    step[first] = 0.0
    arc, chord = np.add.reduceat(step, first), np.hypot(*(b - a).T)
    along = (b - a) / np.maximum(chord, 1e-9)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    straight = chord > _STRAIGHT * arc
    far = np.maximum(*(np.abs(np.einsum("ijk,jk->ij", end[:, None] - a, across)) for end in (a, b)))
    on = (far < _ONE_EDGE[0]) & (np.abs(along @ along.T) > _ONE_EDGE[1]) & straight & straight[:, None]
    np.fill_diagonal(on, True)
    owner = np.argmax(np.where(on, arc, -1.0), axis=1)
    _, line = np.unique(owner, return_inverse=True)
    return np.repeat(line, last - first + 1), np.bincount(line, arc).astype(np.float64)


def _worth(q: Array, normal: Array, run: Ids, line: Longs, length: Array) -> float:
    """Return how many constraints samples (n,) on lines of these lengths (L,) px lay on a pose.

    A line is worth what its straight stretches are; one that bends everywhere, or hardly, what its length is.
    """
    same = run[1:] == run[:-1]
    step, turn = (np.append(0.0, same * np.hypot(*np.diff(a, axis=0).T)) for a in (q, normal))
    straight = along_runs(turn, run, _AROUND) < _BENT * along_runs(step, run, _AROUND)
    turned = np.cumsum(turn)
    turned -= turned[np.searchsorted(run, run)]
    stretch = np.minimum(turned // _CORNER, _CORNERS - 1).astype(np.int64)
    of_stretch = np.bincount(line * _CORNERS + stretch, step * straight, len(length) * _CORNERS)
    worth = [np.searchsorted(_WORTH_PX, px, side="right") for px in (length, of_stretch)]
    return float(np.maximum(worth[0], worth[1].reshape(-1, _CORNERS).sum(axis=1)).sum())


def _missed(shown: Mask, line: Longs) -> Array:
    """Return which samples (n,) lie on lines that are nowhere shown, 0 to 1; a few shown make a line count less."""
    share = np.bincount(line, shown) / np.bincount(line)
    return np.asarray(np.clip(1 - share / _NOWHERE, 0, None)[line])


def behind_border(q: Array, shown: Mask) -> Mask:
    """Return which samples (n,) at q (n, 2) px lie on that side of a straight border where hardly any is shown.

    Of all borders that have such a side, the one with most samples there.
    """
    angle = 2 * np.pi * np.arange(_BORDERS // 2) / _BORDERS
    order = np.argsort(np.stack([np.cos(angle), np.sin(angle)], axis=1) @ q.T, axis=1)
    order = np.concatenate([order[:, ::-1], order])  # each border from either side
    count = np.arange(1, len(q) + 1)
    bare = np.cumsum(shown[order], axis=1) <= _BEHIND * count
    behind = np.where(bare, count, 0).max(axis=1)
    best = int(np.argmax(behind))
    out = np.zeros(len(q), bool)
    out[order[best, : behind[best]]] = True
    return out
