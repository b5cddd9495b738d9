"""The photo's edges fitted to the pixels along each edge of the model, and what they err by as a whole.

The places of an edge's steps are first taken from the candidates associated with it, then fitted, twice: the fit is
linear, and most accurate where the steps are. Beside the photo's noise, the steps of an edge err alike by the steps of
parallel lines near it, its twins, and by the sampling of an edge that runs along the rows of the pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cadcam.arrays import Array, Longs, Mask, quantile
from cadcam.cad.edges import EdgeKind
from cadcam.locate.lines.cells import Cells, CellSize, measured_steps
from cadcam.locate.lines.edges import Projected
from cadcam.locate.lines.sight import Sight
from cadcam.verify.edges.shifts import all_round
from cadcam.verify.edges.sightlines import REACH_PX, STEP_PX, Sightlines

ROOM_PX = 2.5  # room without other lines that a place needs for a step to be fitted to the pixels
_APART = 1.5  # blurs: the same again, for the steps of other lines
NEIGHBOURS = 4  # places on other lines that are compared with a place or a candidate
ON_LINE_PX = 1.2  # largest distance from a line of what belongs to it
# A twin's own step, of a blur slightly different from the assumed one, biases the fit: by so much at so many blurs'
# distance (measured in simulated pictures: 0.03 px at 3.5 blurs, 0.01 px at 4.5), falling fast with the distance.
_TWIN_ERROR_PX, _TWIN_BLURS = 0.035, 3.5
# The error of sampling by pixels averages out along an edge that crosses many rows, not along one that follows a row:
# an edge of a picture drawn with 4 x 4 samples a pixel is off by anything up to half the distance of the samples, if it
# spans less of the way from row to row than this. Diagonals and knight's moves are rows as well: the closer rows are to
# each other, the smaller their error.
_ROW_ERROR_PX, _ROW_SPAN = 0.25 / np.sqrt(12.0), 0.5
_ROWS = np.array([(1, 0), (0, 1), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1)], float)  # across which 1, 2, ...
_LEAST_STEP = 1e-3  # of brightness: fainter ones are no steps
_LEVEL_PX = 0.1  # by which a guess changes at least along an edge that is bent, and displaced
_ROUNDS, _EXACT_PX = 20, 1e-3  # of least absolute deviations, and what of them counts as none
_TWIN_SHARE = 0.6  # least distance of twins in the photo, as a share of that in the model


class FittedSteps(NamedTuple):
    """The steps of N places on edges, fitted to the pixels.

    offset, sigma (N,) px: of the step along the normal, and its standard deviation by the photo's noise, nan where it
    cannot be measured; common (N,) px: further error of a whole edge; step (N,): change of brightness, nan where there
    is no room.
    """

    offset: Array
    sigma: Array
    common: Array
    step: Array


def fitted_steps(lines: Sightlines, sights: Sequence[Sight], body: Longs, coarse: Array, guess: Array) -> FittedSteps:
    """Return the steps fitted where each edge's coarse offsets (N,) px predict them.

    guess (N,) px: where its body's shift has them. body (N,): number of what moves as one.
    """
    along_edge = _expected(coarse, guess, lines)
    places = np.where(np.isfinite(along_edge), along_edge, guess)
    distinct, twin = _told_from_twins(lines, sights, body, along_edge)
    closer = _expected(_measured(lines, sights, places, distinct, twin).offset, places, lines)
    return _measured(lines, sights, np.where(np.isfinite(closer), closer, places), distinct, twin)


def _expected(coarse: Array, guess: Array, lines: Sightlines) -> Array:
    """Return offsets (N,) px by each edge's coarse ones, which are on a straight line beside a guess (N,) px.

    nan: of edges not seen.
    """
    beside = beside_guess(lines, coarse, guess)
    out = np.full(len(coarse), np.nan)
    for e in np.unique(lines.edge[np.isfinite(coarse)]):
        rows = np.flatnonzero(lines.edge == e)
        have = rows[np.isfinite(coarse[rows])]
        slope, level = robust_line(lines.along[have], coarse[have] - beside[have])
        out[rows] = level + slope * lines.along[rows] + beside[rows]
    return out


def _measured(lines: Sightlines, sights: Sequence[Sight], expected: Array, distinct: Mask, twin: Longs) -> FittedSteps:
    """Return the steps fitted to the pixels about the expected offsets (N,) px.

    distinct (N,): places whose step cannot be confused with that of a line nearby, however little room they have; twin
    (N, 2): the places beside them, whose own steps are where they are expected.
    """
    moved = expected[:, None] * lines.normal
    apart = np.einsum("nki,ni->nk", moved[twin] - moved[:, None], lines.normal)
    apart = np.where((twin >= 0) & distinct[:, None], apart, 0.0)
    offset, sigma, step = (np.full(len(lines), np.nan) for _ in range(3))
    common = np.zeros(len(lines))
    for i, sight in enumerate(sights):
        rows = lines.photo == i
        at = Projected(lines.q[rows], lines.normal[rows], np.zeros((int(rows.sum()), 6)))
        cells = Cells.of(sight, at, CellSize(STEP_PX / 2, REACH_PX, ROOM_PX)).with_twins_moved(apart[rows])
        found = measured_steps(sight, at, cells, expected[rows], as_lines=True)
        clear = (lines.room[rows] >= ROOM_PX + _APART * cells.blur) | distinct[rows]
        usable = found.usable & clear
        offset[rows] = np.where(usable, found.offset, np.nan)
        sigma[rows] = np.where(usable, found.sigma, np.nan)
        step[rows] = np.where(clear, found.contrast, np.nan)
        index = np.flatnonzero(rows)
        common[rows] = np.hypot(_by_twins(lines, index, sight.samples.twins[:, :, 0], step, cells.blur), found.doubt)
    return FittedSteps(offset, sigma, np.hypot(common, _along_rows(lines)), step)


def _by_twins(lines: Sightlines, rows: Longs, away: Array, step: Array, blur: float) -> Array:
    """Return the error (n,) px of places `rows` (n,) due to twins `away` (n, 2) px along their normals.

    The residual of a twin's step is proportional to that step, and shifts a fainter one the more.
    """
    out = np.zeros(len(rows))
    for side in range(2):
        twin = np.flatnonzero(np.isfinite(away[:, side]))
        its = _places_at(lines, rows, rows[twin], away[twin, side])
        ratio = np.abs(step[its]) / np.maximum(np.abs(step[rows[twin]]), _LEAST_STEP)
        stronger = np.where((its >= 0) & np.isfinite(ratio), np.maximum(ratio, 1.0), 1.0)
        blurs = np.maximum(np.abs(away[twin, side]) / blur, 1.0)
        out[twin] = np.maximum(out[twin], stronger * _TWIN_ERROR_PX * (_TWIN_BLURS / blurs) ** 4)
    return out


def _along_rows(lines: Sightlines) -> Array:
    """Return the error (N,) px of edges that cross all pixels of a row at nearly the same place within the pixel.

    A row is any straight line of pixel centres, a column or a diagonal as well.
    """
    out = np.zeros(len(lines))
    apart = 1.0 / np.linalg.norm(_ROWS, axis=1)
    for e in np.unique(lines.edge):
        rows = lines.edge == e
        across = np.ptp(lines.q[rows] @ _ROWS.T, axis=0)
        out[rows] = (_ROW_ERROR_PX * apart * np.maximum(1.0 - across / _ROW_SPAN, 0.0)).max()
    return out


def _told_from_twins(lines: Sightlines, sights: Sequence[Sight], body: Longs, expected: Array) -> tuple[Mask, Longs]:
    """Return which places (N,) have parallel lines nearby, twins, and are distinguishable from all of them.

    Also the places (N, 2) nearest to theirs on these twins, -1 where there is none.

    A twin on another body may be displaced; for twins of one body the fit knows their distance. Twins are distinguished
    where both are seen, each in a place of its own. expected (N,) px: where the steps are, nan for edges not seen.
    """
    there = lines.q + expected[:, None] * lines.normal
    out, beside = np.zeros(len(lines), bool), np.full((len(lines), 2), -1)
    for i, sight in enumerate(sights):
        rows = np.flatnonzero(lines.photo == i)
        certain = np.ones((len(rows), 2), bool)
        for side in range(2):
            away = sight.samples.twins[:, side, 0]
            twin = np.flatnonzero(np.isfinite(away))
            mine, its = rows[twin], _places_at(lines, rows, rows[twin], away[twin])
            beside[mine, side] = its
            found = np.einsum("ni,ni->n", there[its] - there[mine], lines.normal[mine])
            certain[twin, side] = (its >= 0) & (body[mine] == body[its]) & (found / away[twin] > _TWIN_SHARE)
        twins = np.isfinite(sight.samples.twins[:, :, 0])
        all_drawn = lines.room[rows] >= np.minimum(sight.samples.below, sight.samples.above)
        out[rows] = twins.any(axis=1) & certain.all(axis=1) & all_drawn
    return out, beside


def _places_at(lines: Sightlines, among: Longs, rows: Longs, away: Array) -> Longs:
    """Return the places nearest to what lies `away` (n,) px along the normals of places `rows`; -1 where none is."""
    from scipy.spatial import cKDTree

    if not len(rows):
        return np.zeros(0, np.int64)
    q = lines.q[rows] + away[:, None] * lines.normal[rows]
    distance, near = cKDTree(lines.q[among]).query(q, k=NEIGHBOURS, distance_upper_bound=STEP_PX)
    known = np.isfinite(distance)
    j = among[np.where(known, near, 0)]
    across = np.abs(np.einsum("nki,nki->nk", q[:, None] - lines.q[j], lines.normal[j]))
    on_it = known & (lines.edge[j] != lines.edge[rows][:, None]) & (across < ON_LINE_PX)
    first = np.argmax(on_it, axis=1)
    return np.where(on_it.any(axis=1), j[np.arange(len(rows)), first], -1)


def rims(lines: Sightlines) -> Longs:
    """Return the rims that face all ways; not so contours, which depend on the light."""
    drawn = lines.kind != EdgeKind.CONTOUR
    return all_round(lines.rim[drawn], lines.normal[drawn])


def beside_guess(lines: Sightlines, offset: Array, guess: Array) -> Array:
    """Return about which values (N,) px an edge's offsets (N,) px, nan: unknown, lie on a straight line.

    The offsets of a bent edge that is displaced run up and down along it, as a guess (N,) px does: from a straight line
    half of them would be strays. So do those of an oblique rim that is larger. What shows all round is compared with
    the shift and growth that explain most of it, by least absolute deviations.
    """
    out, known = np.zeros(len(lines)), np.isfinite(offset)
    motions = np.column_stack([lines.normal, lines.outward * lines.widening])
    round_ = np.intersect1d(all_round(lines.rim[known], lines.normal[known]), rims(lines))
    for rim in round_:
        rows = lines.rim == rim
        have = rows & known
        out[rows] = motions[rows] @ _explaining(motions[have], offset[have])
    for e in np.unique(lines.edge[known & ~np.isin(lines.rim, round_)]):
        rows = np.flatnonzero(lines.edge == e)
        have = rows[known[rows]]
        if np.ptp(guess[rows]) > _LEVEL_PX:
            along, plain = lines.along[have], offset[have]
            if _off_line(along, plain - guess[have]) < _off_line(along, plain):
                out[rows] = guess[rows]
    return out


def _explaining(X: Array, offset: Array) -> Array:
    """Return the motion (m,), in columns of X (n, m), that explains most offsets (n,) px."""
    weight = np.ones(len(X))
    for _ in range(_ROUNDS):
        motion = np.linalg.lstsq(X * weight[:, None], offset * weight, rcond=None)[0]
        weight = 1 / np.sqrt(np.maximum(np.abs(offset - X @ motion), _EXACT_PX))
    return np.asarray(motion)


def _off_line(t: Array, y: Array) -> float:
    """Return how far y(t) is off its robust line, in the mean."""
    slope, level = robust_line(t, y)
    return float(np.abs(y - level - slope * t).mean())


def robust_line(t: Array, y: Array) -> tuple[float, float]:
    """Return slope and level of a line through y(t) that outliers do not turn: medians of its two halves."""
    half = len(t) // 2
    if half < 3:
        return 0.0, median(y)
    order = np.argsort(t)
    low, high = order[:half], order[-half:]
    run = median(t[high]) - median(t[low])
    slope = (median(y[high]) - median(y[low])) / run if run > 0 else 0.0
    return slope, median(y - slope * t)


def median(values: Array) -> float:
    """Return the median of numbers, none of them nan: what np.median does, quicker for a few of them."""
    return quantile(values, 0.5)
