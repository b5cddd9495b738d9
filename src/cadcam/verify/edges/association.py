"""Which of the photo's edges belong to a feature: a common shift of the feature, beyond what a pose fit allows.

Near each place on a feature's lines the photo may have several edges. A feature is rigid: in each photo all of its
edges are displaced by one vector s (to first order), an edge with normal n by n . s. The shift with most support is
found on a grid; among equally well supported shifts the nominal place is preferred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.camera.camera import Camera
from cadcam.image.profile import CANDIDATE_ROOM_PX, step_candidates
from cadcam.locate.lines.sight import Sight
from cadcam.verify.edges.shifts import CAPTURE_PX, NEAR_PX, best_shift, grown, supported
from cadcam.verify.edges.sightlines import STEP_PX, Sightlines, pieces
from cadcam.verify.edges.step_fit import NEIGHBOURS, ON_LINE_PX, beside_guess, fitted_steps, median, rims, robust_line

BORDER_PX = CANDIDATE_ROOM_PX + CAPTURE_PX  # along the picture's border, within which no profile across an edge fits
_SEARCH_ROOM_PX = 1.5  # room beside other lines needed to search for an edge
_MOST = 6  # candidates per place
_COARSE_PX = 0.3  # approximate sigma of a candidate
_PARALLEL = np.cos(np.radians(20.0))
_STRAYS = 3.5  # robust sigmas
_IN_PLACE = np.zeros(2)  # px: no shift
# Of a place where no edge ought to show, beside others of its body where one ought: what is there may be a twin's, such
# as the other side of a thin rim, and speak for a place halfway.
_HARDLY = 0.5
_LEAST_SAMPLES, _LEAST_SHARE = 3, 0.4  # of an edge that must agree for it to count as seen


@dataclass(frozen=True, slots=True, eq=False)
class Association:
    """What the photos show at N places.

    coarse (N,) px: offset of the edge that the feature's shift predicts, nan where there is none; offset, sigma (N,)
    px: the same measured, with its standard deviation by the photo's noise, nan where it cannot be measured; common
    (N,) px: further error of a whole edge, by a twin or by running along the pixels' rows; apart (N,) px: one of each
    place by itself (`cadcam.verify.edges.limbs`). step (N,): change of brightness across the line at its place, with or
    without an edge; nan where there is no room. shift (N, 2) px: displacement in its photo of the feature that a place
    belongs to, to about a pixel; growth (N,) px: along its normal, by a larger rim, to about a pixel; 0 of other edges.
    """

    coarse: Array
    offset: Array
    sigma: Array
    common: Array
    apart: Array
    step: Array
    shift: Array
    growth: Array

    @property
    def support(self) -> Mask:
        """Return which places have an edge of the photo."""
        return np.isfinite(self.coarse)

    @property
    def measured(self) -> Mask:
        """Return which places have an edge whose offset is known."""
        return np.isfinite(self.offset)


def searchable(lines: Sightlines, cameras: Sequence[Camera]) -> Mask:
    """Return at which places (N,) an edge would be seen: those with room beside other lines, well inside the picture.

    Nearer to the picture's border there is no profile across the edge: that no edge is found tells nothing there.
    """
    out = lines.room >= _SEARCH_ROOM_PX
    along = np.stack([-lines.normal[:, 1], lines.normal[:, 0]], axis=1)
    for i, camera in enumerate(cameras):
        rows = np.flatnonzero((lines.photo == i) & out)
        across, beside = BORDER_PX * lines.normal[rows], 0.5 * STEP_PX * along[rows]
        corners = [lines.q[rows] + a * across + b * beside for a in (-1, 1) for b in (-1, 1)]
        out[rows] = camera.sees(np.array(corners)).all(axis=0)
    return np.asarray(out)


def nearby_edges(lines: Sightlines, sights: Sequence[Sight], *, reach_px: float, way: Array | None = None) -> Array:
    """Return the offsets (N, K) px along the normals of the photos' edges within `reach_px`, nan where no more are.

    way (N,): sign of the change of brightness that is searched for, 0 for either; by default either.
    """
    out = []
    for i, sight in enumerate(sights):
        rows = lines.photo == i
        found = step_candidates(
            sight.photo.gray,
            lines.q[rows],
            lines.normal[rows],
            half_length=STEP_PX / 2,
            reach=int(np.ceil(reach_px)),
            noise=sight.noise,
            most=_MOST,
        )
        wrong = np.zeros(found.slope.shape, bool) if way is None else found.slope * way[rows, None] < 0
        out.append(np.where(wrong, np.nan, found.offset))
    return np.concatenate(out)


def associated(
    lines: Sightlines,
    sights: Sequence[Sight],
    found: Array,
    body: Longs,
    *,
    reach_px: float,
    ought: Mask | None = None,
) -> Association:
    """Return the photo's edge at each place; body (N,) numbers what moves as one, -1 for places to ignore.

    found (N, K): see `nearby_edges`; ought (N,): which places should show an edge, by default all. Where bodies are
    found displaced, the others are searched for once more: their edges are not those of the displaced ones.
    """
    ought = np.ones(len(lines), bool) if ought is None else ought
    search = _Search(lines, found, body, ought, reach_px)
    coarse, shift, growth = search.with_rims(*search.assigned())
    guess = np.einsum("ni,ni->n", lines.normal, shift) + growth
    coarse = search.without_strays(coarse, guess, np.full(len(lines), _COARSE_PX))
    fitted = fitted_steps(lines, sights, body, coarse, guess)
    offset = search.without_strays(np.where(np.isfinite(coarse), fitted.offset, np.nan), guess, fitted.sigma)
    sigma = np.where(np.isfinite(offset), fitted.sigma, np.nan)
    return Association(coarse, offset, sigma, fitted.common, np.zeros(len(lines)), fitted.step, shift, growth)


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """The search for the bodies of N places among the candidates beside them; see `associated`."""

    lines: Sightlines
    found: Array
    body: Longs
    ought: Mask
    reach_px: float

    def assigned(self) -> tuple[Array, Array]:
        """Return the coarse offsets (N,) and shifts (N, 2) px of bodies, those beside displaced ones found again."""
        free = np.where(_explained(self.lines, self.found, self.body, _IN_PLACE), np.nan, self.found)
        coarse, shift = self._shifted(free)
        moved = np.hypot(*shift.T) > NEAR_PX
        if not moved.any():
            return coarse, shift
        taken = _explained(self.lines, self.found, self.body, shift, by=moved)
        others = np.where(np.isin(self.body, self.body[moved]), -1, self.body)
        left = replace(self, found=np.where(taken, np.nan, self.found), body=others)
        coarse_again, shift_again = left._shifted(np.where(taken, np.nan, free))
        again = others >= 0
        return np.where(again, coarse_again, coarse), np.where(again[:, None], shift_again, shift)

    def _shifted(self, free: Array) -> tuple[Array, Array]:
        """Return the coarse offsets (N,) and shifts (N, 2) of bodies, each searched for separately in each photo.

        free (N, K): the candidates that no other body explains.
        """
        lines, body = self.lines, self.body
        coarse, shift = np.full(len(lines), np.nan), np.zeros((len(lines), 2))
        for number in np.unique(body[body >= 0]):
            for photo in np.unique(lines.photo[body == number]):
                rows = np.flatnonzero((body == number) & (lines.photo == photo))
                normal = lines.normal[rows]
                groups = pieces(lines.edge[rows], normal), pieces(lines.bore[rows], normal)
                ought = self.ought[rows]
                worth = np.where(ought | ~ought.any(), 1.0, _HARDLY)
                s = best_shift(self.found[rows], normal, free=free[rows], worth=worth, reach_px=self.reach_px)
                if np.hypot(*s) > NEAR_PX and not _believed(free[rows], normal, groups, s, ought):
                    s = best_shift(self.found[rows], normal, reach_px=NEAR_PX)
                shift[rows] = s
                coarse[rows] = nearest(self.found[rows], normal @ s)
        return coarse, shift

    def with_rims(self, coarse: Array, shift: Array) -> tuple[Array, Array, Array]:
        """Return coarse offsets and shifts, those of larger rims set right, and by how many px (N,) rims are larger.

        A rim is an edge, or all arcs of a circle, that faces several ways; it may be larger by more than a displacement
        of its body explains. All rims of a bore are larger alike: which of the photo's edges is whose only all of them
        tell. Growth is along the normals, which point out of a rim or into it.
        """
        lines, asked = self.lines, self.body >= 0
        coarse, shift, growth = coarse.copy(), shift.copy(), np.zeros(len(lines))
        every = np.unique(lines.bore[asked & np.isin(lines.rim, rims(lines))])
        if not len(every):
            return coarse, shift, growth
        free = np.where(_explained(lines, self.found, lines.bore, _IN_PLACE), np.nan, self.found)
        outward = lines.outward
        for bore in every:
            rows = np.flatnonzero((lines.bore == bore) & asked)
            normal, out = lines.normal[rows], outward[rows]
            found, others, outward_normal = (v * out[:, None] for v in (self.found[rows], free[rows], normal))
            widening = lines.select(rows).widening
            widening /= widening.mean()
            size, by = grown(found, others, outward_normal, widening, shift[rows[0]], reach_px=self.reach_px)
            if size:
                growth[rows], shift[rows] = size * widening * out, by
                coarse[rows] = nearest(free[rows], normal @ by + growth[rows])
        return coarse, shift, growth

    def without_strays(self, offset: Array, guess: Array, sigma: Array) -> Array:
        """Return offsets (N,) px with nan in place of `strays` beside a guess (N,) px; sigma (N,): of each."""
        lines = self.lines
        straight = offset - beside_guess(lines, np.where(self.body >= 0, offset, np.nan), guess)
        stray = strays(straight, sigma, lines.edge, lines.along, self.body >= 0, self.ought)
        return np.where(stray, np.nan, offset)


def _explained(lines: Sightlines, found: Array, owner: Longs, shift: Array, *, by: Mask | None = None) -> Mask:
    """Return which candidates (N, K) are a line of the model with another owner (N,), a body or an edge.

    shift (2,) or (N, 2) px: displacement of the places; by (N,): places whose lines count, by default all.
    """
    out = np.zeros(found.shape, bool)
    row, k = np.nonzero(np.isfinite(found))
    drawn = replace(lines, q=lines.q + shift)
    out[row, k] = on_other_lines(lines.select(row), found[row, k], owner[row], drawn, owner, by=by)
    return out


def on_other_lines(
    places: Sightlines,
    offset: Array,
    owner: Longs | Ids,
    drawn: Sightlines,
    owners: Longs | Ids,
    *,
    by: Mask | None = None,
    within_px: float = ON_LINE_PX,
) -> Mask:
    """Return which edges of the photos, `offset` (n,) px beside n places, lie on drawn lines (N,) of another owner.

    owner (n,), owners (N,): a body or an edge; by (N,): drawn places whose lines count, by default all. within_px:
    largest distance from such a line.
    """
    from scipy.spatial import cKDTree

    out = np.zeros(len(places), bool)
    q = places.q + offset[:, None] * places.normal
    counts = np.ones(len(drawn), bool) if by is None else by
    for photo in np.unique(drawn.photo[counts]):
        mine, there = np.flatnonzero(places.photo == photo), np.flatnonzero((drawn.photo == photo) & counts)
        _, near = cKDTree(drawn.q[there]).query(q[mine], k=NEIGHBOURS, distance_upper_bound=STEP_PX)
        for neighbour in np.asarray(near).T:
            known = np.flatnonzero(neighbour < len(there))
            i, j = mine[known], there[neighbour[known]]
            across = np.abs(np.einsum("ni,ni->n", q[i] - drawn.q[j], drawn.normal[j]))
            parallel = np.abs(np.einsum("ni,ni->n", places.normal[i], drawn.normal[j])) > _PARALLEL
            out[i] |= (owner[i] != owners[j]) & parallel & (across < within_px)
    return out


def _believed(offset: Array, normal: Array, groups: Sequence[Longs], shift: Array, ought: Mask) -> bool:
    """Return whether a shift far from the nominal place is that of the feature, not of a line that happens to be there.

    At least two edges, or pieces of a bent one, must have moved so, and a good part of all places that ought (n,) to
    show an edge. groups: numbers (n,) of edges' pieces, and of bores': of a small hole's rims, which show in part, each
    may have too few places.
    """
    there = supported(offset, normal, shift)
    share = there[ought].mean() if ought.any() else there.mean()
    return bool(share >= _LEAST_SHARE and any(_moved(of, there) >= 2 for of in groups))


def _moved(group: Longs, there: Mask) -> int:
    """Return of how many groups, numbers (n,), half of the places or more are `there` (n,), a few at least."""
    at = np.unique(group, return_inverse=True)[1].reshape(-1)
    n, k = np.bincount(at), np.bincount(at, there)
    return int(((k >= n / 2) & (n >= _LEAST_SAMPLES)).sum())


def strays(offset: Array, sigma: Array, edge: Longs, along: Array, asked: Mask, ought: Mask) -> Mask:
    """Return the offsets that do not lie with those of their edge, and those of edges that are hardly seen.

    asked (N,): places that were looked at; ought (N,): those where the edge should show, as far as there are any.
    """
    out = np.zeros(len(offset), bool)
    for e in np.unique(edge[asked]):
        rows = np.flatnonzero((edge == e) & asked)
        have = rows[np.isfinite(offset[rows])]
        showing = rows[ought[rows]] if ought[rows].sum() >= _LEAST_SAMPLES else rows
        if np.isfinite(offset[showing]).sum() < max(_LEAST_SAMPLES, _LEAST_SHARE * len(showing)):
            out[have] = True
            continue
        slope, level = robust_line(along[have], offset[have])
        r = np.abs(offset[have] - level - slope * along[have])
        scale = max(1.4826 * median(r), median(sigma[have]))
        out[have[r > _STRAYS * scale]] = True
    return out


def nearest(found: Array, expected: Array) -> Array:
    """Return of each row the offset (n,) nearest to what is expected, nan if that is not near."""
    off = np.abs(found - expected[:, None])
    off[~np.isfinite(off)] = np.inf
    k = np.argmin(off, axis=1)
    i = np.arange(len(found))
    return np.where(off[i, k] <= CAPTURE_PX, found[i, k], np.nan)
